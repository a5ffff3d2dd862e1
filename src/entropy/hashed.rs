//! Counters for more contexts than fit into memory. They are found by a hash, and those that are rarely used
//! are replaced by counters of new contexts. FORMAT.md 6.4.

use super::Logistic;

/// Levels of the tree that one lookup covers.
pub const LINE_LEVELS: u32 = 4;
/// Bits of the hash that a line stores to recognise its context.
const TAG_BITS: u32 = 12;
const TAG_MASK: u16 = (1 << TAG_BITS) - 1;
/// The increment of a line's use count.
const USE: u16 = 1 << TAG_BITS;

/// A probability of 12 bits, followed by the number of bits that it is based on, of 4 bits.
#[derive(Clone, Copy, Debug)]
struct SmallCounter(u16);

const COUNT_BITS: u32 = 4;
const COUNT_MASK: u16 = (1 << COUNT_BITS) - 1;
/// From this value on, counts stand for increasing numbers of bits.
const EXACT_COUNTS: i32 = 8;

/// For each count: the rate, in 1/65536, at which the next bit changes the probability.
static RATES: [i32; 1 << COUNT_BITS] = {
    let mut rates = [0; 1 << COUNT_BITS];
    let mut count = 0;
    while count < rates.len() as i32 {
        let more = if count > EXACT_COUNTS { 4 * (count - EXACT_COUNTS) } else { 0 };
        // 1 / (count + 1.5 + more)
        rates[count as usize] = 131_072 / (2 * (count + more) + 3);
        count += 1;
    }
    rates
};

impl SmallCounter {
    const START: Self = SmallCounter(1 << 15);

    #[inline]
    fn opinion(self, tables: &Logistic) -> f32 {
        tables.believed(usize::from(self.0 >> COUNT_BITS), usize::from(self.0 & COUNT_MASK))
    }

    #[inline]
    fn after(self, bit: bool) -> Self {
        let count = self.0 & COUNT_MASK;
        let p = i32::from(self.0 >> COUNT_BITS);
        let target = if bit { (1 << (16 - COUNT_BITS)) - 1 } else { 0 };
        let p = p + (((target - p) * RATES[usize::from(count)] + (1 << 15)) >> 16);
        SmallCounter((p as u16) << COUNT_BITS | (count + 1).min(COUNT_MASK))
    }
}

/// The counters of one context for [`LINE_LEVELS`] levels of a tree: half a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub struct Line {
    /// First the tag: the number of lookups, up to 15, above the lowest bits of the hash. Then one counter
    /// for each node of the tree.
    cells: [u16; 1 << LINE_LEVELS],
}

impl Line {
    const fn new(tag: u16) -> Self {
        let mut cells = [SmallCounter::START.0; 1 << LINE_LEVELS];
        cells[0] = tag;
        Line { cells }
    }

    /// The log odds of a 1 at a node (1 to 15) of the tree of four levels.
    #[inline]
    pub fn opinion(&self, tables: &Logistic, place: usize) -> f32 {
        SmallCounter(self.cells[place % (1 << LINE_LEVELS)]).opinion(tables)
    }

    /// Learns from a bit at a node.
    #[inline]
    pub fn learn(&mut self, place: usize, bit: bool) {
        let cell = &mut self.cells[place % (1 << LINE_LEVELS)];
        *cell = SmallCounter(*cell).after(bit).0;
    }
}

/// The two lines in which a context may be, loaded together.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Pair([Line; 2]);

/// Lines of counters, found by hash.
#[derive(Clone, Debug)]
pub struct HashedCounters {
    pairs: Vec<Pair>,
    index_bits: u32,
}

/// The two lines in which a context may be.
#[derive(Clone, Copy, Debug, Default)]
pub struct Candidates {
    hash: u32,
    tags: [u16; 2],
}

impl HashedCounters {
    /// Creates 2^`index_bits` lines of 32 bytes; `index_bits` is from 2 to 20.
    pub fn new(index_bits: u32) -> Self {
        HashedCounters { pairs: vec![Pair([Line::new(0); 2]); 1 << (index_bits - 1)], index_bits }
    }

    /// The binary logarithm of the number of lines.
    pub fn index_bits(&self) -> u32 {
        self.index_bits
    }

    /// Prefetches the lines in which a context may be. Calling this for several tables before the first
    /// [`line`](Self::line) lets the processor load all of them at the same time.
    #[inline]
    pub fn candidates(&self, hash: u32) -> Candidates {
        let Pair(lines) = &self.pairs[self.pair(hash)];
        Candidates { hash, tags: [lines[0].cells[0], lines[1].cells[0]] }
    }

    #[inline]
    fn pair(&self, hash: u32) -> usize {
        (hash >> (33 - self.index_bits)) as usize
    }

    /// The line of a context. If the context has none, it takes over the candidate that was looked up less
    /// often, or, if both are equal, the one that its hash selects.
    #[inline]
    pub fn line(&mut self, candidates: Candidates) -> &mut Line {
        let Candidates { hash, tags } = candidates;
        let tag = hash as u16 & TAG_MASK;
        let pair = self.pair(hash);
        let first = (hash >> (32 - self.index_bits)) as usize & 1;
        let Pair(lines) = &mut self.pairs[pair];
        let is_its = |line: usize| tags[line] & TAG_MASK == tag && tags[line] >= USE;
        let line = if is_its(first) {
            first
        } else if is_its(1 - first) {
            1 - first
        } else {
            let uses = tags.map(|tag| tag >> TAG_BITS);
            let line = if uses[first] <= uses[1 - first] { first } else { 1 - first };
            let spared = &mut lines[1 - line].cells[0];
            *spared = spared.checked_sub(USE).unwrap_or(*spared);
            lines[line] = Line::new(tag);
            line
        };
        let line = &mut lines[line];
        line.cells[0] = line.cells[0].checked_add(USE).unwrap_or(line.cells[0]);
        line
    }
}

/// A hash of a view's number and a context.
#[inline]
pub fn hash(view: usize, context: u32) -> u32 {
    let mixed = context.wrapping_add((view as u32).wrapping_mul(0x3c6e_f372)).wrapping_mul(0x9e37_79b1);
    (mixed ^ mixed >> 15).wrapping_mul(0x85eb_ca6b)
}

/// The hash for the next levels of the tree, below `node`, in the same context.
#[inline]
pub fn hash_below(hash: u32, node: usize) -> u32 {
    (hash ^ (node as u32).wrapping_mul(0x2545_f491)).wrapping_mul(0x9e37_79b1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_counters_go_where_the_bits_go() {
        let tables = Logistic::tables();
        let mut counter = SmallCounter::START;
        assert_eq!(counter.opinion(tables), 0.0);
        (0..500).for_each(|_| counter = counter.after(true));
        assert!(counter.opinion(tables) > 3.0);
        (0..500).for_each(|_| counter = counter.after(false));
        assert!(counter.opinion(tables) < -3.0);
    }

    #[test]
    fn a_line_is_found_again_until_it_is_given_up() {
        let tables = Logistic::tables();
        let mut counters = HashedCounters::new(2);
        // All of these share one pair of lines.
        let opinion = |counters: &mut HashedCounters, hash: u32| {
            let candidates = counters.candidates(hash);
            let line = counters.line(candidates);
            (0..20).for_each(|_| line.learn(3, hash == 1));
            line.opinion(tables, 3)
        };
        let often = (0..20).map(|_| opinion(&mut counters, 1)).fold(0.0, f32::max);
        assert!(often > 1.0);
        assert!((2..8).all(|other| opinion(&mut counters, other) < -1.0));
        let candidates = counters.candidates(1);
        assert_eq!(counters.line(candidates).opinion(tables, 3), often);
        // Each of the others lowers the line's use count, until one replaces it.
        for hash in (8..40).chain([1]) {
            let candidates = counters.candidates(hash);
            counters.line(candidates);
        }
        let candidates = counters.candidates(1);
        assert_eq!(counters.line(candidates).opinion(tables, 3), 0.0);
    }
}
