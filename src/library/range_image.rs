//! A scan as a table of ranges.

use crate::frame::decoder::DecodedImage;

/// The points of a scan in the rows and columns of the scanner: a row for each laser, a column for each
/// azimuth at which the lasers fired. Second returns, and points that the scanner's formula does not explain,
/// have no cell.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeImage {
    rows: usize,
    columns: usize,
    ranges: Vec<f32>,
    points: Vec<Option<u32>>,
}

impl RangeImage {
    /// The decoded image for the public interface.
    pub(super) fn new(decoded: &DecodedImage, positions: &[[f32; 3]]) -> Self {
        let (steps, scanner) = (&decoded.image.steps, &decoded.scanner);
        let points = decoded.point_of_cell.cells().to_vec();
        let range = |(&steps, point): (&u32, &Option<u32>)| match (steps, point) {
            (0, _) => 0.0,
            // The scanner's ranges are not multiples of a step.
            (_, Some(point)) if scanner.range_step_m() == 0.0 => {
                let position = positions.get(*point as usize).copied().unwrap_or_default();
                position.iter().map(|metres| f64::from(*metres).powi(2)).sum::<f64>().sqrt() as f32
            }
            _ => scanner.metres(steps) as f32,
        };
        let ranges = steps.cells().iter().zip(&points).map(range).collect();
        RangeImage { rows: steps.rows(), columns: steps.columns(), ranges, points }
    }

    /// Number of lasers.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of azimuths.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The range of the first return of each cell from the laser, in metres, row after row; 0 for cells
    /// without one.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// The index of the scan's point in each cell, counted from 0, row after row. Records without a measured
    /// point that were kept have a cell, too.
    pub fn points(&self) -> &[Option<u32>] {
        &self.points
    }
}
