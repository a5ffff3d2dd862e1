//! The intensities: levels on a grid such as hundredths, coded bit by bit from counters in contexts of the
//! neighbours' levels, with few contexts (light) or many (deep). FORMAT.md 8.5.

mod deep;
mod light;
mod neighbours;
mod scale;
#[cfg(test)]
mod tests;
mod tokens;

pub use neighbours::{IntensityNeighbours, IntensityReference};
pub use scale::IntensityScale;
pub use tokens::{INTENSITY_CONTEXTS, IntensityTokens};

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use deep::DeepLevels;
use light::LightLevels;

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
