//! The binary arithmetic coder: 32-bit interval, 16-bit probabilities, bytes out of the top.
//! (The carry-free form of Mahoney's lpaq.)

/// Codes binary decisions in one direction or the other.
pub trait BitCoder {
    /// True if this side knows the bits; the decoder's side may then not look at the data it fills.
    const ENCODES: bool;

    /// Codes one bit that is 1 with probability `p` / 65536, 1 <= `p` <= 65535. The encoder writes
    /// `bit`; the decoder does not look at it. Both return the bit.
    fn code(&mut self, bit: bool, p: u32) -> bool;

    /// Codes the lowest `bits` bits of `value`, each equally likely to be 0 or 1.
    fn code_plain(&mut self, value: u64, bits: u32) -> u64 {
        (0..bits).rev().fold(0, |read, i| read << 1 | u64::from(self.code(value >> i & 1 == 1, 1 << 15)))
    }
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
        while (self.low ^ self.high) >> 24 == 0 {
            self.out.push((self.high >> 24) as u8);
            self.low <<= 8;
            self.high = self.high << 8 | 0xff;
        }
        bit
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
        while (self.low ^ self.high) >> 24 == 0 {
            self.low <<= 8;
            self.high = self.high << 8 | 0xff;
            self.code = self.code << 8 | self.next_byte();
        }
        bit
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

    #[test]
    fn likely_bits_take_next_to_nothing() {
        let mut encoder = ArithmeticEncoder::default();
        for _ in 0..10_000 {
            encoder.code(true, 65535);
        }
        assert!(encoder.finish().len() <= 2);
    }
}
