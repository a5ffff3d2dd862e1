//! The intensities around a return, and how well these were predicted. FORMAT.md 8.5, "Neighbours" and
//! "Levels, if `coder` is 1".

use crate::inter::Reference;

/// The context level assumed if nothing is known.
pub const TYPICAL_LEVEL: u16 = 20;

/// The context levels (1 to 128, 0 = none) of the returns around a return.
#[derive(Clone, Copy, Debug, Default)]
pub struct IntensityNeighbours {
    /// The last four returns of the row, nearest first.
    pub left: [u16; 4],
    /// In the row above: two columns left, one left, above, one right, two right.
    pub above: [u16; 5],
    /// Two rows above: one column left, above, one right.
    pub above2: [u16; 3],
    /// The levels of an earlier frame, if it has a return here.
    pub back: Option<IntensityReference>,
}

/// The context levels of an earlier frame around a return; 0 = none.
#[derive(Clone, Copy, Debug)]
pub struct IntensityReference {
    /// The levels of the same cell and of the cells to its left and right.
    pub same: [u16; 3],
    /// The level of the moved surface that is visible here.
    pub moved: u16,
}

impl IntensityReference {
    /// The levels around a cell; `None` if no earlier frame has a return there.
    pub fn at(reference: &Reference, cell: (usize, usize)) -> Option<Self> {
        let same = [0, -1, 1].map(|right| reference.same.levels.beside(cell, 0, right));
        let moved = reference.moved.levels.beside(cell, 0, 0);
        (same[0] > 0 || moved > 0).then_some(IntensityReference { same, moved })
    }

    /// The level of the same cell, or else of the moved surface.
    pub fn level(&self) -> u16 {
        if self.same[0] > 0 { self.same[0] } else { self.moved }
    }
}

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
