//! The ranges: a mixture of predictors gives each range a probability distribution. An interval of ranges is
//! halved repeatedly, and counters in several contexts correct the probability of each half. FORMAT.md 8.6.
//!
//! The predictors of a return are its neighbours, the line through two of them, and an online least-squares
//! fit. Where an earlier frame has a return in a cell, two more predictors, features for a separate
//! least-squares fit, and contexts are added.

mod deep;
mod halving;
mod mixture;
mod residuals;
mod site;
mod tokens;

use super::least_squares::LeastSquares;
use super::quantise::{Thresholds, signed_level};
use super::shape::ErrorShape;
use crate::entropy::{BitCoder, Counter, Logistic, MixedBits};
use crate::ground::grid::Grid;
use crate::inter::Reference;
use deep::{DeepModel, DeepSite, Referred};
use halving::Halving;
pub use halving::RangeScale;
use mixture::{Interval, Mixture, Rates};
use residuals::{Classes, Residuals, Rows};
use site::{Back, NearbyErrors, ReferenceErrors, Site, Surroundings, Window, pair};
pub use tokens::{KnownCells, RANGE_CONTEXTS, RangeTokens, start_tables};

/// Number of features of the least-squares predictor, of those of the reference, and of both.
const FEATURES: usize = 8;
const REFERENCE_FEATURES: usize = 4;
const ALL_FEATURES: usize = FEATURES + REFERENCE_FEATURES;
/// Predictors in the mixture, without and with those of the reference.
const PREDICTORS: usize = 5;
const ALL_PREDICTORS: usize = PREDICTORS + 2;
/// Indices of the least-squares predictor and of the one for surprises.
const FIT: usize = 3;
const SURPRISE: usize = 4;
/// Number of classes of the measures that contexts consist of: surrounding activity, surrounding errors,
/// surrounding errors of the reference.
const ACTIVITY_LEVELS: usize = 12;
const ERROR_LEVELS: usize = 12;
const REFERENCE_LEVELS: usize = 7;
const CONTEXTS: usize = ACTIVITY_LEVELS * ERROR_LEVELS;
/// Kinds of edges; each has its own least-squares fits.
const EDGES: usize = 4;
/// A difference of ranges, in steps, that counts as an edge, or as a change from the frame before.
const EDGE: u16 = 60;
/// Features and predictions are limited to this many steps from what they are relative to.
const FEATURE_REACH: u16 = 300;
const FIT_REACH: u16 = 400;
/// The weight that a least-squares fit keeps of its samples, from each to the next.
const LONG_MEMORY: f32 = 0.998;
/// The range assumed if nothing is known, in steps.
pub(super) const TYPICAL_RANGE: u16 = 3000;
/// Nodes of the decision tree that have their own counters.
const NODES: usize = 64;
/// Views of the context, each with its own counters; and the number of opinions that are mixed: those of the
/// views, the mixture's, a constant one, and those of the reference's views.
const VIEWS: usize = 4;
const REFERENCE_VIEWS: usize = 2;
const OPINIONS: usize = 8;
/// Number of contexts of each view.
const VIEW_SIZES: [usize; VIEWS] = [1024, 1024, 8 * 128, 8 * 64 * 4];
const REFERENCE_VIEW_SIZES: [usize; REFERENCE_VIEWS] = [32 * 32, 32 * 32];

/// The learning rates of the mixture.
const RATES: Rates = Rates { weights: 0.02, scales: 0.02, early: 0.0 };

type ErrorLevels = Thresholds<{ ERROR_LEVELS - 1 }>;
type RangeBits = MixedBits<VIEWS, OPINIONS>;

/// The adaptive models of ranges.
#[derive(Clone)]
pub struct RangeModel {
    shape: ErrorShape,
    tables: &'static Logistic,
    error_levels: ErrorLevels,
    bits: RangeBits,
    fits: Vec<LeastSquares<FEATURES>>,
    residuals: Residuals,
    mixture: Mixture<PREDICTORS, 1>,
    /// The models of cells with a reference, once there was a reference.
    with_reference: Option<Box<WithReference>>,
    /// The deep model, which replaces all of these [once it is chosen](Self::use_deep).
    deep: Option<Box<DeepModel>>,
}

/// The models of cells with a reference. They start as a copy of those of the other cells.
#[derive(Clone)]
struct WithReference {
    fits: Vec<LeastSquares<ALL_FEATURES>>,
    mixture: Mixture<ALL_PREDICTORS, 1>,
    counters: [Vec<Counter>; REFERENCE_VIEWS],
}

impl Default for RangeModel {
    fn default() -> Self {
        let (sizes, sets) = (VIEW_SIZES.map(|size| size * NODES), NODES * ERROR_LEVELS);
        RangeModel {
            shape: ErrorShape::new(),
            tables: Logistic::tables(),
            error_levels: Thresholds::new(1.6, 1.6),
            bits: MixedBits::new(sizes, sets * (1 + REFERENCE_LEVELS), 0.0, 1.0, 0.004),
            fits: vec![LeastSquares::new(LONG_MEMORY); EDGES],
            residuals: Residuals::default(),
            mixture: Mixture::new(RATES, [CONTEXTS], first_scale),
            with_reference: None,
            deep: None,
        }
    }
}

/// The initial scale, in steps, in a context, which is a class of errors.
fn first_scale(context: usize) -> f32 {
    (2..context % ERROR_LEVELS).fold(3.0, |scale, _| scale * 1.6)
}

/// The data known for all cells before their ranges are coded.
pub struct RangeContext<'a> {
    /// Which cells hold a return.
    pub occupancy: &'a Grid<bool>,
    /// The intensities, limited to 1 to 128; 0 = no return.
    pub intensity: &'a Grid<u16>,
    /// The prediction from an earlier frame.
    pub reference: Option<&'a Reference>,
    /// How ranges are coded.
    pub scale: RangeScale,
}

/// A coded range, and its predictions, in steps.
struct Coded {
    range: i64,
    /// The least-squares prediction, without and with the offset from the surrounding residuals; relative to
    /// the left neighbour.
    fit: f64,
    hinted: f64,
    base: i64,
}

impl RangeModel {
    /// Switches to the deep model, for all further frames of the group.
    pub fn use_deep(&mut self) {
        self.deep.get_or_insert_default();
    }

    /// Codes the range, in steps, of every cell that holds a return. If bins are wider than a step, both
    /// sides continue with the middles of the bins, which are also written to the encoder's grid.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, known: &RangeContext, steps: &mut Grid<u32>) {
        if let Some(deep) = &mut self.deep {
            deep.start_frame(known.occupancy.columns(), known.reference.is_some());
        } else if known.reference.is_some() && self.with_reference.is_none() {
            self.bits.spread_sets(NODES * ERROR_LEVELS);
            self.with_reference = Some(Box::new(WithReference {
                fits: self.fits.iter().map(LeastSquares::widened).collect(),
                mixture: self.mixture.widened(REFERENCE_LEVELS),
                counters: REFERENCE_VIEW_SIZES.map(|size| vec![Counter::default(); size * NODES]),
            }));
        }
        let width = known.occupancy.columns();
        let (mut errors, mut window) = (NearbyErrors::new(width), Window::new(width));
        let (mut reference_errors, mut rows) = (ReferenceErrors::new(width), Rows::new(width));
        for row in 0..known.occupancy.rows() {
            if coder.is_exhausted() {
                return;
            }
            errors.start_row(row > 0);
            window.start_row();
            reference_errors.start_row();
            rows.start_row();
            let levels = known.intensity.row(row);
            let levels_above = row.checked_sub(1).map_or(&[][..], |above| known.intensity.row(above));
            for column in 0..width {
                let cell = (row, column);
                if !known.occupancy[cell] {
                    errors.skip(column);
                    continue;
                }
                let levels_near = (levels, levels_above);
                let site = Site::of(levels_near, window.around(column), &errors, &self.error_levels, column);
                let back = known.reference.and_then(|reference| Back::at(reference, &reference_errors, cell));
                let hint = self.residuals.hint(&rows, column, Classes::of(levels, column));
                let (offset, range) = (f64::from(hint.offset), i64::from(steps[cell]));
                let coded = match (&mut self.deep, &back, &mut self.with_reference) {
                    (Some(deep), ..) => {
                        let referred = known.reference.zip(back.as_ref()).map(|(reference, back)| Referred {
                            around: Surroundings::of(reference, back, cell),
                            back: back.clone(),
                        });
                        let level = |right| known.intensity.beside(cell, 0, right);
                        let levels_beside = [level(-2), level(1), level(2)];
                        let residuals = hint.inputs();
                        let site = DeepSite { site: &site, cell, referred, levels_beside, residuals };
                        deep.code(coder, (&self.shape, self.tables), known.scale, (&site, offset), range)
                    }
                    (None, Some(back), Some(learned)) => {
                        let RangeModel { shape, tables, bits, .. } = self;
                        let shared = Shared { shape, tables, bits, scale: known.scale };
                        learned.code(coder, shared, &site, offset, back, range)
                    }
                    _ => self.code_alone(coder, known.scale, &site, offset, range),
                };
                steps[cell] = coded.range as u32;
                let range = coded.range as f64;
                let from_west = range - site.near.west;
                errors.record(column, from_west - coded.hinted, range - coded.base as f64);
                self.residuals.learn(&mut rows, column, &hint, (from_west - coded.fit) as f32);
                if let Some(back) = &back {
                    reference_errors.record(column, range, back);
                }
                window.push(column, range);
            }
        }
    }

    /// Codes a range from its neighbours alone.
    #[inline]
    fn code_alone<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: RangeScale,
        site: &Site,
        hint: f64,
        range: i64,
    ) -> Coded {
        let fits = &mut self.fits[site.edge];
        let fit = within_reach(fits.predict(&site.features));
        let hinted = within_reach(fit + hint);
        let values = site.predictions(hinted);
        let base = site.base(hinted, scale.bits);
        let bins = scale.bins_around(base);
        let mut halving = Halving {
            coder,
            shape: &self.shape,
            tables: self.tables,
            range_bits: scale.bits,
            bins,
            mixture: &self.mixture,
            predicted: self.mixture.place(&self.shape, values, [site.context]),
            bits: &mut self.bits,
            first_set: site.error_level,
            views: site.views_from(base),
            reference_counters: &mut [],
            reference_views: [],
            bin: bins.of(range),
            interval: Interval::whole(bins.all(scale.bits)),
            odds: 0.0,
        };
        halving.code();
        let Halving { predicted, interval, .. } = halving;
        let range = bins.middle(interval.low, scale.bits);
        self.mixture.learn(&predicted, &interval, range as f32);
        site.learn(fits, &site.features, fit, range as f64);
        Coded { range, fit, hinted, base }
    }
}

/// What ranges share, whether there is a reference or not.
struct Shared<'m> {
    shape: &'m ErrorShape,
    tables: &'static Logistic,
    bits: &'m mut RangeBits,
    scale: RangeScale,
}

impl WithReference {
    /// Codes a range from its neighbours and from the reference.
    #[inline]
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        Shared { shape, tables, bits, scale }: Shared,
        site: &Site,
        hint: f64,
        back: &Back,
        range: i64,
    ) -> Coded {
        let mut features = [0.0; ALL_FEATURES];
        features[..FEATURES].copy_from_slice(&site.features);
        features[FEATURES..].copy_from_slice(&back.features(&site.near));
        let fits = &mut self.fits[site.edge];
        let fit = within_reach(fits.predict(&features));
        let hinted = within_reach(fit + hint);
        let mut values = [0.0; ALL_PREDICTORS];
        values[..PREDICTORS].copy_from_slice(&site.predictions(hinted));
        values[PREDICTORS..].copy_from_slice(&[back.same as f32, back.moved as f32]);
        let base = site.base(hinted, scale.bits);
        let bins = scale.bins_around(base);
        let [same, moved] = [back.same, back.moved].map(|range| range - base as f64);
        let context = back.level * CONTEXTS + site.context;
        let mut halving = Halving {
            coder,
            shape,
            tables,
            range_bits: scale.bits,
            bins,
            mixture: &self.mixture,
            predicted: self.mixture.place(shape, values, [context]),
            bits,
            first_set: (1 + back.level) * NODES * ERROR_LEVELS + site.error_level,
            views: site.views_from(base),
            reference_counters: &mut self.counters,
            reference_views: [
                signed_level(same as i32) * 32 + back.level * 4 + site.error_level / 3,
                pair(same, moved),
            ],
            bin: bins.of(range),
            interval: Interval::whole(bins.all(scale.bits)),
            odds: 0.0,
        };
        halving.code();
        let Halving { predicted, interval, .. } = halving;
        let range = bins.middle(interval.low, scale.bits);
        self.mixture.learn(&predicted, &interval, range as f32);
        site.learn(fits, &features, fit, range as f64);
        Coded { range, fit, hinted, base }
    }
}
/// A prediction relative to the left neighbour, in steps, limited to [`FIT_REACH`].
#[inline(always)]
fn within_reach(steps: impl Into<f64>) -> f64 {
    steps.into().clamp(-f64::from(FIT_REACH), FIT_REACH.into())
}
