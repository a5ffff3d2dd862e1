//! The rotating head: when it fires, what it measures, and the order of the points in the file.

use libm::{exp, rint, sqrt};

use super::SynthConfig;
use super::beams::{Beam, STEP, Stored, TICKS};
use super::ground::Ground;
use super::ray::{Hit, Ray, through_box};
use super::street::Scene;
use super::trajectory::Pose;
use crate::ground::random::Rng;

/// Firings in a turn at 10 turns a second; the motor is not perfectly steady.
const FIRINGS: [f64; 2] = [2148.6, 2165.4];
/// Unsteadiness from one firing to the next: sigma in ticks.
const JITTER: f64 = 0.01;
/// Probability that a point's tick is one too high.
const STRAY: f64 = 1e-5;
/// The roof that carries the scanner, in the scanner's coordinates (metres).
const ROOF: ([f64; 3], [f64; 3]) = ([-1.6, -0.75, -2.0], [1.0, 0.75, -0.35]);
/// Sensitivity: the higher it is, the farther away dark and slanting surfaces are seen.
const SENSITIVITY: f64 = 90.0;
/// The distance to which `SENSITIVITY` applies, in metres.
const SENSITIVITY_RANGE: f64 = 50.0;
/// Noise of the intensity, sigma: hundredths, and speckle as a share of the intensity itself.
const INTENSITY_NOISE: f64 = 2.5;
const SPECKLE: f64 = 0.1;

/// The ticks of the firings of a turn, as columns that all beams share; every `thinning`-th of them.
pub(super) fn columns(rng: &mut Rng, thinning: usize) -> Vec<i32> {
    let spacing = f64::from(TICKS) / rng.between(FIRINGS[0], FIRINGS[1]);
    let mut at = rng.between(0.0, 1.0);
    let mut columns = Vec::new();
    while at < f64::from(TICKS) {
        columns.push(at as i32);
        at += spacing + JITTER * rng.normal();
    }
    columns.into_iter().step_by(thinning.max(1)).collect()
}

/// A frame under construction.
pub(super) struct Scanner<'a> {
    pub config: &'a SynthConfig,
    pub ground: &'a Ground,
    pub beams: &'a [Beam],
}

impl Scanner<'_> {
    /// The points of a frame, as x, y, z and intensity in the order of the file.
    pub(super) fn scan(&self, frame: usize) -> Vec<[f32; 4]> {
        let time = frame as f64;
        let middle = Pose::at(self.config, self.ground, time);
        let scene = Scene::new(self.config, self.ground, [middle.origin[0], middle.origin[1]], time);
        let columns = columns(&mut self.rng(frame, usize::MAX), self.config.thinning);
        let firings: Vec<(i32, Pose)> =
            columns.into_iter().map(|column| (column, self.pose(time, column))).collect();
        let rows = self.beams.iter().enumerate();
        rows.flat_map(|(row, beam)| self.row(&scene, beam, &firings, &mut self.rng(frame, row))).collect()
    }

    fn rng(&self, frame: usize, row: usize) -> Rng {
        Rng::keyed(self.config.seed, &[u64::from(b'f'), frame as u64, row as u64])
    }

    /// The scanner's pose when it fires in a column. A turn begins and ends behind the car.
    fn pose(&self, time: f64, column: i32) -> Pose {
        let turned = f64::from((column + TICKS / 2) % TICKS) / f64::from(TICKS) - 0.5;
        pose(self.config, self.ground, time, turned)
    }

    /// The points of one beam. They are sorted by azimuth before rounding, 0 to 360 degrees, so the ticks are
    /// not in order at the seam, and where a near point precedes a far one.
    fn row(&self, scene: &Scene, beam: &Beam, firings: &[(i32, Pose)], rng: &mut Rng) -> Vec<[f32; 4]> {
        let mut row: Vec<(Stored, f32)> = Vec::with_capacity(firings.len());
        for (column, pose) in firings {
            row.extend(self.fire(scene, beam, *column, pose, rng));
        }
        row.sort_by(|a, b| a.0.azimuth.total_cmp(&b.0.azimuth));
        row.into_iter().map(|(Stored { position: [x, y, z], .. }, intensity)| [x, y, z, intensity]).collect()
    }

    /// One pulse: the point and its intensity, if enough light returns.
    fn fire(
        &self,
        scene: &Scene,
        beam: &Beam,
        column: i32,
        pose: &Pose,
        rng: &mut Rng,
    ) -> Option<(Stored, f32)> {
        let tick = (column - beam.shift).rem_euclid(TICKS);
        let hit = look(scene, &leave(beam, tick), pose, rng)?;
        let distance = measured(self.config, &hit, rng)?;
        let steps = rint((distance - beam.distance_offset()) / STEP).max(1.0) as u32;
        let stray = i32::from(rng.chance(STRAY));
        Some((beam.point((tick + stray) % TICKS, steps), intensity(&hit, beam.gain, rng)))
    }
}

/// The scanner's measurement along a ray that hits something: the distance in metres, with noise. `None` if
/// not enough light returns, or if the surface is too near or too far.
pub(super) fn measured(config: &SynthConfig, hit: &Hit, rng: &mut Rng) -> Option<f64> {
    let noise = sqrt(config.noise * config.noise + hit.scatter * hit.scatter);
    let distance = hit.distance + noise * rng.normal();
    let is_heard = is_heard(config, hit, rng);
    (is_heard && distance >= config.min_range && distance <= config.max_range).then_some(distance)
}

/// Whether a return is strong enough and not lost by chance.
fn is_heard(config: &SynthConfig, hit: &Hit, rng: &mut Rng) -> bool {
    let range = hit.distance / SENSITIVITY_RANGE;
    let strength = SENSITIVITY * hit.reflectivity * hit.incidence / (range * range);
    rng.chance((1.0 - exp(-strength)) * (1.0 - hit.loss) * (1.0 - config.dropout))
}

/// The scanner's pose at a fraction of its turn, from -0.5 to 0.5.
pub(super) fn pose(config: &SynthConfig, ground: &Ground, time: f64, turned: f64) -> Pose {
    Pose::at(config, ground, if config.rolling { time + turned } else { time })
}

/// The ray of a beam in the scanner's coordinates.
fn leave(beam: &Beam, tick: i32) -> Ray {
    let (sin_v, cos_v) = beam.slope();
    let (sin, cos) = libm::sincos(beam.azimuth(tick));
    Ray {
        origin: [-beam.side * sin, beam.side * cos, beam.origin_height()],
        direction: [cos_v * cos, cos_v * sin, sin_v],
    }
}

/// What a ray of the scanner hits: the roof under it, or the street.
pub(super) fn look(scene: &Scene, ray: &Ray, pose: &Pose, rng: &mut Rng) -> Option<Hit> {
    if let Some(span) = through_box(ray, ROOF.0, ROOF.1).filter(|span| span.enter > 0.0) {
        return Some(Hit::plain(span.enter, span.incidence, 0.4));
    }
    scene.trace(&Ray { origin: pose.place(ray.origin), direction: pose.turn(ray.direction) }, rng)
}

/// Intensity as stored: hundredths, 0.00 to 0.99. The scanner compensates for most of the distance; slanting
/// surfaces look darker.
fn intensity(hit: &Hit, gain: f64, rng: &mut Rng) -> f32 {
    (brightness(hit, gain, rng).clamp(0.0, 99.0) / 100.0) as f32
}

/// As [`intensity`], as a whole number without limits.
pub(super) fn brightness(hit: &Hit, gain: f64, rng: &mut Rng) -> f64 {
    let facing = 0.35 + 0.65 * sqrt(hit.incidence);
    let fading = 1.0 / (1.0 + hit.distance / 120.0);
    let level = 100.0 * gain * hit.reflectivity * facing * fading;
    let noise = (INTENSITY_NOISE + SPECKLE * level) * rng.normal();
    rint(level + noise)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn firings_are_two_ticks_apart_and_now_and_then_one() {
        for seed in 0..20 {
            let columns = columns(&mut Rng::keyed(seed, &[]), 1);
            assert!((2147..=2167).contains(&columns.len()), "{}", columns.len());
            let gaps: Vec<i32> = columns.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.iter().all(|gap| [1, 2].contains(gap)));
            let singles = gaps.iter().filter(|gap| **gap == 1).count();
            assert!((250..400).contains(&singles), "{singles}");
            assert!(columns.iter().all(|column| (0..TICKS).contains(column)));
        }
    }

    #[test]
    fn thinning_takes_some_of_the_same_firings() {
        let all = columns(&mut Rng::keyed(4, &[]), 1);
        let some = columns(&mut Rng::keyed(4, &[]), 4);
        assert!(some.iter().enumerate().all(|(at, column)| *column == all[4 * at]));
        assert_eq!(some.len(), all.len().div_ceil(4));
    }
}
