//! The prediction errors around a cell. FORMAT.md 8.6, "Learning".

use super::FEATURE_REACH;

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
