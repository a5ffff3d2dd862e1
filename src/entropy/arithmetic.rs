//! The binary arithmetic coder: a 64-bit interval, 16-bit probabilities, four bytes shifted out at a time.
//! The decoder keeps the position of its number within the interval (Martin's range coder), so that a bit
//! takes one multiplication and one comparison; the encoder propagates carries into the bytes that it has
//! written. FORMAT.md 5.1.

use std::hint::select_unpredictable;

/// Codes binary decisions in one direction or the other.
pub trait BitCoder: Default {
    /// True if this side knows the bits. A decoder's models must not read the data that is being decoded.
    const ENCODES: bool;

    /// Codes one bit, which is 1 with probability `p` / 65536, 1 <= `p` <= 65535. The encoder writes `bit`;
    /// the decoder ignores it. Both return the bit.
    fn code(&mut self, bit: bool, p: u32) -> bool;

    /// Codes the lowest `bits` bits of `value`, each equally likely to be 0 or 1: `PLAIN_BITS` at a time.
    fn code_plain(&mut self, value: u64, bits: u32) -> u64 {
        let mut read = 0;
        let mut left = bits;
        while left > 0 {
            let count = left.min(PLAIN_BITS);
            left -= count;
            read = read << count | self.code_part(value >> left & ((1 << count) - 1), count);
        }
        read
    }

    /// Whether a decoder has read further past the end of its bytes than any encoder's output allows, so that
    /// the bits it returns are meaningless. Loops over decoded data check this from time to time, so that a
    /// few bytes cannot cause much work.
    fn is_exhausted(&self) -> bool {
        false
    }

    /// An upper limit of the number of bits that a decoder can still return before it is exhausted, however
    /// likely they are.
    fn most_bits(&self) -> u64 {
        u64::MAX
    }

    /// Codes one of 2^`bits` equally likely parts of the interval; `bits` is at most `PLAIN_BITS`.
    fn code_part(&mut self, part: u64, bits: u32) -> u64;
}

/// The largest number of plain bits that are coded at once.
const PLAIN_BITS: u32 = 16;

/// The largest number of zero bytes that are dropped from the end.
const MOST_ZEROS: usize = 64;

/// The likeliest bit takes 1.44 / 65536 bits, so a byte holds fewer bits than this.
const BITS_A_BYTE: u64 = 1 << 19;

/// A narrower interval is widened by four bytes. No bit and no part makes it narrower than 2^16.
const NARROWEST: u64 = 1 << 32;

/// The width of the part of the interval that codes a 1: the lower one.
#[inline(always)]
fn width_of_one(width: u64, p: u32) -> u64 {
    (width >> 16) * u64::from(p)
}

/// Writes bits.
pub struct ArithmeticEncoder {
    /// The lower end of the interval, relative to the bytes already written.
    low: u64,
    width: u64,
    out: Vec<u8>,
}

impl Default for ArithmeticEncoder {
    fn default() -> Self {
        ArithmeticEncoder { low: 0, width: u64::MAX, out: Vec::new() }
    }
}

impl ArithmeticEncoder {
    /// The coded bytes. Up to 64 trailing zeros are dropped, as the decoder reads zeros past the end.
    pub fn finish(mut self) -> Vec<u8> {
        // The number inside the interval that ends in the most zeros; 2^64 is a carry followed by zeros.
        let (low, end) = (u128::from(self.low), u128::from(self.low) + u128::from(self.width));
        let rounded = |bits: u32| low.next_multiple_of(1 << bits);
        let number = (0..u64::BITS).rev().map(rounded).find(|&number| number < end).unwrap_or(low);
        if number >> u64::BITS > 0 {
            self.carry();
        }
        self.out.extend_from_slice(&(number as u64).to_be_bytes());
        let zeros = self.out.iter().rev().take(MOST_ZEROS).take_while(|&&byte| byte == 0).count();
        self.out.truncate(self.out.len() - zeros);
        self.out
    }

    /// Keeps `width` of the interval, from `from` on.
    #[inline(always)]
    fn narrow(&mut self, from: u64, width: u64) {
        let (low, is_over) = self.low.overflowing_add(from);
        (self.low, self.width) = (low, width);
        if is_over {
            self.carry();
        }
        if width < NARROWEST {
            self.out.extend_from_slice(&((low >> 32) as u32).to_be_bytes());
            (self.low, self.width) = (low << 32, width << 32);
        }
    }

    /// Adds 1 to the bytes already written, which form a fraction less than 1.
    #[cold]
    fn carry(&mut self) {
        for byte in self.out.iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte > 0 {
                return;
            }
        }
    }
}

impl BitCoder for ArithmeticEncoder {
    const ENCODES: bool = true;

    #[inline(always)]
    fn code(&mut self, bit: bool, p: u32) -> bool {
        let one = width_of_one(self.width, p);
        if bit {
            self.narrow(0, one);
        } else {
            self.narrow(one, self.width - one);
        }
        bit
    }

    fn code_part(&mut self, part: u64, bits: u32) -> u64 {
        let width = self.width >> bits;
        self.narrow(part * width, width);
        part
    }
}

/// Reads bits. Past the end of the bytes it reads zeros, so any bytes decode to something.
pub struct ArithmeticDecoder<'a> {
    /// The position of the coded number relative to the lower end of the interval. In damaged data it may be
    /// beyond the upper end.
    place: u64,
    width: u64,
    // A struct of its own, so that a compiler can keep the numbers above in registers.
    words: Words<'a>,
}

/// The bytes that are left.
#[derive(Default)]
struct Words<'a> {
    bytes: &'a [u8],
    /// Number of zeros read past the end.
    behind: usize,
}

impl Words<'_> {
    /// The next four bytes.
    #[inline(always)]
    fn next(&mut self) -> u64 {
        let Some((word, rest)) = self.bytes.split_first_chunk() else { return self.last() };
        self.bytes = rest;
        u32::from_be_bytes(*word).into()
    }

    /// The next word at the end of the bytes, padded with zeros.
    #[cold]
    fn last(&mut self) -> u64 {
        let mut word = [0; 4];
        let left = self.bytes.len();
        word[..left].copy_from_slice(self.bytes);
        self.bytes = &[];
        self.behind = self.behind.saturating_add(word.len() - left);
        u32::from_be_bytes(word).into()
    }
}

/// A decoder at the end of an empty input.
impl Default for ArithmeticDecoder<'_> {
    fn default() -> Self {
        ArithmeticDecoder { place: 0, width: u64::MAX, words: Words::default() }
    }
}

impl<'a> ArithmeticDecoder<'a> {
    /// Starts at the first of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut words = Words { bytes, behind: 0 };
        let place = words.next() << 32 | words.next();
        ArithmeticDecoder { place, words, ..ArithmeticDecoder::default() }
    }

    /// Keeps `width` of the interval, from `from` on.
    #[inline(always)]
    fn narrow(&mut self, from: u64, width: u64) {
        (self.place, self.width) = (self.place - from, width);
        if width < NARROWEST {
            (self.place, self.width) = (self.place << 32 | self.words.next(), width << 32);
        }
    }
}

impl BitCoder for ArithmeticDecoder<'_> {
    const ENCODES: bool = false;

    fn is_exhausted(&self) -> bool {
        self.words.behind > MOST_ZEROS
    }

    fn most_bits(&self) -> u64 {
        // The bytes that are still read, a word at a time, and those in the interval.
        let bytes = self.words.bytes.len() + (MOST_ZEROS + 4 + 8).saturating_sub(self.words.behind);
        (bytes as u64).saturating_mul(BITS_A_BYTE)
    }

    #[inline(always)]
    fn code(&mut self, _bit: bool, p: u32) -> bool {
        let one = width_of_one(self.width, p);
        let bit = self.place < one;
        let from = select_unpredictable(bit, 0, one);
        self.narrow(from, select_unpredictable(bit, one, self.width - one));
        bit
    }

    fn code_part(&mut self, _part: u64, bits: u32) -> u64 {
        let width = self.width >> bits;
        // No encoder's number is in the remainder of the division; in damaged data it counts as the last
        // part.
        let part = (self.place / width).min((1 << bits) - 1);
        self.narrow(part * width, width);
        part
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
            // Always the likeliest bit, which is the cheapest.
            while !decoder.is_exhausted() {
                let likely = decoder.place < width_of_one(decoder.width, 65535);
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
