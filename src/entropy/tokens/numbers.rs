//! Numbers as tokens: each number below [`DIRECT`] has a token of its own; a larger one shares a token with
//! all numbers of the same octave that agree in the two bits below the highest. FORMAT.md 5.5, "Reading".

/// Numbers below this have a token of their own.
const DIRECT: u64 = 32;
const DIRECT_BITS: u32 = DIRECT.ilog2();
/// Bits below the highest that a token determines.
const MANTISSA_BITS: u32 = 2;
/// The highest octave that any token stands for.
const HIGHEST_OCTAVE: u32 = 59;

/// A number's token, and the bits that the token does not determine.
pub struct NumberToken {
    pub token: u8,
    /// The least number with this token.
    pub base: u64,
    /// The number of bits that the token does not determine.
    pub low_bits: u32,
    /// These bits.
    pub rest: u64,
}

impl NumberToken {
    /// The token of a number below 2^60.
    #[inline]
    pub fn of(value: u64) -> Self {
        if value < DIRECT {
            return NumberToken { token: value as u8, base: value, low_bits: 0, rest: 0 };
        }
        let octave = value.ilog2().min(HIGHEST_OCTAVE);
        let low_bits = octave - MANTISSA_BITS;
        let mantissa = value >> low_bits & ((1 << MANTISSA_BITS) - 1);
        let token = DIRECT + (u64::from(octave - DIRECT_BITS) << MANTISSA_BITS) + mantissa;
        NumberToken {
            token: token as u8,
            base: value >> low_bits << low_bits,
            low_bits,
            rest: value & ((1 << low_bits) - 1),
        }
    }

    /// A token without the remaining bits, as a decoder reads it first. Invalid tokens count as the last
    /// valid one.
    #[inline]
    pub fn from_token(token: u8) -> Self {
        let value = u64::from(token);
        if value < DIRECT {
            return NumberToken { token, base: value, low_bits: 0, rest: 0 };
        }
        let octave = (DIRECT_BITS + ((value - DIRECT) >> MANTISSA_BITS) as u32).min(HIGHEST_OCTAVE);
        let low_bits = octave - MANTISSA_BITS;
        let mantissa = value & ((1 << MANTISSA_BITS) - 1);
        NumberToken { token, base: (1 << MANTISSA_BITS | mantissa) << low_bits, low_bits, rest: 0 }
    }
}

/// The least number with this token, and the number of numbers with it.
pub fn numbers_of_token(token: u8) -> (u64, u64) {
    let NumberToken { base, low_bits, .. } = NumberToken::from_token(token);
    (base, 1 << low_bits)
}
