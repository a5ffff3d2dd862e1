//! The ranges at [`Depth::Deep`](crate::context::Depth::Deep): more least-squares fits, among them one for
//! each stretch of columns; several mixtures of the same predictors, each in contexts of its own; and
//! mixing in two layers.
//!
//! Cells with and without a reference go the same way: what there is of the reference makes contexts.

mod fits;
mod halving;

use super::back::{Back, Surroundings};
use super::bins::Bins;
use super::halving::{code_bin, first_bucket};
use super::mixture::{Interval, Mixture, Rates};
use super::{
    ACTIVITY_LEVELS, ALL_FEATURES, CONTEXTS, Coded, EDGES, ERROR_LEVELS, FEATURES, FIT_REACH, NODES,
    REFERENCE_LEVELS, Site, first_scale, intensity_change, pair,
};
use crate::context::quantise::signed_level;
use crate::context::shape::ErrorShape;
use crate::entropy::{BitCoder, LayeredBits, LayeredContext, Logistic};
use fits::Fits;
use halving::{DeepHalving, SetContexts};

/// Predictors in the mixtures.
const PREDICTORS: usize = 8;
/// Mixtures, views, opinions and mixers.
const MIXTURES: usize = 3;
const VIEWS: usize = 8;
const OPINIONS: usize = 12;
const MIXERS: usize = 4;
/// Rows that have contexts of their own; those below share the last one's.
const ROWS: usize = 64;
/// Kinds of references: none, and the levels of their errors.
const KINDS: usize = 1 + REFERENCE_LEVELS;
/// Changes of the intensity from two others: eight of each.
const CHANGES: usize = 64;
/// No reference, and the changes from its two layers.
const RECOGNITIONS: usize = 1 + CHANGES;
/// Levels of the own intensity.
const OWN_LEVELS: usize = 4;

const RATES: Rates = Rates { weights: 0.03, scales: 0.02, early: 0.3 };
const SIZES: LayeredContext<VIEWS, MIXERS> = LayeredContext {
    views: [
        1024 * NODES,
        1024 * NODES,
        128 * 8 * NODES,
        CHANGES * OWN_LEVELS * 8 * NODES,
        1024 * NODES,
        1024 * NODES,
        ROWS * ERROR_LEVELS * NODES,
        RECOGNITIONS * ERROR_LEVELS * NODES,
    ],
    sets: [KINDS * NODES * ERROR_LEVELS, CHANGES * NODES, ROWS * NODES, RECOGNITIONS * NODES],
    last: NODES,
    maps: [NODES * ERROR_LEVELS, ROWS * NODES],
};

type DeepBits = LayeredBits<MIXTURES, VIEWS, OPINIONS, MIXERS>;

/// What has been learned.
#[derive(Clone)]
pub struct DeepModel {
    fits: Fits,
    mixtures: [Mixture<PREDICTORS>; MIXTURES],
    bits: DeepBits,
    /// Whether there was a frame with a reference.
    had_reference: bool,
}

/// What an earlier frame has for a cell, and around it.
pub struct Referred {
    pub back: Back,
    pub around: Surroundings,
}

/// A cell to be coded.
pub struct DeepSite<'a> {
    pub site: &'a Site,
    pub cell: (usize, usize),
    pub referred: Option<Referred>,
}

impl Default for DeepModel {
    fn default() -> Self {
        let mixture = |contexts: usize| Mixture::new(RATES, (0..contexts).map(first_scale));
        DeepModel {
            fits: Fits::default(),
            mixtures: [
                mixture(KINDS * ACTIVITY_LEVELS * ERROR_LEVELS),
                mixture(CHANGES * OWN_LEVELS * ERROR_LEVELS),
                mixture(RECOGNITIONS * KINDS * ERROR_LEVELS),
            ],
            bits: LayeredBits::new(&SIZES),
            had_reference: false,
        }
    }
}

impl DeepModel {
    /// Makes ready for an image of `columns`. When the first frame with a reference comes, all that depends
    /// on references starts from what has been learned without.
    pub fn start_frame(&mut self, columns: usize, has_reference: bool) {
        self.fits.start_frame(columns);
        if has_reference && !self.had_reference {
            self.had_reference = true;
            self.fits.spread();
            self.mixtures[0].spread(CONTEXTS);
            self.mixtures[2].spread(ERROR_LEVELS);
            self.bits.spread_sets(0, NODES * ERROR_LEVELS);
            self.bits.spread_sets(3, NODES);
        }
    }

    /// Codes a range, in steps.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (shape, tables): (&ErrorShape, &'static Logistic),
        (range_bits, bin): (u32, i64),
        deep_site: &DeepSite,
        range: i64,
    ) -> Coded {
        let DeepSite { site, cell: (row, column), referred } = deep_site;
        let fitted = self.fits.predict(site, *column, referred.as_ref());
        let base = site.base(fitted.blend, range_bits);
        let bins = Bins::around(base, bin);
        let contexts = set_contexts(site, *row, referred.as_ref());
        let values = deep_site.predictions(&fitted);
        let mixture_contexts = deep_site.mixture_contexts(&contexts);
        let predicted = std::array::from_fn(|m| self.mixtures[m].place(shape, values, mixture_contexts[m]));
        let mut intervals = std::array::from_fn(|_| Interval::whole(bins.all(range_bits)));
        let mut halving = DeepHalving {
            coder,
            shape,
            tables,
            range_bits,
            bins,
            mixtures: &self.mixtures,
            predicted: &predicted,
            intervals: &mut intervals,
            bits: &mut self.bits,
            views: deep_site.views(&contexts, &fitted, base as f64),
            contexts,
            bin: bins.of(range),
            odds: 0.0,
        };
        let scale = self.mixtures[0].scale_of_fit(mixture_contexts[0]);
        code_bin(&mut halving, bins.central, first_bucket(scale / bins.width as f64));
        let range = bins.middle(intervals[0].low, range_bits);
        for ((mixture, predicted), interval) in self.mixtures.iter_mut().zip(&predicted).zip(&intervals) {
            mixture.learn(predicted, interval, range as f64);
        }
        self.fits.learn(site, &fitted, range as f64);
        Coded { range, fit: fitted.blend, base }
    }
}

/// What chooses weights for a cell.
fn set_contexts(site: &Site, row: usize, referred: Option<&Referred>) -> SetContexts {
    let (kind, recognition) = referred.map_or((0, 0), |Referred { back, around }| {
        let change = |level| intensity_change(site.intensities[0], level);
        (1 + back.level, 1 + change(around.same_level) * 8 + change(around.moved_level))
    });
    let row = row.min(ROWS - 1);
    SetContexts { kind, error_level: site.error_level, change: site.change, row, recognition }
}

impl DeepSite<'_> {
    /// What is mixed: the line through the two returns to the left, three fits, the left neighbour for
    /// surprises, and the moved layer here and beside.
    fn predictions(&self, fitted: &fits::Fitted) -> [f64; PREDICTORS] {
        let near = &self.site.near;
        let [recent, local, blend] = [fitted.recent, fitted.local, fitted.blend].map(|fit| near.west + fit);
        let [moved, moved_west, moved_east] = match &self.referred {
            None => [near.west + fitted.wide; 3],
            Some(Referred { back, around }) => [back.moved, around.moved_west, around.moved_east],
        };
        [2.0 * near.west - near.west2, recent, local, blend, near.west, moved, moved_west, moved_east]
    }

    fn mixture_contexts(&self, contexts: &SetContexts) -> [usize; MIXTURES] {
        let SetContexts { kind, error_level, change, recognition, .. } = *contexts;
        [
            kind * CONTEXTS + self.site.context,
            (change * OWN_LEVELS + own_level(self.site)) * ERROR_LEVELS + error_level,
            (recognition * KINDS + kind) * ERROR_LEVELS + error_level,
        ]
    }

    /// The context of each view, for a coding that starts at `base`.
    fn views(&self, contexts: &SetContexts, fitted: &fits::Fitted, base: f64) -> [usize; VIEWS] {
        let SetContexts { kind, error_level, row, recognition, .. } = *contexts;
        let near = &self.site.near;
        let [_, errors, own, change] = self.site.views;
        let wide = near.west + fitted.wide;
        let [same, moved] = self
            .referred
            .as_ref()
            .map_or([wide; 2], |Referred { back, .. }| [back.same, back.moved])
            .map(|range| range - base);
        [
            pair(near.west - base, near.north - base),
            errors,
            own,
            change,
            signed_level(same as i32) * 32 + kind * 4 + error_level / 3,
            pair(same, moved),
            row * ERROR_LEVELS + error_level,
            recognition * ERROR_LEVELS + error_level,
        ]
    }
}

/// Level of the cell's own intensity.
fn own_level(site: &Site) -> usize {
    usize::from(site.intensities[0] / 8).min(OWN_LEVELS - 1)
}
