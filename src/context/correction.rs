//! What the formula misses, in units of the file's grid.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::range_image::Return;
use crate::rounding::round_ties_even;
use crate::sensor::{Coordinates, SensorModel};
use crate::varint::{unzigzag, zigzag};

/// Distances to the border of a unit (in units) that make a difference: the formula is right to a
/// few micrometres, so only what lies closer to a border is ever rounded the other way.
const BORDER_DISTANCES: [f64; 7] = [0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.05];
/// Contexts of float32 corrections: how much finer the coordinate's unit is than the range's.
const FINENESS: usize = 24;

/// What the coder has learned about corrections.
pub struct CorrectionModel {
    /// For each distance to the border: whether there is a correction.
    any: Vec<AdaptiveBit>,
    /// Whether it goes over the border that is near.
    expected: Vec<AdaptiveBit>,
    /// The magnitudes that remain, for each axis and fineness.
    rest: Vec<IntegerModel>,
}

impl Default for CorrectionModel {
    fn default() -> Self {
        CorrectionModel {
            any: vec![AdaptiveBit::default(); 3 * (BORDER_DISTANCES.len() + 1)],
            expected: vec![AdaptiveBit::default(); BORDER_DISTANCES.len() + 1],
            rest: vec![IntegerModel::default(); 3 * FINENESS],
        }
    }
}

impl CorrectionModel {
    /// Codes the position of a return, given the formula's.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        sensor: &SensorModel,
        found: &Return,
        position: &mut [f32; 3],
    ) {
        let formula = sensor.point(found.row as usize, found.tick, found.steps);
        for axis in 0..3 {
            let predicted = sensor.coordinates.unit_of(formula[axis]);
            let actual = if C::ENCODES { sensor.coordinates.unit_in_file(position[axis]) } else { None };
            let correction = actual.map_or(0, |actual| actual - predicted);
            let correction = match sensor.coordinates {
                Coordinates::Millimetre => {
                    self.code_rounding(coder, axis, formula[axis] * 1000.0, correction)
                }
                Coordinates::Float32 => self.code_float(coder, axis, formula, correction),
            };
            position[axis] = sensor.coordinates.value(predicted.wrapping_add(correction), formula[axis]);
        }
    }

    /// A correction on a grid far coarser than the formula's errors: 0 but near a border.
    fn code_rounding<C: BitCoder>(&mut self, coder: &mut C, axis: usize, units: f64, correction: i64) -> i64 {
        let offset = units - round_ties_even(units);
        let level = BORDER_DISTANCES.iter().filter(|&&d| 0.5 - offset.abs() >= d).count();
        let any = &mut self.any[level * 3 + axis];
        if !any.code(coder, correction != 0) {
            return 0;
        }
        let over_border = if offset < 0.0 { -1 } else { 1 };
        if self.expected[level].code(coder, correction == over_border) {
            return over_border;
        }
        self.code_rest(coder, axis, correction)
    }

    /// A correction on a grid finer than the formula's errors, which are about the same length
    /// along every axis, however fine its unit is.
    fn code_float<C: BitCoder>(
        &mut self,
        coder: &mut C,
        axis: usize,
        formula: [f64; 3],
        correction: i64,
    ) -> i64 {
        let exponent = |v: f64| (v.to_bits() >> 52 & 0x7ff) as i64;
        let reach = formula.iter().map(|&v| exponent(v)).max().unwrap_or(0);
        let fineness = (reach - exponent(formula[axis])).clamp(0, FINENESS as i64 - 1) as usize;
        self.code_rest(coder, axis * FINENESS + fineness, correction)
    }

    fn code_rest<C: BitCoder>(&mut self, coder: &mut C, context: usize, correction: i64) -> i64 {
        unzigzag(self.rest[context].code(coder, zigzag(correction) & (u64::MAX >> 1)))
    }
}
