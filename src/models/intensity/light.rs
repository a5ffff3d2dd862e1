//! Intensity levels, mixed from two views of the preceding levels and one of the reference: the fastest of
//! the adaptive models. FORMAT.md 8.5, "Levels, unless `coder` is 1".

use std::hint::select_unpredictable;
use std::mem::take;

use super::{IntensityNeighbours, TYPICAL_LEVEL};
use crate::entropy::{BitCoder, Counter, Logistic};

/// Binary logarithm of the number of slots of each view, for small frames and for large ones; contexts share
/// slots. Initialising tables for more contexts than a frame has values would take longer than coding the
/// frame.
const SLOT_BITS: (u32, u32) = (6, 13);
/// Context levels of a return.
const CONTEXT_LEVELS: usize = 128;
/// Initial weights for two opinions and for three. Their sum is above 1, as several opinions carry more
/// information than one, but less than proportionally, since much of it is shared.
const OF_TWO: f32 = 0.55;
const OF_THREE: f32 = 0.45;
/// The learning rate of the weights.
const RATE: f32 = 0.02;
/// Counters copied from the neighbouring row count as this many values at most.
const INHERITED: u32 = 4;

/// The adaptive models of intensity levels, by the largest number of bits of a level so far, but at least 7.
#[derive(Clone)]
pub enum LightLevels {
    Seven(LevelViews<128>),
    Eight(LevelViews<256>),
    Nine(LevelViews<512>),
}

impl Default for LightLevels {
    fn default() -> Self {
        LightLevels::Seven(LevelViews::default())
    }
}

impl LightLevels {
    /// Starts an image with these numbers of rows and values, or its strays. If its levels have more bits
    /// than any before, the models start anew.
    pub fn start_frame(&mut self, bits: u32, rows: usize, values: usize) {
        match self {
            Self::Seven(_) if bits == 8 => *self = Self::Eight(LevelViews::default()),
            Self::Seven(_) | Self::Eight(_) if bits > 8 => *self = Self::Nine(LevelViews::default()),
            _ => {}
        }
        match self {
            Self::Seven(views) => views.start_frame(rows, values),
            Self::Eight(views) => views.start_frame(rows, values),
            Self::Nine(views) => views.start_frame(rows, values),
        }
    }

    /// Codes one level of `bits` bits. `row` serves only as a context.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        bits: u32,
        near: &IntensityNeighbours,
        row: usize,
        level: u32,
    ) -> u32 {
        match self {
            Self::Seven(views) => views.code(coder, bits, near, row, level),
            Self::Eight(views) => views.code(coder, bits, near, row, level),
            Self::Nine(views) => views.code(coder, bits, near, row, level),
        }
    }
}

/// The views of levels below `NODES`, a power of two, which is also the number of nodes in the tree of a
/// level's bits.
#[derive(Clone)]
pub struct LevelViews<const NODES: usize> {
    before: View<NODES>,
    of_row: RowView<NODES>,
    weights: Vec<[f32; 2]>,
    /// The view of the reference, and the weights of all three views.
    reference: View<NODES>,
    reference_weights: Vec<[f32; 3]>,
    tables: &'static Logistic,
}

impl<const NODES: usize> Default for LevelViews<NODES> {
    fn default() -> Self {
        LevelViews {
            before: View::default(),
            of_row: RowView::default(),
            weights: vec![[OF_TWO; 2]; NODES],
            reference: View::default(),
            reference_weights: vec![[OF_THREE; 3]; NODES],
            tables: Logistic::tables(),
        }
    }
}

impl<const NODES: usize> LevelViews<NODES> {
    fn start_frame(&mut self, rows: usize, values: usize) {
        let slot_bits = values.max(1).ilog2().clamp(SLOT_BITS.0, SLOT_BITS.1);
        self.before.grow(slot_bits);
        self.of_row.grow(slot_bits.min((CONTEXT_LEVELS * rows.max(1)).next_power_of_two().ilog2()));
    }

    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        bits: u32,
        near: &IntensityNeighbours,
        row: usize,
        level: u32,
    ) -> u32 {
        let or = |level: u16, other: u16| if level > 0 { level } else { other };
        let [_, north_west, north, north_east, _] = near.above;
        let west = or(near.left[0], or(north, or(north_west, or(north_east, TYPICAL_LEVEL))));
        let west2 = or(near.left[1], west);
        let [w, ww, www] = [west, west2, near.left[2]].map(usize::from);
        // The root of the subtree of all levels with `bits` bits.
        let root = NODES >> bits;
        let slot_bits = self.before.slot_bits;
        let before = self.before.slot((w / 2) << 16 | (ww / 2) << 8 | www / 8);
        let of_row = self.of_row.slot(row, w, root);
        if !C::ENCODES {
            touch(before);
            touch(of_row);
        }
        let tables = self.tables;
        let Some(back) = near.back else {
            return code_bits(coder, tables, (bits, level), &mut self.weights, [before, of_row]);
        };
        self.reference.grow(slot_bits);
        let reference = self.reference.slot(usize::from(back.level()) << 8 | w / 4);
        code_bits(coder, tables, (bits, level), &mut self.reference_weights, [before, of_row, reference])
    }
}

/// Slots of counters, one for each node of the tree of a level's bits.
#[derive(Clone, Default)]
struct View<const NODES: usize> {
    slots: Vec<[Counter; NODES]>,
    slot_bits: u32,
}

impl<const NODES: usize> View<NODES> {
    /// Makes room for 2^`slot_bits` slots; never shrinks. Learned counters are kept: each slot is copied for
    /// all contexts that shared it.
    fn grow(&mut self, slot_bits: u32) {
        if self.slots.is_empty() {
            self.slots = vec![[Counter::default(); NODES]; 1 << slot_bits];
            self.slot_bits = slot_bits;
        } else if slot_bits > self.slot_bits {
            let copies = 1 << (slot_bits - self.slot_bits);
            self.slots = self.slots.iter().flat_map(|slot| std::iter::repeat_n(*slot, copies)).collect();
            self.slot_bits = slot_bits;
        }
    }

    /// The counters of a context.
    #[inline(always)]
    fn slot(&mut self, context: usize) -> &mut [Counter; NODES] {
        &mut self.slots[((context as u32).wrapping_mul(0x9e37_79b1) >> (32 - self.slot_bits)) as usize]
    }
}

/// Slots of counters for each row and context level to the west, row after row. If there are too few slots,
/// rows whose distance is a power of two share them.
#[derive(Clone, Default)]
struct RowView<const NODES: usize> {
    slots: Vec<[Counter; NODES]>,
}

impl<const NODES: usize> RowView<NODES> {
    /// Makes room for 2^`slot_bits` slots; never shrinks. Rows that shared slots each keep a copy of the
    /// learned counters.
    fn grow(&mut self, slot_bits: u32) {
        let slots = 1 << slot_bits;
        if self.slots.is_empty() {
            self.slots = vec![[Counter::default(); NODES]; slots];
        } else if slots > self.slots.len() {
            self.slots = self.slots.repeat(slots / self.slots.len());
        }
    }

    /// The counters of a row and a context level to the west, from 1 on. They start as a copy of those of the
    /// row above.
    #[inline(always)]
    fn slot(&mut self, row: usize, west: usize, root: usize) -> &mut [Counter; NODES] {
        let last = self.slots.len() - 1;
        let place = (row * CONTEXT_LEVELS + west - 1) & last;
        // The counter at the root has seen every value of its slot.
        if self.slots[place][root % NODES].is_new() && row > 0 {
            let above = place.wrapping_sub(CONTEXT_LEVELS) & last;
            self.slots[place] = self.slots[above].map(|counter| counter.based_on(INHERITED));
        }
        &mut self.slots[place]
    }
}

/// Prefetches the counters of a slot, except those of the lowest level of the tree, which are half of them. A
/// decoder learns only bit by bit which of them it needs, and would otherwise wait for memory each time.
#[inline(always)]
fn touch<const NODES: usize>(slot: &[Counter; NODES]) {
    /// Counters in a cache line.
    const LINE: usize = 16;
    let lines = slot[..NODES / 2].iter().step_by(LINE);
    std::hint::black_box(lines.fold(0, |all, counter| all ^ counter.bits()));
}

/// The views' opinions on the next bit, and their mix.
#[derive(Clone, Copy)]
struct Odds<const N: usize> {
    /// The opinions.
    opinions: [f32; N],
    /// The probability of a 1, in 1/65536.
    p: u32,
}

impl<const N: usize> Odds<N> {
    #[inline(always)]
    fn at<const NODES: usize>(
        tables: &Logistic,
        weights: &[[f32; N]],
        views: &[&mut [Counter; NODES]; N],
        node: usize,
    ) -> Self {
        let mut opinions = [0.0; N];
        let mut odds = 0.0;
        for i in 0..N {
            opinions[i] = tables.opinion(views[i][node]);
            odds += weights[node][i] * opinions[i];
        }
        Odds { opinions, p: tables.squash(odds) }
    }
}

/// Codes the bits of a level, from the highest down, each from the weighted sum of the views' opinions;
/// counters and weights are adapted to it. The decoder computes the odds of the following bit for both values
/// of the current one before it knows that, so as not to wait for it.
#[inline(always)]
fn code_bits<C: BitCoder, const N: usize, const NODES: usize>(
    coder: &mut C,
    tables: &Logistic,
    (bits, level): (u32, u32),
    weights: &mut [[f32; N]],
    views: [&mut [Counter; NODES]; N],
) -> u32 {
    // A local variable may be kept in registers.
    let mut own = take(coder);
    let weights = &mut weights[..NODES];
    let mut node = NODES >> bits;
    let mut odds = Odds::at(tables, weights, &views, node);
    for i in (0..bits).rev() {
        let bit = level >> i & 1 == 1;
        let ahead = match (i > 0, C::ENCODES) {
            (false, _) => [odds; 2],
            (true, true) => [Odds::at(tables, weights, &views, (node << 1 | usize::from(bit)) % NODES); 2],
            (true, false) => [0, 1].map(|bit| Odds::at(tables, weights, &views, (node << 1 | bit) % NODES)),
        };
        let bit = own.code(bit, odds.p);
        let pull = ((i32::from(bit) << 16) - odds.p as i32) as f32 * (RATE / 65536.0);
        let at = node % NODES;
        for i in 0..N {
            weights[at][i] += pull * odds.opinions[i];
            views[i][at].learn(bit);
        }
        node = node << 1 | usize::from(bit);
        odds = select_unpredictable(bit, ahead[1], ahead[0]);
    }
    *coder = own;
    (node - NODES) as u32
}
