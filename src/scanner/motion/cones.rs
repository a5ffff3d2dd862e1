//! What the cones of the beams tell about the motion: everything except the rotation about their axis, which
//! leaves every point on its cone.
//!
//! Iterated weighted least squares: the height of each point above its beam's cone is explained by the cone's
//! own two constants and by the motion, which all points share. The constants are eliminated beam by beam.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::motion::{Motion, Mover, part_of_turn};
use crate::scanner::{BeamPoint, thinned};

/// The unknowns: translation, then rotation about x and y.
const UNKNOWNS: usize = 5;
/// Number of points that are enough.
const SAMPLE: usize = 5000;
const ROUNDS: usize = 10;
/// With fewer beams not all of a motion is determined, and they are not beams: the points are in some other
/// order.
const FEWEST_BEAMS: usize = 3;
/// The share of the points that must lie on the cones in the end.
const LEAST_SHARE: f64 = 0.7;
/// In metres: points closer to a cone than this lie on it. A few times the effect of rounding to millimetres.
const ON_CONE: f64 = 0.002;

/// z = height + slope * rho.
#[derive(Clone, Copy, Default)]
struct Cone {
    height: f64,
    slope: f64,
}

/// The motion that brings the points of each beam onto a cone, with the rotation about z taken from `motion`.
/// `None` if no motion does.
pub fn improved(motion: Motion, beams: &[Vec<BeamPoint>]) -> Option<Motion> {
    improved_by(motion, beams, |point| Seen { position: point.position, part: None })
}

/// A point of the file, and which part of the motion moved it: none if that follows from its direction.
#[derive(Clone, Copy)]
pub struct Seen {
    pub position: [f64; 3],
    pub part: Option<f64>,
}

impl Seen {
    /// Where the point was measured, and its part of the motion.
    fn undone(&self, mover: &Mover) -> ([f64; 3], f64) {
        match self.part {
            Some(part) => (mover.at(part).undone(self.position), part),
            None => {
                let point = mover.undone(self.position, part_of_turn(&self.position));
                (point, part_of_turn(&point))
            }
        }
    }
}

/// The same of points of any kind.
pub fn improved_by<P>(mut motion: Motion, beams: &[Vec<P>], seen: impl Fn(&P) -> Seen) -> Option<Motion> {
    let total: usize = beams.iter().map(Vec::len).sum();
    if beams.len() < FEWEST_BEAMS || total == 0 {
        return None;
    }
    let share = |beam: &Vec<P>| (SAMPLE * beam.len()).div_ceil(total);
    let samples: Vec<Vec<Seen>> =
        beams.iter().map(|beam| thinned(beam, share(beam)).map(&seen).collect()).collect();
    let mut cones = vec![Cone::default(); samples.len()];
    for round in 0..ROUNDS {
        // In the first round there are no cones to compare with, in the next ones only rough ones.
        let reach = match round {
            0 => f64::INFINITY,
            1..4 => 0.3,
            4..7 => 0.03,
            _ => 0.01,
        };
        let (step, on_cone) = improve(&samples, &mut cones, &motion, reach)?;
        if round == ROUNDS - 1 {
            let sampled: usize = samples.iter().map(Vec::len).sum();
            return (on_cone as f64 >= LEAST_SHARE * sampled as f64).then_some(motion);
        }
        motion = motion.changed_by(&step);
    }
    None
}

/// One round: improves the cones, and returns the change of the motion and the number of points on their
/// cones.
fn improve(
    samples: &[Vec<Seen>],
    cones: &mut [Cone],
    motion: &Motion,
    reach: f64,
) -> Option<([f64; 6], usize)> {
    /// In metres; keeps weights finite.
    const SOFT: f64 = 1e-3;
    /// Holds components that the points do not determine.
    const RIDGE: f64 = 1e-6;
    let mover = Mover::new(motion);
    let mut system = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::identity() * RIDGE;
    let mut right = SVector::<f64, UNKNOWNS>::zeros();
    let mut eliminated = Vec::with_capacity(cones.len());
    let mut on_cone = 0;
    for (points, cone) in samples.iter().zip(&*cones) {
        let mut own = Matrix2::identity() * RIDGE;
        let mut own_right = Vector2::zeros();
        let mut shared = SMatrix::<f64, 2, UNKNOWNS>::zeros();
        for seen in points {
            let ([x, y, z], part) = seen.undone(&mover);
            let rho = (x * x + y * y).sqrt();
            let miss = z - cone.height - cone.slope * rho;
            on_cone += usize::from(miss.abs() < ON_CONE);
            if !(miss.abs() < reach && rho > 0.0) {
                continue;
            }
            let weight = if reach.is_finite() { 1.0 / (miss.abs() + SOFT) } else { 1.0 };
            // The cone's normal, and how the distance decreases as the motion grows.
            let [nx, ny] = [-cone.slope * x / rho, -cone.slope * y / rho];
            let by = SVector::from([nx, ny, 1.0, y - z * ny, z * nx - x]) * part;
            let constants = Vector2::new(1.0, rho);
            own += constants * constants.transpose() * weight;
            own_right += constants * (weight * miss);
            shared += constants * by.transpose() * weight;
            system += by * by.transpose() * weight;
            right += by * (weight * miss);
        }
        let inverse = own.try_inverse()?;
        system -= shared.transpose() * inverse * shared;
        right -= shared.transpose() * (inverse * own_right);
        eliminated.push((inverse, own_right, shared));
    }
    let step = system.cholesky()?.solve(&right);
    for (cone, (inverse, own_right, shared)) in cones.iter_mut().zip(eliminated) {
        let change = inverse * (own_right - shared * step);
        cone.height += change[0];
        cone.slope += change[1];
    }
    Some(([step[3], step[4], 0.0, step[0], step[1], step[2]], on_cone))
}
