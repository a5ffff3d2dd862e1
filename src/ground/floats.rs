//! Floating-point values: rounding, and their order.
//!
//! Rounding is without a function call: the standard functions are slow where the processor has no
//! instruction for rounding or the compiler must not assume one.
//!
//! In ascending order, values are integers, their *ranks*: those of adjacent values differ by one, and -0.0
//! and 0.0 count as adjacent, the rank of 0.0 being 0. Values are passed as bits where every bit must be
//! preserved, since processors change the bits of some NaNs. FORMAT.md 3.4.

/// The square. Unlike that of `powi`, the result is the same everywhere.
#[inline(always)]
pub fn square(value: f64) -> f64 {
    value * value
}

/// Rounds to the nearest whole number, halves to even; for magnitudes below 2^51.
#[inline]
pub fn round_ties_even(value: f64) -> f64 {
    (value + ONES) - ONES
}

/// The nearest integer, halves to even; for magnitudes below 2^31. Unlike a conversion by `as`, it is one
/// vector instruction or two.
#[inline(always)]
pub fn nearest_integer(value: f64) -> i32 {
    // The low bits of the fraction.
    (value + ONES).to_bits() as i32
}

/// At this magnitude, 1.5 * 2^52, neighbouring floats are 1 apart, so that an addition rounds.
pub const ONES: f64 = 6_755_399_441_055_744.0;

/// The rank of a float32 value.
pub fn rank(value: f32) -> i64 {
    rank32(value.to_bits())
}

/// The inverse of [`rank`], for any integer; ranks of no float32 are truncated to 32 bits.
pub fn of_rank(rank: i64) -> f32 {
    f32::from_bits(bits_of_rank32(rank))
}

/// The rank of the float32 value with these bits.
pub fn rank32(bits: u32) -> i64 {
    let signed = bits as i32;
    i64::from(if signed < 0 { !(signed & i32::MAX) } else { signed })
}

/// The inverse of [`rank32`].
pub fn bits_of_rank32(rank: i64) -> u32 {
    let signed = rank as i32;
    (if signed < 0 { !signed | i32::MIN } else { signed }) as u32
}

/// The rank of the float64 value with these bits.
pub fn rank64(bits: u64) -> i64 {
    let signed = bits as i64;
    if signed < 0 { !(signed & i64::MAX) } else { signed }
}

/// The inverse of [`rank64`].
pub fn bits_of_rank64(rank: i64) -> u64 {
    (if rank < 0 { !rank | i64::MIN } else { rank }) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_rounds_as_the_standard_function_does() {
        for value in [0.0, 0.5, 1.5, 2.5, -0.5, -1.5, 0.49999999999999994, 1e12 + 0.5, -7.3, 123456.789] {
            assert_eq!(round_ties_even(value), value.round_ties_even());
        }
        for value in [0.0, 0.5, 1.5, 2.5, -0.5, -1.5, -7.3, 123456.789, 2_147_483_647.0, -2_147_483_648.0] {
            assert_eq!(f64::from(nearest_integer(value)), value.round_ties_even());
        }
    }
}
