//! The binary arithmetic coder: 32-bit interval, 16-bit probabilities, bytes out of the top.
//! (The carry-free form of Mahoney's lpaq.)

/// Codes binary decisions in one direction or the other.
pub trait BitCoder {
    /// True if this side knows the bits; the decoder's side may then not look at the data it fills.
    const ENCODES: bool;

    /// Codes one bit that is 1 with probability `p` / 65536, 1 <= `p` <= 65535. The encoder writes
    /// `bit`; the decoder does not look at it. Both return the bit.
    fn code(&mut self, bit: bool, p: u32) -> bool;

    /// Codes the lowest `bits` bits of `value`, each as likely to be 0 as 1, `PLAIN_BITS` at a time
    /// where the interval is wide enough, else one by one.
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

    /// Codes one of 2^`bits` equally likely parts of the interval. None, and nothing coded, if it is too narrow.
    fn code_even(&mut self, part: u32, bits: u32) -> Option<u32>;
}

/// The most bits that are coded at once.
const PLAIN_BITS: u32 = 12;

/// The width of each of 2^`bits` equal parts of an interval; None if they would be of no width.
fn part_width(low: u32, high: u32, bits: u32) -> Option<u32> {
    Some((high - low) >> bits).filter(|&width| width > 0)
}

/// Where the interval is split: 1 below, 0 above.
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
    /// The coded bytes. Trailing zeros are left off: the decoder reads zeros behind the end.
    pub fn finish(mut self) -> Vec<u8> {
        // The shortest number inside the interval, as many bytes of it as are needed.
        let shortest =
            (0..4).map(|bytes| ceiling(self.low, 8 * (4 - bytes))).find(|&v| v <= u64::from(self.high));
        let value = shortest.unwrap_or(u64::from(self.low)) as u32;
        self.out.extend_from_slice(&value.to_be_bytes());
        while self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

/// `value` rounded up to a multiple of 2^`bits`.
fn ceiling(value: u32, bits: u32) -> u64 {
    u64::from(value).next_multiple_of(1 << bits)
}

impl ArithmeticEncoder {
    /// Puts out the bytes that both ends share.
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

/// Reads bits. Behind the end of the bytes it reads zeros: any bytes decode to something.
pub struct ArithmeticDecoder<'a> {
    low: u32,
    high: u32,
    code: u32,
    bytes: std::slice::Iter<'a, u8>,
}

impl<'a> ArithmeticDecoder<'a> {
    /// Starts at the first of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = ArithmeticDecoder { low: 0, high: u32::MAX, code: 0, bytes: bytes.iter() };
        for _ in 0..4 {
            decoder.code = decoder.code << 8 | decoder.next_byte();
        }
        decoder
    }

    /// Takes in a byte for each that both ends share.
    #[inline]
    fn shift_in(&mut self) {
        while (self.low ^ self.high) >> 24 == 0 {
            self.low <<= 8;
            self.high = self.high << 8 | 0xff;
            self.code = self.code << 8 | self.next_byte();
        }
    }

    fn next_byte(&mut self) -> u32 {
        self.bytes.next().map_or(0, |&byte| u32::from(byte))
    }
}

impl BitCoder for ArithmeticDecoder<'_> {
    const ENCODES: bool = false;

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
        // No encoder's number lies in what the division leaves over: altered ones count as the last part.
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
            }
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
