//! Motion compensation, undone. A scanner that moves sees each point of a turn from another place; some
//! data sets hold points that were moved to where they would have been seen from the place in the middle
//! of the turn (KITTI odometry). Such coordinates lie on no grid, and on no beam's cone. With the motion they
//! are moved back to what the scanner had measured: what is left is rounding.
//!
//! For a motion of rotation r (axis times angle) and translation t in one turn, a point v seen at azimuth
//! phi, from -pi to pi, is moved to
//!
//! ```text
//! s  = phi / (2 pi)
//! v' = R(s r) v + s t              R(a): the rotation about the axis a by the angle |a|
//! ```
//!
//! `find` finds the motion of a scan, from nothing but the scan: [`cones`] brings the points of each beam onto
//! a cone, which tells all of the motion but the rotation about the cones' axis; [`grid`] brings them onto
//! the millimetre grid.

mod cones;
mod find;
mod grid;
#[allow(clippy::module_inception)]
mod motion;
mod payload;

pub use find::undo;
pub use motion::{Motion, Mover};

use crate::scanner::Coordinates;

/// How the points of a scan were moved, and where they are elsewhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compensation {
    /// The motion of the turn.
    pub motion: Motion,
    /// Points that the formula does not give to the last bit, rising.
    pub misses: Vec<Miss>,
}

/// A point that the formula misses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Miss {
    /// Its number in the file.
    pub point: u32,
    /// What is added to each coordinate, in float32 values.
    pub units: [i64; 3],
}

impl Compensation {
    /// Takes down which points of the file `positions` the formula misses, given the decoded measured ones:
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
        for ((point, position), formula) in (0u32..).zip(positions).zip(&formula) {
            if !near(position, formula) {
                let unit = Coordinates::unit_of_float;
                let units = std::array::from_fn(|axis| unit(position[axis]) - unit(formula[axis]));
                self.misses.push(Miss { point, units });
            }
        }
    }

    /// Moves the points of a scan, in the order of the file. Misses of points that are not there do nothing.
    pub fn apply(&self, positions: &mut [[f32; 3]]) {
        let mover = Mover::new(&self.motion);
        let mut misses = self.misses.iter().peekable();
        for (number, position) in (0u32..).zip(positions) {
            let moved = mover.moved(position.map(f64::from)).map(|metres| metres as f32);
            // What is no number stays as it is: processors differ in the bits of a NaN that they compute.
            if moved.iter().chain(&*position).all(|metres| !metres.is_nan()) {
                *position = moved;
            }
            if let Some(miss) = misses.next_if(|miss| miss.point == number) {
                *position = std::array::from_fn(|axis| {
                    let unit = Coordinates::unit_of_float(position[axis]);
                    Coordinates::Float32.value(unit.wrapping_add(miss.units[axis]), 0.0)
                });
            }
        }
    }
}
