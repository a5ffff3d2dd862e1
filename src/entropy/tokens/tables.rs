//! The tables of a section's tokens, one for each context: how often each token occurs, as shares of 4096.
//! FORMAT.md 5.5, "Tables". They persist for a group and learn from each frame, so that only the first frame
//! has to transmit many. FORMAT.md 5.5, "Adaptation".
//!
//! Lookup tables are computed from the frequencies when they are first needed. They map each number below
//! 4096 to a token, so that each token has as many numbers as its frequency. Walker's alias method keeps them
//! small: equal buckets, each shared by at most two tokens. FORMAT.md 5.5, "Alias method".

use std::sync::{Arc, LazyLock, OnceLock};

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

/// Numbers in a bucket.
const BUCKET: u32 = SCALE / TOKENS as u32;

/// A bucket: its first numbers belong to its own token, the rest to another token.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bucket {
    own_frequency: u16,
    other_frequency: u16,
    /// The index of the bucket's first number among those of the other token; negative if it would be before
    /// the first of them.
    other_place: i16,
    /// How many numbers belong to the bucket's own token.
    own: u8,
    other: u8,
}

/// The token of a number below 4096.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    pub token: u8,
    /// The token's frequency.
    pub frequency: u32,
    /// The index of the number among those of the token.
    pub place: u32,
}

/// The buckets of a context.
fn buckets(Frequencies(frequencies): &Frequencies) -> [Bucket; TOKENS] {
    let mut left = frequencies.map(u32::from);
    let mut buckets: [Bucket; TOKENS] = std::array::from_fn(|token| Bucket {
        own_frequency: frequencies[token],
        other_frequency: frequencies[token],
        other_place: 0,
        own: 0,
        other: token as u8,
    });
    let (mut poor, mut rich): (Vec<usize>, Vec<usize>) =
        (0..TOKENS).filter(|&token| left[token] != BUCKET).partition(|&token| left[token] < BUCKET);
    while let (Some(from), Some(to)) = (rich.pop(), poor.pop()) {
        // The rest of this token's bucket is filled from the end of the other token's numbers.
        let own = left[to];
        left[from] -= BUCKET - own;
        buckets[to].own = own as u8;
        buckets[to].other = from as u8;
        buckets[to].other_frequency = frequencies[from];
        buckets[to].other_place = (left[from] as i32 - own as i32) as i16;
        match left[from] {
            rest if rest < BUCKET => poor.push(from),
            rest if rest > BUCKET => rich.push(from),
            _ => {}
        }
    }
    buckets
}

/// Calls `give` for all numbers below 4096 with the number's token, its index among that token's numbers, and
/// the number.
fn for_each_number(buckets: &[Bucket; TOKENS], mut give: impl FnMut(u8, u32, u32)) {
    for (index, bucket) in buckets.iter().enumerate() {
        let (first, own) = (index as u32 * BUCKET, u32::from(bucket.own));
        (0..own).for_each(|place| give(index as u8, place, first + place));
        let other_place = |place: u32| place.wrapping_add_signed(i32::from(bucket.other_place));
        (own..BUCKET).for_each(|place| give(bucket.other, other_place(place), first + place));
    }
}

/// The token of a number below 4096.
#[inline]
pub fn look_up(buckets: &[Bucket; TOKENS], number: u32) -> Slot {
    let index = (number / BUCKET) as usize % TOKENS;
    let bucket = &buckets[index];
    let place = number % BUCKET;
    // Selected without a branch, which would be unpredictable.
    let is_own = place < u32::from(bucket.own);
    let token = if is_own { index as u8 } else { bucket.other };
    let frequency = if is_own { bucket.own_frequency } else { bucket.other_frequency };
    let first = if is_own { 0 } else { bucket.other_place };
    Slot { token, frequency: u32::from(frequency), place: place.wrapping_add_signed(i32::from(first)) }
}

/// The tables of a section's contexts.
#[derive(Clone, Default)]
pub struct TokenTables {
    contexts: Vec<Table>,
    /// The decoder's lookup tables, by context; all empty where no token has occurred yet.
    pub(super) buckets: Vec<[Bucket; TOKENS]>,
    /// Number of frames learned from.
    frames: u32,
    /// Whether the tables are to be recomputed before the next frame.
    is_due: bool,
    /// Whether the tables have been given their starting distribution.
    has_start: bool,
}

/// The table of a context.
#[derive(Clone)]
struct Table {
    /// How often each token has occurred.
    counts: Counts,
    frequencies: Option<Frequencies>,
    /// The encoder's lookup table, once it was computed from the frequencies.
    encoder: Option<Arc<EncoderTable>>,
    /// Whether the decoder's buckets were computed from these frequencies.
    has_buckets: bool,
}

/// How often each token occurs.
pub type Counts = [u32; TOKENS];

/// Tables with which the first frame of every group starts, computed once.
pub struct StartTables {
    counts: Vec<Counts>,
    frequencies: Vec<Frequencies>,
    buckets: OnceLock<Vec<[Bucket; TOKENS]>>,
    encoders: OnceLock<Vec<Arc<EncoderTable>>>,
}

/// The inverse of the buckets.
pub(super) struct EncoderTable {
    shares: [Share; TOKENS],
    /// The numbers of all tokens, token after token.
    numbers: [u16; SCALE as usize],
}

/// A token's range of numbers.
#[derive(Clone, Copy, Default)]
pub(super) struct Share {
    /// 2^44 over the frequency, rounded up.
    reciprocal: u64,
    /// The number of numbers; 0 if the token is coded by an [`ESCAPE`].
    frequency: u16,
    /// The first of them in the table.
    start: u16,
}

/// With this many bits, reciprocals of frequencies divide states below 2^20 times the frequency exactly in
/// 64-bit arithmetic.
const RECIPROCAL_BITS: u32 = 44;

impl Share {
    pub fn of(frequency: u16, start: u16) -> Self {
        // Most tokens have frequency 0, and divisions are slow.
        let reciprocal = match frequency {
            0 => 0,
            _ => (1u64 << RECIPROCAL_BITS).div_ceil(frequency.into()),
        };
        Share { reciprocal, frequency, start }
    }

    #[inline]
    pub fn frequency(self) -> u32 {
        u32::from(self.frequency)
    }

    /// Divides a state below 2^20 times the frequency by the frequency: quotient and remainder.
    #[inline]
    pub fn divide(self, state: u32) -> (u32, u32) {
        let quotient = (u64::from(state) * self.reciprocal >> RECIPROCAL_BITS) as u32;
        (quotient, state - quotient * self.frequency())
    }
}

impl EncoderTable {
    fn new(frequencies: &Frequencies) -> Self {
        let mut shares = [Share::default(); TOKENS];
        let mut start = 0;
        for (share, &frequency) in shares.iter_mut().zip(&frequencies.0) {
            *share = Share::of(frequency, start);
            start += frequency;
        }
        let mut numbers = [0; SCALE as usize];
        for_each_number(&buckets(frequencies), |token, place, number| {
            let start = usize::from(shares[usize::from(token)].start);
            numbers[start + place as usize] = number as u16;
        });
        EncoderTable { shares, numbers }
    }

    /// The range of numbers of a token.
    #[inline]
    pub fn share(&self, token: u8) -> Share {
        self.shares[usize::from(token)]
    }

    /// The number with this index among those of a token.
    #[inline]
    pub fn number(&self, share: Share, place: u32) -> u32 {
        u32::from(self.numbers[usize::from(share.start) + place as usize])
    }
}

impl StartTables {
    /// Tables for contexts in which tokens typically occur with these counts.
    pub fn of(counts: Vec<Counts>) -> Self {
        let frequencies = counts.iter().map(Frequencies::of).collect();
        StartTables { counts, frequencies, buckets: OnceLock::new(), encoders: OnceLock::new() }
    }

    fn buckets(&self) -> &[[Bucket; TOKENS]] {
        self.buckets.get_or_init(|| self.frequencies.iter().map(buckets).collect())
    }

    fn encoders(&self) -> &[Arc<EncoderTable>] {
        let table = |frequencies| Arc::new(EncoderTable::new(frequencies));
        self.encoders.get_or_init(|| self.frequencies.iter().map(table).collect())
    }
}

impl Default for Table {
    fn default() -> Self {
        Table { counts: [0; TOKENS], frequencies: None, encoder: None, has_buckets: true }
    }
}

impl TokenTables {
    /// Gives each context its starting distribution, once, before any token has occurred. Its influence soon
    /// fades.
    pub fn start_from(&mut self, start: &StartTables, encodes: bool) {
        /// The divisor of the initial counts, so that observed ones soon outweigh them.
        const SHARE: u32 = 32;
        if std::mem::replace(&mut self.has_start, true) {
            return;
        }
        self.contexts = (start.counts.iter().zip(&start.frequencies))
            .map(|(counts, frequencies)| Table {
                counts: counts.map(|count| count / SHARE),
                frequencies: Some(frequencies.clone()),
                ..Table::default()
            })
            .collect();
        if encodes {
            let tables = self.contexts.iter_mut().zip(start.encoders());
            tables.for_each(|(table, encoder)| table.encoder = Some(Arc::clone(encoder)));
        } else {
            self.buckets = start.buckets().to_vec();
        }
    }

    /// Starts a frame of `contexts` contexts, with the tables learned from earlier frames.
    pub(super) fn start_frame(&mut self, contexts: usize) {
        if self.contexts.len() < contexts {
            self.contexts.resize_with(contexts, Table::default);
        }
        if std::mem::take(&mut self.is_due) {
            for table in self.contexts.iter_mut().filter(|table| table.counts.iter().any(|&count| count > 0))
            {
                table.set(Frequencies::of(&table.counts));
            }
        }
    }

    /// Whether a context of these tokens has no table: a reader has read nonsense there.
    pub fn lack_one(&self, counts: &[Counts]) -> bool {
        let contexts = self.contexts.iter().zip(counts);
        contexts.filter(|(table, _)| table.frequencies.is_none()).any(|(_, counts)| *counts != [0; TOKENS])
    }

    /// Learns from the tokens of a frame. Tables are recomputed after 1, 2, 4, 8 ... frames, as they would
    /// hardly differ in between, and only when the next frame needs them.
    pub fn learn(&mut self, counts: &[Counts]) {
        for (table, new) in self.contexts.iter_mut().zip(counts) {
            table.counts.iter_mut().zip(new).for_each(|(known, new)| *known = known.saturating_add(*new));
        }
        self.frames = self.frames.saturating_add(1);
        self.is_due |= self.frames.is_power_of_two();
    }

    /// The frequencies of a context, if it has any.
    pub(super) fn frequencies(&self, context: usize) -> Option<&Frequencies> {
        self.contexts[context].frequencies.as_ref()
    }

    /// Sets the frequencies of a context.
    pub(super) fn set(&mut self, context: usize, frequencies: Frequencies) {
        self.contexts[context].set(frequencies);
    }

    /// Computes the encoder's lookup table for this context.
    pub(super) fn make_encoder(&mut self, context: usize) {
        let table = &mut self.contexts[context];
        if let (None, Some(frequencies)) = (&table.encoder, &table.frequencies) {
            table.encoder = Some(Arc::new(EncoderTable::new(frequencies)));
        }
    }

    /// The encoder's lookup table for this context, if it was computed.
    #[inline]
    pub(super) fn encoder(&self, context: usize) -> Option<&EncoderTable> {
        self.contexts.get(context)?.encoder.as_deref()
    }

    /// Computes the decoder's lookup tables for all contexts.
    pub(super) fn make_buckets(&mut self) {
        self.buckets.resize(self.contexts.len().max(self.buckets.len()), [Bucket::default(); TOKENS]);
        for (made, table) in
            self.buckets.iter_mut().zip(&mut self.contexts).filter(|(_, table)| !table.has_buckets)
        {
            table.frequencies.iter().for_each(|frequencies| *made = buckets(frequencies));
            table.has_buckets = true;
        }
    }
}

impl Table {
    fn set(&mut self, frequencies: Frequencies) {
        self.frequencies = Some(frequencies);
        self.encoder = None;
        self.has_buckets = false;
    }
}
