//! The returns of an image, numbered in scan order, each with its neighbours. Cells without a return are not
//! represented, so a border across them costs nothing. FORMAT.md 8.11.

use std::ops::Range;

use crate::ground::grid::Grid;

/// Returns, with the next one in each direction of their row and column, however far away.
pub struct Returns {
    columns: usize,
    /// The number of each row's first return, and the end of the last row.
    row_starts: Vec<usize>,
    /// Row and column of each return.
    cells: Vec<(u32, u32)>,
    above: Vec<Option<u32>>,
    below: Vec<Option<u32>>,
}

impl Returns {
    /// The returns of an image.
    pub fn of(occupancy: &Grid<bool>) -> Self {
        let (columns, row_starts) = (occupancy.columns(), vec![0]);
        let mut returns =
            Returns { columns, row_starts, cells: Vec::new(), above: Vec::new(), below: Vec::new() };
        let mut last = vec![None; columns];
        for row in 0..occupancy.rows() {
            for (column, _) in occupancy.row(row).iter().enumerate().filter(|(_, filled)| **filled) {
                returns.push((row, column), &mut last[column]);
            }
            returns.row_starts.push(returns.len());
        }
        returns
    }

    /// Adds a return; `last` is the last one in its column, and becomes this one.
    fn push(&mut self, (row, column): (usize, usize), last: &mut Option<u32>) {
        let number = self.len() as u32;
        let above = last.replace(number);
        if let Some(above) = above {
            self.below[above as usize] = Some(number);
        }
        self.cells.push((row as u32, column as u32));
        self.above.push(above);
        self.below.push(None);
    }

    /// Number of returns.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Number of columns of the image.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows of the image.
    pub fn rows(&self) -> usize {
        self.row_starts.len() - 1
    }

    /// Row and column of a return.
    pub fn cell(&self, number: usize) -> (usize, usize) {
        let (row, column) = self.cells[number];
        (row as usize, column as usize)
    }

    /// The returns of a row.
    pub fn in_row(&self, row: usize) -> Range<usize> {
        self.row_starts[row]..self.row_starts[row + 1]
    }

    /// The return before it in its row.
    pub fn left(&self, number: usize) -> Option<usize> {
        number.checked_sub(1).filter(|&left| self.cells[left].0 == self.cells[number].0)
    }

    /// The return after it in its row.
    pub fn right(&self, number: usize) -> Option<usize> {
        self.cells.get(number + 1).filter(|right| right.0 == self.cells[number].0).map(|_| number + 1)
    }

    /// The return before it in its column.
    pub fn above(&self, number: usize) -> Option<usize> {
        self.above[number].map(|above| above as usize)
    }

    /// The return after it in its column.
    pub fn below(&self, number: usize) -> Option<usize> {
        self.below[number].map(|below| below as usize)
    }
}
