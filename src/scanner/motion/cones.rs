//! The motion as determined by the cones of the beams: everything except the rotation about their axis, which
//! leaves every point on its cone.
//!
//! Iterated weighted least squares: the height of each point above its beam's cone is explained by the cone's
//! two constants and by the motion, which all points share. The constants are eliminated beam by beam.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::many::Seen;
use super::turn::{Motion, Mover};
use crate::scanner::thinned;

/// The unknowns: translation, then rotation about x and y.
const UNKNOWNS: usize = 5;
/// Number of points that are used.
const SAMPLE: usize = 5000;
/// Largest distance, in metres, from its cone at which a point is used, for each iteration. In the first
/// there are no cones to compare with, and the next cones are still inaccurate.
const FIRST_REACH: [f64; 10] = [f64::INFINITY, 0.3, 0.3, 0.3, 0.03, 0.03, 0.03, 0.01, 0.01, 0.01];
/// The distances once there are cones.
const REACH: [f64; 6] = [0.3, 0.03, 0.03, 0.01, 0.01, 0.01];
/// With fewer beams a motion is not fully determined; besides, these are no beams: the points are in another
/// order.
const FEWEST_BEAMS: usize = 3;
/// The minimum share of points that must lie on the cones in the end.
const LEAST_SHARE: f64 = 0.7;
/// In metres: the largest distance of points on a cone; a few times the effect of rounding to millimetres.
const ON_CONE: f64 = 0.002;

/// z = height + slope * rho.
#[derive(Clone, Copy, Default)]
struct Cone {
    height: f64,
    slope: f64,
}

/// A sample of the points of each beam, and the cones on which they lie.
pub struct Cones {
    /// The points, beam by beam.
    seen: Vec<Seen>,
    /// The end of each beam in that list, and its cone.
    beams: Vec<(usize, Cone)>,
    are_known: bool,
}

impl Cones {
    /// From points of any type. `None` if there are too few beams.
    pub fn new<P>(beams: &[Vec<P>], seen: impl Fn(&P) -> Seen) -> Option<Self> {
        let total: usize = beams.iter().map(Vec::len).sum();
        if beams.len() < FEWEST_BEAMS || total == 0 {
            return None;
        }
        let mut all = Vec::new();
        let mut sampled = Vec::new();
        for beam in beams {
            all.extend(thinned(beam, (SAMPLE * beam.len()).div_ceil(total)).map(&seen));
            sampled.push((all.len(), Cone::default()));
        }
        Some(Cones { seen: all, beams: sampled, are_known: false })
    }

    /// The motion that brings the points of each beam onto a cone, with the rotation about z taken from
    /// `motion`. `None` if there is none. `undone` computes where points were measured, and may correct their
    /// parts of the turn.
    pub fn improved(
        &mut self,
        mut motion: Motion,
        undone: impl Fn(&Mover, &mut [Seen]) -> Vec<[f64; 3]>,
    ) -> Option<Motion> {
        let rounds = if self.are_known { &REACH[..] } else { &FIRST_REACH };
        let mut on_cone = 0;
        for &reach in rounds {
            let points = undone(&Mover::new(&motion), &mut self.seen);
            let (step, on) = self.improve(&points, reach)?;
            motion = motion.changed_by(&step);
            on_cone = on;
        }
        self.are_known = true;
        (on_cone as f64 >= LEAST_SHARE * self.seen.len() as f64).then_some(motion)
    }

    /// One iteration, given the points as measured according to the motion: improves the cones, and returns
    /// the change of the motion and the number of points on their cones.
    fn improve(&mut self, points: &[[f64; 3]], reach: f64) -> Option<([f64; 6], usize)> {
        /// In metres; keeps weights finite.
        const SOFT: f64 = 1e-3;
        /// Regularises components that the points do not determine.
        const RIDGE: f64 = 1e-6;
        // Only the lower triangle is used.
        let mut system = [[0.0; UNKNOWNS]; UNKNOWNS];
        (0..UNKNOWNS).for_each(|i| system[i][i] = RIDGE);
        let mut right = [0.0; UNKNOWNS];
        let mut eliminated = Vec::with_capacity(self.beams.len());
        let (mut on_cone, mut start) = (0, 0);
        for (end, cone) in &self.beams {
            // Sums for the cone's two constants, and their products with the unknowns.
            let [mut weights, mut rhos, mut squares] = [RIDGE, 0.0, RIDGE];
            let mut own_right = [0.0; 2];
            let mut shared = [[0.0; UNKNOWNS]; 2];
            for (&[x, y, z], Seen { part, .. }) in points[start..*end].iter().zip(&self.seen[start..*end]) {
                let rho = (x * x + y * y).sqrt();
                let miss = z - cone.height - cone.slope * rho;
                on_cone += usize::from(miss.abs() < ON_CONE);
                if !(miss.abs() < reach && rho > 0.0) {
                    continue;
                }
                let weight = if reach.is_finite() { 1.0 / (miss.abs() + SOFT) } else { 1.0 };
                // The cone's normal, and the decrease of the distance as the motion grows.
                let slope = -cone.slope / rho;
                let [nx, ny] = [slope * x, slope * y];
                let by = [nx, ny, 1.0, y - z * ny, z * nx - x].map(|slope| slope * part);
                weights += weight;
                rhos += weight * rho;
                squares += weight * rho * rho;
                own_right[0] += weight * miss;
                own_right[1] += weight * miss * rho;
                for i in 0..UNKNOWNS {
                    let weighted = by[i] * weight;
                    shared[0][i] += weighted;
                    shared[1][i] += weighted * rho;
                    right[i] += weighted * miss;
                    for j in 0..=i {
                        system[i][j] += weighted * by[j];
                    }
                }
            }
            start = *end;
            let inverse = Matrix2::new(weights, rhos, rhos, squares).try_inverse()?;
            let own_right = Vector2::from(own_right);
            let shared = SMatrix::<f64, 2, UNKNOWNS>::from_fn(|row, column| shared[row][column]);
            let (of_system, of_right) =
                (shared.transpose() * inverse * shared, shared.transpose() * (inverse * own_right));
            for i in 0..UNKNOWNS {
                right[i] -= of_right[i];
                (0..=i).for_each(|j| system[i][j] -= of_system[(i, j)]);
            }
            eliminated.push((inverse, own_right, shared));
        }
        let system = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|row, column| {
            system[row.max(column)][row.min(column)]
        });
        let step = system.cholesky()?.solve(&SVector::from(right));
        for ((_, cone), (inverse, own_right, shared)) in self.beams.iter_mut().zip(eliminated) {
            let change = inverse * (own_right - shared * step);
            cone.height += change[0];
            cone.slope += change[1];
        }
        Some(([step[3], step[4], 0.0, step[0], step[1], step[2]], on_cone))
    }
}
