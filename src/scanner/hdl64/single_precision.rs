//! The formula as computed by the program that wrote the file: partly in single precision, operation by
//! operation. FORMAT.md 3.2.
//!
//! Unrounded coordinates depend on the last bit of every one of those operations. The constants are those of
//! the f64 formula, only more accurate, so the stream stores their differences from these.

use std::f64::consts::PI;
use std::ops::{Add, Sub};

use super::formula::small_atan;
use super::sine::sine_and_cosine;
use crate::ground::error::{Error, Result};
use crate::ground::floats::{of_rank, rank};
use crate::ground::lanes::lanes;
use crate::ground::varint::{read_signed, write_signed};

/// The unit of a refinement, in metres or degrees.
const UNIT: f64 = 1.0 / (1u64 << 40) as f64;
/// The limit of refinements: 1/16 m or degree, or more than the number of float32 values.
const LARGEST: u64 = 1 << 36;
/// Degrees of one radian.
const DEGREES: f64 = 180.0 / PI;

/// The refinements of one beam's constants, quantised as in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refinement {
    /// Added to the sine of the elevation, in float32 values.
    pub sine: i64,
    /// Added to the cosine of the elevation, in float32 values.
    pub cosine: i64,
    /// Added to the range offset, in 2^-40 m.
    pub range_offset: i64,
    /// Added to the height, in 2^-40 m.
    pub height: i64,
    /// Added to the sideways offset, in 2^-40 m.
    pub side_offset: i64,
    /// Added to the azimuth offset, in 2^-40 degrees.
    pub azimuth_offset: i64,
    /// The tick that the program counts as 0; its angle is added to the azimuth offset.
    pub first_tick: i64,
}

impl Refinement {
    /// The differences between one beam's constants and more accurate ones, both as in [`SingleBeam`].
    pub(crate) fn between(rough: &SingleBeam, sharp: &SingleBeam) -> Self {
        let units = |rough: f64, sharp: f64| ((sharp - rough) / UNIT).round() as i64;
        let turned = sharp.first_tick as f64 * sharp.tick_degrees;
        Refinement {
            sine: rank(sharp.sine) - rank(rough.sine),
            cosine: rank(sharp.cosine) - rank(rough.cosine),
            range_offset: units(rough.range_offset, sharp.range_offset),
            height: units(rough.height, sharp.height),
            side_offset: units(rough.side_offset, sharp.side_offset),
            azimuth_offset: units(rough.azimuth_offset + turned, sharp.azimuth_offset),
            first_tick: sharp.first_tick,
        }
    }

    fn fields(&mut self) -> [&mut i64; 7] {
        [
            &mut self.sine,
            &mut self.cosine,
            &mut self.range_offset,
            &mut self.height,
            &mut self.side_offset,
            &mut self.azimuth_offset,
            &mut self.first_tick,
        ]
    }

    /// Appends the refinement in the form of the stream.
    pub(crate) fn write_to(mut self, out: &mut Vec<u8>) {
        self.fields().into_iter().for_each(|field| write_signed(out, *field));
    }

    /// Reads what [`write_to`](Self::write_to) wrote.
    ///
    /// # Errors
    /// If it is cut short or holds values that no scanner has.
    pub(crate) fn read_from(bytes: &mut &[u8]) -> Result<Self> {
        let mut refinement = Refinement::default();
        for field in refinement.fields() {
            *field = read_signed(bytes, "scanner model")?;
            if field.unsigned_abs() > LARGEST {
                return Err(Error::corrupt("scanner model: a refinement is out of range"));
            }
        }
        Ok(refinement)
    }
}

/// The constants of one beam in the form used by this arithmetic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SingleBeam {
    /// Sine and cosine of the elevation.
    pub sine: f32,
    pub cosine: f32,
    /// Range offset: added to a range along the beam, in metres.
    pub range_offset: f64,
    /// Height of the beam's origin, in metres.
    pub height: f64,
    /// Sideways offset in metres.
    pub side_offset: f64,
    /// Added to the angle of a tick, in degrees.
    pub azimuth_offset: f64,
    /// The tick whose angle is 0.
    pub first_tick: i64,
    /// Ticks in a turn.
    pub ticks: u32,
    /// Degrees per tick.
    pub tick_degrees: f64,
}

impl SingleBeam {
    /// Converts the constants (V, b, c, h, rot) of the f64 formula, in radians and metres, given `ticks` in a
    /// turn.
    pub fn new([sin_v, cos_v, b, c, h, rot]: [f64; 6], ticks: u32) -> Self {
        let range_offset = b / cos_v;
        SingleBeam {
            sine: sin_v as f32,
            cosine: cos_v as f32,
            range_offset,
            height: c - range_offset * sin_v,
            side_offset: h,
            azimuth_offset: rot * DEGREES,
            first_tick: 0,
            ticks,
            tick_degrees: 360.0 / f64::from(ticks),
        }
    }

    /// The refined constants.
    pub fn refined(self, by: &Refinement) -> Self {
        let turned = by.first_tick as f64 * self.tick_degrees;
        SingleBeam {
            sine: of_rank(rank(self.sine) + by.sine),
            cosine: of_rank(rank(self.cosine) + by.cosine),
            range_offset: self.range_offset + by.range_offset as f64 * UNIT,
            height: self.height + by.height as f64 * UNIT,
            side_offset: self.side_offset + by.side_offset as f64 * UNIT,
            azimuth_offset: (self.azimuth_offset + turned) + by.azimuth_offset as f64 * UNIT,
            first_tick: by.first_tick,
            ..self
        }
    }

    /// The distance along the beam of a range in metres.
    #[inline(always)]
    pub fn distance(&self, metres: f64) -> f32 {
        (metres + self.range_offset) as f32
    }

    /// z, in metres.
    #[inline(always)]
    pub fn z(&self, distance: f32) -> f32 {
        (f64::from(distance * self.sine) + self.height) as f32
    }

    /// The angle by which the sideways offset rotates the beam, in degrees.
    #[inline(always)]
    pub fn aside(&self, distance: f32) -> f64 {
        small_atan(self.side_offset / (f64::from(distance) * f64::from(self.cosine))) * DEGREES
    }

    /// The angle of a tick plus the azimuth offset, in degrees.
    #[inline(always)]
    pub fn turned(&self, tick: u32) -> f32 {
        // Whole numbers, computed in f64 because vector units are slow to convert 64-bit integers.
        let counted = within(f64::from(tick) - self.first_tick as f64, f64::from(self.ticks));
        let angle = (counted * self.tick_degrees) as f32;
        (f64::from(angle) + self.azimuth_offset) as f32
    }

    /// The azimuth at a tick of a beam that is rotated sideways by `aside` degrees, in radians.
    #[inline(always)]
    pub fn azimuth(&self, tick: u32, aside: f64) -> f32 {
        let degrees = within((f64::from(self.turned(tick)) + aside) as f32, 360.0);
        (f64::from(degrees) * (PI / 180.0)) as f32
    }

    /// x and y at a distance and an azimuth, in metres and radians.
    #[inline(always)]
    pub fn x_y(&self, distance: f32, azimuth: f32) -> [f32; 2] {
        let (sine, cosine) = sine_and_cosine(azimuth);
        [distance * (self.cosine * cosine), distance * (self.cosine * sine)]
    }

    /// The formula: x, y and z at a tick and a range, in metres.
    #[inline]
    pub fn position(&self, tick: u32, metres: f64) -> [f32; 3] {
        let [[x], [y], [z]] = self.positions([tick], [metres]);
        [x, y, z]
    }

    /// As [`position`](Self::position), for `N` points.
    #[inline(always)]
    pub fn positions<const N: usize>(&self, ticks: [u32; N], metres: [f64; N]) -> [[f32; N]; 3] {
        let distance: [f32; N] = lanes(|i| self.distance(metres[i]));
        let aside: [f64; N] = lanes(|i| self.aside(distance[i]));
        let azimuth: [f32; N] = lanes(|i| self.azimuth(ticks[i], aside[i]));
        let x_y: [[f32; 2]; N] = lanes(|i| self.x_y(distance[i], azimuth[i]));
        [lanes(|i| x_y[i][0]), lanes(|i| x_y[i][1]), lanes(|i| self.z(distance[i]))]
    }
}

/// A value that is less than one turn outside 0 to `turn`, brought into that range; other values come closer
/// to it.
#[inline(always)]
fn within<T: Copy + Default + PartialOrd + Add<Output = T> + Sub<Output = T>>(value: T, turn: T) -> T {
    if value < T::default() {
        value + turn
    } else if value >= turn {
        value - turn
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rough() -> SingleBeam {
        let (sin_v, cos_v) = (-0.1f64).sin_cos();
        SingleBeam::new([sin_v, cos_v, -0.0004, 0.2, 0.026, 0.0003], 4000)
    }

    #[test]
    fn a_refinement_gives_the_constants_that_it_was_made_from() {
        let sharp = SingleBeam {
            sine: rough().sine.next_up(),
            range_offset: rough().range_offset + 3e-9,
            height: rough().height - 7e-8,
            azimuth_offset: rough().azimuth_offset + 1.5e-8 - 33.0 * 0.09,
            first_tick: -33,
            ..rough()
        };
        let again = rough().refined(&Refinement::between(&rough(), &sharp));
        assert_eq!((again.sine, again.cosine, again.first_tick), (sharp.sine, sharp.cosine, -33));
        for (a, b) in [
            (again.range_offset, sharp.range_offset),
            (again.height, sharp.height),
            (again.side_offset, sharp.side_offset),
            (again.azimuth_offset, sharp.azimuth_offset),
        ] {
            assert!((a - b).abs() < UNIT, "{a} {b}");
        }
    }

    #[test]
    fn is_the_formula_of_double_precision_but_for_roundings() {
        let beam = rough();
        for (tick, metres) in [(0, 5.0), (1, 100.0), (1234, 20.0), (3999, 60.0)] {
            let d = metres + beam.range_offset;
            let rho = d * (-0.1f64).cos();
            let phi = (f64::from(tick) * 0.09 + beam.azimuth_offset).to_radians() + (0.026 / rho).atan();
            let truth = [rho * phi.cos(), rho * phi.sin(), d * (-0.1f64).sin() + beam.height];
            for (got, truth) in beam.position(tick, metres).into_iter().zip(truth) {
                assert!((f64::from(got) - truth).abs() < 1e-6 * metres, "{got} {truth}");
            }
        }
    }
}
