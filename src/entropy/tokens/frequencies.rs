//! How often each token of a context comes, as shares of 4096.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::error::{Error, Result};

/// The sum of the frequencies of a context, as a power of two.
pub const SCALE_BITS: u32 = 12;
/// The sum of the frequencies of a context.
pub const SCALE: u32 = 1 << SCALE_BITS;
/// Tokens that there are.
pub const TOKENS: usize = 256;

/// The frequency of each token: 0 to 4095, and 4096 together. None is certain, so that no stream gives
/// tokens without end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frequencies(pub [u16; TOKENS]);

impl Frequencies {
    /// The nearest to these counts, of which at least one is not 0.
    pub fn of(counts: &[u32; TOKENS]) -> Self {
        let total: u64 = counts.iter().map(|&count| u64::from(count)).sum::<u64>().max(1);
        let share = |count: u32| (u64::from(count) * u64::from(SCALE) / total) as u32;
        let mut frequencies: [u32; TOKENS] =
            std::array::from_fn(|token| if counts[token] > 0 { share(counts[token]).max(1) } else { 0 });
        let used = frequencies.iter().filter(|&&frequency| frequency > 0).count();
        if used < 2 {
            // Any other token, so that the one is not certain.
            let other = usize::from(frequencies[0] > 0);
            frequencies[other] = 1;
        }
        // What rounding leaves goes to, or comes from, the most frequent, where it matters least.
        let mut sum: u32 = frequencies.iter().sum();
        while sum != SCALE {
            let largest = (0..TOKENS).max_by_key(|&token| frequencies[token]).unwrap_or(0);
            let most = frequencies[largest];
            let changed = if sum < SCALE { most + (SCALE - sum) } else { most - (sum - SCALE).min(most / 2) };
            sum = sum - most + changed;
            frequencies[largest] = changed;
        }
        Frequencies(frequencies.map(|frequency| frequency as u16))
    }

    /// The bits that these counts take, but infinity if a token comes that has no frequency.
    pub fn cost(&self, counts: &[u32; TOKENS]) -> f64 {
        let taken = counts.iter().zip(&self.0).filter(|(count, _)| **count > 0);
        taken
            .map(|(&count, &frequency)| {
                f64::from(count) * (f64::from(SCALE_BITS) - f64::from(frequency).log2())
            })
            .sum()
    }

    /// The bits, roughly, that it takes to write the frequencies.
    pub fn table_cost(&self) -> f64 {
        const HEAD: f64 = 10.0;
        const EACH: f64 = 5.0;
        HEAD + EACH * self.0.iter().filter(|&&frequency| frequency > 0).count() as f64
    }
}

/// Codes the tables of a section.
pub struct FrequencyModel {
    is_new: AdaptiveBit,
    /// For each octave of the frequency before.
    frequencies: Vec<IntegerModel>,
}

impl Default for FrequencyModel {
    fn default() -> Self {
        let octaves = 2 + SCALE_BITS as usize;
        FrequencyModel { is_new: AdaptiveBit::default(), frequencies: vec![IntegerModel::default(); octaves] }
    }
}

impl FrequencyModel {
    /// Codes the frequencies of a context if there are new ones.
    ///
    /// # Errors
    /// If they do not make 4096.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, new: &mut Option<Frequencies>) -> Result<()> {
        if !self.is_new.code(coder, new.is_some()) {
            return Ok(());
        }
        let Frequencies(frequencies) = new.get_or_insert(Frequencies([0; TOKENS]));
        let last = frequencies.iter().rposition(|&frequency| frequency > 0).unwrap_or(0);
        let last = coder.code_plain(last as u64, TOKENS.ilog2()) as usize;
        let (mut left, mut before) = (u64::from(SCALE), 0u16);
        for frequency in &mut frequencies[..last] {
            let octave = before.checked_ilog2().map_or(0, |octave| 1 + octave as usize);
            let coded = self.frequencies[octave].code(coder, u64::from(*frequency));
            left = left.checked_sub(coded).ok_or_else(|| Error::corrupt("token frequencies: too many"))?;
            *frequency = coded as u16;
            before = *frequency;
        }
        if !(1..u64::from(SCALE)).contains(&left) {
            return Err(Error::corrupt("token frequencies: no token is certain"));
        }
        frequencies[last] = left as u16;
        Ok(())
    }
}
