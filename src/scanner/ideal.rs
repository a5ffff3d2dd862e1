//! The ideal scanner of the article (IV-A, equation 2): all beams start at one point, at the elevations
//! published by the manufacturer, and all columns are equally spaced. For scanners other than the article's
//! it has the elevations estimated by the fit.

use std::f64::consts::TAU;

use super::hdl64::{BeamConstants, Hdl64};
use super::{CoordinateGrid, Scanner};

/// Elevation of the highest beam of the HDL-64E's upper block, in degrees (user's manual).
const UPPER_TOP: f64 = 2.0;
/// Degrees between the 32 beams of the upper block.
const UPPER_STEP: f64 = 1.0 / 3.0;
/// Elevation of the highest beam of the lower block, in degrees.
const LOWER_TOP: f64 = -8.83;
/// Degrees between the 32 beams of the lower block.
const LOWER_STEP: f64 = 0.5;
/// Beams of one block.
const BLOCK: usize = 32;

/// An HDL-64E as modelled by the article: 64 rows by `columns` columns (2000 for 0.18 degrees), with column 0
/// along x and ranges in steps of `range_step_um` micrometres. Neither may be 0.
pub fn ideal(columns: u32, range_step_um: u32) -> Hdl64 {
    let elevations = (0..BLOCK)
        .map(|beam| UPPER_TOP - UPPER_STEP * beam as f64)
        .chain((0..BLOCK).map(|beam| LOWER_TOP - LOWER_STEP * beam as f64));
    ideal_at(elevations.map(|degrees| degrees / 360.0 * TAU), columns, range_step_um)
}

/// As [`ideal`], with beams at these elevations in radians.
fn ideal_at(elevations: impl Iterator<Item = f64>, columns: u32, range_step_um: u32) -> Hdl64 {
    let beams = elevations.map(|radians| BeamConstants::quantise([radians, 0.0, 0.0, 0.0, 0.0])).collect();
    Hdl64::new(CoordinateGrid::Float32, columns, range_step_um, beams)
}

/// The ideal scanner for the scans of `scanner`: with its own elevations if it is of the `firings` family,
/// otherwise with the article's.
pub fn ideal_of(scanner: Option<&Scanner>, columns: u32, range_step_um: u32) -> Hdl64 {
    match scanner.and_then(Scanner::firings) {
        Some(scanner) => ideal_at(scanner.elevations(), columns, range_step_um),
        None => ideal(columns, range_step_um),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_spherical_coordinates() {
        let scanner = ideal(2000, 10_000);
        assert_eq!(scanner.rows(), 64);
        let [x, y, z] = scanner.point(0, 500, 1000);
        let up = (2.0f64).to_radians();
        assert!(x.abs() < 1e-6 && (y - 10.0 * up.cos()).abs() < 1e-6 && (z - 10.0 * up.sin()).abs() < 1e-6);
        assert_eq!(scanner.invert(0, [x, y, z]), Some((500, 1000)));
    }
}
