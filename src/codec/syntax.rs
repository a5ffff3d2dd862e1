//! The syntax of a frame: which section codes what, in which order. Written once: the encoder
//! walks it with a frame that is full, the decoder with one that fills.

use super::frame::Frame;
use crate::bitstream::{Section, SectionKind};
use crate::context::{
    ByteModel, ColumnModel, CorrectionModel, IntensityModel, IntensityNeighbours, IntensityScale,
    OccupancyModel, OrderModel, PointModel, RangeModel, neighbours_above,
};
use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::error::{Error, Limits, Result};
use crate::grid::Grid;
use crate::range_image::{RangeImage, Return};
use crate::scan::Layout;
use crate::sensor::SensorModel;

/// Opens the sections of a frame one after the other, to write or to read them.
pub trait SectionCoder {
    /// Codes the bits of a section.
    type Coder<'a>: BitCoder
    where
        Self: 'a;

    /// Codes one section by `code`. The section is left out if `present` is false.
    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut Self::Coder<'_>) -> Result<T>,
    ) -> Result<T>;

    /// What this side is willing to allocate.
    fn limits(&self) -> &Limits;
}

/// Collects the sections of a frame.
pub struct SectionWriter {
    /// The sections so far.
    pub sections: Vec<Section>,
    limits: Limits,
}

impl SectionWriter {
    /// No sections yet.
    pub fn new() -> Self {
        SectionWriter { sections: Vec::new(), limits: Limits::default() }
    }
}

impl SectionCoder for SectionWriter {
    type Coder<'a> = ArithmeticEncoder;

    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut ArithmeticEncoder) -> Result<T>,
    ) -> Result<T> {
        if !present {
            return Ok(T::default());
        }
        let mut coder = ArithmeticEncoder::default();
        let result = code(&mut coder)?;
        self.sections.push(Section { kind, payload: coder.finish() });
        Ok(result)
    }

    fn limits(&self) -> &Limits {
        &self.limits
    }
}

/// Takes the sections of a frame one by one.
pub struct SectionReader<'s> {
    sections: std::slice::Iter<'s, Section>,
    limits: &'s Limits,
}

impl<'s> SectionReader<'s> {
    /// Starts at the first section.
    pub fn new(sections: &'s [Section], limits: &'s Limits) -> Self {
        SectionReader { sections: sections.iter(), limits }
    }

    /// # Errors
    /// If sections are left over.
    pub fn finish(mut self) -> Result<()> {
        match self.sections.next() {
            None => Ok(()),
            Some(section) => Err(Error::corrupt(format!("{} section out of place", section.kind))),
        }
    }
}

impl SectionCoder for SectionReader<'_> {
    type Coder<'a>
        = ArithmeticDecoder<'a>
    where
        Self: 'a;

    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut ArithmeticDecoder<'_>) -> Result<T>,
    ) -> Result<T> {
        if !present {
            return Ok(T::default());
        }
        let section = self.sections.next().filter(|section| section.kind == kind);
        let section = section.ok_or_else(|| Error::corrupt(format!("{kind} section is missing")))?;
        let mut decoder = ArithmeticDecoder::new(&section.payload);
        code(&mut decoder)
    }

    fn limits(&self) -> &Limits {
        self.limits
    }
}

/// What a group's frames have taught so far.
#[derive(Default)]
pub struct Models {
    sizes: IntegerModel,
    bytes: ByteModel,
    extra: ByteModel,
    columns: ColumnModel,
    occupancy: OccupancyModel,
    points: PointModel,
    intensity: IntensityModel,
    range: RangeModel,
    correction: CorrectionModel,
    order: OrderModel,
}

impl Models {
    /// Codes a frame. The decoder's starts empty but for the number of records, and fills; it also gets the returns in file
    /// order, which both sides make from the range image.
    ///
    /// # Errors
    /// If the sections do not make a frame, or one over the limits.
    pub fn code_frame<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        sensor: Option<&SensorModel>,
        frame: &mut Frame,
    ) -> Result<Vec<Return>> {
        let limits = *sections.limits();
        sections.section(SectionKind::File, true, |coder| self.code_file(coder, frame, &limits))?;
        let has_points = frame.layout.position.is_some();
        let returns = frame.records - frame.strays;
        let has_image = returns > 0;
        let sensor = match sensor {
            Some(sensor) if has_image => Some(sensor),
            None if has_image => return Err(Error::corrupt("a range image without a sensor model")),
            _ => None,
        };
        if let Some(sensor) = sensor {
            sections.section(SectionKind::Columns, true, |coder| {
                self.columns.code(coder, sensor.ticks, &mut frame.columns);
                Ok(())
            })?;
            let cells = sensor.rows().saturating_mul(frame.columns.len());
            within(cells, limits.points, "cells of the range image")?;
            frame.fit_image(sensor.rows());
            sections.section(SectionKind::Occupancy, true, |coder| {
                self.occupancy.code(coder, &mut frame.occupancy);
                Ok(())
            })?;
            if frame.occupancy.cells().iter().filter(|&&filled| filled).count() != returns {
                return Err(Error::corrupt("the range image holds another number of returns than the frame"));
            }
        }
        frame.stray_positions.resize(if has_points { frame.strays } else { 0 }, [0.0; 3]);
        sections.section(SectionKind::Points, !frame.stray_positions.is_empty(), |coder| {
            self.points.code(coder, &mut frame.stray_positions);
            Ok(())
        })?;
        let has_intensity = frame.layout.intensity.is_some();
        let mut levels = sections
            .section(SectionKind::Intensity, has_intensity, |coder| Ok(self.code_intensity(coder, frame)))?;
        if !has_intensity {
            levels = Grid::new(frame.occupancy.rows(), frame.occupancy.columns());
        }
        sections.section(SectionKind::Range, has_image, |coder| {
            self.range.code(coder, &frame.occupancy, &levels, &mut frame.steps);
            Ok(())
        })?;
        let image = RangeImage {
            columns: std::mem::take(&mut frame.columns),
            steps: std::mem::take(&mut frame.steps),
        };
        let found = sensor.map_or_else(Vec::new, |sensor| image.file_order(sensor));
        if let Some(sensor) = sensor {
            frame.positions.resize(returns, [0.0; 3]);
            sections.section(SectionKind::Correction, true, |coder| {
                for (found, position) in found.iter().zip(&mut frame.positions) {
                    self.correction.code(coder, sensor, found, position);
                }
                Ok(())
            })?;
        }
        sections.section(SectionKind::Order, has_image, |coder| {
            self.order.code(coder, &mut frame.order, returns, frame.strays)
        })?;
        if !has_image {
            frame.order.stray_places = (0..frame.records as u64).collect();
        }
        let extra_bytes = frame.records.saturating_mul(frame.layout.extra_stride());
        within(extra_bytes, limits.file_bytes, "bytes of the frame")?;
        frame.extra.resize(extra_bytes, 0);
        sections.section(SectionKind::Extra, extra_bytes > 0, |coder| {
            self.extra.code(coder, frame.layout.extra_stride(), &mut frame.extra);
            Ok(())
        })?;
        Ok(found)
    }

    /// The layout of the file, and the bytes around the records.
    fn code_file<C: BitCoder>(&mut self, coder: &mut C, frame: &mut Frame, limits: &Limits) -> Result<()> {
        let mut layout = Vec::new();
        if C::ENCODES {
            frame.layout.write_to(&mut layout);
        }
        self.code_bytes(coder, &mut layout, limits)?;
        if !C::ENCODES {
            let mut rest = layout.as_slice();
            frame.layout = Layout::read_from(&mut rest)?;
            if !rest.is_empty() {
                return Err(Error::corrupt("record layout: bytes left over"));
            }
        }
        self.code_bytes(coder, &mut frame.prefix, limits)?;
        self.code_bytes(coder, &mut frame.suffix, limits)?;
        let records = self.sizes.code(coder, frame.records as u64);
        if records != frame.records as u64 {
            return Err(Error::corrupt(format!(
                "{records} points, not {} as the frame's header says",
                frame.records
            )));
        }
        frame.strays = self.sizes.code(coder, frame.strays as u64) as usize;
        within(frame.records, limits.points, "points of the frame")?;
        if frame.strays > frame.records || (frame.layout.position.is_none() && frame.strays < frame.records) {
            return Err(Error::corrupt("more strays than points"));
        }
        Ok(())
    }

    fn code_bytes<C: BitCoder>(&mut self, coder: &mut C, bytes: &mut Vec<u8>, limits: &Limits) -> Result<()> {
        let length = self.sizes.code(coder, bytes.len() as u64) as usize;
        within(length, limits.file_bytes, "bytes of the frame")?;
        bytes.resize(length, 0);
        self.bytes.code(coder, 1, bytes);
        Ok(())
    }

    /// The intensities of the returns, then of the strays. Gives the returns' as contexts for
    /// their ranges.
    fn code_intensity<C: BitCoder>(&mut self, coder: &mut C, frame: &mut Frame) -> Grid<u16> {
        let mut scale = IntensityScale::default();
        if C::ENCODES {
            let of_returns =
                frame.occupancy.cells().iter().zip(frame.intensity.cells()).filter(|(filled, _)| **filled);
            let values: Vec<f32> =
                of_returns.map(|(_, v)| *v).chain(frame.stray_intensity.iter().copied()).collect();
            scale = IntensityScale::of(&values);
        }
        scale.code(coder);
        let width = frame.occupancy.columns();
        let mut levels = Grid::new(frame.occupancy.rows(), width);
        self.intensity.start_frame(&scale, width);
        for row in 0..levels.rows() {
            self.intensity.start_row();
            let mut left = [0; 4];
            for column in (0..width).filter(|&column| frame.occupancy[(row, column)]) {
                let near = neighbours(&levels, left, row, column);
                let value = &mut frame.intensity[(row, column)];
                *value = self.intensity.code(coder, &scale, &near, (row, column), *value);
                levels[(row, column)] = scale.context_level(*value);
                left = [levels[(row, column)], left[0], left[1], left[2]];
            }
        }
        self.code_stray_intensity(coder, &scale, frame);
        levels
    }

    fn code_stray_intensity<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        frame: &mut Frame,
    ) {
        frame.stray_intensity.resize(frame.strays, 0.0);
        let north = neighbours_above(&frame.stray_positions);
        let mut levels: Vec<u16> = Vec::with_capacity(frame.strays);
        self.intensity.start_frame(scale, 1);
        for index in 0..frame.strays {
            let at = |index: Option<usize>| index.and_then(|i| levels.get(i)).copied().unwrap_or(0);
            let above = |offset: isize| {
                at(north.get(index).copied().flatten().and_then(|i| i.checked_add_signed(offset)))
            };
            let near = IntensityNeighbours {
                left: [1, 2, 3, 4].map(|distance| at(index.checked_sub(distance))),
                above: [-2, -1, 0, 1, 2].map(above),
                above2: 0,
            };
            let value = &mut frame.stray_intensity[index];
            *value = self.intensity.code(coder, scale, &near, (0, 0), *value);
            levels.push(scale.context_level(*value));
        }
    }
}

impl Frame {
    /// Gives the decoder's grids the size of the image.
    fn fit_image(&mut self, rows: usize) {
        if self.occupancy.rows() != rows || self.occupancy.columns() != self.columns.len() {
            self.occupancy = Grid::new(rows, self.columns.len());
            self.steps = Grid::new(rows, self.columns.len());
            self.intensity = Grid::new(rows, self.columns.len());
        }
    }
}

/// The levels around a cell.
fn neighbours(levels: &Grid<u16>, left: [u16; 4], row: usize, column: usize) -> IntensityNeighbours {
    let at =
        |rows_up: usize, offset: isize| match (row.checked_sub(rows_up), column.checked_add_signed(offset)) {
            (Some(row), Some(column)) if column < levels.columns() => levels[(row, column)],
            _ => 0,
        };
    IntensityNeighbours { left, above: [-2, -1, 0, 1, 2].map(|offset| at(1, offset)), above2: at(2, 0) }
}

fn within(got: usize, max: u64, what: &'static str) -> Result<()> {
    if got as u64 > max { Err(Error::LimitExceeded { what, got: got as u64, max }) } else { Ok(()) }
}
