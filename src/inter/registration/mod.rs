//! The motion of the scanner from one frame to the next (article, V-A and V-B). Only the encoder estimates
//! it; both sides apply it.

#[cfg(feature = "article")]
mod icp;
mod pose;
mod projective;
mod surface;

pub use pose::{Pose, QuantisedPose, RigidMotion};
pub use projective::columns_by_tick;
pub use surface::{Surface, Surfel, dot};

use crate::ground::error::{Error, Result};
use crate::scanner::hdl64::Hdl64;
use crate::scanner::{RangeImage, thinned};
#[cfg(feature = "article")]
use icp::NearestPoints;
use projective::Aim;

/// The elements that registration compares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RegistrationMethod {
    /// Planes of the reference with the returns in their directions. On real drives five times as fast as
    /// ICP, and more accurate.
    #[default]
    Projective,
    /// Points with their nearest points: the article's ICP.
    #[cfg(feature = "article")]
    Icp,
}

/// How a motion is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationConfig {
    /// The elements that are compared. Default: projective.
    pub method: RegistrationMethod,
    /// The largest number of surfels or points that are compared, sampled evenly. Default 6000.
    pub most_points: usize,
    /// The largest number of iterations. Default 25.
    pub most_iterations: usize,
    /// Distance in metres beyond which a pair is ignored, in the first and in the last iteration. Default 2
    /// and 0.15.
    pub reach_m: [f64; 2],
    /// Convergence: an iteration moves by less than this in metres, and rotates by less than this in tenths
    /// of a radian. Default 0.0005.
    pub precision_m: f64,
    /// The share of the points that must agree in the end. Default 0.25.
    pub least_overlap: f64,
}

impl Default for RegistrationConfig {
    fn default() -> Self {
        RegistrationConfig {
            method: RegistrationMethod::Projective,
            most_points: 6000,
            most_iterations: 25,
            reach_m: [2.0, 0.15],
            precision_m: 0.0005,
            least_overlap: 0.25,
        }
    }
}

impl RegistrationConfig {
    /// Checks that all settings are in range.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] names the setting that is not.
    pub fn check(&self) -> Result<()> {
        let lengths = [self.reach_m[0], self.reach_m[1], self.precision_m];
        let settings = [
            ("points to compare", self.most_points > 0),
            ("iterations", self.most_iterations > 0),
            ("reach or precision", lengths.iter().all(|length| *length > 0.0 && length.is_finite())),
            ("least overlap", (0.0..=1.0).contains(&self.least_overlap)),
        ];
        match settings.iter().find(|(_, holds)| !holds) {
            Some((name, _)) => Err(Error::InvalidSettings(format!("registration: {name} out of range"))),
            None => Ok(()),
        }
    }
}

/// If the fit is this good, no further starting points are tried.
const CERTAIN_FIT: f64 = 0.6;

/// An estimated motion.
#[derive(Clone, Copy, Debug)]
pub struct Registration {
    /// The motion from the reference to the current frame.
    pub pose: Pose,
    /// The fraction of the points that agree; points farther off have less weight.
    pub fit: f64,
}

/// One iteration.
struct Step {
    motion: RigidMotion,
    /// Length of the motion, in metres and tenths of a radian.
    length: f64,
    /// Number of points within reach.
    agreeing: usize,
    /// The sum of their weights.
    weights: f64,
}

/// An iteration with this motion; `None` if the motion is not valid.
fn small_step(motion: RigidMotion, agreeing: usize, weights: f64) -> Option<Step> {
    let pose = motion.pose();
    let length = dot(pose.translation, pose.translation).sqrt() + 10.0 * pose.angle();
    length.is_finite().then_some(Step { motion, length, agreeing, weights })
}

/// Finds the motion that brings the surface to where `current` shows it, starting from `initial`. `None` if
/// there is too little to compare, or if the result does not fit.
pub fn register(
    reference: &Surface,
    current: &RangeImage,
    scanner: &Hdl64,
    initial: &Pose,
    config: &RegistrationConfig,
) -> Option<Registration> {
    match config.method {
        RegistrationMethod::Projective => {
            let surfels = projective::sample(reference, config.most_points);
            let aim = Aim::at(scanner, current);
            let from = |start: &Pose| {
                approach(config, start, surfels.len(), |motion, reach| aim.step(&surfels, motion, reach))
            };
            let found = from(initial);
            if found.is_some_and(|found| found.fit >= CERTAIN_FIT) {
                return found;
            }
            let others = projective::starts(&aim, &surfels);
            let all = found.into_iter().chain(others.iter().filter_map(from));
            all.max_by(|a, b| a.fit.total_cmp(&b.fit))
        }
        #[cfg(feature = "article")]
        RegistrationMethod::Icp => {
            /// Number of points of the reference for each point of the current frame.
            const DENSITY: usize = 4;
            let most = config.most_points.saturating_mul(DENSITY);
            let points = NearestPoints::of(thinned(&reference.surfels, most))?;
            let current = Surface::of(scanner, &current.columns, &current.steps).surfels;
            let current: Vec<_> =
                thinned(&current, config.most_points).map(|surfel| surfel.position).collect();
            approach(config, initial, current.len(), |motion, reach| points.step(&current, motion, reach))
        }
    }
}

/// Iterates until the steps are small. The reach shrinks with each iteration.
fn approach(
    config: &RegistrationConfig,
    initial: &Pose,
    points: usize,
    step: impl Fn(&RigidMotion, f64) -> Option<Step>,
) -> Option<Registration> {
    let [mut reach, last_reach] = config.reach_m;
    let mut motion = initial.motion();
    for iteration in 1..=config.most_iterations {
        let step = step(&motion, reach)?;
        motion = motion.then(&step.motion);
        let has_converged = step.length < config.precision_m && reach <= last_reach;
        if has_converged || iteration == config.most_iterations {
            let overlap = step.agreeing as f64 / points.max(1) as f64;
            let fit = step.weights / points.max(1) as f64;
            let found = Registration { pose: motion.pose(), fit };
            return (overlap >= config.least_overlap).then_some(found);
        }
        reach = (reach * 0.6).max(last_reach);
    }
    None
}
