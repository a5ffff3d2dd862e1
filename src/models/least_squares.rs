//! Online least squares: the linear prediction that would have been best for the samples so far, with old
//! errors forgotten exponentially. FORMAT.md 7.1. Samples are added to the normal equations only before these
//! are solved, all at once, so that the matrix is loaded and stored once; the solution works on whole rows.

use std::ops::Range;

use pulp::{Scalar128b, Simd, WithSimd};

use crate::ground::lanes::{LANES, dispatch, sum_of_products};

/// Samples between two solutions, by default.
const SOLVE_EVERY: u32 = 32;
/// Added to the diagonal; keeps the weights of features that have not yet occurred near zero.
const RIDGE: f32 = 0.05;

/// `N` weights, solved again every few samples.
#[derive(Clone, Debug)]
pub struct LeastSquares<const N: usize> {
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

/// Rows that are updated together: enough for their sums not to wait for each other.
const ROWS: usize = 8;

impl<const N: usize> LeastSquares<N> {
    /// Starts with all weights 0. Each sample multiplies the weight of all earlier ones by `forget`.
    pub fn new(forget: f32) -> Self {
        LeastSquares {
            equations: Equations { normal: [[0.0; N]; N], right: [0.0; N], forget },
            weights: [0.0; N],
            latest: Vec::new(),
            solve_every: SOLVE_EVERY,
        }
    }

    /// This predictor, but solved after every `samples` samples.
    pub fn solved_every(self, samples: u32) -> Self {
        LeastSquares { solve_every: samples, ..self }
    }

    /// This predictor with additional features, which have no samples yet.
    pub fn widened<const M: usize>(&self) -> LeastSquares<M> {
        fn widen<const N: usize, const M: usize>(narrow: &[f32; N]) -> [f32; M] {
            let mut wide = [0.0; M];
            wide[..N].copy_from_slice(narrow);
            wide
        }
        let mut wide = LeastSquares::new(self.equations.forget).solved_every(self.solve_every);
        for (to, from) in wide.equations.normal.iter_mut().zip(&self.equations.normal) {
            *to = widen(from);
        }
        wide.equations.right = widen(&self.equations.right);
        wide.weights = widen(&self.weights);
        wide.latest.extend(self.latest.iter().map(|Sample { features, target, weight }| Sample {
            features: widen(features),
            target: *target,
            weight: *weight,
        }));
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
        self.latest.push(Sample { features: *features, target, weight });
        if self.latest.len() >= self.solve_every as usize {
            self.solve();
        }
    }

    #[inline(never)]
    fn solve(&mut self) {
        let added = Adding { equations: &mut self.equations, samples: &self.latest };
        // With so few features it would take longer to choose a vector unit.
        if N <= LANES {
            added.with_simd(Scalar128b)
        } else {
            dispatch(added)
        }
        self.latest.clear();
        self.equations.solve(&mut self.weights);
    }
}

/// Adds samples to the equations. It names the vectors: left to choose them, LLVM gathers the elements of
/// several rows at each step.
struct Adding<'a, const N: usize> {
    equations: &'a mut Equations<N>,
    samples: &'a [Sample<N>],
}

impl<const N: usize> WithSimd for Adding<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.equations.add(simd, self.samples);
    }
}

/// The columns from `column` on that a vector holds.
#[inline(always)]
fn columns_from<S: Simd>(column: usize, columns: usize) -> Range<usize> {
    column..columns.min(column + S::F32_LANES)
}

impl<const N: usize> Equations<N> {
    #[inline(always)]
    fn add<S: Simd>(&mut self, simd: S, samples: &[Sample<N>]) {
        for column in (0..N).step_by(S::F32_LANES) {
            let columns = columns_from::<S>(column, N);
            self.add_to_right(simd, columns.clone(), samples);
            // On and above the diagonal, and below it as far as needed to complete the tile.
            let mut row = 0;
            while row + ROWS <= columns.end {
                self.add_to_tile::<S, ROWS>(simd, row, columns.clone(), samples);
                row += ROWS;
            }
            while row + LANES <= columns.end {
                self.add_to_tile::<S, LANES>(simd, row, columns.clone(), samples);
                row += LANES;
            }
            while row < columns.end {
                self.add_to_tile::<S, 1>(simd, row, columns.clone(), samples);
                row += 1;
            }
        }
    }

    /// Adds samples to `R` rows, from `row` on, in some columns.
    #[inline(always)]
    fn add_to_tile<S: Simd, const R: usize>(
        &mut self,
        simd: S,
        row: usize,
        columns: Range<usize>,
        samples: &[Sample<N>],
    ) {
        let forget = simd.splat_f32s(self.forget);
        let mut tile = [forget; R];
        for r in 0..R {
            tile[r] = simd.partial_load_f32s(&self.normal[row + r][columns.clone()]);
        }
        for sample in samples {
            let features = simd.partial_load_f32s(&sample.features[columns.clone()]);
            let weighted = simd.mul_f32s(simd.splat_f32s(sample.weight), features);
            for r in 0..R {
                let added = simd.mul_f32s(weighted, simd.splat_f32s(sample.features[row + r]));
                tile[r] = simd.add_f32s(simd.mul_f32s(tile[r], forget), added);
            }
        }
        for r in 0..R {
            simd.partial_store_f32s(&mut self.normal[row + r][columns.clone()], tile[r]);
        }
    }

    /// Adds samples to some columns of the right side.
    #[inline(always)]
    fn add_to_right<S: Simd>(&mut self, simd: S, columns: Range<usize>, samples: &[Sample<N>]) {
        let forget = simd.splat_f32s(self.forget);
        let mut right = simd.partial_load_f32s(&self.right[columns.clone()]);
        for sample in samples {
            let features = simd.partial_load_f32s(&sample.features[columns.clone()]);
            let added = simd.mul_f32s(simd.splat_f32s(sample.weight * sample.target), features);
            right = simd.add_f32s(simd.mul_f32s(right, forget), added);
        }
        simd.partial_store_f32s(&mut self.right[columns], right);
    }

    /// Solves by Cholesky decomposition; if the matrix is not positive definite, the weights are not changed.
    /// Not compiled for AVX-512, for which LLVM gathers the elements of several rows; nor are there vectors
    /// named, because what is written to a part of one is slow to be read back.
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

    /// As FORMAT.md 7.1 says it, one element after the other.
    struct Plain<const N: usize> {
        normal: [[f32; N]; N],
        right: [f32; N],
        weights: [f32; N],
    }

    impl<const N: usize> Plain<N> {
        fn learn(&mut self, features: &[f32; N], target: f32, weight: f32, forget: f32) {
            for i in 0..N {
                for j in 0..=i {
                    self.normal[i][j] = self.normal[i][j] * forget + weight * features[i] * features[j];
                }
                self.right[i] = self.right[i] * forget + weight * target * features[i];
            }
        }

        fn solve(&mut self) {
            let mut lower = [[0.0; N]; N];
            let mut forward = [0.0; N];
            for i in 0..N {
                for j in 0..=i {
                    let sum = (0..j).fold(self.normal[i][j], |sum, k| sum - lower[i][k] * lower[j][k]);
                    lower[i][j] = if i > j { sum * lower[j][j] } else { 1.0 / (sum + RIDGE).sqrt() };
                }
                let known: f32 = (0..i).map(|k| lower[i][k] * forward[k]).sum();
                forward[i] = (self.right[i] - known) * lower[i][i];
            }
            for i in (0..N).rev() {
                let known: f32 = (i + 1..N).map(|k| lower[k][i] * self.weights[k]).sum();
                self.weights[i] = (forward[i] - known) * lower[i][i];
            }
        }
    }

    fn agree<const N: usize, const WIDE: usize>() {
        let mut random = Rng::keyed(N as u64, &[]);
        let mut plain = Plain::<N> { normal: [[0.0; N]; N], right: [0.0; N], weights: [0.0; N] };
        let mut model = LeastSquares::<N>::new(0.98).solved_every(8);
        let mut wide = model.widened::<WIDE>();
        let (mut scalar, mut scalar_weights) = (model.equations.clone(), [0.0; N]);
        for sample in 1..=200 {
            let mut number = || random.below(2000) as f32 / 100.0 - 10.0;
            let features: [f32; N] = std::array::from_fn(|_| number());
            let (target, weight) = (number(), number().abs());
            let mut wide_features = [0.0; WIDE];
            wide_features[..N].copy_from_slice(&features);
            let predicted = model.predict(&features);
            assert_eq!(predicted, sum_of_products(0.0, &plain.weights, &features));
            assert_eq!(predicted, wide.predict(&wide_features));
            plain.learn(&features, target, weight, 0.98);
            model.learn(&features, target, weight);
            wide.learn(&wide_features, target, weight);
            // As on processors without vector units.
            let samples = &[Sample { features, target, weight }];
            Adding { equations: &mut scalar, samples }.with_simd(pulp::Scalar::new());
            if sample % 8 == 0 {
                plain.solve();
                scalar.solve(&mut scalar_weights);
                assert_eq!(model.weights, scalar_weights);
            }
            if sample == 100 {
                wide = model.widened();
            }
        }
    }

    #[test]
    fn results_are_those_of_the_plain_form() {
        agree::<1, 4>();
        agree::<4, 8>();
        agree::<8, 16>();
        agree::<12, 16>();
        agree::<16, 28>();
        agree::<28, 32>();
    }
}
