//! How often each token of a context occurs, as shares of 4096. FORMAT.md 5.5, "Tables".

use std::sync::LazyLock;

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};

/// The sum of the frequencies of a context, as a power of two.
pub const SCALE_BITS: u32 = 12;
/// The sum of the frequencies of a context.
pub const SCALE: u32 = 1 << SCALE_BITS;
/// Number of tokens.
pub const TOKENS: usize = 256;

/// The token that replaces all those without a frequency; the actual token is coded separately.
pub const ESCAPE: u8 = u8::MAX;
/// Binary logarithms of the frequencies, except of 0.
static LOG2: LazyLock<Vec<f64>> =
    LazyLock::new(|| (0..=SCALE).map(|frequency| libm::log2(f64::from(frequency))).collect());

/// Approximate cost of an escape, in bits.
const ESCAPE_COST: f64 = 20.0;

/// The frequency of each token: 0 to 4095, with the sum 4096. No token is certain, so that no stream yields
/// tokens without end; the frequency of [`ESCAPE`] is not 0, so that a table can code tokens that it was not
/// made for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frequencies(pub [u16; TOKENS]);

impl Frequencies {
    /// The frequencies nearest to these counts, of which at least one is not 0.
    pub fn of(counts: &[u32; TOKENS]) -> Self {
        let total: u64 = counts.iter().map(|&count| u64::from(count)).sum::<u64>().max(1);
        let share = |count: u32| (u64::from(count) * u64::from(SCALE) / total) as u32;
        let mut frequencies = counts.map(|count| if count > 0 { share(count).max(1) } else { 0 });
        let escape = usize::from(ESCAPE);
        frequencies[escape] = frequencies[escape].max(1);
        if counts[..escape].iter().all(|&count| count == 0) {
            // Gives a frequency to another token, so that the escape is not certain.
            frequencies[0] = 1;
        }
        // The rounding error is added to the most frequent token, where it matters least.
        let mut sum: u32 = frequencies.iter().sum();
        while sum != SCALE {
            // Of several equal ones, the last.
            let (mut largest, mut most) = (0, 0);
            for (token, &frequency) in frequencies.iter().enumerate() {
                if frequency >= most {
                    (largest, most) = (token, frequency);
                }
            }
            let changed = if sum < SCALE { most + (SCALE - sum) } else { most - (sum - SCALE).min(most / 2) };
            sum = sum - most + changed;
            frequencies[largest] = changed;
        }
        Frequencies(frequencies.map(|frequency| frequency as u16))
    }

    /// Approximate number of bits that tokens with these counts take.
    pub fn cost(&self, counts: &[u32; TOKENS]) -> f64 {
        let taken = counts.iter().zip(&self.0).filter(|(count, _)| **count > 0);
        let cost = |frequency: u16| match frequency {
            0 => ESCAPE_COST,
            _ => f64::from(SCALE_BITS) - LOG2[usize::from(frequency)],
        };
        taken.map(|(&count, &frequency)| f64::from(count) * cost(frequency)).sum()
    }

    /// Rough estimate of the bits that it takes to write the frequencies.
    pub fn table_cost(&self) -> f64 {
        const HEAD: f64 = 10.0;
        const EACH: f64 = 5.0;
        HEAD + EACH * self.0.iter().filter(|&&frequency| frequency > 0).count() as f64
    }
}

/// Codes the tables of a section.
pub struct FrequencyModel {
    is_new: AdaptiveBit,
    /// One model for each octave of the preceding frequency.
    frequencies: Vec<IntegerModel>,
}

impl Default for FrequencyModel {
    fn default() -> Self {
        let octaves = 2 + SCALE_BITS as usize;
        FrequencyModel { is_new: AdaptiveBit::default(), frequencies: vec![IntegerModel::default(); octaves] }
    }
}

impl FrequencyModel {
    /// Codes the frequencies of a context, if they are new.
    ///
    /// # Errors
    /// If they do not add up to 4096.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, new: &mut Option<Frequencies>) -> Result<()> {
        if !self.is_new.code(coder, new.is_some()) {
            return Ok(());
        }
        let Frequencies(frequencies) = new.get_or_insert(Frequencies([0; TOKENS]));
        let escape = usize::from(ESCAPE);
        let end =
            frequencies[..escape].iter().rposition(|&frequency| frequency > 0).map_or(0, |last| last + 1);
        let end = coder.code_plain(end as u64, TOKENS.ilog2()) as usize;
        let (mut left, mut before) = (u64::from(SCALE), 0u16);
        for frequency in &mut frequencies[..end] {
            let octave = before.checked_ilog2().map_or(0, |octave| 1 + octave as usize);
            let coded = self.frequencies[octave].code(coder, u64::from(*frequency));
            left = left.checked_sub(coded).ok_or_else(|| Error::corrupt("token frequencies: too many"))?;
            *frequency = coded as u16;
            before = *frequency;
        }
        if !(1..u64::from(SCALE)).contains(&left) {
            return Err(Error::corrupt("token frequencies: the escape has none of them, or all"));
        }
        // The remainder is the frequency of the escape.
        frequencies[escape] = left as u16;
        Ok(())
    }
}
