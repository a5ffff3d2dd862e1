//! Integers that nearly all follow from their places by one rule. A bit per integer says whether it follows
//! the rule, unless the encoder declared that it does; other predictors are consulted only for integers that
//! do not. FORMAT.md 8.9, "Rules".

use super::integers::{ENTRIES, IntegersModel, Site, slot};
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::floats::{of_rank, rank};

/// What an integer follows from, relative to what the position or the place implies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// A constant of its beam.
    Beam,
    /// A constant of its beam plus one of its column.
    Column,
    /// The integer that its beam had the last time that the integer before was the same.
    After,
    /// A constant of its beam plus one of its azimuth tick: the time of a firing, if the columns of an image
    /// are directions rather than firings.
    Tick,
    /// A constant of its beam, a different one in each of this number of columns in turn, plus a base that
    /// changes seldom: the time of a packet, and that of a firing in it. Frames start anywhere in a packet;
    /// see [`RuleModel::code_phase`]. Sums in single precision are rounded; see [`RoundedSums`].
    Turn(u8),
}

/// The numbers of no rule and of the first rules; `Turn` has all numbers from its own on.
const NONE: u8 = 0;
pub const BEAM: u8 = 1;
pub const COLUMN: u8 = 2;
pub const AFTER: u8 = 3;
pub const TICK: u8 = 4;
pub const TURN: u8 = TICK + 1;

impl Rule {
    /// The largest number of columns in turn.
    pub const MOST_COLUMNS: u8 = u8::MAX - TICK;

    /// The number in the stream; 0 for no rule.
    pub fn to_code(rule: Option<Rule>) -> u8 {
        match rule {
            None => NONE,
            Some(Rule::Beam) => BEAM,
            Some(Rule::Column) => COLUMN,
            Some(Rule::After) => AFTER,
            Some(Rule::Tick) => TICK,
            Some(Rule::Turn(columns)) => TICK + columns,
        }
    }

    /// The same rule, given the number of its kind as a constant: loops are then compiled without branches on
    /// the kind.
    #[inline(always)]
    pub fn of_kind<const KIND: u8>(self) -> Self {
        match KIND {
            BEAM => Rule::Beam,
            COLUMN => Rule::Column,
            AFTER => Rule::After,
            TICK => Rule::Tick,
            _ => Rule::Turn(self.columns() as u8),
        }
    }

    /// The number of columns with constants of their own.
    fn columns(self) -> u32 {
        if let Rule::Turn(columns) = self { u32::from(columns).max(1) } else { 1 }
    }

    /// The rule with this number, if any.
    pub fn from_code(code: u8) -> Option<Self> {
        match code {
            NONE => None,
            BEAM => Some(Rule::Beam),
            COLUMN => Some(Rule::Column),
            AFTER => Some(Rule::After),
            TICK => Some(Rule::Tick),
            _ => Some(Rule::Turn(code - TICK)),
        }
    }
}

/// Contexts of whether the rule is right: the last two answers, whether the column is a new one, and its
/// number among the columns in turn.
const CONTEXTS: usize = 4 * 2 * TURN_CONTEXTS;
const TURN_CONTEXTS: usize = 32;

/// Adaptive models of the integers of a column that follow a rule.
#[derive(Clone)]
pub struct RuleModel {
    state: RuleState,
    is_right: Vec<AdaptiveBit>,
    /// Differences between the integers that break the rule and the expected ones.
    misses: Option<IntegersModel>,
    doubted: IntegerModel,
    doubts_new_columns: AdaptiveBit,
}

/// The records of a column in which the rule may be wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Doubts {
    /// The number of such records at the start.
    first: u64,
    /// And each record in another column than the record before it.
    new_columns: bool,
}

impl Doubts {
    /// Whether the rule is right for all records.
    pub fn is_empty(&self) -> bool {
        *self == Doubts::default()
    }
}

/// Constants by entry, all unknown at first.
#[derive(Clone)]
struct Constants<T> {
    /// Up to the highest entry that is known.
    known: Vec<Option<T>>,
}

impl<T> Default for Constants<T> {
    fn default() -> Self {
        Constants { known: Vec::new() }
    }
}

impl<T: Copy> Constants<T> {
    #[inline(always)]
    fn get(&self, entry: usize) -> Option<T> {
        self.known.get(entry).copied().flatten()
    }

    fn set(&mut self, entry: usize, constant: T) {
        if self.known.len() <= entry {
            self.known.resize(entry + 1, None);
        }
        self.known[entry] = Some(constant);
    }
}

/// What the rule predicts from the integers so far. They count relative to what the position or the place
/// implies, or to 0.
#[derive(Clone, Default)]
pub struct RuleState {
    /// The number among the columns in turn that column 0 of the frame has.
    phase: u32,
    /// The last column, and its number among the columns in turn: divisions are slow.
    turn: (u32, u32),
    /// By key and by the column's number among those in turn, see [`entry`]: the integer minus its base.
    offsets: Constants<i64>,
    /// By hash of the key and the last integer: the integer that followed.
    after: Vec<Option<i64>>,
    /// The same for sums that are rounded, which have a base of their own.
    rounded: RoundedSums,
    are_rounded: bool,
    /// By column, or by tick: the base.
    bases: Constants<i64>,
    base: i64,
    /// If the last integer broke the rule: the base before it, its entry among the offsets, and the integer.
    missed: Option<(i64, usize, i64)>,
    last: i64,
    last_column: u32,
    /// Whether the last integers followed the rule, a bit each.
    history: usize,
}

impl Default for RuleModel {
    fn default() -> Self {
        RuleModel {
            state: RuleState::default(),
            is_right: vec![AdaptiveBit::default(); CONTEXTS],
            misses: None,
            doubted: IntegerModel::default(),
            doubts_new_columns: AdaptiveBit::default(),
        }
    }
}

/// The integer that is expected at a site, and the table entries that it comes from.
struct Expected {
    integer: i64,
    offset: usize,
    after: usize,
    column: usize,
    context: usize,
}

impl RuleModel {
    /// Allocates the tables of a rule, before its first integer. `are_singles`: integers are ranks of float32
    /// values.
    pub fn prepare(&mut self, rule: Rule, are_singles: bool) {
        self.state.prepare(rule, are_singles);
    }

    /// Codes which of the columns in turn a frame starts with. The encoder passes its integers, each with the
    /// site of its record.
    pub fn code_phase<C: BitCoder>(
        &mut self,
        coder: &mut C,
        rule: Rule,
        known: impl Iterator<Item = Option<(Site, i64)>>,
    ) {
        if rule.columns() > 1 {
            let phase = if C::ENCODES { self.state.likely_phase(rule, known) } else { 0 };
            self.state.phase = coder.code_plain(phase.into(), 8) as u32;
            self.state.turn = (0, self.state.phase % rule.columns());
        }
    }

    /// Codes for which of the next integers the rule may be wrong. The encoder passes these integers, each
    /// with the site of its record, or `None` if it is off the scale; it also gets the state after all of
    /// them.
    #[inline(always)]
    pub fn code_doubts<C: BitCoder>(
        &mut self,
        coder: &mut C,
        rule: Rule,
        known: impl Iterator<Item = Option<(Site, i64)>>,
    ) -> (Doubts, Option<RuleState>) {
        let mut doubts = Doubts::default();
        let mut learned = None;
        if C::ENCODES {
            let state = learned.insert(self.state.clone());
            // The number of records up to the last one that breaks the rule, and up to the last such record
            // that is not in a new column.
            let (mut of_any, mut of_others) = (0, 0);
            for (record, known) in (1..).zip(known) {
                let Some((site, integer)) = known else { continue };
                let is_new = site.column != state.last_column;
                if !state.is_right(rule, &site, integer) {
                    of_any = record;
                    of_others = if is_new { of_others } else { record };
                }
            }
            doubts = Doubts { first: of_others, new_columns: of_any > of_others };
        }
        doubts.first = self.doubted.code(coder, doubts.first);
        doubts.new_columns = self.doubts_new_columns.code(coder, doubts.new_columns);
        (doubts, learned)
    }

    /// Adopts the state after integers that all follow the rule, as if they had been coded.
    pub fn know(&mut self, learned: RuleState) {
        self.state = learned;
    }

    /// The integer of a record, of integers that all follow the rule.
    #[inline(always)]
    pub fn follow(&mut self, rule: Rule, site: &Site) -> i64 {
        self.state.follow(rule, site)
    }

    /// Codes the integer of a record.
    #[inline(always)]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        rule: Rule,
        doubts: Doubts,
        record: usize,
        site: &Site,
        value: i64,
    ) -> i64 {
        let implied = site.geometry.unwrap_or(0);
        let value = value.wrapping_sub(implied);
        let expected = self.state.expected(rule, site);
        let is_new = site.column != self.state.last_column;
        let is_doubted = (record as u64) < doubts.first || doubts.new_columns && is_new;
        debug_assert!(!C::ENCODES || is_doubted || value == expected.integer);
        let is_right = !is_doubted || self.is_right[expected.context].code(coder, value == expected.integer);
        let above =
            if is_right { 0 } else { self.code_miss(coder, site.key, value.wrapping_sub(expected.integer)) };
        let coded = expected.integer.wrapping_add(above);
        self.state.learn(rule, site, &expected, coded);
        coded.wrapping_add(implied)
    }

    /// Codes the difference of an integer from the expected one.
    #[cold]
    fn code_miss<C: BitCoder>(&mut self, coder: &mut C, key: u32, above: i64) -> i64 {
        let site = Site { key, ..Site::default() };
        self.misses.get_or_insert_default().code(coder, &site, above)
    }
}

impl RuleState {
    /// See [`RuleModel::prepare`].
    pub fn prepare(&mut self, rule: Rule, are_singles: bool) {
        self.are_rounded = are_singles && matches!(rule, Rule::Turn(_));
        self.turn = (0, self.phase % rule.columns());
        if rule == Rule::After {
            self.after.resize(ENTRIES, None);
        }
    }

    /// Learns the next integer. Returns whether it is the expected one.
    #[inline(always)]
    pub fn is_right(&mut self, rule: Rule, site: &Site, value: i64) -> bool {
        let value = value.wrapping_sub(site.geometry.unwrap_or(0));
        let expected = self.expected(rule, site);
        self.learn(rule, site, &expected, value);
        value == expected.integer
    }

    /// The next integer, which is the expected one.
    #[inline(always)]
    pub fn follow(&mut self, rule: Rule, site: &Site) -> i64 {
        let expected = self.expected(rule, site);
        self.learn(rule, site, &expected, expected.integer);
        expected.integer.wrapping_add(site.geometry.unwrap_or(0))
    }

    /// The phase with which the base changes least often in a frame, given the offsets of earlier frames.
    fn likely_phase(&self, rule: Rule, known: impl Iterator<Item = Option<(Site, i64)>>) -> u32 {
        /// The number of records that are examined: of a few packets.
        const SAMPLE: usize = 1024;
        let known: Vec<(Site, i64)> = known.flatten().take(SAMPLE).collect();
        // Counts up to `most` changes.
        let changes = |phase: u32, most: usize| {
            let sums = known.iter().map(|(site, integer)| {
                let column = site.column.wrapping_add(phase) % rule.columns();
                (entry(rule, site.key, column), integer.wrapping_sub(site.geometry.unwrap_or(0)))
            });
            if self.are_rounded {
                return self.rounded.changes(sums, most);
            }
            let bases =
                sums.filter_map(|(entry, integer)| Some(integer.wrapping_sub(self.offsets.get(entry)?)));
            let mut last = None;
            bases.filter(|&base| last.replace(base) != Some(base)).take(most).count()
        };
        let (mut likely, mut least) = (0, usize::MAX);
        for phase in 0..rule.columns() {
            let changes = changes(phase, least);
            if changes < least {
                (likely, least) = (phase, changes);
            }
        }
        likely
    }

    #[inline(always)]
    fn expected(&mut self, rule: Rule, site: &Site) -> Expected {
        let phase = match rule {
            Rule::Turn(_) => {
                if site.column != self.turn.0 {
                    self.turn = (site.column, site.column.wrapping_add(self.phase) % rule.columns());
                }
                self.turn.1
            }
            _ => 0,
        };
        let offset = entry(rule, site.key, phase);
        let mut expected = Expected {
            integer: 0,
            offset,
            after: 0,
            column: site.column as usize,
            context: self.history & 3
                | usize::from(site.column != self.last_column) << 2
                | (phase as usize % TURN_CONTEXTS) << 3,
        };
        let above = |base: i64| base.wrapping_add(self.offsets.get(offset).unwrap_or(0));
        expected.integer = match rule {
            Rule::Beam => above(0),
            Rule::Turn(_) if self.are_rounded => self.rounded.expected(offset),
            Rule::Turn(_) => above(self.base),
            Rule::Column | Rule::Tick => above(self.bases.get(expected.column).unwrap_or(0)),
            Rule::After => {
                expected.after = slot(site.key.into(), self.last as u64);
                self.after[expected.after].unwrap_or_else(|| above(self.base))
            }
        };
        expected
    }

    #[inline(always)]
    fn learn(&mut self, rule: Rule, site: &Site, expected: &Expected, value: i64) {
        let is_right = value == expected.integer;
        self.history = self.history << 1 | usize::from(is_right);
        self.last_column = site.column;
        if self.are_rounded {
            return self.rounded.learn(expected.offset, value);
        }
        let offset = self.offsets.get(expected.offset);
        // Most integers follow the rule, and these rules learn nothing new from them.
        match rule {
            Rule::Beam if is_right && offset.is_some() => return,
            Rule::Turn(_) if is_right && offset.is_some() => return self.missed = None,
            _ => {}
        }
        match rule {
            Rule::Beam => self.offsets.set(expected.offset, value),
            Rule::Column | Rule::Tick => match (self.bases.get(expected.column), offset) {
                (Some(base), None) => self.offsets.set(expected.offset, value.wrapping_sub(base)),
                (None, None) => {
                    self.offsets.set(expected.offset, 0);
                    self.bases.set(expected.column, value);
                }
                (_, Some(offset)) => self.bases.set(expected.column, value.wrapping_sub(offset)),
            },
            Rule::Turn(_) => self.learn_base(expected.offset, value),
            Rule::After => {
                self.learn_base(expected.offset, value);
                self.after[expected.after] = Some(value);
                self.last = value;
            }
        }
    }

    /// Learns an integer above a base. If it is not the expected one, the base has changed, unless the next
    /// integer is above the earlier base again: then only the constant of this integer has changed.
    fn learn_base(&mut self, entry: usize, value: i64) {
        let missed = self.missed.take();
        let Some(offset) = self.offsets.get(entry) else {
            return self.offsets.set(entry, value.wrapping_sub(self.base));
        };
        let base = value.wrapping_sub(offset);
        if base == self.base {
            return;
        }
        match missed {
            Some((before, entry, missed)) if base == before => {
                self.offsets.set(entry, missed.wrapping_sub(before));
            }
            _ => self.missed = Some((self.base, entry, value)),
        }
        self.base = base;
    }
}

/// Sums of a base and a constant that were rounded to single precision: `t = f32(base + offset)`. A sum shows
/// its base only to within half a unit in its last place; several sums narrow it down. All in double
/// precision.
#[derive(Clone, Default)]
struct RoundedSums {
    /// By entry, as for other sums.
    offsets: Constants<RoundedOffset>,
    /// The least and the largest possible base.
    base: [f64; 2],
    /// If the last sum contradicted the base: the base before it, its entry, and the sum.
    missed: Option<([f64; 2], usize, f64)>,
}

/// A constant, and how far it may be off.
#[derive(Clone, Copy)]
struct RoundedOffset {
    value: f64,
    error: f64,
}

impl RoundedSums {
    /// The rank of the sum that is expected of an entry.
    fn expected(&self, entry: usize) -> i64 {
        let offset = self.offsets.get(entry).map_or(0.0, |offset| offset.value);
        let sum = (middle(self.base) + offset) as f32;
        // Processors differ in the bits of a NaN that they compute.
        if sum.is_nan() { 0 } else { rank(sum) }
    }

    /// Learns from the rank of a sum.
    fn learn(&mut self, entry: usize, rank: i64) {
        let missed = self.missed.take();
        let Some((sum, half)) = rounded(rank) else { return };
        let Some(offset) = self.offsets.get(entry) else {
            return self.offsets.set(entry, self.offset(sum, half, self.base));
        };
        let possible = offset.base_of(sum, half);
        match both(self.base, possible) {
            Some(base) => self.base = base,
            None => match missed.and_then(|(before, entry, sum)| Some((both(before, possible)?, entry, sum)))
            {
                // The constant of the last sum has changed, not the base.
                Some((base, entry, sum)) => {
                    self.base = base;
                    self.offsets.set(entry, self.offset(sum, half, base));
                }
                None => {
                    self.missed = Some((self.base, entry, sum));
                    self.base = possible;
                }
            },
        }
        let again = self.offset(sum, half, self.base);
        if again.error < offset.error {
            self.offsets.set(entry, again);
        }
    }

    /// The constant that is added to a base to give a sum, itself known to within `half`.
    fn offset(&self, sum: f64, half: f64, base: [f64; 2]) -> RoundedOffset {
        RoundedOffset { value: sum - middle(base), error: half + 0.5 * (base[1] - base[0]) }
    }

    /// How often the base changes from sum to sum, each with its entry; `most` if it is more often.
    fn changes(&self, sums: impl Iterator<Item = (usize, i64)>, most: usize) -> usize {
        let bases = sums.filter_map(|(entry, rank)| {
            let (sum, half) = rounded(rank)?;
            Some(self.offsets.get(entry)?.base_of(sum, half))
        });
        let mut last = [f64::NEG_INFINITY, f64::INFINITY];
        let changes = |base: &[f64; 2]| {
            let shared = both(last, *base);
            last = shared.unwrap_or(*base);
            shared.is_none()
        };
        bases.filter(changes).take(most).count()
    }
}

impl RoundedOffset {
    /// The least and the largest base of a sum that is known to within `half`.
    fn base_of(&self, sum: f64, half: f64) -> [f64; 2] {
        [sum - self.value - (half + self.error), sum - self.value + (half + self.error)]
    }
}

/// The float32 value of a rank, and half a unit in its last place; `None` if it is not finite.
fn rounded(rank: i64) -> Option<(f64, f64)> {
    let sum = of_rank(rank);
    let above = sum.abs().next_up();
    above.is_finite().then(|| (f64::from(sum), 0.5 * (f64::from(above) - f64::from(sum.abs()))))
}

fn middle([least, largest]: [f64; 2]) -> f64 {
    0.5 * (least + largest)
}

/// What two intervals share.
fn both(a: [f64; 2], b: [f64; 2]) -> Option<[f64; 2]> {
    let shared = [a[0].max(b[0]), a[1].min(b[1])];
    (shared[0] <= shared[1]).then_some(shared)
}

/// The index of an offset: dense as long as keys are small, otherwise a hash.
#[inline(always)]
fn entry(rule: Rule, key: u32, phase: u32) -> usize {
    let entry = key as usize * rule.columns() as usize + phase as usize;
    if entry < ENTRIES { entry } else { slot(key.into(), phase.into()) }
}
