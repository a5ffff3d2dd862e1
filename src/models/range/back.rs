//! The reference around a cell, and its recent errors. FORMAT.md 8.6, "P frames".

use super::neighbourhood::Neighbourhood;
use super::{FEATURE_REACH, REFERENCE_FEATURES, REFERENCE_LEVELS};
use crate::inter::{Layer, Reference};

/// Features of a least-squares fit that come from [`Surroundings`].
pub const SURROUNDING_FEATURES: usize = 6;
/// In steps; the error assumed at the start of a row.
const TYPICAL_ERROR: f32 = 20.0;

/// The ranges of an earlier frame for a cell, in both layers.
#[derive(Clone)]
pub struct Back {
    /// The range in the layer of the same cells, or else in the moved layer; for `moved` it is the reverse.
    pub same: f64,
    pub moved: f64,
    same_west: f64,
    same_east: f64,
    /// The recent error of the reference around here, in octaves.
    pub level: usize,
}

impl Back {
    /// The reference of a cell; `None` if no earlier frame has a return there.
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
        [self.same, self.same_west, self.same_east, self.moved].map(|range| near.feature(range))
    }
}

/// Further values of an earlier frame around a cell: ranges, with the cell's own in place of missing ones,
/// and the context levels of intensities, 0 for none.
pub struct Surroundings {
    pub moved_west: f64,
    pub moved_east: f64,
    pub moved_north: f64,
    moved_south: f64,
    same_north: f64,
    same_south: f64,
    pub same_level: u16,
    pub moved_level: u16,
}

impl Surroundings {
    /// The surroundings of a cell.
    pub fn of(reference: &Reference, back: &Back, cell: (usize, usize)) -> Self {
        let at = |layer: &Layer, down, right, other| {
            let range = f64::from(layer.steps.beside(cell, down, right));
            if range > 0.0 { range } else { other }
        };
        let moved = |down, right| at(&reference.moved, down, right, back.moved);
        let same = |down| at(&reference.same, down, 0, back.same);
        Surroundings {
            moved_west: moved(0, -1),
            moved_east: moved(0, 1),
            moved_north: moved(-1, 0),
            moved_south: moved(1, 0),
            same_north: same(-1),
            same_south: same(1),
            same_level: reference.same.levels[cell],
            moved_level: reference.moved.levels[cell],
        }
    }

    /// Differences to the left neighbour.
    pub fn features(&self, near: &Neighbourhood) -> [f32; SURROUNDING_FEATURES] {
        [
            self.moved_west,
            self.moved_east,
            self.moved_north,
            self.moved_south,
            self.same_north,
            self.same_south,
        ]
        .map(|range| near.feature(range))
    }
}

/// The errors of the reference to the left and above.
pub struct ReferenceErrors {
    mean: f32,
    above: Vec<f32>,
}

impl ReferenceErrors {
    /// Creates the errors for an image of `width` columns.
    pub fn new(width: usize) -> Self {
        ReferenceErrors { mean: TYPICAL_ERROR, above: vec![0.0; width] }
    }

    /// Starts the next row.
    pub fn start_row(&mut self) {
        self.mean = TYPICAL_ERROR;
    }

    /// The expected error, in octaves.
    fn level(&self, column: usize) -> usize {
        let error = self.mean + 0.5 * self.above[column];
        let octaves = ((error * 0.5) as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(REFERENCE_LEVELS - 1)
    }

    /// Records the error of the better of a cell's two references.
    pub fn record(&mut self, column: usize, range: f64, back: &Back) {
        let error =
            (range - back.same).abs().min((range - back.moved).abs()).min(FEATURE_REACH.into()) as f32;
        self.mean = 0.6 * self.mean + 0.4 * error;
        self.above[column] = 0.5 * self.above[column] + 0.5 * error;
    }
}
