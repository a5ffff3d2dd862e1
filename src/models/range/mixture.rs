//! A mixture of predictors, each with a weight and a scale in each context. The predictions are mixed by one
//! or more sets of weights. FORMAT.md 8.6, "Coding" and "Learning".

use super::{FIT, FIT_REACH, SURPRISE};
use crate::entropy::Logistic;
use crate::ground::lanes::{lanes, sum_of_products};
use crate::models::shape::{ErrorShape, Placed};

/// The part of the probability that is distributed evenly over all ranges.
const EVEN: f32 = 1.0 / 256.0;
/// The lower limit of the probability of a half.
const LEAST: f32 = 1.0 / (1 << 26) as f32;

/// The learning rates of a context's weights and scales.
#[derive(Clone, Copy)]
pub struct Rates {
    pub weights: f32,
    pub scales: f32,
    /// Both rates are at least this value divided by (n + 1.5), where n is the number of returns seen in the
    /// context.
    pub early: f32,
}

/// The number of returns seen is limited to this.
const MOST_SEEN: u16 = 1000;

/// The adaptive models of `P` predictors, mixed by `M` sets of weights.
#[derive(Clone)]
pub struct Mixture<const P: usize, const M: usize> {
    /// The mean magnitude of each predictor's error, in steps, in the contexts of the last set of weights.
    scales: Vec<[f32; P]>,
    weights: [Vec<Weights<P>>; M],
    rates: Rates,
}

/// The weights of the predictors in a context.
#[derive(Clone, Copy)]
struct Weights<const P: usize> {
    weights: [f32; P],
    /// Number of returns seen in the context.
    seen: u16,
}

/// The predictions for a cell, in steps, placed in the table of the error shape, and the context for each set
/// of weights.
pub struct Predicted<const P: usize, const M: usize> {
    values: [f32; P],
    contexts: [usize; M],
    placed: Placed<P>,
}

/// The remaining bins, and the probability below each end.
pub struct Interval<const P: usize, const M: usize> {
    pub low: i64,
    pub high: i64,
    below_low: Below<P, M>,
    below_high: Below<P, M>,
}

/// Probability that a range is below some value, according to each predictor and to each set of weights.
#[derive(Clone, Copy)]
pub struct Below<const P: usize, const M: usize> {
    each: [f32; P],
    mixed: [f32; M],
}

impl<const P: usize, const M: usize> Interval<P, M> {
    /// The interval of all bins.
    pub fn whole((low, high): (i64, i64)) -> Self {
        let below = |each, mixed| Below { each: [each; P], mixed: [mixed; M] };
        Interval { low, high, below_low: below(0.0, 0.0), below_high: below(1.0, 1.0 + EVEN) }
    }

    /// The log odds of each set of weights for the halves above and below a point between the ends, upper
    /// against lower.
    #[inline]
    pub fn split(&self, below_middle: &Below<P, M>, tables: &Logistic) -> [f32; M] {
        lanes(|m| {
            let above = self.below_high.mixed[m] - below_middle.mixed[m];
            let below = below_middle.mixed[m] - self.below_low.mixed[m];
            let [above, below] = [above, below].map(|half| if half > LEAST { half } else { LEAST });
            tables.odds(above, below)
        })
    }

    /// Keeps the half from `middle` on, or else the one below.
    #[inline]
    pub fn cut(&mut self, upper: bool, middle: i64, below_middle: &Below<P, M>) {
        if upper {
            self.low = middle;
            self.below_low = *below_middle;
        } else {
            self.high = middle;
            self.below_high = *below_middle;
        }
    }
}

impl<const P: usize, const M: usize> Mixture<P, M> {
    /// The set of weights whose contexts the scales share.
    const LAST: usize = M - 1;

    /// Creates a mixture with `contexts` contexts for each set of weights. `first_scale` returns the initial
    /// scale in a context.
    pub fn new(rates: Rates, contexts: [usize; M], first_scale: impl Fn(usize) -> f32) -> Self {
        let scales = (0..contexts[Self::LAST]).map(|context| {
            let mut scales = [first_scale(context); P];
            scales[SURPRISE] = 500.0;
            scales
        });
        let equal = Weights { weights: [1.0 / P as f32; P], seen: 0 };
        Mixture { scales: scales.collect(), weights: contexts.map(|contexts| vec![equal; contexts]), rates }
    }

    /// This mixture with additional predictors, which are untrained, and with all contexts repeated
    /// `copies` times.
    pub fn widened<const Q: usize>(&self, copies: usize) -> Mixture<Q, M> {
        let share = P as f32 / Q as f32;
        let widened = |old: &Weights<P>| {
            let mut weights = [1.0 / Q as f32; Q];
            weights.iter_mut().zip(old.weights).for_each(|(weight, old)| *weight = old * share);
            Weights { weights, seen: old.seen }
        };
        let scales = self.scales.iter().map(|old| {
            let mut scales = [old[FIT]; Q];
            scales[..P].copy_from_slice(old);
            scales
        });
        Mixture {
            scales: scales.collect::<Vec<_>>().repeat(copies),
            weights: self
                .weights
                .each_ref()
                .map(|set| set.iter().map(widened).collect::<Vec<_>>().repeat(copies)),
            rates: self.rates,
        }
    }

    /// Copies the learned state of the first `contexts` contexts of a set of weights to the contexts that
    /// follow, `contexts` at a time.
    pub fn spread(&mut self, set: usize, contexts: usize) {
        for context in contexts..self.weights[set].len() {
            self.weights[set][context] = self.weights[set][context % contexts];
            if set == Self::LAST {
                self.scales[context] = self.scales[context % contexts];
            }
        }
    }

    /// Places the error distributions around the predictions, in steps.
    #[inline]
    pub fn place(&self, shape: &ErrorShape, values: [f32; P], contexts: [usize; M]) -> Predicted<P, M> {
        let placed = shape.place(values.map(|value| value + 0.5), &self.scales[contexts[Self::LAST]]);
        Predicted { values, contexts, placed }
    }

    /// The scale of the least-squares prediction.
    pub fn scale_of_fit(&self, predicted: &Predicted<P, M>) -> f32 {
        self.scales[predicted.contexts[Self::LAST]][FIT]
    }

    /// The probability that the range is below `range`.
    #[inline]
    pub fn below(
        &self,
        shape: &ErrorShape,
        predicted: &Predicted<P, M>,
        range: i64,
        range_bits: u32,
    ) -> Below<P, M> {
        let each = shape.below(&predicted.placed, range as f32);
        let even = EVEN / (1u32 << range_bits) as f32 * range as f32;
        let mixed = lanes(|m| sum_of_products(even, &self.weights[m][predicted.contexts[m]].weights, &each));
        Below { each, mixed }
    }

    /// Adapts weights and scales to the coded range, to whose bin the interval has shrunk.
    pub fn learn(&mut self, predicted: &Predicted<P, M>, interval: &Interval<P, M>, range: f32) {
        let mut likelihood = [0.0; P];
        for k in 0..P {
            likelihood[k] = (interval.below_high.each[k] - interval.below_low.each[k]).max(0.0);
        }
        let Rates { weights: weight_rate, scales: scale_rate, early } = self.rates;
        let last = predicted.contexts[Self::LAST];
        let scale_rate = scale_rate.max(self.weights[Self::LAST][last].early(early));
        let mut responsible = [0.0; P];
        for (set, context) in self.weights.iter_mut().zip(predicted.contexts) {
            let weights = &mut set[context];
            // The responsibilities according to the last set are used below.
            responsible = weights.learn(&likelihood, weight_rate.max(weights.early(early)));
        }
        let scales = &mut self.scales[last];
        for k in 0..P {
            let surprise = k == SURPRISE;
            let (farthest, least, always) =
                if surprise { (4000.0, 100.0, 0.0) } else { (f32::from(FIT_REACH), 1.5, 0.1) };
            let error = (range - predicted.values[k]).abs().min(farthest);
            scales[k] += scale_rate * (responsible[k] + always) * (error - scales[k]);
            scales[k] = scales[k].max(least);
        }
    }
}

impl<const P: usize> Weights<P> {
    /// The least learning rate of a context that has seen few returns.
    #[inline]
    fn early(&self, early: f32) -> f32 {
        early / (f32::from(self.seen) + 1.5)
    }

    /// Adapts the weights to the likelihood of the range under each predictor. Returns the responsibility of
    /// each predictor for it.
    #[inline]
    fn learn(&mut self, likelihood: &[f32; P], rate: f32) -> [f32; P] {
        /// Avoids a division by 0.
        const TINY: f32 = 1e-9;
        self.seen = (self.seen + 1).min(MOST_SEEN);
        let weights = &mut self.weights;
        let most = 1.0 / sum_of_products(TINY, weights, likelihood);
        let mut responsible = [0.0; P];
        for k in 0..P {
            let merit = (likelihood[k] + TINY) * most;
            weights[k] = (weights[k] * (1.0 - rate + rate * merit)).max(0.001);
            responsible[k] = (weights[k] * merit).min(1.0);
        }
        let even_out = 1.0 / sum_of_products(0.0, weights, &[1.0; P]);
        weights.iter_mut().for_each(|weight| *weight *= even_out);
        responsible
    }
}
