//! Collects tokens and writes them. FORMAT.md 5.5.

use super::frequencies::{ESCAPE, Frequencies, FrequencyModel, SCALE_BITS, TOKENS};
use super::tables::TokenTables;
use super::{MOST_BITS, TokenCoder};
use crate::entropy::ArithmeticEncoder;
use crate::ground::error::{Error, Result};
use crate::ground::varint::write_unsigned;

/// The least value of a state: smaller states read 16 more bits.
pub(super) const LEAST_STATE: u32 = 1 << 16;
/// Number of states. They are used in turn, one token each, so that their computations can overlap.
pub(super) const STATES: usize = 4;

/// Collects tokens and plain bits.
pub struct TokenWriter {
    /// Each token in the lowest eight bits, its context above them.
    tokens: Vec<u32>,
    counts: Vec<[u32; TOKENS]>,
    bits: Vec<u8>,
    /// Bits not yet written as bytes, and their number.
    open: u64,
    open_bits: u32,
}

impl TokenWriter {
    /// Creates a writer for `contexts` contexts.
    pub fn new(contexts: usize) -> Self {
        TokenWriter {
            tokens: Vec::new(),
            counts: vec![[0; TOKENS]; contexts],
            bits: Vec::new(),
            open: 0,
            open_bits: 0,
        }
    }

    /// The payload of the section. Its tables are added to `tables`, which learn from the tokens.
    ///
    /// # Errors
    /// None by itself; the coder of the tables may return some.
    pub fn finish(mut self, tables: &mut TokenTables) -> Result<Vec<u8>> {
        let mut payload = Vec::new();
        let frequencies = self.write_tables(tables)?;
        write_unsigned(&mut payload, frequencies.len() as u64);
        payload.extend_from_slice(&frequencies);
        let (words, escaped) = self.words(tables)?;
        write_unsigned(&mut payload, escaped.len() as u64);
        payload.extend_from_slice(&escaped);
        write_unsigned(&mut payload, words.len() as u64);
        words.iter().for_each(|word| payload.extend_from_slice(&word.to_le_bytes()));
        self.bits.extend_from_slice(&self.open.to_le_bytes()[..self.open_bits.div_ceil(8) as usize]);
        payload.extend_from_slice(&self.bits);
        tables.learn(&self.counts);
        Ok(payload)
    }

    /// Writes new tables for contexts where they save more than they cost.
    fn write_tables(&self, tables: &mut TokenTables) -> Result<Vec<u8>> {
        let (mut coder, mut model) = (ArithmeticEncoder::default(), FrequencyModel::default());
        tables.start_frame(self.counts.len());
        for (context, counts) in self.counts.iter().enumerate() {
            let mut new = None;
            let is_used = counts.iter().any(|&count| count > 0);
            if is_used {
                let fresh = Frequencies::of(counts);
                let old_cost = tables.frequencies(context).map_or(f64::INFINITY, |old| old.cost(counts));
                if old_cost > fresh.cost(counts) + fresh.table_cost() {
                    new = Some(fresh);
                }
            }
            model.code(&mut coder, &mut new)?;
            new.into_iter().for_each(|new| tables.set(context, new));
            if is_used {
                tables.make_encoder(context);
            }
        }
        Ok(coder.finish())
    }

    /// The tokens as 16-bit words (the decoder's initial states, then the words that it reads), and the
    /// escaped tokens.
    fn words(&self, tables: &TokenTables) -> Result<(Vec<u16>, Vec<u8>)> {
        let mut escaped = Vec::new();
        let mut states = [LEAST_STATE; STATES];
        // Filled from the end, because a decoder reads them in reverse.
        let mut words = vec![0; self.tokens.len() + 2 * STATES];
        let mut first = words.len();
        let encoders: Vec<_> = (0..self.counts.len()).map(|context| tables.encoder(context)).collect();
        for (index, &tagged) in self.tokens.iter().enumerate().rev() {
            let (context, token) = ((tagged >> 8) as usize, tagged as u8);
            let table = encoders[context].ok_or_else(|| Error::corrupt("tokens without a table"))?;
            let mut share = table.share(token);
            if token == ESCAPE || share.frequency() == 0 {
                escaped.push(token);
                share = table.share(ESCAPE);
            }
            let state = &mut states[index % STATES];
            // Without a branch, which would be unpredictable.
            words[first - 1] = *state as u16;
            let is_full = *state >> (32 - SCALE_BITS) >= share.frequency();
            first -= usize::from(is_full);
            *state >>= 16 * u32::from(is_full);
            let (quotient, place) = share.divide(*state);
            *state = quotient << SCALE_BITS | table.number(share, place);
        }
        for state in states.iter().rev() {
            first -= 2;
            words[first] = *state as u16;
            words[first + 1] = (*state >> 16) as u16;
        }
        escaped.reverse();
        Ok((words.split_off(first), escaped))
    }
}

impl TokenCoder for TokenWriter {
    const ENCODES: bool = true;

    #[inline(always)]
    fn token(&mut self, context: usize, token: u8) -> u8 {
        self.counts[context][usize::from(token)] += 1;
        self.tokens.push((context as u32) << 8 | u32::from(token));
        token
    }

    #[inline(always)]
    fn bits(&mut self, value: u64, count: u32) -> u64 {
        debug_assert!(count <= MOST_BITS);
        let value = value & ((1 << count) - 1);
        self.open |= value << self.open_bits;
        self.open_bits += count;
        let whole = self.open_bits / 8;
        self.bits.extend_from_slice(&self.open.to_le_bytes());
        self.bits.truncate(self.bits.len() - 8 + whole as usize);
        self.open = self.open.checked_shr(8 * whole).unwrap_or(0);
        self.open_bits -= 8 * whole;
        value
    }
}
