//! The ranges as tokens: prediction errors (misses), whose contexts are how rough the surroundings are and
//! how large the misses around were.

mod prediction;
mod start;

pub use prediction::RANGE_CONTEXTS;
pub use start::start_tables;

use crate::entropy::TokenCoder;
use crate::ground::grid::Grid;
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::Bins;
use prediction::{Before, Fits, Guess, Near};

/// The range assumed where nothing is known, in steps.
const TYPICAL_RANGE: i32 = 3000;
/// The miss assumed at the start of a row, in steps.
const TYPICAL_MISS: i32 = 20;
/// Misses count as at most this many steps.
const MOST_MISS: i32 = 300;
/// No range is farther from a prediction, in bins.
const MOST_BINS: i64 = 1 << 25;

/// What the coder has learned about ranges, besides the tables.
#[derive(Clone, Default)]
pub struct RangeTokens {
    fits: Fits,
}

impl RangeTokens {
    /// Codes the range, in steps, of every cell that holds a return: the number of its bin, of `bin` steps
    /// around the prediction. This is the left neighbour or, if `fitted`, by least squares from the
    /// neighbours and, where there is one, from the frame before (`expected`; 0 = nothing). Ranges are from 1
    /// to 2^`range_bits` - 1; if bins are wider than a step, both sides continue with the middles of the
    /// bins.
    pub fn code<C: TokenCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        (fitted, expected): (bool, Option<&Grid<u32>>),
        axis: (u32, u32),
        steps: &mut Grid<u32>,
    ) {
        let fits = &mut self.fits;
        match (fitted, expected, axis) {
            // Compiled apart for bins of one step, which need no division, and without a frame before.
            (true, None, (bits, 1)) => {
                code_rows::<C, true>(coder, fits, (occupancy, None), (bits, 1), steps);
            }
            (true, ..) => code_rows::<C, true>(coder, fits, (occupancy, expected), axis, steps),
            (false, _, (bits, 1)) => {
                code_rows::<C, false>(coder, fits, (occupancy, None), (bits, 1), steps);
            }
            (false, ..) => code_rows::<C, false>(coder, fits, (occupancy, None), axis, steps),
        }
    }
}

#[inline(always)]
fn code_rows<C: TokenCoder, const FITTED: bool>(
    coder: &mut C,
    fits: &mut Fits,
    (occupancy, expected): (&Grid<bool>, Option<&Grid<u32>>),
    (range_bits, bin): (u32, u32),
    steps: &mut Grid<u32>,
) {
    /// Columns beyond the last, so that every cell has neighbours to the right.
    const MARGIN: usize = 2;
    let width = occupancy.columns();
    // For each column: the last ranges in it, and the size of the misses there.
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
            let miss_expected = (miss_left + (*miss << 3)) as u32;
            let before = expected.and_then(|expected| Before::at(expected, (row, column), west));
            let guess = match before {
                Some(before) => Guess::from_before(&before, &near, fits, miss_expected, bin),
                None if FITTED => Guess::fitted(&near, fits, miss_expected, bin),
                None => Guess::west(&near, miss_expected, bin),
            };
            let most = (1i64 << range_bits) - 1;
            let base = (guess.from + (guess.fit + 1000.5) as i32 - 1000).clamp(1, (most - 1) as i32);
            let bins = Bins::around(i64::from(base), i64::from(bin));
            let off = zigzag(bins.of(i64::from(*range)) - bins.central);
            let off =
                unzigzag(coder.number(guess.context, off & ((1 << 48) - 1))).clamp(-MOST_BINS, MOST_BINS);
            let coded = bins.middle(bins.central + off, range_bits) as i32;
            *range = coded as u32;
            fits.learn(&guess, coded);
            if FITTED {
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
