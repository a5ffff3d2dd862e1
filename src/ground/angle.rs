//! Fast angle functions for computations where the last bits do not matter: several times as fast as the
//! exact functions, with the same results on every processor. Only encoders use them, to find candidates that
//! the exact formula then confirms. Differences of ticks are whole numbers, for both sides.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use super::doubles::Choose;
use super::floats::round_ties_even;

/// The tangent of pi / 8.
const EIGHTH: f64 = 0.414_213_562_373_095_03;
/// Coefficients of atan(r) / r in powers of r squared, for r up to [`EIGHTH`]: a Chebyshev approximation.
const ATAN: [f64; 9] = [
    0.999_999_999_999_974,
    -0.333_333_333_308_715_7,
    0.199_999_996_131_619_76,
    -0.142_856_908_068_122_9,
    0.111_103_937_699_429_56,
    -0.090_785_000_473_724_6,
    0.075_644_443_615_886_2,
    -0.058_771_535_399_383_64,
    0.030_700_905_501_758_177,
];

/// The angle from the x axis to a point, in radians from -pi to pi, to within 2e-14; 0 for the origin.
#[inline(always)]
pub fn atan2<V: Choose>(y: V, x: V) -> V {
    let value = |value: f64| x.splat(value);
    let (ahead, aside) = (x.abs(), y.abs());
    let is_flat = aside.is_at_most(ahead);
    let (small, large) = (V::select(is_flat, aside, ahead), V::select(is_flat, ahead, aside));
    // The angle from the nearest axis or diagonal is at most pi / 8.
    let is_near_axis = small.is_at_most(large * EIGHTH);
    let above = V::select(is_near_axis, small, small - large);
    let below = V::select(is_near_axis, large, small + large);
    let tangent = V::select(below.is_above(0.0), above / below, value(0.0));
    let square = tangent * tangent;
    // Not by an iterator, whose functions would be called outside the vector unit's code.
    let mut ratio = value(ATAN[ATAN.len() - 1]);
    for power in (0..ATAN.len() - 1).rev() {
        ratio = ratio * square + ATAN[power];
    }
    let angle = tangent * ratio + V::select(is_near_axis, value(0.0), value(FRAC_PI_4));
    let angle = V::select(is_flat, angle, value(FRAC_PI_2) - angle);
    let angle = V::select(x.is_below(0.0), value(PI) - angle, angle);
    // The sign of a zero decides between pi and -pi.
    angle.copysign(y)
}

/// Cosines and sines of angles below a hundredth of a radian, to within 1e-15; if any angle is larger, all
/// are computed exactly.
#[inline(always)]
pub fn small_cos_sin<V: Choose>(angle: V) -> [V; 2] {
    const SMALL: f64 = 0.01;
    if V::any(angle.abs().is_above(SMALL)) {
        return [angle.map(libm::cos), angle.map(libm::sin)];
    }
    let square = angle * angle;
    let cos = ((square * (-1.0 / 720.0) + 1.0 / 24.0) * square - 0.5) * square + 1.0;
    let sin = ((square * (1.0 / 120.0) - 1.0 / 6.0) * square + 1.0) * angle;
    [cos, sin]
}

/// Cosine and sine of an angle of up to half a radian, to within 2e-16; free of branches, so that it can be
/// vectorised. The results for larger angles are wrong.
#[inline(always)]
pub fn cos_sin_below_half(angle: f64) -> [f64; 2] {
    /// The ratio of each term of the series to the one before.
    const COS: [f64; 7] =
        [1.0 / 182.0, 1.0 / 132.0, 1.0 / 90.0, 1.0 / 56.0, 1.0 / 30.0, 1.0 / 12.0, 1.0 / 2.0];
    const SIN: [f64; 6] = [1.0 / 156.0, 1.0 / 110.0, 1.0 / 72.0, 1.0 / 42.0, 1.0 / 20.0, 1.0 / 6.0];
    let square = angle * angle;
    let series = |factors: &[f64]| factors.iter().fold(1.0, |sum, factor| 1.0 - square * factor * sum);
    [series(&COS), angle * series(&SIN)]
}

/// The sine of an angle in turns, to within a thousandth.
#[inline(always)]
pub fn rough_sine(turns: f64) -> f64 {
    let turn = turns - round_ties_even(turns);
    let parabola = 16.0 * turn * (0.5 - turn.abs());
    parabola + 0.225 * (parabola * parabola.abs() - parabola)
}

/// A difference of azimuths in ticks, of which a turn has `turn`, as one of half a turn at most: the shorter
/// way round.
#[inline]
pub fn shorter_way(ticks: i64, turn: i64) -> i64 {
    // Divisions are slow, and most differences are less than a turn.
    let ahead = ticks + turn / 2;
    let within = match ahead {
        _ if (0..turn).contains(&ahead) => ahead,
        _ if (-turn..0).contains(&ahead) => ahead + turn,
        _ if (turn..2 * turn).contains(&ahead) => ahead - turn,
        _ => ahead.rem_euclid(turn),
    };
    within - turn / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shorter_way_is_half_a_turn_at_most() {
        for turn in [7, 8, 36_000] {
            for ticks in (-3 * turn..3 * turn).step_by(turn as usize / 7) {
                let shorter = shorter_way(ticks, turn);
                assert!(
                    2 * shorter.abs() <= turn && (ticks - shorter) % turn == 0,
                    "{ticks} of {turn}: {shorter}"
                );
            }
        }
        assert_eq!([-4, 4].map(|ticks| shorter_way(ticks, 8)), [-4; 2]);
    }

    #[test]
    fn angles_are_near_the_exact_ones() {
        for step in 0..200_000 {
            let exact = (f64::from(step) / 100_000.0 - 1.0) * PI;
            let length = 10f64.powi(step % 7 - 3);
            let (y, x) = (length * libm::sin(exact), length * libm::cos(exact));
            let off = atan2(y, x) - libm::atan2(y, x);
            assert!(off.abs() < 2e-14, "{exact}: {off}");
        }
        let axes = [
            (0.0, 0.0),
            (0.0, 1.0),
            (1.0, 0.0),
            (-1.0, 0.0),
            (0.0, -1.0),
            (-0.0, -1.0),
            (1.0, 1.0),
            (-1.0, -1.0),
        ];
        for (y, x) in axes {
            assert!((atan2(y, x) - libm::atan2(y, x)).abs() < 2e-14, "{y} {x}");
        }
    }

    #[test]
    fn small_angles_are_exact_to_the_last_bits() {
        for step in -3000..3000 {
            let angle = f64::from(step) * 1e-5;
            let [cos, sin] = small_cos_sin(angle);
            assert!(
                (cos - libm::cos(angle)).abs() < 1e-15 && (sin - libm::sin(angle)).abs() < 1e-15,
                "{angle}"
            );
        }
    }

    #[test]
    fn angles_below_half_a_radian_are_exact_to_the_last_bits() {
        for step in -5000..=5000 {
            let angle = f64::from(step) * 1e-4;
            let [cos, sin] = cos_sin_below_half(angle);
            let off = (cos - libm::cos(angle)).abs().max((sin - libm::sin(angle)).abs());
            assert!(off < 2e-16, "{angle}: {off}");
        }
    }

    #[test]
    fn rough_sines_are_near_the_exact_ones() {
        for step in -3000..3000 {
            let turns = f64::from(step) * 1e-3;
            let off = rough_sine(turns) - libm::sin(turns * std::f64::consts::TAU);
            assert!(off.abs() < 1.2e-3, "{turns}: {off}");
        }
    }
}
