//! Logistic mixing: the opinions of several models about the next bit, weighted by how much each has helped
//! so far, in each context (Mahoney's PAQ). Opinions are log odds, ln(p / (1 - p)). FORMAT.md 6.1 to 6.3; 6.5
//! for the weights.

use std::sync::LazyLock;

use super::BitCoder;
use crate::ground::lanes::{LANES, sum_of_products};

/// Table entries per unit of log odds: fine enough that a finer table would save less than a thousandth of a
/// bit.
const SQUASH_FINENESS: f32 = 256.0;
const SQUASH_STEPS: usize = 8192;
/// The log odds of the table's last entry.
const MOST_ODDS: f32 = 16.0 - 1.0 / SQUASH_FINENESS;
const STRETCH_STEPS: usize = 4096;
const BEND_STEPS: usize = 1024;

/// The functions of logistic mixing, as tables.
#[derive(Clone)]
pub struct Logistic {
    /// The probability, in 1/65536, for log odds from -16 to 16.
    squash: [u16; SQUASH_STEPS],
    /// Log odds at the centres of equal steps of probability.
    stretch: [f32; STRETCH_STEPS],
    /// The height of the logarithm above its chord between powers of two, in equal steps from one power to
    /// the next. A float's bits, exponent and mantissa as one integer, lie on that chord.
    bend: [f32; BEND_STEPS],
    /// For each count of a [`Counter`], how much its probability is trusted.
    belief: [f32; COUNT_LIMIT as usize + 1],
}

static TABLES: LazyLock<Box<Logistic>> = LazyLock::new(|| Box::new(Logistic::new()));

impl Logistic {
    /// The tables, computed once. Models keep the reference, because looking it up takes time.
    pub fn tables() -> &'static Logistic {
        &TABLES
    }

    fn new() -> Self {
        let squash = |i: usize| {
            let odds = (i as f64 - SQUASH_STEPS as f64 / 2.0) / f64::from(SQUASH_FINENESS);
            (65536.0 / (1.0 + libm::exp(-odds))).clamp(1.0, 65535.0) as u16
        };
        let stretch = |i: usize| {
            let p = (i as f64 + 0.5) / STRETCH_STEPS as f64;
            libm::log(p / (1.0 - p)) as f32
        };
        let bend = |i: usize| {
            let part = (i as f64 + 0.5) / BEND_STEPS as f64;
            (libm::log(1.0 + part) - part * std::f64::consts::LN_2) as f32
        };
        Logistic {
            squash: std::array::from_fn(squash),
            stretch: std::array::from_fn(stretch),
            bend: std::array::from_fn(bend),
            belief: std::array::from_fn(|n| (n as f64 / (n as f64 + 1.5)) as f32),
        }
    }

    /// The probability, in 1/65536 (1 to 65535), of log odds.
    #[inline(always)]
    pub fn squash(&self, odds: f32) -> u32 {
        // For a sum near 2^23 the lowest bit of a float is 1, so the addition rounds.
        const MIDDLE: f32 = (1 << 23) as f32 + (SQUASH_STEPS / 2) as f32;
        let place = odds.clamp(-MOST_ODDS, MOST_ODDS) * SQUASH_FINENESS + MIDDLE;
        u32::from(self.squash[place.to_bits() as usize % SQUASH_STEPS])
    }

    /// The log odds of a 1, to within a thousandth, given the ratio of the probabilities of 1 and 0 as two
    /// positive numbers.
    #[inline(always)]
    pub fn odds(&self, one: f32, zero: f32) -> f32 {
        const MANTISSA_BITS: u32 = f32::MANTISSA_DIGITS - 1;
        const UNIT: f32 = std::f32::consts::LN_2 / (1u32 << MANTISSA_BITS) as f32;
        let [one, zero] = [one, zero].map(f32::to_bits);
        let bend =
            |bits: u32| self.bend[(bits >> (MANTISSA_BITS - BEND_STEPS.ilog2())) as usize % BEND_STEPS];
        (one as i32).wrapping_sub(zero as i32) as f32 * UNIT + (bend(one) - bend(zero))
    }

    /// The log odds of a 1 by this counter, closer to 0 the fewer bits it has seen.
    #[inline]
    pub fn opinion(&self, counter: Counter) -> f32 {
        let step = (counter.0 >> (32 - STRETCH_STEPS.ilog2())) as usize;
        self.believed(step, (counter.0 & COUNT_MASK & COUNT_LIMIT) as usize)
    }

    /// The log odds of a probability, in 1/4096, closer to 0 the fewer bits (0 to 255) it is based on.
    #[inline]
    pub(super) fn believed(&self, step: usize, count: usize) -> f32 {
        self.stretch[step] * self.belief[count]
    }
}

/// A probability of 22 bits, followed by the number of bits that it is based on, of 10 bits.
#[derive(Clone, Copy, Debug)]
pub struct Counter(u32);

const COUNT_BITS: u32 = 10;
const COUNT_MASK: u32 = (1 << COUNT_BITS) - 1;
/// The lowest adaptation rate of counters is one in this number.
const COUNT_LIMIT: u32 = 255;

/// For each count: the rate, in 1/8192, at which the next bit changes the probability.
static RATES: [i32; COUNT_LIMIT as usize + 1] = {
    let mut rates = [0; COUNT_LIMIT as usize + 1];
    let mut n = 0;
    while n < rates.len() {
        // 1 / (n + 1.5)
        rates[n] = 16_384 / (2 * n as i32 + 3);
        n += 1;
    }
    rates
};

impl Default for Counter {
    fn default() -> Self {
        Counter(1 << 31)
    }
}

impl Counter {
    /// The counter as one number.
    #[inline]
    pub fn bits(self) -> u32 {
        self.0
    }

    /// Whether it has seen no bit.
    #[inline]
    pub fn is_new(self) -> bool {
        self.0 & COUNT_MASK == 0
    }

    /// The counter with the probability of this one, as if based on at most `most` bits, which is at least 4.
    /// The probability is kept between 1/1024 and 1023/1024: a low count means a high rate, whose rounding
    /// would take a probability of nearly 0 below 0.
    #[inline]
    pub fn based_on(self, most: u32) -> Self {
        const SUREST: u32 = u32::MAX / 1024 + 1;
        Counter((self.0 & !COUNT_MASK).clamp(SUREST, SUREST.wrapping_neg()) | (self.0 & COUNT_MASK).min(most))
    }

    /// Learns from a bit.
    #[inline]
    pub fn learn(&mut self, bit: bool) {
        let count = self.0 & COUNT_MASK & COUNT_LIMIT;
        let target = if bit { (1 << 22) - 1 } else { 0 };
        // An eighth of the distance to the target times 8192ths is in units of 2^-32, as is the counter
        // itself. The product fits 31 bits: early rates are high, but then the probability is still near one
        // half.
        let moved = ((target - (self.0 >> COUNT_BITS) as i32) >> 3) * RATES[count as usize];
        self.0 = self.0.wrapping_add_signed(moved & !(COUNT_MASK as i32)) + u32::from(count < COUNT_LIMIT);
    }
}

/// Codes bits by mixing opinions: those of counters in `V` views, an external one, and a constant one. Each
/// mixing context has its own weight set. `N` is the number of opinions, rounded up to a multiple of four.
#[derive(Clone)]
pub struct MixedBits<const V: usize, const N: usize> {
    /// The counters of all views, one view after the other.
    counters: Vec<Counter>,
    /// Index of each view's first counter.
    views: [usize; V],
    weights: WeightSets<N>,
    tables: &'static Logistic,
}

/// The constant opinion.
pub(super) const CONSTANT: f32 = 0.25;

impl<const V: usize, const N: usize> MixedBits<V, N> {
    /// Creates `places` counters for each view, and `sets` weight sets. Weights start at `view_weight` for
    /// each view and at `other_weight` for the external opinion; the learning rate ends at `rate`.
    pub fn new(places: [usize; V], sets: usize, view_weight: f32, other_weight: f32, rate: f32) -> Self {
        const { assert!(V + 2 <= N) };
        let mut start = [0.0; N];
        start[..V].fill(view_weight);
        start[V] = other_weight;
        let mut end = 0;
        let views = places.map(|places| {
            end += places;
            end - places
        });
        MixedBits {
            counters: vec![Counter::default(); end],
            views,
            weights: WeightSets::new(sets, start, rate),
            tables: Logistic::tables(),
        }
    }

    /// Copies the learned state of the first `sets` weight sets to the sets that follow, `sets` at a time.
    pub fn spread_sets(&mut self, sets: usize) {
        self.weights.spread(sets);
    }

    /// Codes a bit as [`code_with`](Self::code_with) does, but from the first two views alone if the log odds
    /// of both are at least `sure` in magnitude: the gain from the others would not be worth the time.
    #[inline]
    pub fn code_or_sure<C: BitCoder, const X: usize>(
        &mut self,
        coder: &mut C,
        sure: f32,
        set: usize,
        places: &[usize; V],
        extra: [&mut Counter; X],
        bit: bool,
    ) -> bool {
        let deciding = [self.views[0] + places[0], self.views[1] + places[1]];
        let [first, second] = deciding.map(|place| self.tables.opinion(self.counters[place]));
        if first.min(second) < sure && first.max(second) > -sure {
            return self.code_with(coder, set, places, 0.0, extra, bit);
        }
        let bit = coder.code(bit, self.tables.squash(0.5 * (first + second)));
        deciding.into_iter().for_each(|place| self.counters[place].learn(bit));
        bit
    }

    /// Codes a bit. `places` selects the counter of each view; `other` is the external opinion, as log odds.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        set: usize,
        places: &[usize; V],
        other: f32,
        bit: bool,
    ) -> bool {
        self.code_with(coder, set, places, other, [], bit)
    }

    /// Codes a bit as [`code`](Self::code) does, with `X` more counters, whose weights start at 0.
    #[inline]
    pub fn code_with<C: BitCoder, const X: usize>(
        &mut self,
        coder: &mut C,
        set: usize,
        places: &[usize; V],
        other: f32,
        extra: [&mut Counter; X],
        bit: bool,
    ) -> bool {
        const { assert!(V + 2 + X <= N) };
        let counters = self.counters.as_mut_slice();
        let mut opinions = [0.0; N];
        opinions[V] = other;
        opinions[V + 1] = CONSTANT;
        for (opinion, counter) in opinions[V + 2..].iter_mut().zip(&extra) {
            *opinion = self.tables.opinion(**counter);
        }
        for view in 0..V {
            opinions[view] = self.tables.opinion(counters[self.views[view] + places[view]]);
        }
        let p = self.tables.squash(self.weights.mix(set, &opinions));
        let bit = coder.code(bit, p);
        self.weights.learn(set, &opinions, bit, p);
        for view in 0..V {
            counters[self.views[view] + places[view]].learn(bit);
        }
        extra.into_iter().for_each(|counter| counter.learn(bit));
        bit
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squash_undoes_the_opinion_of_a_counter() {
        let tables = Logistic::tables();
        for p in (1u32 << 14..u32::MAX - (1 << 14)).step_by(1 << 19) {
            let sure = Counter(p & !COUNT_MASK | COUNT_LIMIT);
            assert!(tables.squash(tables.opinion(sure)).abs_diff(p >> 16) <= 256);
        }
    }

    #[test]
    fn odds_are_those_of_the_ratio() {
        for one in [1e-9f32, 0.3, 1.0, 1.5, 2.0, 123_456_789.0] {
            for zero in [1e-7f32, 0.7, 2.0, 1e4] {
                let odds = Logistic::tables().odds(one, zero);
                assert!((odds - (one / zero).ln()).abs() < 1e-3, "{one} to {zero}");
            }
        }
    }

    #[test]
    fn counters_go_where_the_bits_go() {
        let tables = Logistic::tables();
        let mut counter = Counter::default();
        assert_eq!(tables.opinion(counter), 0.0);
        (0..1000).for_each(|_| counter.learn(true));
        assert!(tables.opinion(counter) > 5.0);
        (0..3000).for_each(|_| counter.learn(false));
        assert!(tables.opinion(counter) < -5.0);
    }

    #[test]
    fn what_is_based_on_few_bits_stays_a_probability() {
        for bit in [false, true] {
            let mut sure = Counter::default();
            (0..3000).for_each(|_| sure.learn(bit));
            let mut counter = sure.based_on(4);
            for _ in 0..3000 {
                let before = counter.0 >> COUNT_BITS;
                counter.learn(bit);
                let after = counter.0 >> COUNT_BITS;
                assert!(if bit { after >= before } else { after <= before });
            }
        }
    }
}
