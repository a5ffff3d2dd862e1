//! The binary arithmetic coder: 32-bit interval, 16-bit probabilities, bytes shifted out at the top (the
//! carry-free form of Mahoney's lpaq).

/// Codes binary decisions in one direction or the other.
pub trait BitCoder {
    /// True if this side knows the bits. A decoder's models must not read the data that they are filling.
    const ENCODES: bool;

    /// Codes one bit that is 1 with probability `p` / 65536, 1 <= `p` <= 65535. The encoder writes
    /// `bit`; the decoder does not look at it. Both return the bit.
    fn code(&mut self, bit: bool, p: u32) -> bool;

    /// Codes the lowest `bits` bits of `value`, each equally likely to be 0 or 1: `PLAIN_BITS` at a time
    /// where the interval is wide enough, otherwise one by one.
    fn code_plain(&mut self, value: u64, bits: u32) -> u64 {
        let mut read = 0;
        let mut left = bits;
        while left > 0 {
            let count = left.min(PLAIN_BITS);
            left -= count;
            let part = (value >> left) as u32 & ((1 << count) - 1);
            let part = self.code_even(part, count).unwrap_or_else(|| {
                (0..count)
                    .rev()
                    .fold(0, |read, i| read << 1 | u32::from(self.code(part >> i & 1 == 1, 1 << 15)))
            });
            read = read << count | u64::from(part);
        }
        read
    }

    /// Whether a decoder has read farther past the end of its bytes than any encoder's output allows, so that
    /// what it returns is meaningless. Loops over decoded data check this from time to time, so that a few
    /// bytes cannot cause much work.
    fn is_exhausted(&self) -> bool {
        false
    }

    /// An upper limit of the bits that a decoder can still return before it is exhausted, however likely they
    /// are.
    fn most_bits(&self) -> u64 {
        u64::MAX
    }

    /// Codes one of 2^`bits` equally likely parts of the interval. `None`, with nothing coded, if the
    /// interval is too narrow.
    fn code_even(&mut self, part: u32, bits: u32) -> Option<u32>;
}

/// The most plain bits that are coded at once.
const PLAIN_BITS: u32 = 12;

/// At most this many zeros are dropped from the end of the bytes.
const MOST_ZEROS: usize = 64;

/// The likeliest bit takes 1.44 / 65536 bits, so a byte holds fewer bits than this.
const BITS_A_BYTE: u64 = 1 << 19;

/// The width of each of 2^`bits` equal parts of an interval; `None` if it would be 0.
fn part_width(low: u32, high: u32, bits: u32) -> Option<u32> {
    Some((high - low) >> bits).filter(|&width| width > 0)
}

/// Where the interval is split: below is a 1, above a 0.
fn split(low: u32, high: u32, p: u32) -> u32 {
    low + ((u64::from(high - low) * u64::from(p)) >> 16) as u32
}

/// Writes bits.
pub struct ArithmeticEncoder {
    low: u32,
    high: u32,
    out: Vec<u8>,
}

impl Default for ArithmeticEncoder {
    fn default() -> Self {
        ArithmeticEncoder { low: 0, high: u32::MAX, out: Vec::new() }
    }
}

impl ArithmeticEncoder {
    /// The coded bytes. Up to 64 trailing zeros are dropped, as the decoder reads zeros past the end.
    pub fn finish(mut self) -> Vec<u8> {
        // The shortest number inside the interval, with as many bytes as it needs.
        let shortest =
            (0..4).map(|bytes| ceiling(self.low, 8 * (4 - bytes))).find(|&v| v <= u64::from(self.high));
        let value = shortest.unwrap_or(u64::from(self.low)) as u32;
        self.out.extend_from_slice(&value.to_be_bytes());
        let zeros = self.out.iter().rev().take(MOST_ZEROS).take_while(|&&byte| byte == 0).count();
        self.out.truncate(self.out.len() - zeros);
        self.out
    }
}

/// `value` rounded up to a multiple of 2^`bits`.
fn ceiling(value: u32, bits: u32) -> u64 {
    u64::from(value).next_multiple_of(1 << bits)
}

impl ArithmeticEncoder {
    /// Writes the leading bytes that both ends of the interval share.
    #[inline]
    fn shift_out(&mut self) {
        while (self.low ^ self.high) >> 24 == 0 {
            self.out.push((self.high >> 24) as u8);
            self.low <<= 8;
            self.high = self.high << 8 | 0xff;
        }
    }
}

impl BitCoder for ArithmeticEncoder {
    const ENCODES: bool = true;

    #[inline]
    fn code(&mut self, bit: bool, p: u32) -> bool {
        let middle = split(self.low, self.high, p);
        if bit {
            self.high = middle;
        } else {
            self.low = middle + 1;
        }
        self.shift_out();
        bit
    }

    fn code_even(&mut self, part: u32, bits: u32) -> Option<u32> {
        let width = part_width(self.low, self.high, bits)?;
        self.low += part * width;
        self.high = self.low + (width - 1);
        self.shift_out();
        Some(part)
    }
}

/// Reads bits. Past the end of the bytes it reads zeros, so any bytes decode to something.
pub struct ArithmeticDecoder<'a> {
    low: u32,
    high: u32,
    code: u32,
    /// Zeros read past the end.
    behind: usize,
    bytes: std::slice::Iter<'a, u8>,
}

impl<'a> ArithmeticDecoder<'a> {
    /// Starts at the first of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder =
            ArithmeticDecoder { low: 0, high: u32::MAX, code: 0, behind: 0, bytes: bytes.iter() };
        for _ in 0..4 {
            decoder.code = decoder.code << 8 | decoder.next_byte();
        }
        decoder
    }

    /// Reads one byte for each leading byte that both ends of the interval share.
    #[inline]
    fn shift_in(&mut self) {
        while (self.low ^ self.high) >> 24 == 0 {
            self.low <<= 8;
            self.high = self.high << 8 | 0xff;
            self.code = self.code << 8 | self.next_byte();
        }
    }

    fn next_byte(&mut self) -> u32 {
        match self.bytes.next() {
            Some(&byte) => u32::from(byte),
            None => {
                self.behind = self.behind.saturating_add(1);
                0
            }
        }
    }
}

impl BitCoder for ArithmeticDecoder<'_> {
    const ENCODES: bool = false;

    /// Four bytes are read ahead.
    fn is_exhausted(&self) -> bool {
        self.behind > MOST_ZEROS + 4
    }

    fn most_bits(&self) -> u64 {
        let bytes = self.bytes.len() + (MOST_ZEROS + 5).saturating_sub(self.behind);
        (bytes as u64).saturating_mul(BITS_A_BYTE)
    }

    #[inline]
    fn code(&mut self, _bit: bool, p: u32) -> bool {
        let middle = split(self.low, self.high, p);
        let bit = self.code <= middle;
        if bit {
            self.high = middle;
        } else {
            self.low = middle + 1;
        }
        self.shift_in();
        bit
    }

    fn code_even(&mut self, _part: u32, bits: u32) -> Option<u32> {
        let width = part_width(self.low, self.high, bits)?;
        // No encoder's number lies in the remainder of the division; in damaged data it counts as the last
        // part.
        let part = ((self.code - self.low) / width).min((1 << bits) - 1);
        self.low += part * width;
        self.high = self.low + (width - 1);
        self.code = self.code.min(self.high);
        self.shift_in();
        Some(part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_come_back_whatever_their_probabilities(
            bits in proptest::collection::vec((any::<bool>(), 1u32..65536), 0..2000)
        ) {
            let mut encoder = ArithmeticEncoder::default();
            for &(bit, p) in &bits {
                encoder.code(bit, p);
            }
            let bytes = encoder.finish();
            let mut decoder = ArithmeticDecoder::new(&bytes);
            for &(bit, p) in &bits {
                prop_assert_eq!(decoder.code(false, p), bit);
                prop_assert!(!decoder.is_exhausted());
            }
        }

        #[test]
        fn few_bytes_give_no_more_bits_than_they_may(bytes in proptest::collection::vec(any::<u8>(), 0..3)) {
            let mut decoder = ArithmeticDecoder::new(&bytes);
            let most = decoder.most_bits();
            let mut bits = 0u64;
            // Always the likeliest bit, which takes the least.
            while !decoder.is_exhausted() {
                let likely = decoder.code <= split(decoder.low, decoder.high, 65535);
                decoder.code(false, if likely { 65535 } else { 1 });
                bits += 1;
            }
            prop_assert!(bits <= most, "{bits} of {most}");
        }
    }

    #[test]
    fn long_runs_of_zeros_are_not_all_left_off() {
        for numbers in [0, 10, 1000] {
            let mut encoder = ArithmeticEncoder::default();
            for _ in 0..numbers {
                encoder.code_plain(0, 32);
            }
            let bytes = encoder.finish();
            let mut decoder = ArithmeticDecoder::new(&bytes);
            assert!((0..numbers).all(|_| decoder.code_plain(0, 32) == 0 && !decoder.is_exhausted()));
        }
    }

    proptest! {
        #[test]
        fn plain_numbers_come_back_between_skewed_bits(
            numbers in proptest::collection::vec((any::<u64>(), 0u32..=63, 1u32..65536), 0..500)
        ) {
            let number = |value: u64, bits: u32| value & ((1u64 << bits) - 1);
            let mut encoder = ArithmeticEncoder::default();
            for &(value, bits, p) in &numbers {
                encoder.code_plain(number(value, bits), bits);
                encoder.code(value & 1 == 1, p);
            }
            let bytes = encoder.finish();
            let mut decoder = ArithmeticDecoder::new(&bytes);
            for &(value, bits, p) in &numbers {
                prop_assert_eq!(decoder.code_plain(0, bits), number(value, bits));
                prop_assert_eq!(decoder.code(false, p), value & 1 == 1);
            }
        }

        #[test]
        fn any_bytes_decode_to_something(bytes: Vec<u8>, sizes in proptest::collection::vec(0u32..=63, 0..300)) {
            let mut decoder = ArithmeticDecoder::new(&bytes);
            for bits in sizes {
                prop_assert!(decoder.code_plain(0, bits) < 1 << bits);
                decoder.code(false, 1);
            }
        }
    }

    #[test]
    fn likely_bits_take_next_to_nothing() {
        let mut encoder = ArithmeticEncoder::default();
        for _ in 0..10_000 {
            encoder.code(true, 65535);
        }
        assert!(encoder.finish().len() <= 2);
    }
}
