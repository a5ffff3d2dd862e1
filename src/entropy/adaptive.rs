//! Adaptive models: of a single bit, and of integers of any size. FORMAT.md 5.2 to 5.4.

use super::BitCoder;
use crate::ground::varint::{unzigzag, zigzag};

/// The probability of a bit in one context: a running mean that adapts fast at first.
#[derive(Clone, Copy, Debug)]
pub struct AdaptiveBit {
    /// Probability of a 1, in 1/65536.
    p: u16,
    /// Number of bits seen, up to the value at which the rate stops decreasing.
    seen: u8,
}

/// The lowest rate is one in 64.
const MOST_SEEN: u8 = 62;

/// For each count of bits seen: 2^32 / (count + 2), rounded up. Multiplication by it divides a u16 exactly.
static RATES: [u64; MOST_SEEN as usize + 1] = {
    let mut rates = [0; MOST_SEEN as usize + 1];
    let mut seen = 0;
    while seen < rates.len() {
        rates[seen] = (1u64 << 32).div_ceil(seen as u64 + 2);
        seen += 1;
    }
    rates
};

impl Default for AdaptiveBit {
    fn default() -> Self {
        AdaptiveBit { p: 1 << 15, seen: 0 }
    }
}

impl AdaptiveBit {
    /// Codes a bit and learns from it.
    #[inline]
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, bit: bool) -> bool {
        let bit = coder.code(bit, u32::from(self.p).clamp(16, 65520));
        let left = if bit { u16::MAX - self.p } else { self.p };
        let moved = (u64::from(left) * RATES[usize::from(self.seen.min(MOST_SEEN))] >> 32) as u16;
        self.p = if bit { self.p + moved } else { self.p - moved };
        self.seen = (self.seen + 1).min(MOST_SEEN);
        bit
    }
}

/// Codes a symbol below 2^`bits` from the top bit down, each bit in the context of the bits above it. `nodes`
/// has 2^`bits` contexts, the first of which is unused.
fn code_symbol<C: BitCoder>(nodes: &mut [AdaptiveBit], coder: &mut C, bits: u32, symbol: u32) -> u32 {
    let mut node = 1;
    for i in (0..bits).rev() {
        node = node << 1 | usize::from(nodes[node].code(coder, symbol >> i & 1 == 1));
    }
    node as u32 - (1 << bits)
}

/// Codes an integer whose length in bits, 63 at most, is known: the two bits below the highest by `nodes`, of
/// which there are four, and the others as plain bits.
pub fn code_below_highest<C: BitCoder>(
    nodes: &mut [AdaptiveBit],
    coder: &mut C,
    length: u32,
    value: u64,
) -> u64 {
    if length < 2 {
        return u64::from(length);
    }
    let below = length - 1;
    let modelled = below.min(2);
    // A length of 2 has one bit below the highest: the model's upper bit stays 0.
    let top = (value >> (below - modelled)) & ((1 << modelled) - 1);
    let top = u64::from(code_symbol(nodes, coder, 2, top as u32)) & ((1 << modelled) - 1);
    let rest = below - modelled;
    let low = coder.code_plain(value & ((1 << rest) - 1), rest);
    ((1 << modelled) | top) << rest | low
}

/// A model of integers of up to 63 bits: the length in bits as a symbol, the two bits below the highest in
/// the context of the length, and the other bits, which are nearly random, as plain bits.
#[derive(Clone, Debug)]
pub struct IntegerModel {
    /// The contexts of the length, followed for each length by those of the two bits below the highest, in
    /// one allocation.
    nodes: Vec<AdaptiveBit>,
}

/// Number of contexts of the length, in bits, of an integer.
const LENGTHS: usize = 64;

impl Default for IntegerModel {
    fn default() -> Self {
        IntegerModel { nodes: vec![AdaptiveBit::default(); LENGTHS + 4 * LENGTHS] }
    }
}

impl IntegerModel {
    /// Codes an integer below 2^63.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, value: u64) -> u64 {
        let (lengths, tops) = self.nodes.split_at_mut(LENGTHS);
        let length = code_symbol(lengths, coder, 6, 64 - value.leading_zeros());
        code_below_highest(&mut tops[4 * length as usize..][..4], coder, length, value)
    }

    /// Codes an integer from -2^62 to 2^62 - 1, those near 0 as the shortest.
    pub fn code_signed<C: BitCoder>(&mut self, coder: &mut C, value: i64) -> i64 {
        // While decoding, `value` may be any number.
        unzigzag(self.code(coder, zigzag(value) & (u64::MAX >> 1)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ArithmeticDecoder, ArithmeticEncoder};
    use super::*;

    #[test]
    fn rates_divide_exactly() {
        for (parts, rate) in (2..).zip(RATES) {
            assert!((0..=u64::from(u16::MAX)).all(|left| left * rate >> 32 == left / parts), "{parts}");
        }
    }

    #[test]
    fn integers_of_every_length_come_back() {
        let values: Vec<u64> = (0..63)
            .flat_map(|shift| [1u64 << shift, (1 << shift) - 1, (1 << shift) | (1 << shift) / 3])
            .collect();
        let mut encoder = ArithmeticEncoder::default();
        let mut model = IntegerModel::default();
        values.iter().for_each(|&v| assert_eq!(model.code(&mut encoder, v), v));
        let bytes = encoder.finish();
        let mut decoder = ArithmeticDecoder::new(&bytes);
        let mut model = IntegerModel::default();
        values.iter().for_each(|&v| assert_eq!(model.code(&mut decoder, 0), v));
    }
}
