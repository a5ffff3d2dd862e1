//! A laser ray, the surfaces that it may hit, and where it enters and leaves simple bodies.

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

/// The part of a ray inside a body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    /// Where the ray enters, in metres; negative if it starts inside.
    pub enter: f64,
    /// Where it leaves.
    pub leave: f64,
    /// The axis of the face or, for round bodies, of the normal at the entry.
    pub axis: usize,
    /// Cosine of the angle between the ray and the normal at the entry.
    pub incidence: f64,
}

/// A box with these corners.
pub(super) fn through_box(ray: &Ray, low: [f64; 3], high: [f64; 3]) -> Option<Span> {
    let (mut enter, mut leave, mut face) = (f64::NEG_INFINITY, f64::INFINITY, 0);
    for axis in 0..3 {
        // If the ray is parallel to the face, this divides by zero; the infinities then mean "always" or
        // "never" inside.
        let inverse = 1.0 / ray.direction[axis];
        let (a, b) = ((low[axis] - ray.origin[axis]) * inverse, (high[axis] - ray.origin[axis]) * inverse);
        if a.min(b) > enter {
            (enter, face) = (a.min(b), axis);
        }
        leave = leave.min(a.max(b));
    }
    (enter < leave).then(|| Span { enter, leave, axis: face, incidence: ray.direction[face].abs() })
}

/// An ellipsoid with this centre and these half axes.
pub(super) fn through_ellipsoid(ray: &Ray, centre: [f64; 3], half: [f64; 3]) -> Option<Span> {
    let from: [f64; 3] = core::array::from_fn(|axis| (ray.origin[axis] - centre[axis]) / half[axis]);
    let along: [f64; 3] = core::array::from_fn(|axis| ray.direction[axis] / half[axis]);
    let (enter, leave) = roots(dot(along, along), dot(from, along), dot(from, from) - 1.0)?;
    let normal = core::array::from_fn(|axis| (from[axis] + enter * along[axis]) / half[axis]);
    let incidence = dot(normal, ray.direction).abs() / libm::sqrt(dot(normal, normal));
    Some(Span { enter, leave, axis: 2, incidence })
}

/// An upright cylinder about the vertical axis through the origin of the ray's coordinates; its ends are
/// open, since no cylinder is seen from above.
pub(super) fn through_cylinder(ray: &Ray, radius: f64, height: [f64; 2]) -> Option<Span> {
    let flat = |v: [f64; 3]| [v[0], v[1], 0.0];
    let (from, along) = (flat(ray.origin), flat(ray.direction));
    let (enter, leave) = roots(dot(along, along), dot(from, along), dot(from, from) - radius * radius)?;
    let [x, y, z] = ray.at(enter);
    let incidence = dot([x, y, 0.0], along).abs() / radius;
    (height[0] <= z && z <= height[1]).then_some(Span { enter, leave, axis: 0, incidence })
}

/// The solutions of a t^2 + 2 b t + c = 0, the smaller one first.
fn roots(a: f64, b: f64, c: f64) -> Option<(f64, f64)> {
    let inside = b * b - a * c;
    (inside > 0.0 && a > 0.0).then(|| {
        let root = libm::sqrt(inside);
        ((-b - root) / a, (-b + root) / a)
    })
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_enters_and_leaves_where_the_body_is() {
        let ray = Ray::new([-5.0, 0.0, 0.5], [1.0, 0.0, 0.0]);
        let span = through_box(&ray, [-1.0, -1.0, 0.0], [2.0, 1.0, 1.0]).unwrap();
        assert_eq!((span.enter, span.leave, span.axis, span.incidence), (4.0, 7.0, 0, 1.0));
        let span = through_ellipsoid(&ray, [0.0, 0.0, 0.5], [2.0, 1.0, 1.0]).unwrap();
        assert!((span.enter - 3.0).abs() < 1e-12 && (span.leave - 7.0).abs() < 1e-12);
        assert!((span.incidence - 1.0).abs() < 1e-12);
        let span = through_cylinder(&ray, 0.5, [0.0, 1.0]).unwrap();
        assert!((span.enter - 4.5).abs() < 1e-12 && (span.incidence - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_ray_past_the_body_misses() {
        let ray = Ray::new([-5.0, 1.5, 0.5], [1.0, 0.0, 0.0]);
        assert!(through_box(&ray, [-1.0, -1.0, 0.0], [2.0, 1.0, 1.0]).is_none());
        assert!(through_ellipsoid(&ray, [0.0, 0.0, 0.5], [2.0, 1.0, 1.0]).is_none());
        assert!(through_cylinder(&ray, 0.5, [0.0, 1.0]).is_none());
        let over = Ray::new([-5.0, 0.0, 1.5], [1.0, 0.0, 0.0]);
        assert!(through_cylinder(&over, 0.5, [0.0, 1.0]).is_none());
    }
}
