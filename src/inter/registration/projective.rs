//! Projective registration: each surfel of the reference is compared with the return at the cell of the
//! current image where the surfel would be visible, which avoids a search for neighbours. The distance is
//! from point to plane, and outliers have little weight (equation 8, with an information matrix along the
//! normal). If the motion is unknown, it starts from several: a car drives ahead at any speed, straight or in
//! a bend.

use std::f64::consts::PI;

use nalgebra::{Matrix6, Vector3, Vector6};

use super::pose::{Pose, RigidMotion};
use super::surface::{Surface, Surfel, dot};
use super::{Step, small_step};
use crate::ground::floats::square;
use crate::scanner::hdl64::Hdl64;
use crate::scanner::{RangeImage, thinned};

/// The current image, with which surfels are compared.
pub struct Aim<'a> {
    scanner: &'a Hdl64,
    current: &'a RangeImage,
    column_of_tick: Vec<Option<u32>>,
}

impl<'a> Aim<'a> {
    /// Prepares an image.
    pub fn at(scanner: &'a Hdl64, current: &'a RangeImage) -> Self {
        Aim { scanner, current, column_of_tick: columns_by_tick(&current.columns, scanner.ticks) }
    }

    /// One Gauss-Newton step with Tukey's weights, composed with `motion`. `None` if the surfels do not
    /// determine one.
    pub fn step(&self, surfels: &[Surfel], motion: &RigidMotion, reach: f64) -> Option<Step> {
        let (mut normal, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
        let (mut agreeing, mut weights) = (0, 0.0);
        for surfel in surfels {
            let position = motion.apply(surfel.position);
            let Some(seen) = self.seen(surfel.cell.0 as usize, position) else { continue };
            let facing = motion.turn(surfel.normal);
            let facing = Vector3::from(facing) / dot(facing, facing).sqrt();
            let position = Vector3::from(position);
            let off = facing.dot(&(Vector3::from(seen) - position));
            if off.is_nan() || off.abs() >= reach {
                continue;
            }
            agreeing += 1;
            let weight = square(1.0 - square(off / reach));
            weights += weight;
            let turned = position.cross(&facing);
            let gradient = Vector6::new(turned.x, turned.y, turned.z, facing.x, facing.y, facing.z);
            normal.ger(weight, &gradient, &gradient, 1.0);
            right.axpy(weight * off, &gradient, 1.0);
        }
        // Slight damping, without which there is no solution in a featureless tunnel.
        let damping = 1e-6 * normal.trace();
        let solution = (normal + Matrix6::identity() * damping).cholesky()?.solve(&right);
        let [roll, pitch, yaw, x, y, z] = solution.into();
        let step = Pose { yaw, pitch, roll, translation: [x, y, z] };
        small_step(step.motion(), agreeing, weights)
    }

    /// The return of the current image in the cell where a point would be visible.
    fn seen(&self, row: usize, position: [f64; 3]) -> Option<[f64; 3]> {
        let sighting = self.scanner.locate(row, position)?;
        let column = self.column_of_tick[sighting.column_tick as usize]? as usize;
        let steps = self.current.steps[(sighting.row, column)];
        let tick = self.scanner.tick_of_column(sighting.row, self.current.columns[column]);
        (steps > 0).then(|| self.scanner.point(sighting.row, tick, steps))
    }
}

/// Classes of orientation: up or down, and equal parts of a half turn.
const WAYS: usize = 13;

/// At most `most` surfels with a normal, distributed over the orientations as evenly as possible. Otherwise
/// the ground and the walls of a street, which carry no information on the distance travelled along it, would
/// outvote everything else.
pub fn sample(surface: &Surface, most: usize) -> Vec<Surfel> {
    let mut by_way: [Vec<Surfel>; WAYS] = Default::default();
    for surfel in surface.surfels.iter().filter(|surfel| surfel.normal != [0.0; 3]) {
        by_way[way(surfel.normal)].push(*surfel);
    }
    by_way.sort_by_key(Vec::len);
    let (mut chosen, mut room) = (Vec::new(), most);
    for (surfels, ways) in by_way.iter().zip((1..=WAYS).rev()) {
        let before = chosen.len();
        chosen.extend(thinned(surfels, room / ways));
        room -= chosen.len() - before;
    }
    chosen
}

fn way([x, y, z]: [f64; 3]) -> usize {
    if z * z > x * x + y * y {
        return 0;
    }
    let part = libm::atan2(y, x).rem_euclid(PI) / PI * (WAYS - 1) as f64;
    1 + (part as usize).min(WAYS - 2)
}

/// The column nearest to each tick, at most one tick away.
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
    let few: Vec<Surfel> = thinned(surfels, FEW).copied().collect();
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
