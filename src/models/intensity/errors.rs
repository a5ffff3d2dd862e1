//! The prediction errors around a return. FORMAT.md 8.5, "Levels, if `coder` is 1".

/// The error assumed where nothing was coded yet, in context levels.
const TYPICAL_ERROR: f32 = 4.0;

/// The mean errors along the row and down each column, in context levels.
#[derive(Clone, Debug)]
pub struct MeanErrors {
    mean: f32,
    above: Vec<f32>,
}

impl Default for MeanErrors {
    fn default() -> Self {
        MeanErrors { mean: TYPICAL_ERROR, above: Vec::new() }
    }
}

impl MeanErrors {
    /// Starts a frame with `columns` columns.
    pub fn start_frame(&mut self, columns: usize) {
        self.start_row();
        self.above.clear();
        self.above.resize(columns, TYPICAL_ERROR);
    }

    /// Starts a row.
    pub fn start_row(&mut self) {
        self.mean = TYPICAL_ERROR;
    }

    /// The expected error in a column.
    #[inline]
    pub fn expected(&self, column: usize) -> f32 {
        self.mean + 0.5 * self.above[column]
    }

    /// Adds the magnitude of an error.
    #[inline]
    pub fn record(&mut self, column: usize, magnitude: f32) {
        self.mean = 0.6 * self.mean + 0.4 * magnitude;
        self.above[column] = 0.5 * self.above[column] + 0.5 * magnitude;
    }
}
