//! The formula of motion compensation: where it moves a point that was seen at some part of a turn.
//! FORMAT.md 8.15.

use std::f64::consts::TAU;

use crate::ground::angle;
use crate::ground::error::{Error, Result};
use crate::ground::floats::round_ties_even;
use crate::ground::lanes::lanes;
use crate::ground::varint::read_f64;

/// The motion of the scanner in one turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Axis of the rotation; its length is the angle in radians.
    pub rotation: [f64; 3],
    /// Translation in metres.
    pub translation: [f64; 3],
}

/// The largest accepted rotation, in radians, and the largest accepted translation, in metres.
const LARGEST_ROTATION: f64 = 8.0;
const LARGEST_TRANSLATION: f64 = 1e6;

impl Motion {
    /// Whether a stream may contain this motion.
    pub fn is_possible(&self) -> bool {
        // False for NaN too.
        self.rotation.iter().all(|r| r.abs() <= LARGEST_ROTATION)
            && self.translation.iter().all(|t| t.abs() <= LARGEST_TRANSLATION)
    }

    /// Appends its six numbers.
    pub(super) fn write_to(&self, out: &mut Vec<u8>) {
        let values = self.rotation.iter().chain(&self.translation);
        values.for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }

    /// Reads its six numbers, in a section with this name.
    ///
    /// # Errors
    /// If they are cut short, or if no scanner moves so far.
    pub(super) fn read_from(input: &mut &[u8], what: &str) -> Result<Self> {
        let mut values = [0.0; 6];
        for value in &mut values {
            *value = read_f64(input, what)?;
        }
        let [rx, ry, rz, x, y, z] = values;
        let motion = Motion { rotation: [rx, ry, rz], translation: [x, y, z] };
        match motion.is_possible() {
            true => Ok(motion),
            false => Err(Error::corrupt(format!("{what}: no scanner moves so far in a turn"))),
        }
    }

    /// The motion with each component changed by `step`: rotation, then translation.
    pub(super) fn changed_by(&self, step: &[f64; 6]) -> Self {
        Motion {
            rotation: std::array::from_fn(|axis| self.rotation[axis] + step[axis]),
            translation: std::array::from_fn(|axis| self.translation[axis] + step[axis + 3]),
        }
    }
}

/// Moves points by parts of a [`Motion`].
#[derive(Clone, Copy, Debug)]
pub struct Mover {
    /// A unit vector, or 0 if there is no rotation.
    axis: [f64; 3],
    /// In radians.
    angle: f64,
    translation: [f64; 3],
}

impl Mover {
    /// Prepares to move points by this motion.
    pub fn new(motion: &Motion) -> Self {
        let [x, y, z] = motion.rotation;
        let angle = (x * x + y * y + z * z).sqrt();
        let axis = if angle > 0.0 { motion.rotation.map(|r| r / angle) } else { [0.0; 3] };
        Mover { axis, angle, translation: motion.translation }
    }

    /// The position to which compensation moves a point (metres).
    #[inline]
    pub fn moved(&self, point: [f64; 3]) -> [f64; 3] {
        self.at(part_of_turn(&point)).moved(point)
    }

    /// The rigid motion at this part of the turn.
    #[inline]
    pub(in crate::scanner) fn at(&self, part: f64) -> Displacement {
        let (sin, cos) = libm::sincos(part * self.angle);
        Displacement { axis: self.axis, sin, cos, shift: self.translation.map(|metres| part * metres) }
    }

    /// [`moved`](Self::moved) for `N` points, of which vector units compute several side by side: accurate up
    /// to f64 rounding if the motion turns by less than a radian.
    #[inline(always)]
    pub(super) fn nearly_moved<const N: usize>(&self, points: &[[f64; N]; 3]) -> [[f64; N]; 3] {
        let [x, y, z] = points;
        let part: [f64; N] = lanes(|i| angle::atan2(y[i], x[i]) * (1.0 / TAU));
        let [x, y, z] = self.turned([*x, *y, *z], &part, 1.0);
        let [tx, ty, tz] = self.translation;
        [lanes(|i| x[i] + part[i] * tx), lanes(|i| y[i] + part[i] * ty), lanes(|i| z[i] + part[i] * tz)]
    }

    /// The positions, to within a few micrometres, that compensation moves to these `N` points, given
    /// approximate parts of the turn; and the accurate parts. The same restriction applies.
    #[inline(always)]
    pub(super) fn nearly_undone<const N: usize>(
        &self,
        moved: &[[f64; N]; 3],
        mut part: [f64; N],
    ) -> ([[f64; N]; 3], [f64; N]) {
        /// Number of iterations that the nearest points of the fastest car need.
        const MOST_ROUNDS: usize = 16;
        /// A difference of parts that moves nothing by more than a few micrometres.
        const SAME: f64 = 1e-6;
        let [x, y, z] = moved;
        let [tx, ty, tz] = self.translation;
        let mut point = *moved;
        for _ in 0..MOST_ROUNDS {
            let back = [
                lanes(|i| x[i] - part[i] * tx),
                lanes(|i| y[i] - part[i] * ty),
                lanes(|i| z[i] - part[i] * tz),
            ];
            point = self.turned(back, &part, -1.0);
            // Across the seam behind the scanner, parts continue beyond one half.
            let next: [f64; N] = lanes(|i| {
                let now = angle::atan2(point[1][i], point[0][i]) * (1.0 / TAU);
                now - round_ties_even(now - part[i])
            });
            let changes: [f64; N] = lanes(|i| (next[i] - part[i]).abs());
            part = next;
            if changes.iter().fold(0.0, |most: f64, change| most.max(*change)) < SAME {
                break;
            }
        }
        (point, part)
    }

    /// `N` points rotated by these parts of the rotation, or back by them if `sign` is -1: Rodrigues'
    /// rotation formula.
    #[inline(always)]
    fn turned<const N: usize>(&self, [x, y, z]: [[f64; N]; 3], part: &[f64; N], sign: f64) -> [[f64; N]; 3] {
        let [kx, ky, kz] = self.axis;
        let angle = sign * self.angle;
        let cos_sin: [[f64; 2]; N] = lanes(|i| angle::cos_sin_below_half(part[i] * angle));
        let along: [f64; N] = lanes(|i| (kx * x[i] + ky * y[i] + kz * z[i]) * (1.0 - cos_sin[i][0]));
        let turn =
            |value: f64, across: f64, along: f64, [cos, sin]: [f64; 2]| value * cos + across * sin + along;
        [
            lanes(|i| turn(x[i], ky * z[i] - kz * y[i], kx * along[i], cos_sin[i])),
            lanes(|i| turn(y[i], kz * x[i] - kx * z[i], ky * along[i], cos_sin[i])),
            lanes(|i| turn(z[i], kx * y[i] - ky * x[i], kz * along[i], cos_sin[i])),
        ]
    }
}

/// A rotation and a translation.
#[derive(Clone, Copy, Debug)]
pub(in crate::scanner) struct Displacement {
    axis: [f64; 3],
    sin: f64,
    cos: f64,
    shift: [f64; 3],
}

impl Displacement {
    /// The position to which a point is moved.
    #[inline]
    pub fn moved(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = self.turned(point, self.sin);
        std::array::from_fn(|axis| turned[axis] + self.shift[axis])
    }

    /// The position from which a point is moved here.
    #[inline]
    pub fn undone(&self, moved: [f64; 3]) -> [f64; 3] {
        self.turned(std::array::from_fn(|axis| moved[axis] - self.shift[axis]), -self.sin)
    }

    /// Rodrigues' rotation formula, given the sine of the angle.
    #[inline]
    fn turned(&self, point: [f64; 3], sin: f64) -> [f64; 3] {
        let [kx, ky, kz] = self.axis;
        let cos = self.cos;
        let [x, y, z] = point;
        let along = (kx * x + ky * y + kz * z) * (1.0 - cos);
        [
            x * cos + (ky * z - kz * y) * sin + kx * along,
            y * cos + (kz * x - kx * z) * sin + ky * along,
            z * cos + (kx * y - ky * x) * sin + kz * along,
        ]
    }
}

/// The part of the turn at which a point is seen: from -1/2 behind the scanner, through 0 in front of it, to
/// 1/2.
#[inline]
pub fn part_of_turn(point: &[f64; 3]) -> f64 {
    libm::atan2(point[1], point[0]) / TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_moved_is_found_again() {
        let motion = Motion { rotation: [0.003, -0.002, 0.06], translation: [1.9, 0.1, -0.02] };
        let mover = Mover::new(&motion);
        for i in 0..1000 {
            let azimuth = f64::from(i) * 0.0062 - 3.1;
            let point = [9.0 * azimuth.cos(), 9.0 * azimuth.sin(), f64::from(i) * 0.001];
            let moved = mover.moved(point);
            let again = mover.nearly_undone(&moved.map(|metres| [metres]), [part_of_turn(&point)]).0;
            assert!(point.iter().zip(again).all(|(a, [b])| (a - b).abs() < 1e-5), "{point:?} {again:?}");
            let nearly = mover.nearly_moved(&point.map(|metres| [metres]));
            assert!(moved.iter().zip(nearly).all(|(a, [b])| (a - b).abs() < 1e-13), "{moved:?} {nearly:?}");
        }
    }

    #[test]
    fn nothing_in_front_moves_and_half_the_motion_is_made_behind() {
        let mover = Mover::new(&Motion { rotation: [0.0; 3], translation: [2.0, 0.5, 0.25] });
        assert_eq!(mover.moved([7.0, 0.0, 1.0]), [7.0, 0.0, 1.0]);
        assert_eq!(mover.moved([-7.0, 0.0, 1.0]), [-6.0, 0.25, 1.125]);
        assert_eq!(mover.moved([-7.0, -0.0, 1.0]), [-8.0, -0.25, 0.875]);
    }
}
