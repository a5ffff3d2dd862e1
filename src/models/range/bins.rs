//! Bins of ranges, for near-lossless coding, where only the bin is coded. The bins are centred on the
//! prediction, as in JPEG-LS (ITU-T T.87, A.4), so that accurately predicted ranges cost next to nothing.
//! FORMAT.md 8.6, "Bins".

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
