//! The next return in each direction.

use std::iter::successors;

use crate::ground::grid::Grid;

/// A cell, row and column.
pub type Cell = (usize, usize);

/// Returns in a row are neighbours if they are at most this many columns apart.
const ROW_REACH: usize = 4;
/// Returns in a column are neighbours if they are at most this many rows apart. Some beams have few returns,
/// and the ideal image has rows that no real beam measures.
const COLUMN_REACH: usize = 10;

/// The number of cells to the next return on each side; 0 = none within reach.
#[derive(Clone, Copy, Default)]
struct Distances {
    left: u8,
    right: u8,
    above: u8,
    below: u8,
}

/// Finds the returns around a cell. The image wraps around from its last column to its first.
pub struct Neighbours {
    distances: Grid<Distances>,
}

impl Neighbours {
    /// The neighbours in an image of ranges, 0 = no return.
    pub fn of(ranges: &Grid<f32>) -> Self {
        let mut neighbours = Neighbours { distances: Grid::new(ranges.rows(), ranges.columns()) };
        // For each column, the row of the last return so far.
        let mut last_rows = vec![None; ranges.columns()];
        for row in 0..ranges.rows() {
            neighbours.link_row(row, ranges.row(row));
            neighbours.link_columns(row, ranges.row(row), &mut last_rows);
        }
        neighbours
    }

    fn link_row(&mut self, row: usize, ranges: &[f32]) {
        let columns = ranges.len();
        // Columns continue from the end of the preceding turn, so that the end of a row meets its beginning.
        let mut last = ranges.iter().rposition(|&range| range > 0.0).unwrap_or(0);
        for column in (0..columns).filter(|&column| ranges[column] > 0.0) {
            let distance = column + columns - last;
            if distance <= ROW_REACH && distance < columns {
                self.distances[(row, column)].left = distance as u8;
                self.distances[(row, last % columns)].right = distance as u8;
            }
            last = column + columns;
        }
    }

    fn link_columns(&mut self, row: usize, ranges: &[f32], last_rows: &mut [Option<usize>]) {
        for column in (0..ranges.len()).filter(|&column| ranges[column] > 0.0) {
            if let Some(last) = last_rows[column].replace(row)
                && row - last <= COLUMN_REACH
            {
                self.distances[(row, column)].above = (row - last) as u8;
                self.distances[(last, column)].below = (row - last) as u8;
            }
        }
    }

    /// The nearest returns to the left and to the right.
    pub fn beside(&self, (row, column): Cell) -> impl Iterator<Item = Cell> + use<> {
        let columns = self.distances.columns();
        let Distances { left, right, .. } = self.distances[(row, column)];
        let left = (left > 0).then(|| (row, (column + columns - usize::from(left)) % columns));
        let right = (right > 0).then(|| (row, (column + usize::from(right)) % columns));
        left.into_iter().chain(right)
    }

    /// The returns above, beginning with the nearest.
    pub fn above(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let next = |&(row, column): &Cell| match usize::from(self.distances[(row, column)].above) {
            0 => None,
            distance => Some((row - distance, column)),
        };
        successors(next(&cell), next)
    }

    /// The returns below, beginning with the nearest.
    pub fn below(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let next = |&(row, column): &Cell| match usize::from(self.distances[(row, column)].below) {
            0 => None,
            distance => Some((row + distance, column)),
        };
        successors(next(&cell), next)
    }
}
