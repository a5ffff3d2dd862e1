//! Online least squares: the linear prediction that would have been best for the samples so far, with old
//! errors forgotten exponentially. FORMAT.md 7.1.

mod batched;

pub use batched::BatchedLeastSquares;

use crate::ground::lanes::{LANES, sum_of_products};

/// `N` weights, solved again every few samples from the running normal equations.
#[derive(Clone, Debug)]
pub struct LeastSquares<const N: usize> {
    /// The normal matrix. Above the diagonal, only the elements that share a block with it are kept.
    normal: [[f32; N]; N],
    right: [f32; N],
    weights: [f32; N],
    forget: f32,
    samples: u32,
    solve_every: u32,
}

/// Samples between two solutions, by default.
const SOLVE_EVERY: u32 = 32;
/// Added to the diagonal; keeps the weights of features that have not yet occurred near zero.
const RIDGE: f32 = 0.05;

impl<const N: usize> LeastSquares<N> {
    /// Starts with all weights 0. Each sample multiplies the weight of all earlier ones by `forget`.
    pub fn new(forget: f32) -> Self {
        LeastSquares {
            normal: [[0.0; N]; N],
            right: [0.0; N],
            weights: [0.0; N],
            forget,
            samples: 0,
            solve_every: SOLVE_EVERY,
        }
    }

    /// This predictor, but solved after every `samples` samples.
    pub fn solved_every(self, samples: u32) -> Self {
        LeastSquares { solve_every: samples, ..self }
    }

    /// This predictor with additional features, which have no samples yet.
    pub fn widened<const M: usize>(&self) -> LeastSquares<M> {
        let mut wide = LeastSquares::new(self.forget).solved_every(self.solve_every);
        for (to, from) in wide.normal.iter_mut().zip(&self.normal) {
            to[..N].copy_from_slice(from);
        }
        wide.right[..N].copy_from_slice(&self.right);
        wide.weights[..N].copy_from_slice(&self.weights);
        wide.samples = self.samples;
        wide
    }

    /// The prediction from these features.
    #[inline(always)]
    pub fn predict(&self, features: &[f32; N]) -> f32 {
        sum_of_products(0.0, &self.weights, features)
    }

    /// Learns that `target` came with these features; `weight` is the weight of this sample.
    #[inline(always)]
    pub fn learn(&mut self, features: &[f32; N], target: f32, weight: f32) {
        let forget = self.forget;
        let (blocks, rest) = features.as_chunks::<LANES>();
        for (i, row) in self.normal.iter_mut().enumerate() {
            let weighted = weight * features[i];
            // Whole blocks, up to the one on the diagonal.
            let (row, row_rest) = row.as_chunks_mut::<LANES>();
            for (cell, feature) in row_rest.iter_mut().zip(rest) {
                *cell = *cell * forget + weighted * feature;
            }
            for (cells, features) in row.iter_mut().zip(blocks).take(i / LANES + 1) {
                for lane in 0..LANES {
                    cells[lane] = cells[lane] * forget + weighted * features[lane];
                }
            }
        }
        let weighted = weight * target;
        for i in 0..N {
            self.right[i] = self.right[i] * forget + weighted * features[i];
        }
        self.samples += 1;
        if self.samples >= self.solve_every {
            self.samples = 0;
            self.solve();
        }
    }

    /// Solves by Cholesky decomposition; if the matrix is not positive definite, the weights are not changed.
    fn solve(&mut self) {
        let mut lower = [[0.0; N]; N];
        let mut inverse = [0.0; N];
        for i in 0..N {
            for j in 0..=i {
                let mut sum = self.normal[i][j];
                for k in 0..j {
                    sum -= lower[i][k] * lower[j][k];
                }
                if i > j {
                    lower[i][j] = sum * inverse[j];
                } else if sum + RIDGE > 1e-6 {
                    lower[i][i] = (sum + RIDGE).sqrt();
                    inverse[i] = 1.0 / lower[i][i];
                } else {
                    return;
                }
            }
        }
        let mut forward = [0.0; N];
        for i in 0..N {
            let known: f32 = (0..i).map(|k| lower[i][k] * forward[k]).sum();
            forward[i] = (self.right[i] - known) * inverse[i];
        }
        for i in (0..N).rev() {
            let known: f32 = (i + 1..N).map(|k| lower[k][i] * self.weights[k]).sum();
            self.weights[i] = (forward[i] - known) * inverse[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_law_is_found() {
        let mut model = LeastSquares::<4>::new(0.999);
        for i in 0..400u16 {
            let features = [f32::from(i % 7), f32::from(i % 5) - 2.0, f32::from(i % 3), 0.0];
            model.learn(&features, 2.0 * features[0] - features[1] + 0.5 * features[2], 1.0);
        }
        assert!((model.predict(&[1.0, 1.0, 2.0, 0.0]) - 2.0).abs() < 0.01);
    }
}
