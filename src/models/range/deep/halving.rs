//! Halving one range under a mixture with several sets of weights. FORMAT.md 8.6, "deep".

use super::site::SetContexts;
use super::{DeepBits, PREDICTORS, SETS, VIEWS};
use crate::entropy::{BitCoder, LayeredContext, Logistic, MixContexts};
use crate::models::range::bins::Bins;
use crate::models::range::halving::Halves;
use crate::models::range::mixture::{Interval, Mixture, Predicted};
use crate::models::range::{ERROR_LEVELS, NODES};
use crate::models::shape::ErrorShape;

/// The state of halving one range.
pub struct DeepHalving<'a, C> {
    pub coder: &'a mut C,
    pub shape: &'a ErrorShape,
    pub tables: &'static Logistic,
    pub range_bits: u32,
    pub bins: Bins,
    pub mixture: &'a Mixture<PREDICTORS, SETS>,
    pub predicted: &'a Predicted<PREDICTORS, SETS>,
    /// The remaining bins.
    pub interval: Interval<PREDICTORS, SETS>,
    pub bits: &'a mut DeepBits,
    pub views: [usize; VIEWS],
    pub contexts: SetContexts,
    /// The encoder's bin.
    pub bin: i64,
    /// The mean of the log odds of the mixture's sets of weights for the last halves.
    pub odds: f32,
}

impl<C: BitCoder> Halves for DeepHalving<'_, C> {
    const CORRECTED: usize = 2;

    #[inline]
    fn ends(&self) -> (i64, i64) {
        (self.interval.low, self.interval.high)
    }

    #[inline]
    fn halve(&mut self, middle: i64, node: Option<usize>) -> bool {
        let start = self.bins.start(middle, self.range_bits);
        let below_middle = self.mixture.below(self.shape, self.predicted, start, self.range_bits);
        let odds = self.interval.split(&below_middle, self.tables);
        self.odds = (odds[0] + odds[1] + odds[2]) * (1.0 / 3.0);
        let bit = self.bin >= middle;
        let bit = match node {
            None => self.coder.code(bit, self.tables.squash(self.odds)),
            Some(node) => {
                let SetContexts { error_level, row, .. } = self.contexts;
                let context = LayeredContext {
                    views: self.views.map(|view| view * NODES + node),
                    mixer: MixContexts {
                        sets: self.contexts.sets(node),
                        last: node,
                        refinements: [node * ERROR_LEVELS + error_level, row * NODES + node],
                    },
                };
                self.bits.code(self.coder, &context, &odds, bit)
            }
        };
        self.interval.cut(bit, middle, &below_middle);
        bit
    }

    #[inline]
    fn halve_evenly(&mut self, middle: i64) {
        self.odds *= 0.5;
        let upper = self.coder.code(self.bin >= middle, self.tables.squash(self.odds));
        *(if upper { &mut self.interval.low } else { &mut self.interval.high }) = middle;
    }
}
