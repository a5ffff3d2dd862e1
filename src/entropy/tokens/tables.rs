//! The tables of a section, one for each context. They live as long as a group and learn from each frame, so
//! only the first frame has to send many.

use super::alias::{Bucket, buckets, for_each_number};
use super::frequencies::{Frequencies, SCALE, TOKENS};

/// The tables of a section's contexts.
#[derive(Clone, Default)]
pub struct TokenTables {
    /// The buckets of each context; all empty where no token has occurred yet.
    pub(super) buckets: Vec<[Bucket; TOKENS]>,
    /// What only the encoder needs; empty in a decoder.
    pub(super) encoders: Vec<Option<EncoderTable>>,
    /// How often each token has occurred, by context.
    counts: Vec<Counts>,
    /// Frames learned from.
    frames: u32,
    /// Whether the tables have been given their starting distribution.
    has_start: bool,
}

/// How often each token occurs.
pub type Counts = [u32; TOKENS];

/// The inverse of the buckets.
#[derive(Clone)]
pub(super) struct EncoderTable {
    pub frequencies: Frequencies,
    shares: [Share; TOKENS],
    /// The numbers of all tokens, token after token.
    numbers: Vec<u16>,
}

/// The numbers of a token.
#[derive(Clone, Copy, Default)]
pub(super) struct Share {
    /// 2^44 over the frequency, rounded up.
    reciprocal: u64,
    /// How many there are; 0 if the token is coded by way of [`ESCAPE`].
    frequency: u16,
    /// The first of them in the table.
    start: u16,
}

/// With this many bits, reciprocals of frequencies divide states below 2^20 times the frequency exactly, in
/// 64 bits.
const RECIPROCAL_BITS: u32 = 44;

impl Share {
    pub fn of(frequency: u16, start: u16) -> Self {
        let divisor = u64::from(frequency.max(1));
        Share { reciprocal: (1u64 << RECIPROCAL_BITS).div_ceil(divisor), frequency, start }
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
    fn new(frequencies: Frequencies, buckets: &[Bucket; TOKENS]) -> Self {
        let mut shares = [Share::default(); TOKENS];
        let mut start = 0;
        for (share, &frequency) in shares.iter_mut().zip(&frequencies.0) {
            *share = Share::of(frequency, start);
            start += frequency;
        }
        let mut numbers = vec![0; SCALE as usize];
        for_each_number(buckets, |token, place, number| {
            let start = usize::from(shares[usize::from(token)].start);
            numbers[start + place as usize] = number as u16;
        });
        EncoderTable { frequencies, shares, numbers }
    }

    /// The numbers of a token.
    #[inline]
    pub fn share(&self, token: u8) -> Share {
        self.shares[usize::from(token)]
    }

    /// The number at a place among those of a token.
    #[inline]
    pub fn number(&self, share: Share, place: u32) -> u32 {
        u32::from(self.numbers[usize::from(share.start) + place as usize])
    }
}

impl TokenTables {
    /// Makes room for `contexts` contexts.
    pub(super) fn grow(&mut self, contexts: usize) {
        if self.buckets.len() < contexts {
            self.buckets.resize(contexts, [Bucket::default(); TOKENS]);
            self.counts.resize(contexts, [0; TOKENS]);
        }
    }

    /// Initialises each context, once, from the counts that are typical of its tokens, before any has
    /// occurred. Their influence soon fades.
    pub fn start_from(&mut self, counts: &[Counts], encodes: bool) {
        /// The share that the initial counts have among those of tokens that have occurred.
        const SHARE: u32 = 32;
        if !std::mem::replace(&mut self.has_start, true) {
            self.grow(counts.len());
            for (context, counts) in counts.iter().enumerate() {
                self.counts[context] = counts.map(|count| count / SHARE);
                self.set(context, Frequencies::of(counts), encodes);
            }
        }
    }

    /// Learns from the tokens of a frame that has been decoded.
    pub fn learn_decoded(&mut self, counts: &[Counts]) {
        self.learn(counts, false);
    }

    /// Learns from the tokens of a frame. New tables are made after 1, 2, 4, 8 ... frames, as later ones
    /// would hardly differ.
    pub(super) fn learn(&mut self, counts: &[Counts], encodes: bool) {
        for (known, new) in self.counts.iter_mut().zip(counts) {
            known.iter_mut().zip(new).for_each(|(known, new)| *known = known.saturating_add(*new));
        }
        self.frames = self.frames.saturating_add(1);
        if self.frames.is_power_of_two() {
            for context in 0..self.counts.len() {
                if self.counts[context].iter().any(|&count| count > 0) {
                    self.set(context, Frequencies::of(&self.counts[context]), encodes);
                }
            }
        }
    }

    /// Installs a new table for a context.
    pub(super) fn set(&mut self, context: usize, frequencies: Frequencies, encodes: bool) {
        self.buckets[context] = buckets(&frequencies);
        if encodes {
            self.encoders.resize(self.encoders.len().max(context + 1), None);
            self.encoders[context] = Some(EncoderTable::new(frequencies, &self.buckets[context]));
        }
    }
}
