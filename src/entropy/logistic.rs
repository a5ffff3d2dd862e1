//! Logistic mixing: the opinions of several models on the next bit, weighed by how much each has
//! helped so far (Mahoney's PAQ). Opinions are log odds, ln(p / (1 - p)).

use std::sync::LazyLock;

/// Log odds beyond this are cut.
const LARGEST: f32 = 12.0;
const SQUASH_STEPS: usize = 4096;
const STRETCH_STEPS: usize = 4096;
const LN_STEPS: usize = 1024;

/// Probabilities of log odds from -LARGEST to LARGEST, in 1/65536.
static SQUASH: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let at = |i: usize| (i as f64 / SQUASH_STEPS as f64 * 2.0 - 1.0) * f64::from(LARGEST);
    (0..=SQUASH_STEPS + 1).map(|i| (65536.0 / (1.0 + libm::exp(-at(i)))) as f32).collect()
});

/// Log odds of the middles of equal steps of probability.
static STRETCH: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let at = |i: usize| (i as f64 + 0.5) / STRETCH_STEPS as f64;
    (0..STRETCH_STEPS).map(|i| libm::log(at(i) / (1.0 - at(i))) as f32).collect()
});

/// ln of 1 to 2.
static LN: LazyLock<Vec<f64>> =
    LazyLock::new(|| (0..=LN_STEPS).map(|i| libm::log(1.0 + i as f64 / LN_STEPS as f64)).collect());

/// The probability, in 1/65536 (1 to 65535), of log odds.
#[inline]
pub fn squash(odds: f32) -> u32 {
    let place = (odds.clamp(-LARGEST, LARGEST) + LARGEST) * (SQUASH_STEPS as f32 / (2.0 * LARGEST));
    let index = (place as usize).min(SQUASH_STEPS);
    let (a, b) = (SQUASH[index], SQUASH[index + 1]);
    ((a + (b - a) * (place - index as f32)) as u32).clamp(1, 65535)
}

/// The log odds of a probability in 1/65536.
#[inline]
pub fn stretch(p: u32) -> f32 {
    STRETCH[(p >> 4) as usize & (STRETCH_STEPS - 1)]
}

/// ln of a positive, normal number; the same bits on every platform, good to about 1e-7.
#[inline]
pub fn ln(value: f64) -> f64 {
    let bits = value.to_bits();
    let exponent = (bits >> 52) as i64 - 1023;
    let mantissa = (bits & ((1 << 52) - 1)) as f64 * (LN_STEPS as f64 / (1u64 << 52) as f64);
    let index = mantissa as usize;
    let (a, b) = (LN[index], LN[index + 1]);
    exponent as f64 * std::f64::consts::LN_2 + a + (b - a) * (mantissa - index as f64)
}

/// A probability with the number of bits that it rests on: 22 bits of the one, 10 of the other.
#[derive(Clone, Copy, Debug)]
pub struct Counter(u32);

const COUNT_BITS: u32 = 10;
const COUNT_MASK: u32 = (1 << COUNT_BITS) - 1;
/// Counters forget at a rate of one in this many bits.
const COUNT_LIMIT: u32 = 255;

/// For each count: the rate (in 1/65536) at which the next bit moves the probability, and how far
/// the probability can be believed.
static RATES: LazyLock<Vec<(u32, f32)>> = LazyLock::new(|| {
    let rate = |n: f64| ((65536.0 / (n + 1.5)) as u32, (n / (n + 1.5)) as f32);
    (0..=COUNT_LIMIT).map(|n| rate(f64::from(n))).collect()
});

impl Default for Counter {
    fn default() -> Self {
        Counter(1 << 31)
    }
}

impl Counter {
    /// Log odds of a 1, less the less is known.
    #[inline]
    pub fn opinion(self) -> f32 {
        STRETCH[(self.0 >> 20) as usize] * RATES[(self.0 & COUNT_MASK) as usize].1
    }

    /// Learns a bit.
    #[inline]
    pub fn learn(&mut self, bit: bool) {
        let count = self.0 & COUNT_MASK;
        let p = i64::from(self.0 >> COUNT_BITS);
        let target = if bit { (1 << 22) - 1 } else { 0 };
        let moved = p + (((target - p) * i64::from(RATES[count as usize].0)) >> 16);
        self.0 = (moved as u32) << COUNT_BITS | (count + 1).min(COUNT_LIMIT);
    }
}

/// Weighs `N` opinions, with a set of weights for each context.
pub struct Mixer<const N: usize> {
    weights: Vec<[f32; N]>,
    /// How many bits each set has learned from, up to where its rate stops falling.
    seen: Vec<f32>,
    rate: f32,
}

/// The rate of learning starts this many times as high as it ends.
const EARLY_RATE: f32 = 4.0;
/// How many bits a set of weights takes to halve that.
const EARLY_BITS: f32 = 200.0;

impl<const N: usize> Mixer<N> {
    /// A mixer of `contexts` sets of weights that start at `start` and learn at `rate`.
    pub fn new(contexts: usize, start: [f32; N], rate: f32) -> Self {
        Mixer { weights: vec![start; contexts], seen: vec![0.0; contexts], rate }
    }

    /// The log odds that the opinions make together.
    #[inline]
    pub fn mix(&self, context: usize, opinions: &[f32; N]) -> f32 {
        let weights = &self.weights[context];
        let mut sum = [0.0f32; 4];
        for i in 0..N {
            sum[i % 4] += weights[i] * opinions[i];
        }
        (sum[0] + sum[1]) + (sum[2] + sum[3])
    }

    /// Learns a bit for which `p` (in 1/65536) was the probability of a 1.
    #[inline]
    pub fn learn(&mut self, context: usize, opinions: &[f32; N], p: u32, bit: bool) {
        let seen = &mut self.seen[context];
        let early = EARLY_RATE * EARLY_BITS / (EARLY_BITS + *seen);
        *seen += 1.0;
        let target = if bit { 65536.0 } else { 0.0 };
        let pull = (target - p as f32) * (1.0 / 65536.0) * self.rate * early.max(1.0);
        for (weight, opinion) in self.weights[context].iter_mut().zip(opinions) {
            *weight += pull * opinion;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squash_undoes_stretch() {
        for p in (64..65536 - 64).step_by(61) {
            assert!(squash(stretch(p)).abs_diff(p) <= 16, "{p} {}", squash(stretch(p)));
        }
    }

    #[test]
    fn ln_is_right() {
        for value in [1e-9, 0.3, 1.0, 1.999, 2.0, 12345.678] {
            assert!((ln(value) - f64::ln(value)).abs() < 1e-6);
        }
    }

    #[test]
    fn counters_go_where_the_bits_go() {
        let mut counter = Counter::default();
        assert_eq!(counter.opinion(), 0.0);
        (0..1000).for_each(|_| counter.learn(true));
        assert!(counter.opinion() > 5.0);
        (0..3000).for_each(|_| counter.learn(false));
        assert!(counter.opinion() < -5.0);
    }
}
