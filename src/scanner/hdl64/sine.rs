//! Sine and cosine in single precision, computed with the operations of the C library of the time (fdlibm).
//! FORMAT.md 3.5.
//!
//! Their last bit is wrong for 6 to 10 % of the angles, and files contain that bit, so they are computed in
//! the same way here. Correctly rounded values reproduce x and y of nine points in ten, these reproduce all.

/// 2 / pi.
const TWO_OVER_PI: f32 = f32::from_bits(0x3f22_f984);
/// The first 17 bits of pi / 2, whose products with small integers are exact.
const HALF_PI_HEAD: f32 = f32::from_bits(0x3fc9_0f80);
/// pi / 2 minus its head.
const HALF_PI_TAIL: f32 = f32::from_bits(0x3735_4443);
/// The leading bits of that tail, and the rest of it.
const HALF_PI_TAIL_HEAD: f32 = f32::from_bits(0x3735_4400);
const HALF_PI_TAIL_TAIL: f32 = f32::from_bits(0x2e85_a308);
/// Angles up to this (pi / 4) are not reduced.
const QUARTER_PI: f32 = f32::from_bits(0x3f49_0fd8);

/// Coefficients of x^3, x^5 ... x^13 of the sine.
const SINE: [f32; 6] = [
    f32::from_bits(0xbe2a_aaab),
    f32::from_bits(0x3c08_8889),
    f32::from_bits(0xb950_0d01),
    f32::from_bits(0x3638_ef1b),
    f32::from_bits(0xb2d7_2f34),
    f32::from_bits(0x2f2e_c9d3),
];

/// Coefficients of x^4, x^6 ... x^14 of the cosine.
const COSINE: [f32; 6] = [
    f32::from_bits(0x3d2a_aaab),
    f32::from_bits(0xbab6_0b61),
    f32::from_bits(0x37d0_0d01),
    f32::from_bits(0xb493_f27c),
    f32::from_bits(0x310f_74f6),
    f32::from_bits(0xad47_d74e),
];

/// Sine and cosine of an angle from 0 to 2 pi, in radians. For other angles the results are meaningless, but
/// the same everywhere.
///
/// All cases are computed before one is selected, so that vector units can process several angles at a time.
#[inline(always)]
pub fn sine_and_cosine(angle: f32) -> (f32, f32) {
    let is_small = angle <= QUARTER_PI;
    let (quarter_turns, rest, error) = reduce(angle);
    let quarter_turns = if is_small { 0 } else { quarter_turns };
    let (rest, error) = if is_small { (angle, 0.0) } else { (rest, error) };
    let sine = sine_near_zero(rest, error, is_small);
    let cosine = cosine_near_zero(rest, error);
    let is_odd = quarter_turns & 1 == 1;
    let (first, second) = if is_odd { (cosine, sine) } else { (sine, cosine) };
    let first = if quarter_turns & 2 == 2 { -first } else { first };
    let second = if quarter_turns.wrapping_add(1) & 2 == 2 { -second } else { second };
    (first, second)
}

/// The nearest number of quarter turns, and the remainder of the angle as a sum of two values.
#[inline(always)]
fn reduce(angle: f32) -> (i32, f32, f32) {
    /// If more leading bits than this are lost, the second part of pi / 2 is taken into account.
    const MOST_BITS_LOST: i32 = 8;
    let exponent = |v: f32| (v.to_bits() >> 23 & 0xff) as i32;
    let quarter_turns = (angle * TWO_OVER_PI + 0.5) as i32;
    let count = quarter_turns as f32;
    let (head, tail) = (angle - count * HALF_PI_HEAD, count * HALF_PI_TAIL);
    let rest = head - tail;
    let second = count * HALF_PI_TAIL_HEAD;
    let finer_head = head - second;
    let finer_tail = count * HALF_PI_TAIL_TAIL - ((head - finer_head) - second);
    let is_fine = exponent(angle) - exponent(rest) > MOST_BITS_LOST;
    let (head, tail) = if is_fine { (finer_head, finer_tail) } else { (head, tail) };
    let rest = head - tail;
    (quarter_turns, rest, (head - rest) - tail)
}

/// Sine of x if the original angle was small, otherwise of x + error, for |x| up to pi / 4.
#[inline(always)]
fn sine_near_zero(x: f32, error: f32, is_small: bool) -> f32 {
    let [first, second, .., last] = SINE;
    let z = x * x;
    let v = z * x;
    let r = second + z * (SINE[2] + z * (SINE[3] + z * (SINE[4] + z * last)));
    let (plain, of_sum) = (x + v * (first + z * r), x - ((z * (0.5 * error - v * r) - error) - v * first));
    if is_small { plain } else { of_sum }
}

/// Cosine of x + error, for |x| up to pi / 4.
#[inline(always)]
fn cosine_near_zero(x: f32, error: f32) -> f32 {
    const SMALL: u32 = 0x3e99_999a; // 0.3
    const LARGE: u32 = 0x3f48_0000; // 0.78125
    let [first, .., last] = COSINE;
    let z = x * x;
    let r = z * (first + z * (COSINE[1] + z * (COSINE[2] + z * (COSINE[3] + z * (COSINE[4] + z * last)))));
    let bits = x.abs().to_bits();
    let correction = z * r - x * error;
    let of_small = 1.0 - (0.5 * z - correction);
    // About x / 4, chosen so that it can be subtracted from 1 without an error.
    let part = if bits > LARGE { 0.281_25 } else { f32::from_bits(bits.wrapping_sub(0x0100_0000)) };
    let half_square = 0.5 * z - part;
    let of_large = (1.0 - part) - (half_square - correction);
    if bits < SMALL { of_small } else { of_large }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_near_the_true_values_and_off_as_often_as_it_was() {
        let (mut off, mut total) = (0, 0);
        for place in 0..62_831 {
            let angle = place as f32 * 1e-4;
            let (sine, cosine) = sine_and_cosine(angle);
            for (value, truth) in [(sine, f64::from(angle).sin()), (cosine, f64::from(angle).cos())] {
                assert!((f64::from(value) - truth).abs() < 1e-7, "at {angle}: {value}, not {truth}");
                total += 1;
                off += i32::from(value != truth as f32);
            }
        }
        let share = f64::from(off) / f64::from(total);
        assert!((0.07..0.09).contains(&share), "{share} of the last bits are wrong");
    }

    #[test]
    fn other_angles_give_the_same_everywhere() {
        for (angle, sine, cosine) in [
            (-1.0, 0xbf57_6aa4, 0x3f0a_5140),
            (-0.0, 0, 0x3f80_0000),
            (7.0, 0x3f28_3046, 0x3f40_ffbc),
            (f32::from_bits(1), 1, 0x3f80_0000),
        ] {
            let found = sine_and_cosine(angle);
            assert_eq!((found.0.to_bits(), found.1.to_bits()), (sine, cosine), "{angle}");
        }
        let (sine, cosine) = sine_and_cosine(f32::NAN);
        assert!(sine.is_nan() && cosine.is_nan());
    }
}
