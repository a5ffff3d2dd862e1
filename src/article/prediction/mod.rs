//! The prediction of ranges; the residuals are coded by a back-end or an image coder. FORMAT.md 8.13.

pub mod intra;
pub mod ransac;
pub mod surface;

mod partition;
mod rays;
pub(crate) mod snake;

pub use rays::Rays;

use crate::ground::grid::Grid;

/// Predicted ranges, and whether their residuals are predicted again along the snake's path.
pub struct Predictor {
    /// Rows x columns, in steps; `None`: no prediction.
    pub ranges: Option<Grid<u32>>,
    /// Whether the snake's path is used (article, V-C).
    pub snake: bool,
}

impl Predictor {
    /// The residuals of the ranges (steps, rows x columns), for each return in scan order.
    pub fn residuals(&self, occupancy: &Grid<bool>, steps: &Grid<u32>) -> Vec<i32> {
        let mut values = self.differences(occupancy, steps);
        if self.snake {
            snake::difference(occupancy, &mut values);
        }
        let mut residuals = Vec::new();
        each_return(occupancy, |cell| residuals.push(values[cell]));
        residuals
    }

    /// The inverse of [`residuals`](Self::residuals), given one residual for each return. If they are
    /// damaged, any ranges may result.
    pub fn restore(&self, occupancy: &Grid<bool>, residuals: &[i32]) -> Grid<u32> {
        let mut values = Grid::new(occupancy.rows(), occupancy.columns());
        let mut next = residuals.iter();
        each_return(occupancy, |cell| values[cell] = next.next().copied().unwrap_or_default());
        if self.snake {
            snake::sum(occupancy, &mut values);
        }
        let mut steps = Grid::new(occupancy.rows(), occupancy.columns());
        each_return(occupancy, |cell| steps[cell] = (values[cell] as u32).wrapping_add(self.predicted(cell)));
        steps
    }

    /// The difference between each return and its prediction (equation 7), in steps, rows x columns; 0 for
    /// other cells.
    pub fn differences(&self, occupancy: &Grid<bool>, steps: &Grid<u32>) -> Grid<i32> {
        let mut values = Grid::new(steps.rows(), steps.columns());
        each_return(occupancy, |cell| values[cell] = steps[cell].wrapping_sub(self.predicted(cell)) as i32);
        values
    }

    /// The ranges of the returns, given approximate differences: from 1 to `most` steps.
    pub fn restore_within(&self, occupancy: &Grid<bool>, differences: &Grid<i32>, most: u32) -> Grid<u32> {
        let mut steps = Grid::new(occupancy.rows(), occupancy.columns());
        each_return(occupancy, |cell| {
            let range = i64::from(self.predicted(cell)) + i64::from(differences[cell]);
            steps[cell] = range.clamp(1, i64::from(most)) as u32;
        });
        steps
    }

    fn predicted(&self, cell: (usize, usize)) -> u32 {
        self.ranges.as_ref().map_or(0, |ranges| ranges[cell])
    }
}

/// Visits the returns in scan order: row by row, from the left.
fn each_return(occupancy: &Grid<bool>, mut visit: impl FnMut((usize, usize))) {
    for row in 0..occupancy.rows() {
        let filled = occupancy.row(row).iter().enumerate().filter(|(_, filled)| **filled);
        filled.for_each(|(column, _)| visit((row, column)));
    }
}
