//! Coding one range by repeated halving. FORMAT.md 8.6, "Coding".

use super::bins::Bins;
use super::mixture::{Interval, Mixture, Predicted};
use super::{ERROR_LEVELS, NODES, RangeBits, VIEWS};
use crate::entropy::{BitCoder, Counter, Logistic};
use crate::models::shape::ErrorShape;

/// Codes in which half of the remaining bins a range is.
pub trait Halves {
    /// Number of halvings inside a bucket whose probabilities are corrected by counters; further bits are
    /// pure noise.
    const CORRECTED: usize;

    /// The first of the remaining bins, and the bin after the last.
    fn ends(&self) -> (i64, i64);

    /// Codes whether the bin is `middle` or beyond, and keeps that side. With a `node`, the counters
    /// contribute.
    fn halve(&mut self, middle: i64, node: Option<usize>) -> bool;

    /// Halves an interval so short that the density decreases uniformly over it: the odds of its halves are
    /// then the square root of the odds of the interval and its last sibling.
    fn halve_evenly(&mut self, middle: i64);
}

/// Codes a bin: first whether it is at or above the bin around the base, or below; then its bucket, of
/// increasing width with the distance, the first being `fine` bins wide; then by halving the bucket.
#[inline]
pub fn code_bin<H: Halves>(halves: &mut H, base: i64, fine: i64) {
    let up = halves.halve(base, Some(0));
    let mut width = fine;
    let mut edge = base;
    let mut bucket = 0;
    loop {
        let next = if up { edge + width } else { edge - width };
        let (low, high) = halves.ends();
        if next <= low || next >= high {
            break;
        }
        let node = 1 + bucket.min(14) * 2 + usize::from(up);
        if halves.halve(next, Some(node)) != up {
            break;
        }
        edge = next;
        if bucket > 0 {
            width *= 2;
        }
        bucket += 1;
    }

    let mut halving = 0;
    loop {
        let (low, high) = halves.ends();
        if high - low <= 1 {
            return;
        }
        let middle = (low + high) / 2;
        if halving >= H::CORRECTED && high - low <= fine {
            halves.halve_evenly(middle);
            continue;
        }
        let node = 32 + halving * 8 + bucket.min(3) * 2 + usize::from(up);
        halves.halve(middle, (halving < H::CORRECTED).then_some(node));
        halving += 1;
    }
}

/// Width of the first bucket beside the base, in bins: a power of two near 0.6 scales.
pub fn first_bucket(scale: f32) -> i64 {
    // The factor is 0.6 * sqrt(2): this selects the nearest power on a logarithmic scale.
    ((scale * 0.84853) as u32).checked_ilog2().map_or(1, |octave| 1 << octave)
}

/// The state of halving one range, with `P` predictors and `X` views of references.
pub struct Halving<'a, C, const P: usize, const X: usize> {
    pub coder: &'a mut C,
    pub shape: &'a ErrorShape,
    pub tables: &'static Logistic,
    /// Ranges are below 2^`range_bits`.
    pub range_bits: u32,
    pub bins: Bins,
    pub mixture: &'a Mixture<P, 1>,
    pub predicted: Predicted<P, 1>,
    pub bits: &'a mut RangeBits,
    /// The weight set of the first node.
    pub first_set: usize,
    /// The context of each view.
    pub views: [usize; VIEWS],
    pub reference_counters: &'a mut [Vec<Counter>; X],
    pub reference_views: [usize; X],
    /// The encoder's bin.
    pub bin: i64,
    /// The remaining bins.
    pub interval: Interval<P, 1>,
    /// The mixture's log odds for the last halves, upper against lower.
    pub odds: f32,
}

impl<C: BitCoder, const P: usize, const X: usize> Halving<'_, C, P, X> {
    /// Codes the bin of the range.
    #[inline]
    pub fn code(&mut self) {
        let scale = self.mixture.scale_of_fit(&self.predicted);
        code_bin(self, self.bins.central, first_bucket(scale / self.bins.width as f32));
    }

    /// Codes a bit from the log odds of the mixture and of the counters.
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

impl<C: BitCoder, const P: usize, const X: usize> Halves for Halving<'_, C, P, X> {
    const CORRECTED: usize = 1;

    #[inline]
    fn ends(&self) -> (i64, i64) {
        (self.interval.low, self.interval.high)
    }

    #[inline]
    fn halve_evenly(&mut self, middle: i64) {
        self.odds *= 0.5;
        let interval = &mut self.interval;
        if self.coder.code(self.bin >= middle, self.tables.squash(self.odds)) {
            interval.low = middle;
        } else {
            interval.high = middle;
        }
    }

    #[inline]
    fn halve(&mut self, middle: i64, node: Option<usize>) -> bool {
        let start = self.bins.start(middle, self.range_bits);
        let below_middle = self.mixture.below(self.shape, &self.predicted, start, self.range_bits);
        let [odds] = self.interval.split(&below_middle, self.tables);
        self.odds = odds;
        let bit = self.bin >= middle;
        let bit = match node {
            None => self.coder.code(bit, self.tables.squash(odds)),
            Some(node) => self.code_corrected(node, odds, bit),
        };
        self.interval.cut(bit, middle, &below_middle);
        bit
    }
}
