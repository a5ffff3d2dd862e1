//! A scanner and an image for tests of functions that are compiled for several vector units.

use super::{BeamConstants, Hdl64};
use crate::ground::random::Rng;
use crate::scanner::{CoordinateGrid, RangeImage};

/// Some beams of an HDL-64E that pass the axis on either side, and an image with near returns, far returns
/// and cells without a return.
pub fn scanner() -> (Hdl64, RangeImage) {
    let constants = |beam: usize| {
        let beam = beam as f64;
        BeamConstants::quantise([
            0.01 * beam - 0.1,
            1.0 + 1e-4 * beam,
            0.1,
            0.026 - 0.0123 * beam,
            0.02 * beam,
        ])
    };
    let scanner = Hdl64::new(CoordinateGrid::Millimetre, 4000, 2000, (0..5).map(constants).collect());
    let mut image = RangeImage::new(5, (0..4000).step_by(2).collect());
    let mut random = Rng::keyed(1, &[]);
    for steps in image.steps.cells_mut() {
        *steps = match random.below(20) {
            0 => 0,
            1 => 1 + random.below(60_000) as u32,
            _ => 2000 + random.below(40) as u32,
        };
    }
    (scanner, image)
}
