//! Reads tokens. FORMAT.md 5.5.

use super::alias::{Bucket, look_up};
use super::frequencies::{ESCAPE, FrequencyModel, SCALE, SCALE_BITS, TOKENS};
use super::tables::{Counts, TokenTables};
use super::writer::{LEAST_STATE, STATES};
use super::{MOST_BITS, TokenCoder};
use crate::entropy::{ArithmeticDecoder, BitCoder};
use crate::ground::error::{Error, Result};
use crate::ground::varint::read_unsigned;

/// Reads tokens and plain bits. Past the end of the bytes it reads zeros, so any bytes decode to something.
pub struct TokenReader<'a> {
    buckets: &'a [[Bucket; TOKENS]],
    /// The states, the next to be used first.
    states: [u32; STATES],
    escaped: std::slice::Iter<'a, u8>,
    words: &'a [[u8; 2]],
    bits: &'a [u8],
    /// Number of plain bits already read.
    bits_read: u64,
    exhausted: bool,
    counts: Vec<Counts>,
    /// Tokens that the payload can still hold.
    left: u64,
}

/// The likeliest token takes 1.44 / 4096 bits, so a byte holds fewer tokens than this.
const TOKENS_A_BYTE: u64 = 1 << 15;
/// The states hold as many tokens as this many bytes.
const BYTES_OF_STATES: u64 = 4 * STATES as u64;

impl<'a> TokenReader<'a> {
    /// Starts at the first byte of a payload. Its tables, for `contexts` contexts, are added to `tables`.
    ///
    /// # Errors
    /// If the payload is cut short, or its tables are invalid.
    pub fn new(mut payload: &'a [u8], contexts: usize, tables: &'a mut TokenTables) -> Result<Self> {
        let short = || Error::corrupt("tokens: cut short");
        let input = &mut payload;
        let length = usize::try_from(read_unsigned(input, "tokens")?).map_err(|_| short())?;
        let frequencies = input.split_off(..length).ok_or_else(short)?;
        let (mut coder, mut model) = (ArithmeticDecoder::new(frequencies), FrequencyModel::default());
        tables.start_frame(contexts);
        for context in 0..contexts {
            let mut new = None;
            model.code(&mut coder, &mut new)?;
            new.into_iter().for_each(|new| tables.set(context, new));
        }
        if coder.is_exhausted() {
            return Err(Error::corrupt("tokens: tables cut short"));
        }
        tables.make_buckets();
        let length = usize::try_from(read_unsigned(input, "tokens")?).map_err(|_| short())?;
        let escaped = input.split_off(..length).ok_or_else(short)?.iter();
        let length = usize::try_from(read_unsigned(input, "tokens")?).map_err(|_| short())?;
        let words = input.split_off(..length.checked_mul(2).ok_or_else(short)?).ok_or_else(short)?;
        let (words, _) = words.as_chunks();
        let mut reader = TokenReader {
            buckets: &tables.buckets,
            states: [0; STATES],
            escaped,
            words,
            bits: input,
            bits_read: 0,
            exhausted: false,
            counts: vec![[0; TOKENS]; contexts],
            left: (2 * length as u64 + BYTES_OF_STATES).saturating_mul(TOKENS_A_BYTE),
        };
        for place in 0..STATES {
            let low = reader.take_word(0, true);
            reader.states[place] = reader.take_word(0, true) << 16 | low;
        }
        Ok(reader)
    }

    /// How often each token occurred in each context, for [`TokenTables::learn`].
    pub fn into_counts(self) -> Vec<Counts> {
        self.counts
    }

    /// Shifts the next word into `state` if `wanted`, else returns `state` unchanged.
    #[inline]
    fn take_word(&mut self, state: u32, wanted: bool) -> u32 {
        let next = self.words.first().map_or(0, |word| u32::from(u16::from_le_bytes(*word)));
        match self.words.get(usize::from(wanted)..) {
            Some(rest) => self.words = rest,
            None => self.exhausted = true,
        }
        // Without a branch, which would be unpredictable.
        if wanted { state << 16 | next } else { state }
    }

    #[cold]
    fn next_escaped(&mut self) -> u8 {
        let token = self.escaped.next().copied();
        self.exhausted |= token.is_none();
        token.unwrap_or(0)
    }

    /// The last bytes, from `at` on, padded with zeros.
    #[cold]
    fn last_bytes(&self, at: u64) -> u64 {
        let rest = usize::try_from(at).ok().and_then(|at| self.bits.get(at..)).unwrap_or_default();
        let mut last = [0; 8];
        last.iter_mut().zip(rest).for_each(|(last, byte)| *last = *byte);
        u64::from_le_bytes(last)
    }
}

impl TokenCoder for TokenReader<'_> {
    const ENCODES: bool = false;

    #[inline(always)]
    fn token(&mut self, context: usize, _token: u8) -> u8 {
        let [state, second, third, fourth] = self.states;
        let slot = look_up(&self.buckets[context], state % SCALE);
        let state = slot.frequency.wrapping_mul(state >> SCALE_BITS).wrapping_add(slot.place);
        self.states = [second, third, fourth, self.take_word(state, state < LEAST_STATE)];
        let token = if slot.token == ESCAPE { self.next_escaped() } else { slot.token };
        self.counts[context][usize::from(token)] += 1;
        self.left = self.left.saturating_sub(1);
        token
    }

    #[inline(always)]
    fn bits(&mut self, _value: u64, count: u32) -> u64 {
        debug_assert!(count <= MOST_BITS);
        let at = self.bits_read / 8;
        let whole = usize::try_from(at).ok().and_then(|at| self.bits.get(at..)?.first_chunk());
        let bytes = whole.map_or_else(|| self.last_bytes(at), |bytes| u64::from_le_bytes(*bytes));
        let value = bytes >> (self.bits_read % 8) & ((1 << count) - 1);
        self.bits_read += u64::from(count);
        value
    }

    fn is_exhausted(&self) -> bool {
        self.exhausted || self.left == 0 || self.bits_read > 8 * self.bits.len() as u64
    }
}
