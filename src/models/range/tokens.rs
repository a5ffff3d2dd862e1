//! The ranges as tokens: prediction errors (misses) in contexts of the roughness of the surroundings and of
//! the size of the surrounding misses. FORMAT.md 8.16.
//!
//! Before any miss has occurred, their distribution is assumed, so that small scans need not transmit tables:
//! a bell with long tails, as wide as the miss that the context expects.

use std::array::from_fn;
use std::sync::LazyLock;

use pulp::NullaryFnOnce;

use super::residuals::{Classes, Residuals, Rows};
use super::{EDGE, EDGES, FEATURE_REACH, FIT_REACH, LONG_MEMORY, TYPICAL_RANGE};
use crate::entropy::{Counts, StartTables, TokenCoder, numbers_of_token};
use crate::ground::grid::Grid;
use crate::ground::lanes::dispatch;
use crate::ground::varint::{unzigzag, zigzag};
use crate::models::quantise::{magnitude_level, magnitude_of_level};
use crate::models::{LeastSquares, RangeScale};

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

/// Classes of the expected miss, if the left neighbour is the prediction.
const MISS_LEVELS: usize = 40;
/// Classes of the expected miss and of the surrounding roughness, for least squares.
const FITTED_MISS_LEVELS: usize = 16;
const ACTIVITY_CLASSES: usize = 6;
/// Number of contexts of a range.
pub const RANGE_CONTEXTS: usize = FITTED_MISS_LEVELS * ACTIVITY_CLASSES;
/// Number of features from the neighbours alone, and with the frame before.
const FEATURES: usize = 8;
const REFERRING_FEATURES: usize = 16;

/// A prediction in steps from what it is relative to, limited to [`FIT_REACH`].
#[inline(always)]
fn within_reach(steps: f32) -> f32 {
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
        let activity = ((1 + self.activity() / bin).ilog2() as usize / 2).min(ACTIVITY_CLASSES - 1);
        miss_level(expected / bin) * ACTIVITY_CLASSES + activity
    }
}

#[inline(always)]
fn feature(range: i32, from: i32) -> f32 {
    (range - from).clamp(-i32::from(FEATURE_REACH), FEATURE_REACH.into()) as f32
}

/// The least miss, in sixteenths of a bin, that the given context of least squares expects.
fn least_miss_of(context: usize) -> f64 {
    /// The cube root of 4.
    const STEP: f64 = 1.587_401;
    (0..context / ACTIVITY_CLASSES).fold(5.657, |miss, _| miss * STEP)
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

/// Numbers from this on are escaped until one has occurred.
const FARTHEST: u64 = 1 << 18;
/// Number of points at which the density is evaluated for a token of many numbers.
const POINTS: u64 = 4;
/// The approximate sum of the counts of a context.
const SUM: f64 = 4096.0;

/// The tables of typical token counts, by context: for ranges predicted by least squares if `fitted`,
/// otherwise from their left neighbours.
pub fn start_tables(fitted: bool) -> &'static StartTables {
    static FITTED: LazyLock<StartTables> = LazyLock::new(|| {
        let width = |context| 1.5 + least_miss_of(context) / 48.0;
        StartTables::of((0..RANGE_CONTEXTS).map(|context| bell(width(context))).collect())
    });
    static WEST: LazyLock<StartTables> = LazyLock::new(|| {
        let width = |level| 2.0 + f64::from(magnitude_of_level(level)) / 9.0;
        StartTables::of((0..MISS_LEVELS).map(|level| bell(width(level))).collect())
    });
    if fitted { &FITTED } else { &WEST }
}

/// Counts of misses proportional to 1 / (1 + (miss / width)^2).
fn bell(width: f64) -> Counts {
    let at = |miss: f64| {
        let part = miss / width;
        1.0 / (1.0 + part * part)
    };
    let weight = |token: usize| match numbers_of_token(token as u8) {
        (first, _) if first >= FARTHEST => 0.0,
        (number, 1) => at(number.div_ceil(2) as f64),
        (first, numbers) => {
            let points = (0..POINTS).map(|i| at((first + numbers * (2 * i + 1) / (2 * POINTS)) as f64 / 2.0));
            points.sum::<f64>() * (numbers / POINTS) as f64
        }
    };
    let weights: [f64; 255] = std::array::from_fn(weight);
    let sum = weights.iter().sum::<f64>();
    std::array::from_fn(|token| weights.get(token).map_or(0, |weight| (SUM * weight / sum) as u32))
}
