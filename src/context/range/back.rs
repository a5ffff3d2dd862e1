//! The reference around a cell, and how well it has done.

use super::neighbourhood::Neighbourhood;
use super::{FEATURE_REACH, REFERENCE_FEATURES, REFERENCE_LEVELS};
use crate::range_image::{Layer, Reference};

/// Steps; at the start of a row.
const TYPICAL_ERROR: f32 = 20.0;

/// The ranges that an earlier frame offers for a cell that has one in either layer.
pub struct Back {
    /// The same cell's range, or else that of the moved layer; and the other way round.
    pub same: f64,
    pub moved: f64,
    same_west: f64,
    same_east: f64,
    /// How far off they have been around here, in octaves.
    pub level: usize,
}

impl Back {
    /// Of a cell; none if no earlier frame has a return there.
    pub fn at(reference: &Reference, errors: &ReferenceErrors, cell: (usize, usize)) -> Option<Self> {
        let at = |layer: &Layer, right| f64::from(layer.steps.beside(cell, 0, right));
        let or = |range: f64, other: f64| if range > 0.0 { range } else { other };
        let (same, moved) = (at(&reference.same, 0), at(&reference.moved, 0));
        if same == 0.0 && moved == 0.0 {
            return None;
        }
        let (same, moved) = (or(same, moved), or(moved, same));
        let (same_west, same_east) = (or(at(&reference.same, -1), same), or(at(&reference.same, 1), same));
        Some(Back { same, moved, same_west, same_east, level: errors.level(cell.1) })
    }

    /// Differences to the left neighbour.
    pub fn features(&self, near: &Neighbourhood) -> [f32; REFERENCE_FEATURES] {
        [self.same, self.same_west, self.same_east, self.moved]
            .map(|range| (range - near.west).clamp(-FEATURE_REACH, FEATURE_REACH) as f32)
    }
}

/// How far off the reference has been to the left and above.
pub struct ReferenceErrors {
    mean: f32,
    above: Vec<f32>,
}

impl ReferenceErrors {
    /// For an image of `width` columns.
    pub fn new(width: usize) -> Self {
        ReferenceErrors { mean: TYPICAL_ERROR, above: vec![0.0; width] }
    }

    /// Begins the next row.
    pub fn start_row(&mut self) {
        self.mean = TYPICAL_ERROR;
    }

    /// In octaves.
    fn level(&self, column: usize) -> usize {
        let error = self.mean + 0.5 * self.above[column];
        let octaves = ((error * 0.5) as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(REFERENCE_LEVELS - 1)
    }

    /// Notes the better of a cell's two references.
    pub fn record(&mut self, column: usize, range: f64, back: &Back) {
        let error = (range - back.same).abs().min((range - back.moved).abs()).min(FEATURE_REACH) as f32;
        self.mean = 0.6 * self.mean + 0.4 * error;
        self.above[column] = 0.5 * self.above[column] + 0.5 * error;
    }
}
