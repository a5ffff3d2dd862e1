//! The path of the scanner: the car keeps to its lane and weaves slightly.

use libm::{cos, sin, sqrt};

use super::SynthConfig;
use super::ground::Ground;

/// Height of the scanner above the ground, in metres (Geiger et al. 2012, figure 3).
pub(super) const SENSOR_HEIGHT: f64 = 1.73;
/// The middle of the car's lane, in metres from the middle of the road.
pub(super) const LANE: f64 = -1.9;
/// The largest distance of the car from the middle of its lane, in metres.
const WEAVE: f64 = 0.6;
/// Frames for one weave to the left and right; fewer if this would leave the lane.
const PERIOD: f64 = 80.0;

/// Position and attitude of the scanner: maps the scanner's coordinates to those of the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    /// The columns are the scanner's forward, left and up directions.
    pub rotation: [[f64; 3]; 3],
    /// The position of the scanner, in metres.
    pub origin: [f64; 3],
}

impl Pose {
    /// The pose at a time in frames; whole numbers are the middle of a turn.
    pub(super) fn at(config: &SynthConfig, ground: &Ground, time: f64) -> Self {
        let ([x, y], yaw) = on_the_road(config, time);
        let [along, across] = ground.slopes(x);
        let (cos, sin) = (cos(yaw), sin(yaw));
        let forward = unit([cos, sin, cos * along + sin * across]);
        let left = [-sin, cos, cos * across - sin * along];
        let up = unit(cross(forward, left));
        let left = cross(up, forward);
        Pose {
            rotation: core::array::from_fn(|axis| [forward[axis], left[axis], up[axis]]),
            origin: [x, y, ground.height(x, y) + SENSOR_HEIGHT],
        }
    }

    /// Converts a direction from the scanner's coordinates to those of the world.
    pub(super) fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// Converts a position from the scanner's coordinates to those of the world.
    pub(super) fn place(&self, v: [f64; 3]) -> [f64; 3] {
        let turned = self.turn(v);
        core::array::from_fn(|axis| turned[axis] + self.origin[axis])
    }

    /// The first three rows of the 4 x 4 matrix, one after the other.
    pub(super) fn row_major(&self) -> [f64; 12] {
        core::array::from_fn(
            |at| if at % 4 == 3 { self.origin[at / 4] } else { self.rotation[at / 4][at % 4] },
        )
    }
}

/// Position on the plan, and heading, which varies as a sine whose steepest slope is the yaw rate.
fn on_the_road(config: &SynthConfig, time: f64) -> ([f64; 2], f64) {
    let slowest = core::f64::consts::TAU / PERIOD;
    let frequency = slowest.max(sqrt((config.speed * config.yaw_rate).abs() / WEAVE));
    let swing = config.yaw_rate / frequency;
    let y = LANE - config.speed * swing / frequency * cos(frequency * time);
    ([config.speed * time, y], swing * sin(frequency * time))
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = sqrt(v.iter().map(|v| v * v).sum());
    v.map(|v| v / length)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_rigid_and_in_the_lane() {
        let ground = Ground::new(3);
        let config = SynthConfig { yaw_rate: 0.03, speed: 1.5, ..SynthConfig::default() };
        for frame in 0..200 {
            let pose = Pose::at(&config, &ground, f64::from(frame) * 0.7);
            for (i, a) in pose.rotation.iter().enumerate() {
                for (j, b) in pose.rotation.iter().enumerate() {
                    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12);
                }
            }
            assert!((pose.origin[1] - LANE).abs() <= WEAVE + 1e-9);
        }
    }

    #[test]
    fn steps_are_as_long_and_turns_as_sharp_as_asked() {
        let ground = Ground::new(3);
        let config = SynthConfig { speed: 0.9, yaw_rate: 0.005, ..SynthConfig::default() };
        let [before, after] = [0.0, 1.0].map(|time| Pose::at(&config, &ground, time));
        assert!((after.origin[0] - before.origin[0] - 0.9).abs() < 1e-9);
        let yaw = libm::atan2(after.rotation[1][0], after.rotation[0][0]);
        assert!((yaw - 0.005).abs() < 1e-4, "{yaw}");
    }
}
