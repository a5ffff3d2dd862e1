//! The inverse of the formula for several points at a time, near their expected ticks. For the encoder, in
//! whose input nearly every point is one tick after the one before.

use std::f64::consts::TAU;

use super::Hdl64;
use super::model::ON_CONE;
use crate::ground::lanes::lanes;
use crate::ground::rounding::round_ties_even;
use crate::scanner::FLOAT_RANGES;

/// Within this many ticks an angle can be replaced by its sine.
const NEAR: f64 = 32.0;

impl Hdl64 {
    /// The ticks and range steps of points (metres, as in the file) of beam `row`, all near tick `hint`.
    /// `None` if any of them is not near it, is not on the file's grid, or deviates from the formula by
    /// `reach` metres or more along an axis.
    #[inline(always)]
    pub fn invert_near<const N: usize>(
        &self,
        row: usize,
        points: &[[f32; 3]; N],
        hint: u32,
        reach: f64,
    ) -> Option<[(u32, u32); N]> {
        let (beam, turn) = (&self.beams[row], f64::from(self.ticks));
        if self.range_step_um == FLOAT_RANGES || turn < 16.0 * NEAR {
            return None;
        }
        let [x, y, z]: [[f64; N]; 3] = [0, 1, 2].map(|axis| lanes(|i| f64::from(points[i][axis])));
        let rho: [f64; N] = lanes(|i| (x[i] * x[i] + y[i] * y[i]).sqrt());
        let (cos, sin) = beam.heading(self.ticks_of_turn.get(hint));
        let turned: [f64; N] = lanes(|i| (y[i] * cos - x[i] * sin - beam.h) / rho[i] * (turn * (1.0 / TAU)));
        let steps: [f64; N] =
            lanes(|i| round_ties_even(beam.range(rho[i], z[i]) * (1e6 / f64::from(self.range_step_um))));
        let most = f64::from(self.most_steps());
        let is_expected = |i: usize| {
            ((beam.height_at(rho[i]) - z[i]).abs() < ON_CONE)
                & (turned[i].abs() < NEAR)
                & (x[i] * cos + y[i] * sin > 0.0)
                & (steps[i] >= 1.0)
                & (steps[i] <= most)
        };
        // Loops rather than calls, which would not be compiled for the same vector unit.
        let mut all_expected = true;
        for i in 0..N {
            all_expected &= is_expected(i);
        }
        if !all_expected {
            return None;
        }
        let ticks: [u32; N] = lanes(|i| {
            let tick = hint as i32 + round_ties_even(turned[i]) as i32;
            let (first, end) = (tick < 0, tick >= self.ticks as i32);
            (tick + self.ticks as i32 * (i32::from(first) - i32::from(end))) as u32
        });
        let metres: [f64; N] = lanes(|i| steps[i] * self.range_step_m());
        let formula = beam.points(self.ticks_of_turn.at(ticks), metres);
        let mut all_near = true;
        for (axis, values) in [x, y, z].into_iter().enumerate() {
            for i in 0..N {
                all_near &= (formula[axis][i] - values[i]).abs() < reach;
            }
            all_near &= self.coordinates.holds_all(values, formula[axis]);
        }
        all_near.then(|| lanes(|i| (ticks[i], steps[i] as u32)))
    }
}
