//! Where to start if nothing is known of the motion: a car drives ahead at any speed, straight or in a bend.

use super::pose::Pose;
use super::projective::Aim;
use super::surface::Surfel;

/// Metres between frames: up to 45 m/s at ten frames a second, and backwards.
const STEP: f64 = 0.5;
const FORWARD: i32 = 9;
const BACKWARD: i32 = 2;
/// Radians between frames.
const TURN: f64 = 0.025;
const TURNS: i32 = 2;
/// A surfel counts if it is within this many metres of what is seen in its place.
const REACH: f64 = 0.4;
/// Number of surfels that are looked at.
const FEW: usize = 1000;
/// Number of starts that are worth trying.
const BEST: usize = 3;

/// Of many motions, those under which the most surfels are near what is seen in their place.
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
