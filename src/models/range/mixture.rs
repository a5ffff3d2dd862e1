//! A mixture of predictors, each with a weight and a scale in each context.

use super::{FIT, FIT_REACH, SURPRISE};
use crate::entropy::Logistic;
use crate::models::shape::{CERTAIN, ErrorShape, Placed};

/// The probability 1 in the unit of [`Below::mixed`], as weights are in 2^-16.
const MIXED_CERTAIN: u64 = (CERTAIN as u64) << 16;
/// The part of it that is distributed evenly over all ranges.
const EVEN: u64 = MIXED_CERTAIN / 256;

/// The learning rates of a context's weights and scales.
#[derive(Clone, Copy)]
pub struct Rates {
    pub weights: f64,
    pub scales: f64,
    /// Both rates are at least this divided by the number of returns that the context has seen plus 1.5.
    pub early: f64,
}

/// Returns are counted up to this number.
const MOST_SEEN: u16 = 1000;

/// What the coder has learned about `P` predictors.
#[derive(Clone)]
pub struct Mixture<const P: usize> {
    weights: Vec<[f64; P]>,
    /// The weights in 2^-16.
    shares: Vec<[u32; P]>,
    scales: Vec<[f64; P]>,
    /// Number of returns that each context has seen.
    seen: Vec<u16>,
    rates: Rates,
}

/// The predictions for a cell, in steps, in a context, as places in the table of the error shape.
pub struct Predicted<const P: usize> {
    pub values: [f64; P],
    pub context: usize,
    placed: [Placed; P],
}

/// The remaining bins, and the probability below each end.
pub struct Interval<const P: usize> {
    pub low: i64,
    pub high: i64,
    pub below_low: Below<P>,
    pub below_high: Below<P>,
    /// The mixture's log odds for the last halves, upper against lower.
    pub odds: f32,
}

/// Probability that a range is below some value: by each predictor, and by the mixture.
#[derive(Clone, Copy)]
pub struct Below<const P: usize> {
    each: [u32; P],
    pub mixed: u64,
}

impl<const P: usize> Default for Below<P> {
    fn default() -> Self {
        Below { each: [0; P], mixed: 0 }
    }
}

impl<const P: usize> Interval<P> {
    /// The mixture's log odds for the halves above and below a place between the ends, upper against lower.
    #[inline]
    pub fn split(&mut self, below_middle: &Below<P>, tables: &Logistic) -> f32 {
        let above = self.below_high.mixed.saturating_sub(below_middle.mixed) | 1;
        let below = below_middle.mixed.saturating_sub(self.below_low.mixed) | 1;
        self.odds = tables.ln(above) - tables.ln(below);
        self.odds
    }

    /// Keeps the half from `middle` on, or else the one below.
    #[inline]
    pub fn cut(&mut self, upper: bool, middle: i64, below_middle: &Below<P>) {
        if upper {
            self.low = middle;
            self.below_low = *below_middle;
        } else {
            self.high = middle;
            self.below_high = *below_middle;
        }
    }

    /// The interval of all bins.
    pub fn whole((low, high): (i64, i64)) -> Self {
        let below = |each, mixed| Below { each: [each; P], mixed };
        let certain = below(CERTAIN, MIXED_CERTAIN + EVEN);
        Interval { low, high, below_low: below(0, 0), below_high: certain, odds: 0.0 }
    }
}

impl<const P: usize> Mixture<P> {
    /// Creates a mixture whose contexts start with these scales.
    pub fn new(rates: Rates, scales: impl Iterator<Item = f64>) -> Self {
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
            seen: vec![0; scales.len()],
            rates,
            scales,
        }
    }

    /// The same with additional predictors, about which nothing is known yet, and with all contexts repeated
    /// `copies` times.
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
            seen: self.seen.repeat(copies),
            rates: self.rates,
        }
    }

    /// Copies what the first `contexts` contexts have learned to those that follow, `contexts` at a time.
    pub fn spread(&mut self, contexts: usize) {
        for context in contexts..self.scales.len() {
            let from = context % contexts;
            self.weights[context] = self.weights[from];
            self.shares[context] = self.shares[from];
            self.scales[context] = self.scales[from];
            self.seen[context] = self.seen[from];
        }
    }

    /// Places the error distributions around the predictions.
    #[inline]
    pub fn place(&self, shape: &ErrorShape, values: [f64; P], context: usize) -> Predicted<P> {
        let scales = &self.scales[context];
        let mut placed = [Placed::default(); P];
        for k in 0..P {
            placed[k] = shape.place(values[k] + 0.5, scales[k]);
        }
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

    /// Adapts weights and scales to the range that has been coded, to whose bin the interval has shrunk.
    pub fn learn(&mut self, predicted: &Predicted<P>, interval: &Interval<P>, range: f64) {
        let weights = &mut self.weights[predicted.context];
        let scales = &mut self.scales[predicted.context];
        let seen = &mut self.seen[predicted.context];
        let early = self.rates.early / (f64::from(*seen) + 1.5);
        *seen = (*seen + 1).min(MOST_SEEN);
        let weight_rate = self.rates.weights.max(early);
        let scale_rate = self.rates.scales.max(early);
        let likelihood: [f64; P] = std::array::from_fn(|k| {
            let likely = interval.below_high.each[k].saturating_sub(interval.below_low.each[k]);
            f64::from(likely) / f64::from(CERTAIN)
        });
        let total: f64 = weights.iter().zip(&likelihood).map(|(weight, p)| weight * p).sum();
        let mut sum = 0.0;
        for k in 0..P {
            let surprise = k == SURPRISE;
            let merit = (likelihood[k] + 1e-9) / (total + 1e-9);
            weights[k] = (weights[k] * (1.0 - weight_rate + weight_rate * merit)).max(0.001);
            sum += weights[k];
            let error = (range - predicted.values[k]).abs().min(if surprise { 4000.0 } else { FIT_REACH });
            let responsibility = (weights[k] * merit).min(1.0) + if surprise { 0.0 } else { 0.1 };
            scales[k] += scale_rate * responsibility * (error - scales[k]);
            scales[k] = scales[k].max(if surprise { 100.0 } else { 1.5 });
        }
        let even_out = 1.0 / sum;
        for (weight, share) in weights.iter_mut().zip(&mut self.shares[predicted.context]) {
            *weight *= even_out;
            *share = (*weight * 65536.0) as u32;
        }
    }
}
