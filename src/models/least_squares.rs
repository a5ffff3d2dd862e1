//! Online least squares: the linear prediction that would have been best for the samples so far, with old
//! errors forgotten exponentially. FORMAT.md 7.1. In two forms with the same results: for few samples a
//! solution, and for many, which are added to the normal equations only before these are solved, all at once,
//! so that the matrix is loaded and stored once, and the solution works on whole rows.

use pulp::NullaryFnOnce;

use crate::ground::lanes::{LANES, dispatch, lanes, sum_of_products};

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

/// `N` weights, solved again every few samples.
#[derive(Clone, Debug)]
pub struct BatchedLeastSquares<const N: usize> {
    equations: Equations<N>,
    weights: [f32; N],
    /// The samples since the last solution, which are not in the equations yet.
    latest: Vec<Sample<N>>,
    solve_every: u32,
}

/// The normal equations of the samples so far.
#[derive(Clone, Debug)]
struct Equations<const N: usize> {
    /// The normal matrix, of which only the elements on and above the diagonal are used.
    normal: [[f32; N]; N],
    right: [f32; N],
    forget: f32,
}

#[derive(Clone, Copy, Debug)]
struct Sample<const N: usize> {
    features: [f32; N],
    target: f32,
    weight: f32,
}

/// Columns that are updated together while there are as many; then [`LANES`].
const WIDE: usize = 8;
/// Rows that are updated together: enough for their sums not to wait for each other.
const ROWS: usize = 8;

impl<const N: usize> BatchedLeastSquares<N> {
    /// As [`LeastSquares::new`](LeastSquares::new).
    pub fn new(forget: f32) -> Self {
        const { assert!(N.is_multiple_of(LANES)) };
        BatchedLeastSquares {
            equations: Equations { normal: [[0.0; N]; N], right: [0.0; N], forget },
            weights: [0.0; N],
            latest: Vec::new(),
            solve_every: SOLVE_EVERY,
        }
    }

    /// This predictor, but solved after every `samples` samples.
    pub fn solved_every(self, samples: u32) -> Self {
        BatchedLeastSquares { solve_every: samples, ..self }
    }

    /// The prediction from these features.
    #[inline(always)]
    pub fn predict(&self, features: &[f32; N]) -> f32 {
        sum_of_products(0.0, &self.weights, features)
    }

    /// Learns that `target` came with these features; `weight` is the weight of this sample.
    #[inline(always)]
    pub fn learn(&mut self, features: &[f32; N], target: f32, weight: f32) {
        self.latest.push(Sample { features: *features, target, weight });
        if self.latest.len() >= self.solve_every as usize {
            self.solve();
        }
    }

    #[inline(never)]
    fn solve(&mut self) {
        dispatch(Adding { equations: &mut self.equations, samples: &self.latest });
        self.latest.clear();
        self.equations.solve(&mut self.weights);
    }
}

/// Adds samples to the equations.
struct Adding<'a, const N: usize> {
    equations: &'a mut Equations<N>,
    samples: &'a [Sample<N>],
}

impl<const N: usize> NullaryFnOnce for Adding<'_, N> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.equations.add(self.samples);
    }
}

impl<const N: usize> Equations<N> {
    #[inline(always)]
    fn add(&mut self, samples: &[Sample<N>]) {
        let mut column = 0;
        while column < N {
            if column + WIDE <= N {
                for row in (0..column + WIDE).step_by(ROWS) {
                    self.add_to_tile::<WIDE, ROWS>((row, column), samples);
                }
                column += WIDE;
            } else {
                let mut row = 0;
                while row + ROWS <= column + LANES {
                    self.add_to_tile::<LANES, ROWS>((row, column), samples);
                    row += ROWS;
                }
                if row < column + LANES {
                    self.add_to_tile::<LANES, LANES>((row, column), samples);
                }
                column += LANES;
            }
        }
        let mut right = self.right;
        for sample in samples {
            let weighted = sample.weight * sample.target;
            for i in 0..N {
                right[i] = right[i] * self.forget + weighted * sample.features[i];
            }
        }
        self.right = right;
    }

    /// Adds samples to `R` rows of `L` elements, from `row` and `column` on.
    #[inline(always)]
    fn add_to_tile<const L: usize, const R: usize>(
        &mut self,
        (row, column): (usize, usize),
        samples: &[Sample<N>],
    ) {
        let forget = self.forget;
        let mut tile: [[f32; L]; R] = [[0.0; L]; R];
        for r in 0..R {
            tile[r].copy_from_slice(&self.normal[row + r][column..column + L]);
        }
        for sample in samples {
            let weighted: [f32; L] = lanes(|lane| sample.weight * sample.features[column + lane]);
            for r in 0..R {
                let feature = sample.features[row + r];
                for lane in 0..L {
                    tile[r][lane] = tile[r][lane] * forget + weighted[lane] * feature;
                }
            }
        }
        for r in 0..R {
            self.normal[row + r][column..column + L].copy_from_slice(&tile[r]);
        }
    }

    /// Solves by Cholesky decomposition; if the matrix is not positive definite, the weights are not changed.
    /// Not compiled for AVX-512, for which LLVM gathers the elements of several rows, which takes longer.
    fn solve(&self, weights: &mut [f32; N]) {
        // The rows above number k are those of the upper factor, the others what is left of the matrix.
        let mut rows = self.normal;
        let mut inverse = [0.0; N];
        for k in 0..N {
            let pivot = rows[k][k];
            if pivot + RIDGE > 1e-6 {
                inverse[k] = 1.0 / (pivot + RIDGE).sqrt();
            } else {
                return;
            }
            for i in 0..N {
                rows[k][i] *= inverse[k];
            }
            let row = rows[k];
            for j in k + 1..N {
                let factor = row[j];
                for i in 0..N {
                    rows[j][i] -= factor * row[i];
                }
            }
        }
        let mut forward = [0.0; N];
        let mut known = [0.0; N];
        for k in 0..N {
            forward[k] = (self.right[k] - known[k]) * inverse[k];
            for i in 0..N {
                known[i] += rows[k][i] * forward[k];
            }
        }
        for i in (0..N).rev() {
            let known: f32 = (i + 1..N).map(|k| rows[i][k] * weights[k]).sum();
            weights[i] = (forward[i] - known) * inverse[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    #[test]
    fn a_linear_law_is_found() {
        let mut model = LeastSquares::<4>::new(0.999);
        for i in 0..400u16 {
            let features = [f32::from(i % 7), f32::from(i % 5) - 2.0, f32::from(i % 3), 0.0];
            model.learn(&features, 2.0 * features[0] - features[1] + 0.5 * features[2], 1.0);
        }
        assert!((model.predict(&[1.0, 1.0, 2.0, 0.0]) - 2.0).abs() < 0.01);
    }

    fn agree<const N: usize>() {
        let mut random = Rng::keyed(N as u64, &[]);
        let mut one_by_one = LeastSquares::<N>::new(0.98).solved_every(8);
        let mut batched = BatchedLeastSquares::<N>::new(0.98).solved_every(8);
        for _ in 0..200 {
            let mut number = || random.below(2000) as f32 / 100.0 - 10.0;
            let features = std::array::from_fn(|_| number());
            let (target, weight) = (number(), number().abs());
            assert_eq!(one_by_one.predict(&features), batched.predict(&features));
            one_by_one.learn(&features, target, weight);
            batched.learn(&features, target, weight);
        }
    }

    #[test]
    fn results_are_those_of_adding_one_by_one() {
        agree::<4>();
        agree::<8>();
        agree::<12>();
        agree::<16>();
        agree::<28>();
    }
}
