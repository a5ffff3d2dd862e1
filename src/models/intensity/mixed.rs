//! Levels by five views of their neighbours and one of the reference, mixed.

use super::errors::MeanErrors;
use super::neighbours::{IntensityNeighbours, TYPICAL_LEVEL};
use super::scale::{IntensityScale, MOST_BITS};
use crate::entropy::{BitCoder, Counter, MixedBits};
use crate::models::Depth;
use crate::models::least_squares::LeastSquares;
use crate::models::quantise::Levels;

const VIEWS: usize = 5;
const OPINIONS: usize = 8;
/// Counters of each view: contexts share them by hashing.
const SLOT_BITS: u32 = 12;
const FEATURES: usize = 8;
const REFERENCE_FEATURES: usize = 4;
const ALL_FEATURES: usize = FEATURES + REFERENCE_FEATURES;
/// Beams beyond this many share their contexts.
const ROW_CONTEXTS: usize = 128;
const ERROR_LEVELS: usize = 8;
const GRADIENT_LEVELS: usize = 8;
/// Least-squares fits: nothing above, and something.
const FITS: usize = 2;
/// Sets of weights; with a reference there are as many more.
const SETS: usize = MOST_BITS as usize * ERROR_LEVELS * GRADIENT_LEVELS;

/// What the coder has learned about levels.
#[derive(Clone)]
pub struct MixedLevels {
    fits: [LeastSquares<FEATURES>; FITS],
    /// The same with a reference, once there was one.
    reference_fits: Option<[LeastSquares<ALL_FEATURES>; FITS]>,
    bits: MixedBits<VIEWS, OPINIONS>,
    reference: Vec<Counter>,
    levels: Levels<7>,
    errors: MeanErrors,
    /// Whether two views decide most bits.
    is_quick: bool,
}

/// Log odds from which on two views decide a bit: 1 to 33, or, to be quick, 1 to 2.7.
const SURE: f32 = 3.5;
const QUICKLY_SURE: f32 = 1.0;

impl Default for MixedLevels {
    fn default() -> Self {
        MixedLevels {
            fits: std::array::from_fn(|_| LeastSquares::new(0.9995)),
            reference_fits: None,
            bits: MixedBits::new([0; VIEWS], 2 * SETS, 0.25, 0.0, 0.003),
            reference: Vec::new(),
            levels: Levels::new(1.0, 1.8),
            errors: MeanErrors::default(),
            is_quick: false,
        }
    }
}

impl MixedLevels {
    /// Begins a frame, or its strays, with `columns` columns.
    pub fn start_frame(&mut self, depth: Depth, scale: &IntensityScale, columns: usize) {
        self.is_quick = depth == Depth::Quick;
        self.errors.start_frame(columns);
        // A context has a counter for each place in the tree of a level's bits.
        if scale.is_on_grid() {
            let places = 1 << (SLOT_BITS + scale.bits());
            self.bits.grow(places);
            self.reference.resize(self.reference.len().max(places), Counter::default());
        }
    }

    /// Begins a row.
    pub fn start_row(&mut self) {
        self.errors.start_row();
    }

    /// Codes one level. `row` and `column` only serve as contexts.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        level: u32,
    ) -> u32 {
        if near.back.is_some() && self.reference_fits.is_none() {
            self.bits.spread_sets(SETS);
            self.reference_fits = Some(self.fits.each_ref().map(LeastSquares::widened));
        }
        let site = self.site(near, row, self.errors.expected(column));
        let slots = site.views.map(|view| slot(view) << scale.bits());
        let reference = site.reference.as_ref().map(|reference| slot(reference.view) << scale.bits());
        let mut node = 1usize;
        for i in (0..scale.bits()).rev() {
            let set = i as usize * ERROR_LEVELS * GRADIENT_LEVELS + site.mixer_set;
            let places = slots.map(|slot| slot + node);
            let bit = level >> i & 1 == 1;
            let sure = match (self.is_quick, i) {
                (false, _) => SURE,
                // The lowest bit is all noise.
                (true, 0) => f32::NEG_INFINITY,
                (true, _) => QUICKLY_SURE,
            };
            let bit = match reference {
                None => self.bits.code_or_sure(coder, sure, set, &places, [], bit),
                Some(slot) => {
                    let extra = [&mut self.reference[slot + node]];
                    self.bits.code_or_sure(coder, sure, SETS + set, &places, extra, bit)
                }
            };
            node = node << 1 | usize::from(bit);
        }
        let level = node as u32 - (1 << scale.bits());
        self.learn(&site, column, f32::from(scale.context_of(level)));
        level
    }

    fn site(&self, near: &IntensityNeighbours, row: usize, expected_error: f32) -> Site {
        let or = |level: u16, other: u16| if level > 0 { level } else { other };
        let [_, nw, n, ne, nee] = near.above;
        let west = or(near.left[0], or(n, or(nw, or(ne, TYPICAL_LEVEL))));
        let west2 = or(near.left[1], west);
        let west4 = or(near.left[3], or(near.left[2], west2));
        let north = or(n, or(ne, or(nw, west)));
        let north_east = or(ne, north);
        let difference = |level: u16| f32::from(level) - f32::from(west);
        let features = [
            difference(west2),
            difference(north),
            difference(or(nw, north)),
            difference(north_east),
            difference(or(near.above2[1], north)),
            difference(or(near.left[2], west2)),
            difference(west4),
            difference(or(nee, north_east)),
        ];
        let fit = usize::from(near.above[2] > 0);
        let reference = near.back.map(|back| {
            let mut all = [0.0; ALL_FEATURES];
            all[..FEATURES].copy_from_slice(&features);
            let same = back.level();
            let [_, left, right] = back.same;
            let levels = [same, or(left, same), or(right, same), or(back.moved, same)];
            all[FEATURES..].copy_from_slice(&levels.map(difference));
            (all, same)
        });
        let change = match (&reference, &self.reference_fits) {
            (Some((all, _)), Some(fits)) => fits[fit].predict(all),
            _ => self.fits[fit].predict(&features),
        };
        let prediction = (f32::from(west) + change).clamp(0.0, 127.0);
        let apart = |a: u16, b: u16| f32::from(a.abs_diff(b));
        let gradient = apart(west, north) + apart(west, west2) + apart(north, north_east);
        let error_level = self.levels.of(expected_error);
        let gradient_level = self.levels.of(gradient);
        let [w, ww] = [west, west2].map(usize::from);
        let row = row.min(ROW_CONTEXTS - 1);
        // In steps of 1.6 levels.
        let coarse = (prediction * 0.625) as usize;
        let mixer_set = error_level * GRADIENT_LEVELS + gradient_level;
        let [pair, exact_pair, of_row, west_of_row, expected] =
            [(w / 2) << 8 | ww / 2, w << 8 | ww, row << 8 | coarse, row << 8 | w, coarse << 6 | mixer_set];
        // The first two are those that decide alone where they are sure.
        let views = match self.is_quick {
            false => [pair, exact_pair, of_row, west_of_row, expected],
            true => [expected, pair, of_row, exact_pair, west_of_row],
        };
        Site {
            views,
            mixer_set,
            features,
            reference: reference
                .map(|(features, same)| SiteReference { features, view: usize::from(same) << 8 | coarse }),
            fit,
            west: f32::from(west),
            prediction,
        }
    }

    fn learn(&mut self, site: &Site, column: usize, level: f32) {
        let error = level - site.prediction;
        let (target, weight) = (level - site.west, 1.0 / (9.0 + error * error));
        match (&site.reference, &mut self.reference_fits) {
            (Some(reference), Some(fits)) => fits[site.fit].learn(&reference.features, target, weight),
            _ => self.fits[site.fit].learn(&site.features, target, weight),
        }
        self.errors.record(column, error.abs());
    }
}

/// A value to be coded.
#[derive(Clone)]
struct Site {
    views: [usize; VIEWS],
    mixer_set: usize,
    features: [f32; FEATURES],
    reference: Option<SiteReference>,
    fit: usize,
    west: f32,
    prediction: f32,
}

/// What an earlier frame adds to it.
#[derive(Clone)]
struct SiteReference {
    /// Those of the site and of the reference.
    features: [f32; ALL_FEATURES],
    view: usize,
}

/// The place of a context among the slots.
fn slot(view: usize) -> usize {
    ((view as u32).wrapping_mul(0x9e37_79b1) >> (32 - SLOT_BITS)) as usize
}
