//! The prediction of a range, and the context of its miss. FORMAT.md 8.16, "Fitted tokens of ranges".

use std::array::from_fn;

use super::MOST_MISS;
use crate::ground::grid::Grid;
use crate::models::LeastSquares;
use crate::models::quantise::magnitude_level;
use crate::models::range::{EDGE, EDGES, FEATURE_REACH, FIT_REACH, LONG_MEMORY};

/// Classes of the expected miss, if the left neighbour is the prediction.
pub const MISS_LEVELS: usize = 40;
/// Classes of the expected miss and of the surrounding roughness, for least squares.
const FITTED_MISS_LEVELS: usize = 16;
const ACTIVITY_LEVELS: usize = 6;
/// Number of contexts of a range.
pub const RANGE_CONTEXTS: usize = FITTED_MISS_LEVELS * ACTIVITY_LEVELS;
/// Number of features from the neighbours alone, and with the frame before.
const FEATURES: usize = 8;
const REFERRING_FEATURES: usize = 16;

/// A prediction in steps from what it is relative to, limited to [`FIT_REACH`].
#[inline(always)]
pub fn within_reach(steps: f32) -> f32 {
    steps.clamp(-f32::from(FIT_REACH), FIT_REACH.into())
}

/// The least-squares fits.
#[derive(Clone)]
pub struct Fits {
    /// From the neighbours alone, and with the frame before: one fit for each kind of edge.
    near: [LeastSquares<FEATURES>; EDGES],
    before: [LeastSquares<REFERRING_FEATURES>; EDGES],
}

impl Default for Fits {
    fn default() -> Self {
        Fits {
            near: from_fn(|_| LeastSquares::new(LONG_MEMORY)),
            before: from_fn(|_| LeastSquares::new(LONG_MEMORY)),
        }
    }
}

impl Fits {
    /// Learns from the range for which this guess was made, in steps.
    #[inline(always)]
    pub fn learn(&mut self, guess: &Guess, range: i32) {
        let off = (range - guess.from) as f32;
        let error = off - guess.fit;
        let (target, weight) = (within_reach(off), 1.0 / (25.0 + error * error));
        match &guess.by {
            By::West => {}
            By::Fit { edge, features } => self.near[*edge].learn(features, target, weight),
            By::Before { edge, features } => self.before[*edge].learn(features, target, weight),
        }
    }
}

/// The ranges coded before a cell, in steps, with missing ones replaced by the next best.
pub struct Near {
    pub west: i32,
    pub west2: i32,
    pub west3: i32,
    pub west4: i32,
    pub north: i32,
    pub north_west: i32,
    pub north_east: i32,
    pub north_east2: i32,
    pub north2: i32,
}

/// The prediction of a cell and its surroundings from the frame before, in steps; 0 = none.
pub struct Before {
    here: i32,
    west: i32,
    north: i32,
    west2: i32,
    east: i32,
    south: i32,
    south_east: i32,
    north_east: i32,
}

impl Before {
    /// The prediction for a cell whose left neighbour has the range `west`; `None` if the frame before has no
    /// return there, or a different surface to the left of it.
    #[inline(always)]
    pub fn at(expected: &Grid<u32>, cell: (usize, usize), west: i32) -> Option<Self> {
        let at = |down, right| expected.beside(cell, down, right) as i32;
        let (here, west_before) = (at(0, 0), at(0, -1));
        let is_as_before = here > 0 && west_before > 0 && (west - west_before).abs() <= EDGE.into();
        is_as_before.then(|| Before {
            here,
            west: west_before,
            north: at(-1, 0),
            west2: at(0, -2),
            east: at(0, 1),
            south: at(1, 0),
            south_east: at(1, 1),
            north_east: at(-1, 1),
        })
    }
}

/// The prediction of a range.
pub struct Guess {
    /// The base of the prediction, in steps, and the offset from it.
    pub from: i32,
    pub fit: f32,
    /// The context of the miss.
    pub context: usize,
    by: By,
}

/// How the guess was made.
enum By {
    West,
    Fit { edge: usize, features: [f32; FEATURES] },
    Before { edge: usize, features: [f32; REFERRING_FEATURES] },
}

impl Guess {
    /// Predicts from the left neighbour. `expected` is the expected miss, in sixteenths of a step.
    #[inline(always)]
    pub fn west(near: &Near, expected: u32, bin: u32) -> Self {
        let expected = expected + 5 * near.activity().min(4 * MOST_MISS as u32);
        let context = magnitude_level(expected / bin >> 3, MISS_LEVELS);
        Guess { from: near.west, fit: 0.0, context, by: By::West }
    }

    /// Predicts by least squares from the neighbours.
    #[inline(always)]
    pub fn fitted(near: &Near, fits: &Fits, expected: u32, bin: u32) -> Self {
        let features = [
            near.west2,
            near.west3,
            near.west4,
            near.north,
            near.north_west,
            near.north_east,
            near.north_east2,
            near.north2,
        ]
        .map(|range| feature(range, near.west));
        let edge = near.edge();
        let fit = within_reach(fits.near[edge].predict(&features));
        let context = near.context(expected, bin);
        Guess { from: near.west, fit, context, by: By::Fit { edge, features } }
    }

    /// Predicts by least squares from the frame before and the neighbours.
    #[inline(always)]
    pub fn from_before(before: &Before, near: &Near, fits: &Fits, expected: u32, bin: u32) -> Self {
        let or_here = |range: i32| if range > 0 { range } else { before.here };
        let features = [
            near.west,
            near.west2,
            near.north,
            near.north_west,
            near.north_east,
            near.north2,
            near.west3,
            near.west4,
            near.north_east2,
            or_here(before.north_east),
            before.west,
            or_here(before.west2),
            or_here(before.north),
            or_here(before.east),
            or_here(before.south),
            or_here(before.south_east),
        ]
        .map(|range| feature(range, before.here));
        let edge = near.edge();
        let fit = within_reach(fits.before[edge].predict(&features));
        let context = near.context(expected, bin);
        Guess { from: before.here, fit, context, by: By::Before { edge, features } }
    }
}

impl Near {
    /// The roughness around the cell, in steps.
    #[inline(always)]
    fn activity(&self) -> u32 {
        let Near { west, west2, north, north_west, north_east, .. } = self;
        ((west - west2).abs() + (north - north_west).abs() + (north - north_east).abs()) as u32
    }

    /// The kind of edge.
    #[inline(always)]
    fn edge(&self) -> usize {
        let from_west = |range| feature(range, self.west);
        usize::from((self.west2 - self.west).abs() > EDGE.into())
            + 2 * usize::from((from_west(self.north) - from_west(self.north_west)).abs() > EDGE.into())
    }

    /// The context for least squares.
    #[inline(always)]
    fn context(&self, expected: u32, bin: u32) -> usize {
        let activity = ((1 + self.activity() / bin).ilog2() as usize / 2).min(ACTIVITY_LEVELS - 1);
        miss_level(expected / bin) * ACTIVITY_LEVELS + activity
    }
}

#[inline(always)]
fn feature(range: i32, from: i32) -> f32 {
    (range - from).clamp(-i32::from(FEATURE_REACH), FEATURE_REACH.into()) as f32
}

/// The least miss, in sixteenths of a bin, that the given context of least squares expects.
pub fn least_miss_of(context: usize) -> f64 {
    /// The cube root of 4.
    const STEP: f64 = 1.587_401;
    (0..context / ACTIVITY_LEVELS).fold(5.657, |miss, _| miss * STEP)
}

/// The class of an expected miss, in sixteenths of a bin: three classes for two octaves, from 2^2.5 on.
#[inline(always)]
fn miss_level(expected: u32) -> usize {
    /// 2^15 / 2^7.5.
    const START: u64 = 181;
    let expected = u64::from(expected.min(1 << 15));
    let cube = expected * expected * expected * START >> 15;
    ((cube | 1).ilog2() as usize / 2).min(FITTED_MISS_LEVELS - 1)
}
