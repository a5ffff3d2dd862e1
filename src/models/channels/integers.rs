//! Integers, one per record, each predicted in several ways: which predictions were right shows which to try
//! first for the next one. If none of those tried is right, the difference from the prediction with the
//! smallest recent error is coded. FORMAT.md 8.9, "Integers".

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel, MixedBits};
use crate::ground::varint::{unzigzag, zigzag};

/// Number of ways to predict an integer.
const CANDIDATES: usize = 13;
/// Number of predictions that are tried, starting with the one that was right most often.
const TRIES: usize = 4;
/// Number of contexts of an attempt, and of opinions on it.
const VIEWS: usize = 5;
const OPINIONS: usize = 8;
/// Log2 of the number of entries of a hash table.
const TABLE_BITS: u32 = 14;
/// Entries of a hash table.
pub const ENTRIES: usize = 1 << TABLE_BITS;
/// Number of levels of the recent error, in half bits.
const ERROR_LEVELS: usize = 64;
/// If a difference has more bits than this, the integer itself is coded, without a model.
const LONGEST: u32 = 62;

/// The place of a record, and what is known about it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Site {
    /// Its beam.
    pub key: u32,
    /// Its column in the range image, counted from 1; 0 if it has none. For a rule by ticks, its tick
    /// instead.
    pub column: u32,
    /// The integer that its position implies, if any.
    pub geometry: Option<i64>,
    /// The integer one lag before, and the integer before that one.
    pub lagged: Option<[i64; 2]>,
}

/// Adaptive models of the integers of a column.
#[derive(Clone)]
pub struct IntegersModel {
    /// The last integers, the latest first.
    last: [i64; 3],
    /// The last site's key.
    key: u32,
    /// By hash of the key: the last integer with this key, the one before it, and the last one's difference
    /// from the geometry.
    of_key: Vec<[i64; 3]>,
    /// By hash of this key and the last one: the last difference.
    of_keys: Vec<i64>,
    /// By column: the last integer.
    of_column: Vec<i64>,
    /// By hash of the last two integers: the integer that followed.
    after: Vec<i64>,
    /// By hash of the last two differences: the difference that followed.
    after_steps: Vec<i64>,
    /// How often each candidate has recently been right, from 0 to 1.
    scores: [f32; CANDIDATES],
    /// The recent error of each candidate where no attempt was right, in half bits.
    errors: [f32; CANDIDATES],
    /// Which attempt was right for each of the last integers, two bits each.
    history: usize,
    hits: MixedBits<VIEWS, OPINIONS>,
    is_long: AdaptiveBit,
    differences: Vec<IntegerModel>,
}

/// Counters per context of an attempt.
const PLACES: usize = 1 << 14;

impl Default for IntegersModel {
    fn default() -> Self {
        IntegersModel {
            last: [0; 3],
            key: 0,
            of_key: vec![[0; 3]; ENTRIES],
            of_keys: vec![0; ENTRIES],
            of_column: Vec::new(),
            after: vec![0; ENTRIES],
            after_steps: vec![0; ENTRIES],
            scores: [0.5; CANDIDATES],
            errors: [16.0; CANDIDATES],
            history: 0,
            hits: MixedBits::new([PLACES; VIEWS], TRIES, 0.3, 0.0, 0.004),
            is_long: AdaptiveBit::default(),
            differences: vec![IntegerModel::default(); ERROR_LEVELS],
        }
    }
}

/// The entries of the tables for a site.
struct Entries {
    key: usize,
    keys: usize,
    column: usize,
    after: usize,
    after_steps: usize,
}

impl IntegersModel {
    /// Codes the next integer.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, site: &Site, value: i64) -> i64 {
        let entries = self.entries(site);
        let candidates = self.candidates(site, &entries);
        let coded = self.code_by(coder, site, &entries, &candidates, value);
        self.learn(site, &entries, &candidates, coded);
        coded
    }

    #[inline]
    fn entries(&mut self, site: &Site) -> Entries {
        let column = site.column as usize;
        if self.of_column.len() <= column {
            self.of_column.resize(column + 1, 0);
        }
        let [a, b, c] = self.last;
        Entries {
            key: slot(site.key.into(), 0),
            keys: slot(site.key.into(), u64::from(self.key) + 1),
            column,
            after: slot(a as u64, b as u64),
            after_steps: slot(a.wrapping_sub(b) as u64, b.wrapping_sub(c) as u64),
        }
    }

    /// The predictions of all candidates.
    #[inline]
    fn candidates(&self, site: &Site, entries: &Entries) -> [i64; CANDIDATES] {
        let [last, before, _] = self.last;
        let step = last.wrapping_sub(before);
        let [of_key, before_of_key, off] = self.of_key[entries.key];
        // The difference between the last record and the one before it with the same key.
        let change = last.wrapping_sub(self.of_key[slot(self.key.into(), 0)][1]);
        let [lagged, before_lagged] = site.lagged.unwrap_or([last; 2]);
        let geometry = site.geometry.unwrap_or(last);
        [
            last,
            last.wrapping_add(step),
            last.wrapping_add(self.of_keys[entries.keys]),
            of_key,
            of_key.wrapping_add(of_key.wrapping_sub(before_of_key)),
            of_key.wrapping_add(change),
            if entries.column > 0 { self.of_column[entries.column] } else { last },
            lagged,
            lagged.wrapping_add(last.wrapping_sub(before_lagged)),
            self.after[entries.after],
            last.wrapping_add(self.after_steps[entries.after_steps]),
            geometry,
            if site.geometry.is_some() { geometry.wrapping_add(off) } else { last },
        ]
    }

    /// The candidate of a bit mask that was right most often, the first one on ties.
    #[inline(always)]
    fn likeliest(&self, left: u32) -> Option<usize> {
        let of_most = (0..CANDIDATES).fold((CANDIDATES, -1.0), |(best, most), at| {
            let score = if left >> at & 1 == 1 { self.scores[at] } else { -1.0 };
            if score > most { (at, score) } else { (best, most) }
        });
        Some(of_most.0).filter(|&best| best < CANDIDATES)
    }

    /// Codes an integer, given its predictions.
    #[inline]
    fn code_by<C: BitCoder>(
        &mut self,
        coder: &mut C,
        site: &Site,
        entries: &Entries,
        candidates: &[i64; CANDIDATES],
        value: i64,
    ) -> i64 {
        // Bit mask of the candidates that are not excluded yet.
        let mut left = (1u32 << CANDIDATES) - 1;
        for attempt in 0..TRIES {
            let Some(best) = self.likeliest(left) else { break };
            let expected = candidates[best];
            // Bit mask of the candidates with the same prediction, all of which are excluded if it is wrong.
            let alike = alike(candidates, expected);
            left &= !alike;
            let trust = ones(alike).fold(0.0, |trust, at| trust + self.scores[at]);
            let alike = alike as usize;
            let context = attempt | (self.history & 0xff) << 2;
            let places = [
                context,
                attempt | best << 2 | level(self.scores[best]) << 6 | (self.history & 7) << 11,
                attempt | alike << 2 & (PLACES - 1),
                slot(site.key.into(), (attempt as u64) << 32 | 1 << 40),
                attempt | level(trust / 4.0) << 2 | (entries.keys & 0x7f) << 7,
            ];
            let hit = self.hits.code(
                coder,
                attempt,
                &places.map(|place| place & (PLACES - 1)),
                0.0,
                value == expected,
            );
            if hit {
                self.history = self.history << 2 | attempt.min(2) + 1;
                return expected;
            }
        }
        self.history <<= 2;
        let nearest =
            (0..CANDIDATES).reduce(|a, b| if self.errors[b] < self.errors[a] { b } else { a }).unwrap_or(0);
        let expected = candidates[nearest];
        let difference = zigzag(value.wrapping_sub(expected));
        if self.is_long.code(coder, difference >> LONGEST > 0) {
            return coder.code_plain(value as u64, 64) as i64;
        }
        let model = &mut self.differences[(self.errors[nearest] as usize).min(ERROR_LEVELS - 1)];
        expected.wrapping_add(unzigzag(model.code(coder, difference)))
    }

    #[inline]
    fn learn(&mut self, site: &Site, entries: &Entries, candidates: &[i64; CANDIDATES], value: i64) {
        for (score, candidate) in self.scores.iter_mut().zip(candidates) {
            let right = if *candidate == value { 1.0 } else { 0.0 };
            *score += (right - *score) * (1.0 / 32.0);
        }
        // How far predictions were off matters only where none was right.
        if self.history & 3 == 0 {
            for (error, candidate) in self.errors.iter_mut().zip(candidates) {
                let off = candidate.wrapping_sub(value).unsigned_abs();
                let half_bits = (2 * (u64::BITS - off.leading_zeros())) as f32;
                *error += (half_bits - *error) * (1.0 / 4.0);
            }
        }
        let [last, before, _] = self.last;
        self.after[entries.after] = value;
        self.after_steps[entries.after_steps] = value.wrapping_sub(last);
        self.of_keys[entries.keys] = value.wrapping_sub(last);
        self.of_column[entries.column] = value;
        let [of_key, _, _] = self.of_key[entries.key];
        let off = site.geometry.map_or(0, |geometry| value.wrapping_sub(geometry));
        self.of_key[entries.key] = [value, of_key, off];
        self.last = [value, last, before];
        self.key = site.key;
    }
}

/// Bit mask of the candidates that equal this integer.
#[inline(always)]
fn alike(candidates: &[i64; CANDIDATES], integer: i64) -> u32 {
    (0..CANDIDATES).fold(0, |alike, at| alike | u32::from(candidates[at] == integer) << at)
}

/// The positions of the ones in a bit mask, ascending.
#[inline(always)]
fn ones(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = bits.trailing_zeros() as usize;
        (bits > 0).then(|| {
            bits &= bits - 1;
            place
        })
    })
}

/// A share of 1 as one of 32 levels.
fn level(part: f32) -> usize {
    ((part * 32.0) as usize).min(31)
}

/// The hash of two numbers, as an index of a table of [`ENTRIES`].
#[inline(always)]
pub fn slot(a: u64, b: u64) -> usize {
    let mixed =
        (a.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ b.rotate_left(29)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    ((mixed ^ mixed >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (u64::BITS - TABLE_BITS)) as usize
}
