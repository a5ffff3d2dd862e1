//! The coding of corrections of coordinates, in float32 units. FORMAT.md 8.15.

use crate::entropy::{BitCoder, IntegerModel};
use crate::ground::varint::{unzigzag, zigzag};

/// Number of contexts of units: the exponent of the coordinate, clamped to the range in which it matters.
const EXPONENTS: usize = 16;
/// The biased exponent of the first context: 2^-11 m.
const FIRST_EXPONENT: i32 = 127 - 11;

/// A class of coordinates by their size: 0 for the smallest.
pub fn exponent_of(value: f32) -> usize {
    let exponent = (value.to_bits() >> 23 & 0xff) as i32;
    (exponent - FIRST_EXPONENT).clamp(0, EXPONENTS as i32 - 1) as usize
}

/// The adaptive models of corrections, by axis and exponent.
#[derive(Default)]
pub struct UnitModel([[IntegerModel; EXPONENTS]; 3]);

impl UnitModel {
    /// Codes the values added to the coordinates of a point that starts at `start`.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, start: &[f32; 3], units: &mut [i64; 3]) {
        for axis in 0..3 {
            let model = &mut self.0[axis][exponent_of(start[axis])];
            units[axis] = unzigzag(model.code(coder, zigzag(units[axis])));
        }
    }
}
