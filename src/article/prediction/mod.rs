//! The prediction of ranges; the residuals are coded by a back-end or an image coder. FORMAT.md 8.13.
//!
//! Residuals can be predicted again along a snake (article, V-C): each pixel from the one before it on a path
//! that runs through the rows in alternating directions, so that the first pixel of a row has its reference
//! right above.

pub mod intra;
pub mod ransac;
pub mod surface;

mod partition;

pub use surface::Rays;

use crate::ground::grid::Grid;
use crate::inter::snake_path;

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
            snake_difference(occupancy, &mut values);
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
            snake_sum(occupancy, &mut values);
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

/// Replaces the value of each return by its difference from the one before it on the path.
fn snake_difference(occupancy: &Grid<bool>, values: &mut Grid<i32>) {
    let mut before = 0;
    for cell in snake_path(occupancy) {
        let value = values[cell];
        values[cell] = value.wrapping_sub(before);
        before = value;
    }
}

/// The inverse of [`snake_difference`].
fn snake_sum(occupancy: &Grid<bool>, values: &mut Grid<i32>) {
    let mut before = 0i32;
    for cell in snake_path(occupancy) {
        before = before.wrapping_add(values[cell]);
        values[cell] = before;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_path_turns_at_the_ends_of_rows() {
        let mut occupancy = Grid::new(2, 3);
        for cell in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)] {
            occupancy[cell] = true;
        }
        assert_eq!(snake_path(&occupancy).collect::<Vec<_>>(), [(0, 0), (0, 1), (0, 2), (1, 2), (1, 0)]);
        let mut values = Grid::new(2, 3);
        for (row, column, value) in [(0, 0, 5), (0, 1, 7), (0, 2, 8), (1, 0, 1), (1, 1, 77), (1, 2, 9)] {
            values[(row, column)] = value;
        }
        snake_difference(&occupancy, &mut values);
        assert_eq!(values.cells(), [5, 2, 1, -8, 77, 1]);
    }

    proptest! {
        #[test]
        fn any_values_come_back(
            cells in prop::collection::vec((any::<bool>(), any::<i32>()), 12),
            rows in prop::sample::select(vec![1usize, 2, 3, 4]),
        ) {
            let (mut occupancy, mut values) = (Grid::new(rows, 12 / rows), Grid::new(rows, 12 / rows));
            for (i, (filled, value)) in cells.into_iter().enumerate() {
                occupancy[(i % rows, i / rows)] = filled;
                values[(i % rows, i / rows)] = value;
            }
            let before = values.clone();
            snake_difference(&occupancy, &mut values);
            snake_sum(&occupancy, &mut values);
            prop_assert_eq!(values, before);
        }
    }
}
