//! Intensity levels, coded from many views of their surroundings, with hashed lines of counters, a
//! least-squares fit and a neural network, mixed in two layers. FORMAT.md 8.5, "Levels, if `coder` is 1".
//!
//! Beams respond differently: some never give a level that another beam often gives, and the same surface may
//! get one of several levels, as the laser's power varies. Views of exact levels together with the beam learn
//! this.
//!
//! Whether an intensity is 0 because the return was too weak is a case of its own, not the lowest of a
//! surface's possible levels.
//!
//! After the model come the levels around a return, with gaps filled from their neighbours, the views of
//! them, each of which selects a context, the network with its inputs, the fit with its reliability, and the
//! model of zeros.

use std::ops::RangeInclusive;

use super::scale::{IntensityScale, MOST_BITS};
use super::{IntensityNeighbours, IntensityReference, MeanErrors, TYPICAL_LEVEL};
use crate::entropy::{
    Activations, BitCoder, Candidates, HashedCounters, LINE_LEVELS, LayeredMixer, Logistic, MixContexts,
    MixRates, MixedBits, Network, NetworkRates, hash, hash_below,
};
use crate::ground::lanes::lanes;
use crate::models::least_squares::LeastSquares;
use crate::models::quantise::{Thresholds, signed_level};
use crate::models::shape::{ErrorShape, Placed};

/// The number of opinions, rounded up: those of the views, of the fit, and of the network, and a constant
/// one.
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
    network: LevelNetwork,
    counters: [HashedCounters; VIEWS],
    mixer: LayeredMixer<OPINIONS, 2>,
    levels: Thresholds<{ ERROR_LEVELS - 1 }>,
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
            network: Network::new(NETWORK_TABLES, (1 + GATES) * NODES, NETWORK_RATES),
            counters: std::array::from_fn(|_| HashedCounters::new(*INDEX_BITS.start())),
            mixer: LayeredMixer::new(counts, [0.15; OPINIONS], RATES),
            levels: Thresholds::new(0.7, 1.45),
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
        let hashes = view_hashes(&around, (row, column), prediction);
        let first = self.candidates(&hashes, 1);
        let mut inference = Inference::new(&self.network, &around, row);
        let odds = inference.odds(&self.network, 0);
        let is_zero = self.zero.code(coder, &around, (row, column), prediction, odds, level == 0);
        inference.learn_bit(&mut self.network, 0, odds, is_zero);
        if is_zero {
            self.network.learn(&inference.activations);
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
        let level = self.code_bits(coder, scale.bits(), &site, first, (opinion, &mut inference), level);
        self.network.learn(&inference.activations);
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
        (mut fit, inference): (FitOpinion, &mut Inference),
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
                let mut opinions = [0.0; OPINIONS];
                for (opinion, line) in opinions.iter_mut().zip(&lines) {
                    *opinion = line.opinion(self.tables, place);
                }
                opinions[VIEWS] = fit.of_upper_half(self.fit.shape(), self.tables);
                let odds = inference.odds(&self.network, node);
                opinions[VIEWS + 1] = odds;
                opinions[VIEWS + 2] = CONSTANT;
                let bit = level >> left & 1 == 1;
                let bit = self.mixer.code(coder, &site.mix_contexts(node, left), &opinions, bit);
                lines.iter_mut().for_each(|line| line.learn(place, bit));
                inference.learn_bit(&mut self.network, node, odds, bit);
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

/// Features of the least-squares fit.
const FEATURES: usize = 16;
/// The context level of an intensity of 0.
const ZERO: u16 = 1;
/// The constant feature.
const CONSTANT_FEATURE: f32 = 4.0;

/// Context levels around a return.
#[derive(Clone, Copy, Debug)]
struct Surroundings {
    /// The last four levels of the row, nearest first, and the one above; none of them is missing.
    west: u16,
    west2: u16,
    west3: u16,
    west4: u16,
    north: u16,
    /// The level of the same cell in an earlier frame, and that of its moved surface; 0 = none.
    same: u16,
    moved: u16,
    /// The levels of the earlier frame, if it has a return here.
    back: Option<IntensityReference>,
    /// One bit for each neighbour, set if its level is [`ZERO`].
    zeros: usize,
    /// The base of the features: the best neighbour that is neither missing nor 0.
    base: u16,
    features: [f32; FEATURES],
    gradient: f32,
    /// The index of the fit that applies.
    fit: usize,
}

/// The first level, or the other if the first is unknown.
fn or(level: u16, other: u16) -> u16 {
    if level > 0 { level } else { other }
}

impl Surroundings {
    /// The surroundings of a return.
    fn new(near: &IntensityNeighbours) -> Self {
        let [w, ww, www, wwww] = near.left;
        let [nww, nw, n, ne, nee] = near.above;
        let [nnw, nn, nne] = near.above2;
        let ([same, same_west, same_east, _], moved) =
            near.back.map_or(([0; 4], 0), |back| (back.same, back.moved[0]));
        let zeros = [w, n, ne, nw, same, moved, ww, nn, www, nee, same_east, same_west];
        let zeros = zeros.iter().enumerate().fold(0, |bits, (i, l)| bits | usize::from(*l == ZERO) << i);
        let west = or(w, or(n, or(nw, or(ne, TYPICAL_LEVEL))));
        let west2 = or(ww, west);
        let filled = Surroundings {
            west,
            west2,
            west3: or(www, west2),
            west4: or(wwww, or(www, west2)),
            north: or(n, or(ne, or(nw, west))),
            same,
            moved,
            back: near.back,
            zeros,
            base: 0,
            features: [0.0; FEATURES],
            gradient: 0.0,
            fit: usize::from(n > 0) | usize::from(near.back.is_some()) << 1 | usize::from(w > 0) << 2,
        };

        // A level of 0 carries no information about the surface, so it counts as a gap here.
        let [w, ww, www, wwww, nww, nw, n, ne, nee, nnw, nn, nne, same, same_west, same_east, moved] =
            [w, ww, www, wwww, nww, nw, n, ne, nee, nnw, nn, nne, same, same_west, same_east, moved]
                .map(|level| if level == ZERO { 0 } else { level });
        let base = [w, n, nw, ne, ww, www, nn, same].into_iter().fold(0, or);
        let base = or(base, TYPICAL_LEVEL);
        let ww = or(ww, base);
        let www = or(www, ww);
        let n = or(n, or(ne, or(nw, base)));
        let [nw, ne, nn] = [nw, ne, nn].map(|level| or(level, n));
        let difference = |level: u16| f32::from(level) - f32::from(base);
        let mut features = [0.0; FEATURES];
        let alone =
            [ww, n, nw, ne, nn, www, or(wwww, www), or(nee, ne), or(nww, nw), or(nnw, nn), or(nne, nn)];
        features[..alone.len()].copy_from_slice(&alone.map(difference));
        features[alone.len()] = CONSTANT_FEATURE;
        if near.back.is_some() {
            let here = or(same, or(moved, base));
            let back = [here, or(same_west, here), or(same_east, here), or(moved, here)];
            features[alone.len() + 1..].copy_from_slice(&back.map(difference));
        }
        let apart = |a: u16, b: u16| f32::from(a.abs_diff(b));
        let gradient = apart(base, n) + apart(base, ww) + apart(n, ne);
        Surroundings { base, features, gradient, ..filled }
    }

    /// Whether an earlier frame has a return here.
    fn has_reference(&self) -> bool {
        self.same > 0 || self.moved > 0
    }

    /// The index of the fit that applies, 0 to 7: whether there is a level above, in an earlier frame, and to
    /// the left.
    fn fit(&self) -> usize {
        self.fit
    }

    /// The base of the features.
    fn base(&self) -> f32 {
        f32::from(self.base)
    }

    /// Differences between the levels around and the base.
    fn features(&self) -> &[f32; FEATURES] {
        &self.features
    }

    /// A measure of the differences among the surrounding levels.
    fn gradient(&self) -> f32 {
        self.gradient
    }

    /// The levels to the left and above, in steps of four: 0 to 1023.
    fn pair(&self) -> usize {
        let step = |level: u16| usize::from(level.saturating_sub(1) / 4).min(31);
        step(self.west) * 32 + step(self.north)
    }
}

/// Number of views.
const VIEWS: usize = 8;
/// Rows from this number on share their contexts.
const ROW_CONTEXTS: usize = 128;
/// Columns of a sector, whose counters carry over from frame to frame.
const WIDE_SECTOR: usize = 64;
const NARROW_SECTOR: usize = 32;

/// The hash of each view's context.
fn view_hashes(around: &Surroundings, (row, column): (usize, usize), prediction: f32) -> [u32; VIEWS] {
    let row = row.min(ROW_CONTEXTS - 1) as u32;
    let Surroundings { west, west2, west3, same, moved, .. } = *around;
    let [w, w2, w3, same, moved] = [west, west2, west3, same, moved].map(u32::from);
    let (wide, narrow) = ((column / WIDE_SECTOR) as u32, (column / NARROW_SECTOR) as u32);
    let change = signed_level((prediction - around.base()) as i32) as u32;
    // Fields of eight bits, the beam in seven.
    let contexts = [
        w / 2 | (w2 / 2) << 8,
        row | (w / 4) << 7 | (w2 / 4) << 15 | (w3 / 4) << 23,
        row | w << 7 | change << 15,
        w | w3 << 8,
        row / 32 | w << 2 | w2 << 10,
        row | (same / 2) << 7 | (moved / 2) << 15,
        row / 2 | (w / 2) << 6 | wide << 14,
        row | (w / 4) << 7 | narrow << 15,
    ];
    std::array::from_fn(|view| hash(view, contexts[view]))
}

/// Number of rows of a table of the network that a context level selects, or the beam; and of one that a pair
/// of these selects.
const SINGLE: usize = 128;
const PAIR: usize = SINGLE * SINGLE;
/// The network's tables: those of single values, then those of pairs.
const SINGLES: usize = 17;
const PAIRED: usize = 4;
const NETWORK_TABLES: [usize; SINGLES + PAIRED] = {
    let mut sizes = [SINGLE; SINGLES + PAIRED];
    let mut table = SINGLES;
    while table < sizes.len() {
        sizes[table] = PAIR;
        table += 1;
    }
    sizes
};
const NETWORK_RATES: NetworkRates = NetworkRates { rows: 0.03, numbers: 0.01, outputs: 0.01 };
/// Besides an output for each node, there is one for each node and every two levels of the left neighbour.
const GATES: usize = SINGLE / 2;

type LevelNetwork = Network<{ SINGLES + PAIRED }, 1, 2>;

/// The network, applied to one intensity.
struct Inference {
    activations: Activations<{ SINGLES + PAIRED }, 1>,
    gate: usize,
}

impl Inference {
    fn new(network: &LevelNetwork, around: &Surroundings, row: usize) -> Self {
        let single = |level: u16| usize::from(level).min(SINGLE - 1);
        let row = row.min(SINGLE - 1);
        let Surroundings { west, west2, west3, west4, same, moved, back, .. } = *around;
        let [w, w2, w3, w4, same, moved] = [west, west2, west3, west4, same, moved].map(single);
        let (
            [_, same_west, same_east, same_east2],
            [_, moved_west, moved_east, moved_east2, moved_west2],
            farther,
        ) = back.map_or_else(Default::default, |back| {
            (back.same.map(single), back.moved.map(single), back.farther)
        });
        let pair = |a: usize, b: usize| a * SINGLE + b;
        let contexts = [
            w,
            w2,
            w3,
            w4,
            row,
            moved,
            moved_west,
            moved_east,
            moved_east2,
            moved_west2,
            same_west,
            same_east,
            same_east2,
            farther[0],
            farther[1],
            farther[2],
            single(around.north),
            pair(w, w2),
            pair(w2, w3),
            pair(w, same),
            pair(row, w),
        ];
        Inference { activations: network.activate(&contexts, &[1.0]), gate: (w / 2).min(GATES - 1) }
    }

    /// The outputs at a node; 0 is for whether the level is 0.
    fn outputs(&self, node: usize) -> [usize; 2] {
        [node, (1 + self.gate) * NODES + node]
    }

    /// The log odds of a 1 at a node.
    #[inline]
    fn odds(&mut self, network: &LevelNetwork, node: usize) -> f32 {
        let outputs = self.outputs(node);
        network.odds(&mut self.activations, outputs)
    }

    /// Learns from the bit at a node.
    #[inline]
    fn learn_bit(&mut self, network: &mut LevelNetwork, node: usize, odds: f32, bit: bool) {
        let outputs = self.outputs(node);
        network.learn_bit(&mut self.activations, outputs, odds, bit);
    }
}

/// Fits: one for each combination of whether there is a neighbour to the left, one above, and one in an
/// earlier frame.
const FITS: usize = 8;
/// The lower limit of mean errors, in context levels.
const LEAST_SCALE: f32 = 0.3;
/// The rate at which mean errors are learned.
const SCALE_RATE: f32 = 0.01;
/// Added to probabilities before their logarithm is taken.
const LEAST: f32 = 1.0 / (1 << 24) as f32;

/// The fits, and their mean errors.
#[derive(Clone)]
struct Fit {
    fits: [LeastSquares<FEATURES>; FITS],
    shape: ErrorShape,
    /// The mean error in each context, in context levels.
    scales: Vec<f32>,
}

impl Fit {
    /// Creates untrained fits, with mean errors for `contexts` contexts.
    fn new(contexts: usize) -> Self {
        Fit {
            fits: std::array::from_fn(|_| LeastSquares::new(0.998)),
            shape: ErrorShape::new(),
            scales: vec![4.0; contexts],
        }
    }

    /// The predicted context level: 0 to 127.9.
    fn predict(&self, around: &Surroundings) -> f32 {
        (around.base() + self.fits[around.fit()].predict(around.features())).clamp(0.0, 127.9)
    }

    /// The distribution of the level around a prediction.
    fn opinion(&self, prediction: f32, context: usize, scale: &IntensityScale) -> FitOpinion {
        let unit = scale.context_step() as f32;
        let mean_error = self.scales[context].max(LEAST_SCALE) * unit;
        let placed = self.shape.place([(prediction - 0.5) * unit], &[mean_error]);
        FitOpinion { placed, low: 0, high: 1 << scale.bits(), below: [0.0, 0.0, 1.0] }
    }

    /// The shape of the error distribution.
    fn shape(&self) -> &ErrorShape {
        &self.shape
    }

    /// Learns from the context level that was coded.
    fn learn(&mut self, around: &Surroundings, prediction: f32, context: usize, own: f32) {
        let error = own - prediction;
        let weight = 1.0 / (9.0 + error * error);
        self.fits[around.fit()].learn(around.features(), own - around.base(), weight);
        let scale = &mut self.scales[context];
        *scale += (error.abs() - *scale) * SCALE_RATE;
    }
}

/// The opinion of a fit on each bit of a level, from the distribution around its prediction.
#[derive(Clone, Copy, Debug)]
struct FitOpinion {
    placed: Placed<1>,
    /// The levels that are still possible after the bits so far: `low` to below `high`.
    low: u32,
    high: u32,
    /// The probability of a level below `low`, below the middle, and below `high`.
    below: [f32; 3],
}

impl FitOpinion {
    /// The log odds that the level is in the upper half of those still possible.
    #[inline]
    fn of_upper_half(&mut self, shape: &ErrorShape, tables: &Logistic) -> f32 {
        let [low, _, high] = self.below;
        let [middle] = shape.below(&self.placed, ((self.low + self.high) / 2) as f32);
        self.below[1] = middle;
        let [lower, upper] =
            [middle - low, high - middle].map(|part| if part > 0.0 { part + LEAST } else { LEAST });
        tables.odds(upper, lower)
    }

    /// Continues with the upper half, or with the lower one.
    #[inline]
    fn narrow(&mut self, upper: bool) {
        let middle = (self.low + self.high) / 2;
        if upper {
            (self.low, self.below[0]) = (middle, self.below[1]);
        } else {
            (self.high, self.below[2]) = (middle, self.below[1]);
        }
    }
}

/// Views of the model of zeros, and opinions in its mix.
const ZERO_VIEWS: usize = 8;
const ZERO_OPINIONS: usize = 12;
/// Binary logarithm of the number of counters of each view: contexts share them by hashing.
const ZERO_SLOT_BITS: u32 = 16;
/// Number of weight sets: by which of six neighbours are 0, and whether there is a reference.
const ZERO_SETS: usize = 128;

/// The adaptive models of zeros.
#[derive(Clone)]
struct ZeroModel {
    bits: MixedBits<ZERO_VIEWS, ZERO_OPINIONS>,
}

impl Default for ZeroModel {
    fn default() -> Self {
        ZeroModel { bits: MixedBits::new([1 << ZERO_SLOT_BITS; ZERO_VIEWS], ZERO_SETS, 0.2, 0.3, 0.002) }
    }
}

impl ZeroModel {
    /// Codes whether a level is 0. `prediction` is the predicted level if it is not; `other` is an external
    /// opinion, as log odds.
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        around: &Surroundings,
        (row, column): (usize, usize),
        prediction: f32,
        other: f32,
        is_zero: bool,
    ) -> bool {
        let row = row.min(ROW_CONTEXTS - 1);
        let zeros = around.zeros;
        let [west, north, same, moved] =
            [around.west, around.north, around.same, around.moved].map(usize::from);
        let coarse = (prediction * 0.625) as usize;
        let contexts = [
            zeros,
            zeros & 0xff | row << 8,
            zeros & 0x1f | coarse << 5 | row << 12,
            zeros & 0xf | west << 4 | row << 12,
            zeros & 3 | same << 2 | (west / 8) << 10,
            zeros & 3 | west << 2 | north << 10,
            zeros & 0xf | row << 4 | (column / NARROW_SECTOR) << 11,
            zeros & 0x33 | (same / 2) << 6 | (moved / 2) << 13 | coarse / 2 << 20,
        ];
        let places = contexts.map(zero_slot);
        let set = zeros & 0x3f | usize::from(around.has_reference()) << 6;
        self.bits.code(coder, set, &places, other, is_zero)
    }
}

/// The slot of a context of zeros.
fn zero_slot(context: usize) -> usize {
    ((context as u32).wrapping_mul(0x9e37_79b1) >> (32 - ZERO_SLOT_BITS)) as usize
}
