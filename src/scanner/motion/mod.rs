//! Undoing motion compensation. There are three kinds: by the motion of a turn, here; firing by firing
//! through the coordinates of a map, in [`world`]; and by the points' time stamps, in [`by_time`].
//! FORMAT.md 8.15.
//!
//! A moving scanner sees each point of a turn from a different position. Some data sets hold points that were
//! moved to where they would have been seen from the position in the middle of the turn (KITTI odometry).
//! Such coordinates are on no grid and on no beam's cone. Given the motion, they are moved back to the
//! measured ones, up to rounding.
//!
//! For a motion of rotation r (axis times angle) and translation t in one turn, a point v seen at azimuth
//! phi, from -pi to pi, is moved to
//!
//! ```text
//! s  = phi / (2 pi)
//! v' = R(s r) v + s t              R(a): the rotation about the axis a by the angle |a|
//! ```
//! `find` estimates the motion of a scan from the scan alone: [`cones`] brings the points of each beam onto a
//! cone, which determines all of the motion except the rotation about the cones' axis; [`grid`] brings them
//! onto the millimetre grid.

pub mod by_time;
mod cones;
mod find;
mod grid;
mod many;
mod payload;
mod turn;
mod units;
pub mod world;

pub use by_time::Stamped;
pub(in crate::scanner) use turn::Displacement;
pub use turn::{Motion, Mover};
pub use world::World;

use crate::scan::Channel;
use crate::scanner::CoordinateGrid;

/// How the points of a scan were moved.
#[derive(Clone, Debug, PartialEq)]
pub enum Compensation {
    /// By the motion of a turn.
    Turn(Turn),
    /// Through the coordinates of a map.
    World(World),
    /// By the points' time stamps.
    Stamped(Stamped),
}

/// The points as they were measured, and how they were moved to those of the file, with the misses still to
/// be found. `None` if they were not moved in any known way.
pub fn undo(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, Compensation)> {
    let of_map = world::undo(positions).map(|(points, world)| (points, Compensation::World(world)));
    of_map.or_else(|| find::undo(positions).map(|(points, turn)| (points, Compensation::Turn(turn))))
}

/// The points as they were measured; as [`undo`], but faster.
pub fn measured(positions: &[[f32; 3]]) -> Option<Vec<[f32; 3]>> {
    world::measured(positions).or_else(|| find::undo(positions).map(|(points, _)| points))
}

impl Compensation {
    /// Records the points of the file `positions` that the formula misses, given the decoded measured points:
    /// those that are not `near` it.
    pub fn find_misses(
        &mut self,
        (measured, channels): (&[[f32; 3]], &[Channel]),
        positions: &[[f32; 3]],
        near: impl Fn(&[f32; 3], &[f32; 3]) -> bool,
    ) {
        match self {
            Compensation::Turn(turn) => turn.find_misses(measured, positions, near),
            Compensation::World(world) => world.find_corrections(measured, positions, near),
            Compensation::Stamped(stamped) => stamped.find_misses((measured, channels), positions, near),
        }
    }

    /// Moves the points of a scan with these channels. Misses with a number that no point has are ignored.
    pub fn apply(&self, positions: &mut [[f32; 3]], channels: &[Channel]) {
        match self {
            Compensation::Turn(turn) => turn.apply(positions),
            Compensation::World(world) => world.apply(positions),
            Compensation::Stamped(stamped) => stamped.apply(positions, channels),
        }
    }
}

/// How the motion of a turn moved the points of a scan, and the points that it misses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Turn {
    /// The motion.
    pub motion: Motion,
    /// Points that the formula does not reproduce to the last bit, in ascending order.
    pub misses: Vec<Miss>,
}

/// A point that the formula misses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Miss {
    /// Its number in the file.
    pub point: u32,
    /// The value added to each coordinate, in float32 units.
    pub units: [i64; 3],
}

impl Turn {
    /// Records the points of the file `positions` that the formula misses, given the decoded measured points:
    /// those that are not `near` it.
    pub fn find_misses(
        &mut self,
        measured: &[[f32; 3]],
        positions: &[[f32; 3]],
        near: impl Fn(&[f32; 3], &[f32; 3]) -> bool,
    ) {
        self.misses.clear();
        let mut formula = measured.to_vec();
        self.apply(&mut formula);
        self.misses = find_misses(&formula, positions, near);
    }

    /// Moves the points of a scan, in the order of the file. Misses with a number that no point has are
    /// ignored.
    pub fn apply(&self, positions: &mut [[f32; 3]]) {
        let mover = Mover::new(&self.motion);
        for position in positions.iter_mut() {
            *position =
                unless_nan(position, mover.moved(position.map(f64::from)).map(|metres| metres as f32));
        }
        put_right(positions, &self.misses);
    }
}

/// The points of the file `positions` that a formula misses: those that are not `near` it.
fn find_misses(
    formula: &[[f32; 3]],
    positions: &[[f32; 3]],
    near: impl Fn(&[f32; 3], &[f32; 3]) -> bool,
) -> Vec<Miss> {
    let unit = CoordinateGrid::unit_of_float;
    let points = (0u32..).zip(positions.iter().zip(formula));
    let missed = points.filter(|(_, (position, formula))| !near(position, formula));
    let miss = |(point, (position, formula)): (u32, (&[f32; 3], &[f32; 3]))| Miss {
        point,
        units: std::array::from_fn(|axis| unit(position[axis]) - unit(formula[axis])),
    };
    missed.map(miss).collect()
}

/// Moves the points that a formula misses to their positions in the file. Misses with a number that no point
/// has are ignored.
fn put_right(positions: &mut [[f32; 3]], misses: &[Miss]) {
    for miss in misses {
        if let Some(position) = positions.get_mut(miss.point as usize) {
            *position = corrected(*position, &miss.units);
        }
    }
}

/// A position, moved by this number of units along each axis.
fn corrected(position: [f32; 3], units: &[i64; 3]) -> [f32; 3] {
    if *units == [0; 3] {
        return position;
    }
    std::array::from_fn(|axis| {
        let unit = CoordinateGrid::unit_of_float(position[axis]);
        CoordinateGrid::Float32.value(unit.wrapping_add(units[axis]), 0.0)
    })
}

/// A point after compensation; but the measured point itself if either has a NaN, as processors differ in the
/// bits of a NaN that they compute.
fn unless_nan(measured: &[f32; 3], moved: [f32; 3]) -> [f32; 3] {
    if moved.iter().chain(measured).any(|metres| metres.is_nan()) { *measured } else { moved }
}
