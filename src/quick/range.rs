//! The ranges: what a prediction misses them by, as numbers whose contexts are how rough the surroundings
//! are and how far the predictions around have missed.

use super::magnitude_level;
use crate::context::{Bins, LeastSquares};
use crate::entropy::TokenCoder;
use crate::grid::Grid;
use crate::varint::{unzigzag, zigzag};

/// Levels of the miss to expect where the left neighbour predicts.
const MISS_LEVELS: usize = 40;
/// Levels of it and of the roughness around, apart, where least squares do.
const FITTED_MISS_LEVELS: usize = 14;
const ACTIVITY_LEVELS: usize = 12;
pub const RANGE_CONTEXTS: usize = FITTED_MISS_LEVELS * ACTIVITY_LEVELS;
/// The range assumed where nothing is known, in steps.
const TYPICAL_RANGE: i32 = 3000;
/// The miss assumed at the start of a row, in steps.
const TYPICAL_MISS: i32 = 20;
/// Misses count as at most so many steps.
const MOST_MISS: i32 = 300;
/// No range is farther from a prediction, in bins.
const MOST_BINS: i64 = 1 << 25;
const FEATURES: usize = 8;
/// Kinds of edges for which the least-squares fits are kept apart.
const EDGES: usize = 4;
/// A difference of ranges, in steps, that counts as an edge.
const EDGE: f32 = 60.0;
/// Features and predictions are cut to so many steps from the left neighbour.
const FEATURE_REACH: i32 = 300;
const FIT_REACH: f32 = 400.0;

/// What has been learned about ranges, besides the tables.
#[derive(Clone)]
pub struct RangeTokens {
    /// One for each kind of edge.
    fits: [LeastSquares<FEATURES>; EDGES],
}

/// The ranges before a cell, in steps, each missing one replaced by the next best.
struct Near {
    west: i32,
    west2: i32,
    west3: i32,
    west4: i32,
    north: i32,
    north_west: i32,
    north_east: i32,
    north_east2: i32,
    north2: i32,
}

impl Default for RangeTokens {
    fn default() -> Self {
        RangeTokens { fits: std::array::from_fn(|_| LeastSquares::new(0.998)) }
    }
}

impl RangeTokens {
    /// Codes the range, in steps, of every cell that holds a return: the number of its bin, of `bin` steps
    /// around the prediction, which is the left neighbour or, `fitted`, by least squares. Ranges are from 1
    /// to 2^`range_bits` - 1; where bins are wider than a step, both sides go on with the middles of the bins.
    pub fn code<C: TokenCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        fitted: bool,
        axis: (u32, u32),
        steps: &mut Grid<u32>,
    ) {
        let fits = &mut self.fits;
        match (fitted, axis) {
            // Nothing is divided where bins are known to be of one step.
            (true, (range_bits, 1)) => code_rows::<C, true>(coder, fits, occupancy, (range_bits, 1), steps),
            (true, _) => code_rows::<C, true>(coder, fits, occupancy, axis, steps),
            (false, (range_bits, 1)) => code_rows::<C, false>(coder, fits, occupancy, (range_bits, 1), steps),
            (false, _) => code_rows::<C, false>(coder, fits, occupancy, axis, steps),
        }
    }
}

#[inline(always)]
fn code_rows<C: TokenCoder, const FITTED: bool>(
    coder: &mut C,
    fits: &mut [LeastSquares<FEATURES>; EDGES],
    occupancy: &Grid<bool>,
    (range_bits, bin): (u32, u32),
    steps: &mut Grid<u32>,
) {
    /// Columns beyond the last, so that every cell has neighbours to the right.
    const MARGIN: usize = 2;
    let width = occupancy.columns();
    // For each column: the last ranges seen in it, and how far the predictions there missed.
    let mut ranges = vec![TYPICAL_RANGE; width + MARGIN];
    let mut ranges2 = vec![TYPICAL_RANGE; if FITTED { width } else { 0 }];
    let mut misses = vec![TYPICAL_MISS; width];
    for row in 0..occupancy.rows() {
        if coder.is_exhausted() {
            return;
        }
        let mut left: Option<[i32; 4]> = None;
        let mut miss_left = TYPICAL_MISS << 4;
        let mut north_west = ranges[0];
        let cells = occupancy.row(row).iter().zip(steps.row_mut(row)).zip(&mut misses).enumerate();
        for (column, ((_, range), miss)) in cells.filter(|(_, ((filled, _), _))| **filled) {
            let [north, north_east, north_east2] = [ranges[column], ranges[column + 1], ranges[column + 2]];
            let [west, west2, west3, west4] = left.unwrap_or([north; 4]);
            let north2 = if FITTED { ranges2[column] } else { north };
            let near = Near { west, west2, west3, west4, north, north_west, north_east, north_east2, north2 };
            let activity = (west - west2).abs() + (north - north_west).abs() + (north - north_east).abs();
            let context = context::<FITTED>((miss_left + (*miss << 3)) as u32, activity as u32, bin);
            let (features, edge, fit) = if FITTED { near.fit(fits) } else { ([0.0; FEATURES], 0, 0.0) };
            let most = (1i64 << range_bits) - 1;
            let base = (west + (fit + 1000.5) as i32 - 1000).clamp(1, (most - 1) as i32);
            let bins = Bins::around(i64::from(base), i64::from(bin));
            let off = zigzag(bins.of(i64::from(*range)) - bins.central);
            let off = unzigzag(coder.number(context, off & ((1 << 48) - 1))).clamp(-MOST_BINS, MOST_BINS);
            let coded = bins.middle(bins.central + off, range_bits) as i32;
            *range = coded as u32;
            if FITTED {
                let error = (coded - west) as f32 - fit;
                let target = ((coded - west) as f32).clamp(-FIT_REACH, FIT_REACH);
                fits[edge].learn(&features, target, 1.0 / (25.0 + error * error));
                ranges2[column] = north;
            }
            let off = (coded - base).abs().min(MOST_MISS);
            miss_left = (5 * miss_left + 3 * (off << 4)) >> 3;
            *miss = (*miss + off) >> 1;
            left = Some([coded, west, west2, west3]);
            north_west = north;
            ranges[column] = coded;
        }
    }
}

/// The context of a miss to expect, in sixteenths of a step, and a roughness, in steps.
#[inline]
fn context<const FITTED: bool>(miss: u32, activity: u32, bin: u32) -> usize {
    if FITTED {
        let level = (magnitude_level(miss / bin >> 2, 2 * FITTED_MISS_LEVELS + 4) >> 1)
            .clamp(2, FITTED_MISS_LEVELS + 1)
            - 2;
        let activity = ((1 + activity / bin).ilog2() as usize).min(ACTIVITY_LEVELS - 1);
        level * ACTIVITY_LEVELS + activity
    } else {
        let expected = miss + 5 * activity.min(4 * MOST_MISS as u32);
        magnitude_level(expected / bin >> 3, MISS_LEVELS)
    }
}

impl Near {
    /// The features (differences to the left neighbour), the kind of edge, and the fit: steps from the left
    /// neighbour.
    #[inline]
    fn fit(&self, fits: &[LeastSquares<FEATURES>]) -> ([f32; FEATURES], usize, f32) {
        let features = [
            self.west2,
            self.west3,
            self.west4,
            self.north,
            self.north_west,
            self.north_east,
            self.north_east2,
            self.north2,
        ]
        .map(|range| (range - self.west).clamp(-FEATURE_REACH, FEATURE_REACH) as f32);
        let edge =
            usize::from(features[0].abs() > EDGE) + 2 * usize::from((features[3] - features[4]).abs() > EDGE);
        (features, edge, fits[edge].predict(&features).clamp(-FIT_REACH, FIT_REACH))
    }
}
