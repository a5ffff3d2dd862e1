//! The sections of frames that are coded as tokens.

use super::frame::Frame;
use super::sections::SectionCoder;
use crate::entropy::{TokenCoder, TokenTables};
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use crate::models::IntensityScale;
use crate::models::{
    CORRECTION_CONTEXTS, INTENSITY_CONTEXTS, IntensityTokens, OCCUPANCY_CONTEXTS, PACKED_INTENSITY_CONTEXTS,
    PACKED_RANGE_CONTEXTS, RANGE_CONTEXTS, RangeTokens, code_occupancy, code_packed_intensities,
    code_packed_ranges, correct_positions, start_counts,
};
use crate::scanner::Coordinates;
use crate::stream::container::SectionKind;

/// What a group's frames have taught so far: tables, and predictors of ranges.
#[derive(Clone, Default)]
pub struct QuickModels {
    occupancy: TokenTables,
    intensity: TokenTables,
    range: TokenTables,
    correction: TokenTables,
    packed_intensity: TokenTables,
    packed_range: TokenTables,
    ranges: RangeTokens,
}

impl QuickModels {
    /// Which cells of the range image hold a return.
    pub fn code_occupancy<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut Frame) -> Result<()> {
        sections.tokens(SectionKind::Occupancy, OCCUPANCY_CONTEXTS, &mut self.occupancy, |coder| {
            code_occupancy(coder, &mut frame.occupancy);
        })
    }

    /// The intensities of the returns, then of the strays.
    pub fn code_intensities<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut Frame) -> Result<()> {
        let scale = if S::ENCODES { frame.intensity_scale() } else { IntensityScale::default() };
        sections.tokens(SectionKind::Intensity, INTENSITY_CONTEXTS, &mut self.intensity, |coder| {
            code_intensities(coder, scale, frame);
        })
    }

    /// The intensities of the returns, then of the strays, in packed bits.
    pub fn code_packed_intensities<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        frame: &mut Frame,
    ) -> Result<()> {
        let scale = if S::ENCODES { frame.intensity_scale() } else { IntensityScale::default() };
        let tables = &mut self.packed_intensity;
        sections.tokens(SectionKind::Intensity, PACKED_INTENSITY_CONTEXTS, tables, |coder| {
            pack_intensities(coder, scale, frame);
        })
    }

    /// The range of each return, in packed bits.
    pub fn code_packed_ranges<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        axis: (u32, u32),
        frame: &mut Frame,
    ) -> Result<()> {
        let tables = &mut self.packed_range;
        sections.tokens(SectionKind::Range, PACKED_RANGE_CONTEXTS, tables, |coder| {
            let returns = frame.cells.len();
            let mut ranges = if S::ENCODES { frame.image.steps.at(&frame.cells) } else { vec![0; returns] };
            code_packed_ranges(coder, axis, &mut ranges);
            frame.image.steps.fill(&frame.cells, &ranges);
        })
    }

    /// The range of each return, predicted by least squares (`fitted`) or from its left neighbour; `expected`
    /// is what the frame before predicts, in steps, if anything.
    pub fn code_ranges<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        (fitted, expected): (bool, Option<&Grid<u32>>),
        axis: (u32, u32),
        frame: &mut Frame,
    ) -> Result<()> {
        self.range.start_from(start_counts(fitted), S::ENCODES);
        let model = &mut self.ranges;
        sections.tokens(SectionKind::Range, RANGE_CONTEXTS, &mut self.range, |coder| {
            model.code(coder, &frame.occupancy, (fitted, expected), axis, &mut frame.image.steps);
        })
    }

    /// The positions of the returns, given those of the formula, and `near`, those of the file where there is
    /// no correction.
    pub fn code_positions<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        grid: Coordinates,
        formula: impl Fn(usize) -> [f64; 3],
        (near, max_error): (Vec<[f32; 3]>, Option<f64>),
        frame: &mut Frame,
    ) -> Result<()> {
        let wanted = std::mem::replace(&mut frame.positions, near);
        sections.tokens(SectionKind::Correction, CORRECTION_CONTEXTS, &mut self.correction, |coder| {
            correct_positions(coder, grid, formula, (&wanted, max_error), &mut frame.positions);
        })
    }
}

fn code_intensities<C: TokenCoder>(coder: &mut C, mut scale: IntensityScale, frame: &mut Frame) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let mut model = IntensityTokens::default();
    let (rows, width) = (frame.occupancy.rows(), frame.occupancy.columns());
    // The last intensity level in each column.
    let mut above = vec![0; width];
    for row in 0..rows {
        if coder.is_exhausted() {
            return;
        }
        let mut west = 0;
        let cells = frame.occupancy.row(row).iter().zip(frame.intensity.row_mut(row)).zip(&mut above);
        for ((_, value), north) in cells.filter(|((filled, _), _)| **filled) {
            west = model.code(coder, &scale, (west, *north), value);
            *north = west;
        }
    }
    frame.stray_intensity.resize(frame.strays, 0.0);
    let mut west = 0;
    for value in &mut frame.stray_intensity {
        if coder.is_exhausted() {
            return;
        }
        west = model.code(coder, &scale, (west, 0), value);
    }
}

fn pack_intensities<C: TokenCoder>(coder: &mut C, mut scale: IntensityScale, frame: &mut Frame) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let returns = frame.cells.len();
    let mut values = if C::ENCODES { frame.intensity.at(&frame.cells) } else { vec![0.0; returns] };
    values.append(&mut frame.stray_intensity);
    values.resize(frame.records, 0.0);
    code_packed_intensities(coder, &scale, &mut values);
    frame.stray_intensity = values.split_off(returns);
    frame.intensity.fill(&frame.cells, &values);
}

impl Frame {
    /// The grid on which the intensities of the returns and strays lie.
    pub(crate) fn intensity_scale(&self) -> IntensityScale {
        let mut values = self.intensity.at(&self.cells);
        values.extend(&self.stray_intensity);
        IntensityScale::of(&values, self.parameters.intensity.levels_per_unit())
    }
}
