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
//!
//! `undo_turn` estimates the motion of a scan from the scan alone: [`cones`] brings the points of each beam
//! onto a cone, which determines all of the motion except the rotation about the cones' axis; [`grid`] brings
//! them onto the millimetre grid.

pub mod by_time;
mod cones;
mod grid;
mod many;
mod turn;
pub mod world;

use std::f64::consts::TAU;

pub use by_time::Stamped;
use cones::Cones;
use grid::Yaw;
use many::{Seen, is_in_reach};
pub(in crate::scanner) use turn::Displacement;
pub use turn::{Motion, Mover};
pub use world::World;

use super::hdl64::{BeamPoint, split_beams};
use super::{CoordinateGrid, thinned};
use crate::entropy::{BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_signed, read_unsigned, unzigzag, write_signed, write_unsigned, zigzag};
use crate::scan::Channel;

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
    of_map.or_else(|| undo_turn(positions).map(|(points, turn)| (points, Compensation::Turn(turn))))
}

/// The points as they were measured; as [`undo`], but faster.
pub fn measured(positions: &[[f32; 3]]) -> Option<Vec<[f32; 3]>> {
    world::measured(positions).or_else(|| undo_turn(positions).map(|(points, _)| points))
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

/// The points as they were measured, on the millimetre grid, and the motion that moved them to those of the
/// file, with a list of misses that is still empty. `None` if the points were not measured on that grid, or
/// not moved in this way.
fn undo_turn(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, Turn)> {
    if !may_be_moved(positions) {
        return None;
    }
    let in_reach: Vec<[f32; 3]> =
        positions.iter().filter(|position| is_in_reach(position)).copied().collect();
    let beams = split_beams(&in_reach);
    let seen = |point: &BeamPoint| {
        let turn = point.azimuth / TAU;
        Seen { position: point.position, part: if turn > 0.5 { turn - 1.0 } else { turn } }
    };
    let all: Vec<Seen> = beams.iter().flatten().map(seen).collect();
    let (mut cones, mut yaw) = (Cones::new(&beams, seen)?, Yaw::new(&all)?);
    let mut motion = Motion::default();
    // Cones are fitted as if there were no rotation about z, until that rotation is known.
    for _ in 0..2 {
        motion = yaw.with_yaw(cones.improved(motion, many::undone)?)?;
    }
    let motion = grid::polished(motion, &all)?;
    let points = many::measured(&Mover::new(&motion), positions);
    let motion = grid::sharpened(motion, &points, positions);

    (motion.is_possible() && reproduces_most(&Mover::new(&motion), &points, positions))
        .then_some((points, Turn { motion, misses: Vec::new() }))
}

/// Whether the formula reproduces nearly all points of a sample to the last bit.
fn reproduces_most(mover: &Mover, points: &[[f32; 3]], positions: &[[f32; 3]]) -> bool {
    const SAMPLE: usize = 2000;
    /// Of this many points, the formula may miss one; otherwise the scan is not changed.
    const FEWEST_TO_A_MISS: usize = 20;
    let pairs: Vec<_> = points.iter().zip(positions).collect();
    let is_missed = |(point, position): &&(&[f32; 3], &[f32; 3])| {
        mover.moved(point.map(f64::from)).map(|metres| metres as f32) != **position
    };
    let sample: Vec<_> = thinned(&pairs, SAMPLE).collect();
    sample.iter().copied().filter(is_missed).count() * FEWEST_TO_A_MISS <= sample.len()
}

/// A quick test of a scan: moved points are on no grid, except straight in front of the scanner, where
/// compensation does not move them.
fn may_be_moved(positions: &[[f32; 3]]) -> bool {
    /// |y / x| of points that even the fastest car moves by less than a third of a millimetre.
    const IN_FRONT: f32 = 5e-4;
    /// Minimum number of points for a conclusion.
    const FEWEST: u32 = 4;
    /// Minimum coherence, which points on no grid do not reach by chance.
    const LEAST: f64 = 0.4;
    /// Number of points that are tested for being on the grid.
    const SAMPLE: usize = 2000;
    if CoordinateGrid::of(thinned(positions, SAMPLE).flatten()) != CoordinateGrid::Float32 {
        return false;
    }
    let in_front = positions.iter().filter(|[x, y, _]| *x > 0.5 && y.abs() < IN_FRONT * x && x.is_finite());
    let (mut sum, mut count) = (0.0, 0u32);
    for [x, _, z] in in_front.filter(|[_, _, z]| z.is_finite()) {
        sum += [x, z].map(|v| libm::cos(f64::from(*v) * 1000.0 * TAU)).iter().sum::<f64>();
        count += 2;
    }
    count < 2 * FEWEST || sum > LEAST * f64::from(count)
}

/// The section's name in errors.
const WHAT: &str = "motion compensation";

impl Turn {
    /// Appends the payload of the section.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        self.motion.write_to(out);
        let mut next = 0;
        for miss in &self.misses {
            write_unsigned(out, u64::from(miss.point - next));
            miss.units.iter().for_each(|&units| write_signed(out, units));
            next = miss.point + 1;
        }
    }

    /// Reads the payload of the section, for a frame with `points` points.
    ///
    /// # Errors
    /// If it is cut short, or contains a motion that no scanner makes or points that the frame does not have.
    pub fn from_payload(mut bytes: &[u8], points: usize) -> Result<Self> {
        let input = &mut bytes;
        let mut turn = Turn { motion: Motion::read_from(input, WHAT)?, misses: Vec::new() };
        let mut next = 0u64;
        while !input.is_empty() {
            let point = next.saturating_add(read_unsigned(input, WHAT)?);
            if point >= points as u64 || point > u64::from(u32::MAX) {
                return Err(Error::corrupt(format!("{WHAT}: the frame has no point {point}")));
            }
            let mut units = [0; 3];
            for unit in &mut units {
                *unit = read_signed(input, WHAT)?;
            }
            turn.misses.push(Miss { point: point as u32, units });
            next = point + 1;
        }
        Ok(turn)
    }
}

/// Number of contexts of units: the exponent of the coordinate, clamped to the range in which it matters.
const EXPONENTS: usize = 16;
/// The biased exponent of the first context: 2^-11 m.
const FIRST_EXPONENT: i32 = 127 - 11;

/// A class of coordinates by their size: 0 for the smallest.
fn exponent_of(value: f32) -> usize {
    let exponent = (value.to_bits() >> 23 & 0xff) as i32;
    (exponent - FIRST_EXPONENT).clamp(0, EXPONENTS as i32 - 1) as usize
}

/// The adaptive models of corrections, by axis and exponent.
#[derive(Default)]
struct UnitModel([[IntegerModel; EXPONENTS]; 3]);

impl UnitModel {
    /// Codes the values added to the coordinates of a point that starts at `start`.
    fn code<C: BitCoder>(&mut self, coder: &mut C, start: &[f32; 3], units: &mut [i64; 3]) {
        for axis in 0..3 {
            let model = &mut self.0[axis][exponent_of(start[axis])];
            units[axis] = unzigzag(model.code(coder, zigzag(units[axis])));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Turn {
        let motion = Motion { rotation: [0.25, -1e-9, 0.0], translation: [0.8, 0.1, -0.25] };
        let miss = |point, units| Miss { point, units };
        Turn { motion, misses: vec![miss(0, [1, 0, 0]), miss(1, [0, -70_000, 1 << 33]), miss(9, [0; 3])] }
    }

    #[test]
    fn comes_back() {
        let mut bytes = Vec::new();
        example().write_to(&mut bytes);
        assert_eq!(Turn::from_payload(&bytes, 10).unwrap(), example());
        assert!(Turn::from_payload(&bytes, 9).is_err(), "a point too many");
        assert!(Turn::from_payload(&bytes[..bytes.len() - 1], 10).is_err(), "cut short");
        assert!(Turn::from_payload(&bytes[..47], 10).is_err(), "cut short");
    }

    #[test]
    fn impossible_motions_are_refused() {
        for value in [f64::NAN, f64::INFINITY, -9.0] {
            let mut bytes = Vec::new();
            example().write_to(&mut bytes);
            bytes[..8].copy_from_slice(&value.to_le_bytes());
            assert!(Turn::from_payload(&bytes, 10).is_err(), "{value}");
        }
    }
}
