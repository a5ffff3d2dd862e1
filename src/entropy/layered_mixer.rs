//! Logistic mixing in two layers (Mahoney's PAQ8): several weight sets, each selected by a context of its
//! own, mix the same opinions; their results are mixed again and refined. FORMAT.md 6.5.

use super::refinement::Refinement;
use super::weights::WeightSets;
use super::{BitCoder, Logistic};

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
    last_rate: f32,
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

/// The final learning rates of the layers' weights.
#[derive(Clone, Copy, Debug)]
pub struct MixRates {
    /// The rate of the first layer.
    pub first: f32,
    /// The rate of the second layer.
    pub last: f32,
}

impl<const N: usize, const S: usize> LayeredMixer<N, S> {
    /// Creates as many weight sets and maps as `counts` says. The first layer's weights start as `weights`.
    pub fn new(counts: MixContexts<S>, weights: [f32; N], rates: MixRates) -> Self {
        LayeredMixer {
            sets: counts.sets.map(|sets| WeightSets::new(sets, weights, rates.first)),
            last: vec![[1.0 / S as f32; S]; counts.last],
            refinements: counts.refinements.map(Refinement::new),
            last_rate: rates.last,
            tables: Logistic::tables(),
        }
    }

    /// Copies the learned state of the first `sets` weight sets of a first-layer mixer to the sets that
    /// follow, `sets` at a time.
    pub fn spread_sets(&mut self, mixer: usize, sets: usize) {
        self.sets[mixer].spread(sets);
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
            *first = sets.mix(set, opinions).clamp(-MOST_ODDS, MOST_ODDS);
        }
        let last = &mut self.last[contexts.last];
        let mixed = firsts.iter().zip(last.iter()).fold(0.0, |sum, (first, weight)| sum + first * weight);
        let mut refined = mixed * (1.0 - REFINED_SHARE * REFINEMENTS as f32);
        let places: [_; REFINEMENTS] = std::array::from_fn(|i| {
            let (place, odds) = self.refinements[i].refine(contexts.refinements[i], mixed);
            refined += REFINED_SHARE * odds;
            place
        });
        let p = self.tables.squash(refined);
        let bit = coder.code(bit, p);
        let error = ((i32::from(bit) << 16) - p as i32) as f32 / 65536.0;
        let pull = error * self.last_rate;
        for i in 0..S {
            last[i] += pull * firsts[i];
            self.sets[i].learn(contexts.sets[i], opinions, bit, self.tables.squash(firsts[i]));
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
