//! Registration by projection: each surfel of the reference is compared with the return that the
//! current image has where it would be seen. No search for neighbours is needed; the distance is that
//! of a point to a plane, and what does not fit counts little (article, equation 8, with an information
//! matrix along the normal).

use nalgebra::{Matrix6, Vector3, Vector6};

use super::pose::{Pose, RigidMotion};
use super::surface::{Surface, Surfel, dot};
use crate::range_image::RangeImage;
use crate::sensor::SensorModel;

/// How a motion is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationConfig {
    /// Surfels that are compared, at most, taken evenly. Default 6000.
    pub most_surfels: usize,
    /// Steps of Gauss-Newton, at most. Default 20.
    pub most_iterations: usize,
    /// Metres: surfels further off than this do not count, at first and at last. Default 1 and 0.15.
    pub reach_m: [f64; 2],
    /// Converged once a step moves by less than this in metres, and turns by less in 10^-1 rad.
    /// Default 0.0005.
    pub precision_m: f64,
    /// The part of the surfels that must agree in the end. Default 0.25.
    pub least_overlap: f64,
}

impl Default for RegistrationConfig {
    fn default() -> Self {
        RegistrationConfig {
            most_surfels: 6000,
            most_iterations: 20,
            reach_m: [1.0, 0.15],
            precision_m: 0.0005,
            least_overlap: 0.25,
        }
    }
}

/// A motion that was found.
#[derive(Clone, Copy, Debug)]
pub struct Registration {
    /// From the reference to the current frame.
    pub pose: Pose,
    /// The part of the surfels that agree.
    pub overlap: f64,
    /// Root mean square distance of those, in metres.
    pub rmse_m: f64,
    /// Steps taken.
    pub iterations: usize,
}

/// Finds the motion that takes the surface to where `current` shows it, starting at `initial`. None if
/// there is too little to compare, or it does not fit.
pub fn register(
    reference: &Surface,
    current: &RangeImage,
    sensor: &SensorModel,
    initial: &Pose,
    config: &RegistrationConfig,
) -> Option<Registration> {
    let known: Vec<&Surfel> = reference.surfels.iter().filter(|surfel| surfel.normal != [0.0; 3]).collect();
    let stride = known.len().div_ceil(config.most_surfels.max(1)).max(1);
    let surfels: Vec<Surfel> = known.into_iter().step_by(stride).copied().collect();
    let aim = Aim { sensor, current, column_of_tick: column_of_tick(current, sensor.ticks) };
    let mut motion = initial.motion();
    let mut reach = config.reach_m[0];
    for iteration in 1..=config.most_iterations {
        let step = aim.step(&surfels, &motion, reach)?;
        motion = motion.then(&step.motion);
        let small = step.length < config.precision_m;
        if small && reach <= config.reach_m[1] || iteration == config.most_iterations {
            let overlap = step.agreeing as f64 / surfels.len().max(1) as f64;
            let registration = Registration {
                pose: motion.pose(),
                overlap,
                rmse_m: (step.squares / step.agreeing.max(1) as f64).sqrt(),
                iterations: iteration,
            };
            return (overlap >= config.least_overlap).then_some(registration);
        }
        reach = (reach * 0.6).max(config.reach_m[1]);
    }
    None
}

/// What surfels are compared with.
struct Aim<'a> {
    sensor: &'a SensorModel,
    current: &'a RangeImage,
    column_of_tick: Vec<Option<u32>>,
}

struct Step {
    motion: RigidMotion,
    length: f64,
    agreeing: usize,
    squares: f64,
}

impl Aim<'_> {
    /// One step of Gauss-Newton with Tukey's weights. None if the surfels leave a direction open.
    fn step(&self, surfels: &[Surfel], motion: &RigidMotion, reach: f64) -> Option<Step> {
        let (mut normal, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
        let (mut agreeing, mut squares) = (0, 0.0);
        for surfel in surfels {
            let position = motion.apply(surfel.position);
            let Some(seen) = self.seen(surfel.cell.0 as usize, position) else { continue };
            let facing = motion.turn(surfel.normal);
            let facing = Vector3::from(facing) / dot(facing, facing).sqrt();
            let position = Vector3::from(position);
            let off = facing.dot(&(Vector3::from(seen) - position));
            if !(off.abs() < reach) {
                continue;
            }
            agreeing += 1;
            squares += off * off;
            let weight = (1.0 - (off / reach).powi(2)).powi(2);
            let turned = position.cross(&facing);
            let gradient = Vector6::new(turned.x, turned.y, turned.z, facing.x, facing.y, facing.z);
            normal.ger(weight, &gradient, &gradient, 1.0);
            right.axpy(weight * off, &gradient, 1.0);
        }
        // A hair of damping, or a tunnel without features has no answer.
        let damping = 1e-6 * normal.trace();
        let solution = (normal + Matrix6::identity() * damping).cholesky()?.solve(&right);
        let [roll, pitch, yaw, x, y, z] = solution.into();
        let step = Pose { yaw, pitch, roll, translation: [x, y, z] };
        let length = (x * x + y * y + z * z).sqrt() + 10.0 * step.angle();
        length.is_finite().then(|| Step { motion: step.motion(), length, agreeing, squares })
    }

    /// The return that the current image has where a point would be seen.
    fn seen(&self, row: usize, position: [f64; 3]) -> Option<[f64; 3]> {
        let sighting = self.sensor.locate(row, position)?;
        let column = self.column_of_tick[sighting.column_tick as usize]? as usize;
        let steps = self.current.steps[(sighting.row, column)];
        let tick = self.sensor.tick_of_column(sighting.row, self.current.columns[column]);
        (steps > 0).then(|| self.sensor.point(sighting.row, tick, steps))
    }
}

/// The nearest column of each tick, if it is near.
fn column_of_tick(image: &RangeImage, ticks: u32) -> Vec<Option<u32>> {
    columns_by_tick(&image.columns, ticks)
}

/// The nearest column of each tick, up to one tick away.
pub fn columns_by_tick(columns: &[u32], ticks: u32) -> Vec<Option<u32>> {
    let mut of_tick = vec![None; ticks as usize];
    for (column, &tick) in (0..).zip(columns) {
        for near in [(tick + 1) % ticks, (tick + ticks - 1) % ticks] {
            let place: &mut Option<u32> = &mut of_tick[near as usize];
            *place = place.or(Some(column));
        }
    }
    for (column, &tick) in (0..).zip(columns) {
        of_tick[tick as usize] = Some(column);
    }
    of_tick
}
