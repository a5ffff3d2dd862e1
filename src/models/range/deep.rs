//! The deep model of ranges: more least-squares fits, among them one for each stretch of columns; several
//! sets of weights for the same predictors, each with its own contexts; a neural network that corrects their
//! odds; and mixing in two layers. FORMAT.md 8.6, "deep".
//!
//! Cells with and without a reference are treated alike: the reference, if there is one, contributes
//! contexts.
//!
//! After the model come the fits, and the one that blends their predictions; a cell's predictions and
//! contexts; the network with its inputs; and halving under a mixture with several sets of weights.

use super::halving::{Bins, Halves, RangeScale, code_bin, first_bucket};
use super::mixture::{Interval, Mixture, Predicted, Rates};
use super::residuals::INPUTS;
use super::site::{Back, SURROUNDING_FEATURES, Site, Surroundings, intensity_change, pair};
use super::{
    ACTIVITY_LEVELS, ALL_FEATURES, CONTEXTS, Coded, EDGES, ERROR_LEVELS, FEATURE_REACH, FEATURES,
    LONG_MEMORY, NODES, REFERENCE_FEATURES, REFERENCE_LEVELS, first_scale, within_reach,
};
use crate::entropy::{
    Activations, BitCoder, LayeredBits, LayeredContext, Logistic, MixContexts, Network, NetworkRates,
};
use crate::models::least_squares::LeastSquares;
use crate::models::quantise::signed_level;
use crate::models::shape::ErrorShape;

/// Predictors in the mixture.
const PREDICTORS: usize = 8;
/// Numbers of weight sets of the mixture, of views, of opinions and of mixers.
const SETS: usize = 3;
const VIEWS: usize = 5;
const OPINIONS: usize = 12;
const MIXERS: usize = 3;
/// Rows with their own contexts; those below share the contexts of the last one.
const ROWS: usize = 64;
/// Kinds of references: none, and the classes of their errors.
const KINDS: usize = 1 + REFERENCE_LEVELS;
/// Classes of the difference of an intensity from two others: eight classes each.
const CHANGES: usize = 64;
/// No reference, or the differences from its two layers.
const RECOGNITIONS: usize = 1 + CHANGES;
/// Classes of the cell's own intensity.
const OWN_LEVELS: usize = 4;

const RATES: Rates = Rates { weights: 0.03, scales: 0.02, early: 0.3 };
const SIZES: LayeredContext<VIEWS, MIXERS> = LayeredContext {
    views: [1024 * NODES, 1024 * NODES, CHANGES * OWN_LEVELS * 8 * NODES, 1024 * NODES, 1024 * NODES],
    mixer: MixContexts {
        sets: [KINDS * NODES * ERROR_LEVELS, ROWS * NODES, RECOGNITIONS * NODES],
        last: NODES,
        refinements: [NODES * ERROR_LEVELS, ROWS * NODES],
    },
};

/// The opinions of the sets of weights, and of the network.
const OTHERS: usize = SETS + 1;

type DeepBits = LayeredBits<OTHERS, VIEWS, OPINIONS, MIXERS>;

/// The adaptive models of ranges.
#[derive(Clone)]
pub struct DeepModel {
    fits: Fits,
    mixture: Mixture<PREDICTORS, SETS>,
    bits: DeepBits,
    network: RangeNetwork,
    /// Whether any frame so far had a reference.
    had_reference: bool,
}

impl Default for DeepModel {
    fn default() -> Self {
        let contexts = [
            KINDS * ACTIVITY_LEVELS * ERROR_LEVELS,
            CHANGES * OWN_LEVELS * ERROR_LEVELS,
            RECOGNITIONS * KINDS * ERROR_LEVELS,
        ];
        DeepModel {
            fits: Fits::default(),
            mixture: Mixture::new(RATES, contexts, first_scale),
            bits: LayeredBits::new(&SIZES),
            network: Network::new(NETWORK_TABLES, (1 + GATES) * NODES, NETWORK_RATES),
            had_reference: false,
        }
    }
}

impl DeepModel {
    /// Prepares for an image of `columns` columns. At the first frame with a reference, all models that
    /// depend on references start as a copy of those that do not.
    pub fn start_frame(&mut self, columns: usize, has_reference: bool) {
        self.fits.start_frame(columns);
        if has_reference && !self.had_reference {
            self.had_reference = true;
            self.fits.spread();
            self.mixture.spread(0, CONTEXTS);
            self.mixture.spread(2, ERROR_LEVELS);
            self.bits.spread_sets(0, NODES * ERROR_LEVELS);
            self.bits.spread_sets(2, NODES);
        }
    }

    /// Codes a range, in steps.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (shape, tables): (&ErrorShape, &'static Logistic),
        scale: RangeScale,
        (deep_site, hint): (&DeepSite, f64),
        range: i64,
    ) -> Coded {
        let DeepSite { site, cell: (_, column), referred, .. } = deep_site;
        let fitted = self.fits.predict(site, *column, referred.as_ref(), hint);
        let base = site.base(fitted.hinted, scale.bits);
        let bins = scale.bins_around(base);
        let contexts = SetContexts::of(deep_site);
        let values = deep_site.predictions(&fitted);
        let predicted = self.mixture.place(shape, values, deep_site.mixture_contexts(&contexts));
        let scale_of_fit = self.mixture.scale_of_fit(&predicted);
        let activations =
            deep_site.activate(&self.network, contexts.row, (base as f32, scale_of_fit), hint as f32);
        let mut halving = DeepHalving {
            coder,
            shape,
            tables,
            range_bits: scale.bits,
            bins,
            mixture: &self.mixture,
            predicted: &predicted,
            interval: Interval::whole(bins.all(scale.bits)),
            bits: &mut self.bits,
            network: &mut self.network,
            activations,
            views: deep_site.views(&contexts, &fitted, base as f64),
            contexts,
            bin: bins.of(range),
            odds: 0.0,
        };
        code_bin(&mut halving, bins.central, first_bucket(scale_of_fit / bins.width as f32));
        let DeepHalving { interval, activations, .. } = halving;
        self.network.learn(&activations);
        let range = bins.middle(interval.low, scale.bits);
        self.mixture.learn(&predicted, &interval, range as f32);
        self.fits.learn(site, &fitted, range as f64);
        Coded { range, fit: fitted.blend, hinted: fitted.hinted, base }
    }
}

/// Number of features of the wide fit: of near and farther neighbours, of intensities, of the reference and
/// its surroundings; the last two features are always 0.
const WIDE_FEATURES: usize = 28;
const FARTHER: usize = FEATURES;
const INTENSITIES: usize = FARTHER + 4;
const REFERENCE: usize = INTENSITIES + 4;
const SURROUNDINGS: usize = REFERENCE + REFERENCE_FEATURES;
/// Number of features of the blend: the predictions of the other fits, three ranges, two more that continue
/// from neighbours as the reference does, the surrounding errors, and a constant, in steps.
const BLEND_FEATURES: usize = 12;
const ALWAYS: f64 = 10.0;
/// Columns that share a local fit.
const STRETCH: usize = 64;
/// Weights of older samples. Fits to the last few returns forget quickly, and are solved again after every
/// `SOON` samples.
const SHORT_MEMORY: f32 = 0.97;
const SOON: u32 = 8;

/// The fits.
#[derive(Clone)]
struct Fits {
    /// Fits by kind of edge; those with a reference follow those without.
    wide: Vec<LeastSquares<WIDE_FEATURES>>,
    /// Fits to the last few returns, by kind of edge.
    recent: Vec<LeastSquares<FEATURES>>,
    /// Fits to the last few returns in a stretch of columns, in this row and those above.
    local: Vec<LeastSquares<ALL_FEATURES>>,
    /// Fits to the predictions of these, by class of error.
    blend: Vec<LeastSquares<BLEND_FEATURES>>,
}

/// The predictions of the fits for a cell, in steps from the left neighbour, with their features.
pub struct Fitted {
    pub recent: f64,
    pub local: f64,
    pub blend: f64,
    /// The blend plus the offset from the surrounding residuals.
    pub hinted: f64,
    pub wide: f64,
    wide_fit: usize,
    stretch: usize,
    wide_features: [f32; WIDE_FEATURES],
    local_features: [f32; ALL_FEATURES],
    blend_features: [f32; BLEND_FEATURES],
}

impl Default for Fits {
    fn default() -> Self {
        Fits {
            wide: vec![LeastSquares::new(LONG_MEMORY); 2 * EDGES],
            recent: vec![LeastSquares::new(SHORT_MEMORY).solved_every(SOON); EDGES],
            local: Vec::new(),
            blend: vec![LeastSquares::new(LONG_MEMORY).solved_every(SOON); ERROR_LEVELS],
        }
    }
}

impl Fits {
    /// Prepares for an image of `columns` columns.
    fn start_frame(&mut self, columns: usize) {
        let stretches = columns.div_ceil(STRETCH).max(self.local.len());
        self.local.resize(stretches, LeastSquares::new(SHORT_MEMORY).solved_every(SOON));
    }

    /// Copies the learned state of the fits without a reference to those with one.
    fn spread(&mut self) {
        let (alone, referred) = self.wide.split_at_mut(EDGES);
        referred.clone_from_slice(alone);
    }

    /// Predicts the range of a cell; `hint` is the offset from the surrounding residuals, in steps.
    #[inline]
    fn predict(&self, site: &Site, column: usize, referred: Option<&Referred>, hint: f64) -> Fitted {
        let mut wide_features = [0.0; WIDE_FEATURES];
        wide_features[..FARTHER].copy_from_slice(&site.features);
        wide_features[FARTHER..INTENSITIES].copy_from_slice(&site.near.farther_features());
        wide_features[INTENSITIES..REFERENCE].copy_from_slice(&intensity_features(site.intensities));
        let mut local_features = [0.0; ALL_FEATURES];
        local_features[..FEATURES].copy_from_slice(&site.features);
        if let Some(Referred { back, around }) = referred {
            let of_reference = back.features(&site.near);
            local_features[FEATURES..].copy_from_slice(&of_reference);
            wide_features[REFERENCE..SURROUNDINGS].copy_from_slice(&of_reference);
            wide_features[SURROUNDINGS..][..SURROUNDING_FEATURES]
                .copy_from_slice(&around.features(&site.near));
        }
        let wide_fit = site.edge + if referred.is_some() { EDGES } else { 0 };
        let stretch = column / STRETCH;
        let wide = within_reach(self.wide[wide_fit].predict(&wide_features));
        let recent = within_reach(self.recent[site.edge].predict(&site.features));
        let local = within_reach(self.local[stretch].predict(&local_features));

        let near = &site.near;
        let [same, moved, on_from_west, on_from_north] = match referred {
            None => [wide; 4],
            Some(Referred { back, around }) => [
                back.same - near.west,
                back.moved - near.west,
                back.moved - around.moved_west,
                near.north - near.west + back.moved - around.moved_north,
            ],
        };
        let differences = [
            wide,
            recent,
            local,
            near.north - near.west,
            same,
            moved,
            on_from_west,
            on_from_north,
            site.errors[0],
            site.errors[1],
            site.errors[2],
            ALWAYS,
        ];
        let blend_features = differences
            .map(|difference| difference.clamp(-f64::from(FEATURE_REACH), FEATURE_REACH.into()) as f32);
        let blend = within_reach(self.blend[site.error_level].predict(&blend_features));
        Fitted {
            recent,
            local,
            blend,
            hinted: within_reach(blend + hint),
            wide,
            wide_fit,
            stretch,
            wide_features,
            local_features,
            blend_features,
        }
    }

    /// Adapts the fits to the coded range, in steps.
    #[inline]
    fn learn(&mut self, site: &Site, fitted: &Fitted, range: f64) {
        let (target, weight) = site.sample(fitted.recent, range);
        self.recent[site.edge].learn(&site.features, target, weight);
        let (target, weight) = site.sample(fitted.wide, range);
        self.wide[fitted.wide_fit].learn(&fitted.wide_features, target, weight);
        let (target, weight) = site.sample(fitted.local, range);
        self.local[fitted.stretch].learn(&fitted.local_features, target, weight);
        let (target, weight) = site.sample(fitted.blend, range);
        self.blend[site.error_level].learn(&fitted.blend_features, target, weight);
    }
}

/// The differences between the cell's intensity and those to the left and above, in levels and in a measure
/// that singles out weak returns, which are measured late. 0 for neighbours without a return.
#[inline]
fn intensity_features([own, west, north]: [u16; 3]) -> [f32; 4] {
    let weakness = |level: u16| 40.0 / (f32::from(level) + 2.0);
    let change = |other: u16| if other == 0 { 0.0 } else { f32::from(own) - f32::from(other) };
    let change_of_weakness = |other: u16| if other == 0 { 0.0 } else { weakness(own) - weakness(other) };
    [change(west), change(north), change_of_weakness(west), change_of_weakness(north)]
}

/// The values of an earlier frame for a cell and around it.
pub struct Referred {
    pub back: Back,
    pub around: Surroundings,
}

/// A cell to be coded.
pub struct DeepSite<'a> {
    pub site: &'a Site,
    pub cell: (usize, usize),
    pub referred: Option<Referred>,
    /// The intensities two to the left, one to the right and two to the right; 0 = no return.
    pub levels_beside: [u16; 3],
    /// The residuals around the cell, in steps.
    pub residuals: &'a [f32],
}

/// The contexts that select the weights of the mixers and the maps that refine their result.
#[derive(Clone, Copy)]
pub struct SetContexts {
    /// 0 without a reference, otherwise the class of its errors plus 1.
    pub kind: usize,
    pub error_level: usize,
    /// The row; those below the last row with its own contexts share that row's.
    pub row: usize,
    /// The difference of the intensity from that of the reference; 0 without a reference.
    pub recognition: usize,
}

impl SetContexts {
    /// The contexts of a cell.
    pub fn of(DeepSite { site, cell, referred, .. }: &DeepSite) -> Self {
        let (kind, recognition) = referred.as_ref().map_or((0, 0), |Referred { back, around }| {
            let change = |level| intensity_change(site.intensities[0], level);
            (1 + back.level, 1 + change(around.same_level) * 8 + change(around.moved_level))
        });
        let row = cell.0.min(ROWS - 1);
        SetContexts { kind, error_level: site.error_level, row, recognition }
    }

    /// The weight set of each mixer at a node.
    #[inline]
    pub fn sets(&self, node: usize) -> [usize; MIXERS] {
        [
            (self.kind * NODES + node) * ERROR_LEVELS + self.error_level,
            self.row * NODES + node,
            self.recognition * NODES + node,
        ]
    }

    /// The outputs of the network at a node.
    #[inline]
    fn outputs(&self, node: usize) -> [usize; 3] {
        let gates = [0, 1 + self.kind * ERROR_LEVELS + self.error_level, 1 + KINDS * ERROR_LEVELS + self.row];
        gates.map(|gate| gate * NODES + node)
    }
}

/// Number of rows of a table of the network that the context level of an intensity selects; and of one that
/// the cell's own level selects together with another one, or with the row of the image.
const SINGLE: usize = 128;
const PAIR: usize = SINGLE * SINGLE;
/// Classes of the scale: eight an octave.
const SCALES: usize = 128;
/// The network's tables and numbers, and the number of outputs for each node besides the first: those by kind
/// of reference and class of error, and those by row.
const TABLES: usize = 10;
const NETWORK_TABLES: [usize; TABLES] =
    [SINGLE, SINGLE, SINGLE, SINGLE, ROWS, SCALES, CONTEXTS, PAIR, PAIR, PAIR];
const NUMBERS: usize = INPUTS + 20;
const GATES: usize = KINDS * ERROR_LEVELS + ROWS;
const NETWORK_RATES: NetworkRates = NetworkRates { rows: 0.025, numbers: 0.005, outputs: 0.003 };
/// Numbers are limited to this many scales.
const MOST_SCALES: f32 = 4.0;

type RangeNetwork = Network<TABLES, NUMBERS, 3>;

impl DeepSite<'_> {
    /// The network's hidden layer for a cell in this row. Numbers are in units of twice the scale of the fit
    /// and, for ranges, relative to the base of the coding; `hint` is the offset from the surrounding
    /// residuals. All are in steps.
    fn activate(
        &self,
        network: &RangeNetwork,
        row: usize,
        (base, scale): (f32, f32),
        hint: f32,
    ) -> Activations<TABLES, NUMBERS> {
        let single = |level: u16| usize::from(level).min(SINGLE - 1);
        let Site { near, intensities, context, errors, .. } = self.site;
        let [own, west, _] = intensities.map(single);
        let [west2, east, east2] = self.levels_beside.map(single);
        let scale = scale.max(1.0);
        let octaves = scale_class(scale);
        let pair = |other: usize| own * SINGLE + other;
        let contexts = [west, east, east2, west2, row, octaves, *context, pair(row), pair(west), pair(east)];

        let unit = 1.0 / scale;
        let in_scales = |steps: f32| (steps * unit).clamp(-MOST_SCALES, MOST_SCALES) * 0.5;
        let relative = |range: f64| in_scales(range as f32 - base);
        let line = 2.0 * near.west - near.west2;
        let mut numbers = [0.0; NUMBERS];
        let (residuals, others) = numbers.split_at_mut(INPUTS);
        for (number, residual) in residuals.iter_mut().zip(self.residuals) {
            *number = in_scales(*residual);
        }
        let (always, referred) = others.split_at_mut(11);
        always.copy_from_slice(&[
            1.0,
            octaves as f32 / 32.0 - 1.0,
            in_scales(hint),
            in_scales(errors[0] as f32),
            in_scales(errors[2] as f32),
            relative(near.west),
            relative(near.west2),
            relative(near.west3),
            relative(line),
            relative(near.north),
            relative(near.north_east),
        ]);
        if let Some(Referred { back, around }) = &self.referred {
            referred.copy_from_slice(&[
                1.0,
                relative(back.same),
                relative(back.same_west),
                relative(back.same_east),
                relative(back.moved),
                relative(around.moved_west),
                relative(around.moved_east),
                relative(around.moved_east2),
                relative(around.moved_east3),
            ]);
        }
        network.activate(&contexts, &numbers)
    }
}

/// The class of a scale of at least one step: eight an octave.
fn scale_class(scale: f32) -> usize {
    // The exponent and the highest three bits of the mantissa.
    let class = (scale.to_bits() >> 20) - (1.0f32.to_bits() >> 20);
    (class as usize).min(SCALES - 1)
}

impl DeepSite<'_> {
    /// The predictions that are mixed: the line through the two returns to the left, three fits, the left
    /// neighbour for surprises, and the moved layer here and in the neighbouring cells.
    pub fn predictions(&self, fitted: &Fitted) -> [f32; PREDICTORS] {
        let near = &self.site.near;
        let [recent, local, blend] = [fitted.recent, fitted.local, fitted.hinted].map(|fit| near.west + fit);
        let [moved, moved_west, moved_east] = match &self.referred {
            None => [near.west + fitted.wide; 3],
            Some(Referred { back, around }) => [back.moved, around.moved_west, around.moved_east],
        };
        [2.0 * near.west - near.west2, recent, local, blend, near.west, moved, moved_west, moved_east]
            .map(|value| value as f32)
    }

    /// The context of each of the mixture's sets of weights.
    fn mixture_contexts(&self, contexts: &SetContexts) -> [usize; SETS] {
        let SetContexts { kind, error_level, recognition, .. } = *contexts;
        [
            kind * CONTEXTS + self.site.context,
            (self.site.change * OWN_LEVELS + own_level(self.site)) * ERROR_LEVELS + error_level,
            (recognition * KINDS + kind) * ERROR_LEVELS + error_level,
        ]
    }

    /// The context of each view for this base.
    pub fn views(&self, contexts: &SetContexts, fitted: &Fitted, base: f64) -> [usize; VIEWS] {
        let SetContexts { kind, error_level, .. } = *contexts;
        let near = &self.site.near;
        let [_, errors, _, change] = self.site.views;
        let wide = near.west + fitted.wide;
        let [same, moved] = self
            .referred
            .as_ref()
            .map_or([wide; 2], |Referred { back, .. }| [back.same, back.moved])
            .map(|range| range - base);
        [
            pair(near.west - base, near.north - base),
            errors,
            change,
            signed_level(same as i32) * 32 + kind * 4 + error_level / 3,
            pair(same, moved),
        ]
    }
}

/// The class of the cell's own intensity.
fn own_level(site: &Site) -> usize {
    usize::from(site.intensities[0] / 8).min(OWN_LEVELS - 1)
}

/// The state of halving one range.
struct DeepHalving<'a, C> {
    coder: &'a mut C,
    shape: &'a ErrorShape,
    tables: &'static Logistic,
    range_bits: u32,
    bins: Bins,
    mixture: &'a Mixture<PREDICTORS, SETS>,
    predicted: &'a Predicted<PREDICTORS, SETS>,
    /// The remaining bins.
    interval: Interval<PREDICTORS, SETS>,
    bits: &'a mut DeepBits,
    network: &'a mut RangeNetwork,
    activations: Activations<TABLES, NUMBERS>,
    views: [usize; VIEWS],
    contexts: SetContexts,
    /// The encoder's bin.
    bin: i64,
    /// The mean of the log odds of the mixture's sets of weights for the last halves.
    odds: f32,
}

impl<C: BitCoder> Halves for DeepHalving<'_, C> {
    const CORRECTED: usize = 2;

    #[inline]
    fn ends(&self) -> (i64, i64) {
        (self.interval.low, self.interval.high)
    }

    #[inline]
    fn halve(&mut self, middle: i64, node: Option<usize>) -> bool {
        let start = self.bins.start(middle, self.range_bits);
        let below_middle = self.mixture.below(self.shape, self.predicted, start, self.range_bits);
        let odds = self.interval.split(&below_middle, self.tables);
        self.odds = (odds[0] + odds[1] + odds[2]) * (1.0 / 3.0);
        let bit = self.bin >= middle;
        let bit = match node {
            None => self.coder.code(bit, self.tables.squash(self.odds)),
            Some(node) => {
                let SetContexts { error_level, row, .. } = self.contexts;
                let context = LayeredContext {
                    views: self.views.map(|view| view * NODES + node),
                    mixer: MixContexts {
                        sets: self.contexts.sets(node),
                        last: node,
                        refinements: [node * ERROR_LEVELS + error_level, row * NODES + node],
                    },
                };
                let outputs = self.contexts.outputs(node);
                let corrected = self.odds + self.network.odds(&mut self.activations, outputs);
                let [first, second, third] = odds;
                let bit = self.bits.code(self.coder, &context, &[first, second, third, corrected], bit);
                self.network.learn_bit(&mut self.activations, outputs, corrected, bit);
                bit
            }
        };
        self.interval.cut(bit, middle, &below_middle);
        bit
    }

    #[inline]
    fn halve_evenly(&mut self, middle: i64) {
        self.odds *= 0.5;
        let upper = self.coder.code(self.bin >= middle, self.tables.squash(self.odds));
        *(if upper { &mut self.interval.low } else { &mut self.interval.high }) = middle;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{RangeContext, RangeModel, RangeScale};
    use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
    use crate::ground::grid::Grid;
    use crate::ground::random::Rng;
    use crate::inter::Reference;

    const ROWS: usize = 12;
    const COLUMNS: usize = 150;

    /// A wall with a post in front of it, and noise; every ninth cell is empty.
    fn frame(random: &mut Rng) -> Grid<u32> {
        let mut steps = Grid::new(ROWS, COLUMNS);
        for (i, cell) in steps.cells_mut().iter_mut().enumerate() {
            let (row, column) = (i / COLUMNS, i % COLUMNS);
            let surface = if (60..70).contains(&column) { 900 } else { 3000 + 7 * column + 40 * row };
            let noise = random.below(8);
            *cell = if i % 9 == 4 { 0 } else { (surface + noise) as u32 };
        }
        steps
    }

    /// Codes frames, in steps, to within half a bin, and decodes them; if `refer`, each frame after the first
    /// has the one before as its reference. Returns the number of bytes.
    fn round_trip(bin: u32, refer: bool) -> usize {
        let mut random = Rng::keyed(7, &[]);
        let frames: Vec<_> = (0..3).map(|_| frame(&mut random)).collect();
        let mut models = [RangeModel::default(), RangeModel::default()];
        models.iter_mut().for_each(|model| model.use_deep());
        let [encoding, decoding] = &mut models;
        let mut before: Option<Grid<u32>> = None;
        let mut bytes = 0;
        for frame in frames {
            let reference = before.take().filter(|_| refer).map(|steps| {
                let mut reference = Reference::new(ROWS, COLUMNS);
                reference.same.steps = steps.clone();
                reference.moved.steps = steps;
                reference
            });
            let known = RangeContext {
                occupancy: &frame.map(|&steps| steps > 0),
                intensity: &frame.map(|&steps| (steps / 30 % 100) as u16),
                reference: reference.as_ref(),
                scale: RangeScale { bits: 16, bin },
            };
            let mut encoder = ArithmeticEncoder::default();
            let mut encoded = frame.clone();
            encoding.code(&mut encoder, &known, &mut encoded);
            let coded = encoder.finish();
            bytes += coded.len();
            let mut decoded = Grid::new(ROWS, COLUMNS);
            decoding.code(&mut ArithmeticDecoder::new(&coded), &known, &mut decoded);
            assert_eq!(encoded, decoded);
            let far = |(a, b): (&u32, &u32)| a.abs_diff(*b) > bin / 2;
            assert!(!frame.cells().iter().zip(decoded.cells()).any(far));
            before = Some(decoded);
        }
        bytes
    }

    #[test]
    fn ranges_come_back_and_bins_take_less() {
        let [exact, binned] = [1, 5].map(|bin| round_trip(bin, false));
        // Three bits of noise per return are the minimum.
        assert!((1800..2600).contains(&exact), "{exact} bytes");
        assert!(binned < exact / 2, "{binned} of {exact} bytes");
    }

    #[test]
    fn ranges_with_a_reference_come_back() {
        round_trip(1, true);
        round_trip(5, true);
    }
}
