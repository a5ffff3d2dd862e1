//! Random numbers that are the same everywhere: xoshiro256++ (Blackman and Vigna), seeded by splitmix64.
//! Implemented here, on top of `libm`, so that a seed gives the same bytes on every platform.

use libm::{cos, log, sqrt};

/// Xoshiro256++, keyed by the purpose of the numbers.
#[derive(Clone, Debug)]
pub(crate) struct Rng {
    state: [u64; 4],
}

impl Rng {
    /// The generator for one purpose: equal keys give equal numbers, any other key gives unrelated ones.
    pub(crate) fn keyed(seed: u64, key: &[u64]) -> Self {
        let mut mixed = hash(seed, key);
        let mut next = || {
            mixed = mixed.wrapping_add(GOLDEN);
            mix(mixed)
        };
        Rng { state: [next(), next(), next(), next()] }
    }

    fn next(&mut self) -> u64 {
        let s = &mut self.state;
        let result = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let shifted = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= shifted;
        s[3] = s[3].rotate_left(45);
        result
    }

    /// Uniform in 0..end, which must not be 0.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        ((self.unit() * end as f64) as usize).min(end - 1)
    }

    /// Uniform in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        unit(self.next())
    }

    /// Uniform between two values.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// True with the given probability.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Gaussian with mean 0 and sigma 1 (Box and Muller; the second value is discarded).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = sqrt(-2.0 * log(1.0 - self.unit()));
        radius * cos(core::f64::consts::TAU * self.unit())
    }

    /// Exponential with the given mean.
    pub(crate) fn exponential(&mut self, mean: f64) -> f64 {
        -mean * log(1.0 - self.unit())
    }
}

/// The odd number nearest 2^64 over the golden ratio: the increment of splitmix64.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// A number that depends on every bit of the seed and of the key.
pub(crate) fn hash(seed: u64, key: &[u64]) -> u64 {
    key.iter()
        .fold(mix(seed.wrapping_add(GOLDEN)), |state, &part| mix(state ^ mix(part.wrapping_add(GOLDEN))))
}

/// Turns 64 random bits into a number in 0..1.
pub(crate) fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// The output function of splitmix64.
fn mix(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_answer_of_xoshiro256_plus_plus() {
        // The first outputs for the state 1, 2, 3, 4, as in the authors' and others' test vectors.
        let mut rng = Rng { state: [1, 2, 3, 4] };
        assert_eq!([rng.next(), rng.next(), rng.next()], [41_943_041, 58_720_359, 3_588_806_011_781_223]);
    }

    #[test]
    fn normal_has_mean_0_and_sigma_1() {
        let mut rng = Rng::keyed(1, &[2, 3]);
        let values: Vec<f64> = (0..40_000).map(|_| rng.normal()).collect();
        let mean = values.iter().sum::<f64>() / 40_000.0;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / 40_000.0;
        assert!(mean.abs() < 0.02, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.03, "variance {variance}");
    }

    #[test]
    fn every_part_of_the_key_counts() {
        let first = |seed, key: &[u64]| Rng::keyed(seed, key).next();
        assert_ne!(first(1, &[1, 2]), first(2, &[1, 2]));
        assert_ne!(first(1, &[1, 2]), first(1, &[2, 1]));
        assert_ne!(first(1, &[1, 0]), first(1, &[1]));
    }
}
