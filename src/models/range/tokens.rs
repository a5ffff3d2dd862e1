//! The ranges as tokens: prediction errors (misses) in contexts of the roughness of the surroundings and of
//! the size of the surrounding misses. FORMAT.md 8.16.

mod prediction;
mod start;

pub use prediction::RANGE_CONTEXTS;
pub use start::start_tables;

use pulp::NullaryFnOnce;

use crate::entropy::TokenCoder;
use crate::ground::grid::Grid;
use crate::ground::lanes::dispatch;
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::RangeScale;
use crate::models::range::TYPICAL_RANGE;
use crate::models::range::residuals::{Classes, Residuals, Rows};
use prediction::{Before, Fits, Guess, Near, within_reach};

/// The miss assumed at the start of a row, in steps.
const TYPICAL_MISS: i32 = 20;
/// Misses count as at most this many steps.
const MOST_MISS: i32 = 300;
/// A bound above the distance of any range from its prediction, in bins.
const MOST_BINS: i64 = 1 << 25;

/// The adaptive models of ranges, besides the tables.
#[derive(Clone, Default)]
pub struct RangeTokens {
    fits: Fits,
    residuals: Residuals,
}

impl RangeTokens {
    /// Codes the range, in steps, of every cell that holds a return: the number of its bin among bins that
    /// are centred on the prediction. If bins are wider than a step, both sides continue with the middles of
    /// the bins.
    pub fn code<C: TokenCoder>(
        &mut self,
        coder: &mut C,
        known: &KnownCells,
        scale: RangeScale,
        steps: &mut Grid<u32>,
    ) {
        let work = CodeRows::<C, false, false> { model: self, coder, known, scale, steps };
        match (known.fitted, scale.bin == 1 && (known.expected.is_none() || !known.fitted)) {
            (true, true) => dispatch(work.compiled_for::<true, true>()),
            (true, false) => dispatch(work.compiled_for::<true, false>()),
            (false, true) => dispatch(work.compiled_for::<false, true>()),
            (false, false) => dispatch(work),
        }
    }
}

/// The data known for all cells before their ranges are coded.
pub struct KnownCells<'a> {
    /// Which cells hold a return.
    pub occupancy: &'a Grid<bool>,
    /// Whether ranges are predicted by least squares from the neighbours and, if there is one, from the frame
    /// before; otherwise the left neighbour is the prediction.
    pub fitted: bool,
    /// The ranges of the frame before, in steps; 0 = nothing.
    pub expected: Option<&'a Grid<u32>>,
    /// The context levels of the intensities, 1 to 128; 0 = none.
    pub levels: &'a Grid<u16>,
}

/// The ranges of a frame. `SIMPLE`: bins are one step wide, so no division is needed, and there is no frame
/// before.
struct CodeRows<'a, C, const FITTED: bool, const SIMPLE: bool> {
    model: &'a mut RangeTokens,
    coder: &'a mut C,
    known: &'a KnownCells<'a>,
    scale: RangeScale,
    steps: &'a mut Grid<u32>,
}

impl<'a, C> CodeRows<'a, C, false, false> {
    fn compiled_for<const FITTED: bool, const SIMPLE: bool>(self) -> CodeRows<'a, C, FITTED, SIMPLE> {
        let CodeRows { model, coder, known, scale, steps } = self;
        CodeRows { model, coder, known, scale, steps }
    }
}

impl<C: TokenCoder, const FITTED: bool, const SIMPLE: bool> NullaryFnOnce
    for CodeRows<'_, C, FITTED, SIMPLE>
{
    type Output = ();

    #[inline(always)]
    fn call(self) {
        /// Columns beyond the last, so that every cell has neighbours to the right.
        const MARGIN: usize = 2;
        let CodeRows { model: RangeTokens { fits, residuals }, coder, known, scale, steps } = self;
        let KnownCells { occupancy, expected, levels, .. } = *known;
        let (bin, expected) = if SIMPLE { (1, None) } else { (scale.bin, expected) };
        let scale = RangeScale { bin, ..scale };
        let width = occupancy.columns();
        // For each column: the last ranges, and the size of the misses.
        let mut ranges = vec![i32::from(TYPICAL_RANGE); width + MARGIN];
        let mut ranges2 = vec![i32::from(TYPICAL_RANGE); if FITTED { width } else { 0 }];
        let mut misses = vec![TYPICAL_MISS; width + MARGIN];
        let mut rows = Rows::new(if FITTED { width } else { 0 });
        for row in 0..occupancy.rows() {
            if coder.is_exhausted() {
                return;
            }
            let mut left: Option<[i32; 4]> = None;
            let mut miss_left = TYPICAL_MISS << 4;
            let mut north_west = ranges[0];
            rows.start_row();
            let levels = levels.row(row);
            let cells = occupancy.row(row).iter().zip(steps.row_mut(row)).enumerate();
            for (column, (_, range)) in cells.filter(|(_, (filled, _))| **filled) {
                let [north, north_east, north_east2] =
                    [ranges[column], ranges[column + 1], ranges[column + 2]];
                let [west, west2, west3, west4] = left.unwrap_or([north; 4]);
                let north2 = if FITTED { ranges2[column] } else { north };
                let near =
                    Near { west, west2, west3, west4, north, north_west, north_east, north_east2, north2 };
                let (most, least) = ((1i64 << scale.bits) - 2, 1);
                let miss_above =
                    if FITTED { (3 * misses[column] + 2 * misses[column + 1]) / 5 } else { misses[column] };
                let miss_around = miss_left + (miss_above << 3);
                let hint = FITTED.then(|| residuals.hint(&rows, column, Classes::of(levels, column)));
                let before = expected.and_then(|expected| Before::at(expected, (row, column), west));
                let guess = match (&hint, before) {
                    (None, _) => Guess::west(&near, miss_around as u32, bin),
                    (Some(hint), before) => {
                        let expected = residuals.expected_miss(hint, miss_around);
                        match before {
                            Some(before) => Guess::from_before(&before, &near, fits, expected, bin),
                            None => Guess::fitted(&near, fits, expected, bin),
                        }
                    }
                };
                let offset = hint.as_ref().map_or(0.0, |hint| hint.offset);
                let fit = within_reach(guess.fit + offset);
                let base = i64::from(guess.from + (fit + 1000.5) as i32 - 1000).clamp(least, most) as i32;
                let bins = scale.bins_around(i64::from(base));
                let off = zigzag(bins.of(i64::from(*range)) - bins.central);
                let off =
                    unzigzag(coder.number(guess.context, off & ((1 << 48) - 1))).clamp(-MOST_BINS, MOST_BINS);
                let coded = bins.middle(bins.central + off, scale.bits) as i32;
                *range = coded as u32;
                fits.learn(&guess, coded);
                let off = (coded - base).abs().min(MOST_MISS);
                if let Some(hint) = &hint {
                    let residual = (coded - guess.from) as f32 - guess.fit;
                    residuals.learn_noise(hint, off, miss_around);
                    residuals.learn(&mut rows, column, hint, residual);
                    ranges2[column] = north;
                }
                miss_left = (5 * miss_left + 3 * (off << 4)) >> 3;
                misses[column] = (misses[column] + off) >> 1;
                left = Some([coded, west, west2, west3]);
                north_west = north;
                ranges[column] = coded;
            }
        }
    }
}
