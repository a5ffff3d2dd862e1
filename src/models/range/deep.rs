//! The deep model of ranges: more least-squares fits, among them one for each stretch of columns; several
//! sets of weights for the same predictors, each with its own contexts; and mixing in two layers.
//! FORMAT.md 8.6, "deep".
//!
//! Cells with and without a reference are treated alike: the reference, if there is one, contributes
//! contexts.

mod fits;
mod halving;
mod site;

use super::bins::RangeScale;
use super::halving::{code_bin, first_bucket};
use super::mixture::{Interval, Mixture, Rates};
use super::{ACTIVITY_LEVELS, CONTEXTS, Coded, ERROR_LEVELS, NODES, REFERENCE_LEVELS, first_scale};
use crate::entropy::{BitCoder, LayeredBits, LayeredContext, Logistic, MixContexts};
use crate::models::shape::ErrorShape;
use fits::Fits;
use halving::DeepHalving;
use site::SetContexts;
pub use site::{DeepSite, Referred};

/// Predictors in the mixture.
const PREDICTORS: usize = 8;
/// Numbers of weight sets of the mixture, of views, of opinions and of mixers.
const SETS: usize = 3;
const VIEWS: usize = 8;
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
    views: [
        1024 * NODES,
        1024 * NODES,
        128 * 8 * NODES,
        CHANGES * OWN_LEVELS * 8 * NODES,
        1024 * NODES,
        1024 * NODES,
        ROWS * ERROR_LEVELS * NODES,
        RECOGNITIONS * ERROR_LEVELS * NODES,
    ],
    mixer: MixContexts {
        sets: [KINDS * NODES * ERROR_LEVELS, ROWS * NODES, RECOGNITIONS * NODES],
        last: NODES,
        refinements: [NODES * ERROR_LEVELS, ROWS * NODES],
    },
};

type DeepBits = LayeredBits<SETS, VIEWS, OPINIONS, MIXERS>;

/// The adaptive models of ranges.
#[derive(Clone)]
pub struct DeepModel {
    fits: Fits,
    mixture: Mixture<PREDICTORS, SETS>,
    bits: DeepBits,
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
        let DeepSite { site, cell: (_, column), referred } = deep_site;
        let fitted = self.fits.predict(site, *column, referred.as_ref(), hint);
        let base = site.base(fitted.hinted, scale.bits);
        let bins = scale.bins_around(base);
        let contexts = SetContexts::of(deep_site);
        let values = deep_site.predictions(&fitted);
        let predicted = self.mixture.place(shape, values, deep_site.mixture_contexts(&contexts));
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
            views: deep_site.views(&contexts, &fitted, base as f64),
            contexts,
            bin: bins.of(range),
            odds: 0.0,
        };
        let scale_of_fit = self.mixture.scale_of_fit(&predicted);
        code_bin(&mut halving, bins.central, first_bucket(scale_of_fit / bins.width as f32));
        let DeepHalving { interval, .. } = halving;
        let range = bins.middle(interval.low, scale.bits);
        self.mixture.learn(&predicted, &interval, range as f32);
        self.fits.learn(site, &fitted, range as f64);
        Coded { range, fit: fitted.blend, hinted: fitted.hinted, base }
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
