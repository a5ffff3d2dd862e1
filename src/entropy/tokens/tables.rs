//! The tables of a section: one for each context. They live as long as a group, so that a frame need not
//! send what the frame before has sent.

use super::alias::{Bucket, buckets, look_up};
use super::frequencies::{Frequencies, SCALE, TOKENS};

/// The tables of the contexts of a section.
#[derive(Clone, Default)]
pub struct TokenTables {
    /// The buckets of each context; all empty where there was no token yet.
    pub(super) buckets: Vec<[Bucket; TOKENS]>,
    /// What the encoder needs besides; empty in a decoder.
    pub(super) encoders: Vec<Option<EncoderTable>>,
}

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
