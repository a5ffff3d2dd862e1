//! Static coding of tokens by an asymmetric numeral system (range ANS): a section's tokens are counted first,
//! then each is coded with the resulting frequency. Faster than adaptive coding, and nearly as small where
//! many tokens share few contexts. FORMAT.md 5.5.
//!
//! As with bits, every syntax element is written once, as a function over a [`TokenCoder`]. Numbers are
//! tokens as well: each number below [`DIRECT`] has a token of its own; a larger one shares a token with all
//! numbers of the same octave that agree in the two bits below the highest.

mod tables;

use tables::{Bucket, ESCAPE, Frequencies, FrequencyModel, SCALE, SCALE_BITS, TOKENS, look_up};
pub use tables::{Counts, StartTables, TokenTables};

use super::{ArithmeticDecoder, ArithmeticEncoder, BitCoder};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// The largest number of plain bits coded at once: they fit into eight bytes at any bit offset.
const MOST_BITS: u32 = 56;

/// Codes tokens and plain bits in one direction or the other.
pub trait TokenCoder {
    /// True if this side knows the tokens.
    const ENCODES: bool;

    /// Codes one token in a context. The decoder ignores `token`. Both return the token.
    fn token(&mut self, context: usize, token: u8) -> u8;

    /// Codes the lowest `count` bits of `value`, at most [`MOST_BITS`], each as likely to be 0 as 1.
    fn bits(&mut self, value: u64, count: u32) -> u64;

    /// Whether a decoder has read past the end of its bytes, so that the values it returns are meaningless.
    fn is_exhausted(&self) -> bool {
        false
    }

    /// Codes a number below 2^60: small ones as tokens of their own, larger ones by a token for their highest
    /// bits and the rest as plain bits.
    #[inline]
    fn number(&mut self, context: usize, value: u64) -> u64 {
        let known = NumberToken::of(value);
        let found = NumberToken::from_token(self.token(context, known.token));
        if found.low_bits <= 32 {
            return found.base + self.bits(known.rest, found.low_bits);
        }
        let high = self.bits(known.rest >> 32, found.low_bits - 32);
        found.base + (high << 32 | self.bits(known.rest, 32))
    }
}

/// Numbers below this have a token of their own.
const DIRECT: u64 = 32;
const DIRECT_BITS: u32 = DIRECT.ilog2();
/// Bits below the highest that a token determines.
const MANTISSA_BITS: u32 = 2;
/// The highest octave that any token stands for.
const HIGHEST_OCTAVE: u32 = 59;

/// A number's token, and the bits that the token does not determine.
pub struct NumberToken {
    pub token: u8,
    /// The least number with this token.
    pub base: u64,
    /// The number of bits that the token does not determine.
    pub low_bits: u32,
    /// These bits.
    pub rest: u64,
}

impl NumberToken {
    /// The token of a number below 2^60.
    #[inline]
    pub fn of(value: u64) -> Self {
        if value < DIRECT {
            return NumberToken { token: value as u8, base: value, low_bits: 0, rest: 0 };
        }
        let octave = value.ilog2().min(HIGHEST_OCTAVE);
        let low_bits = octave - MANTISSA_BITS;
        let mantissa = value >> low_bits & ((1 << MANTISSA_BITS) - 1);
        let token = DIRECT + (u64::from(octave - DIRECT_BITS) << MANTISSA_BITS) + mantissa;
        NumberToken {
            token: token as u8,
            base: value >> low_bits << low_bits,
            low_bits,
            rest: value & ((1 << low_bits) - 1),
        }
    }

    /// A token without the remaining bits, as a decoder reads it first. Invalid tokens count as the last
    /// valid one.
    #[inline]
    fn from_token(token: u8) -> Self {
        let value = u64::from(token);
        if value < DIRECT {
            return NumberToken { token, base: value, low_bits: 0, rest: 0 };
        }
        let octave = (DIRECT_BITS + ((value - DIRECT) >> MANTISSA_BITS) as u32).min(HIGHEST_OCTAVE);
        let low_bits = octave - MANTISSA_BITS;
        let mantissa = value & ((1 << MANTISSA_BITS) - 1);
        NumberToken { token, base: (1 << MANTISSA_BITS | mantissa) << low_bits, low_bits, rest: 0 }
    }
}

/// The least number with this token, and the number of numbers with it.
pub fn numbers_of_token(token: u8) -> (u64, u64) {
    let NumberToken { base, low_bits, .. } = NumberToken::from_token(token);
    (base, 1 << low_bits)
}

/// The least value of a state: smaller states read 16 more bits.
const LEAST_STATE: u32 = 1 << 16;
/// Number of states. They are used in turn, one token each, so that their computations can overlap.
const STATES: usize = 4;

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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const CONTEXTS: usize = 5;

    /// Codes tokens, numbers and bits; some contexts have only one token.
    fn code<C: TokenCoder>(coder: &mut C, values: &[(usize, u64, u32)]) -> Vec<(u64, u64)> {
        let code_one = |&(context, value, count): &(usize, u64, u32)| {
            let token = coder.token(context % 2, value as u8 & 7);
            let number = coder.number(2 + context % 2, value);
            let certain = coder.token(4, 9);
            let bits = coder.bits(value, count);
            (number + u64::from(token) + u64::from(certain), bits)
        };
        values.iter().map(code_one).collect()
    }

    proptest! {
        #[test]
        fn tokens_come_back(
            frames in proptest::collection::vec(
                proptest::collection::vec((0usize..9, 0u64..1 << 60, 0..=MOST_BITS), 0..300), 0..4),
            small in any::<bool>(),
        ) {
            let (mut written, mut read) = (TokenTables::default(), TokenTables::default());
            for mut frame in frames {
                if small {
                    frame.iter_mut().for_each(|(_, value, _)| *value %= 50);
                }
                let mut writer = TokenWriter::new(CONTEXTS);
                let coded = code(&mut writer, &frame);
                let payload = writer.finish(&mut written).unwrap();
                let mut reader = TokenReader::new(&payload, CONTEXTS, &mut read).unwrap();
                prop_assert_eq!(code(&mut reader, &frame), coded);
                prop_assert!(!reader.is_exhausted());
                let counts = reader.into_counts();
                prop_assert!(!read.lack_one(&counts));
                read.learn(&counts);
            }
        }

        #[test]
        fn any_bytes_decode_to_something(
            bytes: Vec<u8>,
            values in proptest::collection::vec((0usize..9, 0u64..9, 0..=MOST_BITS), 0..300),
        ) {
            let mut tables = TokenTables::default();
            if let Ok(mut reader) = TokenReader::new(&bytes, CONTEXTS, &mut tables) {
                code(&mut reader, &values);
            }
        }

        #[test]
        fn numbers_come_back_from_their_tokens(value in 0u64..1 << 60) {
            let token = NumberToken::of(value);
            prop_assert_eq!(token.base + token.rest, value);
            let found = NumberToken::from_token(token.token);
            prop_assert_eq!((found.base, found.low_bits), (token.base, token.low_bits));
        }
    }

    #[test]
    fn a_payload_gives_no_tokens_without_end() {
        let mut writer = TokenWriter::new(1);
        writer.token(0, 7);
        let payload = writer.finish(&mut TokenTables::default()).unwrap();
        let mut tables = TokenTables::default();
        let mut reader = TokenReader::new(&payload, 1, &mut tables).unwrap();
        let tokens = (0..1 << 24).take_while(|_| {
            reader.token(0, 0);
            !reader.is_exhausted()
        });
        assert!(tokens.count() < 1 << 21);
    }

    #[test]
    fn a_token_without_a_table_is_noticed() {
        let mut writer = TokenWriter::new(2);
        writer.token(0, 7);
        let payload = writer.finish(&mut TokenTables::default()).unwrap();
        for context in 0..2 {
            let mut tables = TokenTables::default();
            let mut reader = TokenReader::new(&payload, 2, &mut tables).unwrap();
            reader.token(context, 0);
            let counts = reader.into_counts();
            assert_eq!(tables.lack_one(&counts), context == 1);
        }
    }

    #[test]
    fn a_section_of_escapes_comes_back() {
        let mut writer = TokenWriter::new(1);
        (0..100).for_each(|_| assert_eq!(writer.token(0, 255), 255));
        let payload = writer.finish(&mut TokenTables::default()).unwrap();
        let mut tables = TokenTables::default();
        let mut reader = TokenReader::new(&payload, 1, &mut tables).unwrap();
        assert!((0..100).all(|_| reader.token(0, 0) == 255) && !reader.is_exhausted());
    }

    #[test]
    fn frequent_tokens_take_little() {
        let mut writer = TokenWriter::new(1);
        (0..100_000u32)
            .for_each(|i| assert_eq!(writer.token(0, u8::from(i % 100 == 0)), u8::from(i % 100 == 0)));
        let payload = writer.finish(&mut TokenTables::default()).unwrap();
        // 0.081 bits per token, and the states.
        assert!(payload.len() < 1038, "{}", payload.len());
    }

    #[test]
    fn reciprocals_divide_exactly() {
        for frequency in 1..4096u32 {
            let share = super::tables::Share::of(frequency as u16, 0);
            let end = frequency << 20;
            let near_multiples = (0..50u32).map(|i| (end / frequency / 50 * i) * frequency);
            let states = near_multiples.flat_map(|state| [state.wrapping_sub(1), state, state + 1]);
            for state in states.chain([end.wrapping_sub(1), end.wrapping_sub(frequency)]) {
                if u64::from(state) < u64::from(frequency) << 20 {
                    assert_eq!(
                        share.divide(state),
                        (state / frequency, state % frequency),
                        "{state} / {frequency}"
                    );
                }
            }
        }
    }

    /// The likeliest token takes so few bits that a word holds more than 2^15 of them.
    #[test]
    fn many_tokens_in_few_words_come_back() {
        let tokens = |place: usize| if place.is_multiple_of(4100) { 1u8 } else { 0 };
        let (mut written, mut read) = (TokenTables::default(), TokenTables::default());
        let mut writer = TokenWriter::new(1);
        let count = 20_000_000;
        for place in 0..count {
            writer.token(0, tokens(place));
        }
        let payload = writer.finish(&mut written).unwrap();
        let mut reader = TokenReader::new(&payload, 1, &mut read).unwrap();
        assert!((0..count).all(|place| reader.token(0, 0) == tokens(place)));
        assert!(!reader.is_exhausted());
    }
}
