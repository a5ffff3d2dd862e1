//! Rounding without a function call: the standard functions are slow where the processor has no instruction
//! for rounding or the compiler must not assume one.

/// Rounds to the nearest whole number, halves to even; for magnitudes below 2^51.
#[inline]
pub fn round_ties_even(value: f64) -> f64 {
    // At this magnitude neighbouring floats are 1 apart, so the addition rounds.
    const ONES: f64 = 6_755_399_441_055_744.0; // 1.5 * 2^52
    (value + ONES) - ONES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_rounds_as_the_standard_function_does() {
        for value in [0.0, 0.5, 1.5, 2.5, -0.5, -1.5, 0.49999999999999994, 1e12 + 0.5, -7.3, 123456.789] {
            assert_eq!(round_ties_even(value), value.round_ties_even());
        }
    }
}
