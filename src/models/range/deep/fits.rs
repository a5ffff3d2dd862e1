//! Several least-squares fits, and one that blends their predictions. FORMAT.md 8.6, "deep".

use super::Referred;
use crate::models::least_squares::BatchedLeastSquares;
use crate::models::range::back::SURROUNDING_FEATURES;
use crate::models::range::site::Site;
use crate::models::range::{
    ALL_FEATURES, EDGES, ERROR_LEVELS, FEATURE_REACH, FEATURES, LONG_MEMORY, REFERENCE_FEATURES, within_reach,
};

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
pub struct Fits {
    /// Fits by kind of edge; those with a reference follow those without.
    wide: Vec<BatchedLeastSquares<WIDE_FEATURES>>,
    /// Fits to the last few returns, by kind of edge.
    recent: Vec<BatchedLeastSquares<FEATURES>>,
    /// Fits to the last few returns in a stretch of columns, in this row and those above.
    local: Vec<BatchedLeastSquares<ALL_FEATURES>>,
    /// Fits to the predictions of these, by class of error.
    blend: Vec<BatchedLeastSquares<BLEND_FEATURES>>,
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
            wide: vec![BatchedLeastSquares::new(LONG_MEMORY); 2 * EDGES],
            recent: vec![BatchedLeastSquares::new(SHORT_MEMORY).solved_every(SOON); EDGES],
            local: Vec::new(),
            blend: vec![BatchedLeastSquares::new(LONG_MEMORY).solved_every(SOON); ERROR_LEVELS],
        }
    }
}

impl Fits {
    /// Prepares for an image of `columns` columns.
    pub fn start_frame(&mut self, columns: usize) {
        let stretches = columns.div_ceil(STRETCH).max(self.local.len());
        self.local.resize(stretches, BatchedLeastSquares::new(SHORT_MEMORY).solved_every(SOON));
    }

    /// Copies the learned state of the fits without a reference to those with one.
    pub fn spread(&mut self) {
        let (alone, referred) = self.wide.split_at_mut(EDGES);
        referred.clone_from_slice(alone);
    }

    /// Predicts the range of a cell; `hint` is the offset from the surrounding residuals, in steps.
    #[inline]
    pub fn predict(&self, site: &Site, column: usize, referred: Option<&Referred>, hint: f64) -> Fitted {
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
    pub fn learn(&mut self, site: &Site, fitted: &Fitted, range: f64) {
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
