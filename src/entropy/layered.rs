//! Logistic mixing in two layers (Mahoney's PAQ8): several weight sets, each selected by a context of its
//! own, mix the same opinions; their results are mixed again and refined. FORMAT.md 6.5. Bits coded from the
//! counters of several views and from external opinions, mixed in this way. FORMAT.md 6.6.
//!
//! Refinement is by maps from log odds to log odds, by the outcomes of similar estimates: one map per
//! context, piecewise linear between learned points (Mahoney's adaptive probability maps).

use super::logistic::{CONSTANT, WeightSets};
use super::{BitCoder, Counter, Logistic};
use crate::ground::lanes::LANES;

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

/// Points of a map, and points per unit of log odds.
const POINTS: usize = 33;
const FINENESS: f32 = 2.0;
/// The log odds of the outermost points.
const REACH: f32 = (POINTS - 1) as f32 / (2.0 * FINENESS);
const REFINEMENT_RATE: f32 = 0.08;

/// One map for each context.
#[derive(Clone)]
struct Refinement {
    maps: Vec<[f32; POINTS]>,
    tables: &'static Logistic,
}

/// The position of an estimate between two points of a map.
#[derive(Clone, Copy, Debug)]
struct Refined {
    context: usize,
    point: usize,
    /// Its distance from that point as a fraction of the distance to the next, from 0 to 1.
    part: f32,
    /// The refined log odds.
    odds: f32,
}

impl Refinement {
    /// Creates maps for `contexts` contexts, which start as the identity.
    fn new(contexts: usize) -> Self {
        let identity = std::array::from_fn(|i| i as f32 / FINENESS - REACH);
        Refinement { maps: vec![identity; contexts], tables: Logistic::tables() }
    }

    /// The refined log odds of an estimate in a context.
    #[inline]
    fn refine(&self, context: usize, odds: f32) -> (Refined, f32) {
        // In a sum with 2^23 the lowest bit has the value 1, and subtracting one half makes rounding go down.
        // A place on a point may count as the end of the part below it, which gives the same odds.
        const UNIT: f32 = (1 << 23) as f32;
        let place = (odds.clamp(-REACH, REACH) + REACH) * FINENESS;
        let rounded = (place - 0.5).max(0.0) + UNIT;
        let point = (rounded.to_bits() as usize % POINTS.next_power_of_two()).min(POINTS - 2);
        let part = place - point as i32 as f32;
        let map = &self.maps[context];
        let odds = map[point] * (1.0 - part) + map[point + 1] * part;
        (Refined { context, point, part, odds }, odds)
    }

    /// Moves both points towards the bit that was coded, by their shares in the refined odds.
    #[inline]
    fn learn(&mut self, refined: Refined, bit: bool) {
        let target = if bit { 65536 } else { 0 };
        let pull = REFINEMENT_RATE * ((target - self.tables.squash(refined.odds) as i32) as f32 / 65536.0);
        let map = &mut self.maps[refined.context];
        map[refined.point] += pull * (1.0 - refined.part);
        map[refined.point + 1] += pull * refined.part;
    }
}

/// Codes bits by mixing `O` external opinions, those of counters in `V` views, and a constant one, in `S`
/// mixers. `N` is the number of opinions, rounded up to a multiple of four.
#[derive(Clone)]
pub struct LayeredBits<const O: usize, const V: usize, const N: usize, const S: usize> {
    counters: [Vec<Counter>; V],
    mixer: LayeredMixer<N, S>,
    tables: &'static Logistic,
}

/// The contexts of a bit, or the number of contexts.
pub struct LayeredContext<const V: usize, const S: usize> {
    /// The context of each view's counter.
    pub views: [usize; V],
    /// The contexts of the mixer.
    pub mixer: MixContexts<S>,
}

impl<const O: usize, const V: usize, const N: usize, const S: usize> LayeredBits<O, V, N, S> {
    /// Creates as many contexts as `sizes` says. At first, all external opinions have the same weight, and
    /// all others have weight 0.
    pub fn new(sizes: &LayeredContext<V, S>) -> Self {
        const { assert!(N.is_multiple_of(LANES) && O + V < N) };
        const RATES: MixRates = MixRates { first: 0.012, last: 0.001 };
        let mut weights = [0.0; N];
        weights[..O].fill(1.0 / O as f32);
        LayeredBits {
            counters: sizes.views.map(|size| vec![Counter::default(); size]),
            mixer: LayeredMixer::new(sizes.mixer, weights, RATES),
            tables: Logistic::tables(),
        }
    }

    /// Copies the learned state of a mixer's first `sets` weight sets to the sets that follow, `sets` at a
    /// time.
    pub fn spread_sets(&mut self, mixer: usize, sets: usize) {
        self.mixer.spread_sets(mixer, sets);
    }

    /// Codes a bit; `others` are the external opinions, as log odds.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        context: &LayeredContext<V, S>,
        others: &[f32; O],
        bit: bool,
    ) -> bool {
        let mut opinions = [0.0; N];
        opinions[..O].copy_from_slice(others);
        for view in 0..V {
            opinions[O + view] = self.tables.opinion(self.counters[view][context.views[view]]);
        }
        opinions[O + V] = CONSTANT;
        let bit = self.mixer.code(coder, &context.mixer, &opinions, bit);
        for view in 0..V {
            self.counters[view][context.views[view]].learn(bit);
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

    #[test]
    fn an_estimate_that_is_too_sure_is_taken_back() {
        let mut maps = Refinement::new(2);
        for i in 0..4000 {
            let (refined, _) = maps.refine(1, 3.2);
            maps.learn(refined, i % 4 > 0);
        }
        // Log odds of 3 to 1.
        assert!((maps.refine(1, 3.2).1 - 1.1).abs() < 0.2, "{}", maps.refine(1, 3.2).1);
        assert!((maps.refine(0, 3.2).1 - 3.2).abs() < 1e-5);
        assert!(maps.refine(0, f32::NAN).1.is_nan() && maps.refine(0, 1e9).1 == REACH);
    }

    const SIZES: LayeredContext<2, 2> =
        LayeredContext { views: [4, 4], mixer: MixContexts { sets: [2, 2], last: 1, refinements: [2, 1] } };

    /// Bits that are mostly determined by their contexts, with an external opinion that is mostly wrong.
    fn bits() -> impl Iterator<Item = (bool, LayeredContext<2, 2>, [f32; 1])> {
        (0..4000usize).map(|i| {
            let bit = (i % 4 == 1) != (i % 61 == 0);
            let context = LayeredContext {
                views: [i % 4, i / 7 % 4],
                mixer: MixContexts { sets: [i % 2, 0], last: 0, refinements: [i % 2, 0] },
            };
            (bit, context, [if bit { -2.0 } else { 2.0 }])
        })
    }

    #[test]
    fn bits_come_back_and_wrong_opinions_are_turned_round() {
        let mut encoder = ArithmeticEncoder::default();
        let mut mixer = LayeredBits::<1, 2, 4, 2>::new(&SIZES);
        bits().for_each(|(bit, context, other)| {
            mixer.code(&mut encoder, &context, &other, bit);
        });
        let bytes = encoder.finish();
        assert!(bytes.len() < 100, "{} bytes", bytes.len());
        let mut decoder = ArithmeticDecoder::new(&bytes);
        let mut mixer = LayeredBits::<1, 2, 4, 2>::new(&SIZES);
        for (bit, context, other) in bits() {
            assert_eq!(mixer.code(&mut decoder, &context, &other, false), bit);
        }
    }
}
