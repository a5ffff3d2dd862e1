//! What ranges are predicted from before a general-purpose back-end codes what is left.

mod snake;

use crate::grid::Grid;

/// A prediction, with all that a decoder knows of it.
pub enum Predictor {
    /// No prediction.
    None,
    /// The pixel before, on the snake's path.
    Snake,
}

impl Predictor {
    /// What is left of the ranges (steps, rows x columns), for each return in scan order.
    pub fn residuals(&self, occupancy: &Grid<bool>, steps: &Grid<u32>) -> Vec<i32> {
        let mut values = Grid::new(steps.rows(), steps.columns());
        each_return(occupancy, |cell| values[cell] = steps[cell] as i32);
        match self {
            Predictor::None => {}
            Predictor::Snake => snake::difference(occupancy, &mut values),
        }
        let mut residuals = Vec::new();
        each_return(occupancy, |cell| residuals.push(values[cell]));
        residuals
    }

    /// The inverse of [`residuals`](Self::residuals). There must be one for each return. The ranges
    /// may be any if the residuals are damaged.
    pub fn ranges(&self, occupancy: &Grid<bool>, residuals: &[i32]) -> Grid<u32> {
        let mut values = Grid::new(occupancy.rows(), occupancy.columns());
        let mut next = residuals.iter();
        each_return(occupancy, |cell| values[cell] = next.next().copied().unwrap_or_default());
        match self {
            Predictor::None => {}
            Predictor::Snake => snake::sum(occupancy, &mut values),
        }
        let mut steps = Grid::new(occupancy.rows(), occupancy.columns());
        each_return(occupancy, |cell| steps[cell] = values[cell] as u32);
        steps
    }
}

/// Visits the returns in scan order: row by row, each from the left.
fn each_return(occupancy: &Grid<bool>, mut visit: impl FnMut((usize, usize))) {
    for row in 0..occupancy.rows() {
        let filled = occupancy.row(row).iter().enumerate().filter(|(_, filled)| **filled);
        filled.for_each(|(column, _)| visit((row, column)));
    }
}
