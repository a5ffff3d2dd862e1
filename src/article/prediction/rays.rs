//! The rays of a range image. FORMAT.md 8.12.

use super::surface::SurfaceModel;
use crate::scanner::hdl64::Hdl64;

/// The direction of each pixel of a range image.
pub struct Rays<'a> {
    scanner: &'a Hdl64,
    /// Column tick of each column.
    columns: &'a [u32],
}

impl<'a> Rays<'a> {
    /// The rays of an image with these columns.
    pub fn of(scanner: &'a Hdl64, columns: &'a [u32]) -> Self {
        Rays { scanner, columns }
    }

    /// The range that a model predicts for a pixel, in steps.
    #[inline]
    pub fn range(&self, model: &SurfaceModel, cell: (usize, usize)) -> u32 {
        model.range(self.scanner, self.direction(cell))
    }

    /// The end point of a range of `steps`, in metres, as if all beams started at one point.
    pub fn point(&self, cell: (usize, usize), steps: u32) -> [f64; 3] {
        let metres = self.scanner.metres(steps);
        self.direction(cell).map(|v| v * metres)
    }

    #[inline]
    fn direction(&self, (row, column): (usize, usize)) -> [f64; 3] {
        self.scanner.direction(row, self.scanner.tick_of_column(row, self.columns[column]))
    }
}
