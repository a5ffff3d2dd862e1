//! The position of the file's axes in the map, to the last digits: from pairs of float32 coordinates in both.

use nalgebra::{Matrix6, Vector6};

use super::sweep::{Matrix, Vector};
use super::undo::rotated;

/// The distance from a float32 value to the next.
#[inline]
pub fn spacing(value: f64) -> f64 {
    let binade = f32::from_bits((value as f32).to_bits() & 0x7f80_0000);
    f64::from(binade.max(f32::MIN_POSITIVE) * f32::EPSILON)
}

pub fn rounded(v: Vector) -> Vector {
    v.map(|metres| f64::from(metres as f32))
}

/// A condition: along a direction, a point of the file corresponds to one of the map.
pub struct Pair {
    pub file: Vector,
    pub map: Vector,
    /// The direction, in the file's axes.
    pub direction: Vector,
    /// The standard error, in metres.
    pub error: f64,
}

/// The rotation and the origin that map the map's points to those of the file, using fewer and fewer of the
/// pairs: those whose deviation is below each of `limits`, in multiples of their error.
pub fn rigid(pairs: &[Pair], mut axes: Matrix, mut origin: Vector, limits: &[f64]) -> (Matrix, Vector) {
    let middle = pairs.iter().fold(Vector::zeros(), |sum, pair| sum + pair.file) / pairs.len().max(1) as f64;
    for limit in limits {
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for pair in pairs {
            let there = axes.transpose() * (pair.map - origin);
            let off = (pair.file - there).dot(&pair.direction) / pair.error;
            if off.abs() < *limit {
                let turn = (there - middle).cross(&pair.direction) / pair.error;
                let place = pair.direction / pair.error;
                let row = Vector6::new(turn.x, turn.y, turn.z, place.x, place.y, place.z);
                // The lower triangle is enough for the decomposition.
                for column in 0..6 {
                    for i in column..6 {
                        normal[(i, column)] += row[i] * row[column];
                    }
                }
                right += row * off;
            }
        }
        let scale = normal.diagonal().map(|d: f64| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let scaled = Matrix6::from_diagonal(&scale) * normal * Matrix6::from_diagonal(&scale);
        let Some(cholesky) = (scaled + Matrix6::identity() * 1e-13).cholesky() else { break };
        let step = cholesky.solve(&right.component_mul(&scale)).component_mul(&scale);
        if !step.iter().all(|part| part.is_finite()) {
            break;
        }
        let turn = rotated(&Vector::new(step[0], step[1], step[2]));
        // v = turn (there - middle) + middle + shift
        let shift = Vector::new(step[3], step[4], step[5]) + middle - turn * middle;
        axes *= turn.transpose();
        origin -= axes * shift;
        axes = orthonormal(axes);
    }
    (axes, origin)
}

fn orthonormal(axes: Matrix) -> Matrix {
    let svd = axes.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => u * v_t,
        _ => axes,
    }
}
