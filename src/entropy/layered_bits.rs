//! Bits coded from the counters of several views and from external opinions, mixed in two layers.
//! FORMAT.md 6.6.

use super::logistic::CONSTANT;
use super::{BitCoder, Counter, LayeredMixer, Logistic, MixContexts, MixRates};
use crate::ground::lanes::LANES;

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
