//! The intensities: levels on a grid such as hundredths, coded bit by bit from counters in contexts of the
//! neighbours' levels, with few contexts (light) or many (deep). The levels around a return, and how well
//! these were predicted. FORMAT.md 8.5.

mod deep;
mod light;
mod scale;
mod tokens;

use deep::DeepLevels;
use light::LightLevels;
pub use scale::IntensityScale;
pub use tokens::{INTENSITY_CONTEXTS, IntensityTokens};

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::inter::{Layer, Reference};
use crate::models::quantise::signed_level;

/// The adaptive models of intensities.
#[derive(Clone, Default)]
pub struct IntensityModel {
    light: LightLevels,
    /// The deep model, once a frame has used it; it then replaces the light one.
    deep: Option<Box<DeepLevels>>,
    exception: AdaptiveBit,
    off_grid: IntegerModel,
    last_off_grid: u32,
    is_deep: bool,
}

impl IntensityModel {
    /// Sets whether the deep model is used from now on.
    pub fn use_deep(&mut self, is_deep: bool) {
        self.is_deep = is_deep;
    }

    /// Starts an image with these numbers of rows and columns, or its strays, with `values` values. The scale is on
    /// a grid.
    pub fn start_frame(&mut self, scale: &IntensityScale, (rows, columns): (usize, usize), values: usize) {
        debug_assert!(scale.is_on_grid());
        if self.is_deep {
            self.deep.get_or_insert_default().start_frame(columns, values);
        } else {
            self.light.start_frame(scale.bits(), rows, values);
        }
    }

    /// Starts a row.
    pub fn start_row(&mut self) {
        if let Some(deep) = self.deep.as_mut().filter(|_| self.is_deep) {
            deep.start_row();
        }
    }

    /// Codes one value. `row` and `column` serve only as contexts.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        value: f32,
    ) -> f32 {
        let level = scale.level_of(value);
        if scale.has_exceptions() && self.exception.code(coder, level.is_none()) {
            return self.code_off_grid(coder, value);
        }
        let level = level.unwrap_or(0);
        let level = match self.deep.as_mut().filter(|_| self.is_deep) {
            Some(deep) => deep.code(coder, scale, near, (row, column), level),
            None => self.light.code(coder, scale.bits(), near, row, level),
        };
        if C::ENCODES { value } else { scale.value_of(level) }
    }

    /// Codes a value that is not on the grid as the difference between its bits and those of the last such
    /// value.
    fn code_off_grid<C: BitCoder>(&mut self, coder: &mut C, value: f32) -> f32 {
        let difference = i64::from(value.to_bits()) - i64::from(self.last_off_grid);
        let difference = self.off_grid.code_signed(coder, difference);
        self.last_off_grid = i64::from(self.last_off_grid).wrapping_add(difference) as u32;
        f32::from_bits(self.last_off_grid)
    }
}

/// The context level assumed if nothing is known.
const TYPICAL_LEVEL: u16 = 20;

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
    /// The levels of the same cell, of those one to its left, one to its right and two to its right.
    pub same: [u16; 4],
    /// The levels of the moved surfaces that are visible here, one to the left, one and two to the right, and
    /// two to the left.
    pub moved: [u16; 5],
    /// How much farther the moved surface is than the one to its left, the same cell, and the one to its
    /// right: classes of [`signed_level`], 0 if one of the two is missing.
    pub farther: [usize; 3],
}

/// The unit of such differences, in steps.
const FARTHER_UNIT: i32 = 4;

impl IntensityReference {
    /// The levels around a cell; `None` if no earlier frame has a return there.
    pub fn at(reference: &Reference, cell: (usize, usize)) -> Option<Self> {
        let Reference { same: same_layer, moved: moved_layer } = reference;
        let level = |layer: &Layer, right| layer.levels.beside(cell, 0, right);
        let same = [0, -1, 1, 2].map(|right| level(same_layer, right));
        let moved = [0, -1, 1, 2, -2].map(|right| level(moved_layer, right));
        if same[0] == 0 && moved[0] == 0 {
            return None;
        }
        let steps = |layer: &Layer, right| layer.steps.beside(cell, 0, right);
        let here = steps(moved_layer, 0);
        let others = [steps(moved_layer, -1), steps(same_layer, 0), steps(moved_layer, 1)];
        let farther = others.map(|other| match (here, other) {
            (0, _) | (_, 0) => 0,
            _ => signed_level((here as i32 - other as i32) / FARTHER_UNIT),
        });
        Some(IntensityReference { same, moved, farther })
    }

    /// The level of the same cell, or else of the moved surface.
    pub fn level(&self) -> u16 {
        if self.same[0] > 0 { self.same[0] } else { self.moved[0] }
    }
}

/// The error assumed where nothing was coded yet, in context levels.
const TYPICAL_ERROR: f32 = 4.0;

/// The mean errors along the row and down each column, in context levels.
#[derive(Clone, Debug)]
struct MeanErrors {
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
    fn start_frame(&mut self, columns: usize) {
        self.start_row();
        self.above.clear();
        self.above.resize(columns, TYPICAL_ERROR);
    }

    /// Starts a row.
    fn start_row(&mut self) {
        self.mean = TYPICAL_ERROR;
    }

    /// The expected error in a column.
    #[inline]
    fn expected(&self, column: usize) -> f32 {
        self.mean + 0.5 * self.above[column]
    }

    /// Adds the magnitude of an error.
    #[inline]
    fn record(&mut self, column: usize, magnitude: f32) {
        self.mean = 0.6 * self.mean + 0.4 * magnitude;
        self.above[column] = 0.5 * self.above[column] + 0.5 * magnitude;
    }
}

#[cfg(test)]
mod tests;
