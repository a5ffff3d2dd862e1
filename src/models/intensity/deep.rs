//! Intensity levels, coded from many views of their surroundings, with hashed lines of counters, and a
//! least-squares fit, mixed in two layers. FORMAT.md 8.5, "Levels, if `coder` is 1".
//!
//! Beams respond differently: some never give a level that another beam often gives, and the same surface may
//! get one of several levels, as the laser's power varies. Views of exact levels together with the beam learn
//! this.

mod fit;
mod surroundings;
mod views;
mod zero;

use std::ops::RangeInclusive;

use super::neighbours::{IntensityNeighbours, MeanErrors};
use super::scale::{IntensityScale, MOST_BITS};
use crate::entropy::{
    BitCoder, Candidates, HashedCounters, LINE_LEVELS, LayeredMixer, Logistic, MixContexts, MixRates,
    hash_below,
};
use crate::ground::lanes::lanes;
use crate::models::quantise::Levels;
use fit::{Fit, FitOpinion};
use surroundings::Surroundings;
use views::VIEWS;
use zero::ZeroModel;

/// The number of opinions: those of the views, that of the fit, and a constant one.
const OPINIONS: usize = 12;
const CONSTANT: f32 = 0.25;
/// Binary logarithm of the number of 32-byte lines for each view: about twice as many lines as a frame has
/// values.
const INDEX_BITS: RangeInclusive<u32> = 8..=17;
const RATES: MixRates = MixRates { first: 0.0045, last: 0.0005 };
/// Nodes of the tree of a level's bits.
const NODES: usize = 1 << MOST_BITS;
/// Number of classes of the expected error, and of the surrounding gradient.
const ERROR_LEVELS: usize = 12;
/// The levels of two neighbours, in steps of four.
const PAIRS: usize = 32 * 32;
const BITS: usize = MOST_BITS as usize;

/// The adaptive models of intensity levels.
#[derive(Clone)]
pub struct DeepLevels {
    zero: ZeroModel,
    fit: Fit,
    counters: [HashedCounters; VIEWS],
    mixer: LayeredMixer<OPINIONS, 2>,
    levels: Levels<{ ERROR_LEVELS - 1 }>,
    errors: MeanErrors,
    tables: &'static Logistic,
}

impl Default for DeepLevels {
    fn default() -> Self {
        let counts = MixContexts {
            sets: [2 * NODES, PAIRS * BITS],
            last: 2 * BITS,
            refinements: [NODES, ERROR_LEVELS * ERROR_LEVELS],
        };
        DeepLevels {
            zero: ZeroModel::default(),
            fit: Fit::new(ERROR_LEVELS * ERROR_LEVELS),
            counters: std::array::from_fn(|_| HashedCounters::new(*INDEX_BITS.start())),
            mixer: LayeredMixer::new(counts, [0.15; OPINIONS], RATES),
            levels: Levels::new(0.7, 1.45),
            errors: MeanErrors::default(),
            tables: Logistic::tables(),
        }
    }
}

impl DeepLevels {
    /// Starts a frame, or its strays, with `columns` columns and `values` values. If these are too many for
    /// the current tables, larger and empty ones replace them.
    pub fn start_frame(&mut self, columns: usize, values: usize) {
        self.errors.start_frame(columns);
        let wanted = (1 + values.max(1).ilog2()).clamp(*INDEX_BITS.start(), *INDEX_BITS.end());
        if wanted > self.counters[0].index_bits() {
            self.counters = std::array::from_fn(|_| HashedCounters::new(wanted));
        }
    }

    /// Starts a row.
    pub fn start_row(&mut self) {
        self.errors.start_row();
    }

    /// Codes one level. `row` and `column` serve only as contexts.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        level: u32,
    ) -> u32 {
        let around = Surroundings::new(near);
        let prediction = self.fit.predict(&around);
        // The processor loads the lines while the zero is coded.
        let hashes = views::hashes(&around, (row, column), prediction);
        let first = self.candidates(&hashes, 1);
        if self.zero.code(coder, &around, (row, column), prediction, level == 0) {
            return 0;
        }
        let [expected, gradient] =
            [self.errors.expected(column), around.gradient()].map(|measure| self.levels.of(measure));
        let site = Site {
            hashes,
            has_reference: usize::from(around.has_reference()),
            pair: around.pair(),
            uncertainty: expected * ERROR_LEVELS + gradient,
        };
        let opinion = self.fit.opinion(prediction, site.uncertainty, scale);
        let level = self.code_bits(coder, scale.bits(), &site, first, opinion, level);
        if level > 0 {
            let own = f32::from(scale.context_of(level));
            self.fit.learn(&around, prediction, site.uncertainty, own);
            self.errors.record(column, (own - prediction).abs());
        }
        level
    }

    /// Looks for the lines of all views for the tree below `node`.
    #[inline(always)]
    fn candidates(&self, hashes: &[u32; VIEWS], node: usize) -> [Candidates; VIEWS] {
        lanes(|view| self.counters[view].candidates(hash_below(hashes[view], node)))
    }

    /// Codes the bits of a level, from the highest down.
    fn code_bits<C: BitCoder>(
        &mut self,
        coder: &mut C,
        bits: u32,
        site: &Site,
        mut candidates: [Candidates; VIEWS],
        mut fit: FitOpinion,
        level: u32,
    ) -> u32 {
        let mut node = 1usize;
        let mut left = bits;
        while left > 0 {
            let mut view = 0;
            let mut lines = self.counters.each_mut().map(|counters| {
                view += 1;
                counters.line(candidates[view - 1])
            });
            // The node within the levels of the tree that one line covers.
            let mut place = 1;
            for _ in 0..left.min(LINE_LEVELS) {
                left -= 1;
                let mut opinions = [CONSTANT; OPINIONS];
                for (opinion, line) in opinions.iter_mut().zip(&lines) {
                    *opinion = line.opinion(self.tables, place);
                }
                opinions[VIEWS] = fit.of_upper_half(self.fit.shape(), self.tables);
                let bit = level >> left & 1 == 1;
                let bit = self.mixer.code(coder, &site.mix_contexts(node, left), &opinions, bit);
                lines.iter_mut().for_each(|line| line.learn(place, bit));
                fit.narrow(bit);
                node = node << 1 | usize::from(bit);
                place = place << 1 | usize::from(bit);
            }
            if left > 0 {
                candidates = self.candidates(&site.hashes, node);
            }
        }
        node as u32 - (1 << bits)
    }
}

/// An intensity to be coded.
struct Site {
    /// The hash of each view's context.
    hashes: [u32; VIEWS],
    /// 1 if an earlier frame has a return here.
    has_reference: usize,
    pair: usize,
    uncertainty: usize,
}

impl Site {
    /// The mixer's contexts at a node of the tree, with `below` bits still to come after this one.
    fn mix_contexts(&self, node: usize, below: u32) -> MixContexts<2> {
        MixContexts {
            sets: [node + NODES * self.has_reference, self.pair * BITS + below as usize],
            last: 2 * below as usize + self.has_reference,
            refinements: [node, self.uncertainty],
        }
    }
}
