//! A cell to be coded, described by its neighbours: the ranges around it and their prediction errors, and the
//! reference around it with its recent errors. FORMAT.md 8.6, "Neighbours", "Learning" and "P frames".

use super::{
    ACTIVITY_LEVELS, EDGE, ERROR_LEVELS, ErrorLevels, FEATURE_REACH, FEATURES, PREDICTORS,
    REFERENCE_FEATURES, REFERENCE_LEVELS, TYPICAL_RANGE, VIEWS, within_reach,
};
use crate::inter::{Layer, Reference};
use crate::models::least_squares::LeastSquares;
use crate::models::quantise::signed_level;

/// A cell to be coded, described by its neighbours.
pub struct Site {
    pub near: Neighbourhood,
    pub features: [f32; FEATURES],
    /// The intensities of the cell, of the one to the left and of the one above; 0 = no return.
    pub intensities: [u16; 3],
    pub edge: usize,
    pub error_level: usize,
    pub context: usize,
    /// The difference of the intensity from the one to the left and the one above: 0 to 63.
    pub change: usize,
    /// The signed errors to the left, above, and above to the right, in steps.
    pub errors: [f64; 3],
    /// The contexts of all views except the first.
    pub views: [usize; VIEWS],
}

impl Site {
    /// The site of the cell in a column with these neighbours, given the intensities of its row and of the
    /// row above (empty for the first row).
    #[inline]
    pub fn of(
        (levels, levels_above): (&[u16], &[u16]),
        near: Neighbourhood,
        errors: &NearbyErrors,
        error_levels: &ErrorLevels,
        column: usize,
    ) -> Site {
        let features = near.features();
        let is_edge = |difference: f32| usize::from(difference.abs() > EDGE.into());
        let edge = is_edge(features[0]) + 2 * is_edge(features[3] - features[4]);
        let error_level = error_levels.of(errors.expected(column));
        let context = near.activity_level() * ERROR_LEVELS + error_level;
        let coarse_error = error_level * 8 / ERROR_LEVELS;
        let own = levels[column];
        let west = if column > 0 { levels[column - 1] } else { 0 };
        let north = levels_above.get(column).copied().unwrap_or(0);
        let change = intensity_change(own, west) * 8 + intensity_change(own, north);
        let views = [
            0,
            pair(errors.west, errors.north(column)),
            usize::from(own).min(127) * 8 + coarse_error,
            (change * 4 + usize::from(own / 8).min(3)) * 8 + coarse_error,
        ];
        let intensities = [own, west, north];
        let errors = [errors.west, errors.north(column), errors.north_east(column)];
        Site { near, features, intensities, edge, error_level, context, change, errors, views }
    }

    /// The predictions from the neighbours; the last one is for surprises.
    pub fn predictions(&self, fit: f64) -> [f32; PREDICTORS] {
        let Neighbourhood { west, west2, north, .. } = self.near;
        [west, north, 2.0 * west - west2, west + fit, west].map(|value| value as f32)
    }

    /// The base of the coding, in whole steps.
    pub fn base(&self, fit: f64, range_bits: u32) -> i64 {
        ((self.near.west + fit + 0.5) as i64).clamp(1, (1 << range_bits) - 2)
    }

    /// The contexts of all views for this base.
    pub fn views_from(&self, base: i64) -> [usize; VIEWS] {
        let base = base as f64;
        let mut views = self.views;
        views[0] = pair(self.near.west - base, self.near.north - base);
        views
    }

    /// Adapts a fit, which predicted `fit`, to the coded range.
    pub fn learn<const F: usize>(
        &self,
        fits: &mut LeastSquares<F>,
        features: &[f32; F],
        fit: f64,
        range: f64,
    ) {
        let (target, weight) = self.sample(fit, range);
        fits.learn(features, target, weight);
    }

    /// What a fit that predicted `fit` learns from the coded range: its target, and the weight.
    #[inline(always)]
    pub fn sample(&self, fit: f64, range: f64) -> (f32, f32) {
        let target = within_reach(range - self.near.west);
        let error = range - self.near.west - fit;
        let weight = 1.0 / (25.0 + error * error);
        (target as f32, weight as f32)
    }
}

/// Two differences as one context of 1024.
pub fn pair(a: f64, b: f64) -> usize {
    signed_level(a as i32) * 32 + signed_level(b as i32)
}

/// Eight classes of the difference from a neighbour's intensity; the last if it holds no return.
pub fn intensity_change(own: u16, other: u16) -> usize {
    if other == 0 {
        return 7;
    }
    let change = i32::from(own) - i32::from(other);
    let size = match change.abs() {
        0..2 => 0,
        2..6 => 1,
        6..16 => 2,
        _ => 3,
    };
    if change < 0 && size > 0 { size + 3 } else { size }
}

/// The coded ranges that the prediction of a cell uses; 0 where there is no return.
pub struct Window {
    /// The current row and the two above, with margins of empty cells.
    rows: [Vec<f64>; 3],
    /// The last returns of the row, nearest first.
    left: [f64; 5],
}

impl Window {
    /// Empty cells on either side.
    const MARGIN: usize = 2;

    /// Creates the window for an image of `width` columns.
    pub fn new(width: usize) -> Self {
        Window { rows: std::array::from_fn(|_| vec![0.0; width + 2 * Self::MARGIN]), left: [0.0; 5] }
    }

    /// Starts the next row.
    pub fn start_row(&mut self) {
        self.rows.rotate_right(1);
        self.rows[0].fill(0.0);
        self.left = [0.0; 5];
    }

    /// Adds a return.
    pub fn push(&mut self, column: usize, range: f64) {
        self.rows[0][column + Self::MARGIN] = range;
        self.left.rotate_right(1);
        self.left[0] = range;
    }

    /// The ranges around a cell of the current row.
    #[inline]
    pub fn around(&self, column: usize) -> Neighbourhood {
        let or = |range: f64, other: f64| if range > 0.0 { range } else { other };
        let &[nww, nw, n, ne, nee] = self.rows[1][column..].first_chunk().unwrap_or(&[0.0; 5]);
        let &[_, nnw, nn, nne, _] = self.rows[2][column..].first_chunk().unwrap_or(&[0.0; 5]);
        let west = or(self.left[0], or(n, or(nw, or(ne, TYPICAL_RANGE.into()))));
        let west2 = or(self.left[1], west);
        let west3 = or(self.left[2], west2);
        let north = or(n, or(ne, or(nw, west)));
        let north_west = or(nw, north);
        let north_east = or(ne, north);
        let north_east2 = or(nee, north_east);
        let north2 = or(nn, north);
        let west4 = or(self.left[3], west3);
        let farther = [or(self.left[4], west4), or(nww, north_west), or(nnw, north2), or(nne, north2)];
        Neighbourhood {
            west,
            west2,
            west3,
            west4,
            north,
            north_west,
            north_east,
            north_east2,
            north2,
            farther,
        }
    }
}

/// The ranges around a cell, with missing ones replaced by the next best.
pub struct Neighbourhood {
    pub west: f64,
    pub west2: f64,
    pub west3: f64,
    west4: f64,
    pub north: f64,
    north_west: f64,
    pub north_east: f64,
    north_east2: f64,
    north2: f64,
    /// The fifth to the left, the second to the left of the one above, and those beside the second above.
    farther: [f64; 4],
}

impl Neighbourhood {
    /// Differences to the left neighbour.
    pub fn features(&self) -> [f32; FEATURES] {
        [
            self.west2,
            self.west3,
            self.west4,
            self.north,
            self.north_west,
            self.north_east,
            self.north_east2,
            self.north2,
        ]
        .map(|range| self.feature(range))
    }

    /// The differences to the left neighbour for the farther ranges.
    pub fn farther_features(&self) -> [f32; 4] {
        self.farther.map(|range| self.feature(range))
    }

    /// A range as its difference to the left neighbour.
    #[inline]
    pub fn feature(&self, range: f64) -> f32 {
        (range - self.west).clamp(-f64::from(FEATURE_REACH), FEATURE_REACH.into()) as f32
    }

    /// The roughness of the surroundings, in octaves.
    fn activity_level(&self) -> usize {
        let activity = (self.west - self.west2).abs()
            + (self.north - self.north_west).abs()
            + (self.north - self.north_east).abs();
        let octaves = (activity as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(ACTIVITY_LEVELS - 1)
    }
}

/// The prediction errors to the left and above.
pub struct NearbyErrors {
    /// Running mean of the magnitudes along the row.
    mean: f32,
    /// For each column, the running mean of the magnitudes down the rows: up to the row above, and including
    /// the current row.
    above: Vec<f32>,
    current: Vec<f32>,
    /// The signed error of the left neighbour, and those of the row above.
    pub west: f64,
    signed_above: Vec<f32>,
    signed_current: Vec<f32>,
    has_row_above: bool,
}

impl NearbyErrors {
    /// Creates the errors for an image of `width` columns.
    pub fn new(width: usize) -> Self {
        let zeros = vec![0.0; width];
        NearbyErrors {
            mean: 0.0,
            above: zeros.clone(),
            current: zeros.clone(),
            west: 0.0,
            signed_above: zeros.clone(),
            signed_current: zeros,
            has_row_above: false,
        }
    }

    /// Starts the next row.
    pub fn start_row(&mut self, has_row_above: bool) {
        self.mean = 20.0;
        self.west = 0.0;
        self.has_row_above = has_row_above;
        std::mem::swap(&mut self.above, &mut self.current);
        std::mem::swap(&mut self.signed_above, &mut self.signed_current);
    }

    /// The expected error in a column, in steps.
    pub fn expected(&self, column: usize) -> f32 {
        self.mean + 0.5 * self.above[column]
    }

    /// The signed error above a cell.
    pub fn north(&self, column: usize) -> f64 {
        f64::from(self.signed_above[column])
    }

    /// The signed error above and to the right; 0 outside the image.
    pub fn north_east(&self, column: usize) -> f64 {
        self.signed_above.get(column + 1).copied().map_or(0.0, f64::from)
    }

    /// Skips a column without a return, whose mean is not changed.
    pub fn skip(&mut self, column: usize) {
        self.current[column] = self.above[column];
        self.signed_current[column] = self.signed_above[column];
    }

    /// Records the errors of the least-squares fit and of the base of the coding.
    pub fn record(&mut self, column: usize, fit_error: f64, base_error: f64) {
        let magnitude = fit_error.abs().min(FEATURE_REACH.into()) as f32;
        self.mean = 0.6 * self.mean + 0.4 * magnitude;
        self.current[column] =
            if self.has_row_above { 0.5 * self.above[column] + 0.5 * magnitude } else { magnitude };
        self.west = base_error;
        self.signed_current[column] = base_error as f32;
    }
}

/// Features of a least-squares fit that come from [`Surroundings`].
pub const SURROUNDING_FEATURES: usize = 6;
/// In steps; the error assumed at the start of a row.
const TYPICAL_ERROR: f32 = 20.0;

/// The ranges of an earlier frame for a cell, in both layers.
#[derive(Clone)]
pub struct Back {
    /// The range in the layer of the same cells, or else in the moved layer; for `moved` it is the reverse.
    pub same: f64,
    pub moved: f64,
    pub same_west: f64,
    pub same_east: f64,
    /// The recent error of the reference around here, in octaves.
    pub level: usize,
}

impl Back {
    /// The reference of a cell; `None` if no earlier frame has a return there.
    pub fn at(reference: &Reference, errors: &ReferenceErrors, cell: (usize, usize)) -> Option<Self> {
        let at = |layer: &Layer, right| f64::from(layer.steps.beside(cell, 0, right));
        let or = |range: f64, other: f64| if range > 0.0 { range } else { other };
        let (same, moved) = (at(&reference.same, 0), at(&reference.moved, 0));
        if same == 0.0 && moved == 0.0 {
            return None;
        }
        let (same, moved) = (or(same, moved), or(moved, same));
        let (same_west, same_east) = (or(at(&reference.same, -1), same), or(at(&reference.same, 1), same));
        Some(Back { same, moved, same_west, same_east, level: errors.level(cell.1) })
    }

    /// Differences to the left neighbour.
    pub fn features(&self, near: &Neighbourhood) -> [f32; REFERENCE_FEATURES] {
        [self.same, self.same_west, self.same_east, self.moved].map(|range| near.feature(range))
    }
}

/// Further values of an earlier frame around a cell: ranges, with the cell's own in place of missing ones,
/// and the context levels of intensities, 0 for none.
pub struct Surroundings {
    pub moved_west: f64,
    pub moved_east: f64,
    pub moved_east2: f64,
    pub moved_east3: f64,
    pub moved_north: f64,
    moved_south: f64,
    same_north: f64,
    same_south: f64,
    pub same_level: u16,
    pub moved_level: u16,
}

impl Surroundings {
    /// The surroundings of a cell.
    pub fn of(reference: &Reference, back: &Back, cell: (usize, usize)) -> Self {
        let at = |layer: &Layer, down, right, other| {
            let range = f64::from(layer.steps.beside(cell, down, right));
            if range > 0.0 { range } else { other }
        };
        let moved = |down, right| at(&reference.moved, down, right, back.moved);
        let same = |down| at(&reference.same, down, 0, back.same);
        Surroundings {
            moved_west: moved(0, -1),
            moved_east: moved(0, 1),
            moved_east2: moved(0, 2),
            moved_east3: moved(0, 3),
            moved_north: moved(-1, 0),
            moved_south: moved(1, 0),
            same_north: same(-1),
            same_south: same(1),
            same_level: reference.same.levels[cell],
            moved_level: reference.moved.levels[cell],
        }
    }

    /// Differences to the left neighbour.
    pub fn features(&self, near: &Neighbourhood) -> [f32; SURROUNDING_FEATURES] {
        [
            self.moved_west,
            self.moved_east,
            self.moved_north,
            self.moved_south,
            self.same_north,
            self.same_south,
        ]
        .map(|range| near.feature(range))
    }
}

/// The errors of the reference to the left and above.
pub struct ReferenceErrors {
    mean: f32,
    above: Vec<f32>,
}

impl ReferenceErrors {
    /// Creates the errors for an image of `width` columns.
    pub fn new(width: usize) -> Self {
        ReferenceErrors { mean: TYPICAL_ERROR, above: vec![0.0; width] }
    }

    /// Starts the next row.
    pub fn start_row(&mut self) {
        self.mean = TYPICAL_ERROR;
    }

    /// The expected error, in octaves.
    fn level(&self, column: usize) -> usize {
        let error = self.mean + 0.5 * self.above[column];
        let octaves = ((error * 0.5) as u32).checked_ilog2().map_or(0, |octave| octave as usize + 1);
        octaves.min(REFERENCE_LEVELS - 1)
    }

    /// Records the error of the better of a cell's two references.
    pub fn record(&mut self, column: usize, range: f64, back: &Back) {
        let error =
            (range - back.same).abs().min((range - back.moved).abs()).min(FEATURE_REACH.into()) as f32;
        self.mean = 0.6 * self.mean + 0.4 * error;
        self.above[column] = 0.5 * self.above[column] + 0.5 * error;
    }
}
