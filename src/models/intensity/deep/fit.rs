//! A least-squares fit of the intensity level, and its reliability. FORMAT.md 8.5, "Levels, if `coder` is 1".

use super::surroundings::{FEATURES, Surroundings};
use crate::entropy::Logistic;
use crate::models::intensity::scale::IntensityScale;
use crate::models::least_squares::BatchedLeastSquares;
use crate::models::shape::{ErrorShape, Placed};

/// Fits: one for each combination of whether there is a neighbour to the left, one above, and one in an
/// earlier frame.
const FITS: usize = 8;
/// The lower limit of mean errors, in context levels.
const LEAST_SCALE: f32 = 0.3;
/// The rate at which mean errors are learned.
const SCALE_RATE: f32 = 0.01;
/// Added to probabilities before their logarithm is taken.
const LEAST: f32 = 1.0 / (1 << 24) as f32;

/// The fits, and their mean errors.
#[derive(Clone)]
pub struct Fit {
    fits: [BatchedLeastSquares<FEATURES>; FITS],
    shape: ErrorShape,
    /// The mean error in each context, in context levels.
    scales: Vec<f32>,
}

impl Fit {
    /// Creates untrained fits, with mean errors for `contexts` contexts.
    pub fn new(contexts: usize) -> Self {
        Fit {
            fits: std::array::from_fn(|_| BatchedLeastSquares::new(0.998)),
            shape: ErrorShape::new(),
            scales: vec![4.0; contexts],
        }
    }

    /// The predicted context level: 0 to 127.9.
    pub fn predict(&self, around: &Surroundings) -> f32 {
        (around.base() + self.fits[around.fit()].predict(around.features())).clamp(0.0, 127.9)
    }

    /// The distribution of the level around a prediction.
    pub fn opinion(&self, prediction: f32, context: usize, scale: &IntensityScale) -> FitOpinion {
        let unit = scale.context_step() as f32;
        let mean_error = self.scales[context].max(LEAST_SCALE) * unit;
        let placed = self.shape.place([(prediction - 0.5) * unit], &[mean_error]);
        FitOpinion { placed, low: 0, high: 1 << scale.bits(), below: [0.0, 0.0, 1.0] }
    }

    /// The shape of the error distribution.
    pub fn shape(&self) -> &ErrorShape {
        &self.shape
    }

    /// Learns from the context level that was coded.
    pub fn learn(&mut self, around: &Surroundings, prediction: f32, context: usize, own: f32) {
        let error = own - prediction;
        let weight = 1.0 / (9.0 + error * error);
        self.fits[around.fit()].learn(around.features(), own - around.base(), weight);
        let scale = &mut self.scales[context];
        *scale += (error.abs() - *scale) * SCALE_RATE;
    }
}

/// The opinion of a fit on each bit of a level, from the distribution around its prediction.
#[derive(Clone, Copy, Debug)]
pub struct FitOpinion {
    placed: Placed<1>,
    /// The levels that are still possible after the bits so far: `low` to below `high`.
    low: u32,
    high: u32,
    /// The probability of a level below `low`, below the middle, and below `high`.
    below: [f32; 3],
}

impl FitOpinion {
    /// The log odds that the level is in the upper half of those still possible.
    #[inline]
    pub fn of_upper_half(&mut self, shape: &ErrorShape, tables: &Logistic) -> f32 {
        let [low, _, high] = self.below;
        let [middle] = shape.below(&self.placed, ((self.low + self.high) / 2) as f32);
        self.below[1] = middle;
        let [lower, upper] =
            [middle - low, high - middle].map(|part| if part > 0.0 { part + LEAST } else { LEAST });
        tables.odds(upper, lower)
    }

    /// Continues with the upper half, or with the lower one.
    #[inline]
    pub fn narrow(&mut self, upper: bool) {
        let middle = (self.low + self.high) / 2;
        if upper {
            (self.low, self.below[0]) = (middle, self.below[1]);
        } else {
            (self.high, self.below[2]) = (middle, self.below[1]);
        }
    }
}
