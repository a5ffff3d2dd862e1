//! The intensities: levels of a grid such as hundredths, each bit of a level mixed from counters
//! in several contexts of the neighbours' levels.

mod deep;
mod errors;
mod light;
mod mixed;
mod neighbours;
mod scale;
#[cfg(test)]
mod tests;
mod tokens;

pub use neighbours::{IntensityNeighbours, IntensityReference};
pub use scale::IntensityScale;
pub use tokens::{INTENSITY_CONTEXTS, IntensityTokens};

use super::Depth;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::varint::{unzigzag, zigzag};
use deep::DeepLevels;
use light::LightLevels;
use mixed::MixedLevels;

/// What the coder has learned about intensities.
#[derive(Clone, Default)]
pub struct IntensityModel {
    /// Once a frame goes no deeper than this.
    light: Option<Box<LightLevels>>,
    mixed: MixedLevels,
    /// Once a frame goes as deep as this.
    deep: Option<Box<DeepLevels>>,
    exception: AdaptiveBit,
    off_grid: IntegerModel,
    last_off_grid: u32,
    depth: Depth,
}

impl IntensityModel {
    /// How far to go from now on.
    pub fn set_depth(&mut self, depth: Depth) {
        self.depth = depth;
    }

    /// Begins a frame, or its strays, with `columns` columns and so many values.
    pub fn start_frame(&mut self, scale: &IntensityScale, columns: usize, values: usize) {
        match self.depth {
            Depth::Light => self.light.get_or_insert_default().start_frame(scale),
            Depth::Quick | Depth::Mixed => self.mixed.start_frame(self.depth, scale, columns),
            Depth::Deep => self.deep.get_or_insert_default().start_frame(columns, values),
        }
    }

    /// Begins a row.
    pub fn start_row(&mut self) {
        match (self.depth, &mut self.light, &mut self.deep) {
            (Depth::Light, ..) => {}
            (Depth::Deep, _, Some(deep)) => deep.start_row(),
            _ => self.mixed.start_row(),
        }
    }

    /// Codes one value. `row` and `column` only serve as contexts.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        scale: &IntensityScale,
        near: &IntensityNeighbours,
        (row, column): (usize, usize),
        value: f32,
    ) -> f32 {
        if !scale.is_on_grid() {
            return self.code_off_grid(coder, value);
        }
        let level = scale.level_of(value);
        if scale.has_exceptions() && self.exception.code(coder, level.is_none()) {
            return self.code_off_grid(coder, value);
        }
        let level = level.unwrap_or(0);
        let level = match (self.depth, &mut self.light, &mut self.deep) {
            (Depth::Light, Some(light), _) => light.code(coder, scale, near, row, level),
            (Depth::Deep, _, Some(deep)) => deep.code(coder, scale, near, (row, column), level),
            _ => self.mixed.code(coder, scale, near, (row, column), level),
        };
        if C::ENCODES { value } else { scale.value_of(level) }
    }

    /// A value on no grid: the difference of its bits from the last one's.
    fn code_off_grid<C: BitCoder>(&mut self, coder: &mut C, value: f32) -> f32 {
        let difference = i64::from(value.to_bits()) - i64::from(self.last_off_grid);
        let difference = unzigzag(self.off_grid.code(coder, zigzag(difference)));
        self.last_off_grid = i64::from(self.last_off_grid).wrapping_add(difference) as u32;
        f32::from_bits(self.last_off_grid)
    }
}
