//! The ranges: a mixture of predictors gives each range a distribution, interval after interval is
//! halved under it, and counters in several contexts correct each half's probability.
//!
//! For a return, the predictors are its neighbours, the line through two of them, and an online
//! least-squares fit. Each has, in each context, a weight (its responsibility for the ranges so
//! far) and a scale (its mean error).

use super::least_squares::LeastSquares;
use super::quantise::{Levels, signed_level};
use super::shape::{CERTAIN, ErrorShape, Placed};
use crate::entropy::{BitCoder, Logistic, MixedBits};
use crate::grid::Grid;

/// Features of the least-squares predictor.
const FEATURES: usize = 8;
/// Predictors in the mixture.
const PREDICTORS: usize = 5;
/// Places of the least-squares predictor and of the one that stands for surprises.
const FIT: usize = 3;
const SURPRISE: usize = 4;
/// Levels of the two measures that make a context: activity around, errors around.
const ACTIVITY_LEVELS: usize = 12;
const ERROR_LEVELS: usize = 12;
const CONTEXTS: usize = ACTIVITY_LEVELS * ERROR_LEVELS;
/// Kinds of edges for which the least-squares fits are kept apart.
const EDGES: usize = 4;
/// A difference of ranges, in steps, that counts as an edge.
const EDGE: f32 = 60.0;
/// Features and predictions are cut to this many steps from the left neighbour.
const FEATURE_REACH: f64 = 300.0;
const FIT_REACH: f64 = 400.0;
/// Probability of the mixture in the unit of [`Below::mixed`]: weights are in 2^-16.
const MIXED_CERTAIN: u64 = (CERTAIN as u64) << 16;
/// All ranges together get at least this much of it, evenly.
const EVEN: u64 = MIXED_CERTAIN / 256;
/// Learning rates of the weights and the scales.
const WEIGHT_RATE: f64 = 0.02;
const SCALE_RATE: f64 = 0.02;
/// Places in the tree of decisions that keep counters of their own.
const NODES: usize = 64;
/// Halvings inside a bucket that are corrected by counters; those below are all noise.
const CORRECTED_HALVINGS: usize = 1;
/// Contexts in which counters are kept, and the opinions that are mixed: these, the mixture's and a
/// constant.
const VIEWS: usize = 4;
const OPINIONS: usize = 8;
/// Number of contexts of each view.
const VIEW_SIZES: [usize; VIEWS] = [1024, 1024, 8 * 128, 8 * 64 * 4];

/// What the coder has learned about ranges.
#[derive(Clone)]
pub struct RangeModel {
    /// Ranges are below 2 to this power.
    range_bits: u32,
    shape: ErrorShape,
    fits: Vec<LeastSquares<FEATURES>>,
    weights: Vec<[f64; PREDICTORS]>,
    /// The weights in 2^-16.
    shares: Vec<[u32; PREDICTORS]>,
    scales: Vec<[f64; PREDICTORS]>,
    bits: MixedBits<VIEWS, OPINIONS>,
    tables: &'static Logistic,
    error_levels: Levels<{ ERROR_LEVELS - 1 }>,
}

impl Default for RangeModel {
    fn default() -> Self {
        let error_levels = Levels::new(1.6, 1.6);
        let scales = |context: usize| {
            let mut scale = 3.0f64;
            for _ in 2..context % ERROR_LEVELS {
                scale *= 1.6;
            }
            let mut scales = [scale; PREDICTORS];
            scales[SURPRISE] = 500.0;
            scales
        };
        RangeModel {
            range_bits: 0,
            shape: ErrorShape::new(),
            fits: vec![LeastSquares::new(0.998); EDGES],
            weights: vec![[1.0 / PREDICTORS as f64; PREDICTORS]; CONTEXTS],
            shares: vec![[65536 / PREDICTORS as u32; PREDICTORS]; CONTEXTS],
            scales: (0..CONTEXTS).map(scales).collect(),
            bits: MixedBits::new(VIEW_SIZES.map(|size| size * NODES), NODES * ERROR_LEVELS, 0.0, 1.0, 0.004),
            tables: Logistic::tables(),
            error_levels,
        }
    }
}

impl RangeModel {
    /// Codes the range, in steps from 1 to 2^`range_bits` - 1, of every cell that holds a return.
    /// `intensity` holds the intensities coded before, cut to 1 to 128; 0 = no return.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        intensity: &Grid<u16>,
        range_bits: u32,
        steps: &mut Grid<u32>,
    ) {
        self.range_bits = range_bits;
        let width = occupancy.columns();
        let mut errors = ErrorTrack::new(width);
        let mut window = Window::new(width);
        for row in 0..occupancy.rows() {
            errors.start_row(row > 0);
            window.start_row();
            for column in 0..width {
                if !occupancy[(row, column)] {
                    errors.skip(column);
                    continue;
                }
                let near = window.around(column);
                let site = self.site(&near, errors.expected(column));
                let views = self.views(&site, &near, &errors, intensity, (row, column));
                let interval = self.code_range(coder, &site, &views, i64::from(steps[(row, column)]));
                steps[(row, column)] = interval.low as u32;
                let range = interval.low as f64;
                self.learn(&site, &near, &interval);
                errors.record(column, range - near.west - site.fit, range - site.base as f64);
                window.push(column, range);
            }
        }
    }

    /// The predictions for a cell, and its context.
    fn site(&self, near: &Neighbourhood, expected_error: f32) -> Site {
        let features = near.features();
        let edge =
            usize::from(features[0].abs() > EDGE) + 2 * usize::from((features[3] - features[4]).abs() > EDGE);
        let fit = f64::from(self.fits[edge].predict(&features)).clamp(-FIT_REACH, FIT_REACH);
        let Neighbourhood { west, west2, north, .. } = *near;
        let predictions = [west, north, 2.0 * west - west2, west + fit, west];
        let error_level = self.error_levels.of(expected_error);
        let context = near.activity_level() * ERROR_LEVELS + error_level;
        let base = ((west + fit + 0.5) as i64).clamp(1, (1 << self.range_bits) - 2);
        let scales = &self.scales[context];
        let placed = std::array::from_fn(|k| self.shape.place(predictions[k] + 0.5, scales[k]));
        Site { features, edge, fit, predictions, placed, context, error_level, base }
    }

    /// The context of each view.
    fn views(
        &self,
        site: &Site,
        near: &Neighbourhood,
        errors: &ErrorTrack,
        intensity: &Grid<u16>,
        (row, column): (usize, usize),
    ) -> [usize; VIEWS] {
        let base = site.base as f64;
        let coarse_error = site.error_level * 8 / ERROR_LEVELS;
        let pair = |a: f64, b: f64| signed_level(a as i32) * 32 + signed_level(b as i32);
        let own = intensity[(row, column)];
        let west = if column > 0 { intensity[(row, column - 1)] } else { 0 };
        let north = if row > 0 { intensity[(row - 1, column)] } else { 0 };
        let change = intensity_change(own, west) * 8 + intensity_change(own, north);
        [
            pair(near.west - base, near.north - base),
            pair(errors.west, errors.north(column)),
            usize::from(own).min(127) * 8 + coarse_error,
            (change * 4 + usize::from(own / 8).min(3)) * 8 + coarse_error,
        ]
    }

    /// Codes one range: above or below the base, then buckets of growing width away from it, then
    /// the halves of the bucket.
    fn code_range<C: BitCoder>(
        &mut self,
        coder: &mut C,
        site: &Site,
        views: &[usize; VIEWS],
        range: i64,
    ) -> Interval {
        let mut interval = Interval::whole(self.range_bits);
        let up = self.halve(coder, site, views, &mut interval, site.base, Some(0), range);

        let fine = first_bucket(self.scales[site.context][FIT]);
        let mut width = fine;
        let mut edge = site.base;
        let mut bucket = 0;
        loop {
            let next = if up { edge + width } else { edge - width };
            if next <= interval.low || next >= interval.high {
                break;
            }
            let node = 1 + bucket.min(14) * 2 + usize::from(up);
            if self.halve(coder, site, views, &mut interval, next, Some(node), range) != up {
                break;
            }
            edge = next;
            if bucket > 0 {
                width *= 2;
            }
            bucket += 1;
        }

        let mut halving = 0;
        while interval.high - interval.low > 1 {
            if halving >= CORRECTED_HALVINGS && interval.high - interval.low <= fine {
                self.halve_evenly(coder, &mut interval, range);
                continue;
            }
            let middle = (interval.low + interval.high) / 2;
            let node = 32 + halving * 8 + bucket.min(3) * 2 + usize::from(up);
            let node = (halving < CORRECTED_HALVINGS).then_some(node);
            self.halve(coder, site, views, &mut interval, middle, node, range);
            halving += 1;
        }
        interval
    }

    /// Halves an interval so short that the density falls evenly over it: the odds of its halves are
    /// then the square root of those of the interval and its last sibling.
    #[inline]
    fn halve_evenly<C: BitCoder>(&self, coder: &mut C, interval: &mut Interval, range: i64) {
        interval.odds *= 0.5;
        let middle = (interval.low + interval.high) / 2;
        if coder.code(range >= middle, self.tables.squash(interval.odds)) {
            interval.low = middle;
        } else {
            interval.high = middle;
        }
    }

    /// Codes whether the range is at `middle` or beyond, and cuts the interval to that side.
    /// With a `node`, the counters have a say.
    #[allow(clippy::too_many_arguments)]
    #[inline]
    fn halve<C: BitCoder>(
        &mut self,
        coder: &mut C,
        site: &Site,
        views: &[usize; VIEWS],
        interval: &mut Interval,
        middle: i64,
        node: Option<usize>,
        range: i64,
    ) -> bool {
        let below_middle = self.below(site, middle);
        let above = interval.below_high.mixed.saturating_sub(below_middle.mixed) | 1;
        let below = below_middle.mixed.saturating_sub(interval.below_low.mixed) | 1;
        let bit = range >= middle;
        interval.odds = self.tables.ln(above) - self.tables.ln(below);
        let bit = match node {
            None => coder.code(bit, self.tables.squash(interval.odds)),
            Some(node) => self.code_corrected(coder, site, views, node, interval.odds, bit),
        };
        if bit {
            interval.low = middle;
            interval.below_low = below_middle;
        } else {
            interval.high = middle;
            interval.below_high = below_middle;
        }
        bit
    }

    /// Codes a bit by the mixture's log odds and the counters' together.
    #[inline]
    fn code_corrected<C: BitCoder>(
        &mut self,
        coder: &mut C,
        site: &Site,
        views: &[usize; VIEWS],
        node: usize,
        odds: f32,
        bit: bool,
    ) -> bool {
        let set = node * ERROR_LEVELS + site.error_level;
        self.bits.code(coder, set, &views.map(|view| view * NODES + node), odds, bit)
    }

    /// The probability that the range is below `range`.
    #[inline]
    fn below(&self, site: &Site, range: i64) -> Below {
        let shares = &self.shares[site.context];
        let mut each = [0; PREDICTORS];
        let mut mixed = (EVEN >> self.range_bits) * range as u64;
        for k in 0..PREDICTORS {
            each[k] = self.shape.below(&site.placed[k], range);
            mixed += u64::from(shares[k]) * u64::from(each[k]);
        }
        Below { each, mixed }
    }

    /// Moves weights, scales and fits towards the range that has been coded, to which the interval
    /// has shrunk.
    fn learn(&mut self, site: &Site, near: &Neighbourhood, interval: &Interval) {
        let range = interval.low as f64;
        let weights = &mut self.weights[site.context];
        let scales = &mut self.scales[site.context];
        let likelihood: [f64; PREDICTORS] = std::array::from_fn(|k| {
            let likely = interval.below_high.each[k].saturating_sub(interval.below_low.each[k]);
            f64::from(likely) / f64::from(CERTAIN)
        });
        let total: f64 = weights.iter().zip(&likelihood).map(|(weight, p)| weight * p).sum();
        let mut sum = 0.0;
        for k in 0..PREDICTORS {
            let surprise = k == SURPRISE;
            let merit = (likelihood[k] + 1e-9) / (total + 1e-9);
            weights[k] = (weights[k] * (1.0 - WEIGHT_RATE + WEIGHT_RATE * merit)).max(0.001);
            sum += weights[k];
            let error = (range - site.predictions[k]).abs().min(if surprise { 4000.0 } else { FIT_REACH });
            let responsibility = (weights[k] * merit).min(1.0) + if surprise { 0.0 } else { 0.1 };
            scales[k] += SCALE_RATE * responsibility * (error - scales[k]);
            scales[k] = scales[k].max(if surprise { 100.0 } else { 1.5 });
        }
        let even_out = 1.0 / sum;
        for (weight, share) in weights.iter_mut().zip(&mut self.shares[site.context]) {
            *weight *= even_out;
            *share = (*weight * 65536.0) as u32;
        }

        let target = (range - near.west).clamp(-FIT_REACH, FIT_REACH);
        let error = range - near.west - site.fit;
        let weight = 1.0 / (25.0 + error * error);
        self.fits[site.edge].learn(&site.features, target as f32, weight as f32);
    }
}

/// Width of the first bucket beside the base, in steps: a power of two near 0.6 scales.
fn first_bucket(scale: f64) -> i64 {
    // 0.6 * sqrt(2): the nearest power in octaves.
    ((scale * 0.84853) as u32).checked_ilog2().map_or(1, |octave| 1 << octave)
}

/// Eight kinds of change from a neighbour's intensity; none if it holds no return.
fn intensity_change(own: u16, other: u16) -> usize {
    if other == 0 {
        return 7;
    }
    let change = i32::from(own) - i32::from(other);
    let size = match change.abs() {
        0..2 => 0,
        2..6 => 1,
        6..16 => 2,
        _ => 3,
    };
    if change < 0 && size > 0 { size + 3 } else { size }
}

/// What is left of the range axis, and the probability below its two ends.
struct Interval {
    low: i64,
    high: i64,
    below_low: Below,
    below_high: Below,
    /// The mixture's log odds of the last halves, upper against lower.
    odds: f32,
}

/// Probability that a range is below some value: each predictor's, and the mixture's.
#[derive(Clone, Copy)]
struct Below {
    each: [u32; PREDICTORS],
    mixed: u64,
}

impl Interval {
    /// All ranges.
    fn whole(range_bits: u32) -> Self {
        let below = |each, mixed| Below { each: [each; PREDICTORS], mixed };
        let certain = below(CERTAIN, MIXED_CERTAIN + EVEN);
        Interval { low: 1, high: 1 << range_bits, below_low: below(0, 0), below_high: certain, odds: 0.0 }
    }
}

/// A cell to be coded.
#[derive(Clone)]
struct Site {
    features: [f32; FEATURES],
    edge: usize,
    /// The least-squares prediction, from the left neighbour.
    fit: f64,
    predictions: [f64; PREDICTORS],
    placed: [Placed; PREDICTORS],
    context: usize,
    error_level: usize,
    /// Where the coding starts: a whole number of steps.
    base: i64,
}

/// The ranges coded so far that a cell looks at; 0 where there is no return.
#[derive(Clone)]
struct Window {
    /// The current row and the two above, with margins of empty cells.
    rows: [Vec<f64>; 3],
    /// The last returns of the row, nearest first.
    left: [f64; 4],
}

impl Window {
    /// Empty cells on either side.
    const MARGIN: usize = 2;

    fn new(width: usize) -> Self {
        Window { rows: std::array::from_fn(|_| vec![0.0; width + 2 * Self::MARGIN]), left: [0.0; 4] }
    }

    fn start_row(&mut self) {
        self.rows.rotate_right(1);
        self.rows[0].fill(0.0);
        self.left = [0.0; 4];
    }

    fn push(&mut self, column: usize, range: f64) {
        self.rows[0][column + Self::MARGIN] = range;
        self.left.rotate_right(1);
        self.left[0] = range;
    }

    #[inline]
    fn around(&self, column: usize) -> Neighbourhood {
        let or = |range: f64, other: f64| if range > 0.0 { range } else { other };
        let &[_, nw, n, ne, nee] = self.rows[1][column..].first_chunk().unwrap_or(&[0.0; 5]);
        let nn = self.rows[2][column + Self::MARGIN];
        let west = or(self.left[0], or(n, or(nw, or(ne, TYPICAL_RANGE))));
        let west2 = or(self.left[1], west);
        let west3 = or(self.left[2], west2);
        let north = or(n, or(ne, or(nw, west)));
        let north_west = or(nw, north);
        let north_east = or(ne, north);
        let north_east2 = or(nee, north_east);
        let north2 = or(nn, north);
        let west4 = or(self.left[3], west3);
        Neighbourhood { west, west2, west3, west4, north, north_west, north_east, north_east2, north2 }
    }
}

/// The ranges around a cell, each missing one replaced by the next best.
#[derive(Clone)]
struct Neighbourhood {
    west: f64,
    west2: f64,
    west3: f64,
    west4: f64,
    north: f64,
    north_west: f64,
    north_east: f64,
    north_east2: f64,
    north2: f64,
}

/// The range assumed where nothing is known, in steps.
const TYPICAL_RANGE: f64 = 3000.0;

impl Neighbourhood {
    /// Differences to the left neighbour.
    fn features(&self) -> [f32; FEATURES] {
        [
            self.west2,
            self.west3,
            self.west4,
            self.north,
            self.north_west,
            self.north_east,
            self.north_east2,
            self.north2,
        ]
        .map(|range| (range - self.west).clamp(-FEATURE_REACH, FEATURE_REACH) as f32)
    }

    /// How rough the surroundings are, in octaves.
    fn activity_level(&self) -> usize {
        let activity = (self.west - self.west2).abs()
            + (self.north - self.north_west).abs()
            + (self.north - self.north_east).abs();
        let octaves = (activity as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(ACTIVITY_LEVELS - 1)
    }
}

/// The errors made to the left and above.
#[derive(Clone)]
struct ErrorTrack {
    /// Running mean magnitude along the row.
    mean: f32,
    /// For each column, the running mean down the rows, as it was above the current row and as it
    /// is made by it.
    above: Vec<f32>,
    current: Vec<f32>,
    /// The signed error of the left neighbour, and those of the row above.
    west: f64,
    signed_above: Vec<f32>,
    signed_current: Vec<f32>,
    has_row_above: bool,
}

impl ErrorTrack {
    fn new(width: usize) -> Self {
        let zeros = vec![0.0; width];
        ErrorTrack {
            mean: 0.0,
            above: zeros.clone(),
            current: zeros.clone(),
            west: 0.0,
            signed_above: zeros.clone(),
            signed_current: zeros,
            has_row_above: false,
        }
    }

    fn start_row(&mut self, has_row_above: bool) {
        self.mean = 20.0;
        self.west = 0.0;
        self.has_row_above = has_row_above;
        std::mem::swap(&mut self.above, &mut self.current);
        std::mem::swap(&mut self.signed_above, &mut self.signed_current);
    }

    fn expected(&self, column: usize) -> f32 {
        self.mean + 0.5 * self.above[column]
    }

    fn north(&self, column: usize) -> f64 {
        f64::from(self.signed_above[column])
    }

    /// No return in this column: what was known of it stays.
    fn skip(&mut self, column: usize) {
        self.current[column] = self.above[column];
        self.signed_current[column] = self.signed_above[column];
    }

    fn record(&mut self, column: usize, fit_error: f64, base_error: f64) {
        let magnitude = fit_error.abs().min(FEATURE_REACH) as f32;
        self.mean = 0.6 * self.mean + 0.4 * magnitude;
        self.current[column] =
            if self.has_row_above { 0.5 * self.above[column] + 0.5 * magnitude } else { magnitude };
        self.west = base_error;
        self.signed_current[column] = base_error as f32;
    }
}
