//! A mixture of predictors, each with a weight and a scale in each context.

use super::{FIT, FIT_REACH, SURPRISE};
use crate::context::shape::{CERTAIN, ErrorShape, Placed};

/// Probability of the mixture in the unit of [`Below::mixed`]: weights are in 2^-16.
const MIXED_CERTAIN: u64 = (CERTAIN as u64) << 16;
/// All ranges together get at least this much of it, evenly.
const EVEN: u64 = MIXED_CERTAIN / 256;
/// Learning rates of the weights and the scales.
const WEIGHT_RATE: f64 = 0.02;
const SCALE_RATE: f64 = 0.02;

/// What has been learned about `P` predictors.
#[derive(Clone)]
pub struct Mixture<const P: usize> {
    weights: Vec<[f64; P]>,
    /// The weights in 2^-16.
    shares: Vec<[u32; P]>,
    scales: Vec<[f64; P]>,
}

/// The predictions for a cell, in steps, in a context, placed on the range axis.
pub struct Predicted<const P: usize> {
    pub values: [f64; P],
    pub context: usize,
    placed: [Placed; P],
}

/// What is left of the bins of the range axis, and the probability below the two ends.
pub struct Interval<const P: usize> {
    pub low: i64,
    pub high: i64,
    pub below_low: Below<P>,
    pub below_high: Below<P>,
    /// The mixture's log odds of the last halves, upper against lower.
    pub odds: f32,
}

/// Probability that a range is below some value: each predictor's, and the mixture's.
#[derive(Clone, Copy)]
pub struct Below<const P: usize> {
    each: [u32; P],
    pub mixed: u64,
}

impl<const P: usize> Interval<P> {
    /// All bins.
    pub fn whole((low, high): (i64, i64)) -> Self {
        let below = |each, mixed| Below { each: [each; P], mixed };
        let certain = below(CERTAIN, MIXED_CERTAIN + EVEN);
        Interval { low, high, below_low: below(0, 0), below_high: certain, odds: 0.0 }
    }
}

impl<const P: usize> Mixture<P> {
    /// For contexts that start with these scales.
    pub fn new(scales: impl Iterator<Item = f64>) -> Self {
        let scales: Vec<_> = scales
            .map(|scale| {
                let mut scales = [scale; P];
                scales[SURPRISE] = 500.0;
                scales
            })
            .collect();
        Mixture {
            weights: vec![[1.0 / P as f64; P]; scales.len()],
            shares: vec![[65536 / P as u32; P]; scales.len()],
            scales,
        }
    }

    /// The same with more predictors, of which nothing is known yet, and every context as often as told:
    /// copy after copy.
    pub fn widened<const Q: usize>(&self, copies: usize) -> Mixture<Q> {
        let share = P as f64 / Q as f64;
        let weights = self.weights.iter().map(|old| {
            let mut weights = [1.0 / Q as f64; Q];
            weights.iter_mut().zip(old).for_each(|(weight, old)| *weight = old * share);
            weights
        });
        let scales = self.scales.iter().map(|old| {
            let mut scales = [old[FIT]; Q];
            scales[..P].copy_from_slice(old);
            scales
        });
        let (weights, scales): (Vec<_>, Vec<_>) = (weights.collect(), scales.collect());
        let shares: Vec<_> =
            weights.iter().map(|weights| weights.map(|weight| (weight * 65536.0) as u32)).collect();
        Mixture {
            weights: weights.repeat(copies),
            shares: shares.repeat(copies),
            scales: scales.repeat(copies),
        }
    }

    /// Places predictions.
    #[inline]
    pub fn place(&self, shape: &ErrorShape, values: [f64; P], context: usize) -> Predicted<P> {
        let scales = &self.scales[context];
        let placed = std::array::from_fn(|k| shape.place(values[k] + 0.5, scales[k]));
        Predicted { values, context, placed }
    }

    /// The scale of the least-squares prediction.
    pub fn scale_of_fit(&self, context: usize) -> f64 {
        self.scales[context][FIT]
    }

    /// The probability that the range is below `range`.
    #[inline]
    pub fn below(
        &self,
        shape: &ErrorShape,
        predicted: &Predicted<P>,
        range: i64,
        range_bits: u32,
    ) -> Below<P> {
        let shares = &self.shares[predicted.context];
        let mut each = [0; P];
        let mut mixed = (EVEN >> range_bits) * range as u64;
        for k in 0..P {
            each[k] = shape.below(&predicted.placed[k], range);
            mixed += u64::from(shares[k]) * u64::from(each[k]);
        }
        Below { each, mixed }
    }

    /// Moves weights and scales towards the range that has been coded, to whose bin the interval has
    /// shrunk.
    pub fn learn(&mut self, predicted: &Predicted<P>, interval: &Interval<P>, range: f64) {
        let weights = &mut self.weights[predicted.context];
        let scales = &mut self.scales[predicted.context];
        let likelihood: [f64; P] = std::array::from_fn(|k| {
            let likely = interval.below_high.each[k].saturating_sub(interval.below_low.each[k]);
            f64::from(likely) / f64::from(CERTAIN)
        });
        let total: f64 = weights.iter().zip(&likelihood).map(|(weight, p)| weight * p).sum();
        let mut sum = 0.0;
        for k in 0..P {
            let surprise = k == SURPRISE;
            let merit = (likelihood[k] + 1e-9) / (total + 1e-9);
            weights[k] = (weights[k] * (1.0 - WEIGHT_RATE + WEIGHT_RATE * merit)).max(0.001);
            sum += weights[k];
            let error = (range - predicted.values[k]).abs().min(if surprise { 4000.0 } else { FIT_REACH });
            let responsibility = (weights[k] * merit).min(1.0) + if surprise { 0.0 } else { 0.1 };
            scales[k] += SCALE_RATE * responsibility * (error - scales[k]);
            scales[k] = scales[k].max(if surprise { 100.0 } else { 1.5 });
        }
        let even_out = 1.0 / sum;
        for (weight, share) in weights.iter_mut().zip(&mut self.shares[predicted.context]) {
            *weight *= even_out;
            *share = (*weight * 65536.0) as u32;
        }
    }
}
