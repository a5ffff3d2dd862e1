//! Logistic mixing in two layers: several mixers, each with the weights of a context of its own, look at
//! the same opinions; another weighs what they say (as in Mahoney's PAQ8), and its result is corrected by
//! what became of such results before.

use super::logistic::{CONSTANT, LANES};
use super::{AdaptiveMap, BitCoder, Counter, Logistic};

/// The rate at which weights come to learn, and how many times as high it starts.
const RATE: f32 = 0.012;
const EARLY_RATE: f32 = 4.0;
/// How many bits a set of weights takes to halve that.
const EARLY_BITS: f32 = 200.0;
/// The rate of the last mixer.
const LAST_RATE: f32 = 0.001;
/// Log odds of a mixer are cut to this.
const MOST_ODDS: f32 = 12.0;
/// The share of each of the two corrections in the result.
const MAP_SHARE: f32 = 0.25;

/// Codes bits by mixing the opinions of `O` models from elsewhere, of counters in `V` views, and one that
/// is always the same, in `S` mixers. `N` is the number of opinions, rounded up to a multiple of four.
#[derive(Clone)]
pub struct LayeredBits<const O: usize, const V: usize, const N: usize, const S: usize> {
    counters: [Vec<Counter>; V],
    mixers: [Vec<Weights<N>>; S],
    last: Vec<[f32; S]>,
    maps: [AdaptiveMap; 2],
    /// The rate of learning after so many bits.
    rates: Vec<f32>,
    tables: &'static Logistic,
}

/// A set of weights.
#[derive(Clone)]
struct Weights<const N: usize> {
    weights: [f32; N],
    /// How many bits it has learned from.
    seen: u16,
}

/// The contexts of a bit, or how many there are.
pub struct LayeredContext<const V: usize, const S: usize> {
    /// Of the counters of each view.
    pub views: [usize; V],
    /// Of each mixer's weights.
    pub sets: [usize; S],
    /// Of the last mixer's weights.
    pub last: usize,
    /// Of the two corrections.
    pub maps: [usize; 2],
}

impl<const O: usize, const V: usize, const N: usize, const S: usize> LayeredBits<O, V, N, S> {
    /// For as many contexts as told. At first the opinions from elsewhere count alike and nothing else does.
    pub fn new(sizes: &LayeredContext<V, S>) -> Self {
        const { assert!(N.is_multiple_of(LANES) && O + V < N) };
        let mut weights = [0.0; N];
        weights[..O].fill(1.0 / O as f32);
        let early = |seen: u16| EARLY_RATE * EARLY_BITS / (EARLY_BITS + f32::from(seen));
        let settled = (EARLY_BITS * (EARLY_RATE - 1.0)) as u16;
        LayeredBits {
            counters: sizes.views.map(|size| vec![Counter::default(); size]),
            mixers: sizes.sets.map(|size| vec![Weights { weights, seen: 0 }; size]),
            last: vec![[1.0 / S as f32; S]; sizes.last],
            maps: sizes.maps.map(AdaptiveMap::new),
            rates: (0..=settled).map(|seen| RATE * early(seen)).collect(),
            tables: Logistic::tables(),
        }
    }

    /// Gives the sets of a mixer after the first `sets`, as many at a time, what these have learned.
    pub fn spread_sets(&mut self, mixer: usize, sets: usize) {
        let mixer = &mut self.mixers[mixer];
        for set in sets..mixer.len() {
            mixer[set] = mixer[set % sets].clone();
        }
    }

    /// Codes a bit; `others` are the opinions from elsewhere, as log odds.
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
        let mut mixed = [0.0f32; S];
        for mixer in 0..S {
            let sum = self.mixers[mixer][context.sets[mixer]].mix(&opinions);
            mixed[mixer] = sum.clamp(-MOST_ODDS, MOST_ODDS);
        }
        let last = &mut self.last[context.last];
        let odds = (0..S).fold(0.0, |sum, mixer| sum + last[mixer] * mixed[mixer]);
        let p = self.tables.squash(odds) as f32 / 65536.0;
        let [first, second] = &mut self.maps;
        let place = AdaptiveMap::place(odds);
        let corrected =
            first.probability(context.maps[0], place) + second.probability(context.maps[1], place);
        let corrected = (1.0 - 2.0 * MAP_SHARE) * p + MAP_SHARE * corrected;
        let bit = coder.code(bit, ((corrected * 65536.0) as u32).clamp(1, 65535));

        let target = f32::from(u8::from(bit));
        first.learn(context.maps[0], place, target);
        second.learn(context.maps[1], place, target);
        for mixer in 0..S {
            last[mixer] += LAST_RATE * (target - p) * mixed[mixer];
            let error = target - self.tables.squash(mixed[mixer]) as f32 / 65536.0;
            self.mixers[mixer][context.sets[mixer]].learn(&opinions, error, &self.rates);
        }
        for view in 0..V {
            self.counters[view][context.views[view]].learn(bit);
        }
        bit
    }
}

impl<const N: usize> Weights<N> {
    #[inline]
    fn mix(&self, opinions: &[f32; N]) -> f32 {
        let mut sums = [0.0f32; LANES];
        for block in (0..N).step_by(LANES) {
            for lane in 0..LANES {
                sums[lane] += self.weights[block + lane] * opinions[block + lane];
            }
        }
        (sums[0] + sums[1]) + (sums[2] + sums[3])
    }

    #[inline]
    fn learn(&mut self, opinions: &[f32; N], error: f32, rates: &[f32]) {
        let pull = error * rates[usize::from(self.seen)];
        self.seen += u16::from(usize::from(self.seen) + 1 < rates.len());
        for (weight, opinion) in self.weights.iter_mut().zip(opinions) {
            *weight += pull * opinion;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ArithmeticDecoder, ArithmeticEncoder};
    use super::*;

    const SIZES: LayeredContext<2, 2> = LayeredContext { views: [4, 4], sets: [2, 2], last: 1, maps: [2, 1] };

    /// Bit `i`, which its contexts tell mostly, with an opinion that is mostly wrong.
    fn bits() -> impl Iterator<Item = (bool, LayeredContext<2, 2>, [f32; 1])> {
        (0..4000usize).map(|i| {
            let bit = (i % 4 == 1) != (i % 61 == 0);
            let context =
                LayeredContext { views: [i % 4, i / 7 % 4], sets: [i % 2, 0], last: 0, maps: [i % 2, 0] };
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
