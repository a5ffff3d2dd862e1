//! The tables of a section, one for each context. They persist for a group and learn from each frame, so that
//! only the first frame has to transmit many. Lookup tables are computed from the frequencies when they are
//! first needed. FORMAT.md 5.5, "Adaptation".

use std::sync::{Arc, OnceLock};

use super::alias::{Bucket, buckets, for_each_number};
use super::frequencies::{Frequencies, SCALE, TOKENS};

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
