//! The tables of a section: one for each context. They live as long as a group and learn from each frame, so
//! that only the first sends many.

use super::alias::{Bucket, buckets, look_up};
use super::frequencies::{Frequencies, SCALE, TOKENS};

/// The tables of the contexts of a section.
#[derive(Clone, Default)]
pub struct TokenTables {
    /// The buckets of each context; all empty where there was no token yet.
    pub(super) buckets: Vec<[Bucket; TOKENS]>,
    /// What the encoder needs besides; empty in a decoder.
    pub(super) encoders: Vec<Option<EncoderTable>>,
    /// How often each token came, by context.
    counts: Vec<Counts>,
    /// Frames learned from.
    frames: u32,
}

/// How often each token comes.
pub type Counts = [u32; TOKENS];

/// The inverse of the buckets.
#[derive(Clone)]
pub(super) struct EncoderTable {
    pub frequencies: Frequencies,
    /// The first number of each token.
    starts: [u16; TOKENS],
    /// The numbers, token after token.
    numbers: Vec<u16>,
}

impl EncoderTable {
    fn new(frequencies: Frequencies, buckets: &[Bucket; TOKENS]) -> Self {
        let mut starts = [0; TOKENS];
        let mut start = 0;
        for (token, frequency) in frequencies.0.iter().enumerate() {
            starts[token] = start;
            start += frequency;
        }
        let mut numbers = vec![0; SCALE as usize];
        for number in 0..SCALE {
            let slot = look_up(buckets, number);
            numbers[usize::from(starts[usize::from(slot.token)]) + slot.place as usize] = number as u16;
        }
        EncoderTable { frequencies, starts, numbers }
    }

    /// The number at a place among those of a token.
    #[inline]
    pub fn number(&self, token: u8, place: u32) -> u32 {
        u32::from(self.numbers[usize::from(self.starts[usize::from(token)]) + place as usize])
    }
}

impl TokenTables {
    /// Makes room for so many contexts.
    pub(super) fn grow(&mut self, contexts: usize) {
        if self.buckets.len() < contexts {
            self.buckets.resize(contexts, [Bucket::default(); TOKENS]);
            self.counts.resize(contexts, [0; TOKENS]);
        }
    }

    /// Learns from the tokens of a frame that has been decoded.
    pub fn learn_decoded(&mut self, counts: &[Counts]) {
        self.learn(counts, false);
    }

    /// Learns from the tokens of a frame. New tables are made after 1, 2, 4, 8 ... frames: later ones would
    /// differ little.
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

    /// Takes a new table for a context.
    pub(super) fn set(&mut self, context: usize, frequencies: Frequencies, encodes: bool) {
        self.buckets[context] = buckets(&frequencies);
        if encodes {
            self.encoders.resize(self.encoders.len().max(context + 1), None);
            self.encoders[context] = Some(EncoderTable::new(frequencies, &self.buckets[context]));
        }
    }
}
