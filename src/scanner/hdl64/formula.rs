//! The formula of one beam; [`Hdl64`](crate::scanner::hdl64::Hdl64) states it in full. FORMAT.md 3.2, "Formula".

use std::f64::consts::TAU;

use super::BeamConstants;
use crate::ground::doubles::Real;
use crate::ground::lanes::lanes;

/// Cosine and sine of the angle of an azimuth tick, or of several.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tick<V = f64> {
    pub cos: V,
    pub sin: V,
}

impl Tick {
    /// The tick at an angle in radians.
    pub fn at(radians: f64) -> Self {
        Tick { cos: libm::cos(radians), sin: libm::sin(radians) }
    }
}

/// One beam's constants in the form used by the formula, in metres and radians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Formula {
    pub cos_v: f64,
    pub sin_v: f64,
    pub b: f64,
    pub c: f64,
    pub h: f64,
    pub rot: f64,
    /// The tangent of V.
    slope: f64,
    cos_rot: f64,
    sin_rot: f64,
}

impl Formula {
    /// Creates the formula from constants in the form of the stream.
    pub fn new(constants: &BeamConstants) -> Self {
        let [v, b, c, h, rot] = constants.values();
        let (cos_v, sin_v) = (libm::cos(v), libm::sin(v));
        let (cos_rot, sin_rot) = (libm::cos(rot), libm::sin(rot));
        Formula { cos_v, sin_v, b, c, h, rot, slope: sin_v / cos_v, cos_rot, sin_rot }
    }

    /// z at horizontal distance `rho`, both in metres.
    #[inline(always)]
    pub fn height_at<V: Real>(&self, rho: V) -> V {
        (rho - self.b) * self.slope + self.c
    }

    /// Cosine and sine of the beam's azimuth at a tick.
    #[inline(always)]
    pub fn heading<V: Real>(&self, Tick { cos, sin }: Tick<V>) -> (V, V) {
        (cos * self.cos_rot - sin * self.sin_rot, sin * self.cos_rot + cos * self.sin_rot)
    }

    /// The horizontal distance from the axis at a range, both in metres.
    #[inline(always)]
    pub fn rho<V: Real>(&self, metres: V) -> V {
        metres * self.cos_v + self.b
    }

    /// The range, in metres, at which the beam passes closest to a point at distance `rho` and height `z`.
    #[inline(always)]
    pub fn range<V: Real>(&self, rho: V, z: V) -> V {
        (rho - self.b) * self.cos_v + (z - self.c) * self.sin_v
    }

    /// x, y and z of a point, in metres.
    #[inline(always)]
    pub fn point<V: Real>(&self, tick: Tick<V>, metres: V) -> [V; 3] {
        let (cos, sin) = self.heading(tick);
        let rho = self.rho(metres);
        // Rotated by atan(h / rho), whose cosine and sine are rho and h divided by their hypotenuse.
        let along = rho / (rho * rho + self.h * self.h).sqrt();
        [along * (cos * rho - sin * self.h), along * (sin * rho + cos * self.h), metres * self.sin_v + self.c]
    }

    /// phi: the azimuths of `N` points, in radians from 0 to 2 pi, given the angles of their ticks.
    #[inline(always)]
    pub fn azimuths<const N: usize>(&self, ticks: [f64; N], metres: [f64; N]) -> [f64; N] {
        let side: [f64; N] = lanes(|i| small_atan(self.h / self.rho(metres[i])));
        lanes(|i| {
            let azimuth = ticks[i] + self.rot + side[i];
            let (before, behind) = (azimuth < 0.0, azimuth >= TAU);
            azimuth + if before { TAU } else { 0.0 } - if behind { TAU } else { 0.0 }
        })
    }
}

/// atan for the small angles of the sideways offset: a fixed polynomial, the same on every platform. The
/// error is less than 1e-9 rad below 0.05 rad; larger errors only affect the predicted order of the file,
/// never the result.
#[inline(always)]
pub(crate) fn small_atan(tangent: f64) -> f64 {
    let square = tangent * tangent;
    tangent * (1.0 - square * (1.0 / 3.0 - square * (1.0 / 5.0 - square / 7.0)))
}
