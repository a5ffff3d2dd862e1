//! Rigid motions, and their form in the stream. FORMAT.md 4.3, "Motion".

/// The unit of quantised angles, in radians: 0.8 mm at 100 m.
const ANGLE_UNIT: f64 = 1.0 / (1 << 17) as f64;
/// The unit of quantised lengths, in metres.
const LENGTH_UNIT: f64 = 1.0 / (1 << 12) as f64;
/// The largest magnitude of quantised values: 64 rad, or 2 km.
const LARGEST: f64 = (1 << 23) as f64;

/// A rigid motion as in the article (equation 9): p' = R_yaw R_pitch R_roll p + C.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Rotation about z, in radians.
    pub yaw: f64,
    /// Rotation about y, in radians.
    pub pitch: f64,
    /// Rotation about x, in radians.
    pub roll: f64,
    /// C, in metres.
    pub translation: [f64; 3],
}

/// A pose in the units of the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QuantisedPose {
    /// Yaw, pitch and roll in 2^-17 rad, then x, y and z in 2^-12 m.
    pub values: [i32; 6],
}

/// A rigid motion, ready to be applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidMotion {
    /// R, row by row.
    pub rotation: [[f64; 3]; 3],
    /// C, in metres.
    pub translation: [f64; 3],
}

impl Default for RigidMotion {
    /// No motion.
    fn default() -> Self {
        Pose::default().motion()
    }
}

impl Pose {
    /// The nearest pose that the stream can represent. `None` if it is too large.
    pub fn quantise(&self) -> Option<QuantisedPose> {
        let [x, y, z] = self.translation;
        let [yaw, pitch, roll] = [self.yaw, self.pitch, self.roll].map(|angle| angle / ANGLE_UNIT);
        let [x, y, z] = [x, y, z].map(|length| length / LENGTH_UNIT);
        let values = [yaw, pitch, roll, x, y, z].map(f64::round);
        let within = values.iter().all(|value| value.abs() <= LARGEST);
        within.then(|| QuantisedPose { values: values.map(|value| value as i32) })
    }

    /// The motion of this pose; the same on every platform.
    pub fn motion(&self) -> RigidMotion {
        let [(sy, cy), (sp, cp), (sr, cr)] =
            [self.yaw, self.pitch, self.roll].map(|angle| (libm::sin(angle), libm::cos(angle)));
        RigidMotion {
            rotation: [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ],
            translation: self.translation,
        }
    }

    /// The angle of the rotation, in radians; for small angles.
    pub fn angle(&self) -> f64 {
        (self.yaw * self.yaw + self.pitch * self.pitch + self.roll * self.roll).sqrt()
    }
}

impl QuantisedPose {
    /// The pose in radians and metres.
    pub fn pose(&self) -> Pose {
        let [yaw, pitch, roll, x, y, z] = self.values.map(f64::from);
        Pose {
            yaw: yaw * ANGLE_UNIT,
            pitch: pitch * ANGLE_UNIT,
            roll: roll * ANGLE_UNIT,
            translation: [x * LENGTH_UNIT, y * LENGTH_UNIT, z * LENGTH_UNIT],
        }
    }
}

impl RigidMotion {
    /// Moves a point.
    #[inline]
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = self.turn(point);
        std::array::from_fn(|i| turned[i] + self.translation[i])
    }

    /// Rotates a direction.
    #[inline]
    pub fn turn(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|[a, b, c]| a * x + b * y + c * z)
    }

    /// The angles and the translation of this motion.
    pub fn pose(&self) -> Pose {
        let r = &self.rotation;
        Pose {
            yaw: libm::atan2(r[1][0], r[0][0]),
            pitch: libm::asin((-r[2][0]).clamp(-1.0, 1.0)),
            roll: libm::atan2(r[2][1], r[2][2]),
            translation: self.translation,
        }
    }

    /// This motion, followed by another.
    pub fn then(&self, next: &RigidMotion) -> RigidMotion {
        let column = |j: usize| next.turn([self.rotation[0][j], self.rotation[1][j], self.rotation[2][j]]);
        let columns = [column(0), column(1), column(2)];
        RigidMotion {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i])),
            translation: next.apply(self.translation),
        }
    }

    /// The inverse motion.
    pub fn inverse(&self) -> RigidMotion {
        let r = &self.rotation;
        let rotation: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| r[j][i]));
        let back = RigidMotion { rotation, translation: [0.0; 3] };
        RigidMotion { translation: back.turn(self.translation).map(|v| -v), ..back }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: Pose = Pose { yaw: 0.3, pitch: -0.02, roll: 0.05, translation: [1.0, -2.0, 0.125] };

    #[test]
    fn a_motion_and_its_inverse_are_none() {
        let there = POSE.motion();
        let none = there.then(&there.inverse());
        for (i, row) in none.rotation.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
            assert!(none.translation[i].abs() < 1e-12);
        }
        let again = there.pose();
        assert!((again.yaw - 0.3).abs() < 1e-12 && (again.pitch + 0.02).abs() < 1e-12);
    }

    #[test]
    fn quantised_poses_are_near() {
        let near = POSE.quantise().map(|quantised| quantised.pose()).unwrap_or_default();
        assert!((near.yaw - POSE.yaw).abs() <= ANGLE_UNIT && near.translation == POSE.translation);
        assert_eq!(Pose { yaw: f64::NAN, ..POSE }.quantise(), None);
        assert_eq!(Pose { translation: [1e9, 0.0, 0.0], ..POSE }.quantise(), None);
    }
}
