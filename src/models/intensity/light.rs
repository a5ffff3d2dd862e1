//! Intensity levels from two views of the levels before and one of the reference, mixed: the fastest of the
//! adaptive models.

use super::neighbours::{IntensityNeighbours, TYPICAL_LEVEL};
use super::scale::{IntensityScale, MOST_BITS};
use crate::entropy::{BitCoder, Counter, Logistic};

/// Slots of each view, as a power of two, for small frames and for large ones: contexts share them by hashing. Tables
/// for more contexts than a frame has values would take longer to make than the frame takes to be coded.
const SLOT_BITS: (u32, u32) = (6, 13);
/// Beams from this number on share their contexts.
const ROWS: usize = 128;
/// Initial weights of two opinions, and of three: several know more than one, but much of it is the same.
const OF_TWO: f32 = 0.55;
const OF_THREE: f32 = 0.45;
/// The learning rate of the weights.
const RATE: f32 = 0.02;
/// What a beam has learned counts for its neighbour as so many values at most.
const INHERITED: u32 = 4;
/// Nodes of the tree of a level's bits.
const NODES: usize = 1 << MOST_BITS;

/// What the coder has learned about intensity levels.
#[derive(Clone)]
pub struct LightLevels {
    views: [View; 2],
    weights: Vec<[f32; 2]>,
    /// The view of the reference, and the weights of all three views.
    reference: View,
    reference_weights: Vec<[f32; 3]>,
    tables: &'static Logistic,
}

impl Default for LightLevels {
    fn default() -> Self {
        LightLevels {
            views: Default::default(),
            weights: vec![[OF_TWO; 2]; NODES],
            reference: View::default(),
            reference_weights: vec![[OF_THREE; 3]; NODES],
            tables: Logistic::tables(),
        }
    }
}

impl LightLevels {
    /// Starts a frame of so many values, or its strays.
    pub fn start_frame(&mut self, scale: &IntensityScale, values: usize) {
        if scale.is_on_grid() {
            let slot_bits = values.max(1).ilog2().clamp(SLOT_BITS.0, SLOT_BITS.1);
            self.views.iter_mut().for_each(|view| view.grow(slot_bits, scale.bits()));
        }
    }

    /// Codes one level. `row` serves only as a context.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        row: usize,
        level: u32,
    ) -> u32 {
        let or = |level: u16, other: u16| if level > 0 { level } else { other };
        let [_, north_west, north, north_east, _] = near.above;
        let west = or(near.left[0], or(north, or(north_west, or(north_east, TYPICAL_LEVEL))));
        let west2 = or(near.left[1], west);
        let [w, ww, www] = [west, west2, near.left[2]].map(usize::from);
        let bits = scale.bits();
        let [before, of_row] = &mut self.views;
        let (slot_bits, level_bits) = (before.slot_bits, before.level_bits);
        let before = before.slot((w / 2) << 16 | (ww / 2) << 8 | www / 8);
        let of_row = of_row.slot_of_row(row.min(ROWS - 1), w);
        if !C::ENCODES {
            touch(&before[..1 << bits]);
            touch(&of_row[..1 << bits]);
        }
        let tables = self.tables;
        let Some(back) = near.back else {
            return code_bits(coder, tables, (bits, level), &mut self.weights, [before, of_row]);
        };
        self.reference.grow(slot_bits, level_bits);
        let reference = self.reference.slot(usize::from(back.level()) << 8 | w / 4);
        code_bits(coder, tables, (bits, level), &mut self.reference_weights, [before, of_row, reference])
    }
}

/// For each slot, a counter for each node of the tree of a level's bits.
#[derive(Clone, Default)]
struct View {
    counters: Vec<Counter>,
    slot_bits: u32,
    level_bits: u32,
}

impl View {
    /// Makes room for so many slots and levels; never shrinks. What has been learned stays with its contexts, whose
    /// slots are divided among them, unless levels have more bits than before.
    fn grow(&mut self, slot_bits: u32, level_bits: u32) {
        if level_bits > self.level_bits {
            self.slot_bits = self.slot_bits.max(slot_bits);
            self.level_bits = level_bits;
            self.counters.clear();
            self.counters.resize(1 << (self.slot_bits + level_bits), Counter::default());
        } else if slot_bits > self.slot_bits {
            let copies = 1 << (slot_bits - self.slot_bits);
            let slots = self.counters.chunks_exact(1 << self.level_bits);
            self.counters = slots.flat_map(|slot| slot.repeat(copies)).collect();
            self.slot_bits = slot_bits;
        }
    }

    /// The place of a context's first counter.
    #[inline(always)]
    fn place(&self, context: usize) -> usize {
        let slot = (context as u32).wrapping_mul(0x9e37_79b1) >> (32 - self.slot_bits);
        (slot as usize) << self.level_bits
    }

    /// The counters of a context.
    #[inline(always)]
    fn slot(&mut self, context: usize) -> &mut [Counter] {
        let place = self.place(context);
        &mut self.counters[place..][..1 << self.level_bits]
    }

    /// The counters of a level to the west in a row. At first they are those of the row above.
    #[inline(always)]
    fn slot_of_row(&mut self, row: usize, west: usize) -> &mut [Counter] {
        let place = self.place(row << 8 | west);
        // The first node has seen every value of its slot.
        if self.counters[place + 1].is_new() && row > 0 {
            let above = self.place((row - 1) << 8 | west);
            for node in 0..1 << self.level_bits {
                self.counters[place + node] = self.counters[above + node].based_on(INHERITED);
            }
        }
        &mut self.counters[place..][..1 << self.level_bits]
    }
}

/// Prefetches all counters of a slot at once. A decoder learns bit by bit which of them it needs, and would
/// otherwise wait for memory each time.
#[inline(always)]
fn touch(slot: &[Counter]) {
    /// Counters in a cache line.
    const LINE: usize = 16;
    let lines = slot.iter().step_by(LINE);
    std::hint::black_box(lines.fold(0, |all, counter| all ^ counter.bits()));
}

/// What views say of the next bit.
#[derive(Clone, Copy)]
struct Odds<const N: usize> {
    /// Their opinions.
    opinions: [f32; N],
    /// The probability of a 1, in 1/65536.
    p: u32,
}

/// Codes the bits of a level, from the highest down: each by the weighted sum of the views' opinions; counters and weights
/// learn from it. The decoder looks at what may come next before it knows the bit, so that it need not wait for it.
#[inline(always)]
fn code_bits<C: BitCoder, const N: usize>(
    coder: &mut C,
    tables: &Logistic,
    (bits, level): (u32, u32),
    weights: &mut [[f32; N]],
    views: [&mut [Counter]; N],
) -> u32 {
    let nodes = 1 << bits;
    let weights = &mut weights[..nodes];
    views.iter().for_each(|view| assert!(view.len() >= nodes));
    let at = |weights: &[[f32; N]], views: &[&mut [Counter]; N], node: usize| {
        let mut opinions = [0.0; N];
        let mut odds = 0.0;
        for i in 0..N {
            opinions[i] = tables.opinion(views[i][node]);
            odds += weights[node][i] * opinions[i];
        }
        Odds { opinions, p: tables.squash(odds) }
    };
    let mut node = 1;
    let mut odds = at(weights, &views, node);
    for i in (0..bits).rev() {
        let bit = level >> i & 1 == 1;
        let ahead = match (i > 0, C::ENCODES) {
            (false, _) => [odds; 2],
            (true, true) => [at(weights, &views, node << 1 | usize::from(bit)); 2],
            (true, false) => [at(weights, &views, node << 1), at(weights, &views, node << 1 | 1)],
        };
        let bit = coder.code(bit, odds.p);
        let pull = ((i32::from(bit) << 16) - odds.p as i32) as f32 * (RATE / 65536.0);
        for i in 0..N {
            weights[node][i] += pull * odds.opinions[i];
            views[i][node].learn(bit);
        }
        node = node << 1 | usize::from(bit);
        odds = ahead[usize::from(bit)];
    }
    (node - nodes) as u32
}
