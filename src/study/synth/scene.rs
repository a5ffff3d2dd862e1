//! Everything that the scanner can see in one frame, sorted by direction so that few objects must be tested
//! for a ray.

use libm::{asin, atan2, sqrt};

use super::SynthConfig;
use super::ground::Ground;
use super::ray::{Hit, Ray};
use super::street::things;
use super::thing::{Thing, nearer};
use crate::ground::random::Rng;

/// Sectors of the horizon.
const SECTORS: usize = 512;

/// The surroundings of one frame.
#[derive(Debug)]
pub(super) struct Scene<'a> {
    ground: &'a Ground,
    things: Vec<Thing>,
    /// For every sector the objects in it, sorted by their least possible distance, with that distance.
    sectors: Vec<Vec<(f64, usize)>>,
    reach: f64,
}

impl<'a> Scene<'a> {
    /// The surroundings of a position on the plan, at a time counted in frames.
    pub(super) fn new(config: &SynthConfig, ground: &'a Ground, middle: [f64; 2], time: f64) -> Self {
        let reach = config.max_range.clamp(0.0, 1000.0);
        let things = things(config, ground, middle[0] - reach, middle[0] + reach, time);
        let mut sectors = vec![Vec::new(); SECTORS];
        // The scanner moves by half a frame's distance to either side of the middle.
        let margin = 0.5 * config.speed.abs() + 0.2;
        for (index, thing) in things.iter().enumerate() {
            enter(&mut sectors, index, thing, middle, margin);
        }
        for sector in &mut sectors {
            sector.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        Scene { ground, things, sectors, reach }
    }

    /// The first surface that a ray hits within reach.
    pub(super) fn trace(&self, ray: &Ray, rng: &mut Rng) -> Option<Hit> {
        let mut best = self.ground.hit(ray, self.reach);
        let sector = sector(atan2(ray.direction[1], ray.direction[0]));
        for &(nearest, index) in &self.sectors[sector.rem_euclid(SECTORS as i64) as usize] {
            if best.is_some_and(|hit| hit.distance < nearest) {
                break;
            }
            best = nearer(best, self.things[index].hit(ray, rng));
        }
        best
    }
}

/// Number of the sector of an angle in radians, not yet wrapped.
fn sector(angle: f64) -> i64 {
    libm::floor(angle / core::f64::consts::TAU * SECTORS as f64) as i64
}

/// Adds an object to all sectors in which it may be visible.
fn enter(sectors: &mut [Vec<(f64, usize)>], index: usize, thing: &Thing, middle: [f64; 2], margin: f64) {
    let (x, y) = (thing.place[0] - middle[0], thing.place[1] - middle[1]);
    let (distance, radius) = (sqrt(x * x + y * y), thing.radius() + margin);
    let (first, last) = if distance > radius {
        let (bearing, half) = (atan2(y, x), asin(radius / distance));
        (sector(bearing - half), sector(bearing + half))
    } else {
        (0, SECTORS as i64 - 1)
    };
    for sector in first..=last {
        sectors[sector.rem_euclid(SECTORS as i64) as usize].push((distance - radius, index));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The slow, simple way: test every object.
    fn ask_all(scene: &Scene, ray: &Ray) -> Option<Hit> {
        let found = scene.things.iter().map(|thing| thing.hit(ray, &mut Rng::keyed(1, &[])));
        found.fold(scene.ground.hit(ray, scene.reach), nearer)
    }

    #[test]
    fn sectors_hide_nothing() {
        let (config, ground) = (SynthConfig::default(), Ground::new(2));
        let mut scene = Scene::new(&config, &ground, [40.0, -1.8], 50.0);
        // Leaves are hit at random. Without them both ways must agree to the bit.
        for thing in &mut scene.things {
            if let super::super::thing::Kind::Foliage { gap, .. } = &mut thing.kind {
                *gap = 1e9;
            }
        }
        let mut on_things = 0;
        for turn in 0..1500 {
            let (sin, cos) = libm::sincos(f64::from(turn) * 0.0041);
            let ray = Ray::new([40.3, -1.7, ground.height(40.3, -1.7) + 1.9], [cos, sin, -0.03]);
            let (fast, slow) = (scene.trace(&ray, &mut Rng::keyed(1, &[])), ask_all(&scene, &ray));
            assert_eq!(fast.map(|hit| hit.distance), slow.map(|hit| hit.distance));
            on_things +=
                usize::from(slow.map(|hit| hit.distance) != ground.hit(&ray, 120.0).map(|hit| hit.distance));
        }
        assert!(on_things > 500, "{on_things}");
    }
}
