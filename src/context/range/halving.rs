//! One range, halving after halving.

use super::bins::Bins;
use super::mixture::{Interval, Mixture, Predicted};
use super::{ERROR_LEVELS, NODES, RangeBits, VIEWS};
use crate::context::shape::ErrorShape;
use crate::entropy::{BitCoder, Counter, Logistic};

/// Halvings inside a bucket that are corrected by counters; those below are all noise.
const CORRECTED_HALVINGS: usize = 1;

/// What the halvings of one range need. `P` predictors; `X` views of references.
pub struct Halving<'a, C, const P: usize, const X: usize> {
    pub coder: &'a mut C,
    pub shape: &'a ErrorShape,
    pub tables: &'static Logistic,
    /// The last bin that the range may be in ends below 2 to this power.
    pub range_bits: u32,
    pub bins: Bins,
    pub mixture: &'a Mixture<P>,
    pub predicted: Predicted<P>,
    pub bits: &'a mut RangeBits,
    /// The set of weights of the first node.
    pub first_set: usize,
    /// The context of each view.
    pub views: [usize; VIEWS],
    pub reference_counters: &'a mut [Vec<Counter>; X],
    pub reference_views: [usize; X],
    /// The encoder's bin.
    pub bin: i64,
}

impl<C: BitCoder, const P: usize, const X: usize> Halving<'_, C, P, X> {
    /// Codes the bin of the range: from the bin around the base on or below, then buckets of growing width
    /// away from there, then the halves of the bucket.
    #[inline]
    pub fn code(&mut self) -> Interval<P> {
        let mut interval = Interval::whole(self.bins.all(self.range_bits));
        let base = self.bins.central;
        let up = self.halve(&mut interval, base, Some(0));

        let fine = first_bucket(self.mixture.scale_of_fit(self.predicted.context) / self.bins.width as f64);
        let mut width = fine;
        let mut edge = base;
        let mut bucket = 0;
        loop {
            let next = if up { edge + width } else { edge - width };
            if next <= interval.low || next >= interval.high {
                break;
            }
            let node = 1 + bucket.min(14) * 2 + usize::from(up);
            if self.halve(&mut interval, next, Some(node)) != up {
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
                self.halve_evenly(&mut interval);
                continue;
            }
            let middle = (interval.low + interval.high) / 2;
            let node = 32 + halving * 8 + bucket.min(3) * 2 + usize::from(up);
            let node = (halving < CORRECTED_HALVINGS).then_some(node);
            self.halve(&mut interval, middle, node);
            halving += 1;
        }
        interval
    }

    /// Halves an interval so short that the density falls evenly over it: the odds of its halves are
    /// then the square root of those of the interval and its last sibling.
    #[inline]
    fn halve_evenly(&mut self, interval: &mut Interval<P>) {
        interval.odds *= 0.5;
        let middle = (interval.low + interval.high) / 2;
        if self.coder.code(self.bin >= middle, self.tables.squash(interval.odds)) {
            interval.low = middle;
        } else {
            interval.high = middle;
        }
    }

    /// Codes whether the bin is `middle` or beyond, and cuts the interval to that side.
    /// With a `node`, the counters have a say.
    #[inline]
    fn halve(&mut self, interval: &mut Interval<P>, middle: i64, node: Option<usize>) -> bool {
        let start = self.bins.start(middle, self.range_bits);
        let below_middle = self.mixture.below(self.shape, &self.predicted, start, self.range_bits);
        let above = interval.below_high.mixed.saturating_sub(below_middle.mixed) | 1;
        let below = below_middle.mixed.saturating_sub(interval.below_low.mixed) | 1;
        let bit = self.bin >= middle;
        interval.odds = self.tables.ln(above) - self.tables.ln(below);
        let bit = match node {
            None => self.coder.code(bit, self.tables.squash(interval.odds)),
            Some(node) => self.code_corrected(node, interval.odds, bit),
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
    fn code_corrected(&mut self, node: usize, odds: f32, bit: bool) -> bool {
        let set = self.first_set + node * ERROR_LEVELS;
        let places = self.views.map(|view| view * NODES + node);
        let mut views = self.reference_views.iter();
        let extra = self.reference_counters.each_mut().map(|counters| {
            let view = views.next().copied().unwrap_or_default();
            &mut counters[view * NODES + node]
        });
        self.bits.code_with(self.coder, set, &places, odds, extra, bit)
    }
}

/// Width of the first bucket beside the base, in bins: a power of two near 0.6 scales.
fn first_bucket(scale: f64) -> i64 {
    // 0.6 * sqrt(2): the nearest power in octaves.
    ((scale * 0.84853) as u32).checked_ilog2().map_or(1, |octave| 1 << octave)
}
