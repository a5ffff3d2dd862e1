//! A Velodyne VLP-16: sixteen lasers that fire one after the other, blocks of two firings that share one
//! azimuth in the scanner's packets, and points as the ROS driver `velodyne_pointcloud` computes them, in
//! single precision. Written independently of the codec's own recipe, so that one can test the other.

use libm::{cos, rint, sin};

use super::SynthConfig;
use super::ground::Ground;
use super::ray::Ray;
use super::scanner::{brightness, look, measured, pose};
use super::street::Scene;
use super::trajectory::Pose;
use crate::ground::random::Rng;

/// Elevations in degrees, in the order in which the lasers fire.
pub const VLP_16_ELEVATIONS: [i32; 16] = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];
/// One range step in metres.
const STEP: f64 = 0.002;
/// Azimuth ticks in a turn: hundredths of a degree.
const TICKS: u32 = 36_000;
/// Ticks from block to block at ten turns a second; the motor is not perfectly steady.
const BLOCK: f64 = 39.82;
const JITTER: f64 = 0.3;
/// Microseconds from laser to laser, from firing to firing, and from block to block.
const LASER_TIME: f32 = 2.304;
const FIRING_TIME: f32 = 55.296;
const BLOCK_TIME: f32 = 110.592;

/// The points of a frame, as x, y, z and intensity in the order of the file.
pub(super) fn scan(config: &SynthConfig, ground: &Ground, frame: usize) -> Vec<[f32; 4]> {
    let mut rng = Rng::keyed(config.seed, &[u64::from(b'v'), frame as u64]);
    let time = frame as f64;
    let middle = Pose::at(config, ground, time);
    let scene = Scene::new(config, ground, [middle.origin[0], middle.origin[1]], time);
    // A turn begins behind the car.
    let start = f64::from(TICKS) / 2.0 + rng.between(0.0, BLOCK);
    let mut blocks = vec![start];
    while let Some(&last) = blocks.last().filter(|last| **last < start + f64::from(TICKS)) {
        blocks.push(last + BLOCK + JITTER * rng.normal());
    }
    let blocks: Vec<u32> = blocks.into_iter().map(|tick| tick as u32).collect();
    let mut points = Vec::new();
    for pair in blocks.windows(2).step_by(config.thinning.max(1)) {
        let (tick, span) = (pair[0] % TICKS, pair[1] - pair[0]);
        let turned = (f64::from(pair[0]) - start) / f64::from(TICKS) - 0.5;
        let pose = pose(config, ground, time, turned);
        for firing in 0..2 {
            for (laser, elevation) in VLP_16_ELEVATIONS.into_iter().enumerate() {
                let tick = azimuth(tick, span, firing, laser);
                points.extend(fire(config, &scene, &pose, (elevation, tick), &mut rng));
            }
        }
    }
    points
}

/// The azimuth tick of a laser in a firing of a block, `span` ticks before the next block.
fn azimuth(tick: u32, span: u32, firing: usize, laser: usize) -> u32 {
    let passed = laser as f32 * LASER_TIME + firing as f32 * FIRING_TIME;
    (tick as f32 + span as f32 * passed / BLOCK_TIME).round() as u32 % TICKS
}

/// One pulse: the point and its intensity, if enough light returns.
fn fire(config: &SynthConfig, scene: &Scene, pose: &Pose, at: (i32, u32), rng: &mut Rng) -> Option<[f32; 4]> {
    let (elevation, tick) = (f64::from(at.0).to_radians(), f64::from(at.1).to_radians() / 100.0);
    // Azimuths run clockwise.
    let direction = [cos(elevation) * cos(tick), -cos(elevation) * sin(tick), sin(elevation)];
    let hit = look(scene, &Ray { origin: [0.0; 3], direction }, pose, rng)?;
    let distance = measured(config, &hit, rng)?;
    let steps = rint(distance / STEP).max(1.0);
    let intensity = brightness(&hit, 1.0, rng).clamp(0.0, 255.0);
    let [x, y, z] = point(at.0, at.1, steps as u32);
    Some([x, y, z, intensity as f32])
}

/// The coordinates for a range and a tick, with each operation rounded to single precision.
fn point(elevation: i32, tick: u32, steps: u32) -> [f32; 3] {
    let radians = |degrees: f64| f64::from((degrees * core::f64::consts::PI / 180.0) as f32);
    let vertical = radians(f64::from(elevation));
    let horizontal = radians(f64::from(0.01f32 * tick as f32));
    let distance = steps as f32 * 0.002f32;
    let along = distance * cos(vertical) as f32;
    [along * cos(horizontal) as f32, -(along * sin(horizontal) as f32), distance * sin(vertical) as f32]
}
