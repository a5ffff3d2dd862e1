//! The weights of logistic mixing: how much each of several opinions has helped so far, in each context.
//! FORMAT.md 6.3 and 6.5.

use crate::ground::lanes::{LANES, sum_of_products};

/// The ratio of the initial to the final learning rate.
const EARLY_RATE: f32 = 4.0;
/// After this many bits, the learning rate of a weight set has halved.
const EARLY_BITS: f32 = 200.0;

/// One weight set for each context, with `N` weights, a multiple of four.
#[derive(Clone)]
pub struct WeightSets<const N: usize> {
    weights: Vec<[f32; N]>,
    /// How many bits each weight set has learned from.
    seen: Vec<u16>,
    /// The learning rate after that many bits, per 1/65536 of a probability.
    rates: Vec<f32>,
}

impl<const N: usize> WeightSets<N> {
    /// Creates `sets` weight sets, which start as `weights`. The learning rate ends at `rate`.
    pub fn new(sets: usize, weights: [f32; N], rate: f32) -> Self {
        const { assert!(N.is_multiple_of(LANES)) };
        let early = |seen: u16| EARLY_RATE * EARLY_BITS / (EARLY_BITS + f32::from(seen));
        let last = (EARLY_BITS * (EARLY_RATE - 1.0)) as u16;
        WeightSets {
            weights: vec![weights; sets],
            seen: vec![0; sets],
            rates: (0..=last).map(|seen| rate * early(seen) / 65536.0).collect(),
        }
    }

    /// Copies the learned state of the first `sets` sets to the sets that follow, `sets` at a time.
    pub fn spread(&mut self, sets: usize) {
        for set in sets..self.weights.len() {
            (self.weights[set], self.seen[set]) = (self.weights[set % sets], self.seen[set % sets]);
        }
    }

    /// The weighted sum of the opinions.
    #[inline(always)]
    pub fn mix(&self, set: usize, opinions: &[f32; N]) -> f32 {
        sum_of_products(0.0, &self.weights[set], opinions)
    }

    /// Learns from a bit to which the set's sum gave the probability `p` / 65536.
    #[inline(always)]
    pub fn learn(&mut self, set: usize, opinions: &[f32; N], bit: bool, p: u32) {
        let seen = &mut self.seen[set];
        let pull = ((i32::from(bit) << 16) - p as i32) as f32 * self.rates[usize::from(*seen)];
        *seen += u16::from(usize::from(*seen) + 1 < self.rates.len());
        for (weight, opinion) in self.weights[set].iter_mut().zip(opinions) {
            *weight += pull * opinion;
        }
    }
}
