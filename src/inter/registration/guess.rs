//! Starting points if the motion is unknown: a car drives ahead at any speed, straight or in a bend.

use super::pose::Pose;
use super::projective::Aim;
use super::surface::Surfel;

/// Step between the candidates' distances, in metres per frame: up to 45 m/s at ten frames a second, and
/// backwards.
const STEP: f64 = 0.5;
const FORWARD: i32 = 9;
const BACKWARD: i32 = 2;
/// Step between the candidates' rotations, in radians per frame.
const TURN: f64 = 0.025;
const TURNS: i32 = 2;
/// A surfel agrees if it is within this many metres of the return in its direction.
const REACH: f64 = 0.4;
/// Number of surfels that are compared.
const FEW: usize = 1000;
/// Number of starting points that are worth trying.
const BEST: usize = 3;

/// The motions, out of many, for which the most surfels agree with the returns in their directions.
pub fn starts(aim: &Aim, surfels: &[Surfel]) -> Vec<Pose> {
    let few: Vec<Surfel> = super::evenly(surfels, FEW).copied().collect();
    let mut starts = Vec::new();
    for step in -BACKWARD..=FORWARD {
        for turn in -TURNS..=TURNS {
            let translation = [-STEP * f64::from(step), 0.0, 0.0];
            let start = Pose { yaw: TURN * f64::from(turn), translation, ..Pose::default() };
            let agreeing = aim.step(&few, &start.motion(), REACH).map_or(0, |step| step.agreeing);
            starts.push((agreeing, start));
        }
    }
    starts.sort_by_key(|(agreeing, _)| std::cmp::Reverse(*agreeing));
    starts.into_iter().take(BEST).map(|(_, start)| start).collect()
}
