//! A laser ray, and the surfaces that it may hit.

/// A ray in the world, in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    /// Its origin.
    pub origin: [f64; 3],
    /// Its direction, of length 1.
    pub direction: [f64; 3],
}

impl Ray {
    /// A ray in any direction that is not zero.
    #[cfg(test)]
    pub(super) fn new(origin: [f64; 3], direction: [f64; 3]) -> Self {
        let length = libm::sqrt(direction.iter().map(|v| v * v).sum());
        Ray { origin, direction: direction.map(|v| v / length) }
    }

    /// The point at a distance from the origin.
    pub(super) fn at(&self, distance: f64) -> [f64; 3] {
        core::array::from_fn(|axis| self.origin[axis] + distance * self.direction[axis])
    }

    /// The ray as seen from a body at `place` that is rotated about the vertical by the angle with this
    /// cosine and sine.
    pub(super) fn seen_from(&self, place: [f64; 3], cos: f64, sin: f64) -> Ray {
        let turned = |v: [f64; 3]| [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0], v[2]];
        let offset = core::array::from_fn(|axis| self.origin[axis] - place[axis]);
        Ray { origin: turned(offset), direction: turned(self.direction) }
    }
}

/// A surface hit by a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance along the ray, in metres.
    pub distance: f64,
    /// Cosine of the angle between the ray and the surface's normal, 0..=1.
    pub incidence: f64,
    /// Share of the light that returns, 0..=1; more for reflectors.
    pub reflectivity: f64,
    /// Roughness along the ray: sigma in metres, on top of the scanner's noise.
    pub scatter: f64,
    /// Share of the pulses that pass through or are mirrored away, as on glass.
    pub loss: f64,
}

impl Hit {
    /// A smooth surface that loses no pulse.
    pub(super) fn plain(distance: f64, incidence: f64, reflectivity: f64) -> Self {
        Hit { distance, incidence: incidence.clamp(0.0, 1.0), reflectivity, scatter: 0.0, loss: 0.0 }
    }

    /// Glass: dark, and this share of the pulses is lost.
    pub(super) fn glass(distance: f64, incidence: f64, loss: f64) -> Self {
        Hit { loss, ..Hit::plain(distance, incidence, 0.12) }
    }
}
