//! The ground: a road with kerbs and pavements, sloping and undulating.

use super::ray::{Hit, Ray};
use crate::ground::random::{hash, unit};

/// Half the width of the road, from its middle to either kerb, in metres.
pub(super) const KERB: f64 = 6.5;
/// Height of the kerbs, in metres.
const KERB_HEIGHT: f64 = 0.12;
/// Where the paved part ends and grass begins, in metres from the middle of the road.
const VERGE: f64 = 9.0;
/// Rise along the road and across it, in metres a metre.
const CLIMB: f64 = 0.015;
const TILT: f64 = 0.01;
/// Fall of the road from its middle to the kerbs, in metres per metre.
const CAMBER: f64 = 0.015;
/// The undulation along the road: metres between supports, and metres from low to high.
const WAVE_LENGTH: f64 = 25.0;
const WAVE_HEIGHT: f64 = 0.35;
/// All slopes together are never steeper than this.
const STEEPEST: f64 = 0.08;
/// Cells of the ground's brightness, in metres.
const PATCH: f64 = 0.7;

/// The shape of the ground. Along the road is x, across it y, in metres.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    seed: u64,
}

impl Ground {
    pub(super) fn new(seed: u64) -> Self {
        Ground { seed }
    }

    /// Height at a place, pavements and kerbs included, in metres.
    pub(super) fn height(&self, x: f64, y: f64) -> f64 {
        self.base(x, y) + if y.abs() < KERB { 0.0 } else { KERB_HEIGHT }
    }

    /// Slopes along and across the road, without the camber.
    pub(super) fn slopes(&self, x: f64) -> [f64; 2] {
        [CLIMB + self.wave(x).1, TILT]
    }

    /// Height without the kerbs, which is continuous, so that a ray can be followed over it.
    fn base(&self, x: f64, y: f64) -> f64 {
        CLIMB * x + TILT * y - CAMBER * y.abs().min(KERB) + self.wave(x).0
    }

    /// The undulation and its slope.
    fn wave(&self, x: f64) -> (f64, f64) {
        let place = x / WAVE_LENGTH;
        let cell = libm::floor(place);
        let support = |offset: f64| WAVE_HEIGHT * unit(hash(self.seed, &[(cell + offset) as i64 as u64]));
        let (left, right, at) = (support(0.0), support(1.0), place - cell);
        let blend = at * at * (3.0 - 2.0 * at);
        (left + (right - left) * blend, (right - left) * 6.0 * at * (1.0 - at) / WAVE_LENGTH)
    }

    /// The point where a ray meets the ground, if it is at most `reach` metres away.
    pub(super) fn hit(&self, ray: &Ray, reach: f64) -> Option<Hit> {
        let kerb = self.kerb_distance(ray).min(reach);
        if let Some(distance) = self.march(ray, 0.0, kerb, 0.0) {
            return Some(self.surface(ray, distance));
        }
        if kerb >= reach {
            return None;
        }
        let [x, y, z] = ray.at(kerb);
        if z < self.base(x, y) + KERB_HEIGHT {
            return Some(Hit::plain(kerb, ray.direction[1].abs(), 0.35));
        }
        self.march(ray, kerb, reach, KERB_HEIGHT).map(|distance| self.surface(ray, distance))
    }

    /// Distance to the kerb that the ray crosses; 0 if it starts beyond it.
    fn kerb_distance(&self, ray: &Ray) -> f64 {
        let (from, along) = (ray.origin[1], ray.direction[1]);
        if from.abs() >= KERB {
            0.0
        } else if along == 0.0 {
            f64::INFINITY
        } else {
            (KERB.copysign(along) - from) / along
        }
    }

    /// First distance between `from` and `to` at which the ray is down to `lift` above the base. A stride
    /// is as long as the steepest slope allows, or 5 % of the way, whichever is more; crests that such a
    /// stride misses are lower than any that the undulation makes.
    fn march(&self, ray: &Ray, from: f64, to: f64, lift: f64) -> Option<f64> {
        let closing = STEEPEST - ray.direction[2];
        let above = |distance: f64| {
            let [x, y, z] = ray.at(distance);
            z - self.base(x, y) - lift
        };
        let (mut near, mut over) = (from, above(from));
        while closing > 0.0 && over > 0.0 && near < to {
            let far = (near + (over / closing).max(0.05 * near)).min(to);
            let under = above(far);
            if under <= 0.0 {
                return Some(false_position(above, (near, over), (far, under)));
            }
            (near, over) = (far, under);
        }
        None
    }

    /// The ground as seen by the ray at a distance.
    fn surface(&self, ray: &Ray, distance: f64) -> Hit {
        let [x, y, _] = ray.at(distance);
        let [along, across] = self.slopes(x);
        let camber = if y.abs() < KERB { CAMBER.copysign(y) } else { 0.0 };
        let [dx, dy, dz] = ray.direction;
        let incidence = (dx * along + dy * (across - camber) - dz).abs();
        let tone = self.tone(x, y);
        if y.abs() > VERGE {
            return Hit { scatter: 0.03, ..Hit::plain(distance, incidence + 0.05, 0.35 * tone) };
        }
        let paint = is_marking(x, y);
        Hit::plain(distance, incidence, if paint { 0.75 } else { 0.37 * tone })
    }

    /// Patches of lighter and darker ground.
    fn tone(&self, x: f64, y: f64) -> f64 {
        let cell = |v: f64| libm::floor(v / PATCH) as i64 as u64;
        0.85 + 0.3 * unit(hash(self.seed, &[cell(x), cell(y)]))
    }
}

/// The dashed line in the middle of the road, and the solid ones along the parked cars.
fn is_marking(x: f64, y: f64) -> bool {
    let dashed = y.abs() < 0.06 && x.rem_euclid(9.0) < 3.0;
    dashed || (y.abs() - 3.9).abs() < 0.05
}

/// The zero between a point above and one below, far more accurate than the noise.
fn false_position(above: impl Fn(f64) -> f64, near: (f64, f64), far: (f64, f64)) -> f64 {
    let (mut near, mut far) = (near, far);
    let mut middle = far.0;
    for _ in 0..4 {
        middle = near.0 + (far.0 - near.0) * near.1 / (near.1 - far.1);
        let height = above(middle);
        if height > 0.0 {
            near = (middle, height);
        } else {
            far = (middle, height);
        }
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_end_on_the_ground() {
        let ground = Ground::new(5);
        let origin = [3.0, -1.8, ground.height(3.0, -1.8) + 1.9];
        let mut hits = 0;
        for turn in 0..60 {
            for fall in 1..20 {
                let (sin, cos) = libm::sincos(f64::from(turn) * 0.1);
                let down = -0.02 * f64::from(fall);
                let ray = Ray::new(origin, [cos, sin, down]);
                let Some(hit) = ground.hit(&ray, 200.0) else { continue };
                let [x, y, z] = ray.at(hit.distance);
                let gap = z - ground.height(x, y);
                let on_kerb = (y.abs() - KERB).abs() < 1e-6 && gap.abs() <= KERB_HEIGHT + 1e-6;
                assert!(gap.abs() < 0.003 || on_kerb, "{gap} at {x} {y}");
                hits += 1;
            }
        }
        assert!(hits > 1000, "{hits}");
    }

    #[test]
    fn slope_is_the_derivative_of_the_height() {
        let ground = Ground::new(5);
        for place in 0..40 {
            let x = 3.3 * f64::from(place) - 50.0;
            let measured = (ground.height(x + 1e-5, 0.0) - ground.height(x - 1e-5, 0.0)) / 2e-5;
            assert!((measured - ground.slopes(x)[0]).abs() < 1e-6);
        }
    }
}
