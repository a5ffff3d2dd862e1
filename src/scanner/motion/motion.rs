//! The formula of motion compensation: where a point goes that was seen at some fraction of a turn.

use std::f64::consts::TAU;

/// How the scanner moved in one turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Axis of the rotation in a turn; its length is the angle in radians.
    pub rotation: [f64; 3],
    /// In metres.
    pub translation: [f64; 3],
}

/// The largest rotation that is accepted, in radians, and the largest translation, in metres.
const LARGEST_ROTATION: f64 = 8.0;
const LARGEST_TRANSLATION: f64 = 1e6;

impl Motion {
    /// Whether a stream may contain this motion.
    pub fn is_possible(&self) -> bool {
        // False for NaN, too.
        self.rotation.iter().all(|r| r.abs() <= LARGEST_ROTATION)
            && self.translation.iter().all(|t| t.abs() <= LARGEST_TRANSLATION)
    }

    /// The motion with each component changed by `step`: rotation, then translation.
    pub(super) fn changed_by(&self, step: &[f64; 6]) -> Self {
        Motion {
            rotation: std::array::from_fn(|axis| self.rotation[axis] + step[axis]),
            translation: std::array::from_fn(|axis| self.translation[axis] + step[axis + 3]),
        }
    }
}

/// Moves points by fractions of a [`Motion`].
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

    /// The place to which compensation moves a point (metres).
    #[inline]
    pub fn moved(&self, point: [f64; 3]) -> [f64; 3] {
        let part = part_of_turn(&point);
        let turned = self.turned(point, part * self.angle);
        std::array::from_fn(|axis| turned[axis] + part * self.translation[axis])
    }

    /// The place, to within a few micrometres, from which compensation has moved a point here, if it was seen
    /// near the fraction `part` of the turn.
    pub(super) fn undone(&self, moved: [f64; 3], mut part: f64) -> [f64; 3] {
        /// Number of rounds that the nearest points of the fastest car need.
        const MOST_ROUNDS: usize = 16;
        /// A fraction of a turn that moves nothing by more than a few micrometres.
        const SAME: f64 = 1e-6;
        let mut point = moved;
        for _ in 0..MOST_ROUNDS {
            let shifted = std::array::from_fn(|axis| moved[axis] - part * self.translation[axis]);
            point = self.turned(shifted, -part * self.angle);
            // Across the seam behind the scanner, fractions continue beyond one half.
            let now = part_of_turn(&point);
            let next = now - (now - part).round();
            let change = (next - part).abs();
            part = next;
            if change < SAME {
                break;
            }
        }
        point
    }

    /// Rodrigues' rotation formula.
    #[inline]
    fn turned(&self, point: [f64; 3], angle: f64) -> [f64; 3] {
        let (sin, cos) = libm::sincos(angle);
        let [kx, ky, kz] = self.axis;
        let [x, y, z] = point;
        let along = (kx * x + ky * y + kz * z) * (1.0 - cos);
        [
            x * cos + (ky * z - kz * y) * sin + kx * along,
            y * cos + (kz * x - kx * z) * sin + ky * along,
            z * cos + (kx * y - ky * x) * sin + kz * along,
        ]
    }
}

/// The fraction of the turn at which a point is seen: from -1/2 behind the scanner, through 0 in front of it,
/// to 1/2.
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
            let again = mover.undone(mover.moved(point), part_of_turn(&point));
            assert!(point.iter().zip(again).all(|(a, b)| (a - b).abs() < 1e-5), "{point:?} {again:?}");
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
