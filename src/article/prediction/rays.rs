//! The rays of a range image.

use super::surface::SurfaceModel;
use crate::scanner::Hdl64;

/// The direction of each pixel of a range image.
pub struct Rays<'a> {
    sensor: &'a Hdl64,
    /// Column tick of each column.
    columns: &'a [u32],
}

impl<'a> Rays<'a> {
    /// The rays of an image with these columns.
    pub fn of(sensor: &'a Hdl64, columns: &'a [u32]) -> Self {
        Rays { sensor, columns }
    }

    /// The range that a model predicts for a pixel, in steps.
    #[inline]
    pub fn range(&self, model: &SurfaceModel, cell: (usize, usize)) -> u32 {
        model.range(self.sensor, self.direction(cell))
    }

    /// The end point of a range of `steps`, in metres, as if all beams started at one point.
    pub fn point(&self, cell: (usize, usize), steps: u32) -> [f64; 3] {
        let metres = self.sensor.metres(steps);
        self.direction(cell).map(|v| v * metres)
    }

    #[inline]
    fn direction(&self, (row, column): (usize, usize)) -> [f64; 3] {
        self.sensor.direction(row, self.sensor.tick_of_column(row, self.columns[column]))
    }
}
