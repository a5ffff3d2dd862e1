//! The beams of the simulated scanner, and the formula that turns its integers into coordinates.

use libm::{atan, cos, rint, sin};

use crate::ground::random::Rng;

/// Encoder ticks in a turn; a tick is 0.09 degrees.
pub const TICKS: i32 = 4000;

/// One range step in metres.
pub const STEP: f64 = 0.002;

/// Beams of the full scanner.
pub const BEAMS: usize = 64;

const TICK_DEGREES: f64 = 0.09;
const RADIANS: f64 = core::f64::consts::PI / 180.0;

/// The constants of one beam. Range `n` (steps) and azimuth `t` (ticks) give
///
/// ```text
/// d   = 0.002 n
/// rho = d cos(elevation) + range_offset
/// z   = d sin(elevation) + height
/// phi = 0.09 deg t + turn + atan(side / rho)
/// x, y = rho cos(phi), rho sin(phi)
/// ```
///
/// and the shared column of a point is `(t + shift) mod 4000`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Angle above the horizon, in degrees.
    pub elevation: f64,
    /// Added to the horizontal distance, in metres.
    pub range_offset: f64,
    /// Height of the beam's origin above that of the scanner, in metres.
    pub height: f64,
    /// Sideways offset of the beam's origin, in metres; positive offsets turn it towards larger azimuths.
    pub side: f64,
    /// Azimuth offset, less than one tick, in degrees.
    pub turn: f64,
    /// Whole ticks from the beam's azimuth to the column that all beams share.
    pub shift: i32,
    /// Factor of the beam's intensities.
    pub gain: f64,
}

/// The beams from top to bottom, generated from the seed. The structure is the published one of the HDL-64E;
/// the deviations from it differ from scanner to scanner, so they are random here. With fewer than 64 beams,
/// every (64 / count)-th one.
pub(super) fn beams(seed: u64, count: usize) -> Vec<Beam> {
    let count = count.clamp(1, BEAMS);
    let all = (0..BEAMS).map(|row| beam(row, &mut Rng::keyed(seed, &[u64::from(b'b'), row as u64])));
    all.step_by(BEAMS / count).take(count).collect()
}

fn beam(row: usize, rng: &mut Rng) -> Beam {
    let upper = row < BEAMS / 2;
    let place = (row % (BEAMS / 2)) as f64;
    let (top, spacing) = if upper { (1.94, 0.333) } else { (-8.83, 0.52) };
    let (base, sag) = if upper { (0.212, 0.0003) } else { (0.125, 0.0004) };
    Beam {
        elevation: top - spacing * place + rng.between(-0.04, 0.04),
        range_offset: rng.between(-0.04, 0.04),
        height: base - sag * place + rng.between(-0.0003, 0.0003),
        side: if row.is_multiple_of(2) { -0.026 } else { 0.026 },
        turn: rng.between(0.0, TICK_DEGREES),
        shift: shift(row, rng),
        gain: rng.between(0.8, 1.15),
    }
}

/// The lasers of a block are side by side in groups of six, so the shift increases within each group and
/// falls back with the next one; two kinds of groups alternate.
fn shift(row: usize, rng: &mut Rng) -> i32 {
    let upper = row < BEAMS / 2;
    let place = row % (BEAMS / 2) + if upper { 2 } else { 4 };
    let (starts, climb) = if upper { ([-38.0, -30.0], 24.3) } else { ([-75.0, -61.0], 37.3) };
    let start: f64 = starts[place / 6 % 2];
    rint(start + climb * (place % 6) as f64 + rng.between(-0.8, 0.8)) as i32
}

/// A point as the scanner stores it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stored {
    /// Coordinates in metres, rounded to the millimetre.
    pub position: [f32; 3],
    /// The azimuth before that rounding, in degrees from 0 to 360: points are sorted by it.
    pub azimuth: f32,
}

impl Beam {
    /// The difference between the distance along the ray from the axis and the whole steps, in metres.
    pub(super) fn distance_offset(&self) -> f64 {
        self.range_offset / cos(self.elevation * RADIANS)
    }

    /// Height at which the ray, extended back to the axis, starts, in metres.
    pub(super) fn origin_height(&self) -> f64 {
        self.height - self.distance_offset() * sin(self.elevation * RADIANS)
    }

    /// Sine and cosine of the elevation.
    pub(super) fn slope(&self) -> (f64, f64) {
        (sin(self.elevation * RADIANS), cos(self.elevation * RADIANS))
    }

    /// Azimuth of the ray before its sideways offset turns it, in radians.
    pub(super) fn azimuth(&self, tick: i32) -> f64 {
        (f64::from(tick) * TICK_DEGREES + self.turn) * RADIANS
    }

    /// The coordinates for a range and a tick, with the roundings to single precision of the original
    /// software: these move one point in a hundred to the other side of a millimetre boundary.
    pub(super) fn point(&self, tick: i32, steps: u32) -> Stored {
        let (sin_v, cos_v) = self.slope();
        let (sin_v, cos_v) = (sin_v as f32, cos_v as f32);
        let distance = (f64::from(steps) * STEP + self.distance_offset()) as f32;
        let rho = f64::from(distance) * f64::from(cos_v);
        let beam_degrees = (f64::from(tick) * TICK_DEGREES + self.turn) as f32;
        let degrees = (f64::from(beam_degrees) + atan(self.side / rho) / RADIANS) as f32;
        let phi = f64::from((f64::from(degrees) * RADIANS) as f32);
        let x = distance * (cos_v * cos(phi) as f32);
        let y = distance * (cos_v * sin(phi) as f32);
        let z = distance * sin_v + self.origin_height() as f32;
        Stored { position: [x, y, z].map(to_millimetres), azimuth: degrees.rem_euclid(360.0) }
    }
}

/// The float32 nearest to a whole number of millimetres. Zero keeps the sign of the rounded number.
fn to_millimetres(metres: f32) -> f32 {
    (rint(f64::from(metres) * 1000.0) / 1000.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structure_is_that_of_the_hdl_64e() {
        let beams = beams(7, 64);
        assert_eq!(beams.len(), 64);
        assert!((beams[0].elevation - 1.94).abs() < 0.05);
        assert!((-25.2..-24.6).contains(&beams[63].elevation), "{}", beams[63].elevation);
        for (upper, lower) in beams.iter().zip(&beams[1..]) {
            assert!(upper.elevation > lower.elevation);
            assert_eq!(upper.side, -lower.side);
        }
        for beam in &beams {
            assert!((0.0..0.09).contains(&beam.turn));
            assert!((-80..=126).contains(&beam.shift), "{}", beam.shift);
        }
    }

    #[test]
    fn fewer_beams_are_some_of_all_beams() {
        let (all, some) = (beams(7, 64), beams(7, 16));
        assert_eq!(some.len(), 16);
        assert!(some.iter().enumerate().all(|(row, beam)| *beam == all[4 * row]));
        assert_eq!(beams(7, 0).len(), 1);
    }

    #[test]
    fn scanners_of_two_seeds_differ() {
        assert_ne!(beams(7, 64), beams(8, 64));
    }

    #[test]
    fn point_follows_the_formula_in_double_precision() {
        for beam in beams(3, 64) {
            let rho = 12.345 * cos(beam.elevation * RADIANS) + beam.range_offset;
            let phi = (1234.0 * 0.09 + beam.turn) * RADIANS + atan(beam.side / rho);
            let expected =
                [rho * cos(phi), rho * sin(phi), 12.345 * sin(beam.elevation * RADIANS) + beam.height];
            let stored = beam.point(1234, 6173).position;
            for (got, expected) in stored.iter().zip(expected) {
                // 6173 steps are 12.346 m.
                assert!((f64::from(*got) - expected).abs() < 0.0017, "{got} {expected}");
            }
        }
    }

    #[test]
    fn zero_keeps_its_sign() {
        assert!(to_millimetres(-0.0004).is_sign_negative());
        assert!(to_millimetres(0.0004).is_sign_positive());
        assert_eq!(to_millimetres(-0.0006), -0.001);
    }
}
