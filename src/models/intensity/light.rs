//! Intensity levels from two views of the levels before and one of the reference, mixed: the fastest of the
//! adaptive models.

use super::neighbours::{IntensityNeighbours, TYPICAL_LEVEL};
use super::scale::{IntensityScale, MOST_BITS};
use crate::entropy::{BitCoder, Counter, Logistic};

/// Slots of each view, as a power of two: contexts share them by hashing.
const SLOT_BITS: u32 = 13;
/// Beams from this number on share their contexts.
const ROWS: usize = 128;
/// Initial weights of two opinions, and of three: several know more than one, but much of it is the same.
const OF_TWO: f32 = 0.55;
const OF_THREE: f32 = 0.45;
/// The learning rate of the weights.
const RATE: f32 = 0.005;
/// Nodes of the tree of a level's bits.
const NODES: usize = 1 << MOST_BITS;

/// What the coder has learned about intensity levels.
#[derive(Clone)]
pub struct LightLevels {
    /// For each view and slot, one counter for each node of the tree of a level's bits.
    views: [Vec<Counter>; 2],
    weights: Vec<[f32; 2]>,
    /// The view of the reference, once there was one, and the weights of all three views.
    reference: Vec<Counter>,
    reference_weights: Vec<[f32; 3]>,
    tables: &'static Logistic,
}

impl Default for LightLevels {
    fn default() -> Self {
        LightLevels {
            views: Default::default(),
            weights: vec![[OF_TWO; 2]; NODES],
            reference: Vec::new(),
            reference_weights: vec![[OF_THREE; 3]; NODES],
            tables: Logistic::tables(),
        }
    }
}

impl LightLevels {
    /// Starts a frame, or its strays.
    pub fn start_frame(&mut self, scale: &IntensityScale) {
        if scale.is_on_grid() {
            self.views.iter_mut().for_each(|view| grow(view, scale));
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
        let [first, second] = [(w / 2) << 16 | (ww / 2) << 8 | www / 8, row.min(ROWS - 1) << 8 | w]
            .map(|view| slot(view) << scale.bits());
        let [of_before, of_row] = &mut self.views;
        if !C::ENCODES {
            touch(&of_before[first..][..1 << scale.bits()]);
            touch(&of_row[second..][..1 << scale.bits()]);
        }
        let (tables, weights) = (self.tables, &mut self.weights);
        let Some(back) = near.back else {
            return code_bits(scale.bits(), level, |bit, node| {
                let counters = [&mut of_before[first + node], &mut of_row[second + node]];
                mix(coder, tables, &mut weights[node], counters, bit)
            });
        };
        grow(&mut self.reference, scale);
        let (of_reference, weights) = (&mut self.reference, &mut self.reference_weights);
        let third = slot(usize::from(back.level()) << 8 | w / 4) << scale.bits();
        code_bits(scale.bits(), level, |bit, node| {
            let counters =
                [&mut of_before[first + node], &mut of_row[second + node], &mut of_reference[third + node]];
            mix(coder, tables, &mut weights[node], counters, bit)
        })
    }
}

/// Makes room for the levels of a scale.
fn grow(view: &mut Vec<Counter>, scale: &IntensityScale) {
    let places = 1 << (SLOT_BITS + scale.bits());
    if view.len() < places {
        view.resize(places, Counter::default());
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

/// Codes the bits of a level, from the highest down; `code` codes the bit at a node of their tree.
#[inline(always)]
fn code_bits(bits: u32, level: u32, mut code: impl FnMut(bool, usize) -> bool) -> u32 {
    let mut node = 1;
    for i in (0..bits).rev() {
        node = node << 1 | usize::from(code(level >> i & 1 == 1, node));
    }
    node as u32 - (1 << bits)
}

/// Codes a bit by the weighted sum of some opinions; counters and weights learn from it.
#[inline(always)]
fn mix<C: BitCoder, const N: usize>(
    coder: &mut C,
    tables: &Logistic,
    weights: &mut [f32; N],
    counters: [&mut Counter; N],
    bit: bool,
) -> bool {
    let mut opinions = [0.0; N];
    let mut odds = 0.0;
    for i in 0..N {
        opinions[i] = tables.opinion(*counters[i]);
        odds += weights[i] * opinions[i];
    }
    let p = tables.squash(odds);
    let bit = coder.code(bit, p);
    let pull = ((i32::from(bit) << 16) - p as i32) as f32 * (RATE / 65536.0);
    for i in 0..N {
        weights[i] += pull * opinions[i];
    }
    counters.into_iter().for_each(|counter| counter.learn(bit));
    bit
}

/// The slot of a context.
fn slot(view: usize) -> usize {
    ((view as u32).wrapping_mul(0x9e37_79b1) >> (32 - SLOT_BITS)) as usize
}
