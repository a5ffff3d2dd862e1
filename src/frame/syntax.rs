//! The syntax of a frame: its sections in order, and what codes each. Written once: the encoder passes a
//! frame that is complete, the decoder one that is filled.

use std::sync::Arc;
use std::time::Instant;

use byteorder::{ByteOrder, LittleEndian};

use super::fidelity::{Intensity, Positions};
use super::frame::Frame;
use super::modelling::{CorrectionModelling, IntensityModelling, OccupancyModelling};
use super::parameters::{FrameParameters, Prediction};
use super::quick::QuickModels;
use super::sections::SectionCoder;
use super::steps::{Step, StepReport};
use super::whole::WholeFile;
use crate::article::contour::ContourModel;
use crate::article::prediction::surface::SurfaceCoder;
use crate::backend::Level;
use crate::entropy::{AdaptiveBit, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::grid::Grid;
use crate::inter::Reference;
use crate::inter::registration::QuantisedPose;
use crate::inter::{self, Past};
use crate::models::channels::{Packed, code_packed};
use crate::models::{
    Beside, ByteModel, ChannelsModel, CorrectionModel, IntensityModel, IntensityNeighbours,
    IntensityReference, IntensityScale, OccupancyModel, OrderModel, PointModel, RangeModel, neighbours_above,
};
use crate::scan::{Channel, Field, Layout, Scalar};
use crate::scanner::motion::Compensation;
use crate::scanner::{ColumnModels, Coordinates, Return, Scanner};
use crate::stream::container::SectionKind;

/// What a group's frames have taught so far.
#[derive(Clone, Default)]
pub struct Models {
    /// The layout of the last frame.
    layout: Option<Layout>,
    sizes: IntegerModel,
    bytes: ByteModel,
    channels: ChannelsModel,
    rough_intensity: ChannelsModel,
    columns: ColumnModels,
    points: PointModel,
    points_are_packed: AdaptiveBit,
    // The large ones are created when they are first needed.
    occupancy: Option<OccupancyModel>,
    intensity: Option<IntensityModel>,
    pub(crate) range: Option<RangeModel>,
    pub(crate) contour: ContourModel,
    pub(crate) surfaces: SurfaceCoder,
    correction: CorrectionModel,
    order: OrderModel,
    pub(crate) quick: QuickModels,
    /// The last frame with a range image.
    past: Option<Arc<Past>>,
}

impl Models {
    /// Codes a frame. The decoder's frame is empty at first, except for the number of records, and is filled;
    /// it also gets the returns in file order, which both sides derive from the range image.
    ///
    /// # Errors
    /// If the sections do not make a frame, or make one that exceeds the limits.
    pub fn code_frame<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        frame: &mut Frame,
        steps: &mut StepReport,
    ) -> Result<Vec<Return>> {
        let limits = *sections.limits();
        let (start, before) = (Instant::now(), steps.total_time());
        code_parameters(sections, frame)?;
        if code_whole(sections, frame)? {
            steps.took(Step::Rest, start);
            return Ok(Vec::new());
        }
        sections.section(SectionKind::File, true, |coder| self.code_file(coder, frame, &limits))?;
        let returns = frame.records - frame.strays;
        let scanner = match scanner {
            Some(scanner) if returns > 0 => Some(scanner),
            None if returns > 0 => return Err(Error::corrupt("a range image without a scanner model")),
            _ => None,
        };
        let reference = match scanner {
            Some(scanner) => self.code_cells(sections, scanner, frame, returns)?,
            None => None,
        };
        let has_points = frame.layout.position.is_some();
        frame.stray_positions.resize(if has_points { frame.strays } else { 0 }, [0.0; 3]);
        let lattice = frame.parameters.positions.lattice();
        let effort = sections.effort();
        sections.section(SectionKind::Points, !frame.stray_positions.is_empty(), |coder| {
            self.code_strays(coder, (lattice, effort.level), frame.records, &mut frame.stray_positions)
        })?;
        let levels = self.code_intensities(sections, frame, reference.as_ref())?;
        let mut found = Vec::new();
        if let Some(scanner) = scanner {
            steps.converted += 4 * frame.image.steps.cells().len() as u64;
            self.code_ranges(sections, scanner, frame, (&levels, reference.as_ref()), steps)?;
            found = scanner.file_order(&frame.image);
            let can_be_past =
                scanner.hdl64().is_some() && frame.image.steps.cells().len() <= inter::MOST_CELLS;
            if can_be_past && frame.parameters.modelling().has_p_frames() {
                self.past = Some(Arc::new(Past::new(frame.image.clone(), levels)));
            }
        }
        frame.arrange(&found);
        if let Some(scanner) = scanner {
            self.code_positions(sections, scanner, frame, &found)?;
        }
        self.code_order(sections, frame, returns)?;
        let channel_bytes = frame.records.saturating_mul(frame.layout.channel_bytes());
        within(channel_bytes, limits.file_bytes, "bytes of the frame")?;
        frame.fit_channels();
        sections.section(SectionKind::Channels, channel_bytes > 0, |coder| {
            let beside = frame.beside(&found)?;
            self.channels.code(coder, &mut frame.channels, &beside, effort.level)
        })?;
        code_compensation(sections, frame)?;
        let others = steps.total_time() - before;
        steps.took(Step::Rest, start + others);
        Ok(found)
    }

    /// Points outside any range image: by the model of points, or, if most points are such, by a
    /// general-purpose coder where that is shorter.
    fn code_strays<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (lattice, level): (Option<Coordinates>, Level),
        records: usize,
        positions: &mut [[f32; 3]],
    ) -> Result<()> {
        const WIDTH: usize = 12;
        let mut packed = None;
        if C::ENCODES && lattice.is_none() && 2 * positions.len() > records {
            let mut encoder = ArithmeticEncoder::default();
            self.points.clone().code(&mut encoder, lattice, &mut positions.to_vec());
            let bytes: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
            packed = Packed::shortest(&bytes, Scalar::F32, WIDTH, level, encoder.finish().len());
        }
        if !self.points_are_packed.code(coder, packed.is_some()) {
            self.points.code(coder, lattice, positions);
            return Ok(());
        }
        let mut bytes = vec![0; WIDTH * positions.len()];
        code_packed(coder, packed, Scalar::F32, WIDTH, &mut bytes)?;
        if !C::ENCODES {
            for (position, values) in positions.iter_mut().zip(bytes.chunks_exact(WIDTH)) {
                *position = std::array::from_fn(|axis| LittleEndian::read_f32(&values[4 * axis..]));
            }
        }
        Ok(())
    }

    /// The columns of the range image, and which of its cells hold a return. Returns the reference if the
    /// frame is predicted from the one before.
    fn code_cells<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut Frame,
        returns: usize,
    ) -> Result<Option<Reference>> {
        let most = sections.limits().points;
        sections.section(SectionKind::Columns, true, |coder| {
            scanner.code_columns(&mut self.columns, coder, &mut frame.image, most)
        })?;
        let cells = scanner.rows().saturating_mul(frame.image.columns.len());
        within(cells, sections.limits().points, "cells of the range image")?;
        frame.fit_image(scanner.rows());
        let reference = self.reference(scanner, frame)?;
        let modelling = frame.parameters.modelling().parts().occupancy;
        if modelling == OccupancyModelling::Tokens {
            self.quick.code_occupancy(sections, frame)?;
        } else {
            let model = self.occupancy.get_or_insert_default();
            model.set_quick(modelling == OccupancyModelling::Light);
            sections.section(SectionKind::Occupancy, true, |coder| {
                model.code(coder, reference.as_ref(), &mut frame.occupancy);
                Ok(())
            })?;
        }
        frame.cells = frame.occupancy.places();
        if frame.cells.len() != returns {
            return Err(Error::corrupt("the range image holds another number of returns than the frame"));
        }
        Ok(reference)
    }

    /// The reference, if the frame is predicted from the one before.
    fn reference(&self, scanner: &Scanner, frame: &Frame) -> Result<Option<Reference>> {
        if frame.parameters.prediction != Prediction::Inter {
            return Ok(None);
        }
        let past = self.past.as_ref();
        let past = past.ok_or_else(|| Error::corrupt("there is no frame before to predict this one from"))?;
        within(frame.occupancy.cells().len(), inter::MOST_CELLS as u64, "cells of a P frame")?;
        let motion = frame.parameters.motion;
        if frame.parameters.can_do_without_surfaces() && motion == QuantisedPose::default() {
            return Ok(Some(past.same_cells_alone(&frame.image.columns)));
        }
        let motion = motion.pose().motion();
        let scanner =
            scanner.hdl64().ok_or_else(|| Error::corrupt("a P frame of a scanner that has none"))?;
        Ok(Some(past.reference(scanner, &frame.image.columns, &motion)))
    }

    /// The frame before, if it has a range image.
    pub(crate) fn past(&self) -> Option<&Past> {
        self.past.as_deref()
    }

    /// The intensities, if the frame has any and keeps them. Returns those of the returns as contexts for the
    /// ranges.
    fn code_intensities<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        frame: &mut Frame,
        reference: Option<&Reference>,
    ) -> Result<Grid<u16>> {
        let coded = frame.layout.intensity.is_some() && frame.parameters.intensity != Intensity::None;
        if !coded {
            let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
            frame.intensity = Grid::new(rows, columns);
            frame.stray_intensity = vec![0.0; frame.strays];
            return Ok(Grid::new(rows, columns));
        }
        // Tokens need no contexts.
        let is_deep = match frame.parameters.modelling().parts().intensity {
            IntensityModelling::Light => false,
            IntensityModelling::Deep => true,
            IntensityModelling::Tokens => {
                return self.quick.code_intensities(sections, frame).map(|()| Grid::default());
            }
            IntensityModelling::Packed => {
                return self.quick.code_packed_intensities(sections, frame).map(|()| Grid::default());
            }
        };
        let level = sections.effort().level;
        sections.section(SectionKind::Intensity, true, |coder| {
            let mut scale = if S::ENCODES { frame.intensity_scale() } else { IntensityScale::default() };
            scale.code(|value, bits| coder.code_plain(u64::from(value), bits) as u32);
            if !scale.is_on_grid() {
                return self.code_rough_intensity(coder, frame, level);
            }
            let model = self.intensity.get_or_insert_default();
            model.set_deep(is_deep);
            Ok(code_intensity(model, coder, frame, scale, reference))
        })
    }

    /// Intensities on a grid that the models of intensities do not know, coded as a channel of the returns
    /// and strays. Returns no contexts for the ranges.
    fn code_rough_intensity<C: BitCoder>(
        &mut self,
        coder: &mut C,
        frame: &mut Frame,
        level: Level,
    ) -> Result<Grid<u16>> {
        let returns = frame.cells.len();
        let width = frame.occupancy.columns() as u32;
        let strays = || std::iter::repeat_n(0, frame.strays);
        let beside = Beside {
            rows: frame.cells.iter().map(|cell| cell / width + 1).chain(strays()).collect(),
            columns: frame.cells.iter().map(|cell| cell % width + 1).chain(strays()).collect(),
            ..Beside::default()
        };
        let mut values = if C::ENCODES { frame.intensity.at(&frame.cells) } else { vec![0.0; returns] };
        values.append(&mut frame.stray_intensity);
        values.resize(frame.records, 0.0);
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut channels = [Channel { field: Field::new("intensity", Scalar::F32), bytes }];
        self.rough_intensity.code(coder, &mut channels, &beside, level)?;
        let [Channel { bytes, .. }] = channels;
        let mut values: Vec<f32> = bytes.chunks_exact(4).map(LittleEndian::read_f32).collect();
        frame.stray_intensity = values.split_off(returns);
        frame.intensity.fill(&frame.cells, &values);
        let mut levels = Grid::new(frame.occupancy.rows(), frame.occupancy.columns());
        levels.cells_mut().fill(1);
        Ok(levels)
    }

    /// The positions of the returns: those of the formula, corrected as far as necessary.
    fn code_positions<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut Frame,
        found: &[Return],
    ) -> Result<()> {
        let grid = scanner.coordinates();
        let offset_m = frame.parameters.range_coder.offset_m(scanner);
        let formula = |found: &Return| scanner.position(found, offset_m);
        let (max_error, on_grid) = match frame.parameters.positions {
            Positions::Formula => {
                frame.positions = scanner.positions(found, offset_m, false);
                return Ok(());
            }
            Positions::Exact => (None, true),
            Positions::Bounded { max_error_um, on_grid } => (Some(f64::from(max_error_um) * 1e-6), on_grid),
        };
        let as_tokens = match frame.parameters.modelling().parts().correction {
            CorrectionModelling::Adaptive => false,
            CorrectionModelling::Light => grid == Coordinates::Millimetre,
            CorrectionModelling::Tokens => true,
        };
        if as_tokens {
            let near = scanner.positions(found, offset_m, on_grid);
            let formula = |point: usize| formula(&found[point]);
            return self.quick.code_positions(sections, grid, formula, (near, max_error), frame);
        }
        frame.positions.resize(found.len(), [0.0; 3]);
        sections.section(SectionKind::Correction, true, |coder| {
            let points = found.iter().zip(&mut frame.positions);
            match max_error {
                None => points.for_each(|(found, position)| {
                    self.correction.code(coder, grid, formula(found), position);
                }),
                Some(max_error) => {
                    let near = scanner.positions(found, offset_m, on_grid);
                    points.zip(near).for_each(|((found, position), near)| {
                        self.correction.code_bounded(
                            coder,
                            grid,
                            formula(found),
                            (near, max_error),
                            position,
                        );
                    });
                }
            }
            Ok(())
        })
    }

    /// The order of the points in the file: that of the range image, except for the exceptions coded here.
    fn code_order<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        frame: &mut Frame,
        returns: usize,
    ) -> Result<()> {
        if returns == 0 || frame.parameters.positions == Positions::Formula {
            frame.order.stray_places = (returns as u64..frame.records as u64).collect();
            return Ok(());
        }
        sections.section(SectionKind::Order, true, |coder| {
            self.order.code(coder, &mut frame.order, returns, frame.strays)
        })
    }

    /// The layout of the file, and the bytes around the records.
    fn code_file<C: BitCoder>(&mut self, coder: &mut C, frame: &mut Frame, limits: &Limits) -> Result<()> {
        self.code_layout(coder, &mut frame.layout, limits)?;
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

    /// The layout; empty if it is that of the frame before.
    fn code_layout<C: BitCoder>(
        &mut self,
        coder: &mut C,
        layout: &mut Layout,
        limits: &Limits,
    ) -> Result<()> {
        let mut bytes = Vec::new();
        if C::ENCODES && self.layout.as_ref() != Some(layout) {
            layout.write_to(&mut bytes);
        }
        self.code_bytes(coder, &mut bytes, limits)?;
        if bytes.is_empty() {
            let before = self.layout.as_ref();
            layout.clone_from(before.ok_or_else(|| Error::corrupt("record layout: there is none before"))?);
            return Ok(());
        }
        let mut rest = bytes.as_slice();
        *layout = Layout::read_from(&mut rest)?;
        if !rest.is_empty() {
            return Err(Error::corrupt("record layout: bytes left over"));
        }
        self.layout = Some(layout.clone());
        Ok(())
    }

    fn code_bytes<C: BitCoder>(&mut self, coder: &mut C, bytes: &mut Vec<u8>, limits: &Limits) -> Result<()> {
        let length = self.sizes.code(coder, bytes.len() as u64) as usize;
        within(length, limits.file_bytes, "bytes of the frame")?;
        if length as u64 > coder.most_bits() / 8 {
            return Err(Error::corrupt("more bytes than the section can hold"));
        }
        bytes.resize(length, 0);
        self.bytes.code(coder, 1, bytes);
        Ok(())
    }
}

/// The intensities of the returns, then of the strays. Returns those of the returns as contexts for the
/// ranges.
fn code_intensity<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    frame: &mut Frame,
    scale: IntensityScale,
    reference: Option<&Reference>,
) -> Grid<u16> {
    let width = frame.occupancy.columns();
    let mut levels = Grid::new(frame.occupancy.rows(), width);
    model.start_frame(&scale, width, frame.records - frame.strays);
    for row in 0..levels.rows() {
        if coder.is_exhausted() {
            break;
        }
        model.start_row();
        let mut left = [0; 4];
        for column in (0..width).filter(|&column| frame.occupancy[(row, column)]) {
            let mut near = neighbours(&levels, left, row, column);
            near.back = reference.and_then(|reference| IntensityReference::at(reference, (row, column)));
            let value = &mut frame.intensity[(row, column)];
            *value = model.code(coder, &scale, &near, (row, column), *value);
            levels[(row, column)] = scale.context_level(*value);
            left = [levels[(row, column)], left[0], left[1], left[2]];
        }
    }
    code_stray_intensity(model, coder, &scale, frame);
    levels
}

fn code_stray_intensity<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    scale: &IntensityScale,
    frame: &mut Frame,
) {
    frame.stray_intensity.resize(frame.strays, 0.0);
    let north = neighbours_above(&frame.stray_positions);
    let mut levels: Vec<u16> = Vec::with_capacity(frame.strays);
    model.start_frame(scale, 1, frame.strays);
    for index in 0..frame.strays {
        if coder.is_exhausted() {
            return;
        }
        let at = |index: Option<usize>| index.and_then(|i| levels.get(i)).copied().unwrap_or(0);
        let above = |offset: isize| {
            at(north.get(index).copied().flatten().and_then(|i| i.checked_add_signed(offset)))
        };
        let near = IntensityNeighbours {
            left: [1, 2, 3, 4].map(|distance| at(index.checked_sub(distance))),
            above: [-2, -1, 0, 1, 2].map(above),
            above2: [0; 3],
            back: None,
        };
        let value = &mut frame.stray_intensity[index];
        *value = model.code(coder, scale, &near, (0, 0), *value);
        levels.push(scale.context_level(*value));
    }
}

/// How the frame is coded.
fn code_parameters<S: SectionCoder>(sections: &mut S, frame: &mut Frame) -> Result<()> {
    let mut payload = frame.parameters.to_payload();
    sections.payload(SectionKind::Parameters, &mut payload);
    frame.parameters = FrameParameters::from_payload(&payload)?;
    Ok(())
}

/// The frame as the bytes of its file, if it is coded that way; then nothing else follows.
fn code_whole<S: SectionCoder>(sections: &mut S, frame: &mut Frame) -> Result<bool> {
    let mut payload = frame.whole.as_ref().map_or_else(Vec::new, |whole| whole.payload().to_vec());
    sections.payload(SectionKind::Bytes, &mut payload);
    if !S::ENCODES && !payload.is_empty() {
        frame.whole = Some(WholeFile::from_payload(&payload, sections.limits())?);
    }
    Ok(!payload.is_empty())
}

/// How the points were moved after they were measured.
fn code_compensation<S: SectionCoder>(sections: &mut S, frame: &mut Frame) -> Result<()> {
    frame.find_misses()?;
    let mut payload = Vec::new();
    frame.compensation.iter().for_each(|compensation| compensation.write_to(&mut payload));
    sections.payload(SectionKind::Compensation, &mut payload);
    if !payload.is_empty() {
        frame.compensation = Some(Compensation::from_payload(&payload, frame.records)?);
    }
    Ok(())
}

impl Frame {
    /// Resizes the decoder's channels for their values.
    fn fit_channels(&mut self) {
        if self.channels.is_empty() {
            let sized = |field: &Field| Channel {
                field: field.clone(),
                bytes: vec![0; self.records.saturating_mul(field.width())],
            };
            self.channels = self.layout.channels().map(|(_, field)| sized(field)).collect();
        }
    }

    /// Resizes the decoder's grids to the size of the image.
    fn fit_image(&mut self, rows: usize) {
        let columns = self.image.columns.len();
        if self.occupancy.rows() != rows || self.occupancy.columns() != columns {
            self.occupancy = Grid::new(rows, columns);
            self.image.steps = Grid::new(rows, columns);
            self.intensity = Grid::new(rows, columns);
        }
    }
}

/// The intensity levels around a cell.
fn neighbours(levels: &Grid<u16>, left: [u16; 4], row: usize, column: usize) -> IntensityNeighbours {
    let at =
        |rows_up: usize, offset: isize| match (row.checked_sub(rows_up), column.checked_add_signed(offset)) {
            (Some(row), Some(column)) if column < levels.columns() => levels[(row, column)],
            _ => 0,
        };
    IntensityNeighbours {
        left,
        above: [-2, -1, 0, 1, 2].map(|offset| at(1, offset)),
        above2: [-1, 0, 1].map(|offset| at(2, offset)),
        back: None,
    }
}

fn within(got: usize, max: u64, what: &'static str) -> Result<()> {
    if got as u64 > max {
        Err(Error::LimitExceeded { what: what.to_owned(), got: got as u64, max })
    } else {
        Ok(())
    }
}
