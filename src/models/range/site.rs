//! A cell to be coded, described by its neighbours. FORMAT.md 8.6, "Neighbours".

use super::errors::NearbyErrors;
use super::neighbourhood::Neighbourhood;
use super::{EDGE, ERROR_LEVELS, ErrorLevels, FEATURES, PREDICTORS, VIEWS, within_reach};
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
