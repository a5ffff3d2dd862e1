//! Coding one range by repeated halving. FORMAT.md 8.6, "Coding".
//!
//! In near-lossless coding only the bin of a range is coded. The bins are centred on the prediction, as in
//! JPEG-LS (ITU-T T.87, A.4), so that accurately predicted ranges cost next to nothing. FORMAT.md 8.6,
//! "Bins".

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

/// The ranges that a frame may have, and how accurately they are coded.
#[derive(Clone, Copy, Debug)]
pub struct RangeScale {
    /// Ranges are from 1 to 2^`bits` - 1 steps.
    pub bits: u32,
    /// The width of a bin in steps; 1: ranges are coded exactly.
    pub bin: u32,
}

impl RangeScale {
    /// Bins such that `base`, a range in steps, is in the middle of one.
    #[inline]
    pub fn bins_around(self, base: i64) -> Bins {
        Bins::around(base, i64::from(self.bin))
    }
}

/// Bins of equal width. Bin `i` holds the ranges from `origin + i * width` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bins {
    /// Bin width in steps. 1: every range has its own bin, whose number is the range.
    pub width: i64,
    /// Offset of the bins, 0 to `width` - 1 steps.
    origin: i64,
    /// The bin around the prediction.
    pub central: i64,
}

impl Bins {
    /// Creates bins such that `base`, a range in steps, is in the middle of one.
    #[inline]
    fn around(base: i64, width: i64) -> Self {
        if width == 1 {
            // The same result without divisions.
            return Bins { width, origin: 0, central: base };
        }
        let start = base - width / 2;
        Bins { width, origin: start.rem_euclid(width), central: start.div_euclid(width) }
    }

    /// The bin of a range.
    #[inline]
    pub fn of(&self, range: i64) -> i64 {
        if self.width == 1 { range } else { (range - self.origin).div_euclid(self.width) }
    }

    /// The first bin that contains ranges from 1 to 2^`range_bits` - 1, and the bin after the last.
    pub fn all(&self, range_bits: u32) -> (i64, i64) {
        (self.of(1), self.of((1 << range_bits) - 1) + 1)
    }

    /// The start of a bin, limited to 1 to 2^`range_bits`.
    #[inline]
    pub fn start(&self, bin: i64, range_bits: u32) -> i64 {
        (self.origin + bin * self.width).clamp(1, 1 << range_bits)
    }

    /// The range that represents a bin, 1 to 2^`range_bits` - 1 steps: the middle one, or the upper of the
    /// two middle ones.
    #[inline]
    pub fn middle(&self, bin: i64, range_bits: u32) -> i64 {
        (self.origin + bin * self.width + self.width / 2).clamp(1, (1 << range_bits) - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_range_is_near_the_middle_of_its_bin() {
        for (width, base) in [(1, 7), (2, 7), (5, 1), (10, 3), (10, 100), (64, 65_000)] {
            let bins = Bins::around(base, width);
            assert_eq!(bins.of(base), bins.central);
            let (first, end) = bins.all(16);
            for range in (1..200).chain(65_400..65_536) {
                let bin = bins.of(range);
                assert!((first..end).contains(&bin));
                assert!(bins.start(bin, 16) <= range && range < bins.start(bin + 1, 16), "{bins:?} {range}");
                let off = range - bins.middle(bin, 16);
                assert!((-(width / 2)..=(width - 1) / 2).contains(&off), "{bins:?} {range}");
            }
        }
    }

    #[test]
    fn bins_of_one_range_are_the_ranges() {
        let bins = Bins::around(345, 1);
        assert_eq!((bins.all(16), bins.central), ((1, 65_536), 345));
        assert!(
            [1, 20, 65_535].iter().all(|&range| bins.of(range) == range && bins.middle(range, 16) == range)
        );
    }
}
