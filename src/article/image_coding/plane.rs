//! A plane of values, of which only those of returns matter.

use crate::ground::grid::Grid;

/// Values still to be coded, one for each return.
#[derive(Clone, Debug)]
pub struct Plane<'a> {
    /// Rows x columns; the values of cells without a return do not matter.
    pub values: Grid<i32>,
    /// Which cells hold a return.
    pub returns: &'a Grid<bool>,
}

impl Plane<'_> {
    /// Rows and columns.
    pub fn size(&self) -> (usize, usize) {
        (self.values.rows(), self.values.columns())
    }

    /// The values of the returns, row by row.
    pub fn of_returns(&self) -> impl Iterator<Item = i32> {
        self.values.cells().iter().zip(self.returns.cells()).filter(|(_, is)| **is).map(|(value, _)| *value)
    }

    /// The least and the greatest value; zeros if there are no returns.
    pub fn extremes(&self) -> (i32, i32) {
        let extremes = |(least, greatest): (i32, i32), value: i32| (least.min(value), greatest.max(value));
        self.of_returns()
            .map(|value| (value, value))
            .reduce(|a, (value, _)| extremes(a, value))
            .unwrap_or_default()
    }

    /// The median of the values.
    pub fn median(&self) -> i32 {
        let mut values: Vec<i32> = self.of_returns().collect();
        if values.is_empty() {
            return 0;
        }
        let middle = values.len() / 2;
        *values.select_nth_unstable(middle).1
    }

    /// The sum of the squares of the values.
    pub fn energy(&self) -> f64 {
        self.of_returns().map(|value| f64::from(value) * f64::from(value)).sum()
    }

    /// The difference after `coded` is subtracted.
    pub fn without(&self, coded: &Grid<i32>) -> Self {
        let mut left = self.clone();
        for row in 0..coded.rows() {
            for (value, coded) in left.values.row_mut(row).iter_mut().zip(coded.row(row)) {
                *value = value.saturating_sub(*coded);
            }
        }
        left
    }

    /// All cells, with a constant in those without a return: this costs almost nothing if most values are
    /// equal.
    pub fn padded(&self, with: i32) -> Grid<i32> {
        let mut filled = self.values.clone();
        for row in 0..filled.rows() {
            let cells = filled.row_mut(row).iter_mut().zip(self.returns.row(row));
            cells.filter(|(_, is_return)| !**is_return).for_each(|(value, _)| *value = with);
        }
        filled
    }

    /// All cells, with those without a return interpolated linearly between the returns to the left and
    /// right: smooth, as suits a transform. Rows without returns are like the row above, or else the row
    /// below.
    pub fn interpolated(&self) -> Grid<i32> {
        let mut filled = self.values.clone();
        let rows = filled.rows();
        let is_empty = |row: usize| !self.returns.row(row).contains(&true);
        for row in 0..rows {
            interpolate(filled.row_mut(row), self.returns.row(row));
        }
        let first = (0..rows).find(|&row| !is_empty(row)).unwrap_or(0);
        for row in (0..rows).filter(|&row| is_empty(row)) {
            let values = filled.row(row.checked_sub(1).filter(|_| row > first).unwrap_or(first)).to_vec();
            filled.row_mut(row).copy_from_slice(&values);
        }
        filled
    }
}

/// Fills the cells of a row that hold no return.
fn interpolate(values: &mut [i32], returns: &[bool]) {
    let mut left: Option<usize> = None;
    let mut column = 0;
    while column < values.len() {
        if returns[column] {
            (left, column) = (Some(column), column + 1);
            continue;
        }
        let right = (column..values.len()).find(|&right| returns[right]);
        let end = right.unwrap_or(values.len());
        for place in column..end {
            values[place] = match (left, right) {
                (Some(left), Some(right)) => between((left, values[left]), (right, values[right]), place),
                (Some(side), None) | (None, Some(side)) => values[side],
                (None, None) => 0,
            };
        }
        column = end;
    }
}

/// The value at a position on the line through two others, rounded down.
fn between((left, from): (usize, i32), (right, to): (usize, i32), place: usize) -> i32 {
    let (run, rise) = ((right - left) as i64, i64::from(to) - i64::from(from));
    (i64::from(from) + (rise * (place - left) as i64).div_euclid(run)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid<T: Copy + Default>(rows: &[&[T]]) -> Grid<T> {
        let mut grid = Grid::new(rows.len(), rows[0].len());
        (0..).zip(rows).for_each(|(row, values)| grid.row_mut(row).copy_from_slice(values));
        grid
    }

    #[test]
    fn gaps_are_filled_from_their_sides() {
        let returns = grid(&[
            &[false; 5],
            &[true, false, false, false, true],
            &[false; 5],
            &[false, true, false, false, false],
        ]);
        let values = grid(&[&[9; 5], &[10, 9, 9, 9, -30], &[9; 5], &[9, 7, 9, 9, 9]]);
        let plane = Plane { values, returns: &returns };
        let line = [10, 0, -10, -20, -30];
        assert_eq!(plane.interpolated(), grid(&[&line, &line, &line, &[7; 5]]));
        let padded = grid(&[&[5; 5], &[10, 5, 5, 5, -30], &[5; 5], &[5, 7, 5, 5, 5]]);
        assert_eq!(plane.padded(5), padded);
        assert_eq!((plane.extremes(), plane.median(), plane.energy()), ((-30, 10), 7, 1049.0));
    }

    #[test]
    fn the_widest_gap_of_the_largest_values_does_not_overflow() {
        let mut values = vec![0; 300_000];
        let mut returns = vec![false; 300_000];
        (values[0], values[299_999]) = (i32::MIN, i32::MAX);
        (returns[0], returns[299_999]) = (true, true);
        interpolate(&mut values, &returns);
        assert!(values.is_sorted());
    }

    #[test]
    fn planes_without_returns_are_nothing() {
        let returns = Grid::new(2, 3);
        let plane = Plane { values: Grid::new(2, 3), returns: &returns };
        assert_eq!((plane.extremes(), plane.median(), plane.energy()), ((0, 0), 0, 0.0));
        assert_eq!(plane.interpolated(), Grid::new(2, 3));
    }
}
