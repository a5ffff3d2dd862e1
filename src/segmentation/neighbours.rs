//! The next return in each direction.

use crate::grid::Grid;

/// A return is no neighbour over more missing ones in the row than these, or in the column.
const ROW_GAP: usize = 3;
const COLUMN_GAP: usize = 2;

/// A cell, row and column.
pub type Cell = (usize, usize);

/// Finds the returns around one. The image wraps around from its last column to its first.
pub struct Neighbours<'a> {
    steps: &'a Grid<u32>,
}

impl<'a> Neighbours<'a> {
    /// Of an image of ranges in steps, 0 = no return.
    pub fn of(steps: &'a Grid<u32>) -> Self {
        Neighbours { steps }
    }

    /// Whether a cell holds a return.
    pub fn is_return(&self, cell: Cell) -> bool {
        self.steps[cell] > 0
    }

    /// The nearest return to the right.
    pub fn right(&self, (row, column): Cell) -> Option<Cell> {
        self.in_row(row, |distance| (column + distance) % self.steps.columns())
    }

    /// The nearest return to the left.
    pub fn left(&self, (row, column): Cell) -> Option<Cell> {
        self.in_row(row, |distance| (column + self.steps.columns() - distance) % self.steps.columns())
    }

    /// The nearest return above.
    pub fn above(&self, (row, column): Cell) -> Option<Cell> {
        (row.saturating_sub(COLUMN_GAP + 1)..row).rev().map(|row| (row, column)).find(|c| self.is_return(*c))
    }

    /// The nearest return below.
    pub fn below(&self, (row, column): Cell) -> Option<Cell> {
        let end = (row + COLUMN_GAP + 2).min(self.steps.rows());
        (row + 1..end).map(|row| (row, column)).find(|cell| self.is_return(*cell))
    }

    /// All four.
    pub fn around(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        [self.left(cell), self.right(cell), self.above(cell), self.below(cell)].into_iter().flatten()
    }

    fn in_row(&self, row: usize, column: impl Fn(usize) -> usize) -> Option<Cell> {
        let most = (ROW_GAP + 1).min(self.steps.columns().saturating_sub(1));
        (1..=most).map(|distance| (row, column(distance))).find(|cell| self.is_return(*cell))
    }
}
