//! The returns of the range image: their intensities, then their ranges. The upper and the lower half of a
//! large image are coded as two images with separate models, so that two threads can do it. FORMAT.md 4.4.

use std::mem::take;

use super::intensities::{Intensities, IntensityModels};
use super::ranges::RangeModels;
use crate::container::SectionKind;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use crate::inter::Reference;
use crate::scanner::Scanner;

/// The models of returns.
#[derive(Clone, Default)]
pub struct ReturnModels {
    /// The models of the whole image or of its upper half.
    first: PartModels,
    lower: PartModels,
}

#[derive(Clone, Default)]
struct PartModels {
    intensities: IntensityModels,
    ranges: RangeModels,
}

/// A range image or half of one, with the data that are known before its returns are coded.
#[derive(Clone, Copy)]
pub struct Part<'f> {
    /// The frame, whose parameters say how it is coded.
    pub frame: &'f FrameParts,
    /// Which cells hold a return.
    pub occupancy: &'f Grid<bool>,
    /// The indices of these cells, row after row.
    pub cells: &'f [u32],
    /// The prediction from the frame before.
    pub reference: Option<&'f Reference>,
    /// Number of records that are not returns, whose intensities follow.
    pub outside: usize,
}

impl ReturnModels {
    /// Codes the intensities, and the ranges if they are coded by the context coder. Returns the context
    /// levels of the intensities.
    ///
    /// # Errors
    /// If a section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        reference: Option<&Reference>,
        frame: &mut FrameParts,
    ) -> Result<Grid<u16>> {
        let (mut values, mut steps) = (frame.take_intensities(), take(&mut frame.image.steps));
        if scanner.is_some() {
            sections.report().converted += 4 * steps.cells().len() as u64;
        }
        let known = &*frame;
        let (occupancy, cells) = (&known.occupancy, known.cells.as_slice());
        let whole = Part { frame: known, occupancy, cells, reference, outside: known.outside() };
        let levels = match known.middle() {
            Some(middle) => self.code_halves(sections, (whole, middle), &mut values, &mut steps)?,
            None => self.first.code(sections, &whole, &mut values, scanner.map(|_| &mut steps))?,
        };
        frame.put_intensities(values);
        frame.image.steps = steps;
        Ok(levels)
    }

    /// Codes the upper and the lower half, in parallel if a thread is free.
    fn code_halves<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        (whole, middle): (Part, usize),
        values: &mut Intensities,
        steps: &mut Grid<u32>,
    ) -> Result<Grid<u16>> {
        let first_below = (middle * whole.occupancy.columns()) as u32;
        let (cells, cells_below) =
            whole.cells.split_at(whole.cells.partition_point(|&cell| cell < first_below));
        let cells_below: Vec<u32> = cells_below.iter().map(|&cell| cell - first_below).collect();
        let [occupancy, occupancy_below] = whole.occupancy.clone().split(middle);
        let references = whole.reference.map(|reference| reference.clone().split(middle));
        let [reference, reference_below] = [0, 1].map(|half| references.as_ref().map(|halves| &halves[half]));
        let upper = Part { occupancy: &occupancy, cells, reference, outside: 0, ..whole };
        let lower =
            Part { occupancy: &occupancy_below, cells: &cells_below, reference: reference_below, ..whole };
        let [mut upper_values, mut lower_values] = take(values).split(middle);
        let [mut upper_steps, mut lower_steps] = take(steps).split(middle);
        let (upper_levels, lower_levels) = sections.both(
            SectionKind::Range,
            |sections| self.first.code(sections, &upper, &mut upper_values, Some(&mut upper_steps)),
            |sections| self.lower.code(sections, &lower, &mut lower_values, Some(&mut lower_steps)),
        )?;
        *values = Intensities::joined([upper_values, lower_values]);
        *steps = Grid::joined([upper_steps, lower_steps]);
        Ok(Grid::joined([upper_levels, lower_levels]))
    }
}

impl PartModels {
    /// Codes one part. Returns the context levels of the intensities.
    fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        part: &Part,
        values: &mut Intensities,
        steps: Option<&mut Grid<u32>>,
    ) -> Result<Grid<u16>> {
        let levels = self.intensities.code(sections, part, values)?;
        if let Some(steps) = steps {
            self.ranges.code(sections, &levels, part, steps)?;
        }
        Ok(levels)
    }
}
