//! Logistic mixing in two layers (Mahoney's PAQ8): several weight sets, each selected by a context of its
//! own, mix the same opinions; their results are mixed again and refined.

use super::refinement::Refinement;
use super::{BitCoder, Logistic};

/// Numbers that a vector unit of any processor handles at once.
const LANES: usize = 4;
/// The learning rate starts this many times as high as it ends.
const EARLY_RATE: f32 = 4.0;
/// After this many bits, the learning rate of a weight set has halved.
const EARLY_BITS: f32 = 200.0;
/// The results of the first layer are limited to these log odds.
const MOST_ODDS: f32 = 12.0;
/// Number of maps that refine the result, and the share of each in it.
const REFINEMENTS: usize = 2;
const REFINED_SHARE: f32 = 0.25;

/// Mixes `N` opinions by `S` weight sets. `N` is a multiple of four.
#[derive(Clone)]
pub struct LayeredMixer<const N: usize, const S: usize> {
    sets: [WeightSets<N>; S],
    last: Vec<[f32; S]>,
    refinements: [Refinement; REFINEMENTS],
    rates: MixRates,
    tables: &'static Logistic,
}

/// The contexts of a bit, or the number of contexts.
#[derive(Clone, Copy, Debug)]
pub struct MixContexts<const S: usize> {
    /// The weight set that each mixer of the first layer uses.
    pub sets: [usize; S],
    /// The weight set that the second layer uses.
    pub last: usize,
    /// The maps that refine the result.
    pub refinements: [usize; REFINEMENTS],
}

/// The learning rates that the layers' weights arrive at.
#[derive(Clone, Copy, Debug)]
pub struct MixRates {
    /// The rate of the first layer.
    pub first: f32,
    /// The rate of the second layer.
    pub last: f32,
}

#[derive(Clone)]
struct WeightSets<const N: usize> {
    weights: Vec<[f32; N]>,
    /// How many bits each weight set has learned from.
    seen: Vec<u16>,
}

impl<const N: usize> WeightSets<N> {
    #[inline]
    fn mix(&self, set: usize, opinions: &[f32; N]) -> f32 {
        let weights = &self.weights[set];
        let mut sums = [0.0f32; LANES];
        for block in (0..N).step_by(LANES) {
            for lane in 0..LANES {
                sums[lane] += weights[block + lane] * opinions[block + lane];
            }
        }
        ((sums[0] + sums[1]) + (sums[2] + sums[3])).clamp(-MOST_ODDS, MOST_ODDS)
    }

    #[inline]
    fn learn(&mut self, set: usize, opinions: &[f32; N], error: f32, rate: f32) {
        let seen = &mut self.seen[set];
        let early = EARLY_RATE * EARLY_BITS / (EARLY_BITS + f32::from(*seen));
        *seen += u16::from(early > 1.0);
        let pull = error * (rate * early);
        for (weight, opinion) in self.weights[set].iter_mut().zip(opinions) {
            *weight += pull * opinion;
        }
    }
}

impl<const N: usize, const S: usize> LayeredMixer<N, S> {
    /// Creates the numbers of weight sets and maps that `counts` gives. The first layer's weights start as
    /// `weights`.
    pub fn new(counts: MixContexts<S>, weights: [f32; N], rates: MixRates) -> Self {
        const { assert!(N.is_multiple_of(LANES)) };
        LayeredMixer {
            sets: counts.sets.map(|sets| WeightSets { weights: vec![weights; sets], seen: vec![0; sets] }),
            last: vec![[1.0 / S as f32; S]; counts.last],
            refinements: counts.refinements.map(Refinement::new),
            rates,
            tables: Logistic::tables(),
        }
    }

    /// Copies what the first `sets` weight sets of a mixer of the first layer have learned to those that
    /// follow, `sets` at a time.
    pub fn spread_sets(&mut self, mixer: usize, sets: usize) {
        let WeightSets { weights, seen } = &mut self.sets[mixer];
        for set in sets..weights.len() {
            (weights[set], seen[set]) = (weights[set % sets], seen[set % sets]);
        }
    }

    /// Codes a bit.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        contexts: &MixContexts<S>,
        opinions: &[f32; N],
        bit: bool,
    ) -> bool {
        let mut firsts = [0.0; S];
        for (first, (sets, set)) in firsts.iter_mut().zip(self.sets.iter().zip(contexts.sets)) {
            *first = sets.mix(set, opinions);
        }
        let last = &mut self.last[contexts.last];
        let mixed = firsts.iter().zip(last.iter()).fold(0.0, |sum, (first, weight)| sum + first * weight);
        let mut refined = mixed * (1.0 - REFINED_SHARE * REFINEMENTS as f32);
        let places: [_; REFINEMENTS] = std::array::from_fn(|i| {
            let (place, odds) = self.refinements[i].refine(contexts.refinements[i], mixed);
            refined += REFINED_SHARE * odds;
            place
        });
        let bit = coder.code(bit, self.tables.squash(refined));
        let target = i32::from(bit) << 16;
        let error = |odds: f32| (target - self.tables.squash(odds) as i32) as f32 / 65536.0;
        let last_error = error(mixed) * self.rates.last;
        for i in 0..S {
            last[i] += last_error * firsts[i];
            self.sets[i].learn(contexts.sets[i], opinions, error(firsts[i]), self.rates.first);
        }
        for (refinement, place) in self.refinements.iter_mut().zip(places) {
            refinement.learn(place, bit);
        }
        bit
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ArithmeticDecoder, ArithmeticEncoder};
    use super::*;

    /// Bits for which the second of four opinions is right, except in every eighth context, where the third
    /// is.
    fn coded<C: BitCoder>(coder: &mut C, bits: &[bool]) -> Vec<bool> {
        let counts = MixContexts { sets: [8, 1], last: 1, refinements: [1, 8] };
        let mut mixer = LayeredMixer::<4, 2>::new(counts, [0.1; 4], MixRates { first: 0.01, last: 0.0005 });
        let mut code = |(i, bit): (usize, &bool)| {
            let right = if bits[i] { 2.0 } else { -2.0 };
            let opinions = if i % 8 == 0 { [0.3, -right, right, 0.2] } else { [0.3, right, -right, 0.2] };
            let contexts = MixContexts { sets: [i % 8, 0], last: 0, refinements: [0, i % 8] };
            mixer.code(coder, &contexts, &opinions, *bit)
        };
        bits.iter().enumerate().map(&mut code).collect()
    }

    #[test]
    fn who_is_right_is_learned_in_each_context_and_bits_come_back() {
        let bits: Vec<bool> = (0..4000u32).map(|i| i.wrapping_mul(0x9e37_79b1) >> 31 == 1).collect();
        let mut encoder = ArithmeticEncoder::default();
        coded(&mut encoder, &bits);
        let bytes = encoder.finish();
        assert!(bytes.len() < 60, "{} bytes", bytes.len());
        assert_eq!(coded(&mut ArithmeticDecoder::new(&bytes), &bits), bits);
    }
}
