//! Decimal numbers of a few digits, rounded as exact arithmetic would round them. Float64 arithmetic can
//! nearly always guarantee this, and is many times as fast as converting through text.

/// Powers of ten that float64 represents exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];
/// The largest number of significant digits supported.
pub const MOST_DIGITS: u32 = 9;

/// A number times a power of ten, rounded once.
#[inline]
fn scaled(value: f64, exponent: i32) -> Option<f64> {
    let power = *POWERS.get(exponent.unsigned_abs() as usize)?;
    Some(if exponent < 0 { value / power } else { value * power })
}

/// The integer of `digits` digits, 1 to [`MOST_DIGITS`], nearest to a positive number scaled by a power of
/// ten, and the decimal exponent of the number's first digit. None if float64 arithmetic cannot guarantee the
/// rounding.
pub fn significant(value: f64, digits: u32) -> Option<(u64, i32)> {
    /// More than the error of a product below 10^9.
    const ERROR: f64 = 1e-6;
    /// The decimal logarithm of 2, in units of 2^-12: accurate enough for the octaves of these values.
    const LOG10_2: i32 = 1233;
    const LOG10_2_BITS: u32 = 12;
    if !(1e-12..1e15).contains(&value) || !(1..=MOST_DIGITS).contains(&digits) {
        return None;
    }
    let (least, last) = (POWERS[digits as usize - 1], digits as i32 - 1);
    // The exponent of two. The exponent of ten estimated from it is right or one too small.
    let octave = (value.to_bits() >> 52) as i32 - 1023;
    let mut exponent = (octave * LOG10_2) >> LOG10_2_BITS;
    let mut number = scaled(value, last - exponent)?;
    if number >= 10.0 * least {
        exponent += 1;
        number = scaled(value, last - exponent)?;
    }
    let whole = number as u64;
    let rest = number - whole as f64;
    if (rest - 0.5).abs() < ERROR {
        return None;
    }
    let nearest = whole + u64::from(rest > 0.5);
    let least = least as u64;
    Some(if nearest == 10 * least { (least, exponent + 1) } else { (nearest, exponent) })
        .filter(|(number, _)| *number >= least)
}

/// The integer nearest to a number times 10^`decimals`, of two equally near ones the even one. The number is
/// not negative. None if the integer has more than 63 bits, or for more than 18 decimals.
pub fn fixed(value: f64, decimals: u32) -> Option<u64> {
    let power = 10u64.checked_pow(decimals).filter(|_| decimals <= 18)?;
    let (mantissa, exponent) = mantissa_and_exponent(value);
    // Less than 2^113.
    let product = u128::from(mantissa) * u128::from(power);
    let integer = match u32::try_from(-exponent) {
        Ok(shift @ 0..=113) => {
            let (whole, rest) = (product >> shift, product & ((1 << shift) - 1));
            let twice = rest << 1;
            let is_up = twice > 1 << shift || twice == 1 << shift && whole & 1 == 1;
            whole + u128::from(is_up)
        }
        Ok(_) => 0,
        Err(_) => product.checked_mul(1u128.checked_shl(exponent as u32)?)?,
    };
    u64::try_from(integer).ok().filter(|integer| integer >> 63 == 0)
}

/// The number of decimals with which a positive number is written exactly: that of binary digits after its
/// point.
pub fn exact_decimals(value: f64) -> i32 {
    let (mantissa, exponent) = mantissa_and_exponent(value);
    (-exponent - mantissa.trailing_zeros() as i32).max(0)
}

/// The m and e of a number m 2^e that is not negative.
fn mantissa_and_exponent(value: f64) -> (u64, i32) {
    /// Bits of the mantissa below the first one.
    const BELOW: u32 = f64::MANTISSA_DIGITS - 1;
    let fraction = value.to_bits() & ((1 << BELOW) - 1);
    // Subnormal numbers have the exponent of octave 1, and no first bit.
    match (value.to_bits() >> BELOW) as i32 {
        0 => (fraction, -1074),
        octave => (fraction | 1 << BELOW, octave - 1075),
    }
}

/// The float32 nearest to an integer times a power of ten. None if float64 arithmetic cannot guarantee the
/// rounding.
pub fn single(number: u64, exponent: i32) -> Option<f32> {
    /// The bits of a float64 mantissa that a float32 lacks; and half of the float32's last bit.
    const BELOW: u64 = (1 << 29) - 1;
    const HALF: u64 = 1 << 28;
    let value = scaled(number as f64, exponent).filter(|value| (1e-30..1e30).contains(value))?;
    // Rounding to float64 either leaves a number on its side of the midpoint between two float32 values or
    // puts it on the midpoint.
    (number < 1 << 53 && value.to_bits() & BELOW != HALF).then_some(value as f32)
}

/// The float64 nearest to an integer divided by 10^`decimals`. None if float64 arithmetic cannot guarantee the
/// rounding.
#[inline]
pub fn double(number: u64, decimals: u32) -> Option<f64> {
    // Both are exact, and their quotient is rounded once.
    let power = POWERS.get(decimals as usize)?;
    (number < 1 << 53).then_some(number as f64 / power)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    /// Values of all magnitudes, and the neighbours of short decimals, where rounding is close.
    fn values() -> impl Iterator<Item = f32> {
        let mut random = Rng::keyed(3, &[]);
        (0..200_000).map(move |number| {
            let mut below = |most: usize| random.below(most) as u32;
            match number % 4 {
                0 => f32::from_bits(below(0x7f80_0000)),
                1 => below(200_000) as f32 / 1000.0,
                2 => below(2_000_000) as f32 / 2f32.powi(number % 23),
                _ => f32::from_bits((10f32.powi(number % 9 - 4).to_bits() + below(9)).wrapping_sub(4)),
            }
        })
    }

    #[test]
    fn digits_are_those_of_the_standard_library() {
        let mut sure = 0;
        for value in values().map(f64::from) {
            for digits in [1, 4, 6, 8, 9] {
                let Some((number, exponent)) = significant(value, digits) else { continue };
                sure += 1;
                let text = format!("{:.*e}", digits as usize - 1, value);
                let (mantissa, expected) = text.split_once('e').unwrap();
                assert_eq!(
                    (number.to_string(), exponent),
                    (mantissa.replace('.', ""), expected.parse().unwrap())
                );
            }
        }
        assert!(sure > 600_000, "{sure}");
    }

    #[test]
    fn decimals_are_those_of_the_standard_library() {
        let mut given = 0;
        for value in values().map(f64::from).chain([0.5, 1.5, 2.5, 0.125, 0.375, 5e-324, 9.2e18, 0.0]) {
            for decimals in [0, 1, 2, 3, 6, 9, 18] {
                let Some(number) = fixed(value, decimals) else { continue };
                given += 1;
                let expected = format!("{value:.*}", decimals as usize).replace('.', "");
                let expected = expected.trim_start_matches('0');
                assert_eq!(
                    number.to_string(),
                    if expected.is_empty() { "0" } else { expected },
                    "{value} {decimals}"
                );
            }
        }
        assert!(given > 700_000, "{given}");
        assert_eq!(
            (fixed(1e19, 0), fixed(10.0, 18), fixed(1.0, 19), fixed(f64::MAX, 0)),
            (None, None, None, None)
        );
    }

    #[test]
    fn numbers_have_as_many_decimals_as_binary_digits_after_the_point() {
        for value in values().filter(|value| *value > 0.0) {
            let text = format!("{:.160}", f64::from(value));
            let decimals = text.trim_end_matches('0').split_once('.').unwrap().1.len();
            assert_eq!(exact_decimals(value.into()), decimals as i32, "{value:e}");
        }
        assert_eq!((exact_decimals(f64::from_bits(1)), exact_decimals(1e300)), (1074, 0));
    }

    #[test]
    fn numbers_are_those_of_the_standard_library() {
        let mut random = Rng::keyed(4, &[]);
        let mut sure = 0;
        for _ in 0..200_000 {
            let (number, exponent) = (random.below(1_000_000_000) as u64, random.below(40) as i32 - 25);
            let Some(value) = single(number, exponent) else { continue };
            sure += 1;
            let expected: f32 = format!("{number}e{exponent}").parse().unwrap();
            assert_eq!(value.to_bits(), expected.to_bits(), "{number}e{exponent}");
        }
        assert!(sure > 150_000, "{sure}");
        // The midpoint between two float32 values, and its neighbours.
        assert_eq!(single(16_777_217, 0), None);
        assert_eq!(single(167_772_171, -1), Some(16_777_218.0));
        assert_eq!(single(0, 0), None);
    }
}
