//! Halving one range under several mixtures.

use super::site::SetContexts;
use super::{DeepBits, MIXTURES, PREDICTORS, VIEWS};
use crate::entropy::{BitCoder, LayeredContext, Logistic, MixContexts};
use crate::models::range::bins::Bins;
use crate::models::range::halving::Halves;
use crate::models::range::mixture::{Below, Interval, Mixture, Predicted};
use crate::models::range::{ERROR_LEVELS, NODES};
use crate::models::shape::ErrorShape;

/// The state of halving one range.
pub struct DeepHalving<'a, C> {
    pub coder: &'a mut C,
    pub shape: &'a ErrorShape,
    pub tables: &'static Logistic,
    pub range_bits: u32,
    pub bins: Bins,
    pub mixtures: &'a [Mixture<PREDICTORS>; MIXTURES],
    pub predicted: &'a [Predicted<PREDICTORS>; MIXTURES],
    /// What is left of the bins, under each mixture.
    pub intervals: &'a mut [Interval<PREDICTORS>; MIXTURES],
    pub bits: &'a mut DeepBits,
    pub views: [usize; VIEWS],
    pub contexts: SetContexts,
    /// The encoder's bin.
    pub bin: i64,
    /// The mean of the mixtures' log odds for the last halves.
    pub odds: f32,
}

impl<C: BitCoder> Halves for DeepHalving<'_, C> {
    const CORRECTED: usize = 2;

    #[inline]
    fn ends(&self) -> (i64, i64) {
        (self.intervals[0].low, self.intervals[0].high)
    }

    #[inline]
    fn halve(&mut self, middle: i64, node: Option<usize>) -> bool {
        let start = self.bins.start(middle, self.range_bits);
        let mut odds = [0.0; MIXTURES];
        let mut below_middle = [Below::default(); MIXTURES];
        for m in 0..MIXTURES {
            let predicted = &self.predicted[m];
            below_middle[m] = self.mixtures[m].below(self.shape, predicted, start, self.range_bits);
            odds[m] = self.intervals[m].split(&below_middle[m], self.tables);
        }
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
        for (interval, below) in self.intervals.iter_mut().zip(&below_middle) {
            interval.cut(bit, middle, below);
        }
        bit
    }

    #[inline]
    fn halve_evenly(&mut self, middle: i64) {
        self.odds *= 0.5;
        let upper = self.coder.code(self.bin >= middle, self.tables.squash(self.odds));
        for interval in self.intervals.iter_mut() {
            *(if upper { &mut interval.low } else { &mut interval.high }) = middle;
        }
    }
}
