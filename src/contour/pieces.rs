//! The pieces between borders.

use crate::grid::Grid;

/// Which piece each cell belongs to.
pub struct Pieces {
    columns: usize,
    /// For each cell the first cell of its piece, row after row.
    first: Vec<u32>,
}

impl Pieces {
    /// Fills: a cell that is not on a border is of one piece with the cells to its right and below.
    pub fn fill(borders: &Grid<bool>) -> Self {
        let (rows, columns) = (borders.rows(), borders.columns());
        let mut first: Vec<u32> = (0..(rows * columns) as u32).collect();
        for (cell, _) in borders.cells().iter().enumerate().filter(|(_, border)| !**border) {
            if (cell + 1) % columns != 0 {
                join(&mut first, cell as u32, cell as u32 + 1);
            }
            if cell + columns < first.len() {
                join(&mut first, cell as u32, (cell + columns) as u32);
            }
        }
        // The first cell of a piece is never after the cell, so one pass is enough.
        for cell in 0..first.len() {
            first[cell] = first[first[cell] as usize];
        }
        Pieces { columns, first }
    }

    /// The first cell of the piece, as a number in scan order.
    pub fn of(&self, (row, column): (usize, usize)) -> usize {
        self.first[row * self.columns + column] as usize
    }

    /// Cells of the image.
    pub fn cells(&self) -> usize {
        self.first.len()
    }
}

/// Makes one piece of those of two cells; the earlier first cell stays the first.
fn join(first: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(first, a), root(first, b));
    first[a.max(b) as usize] = a.min(b);
}

/// The first cell of a piece; the way to it is halved.
fn root(first: &mut [u32], mut cell: u32) -> u32 {
    while first[cell as usize] != cell {
        first[cell as usize] = first[first[cell as usize] as usize];
        cell = first[cell as usize];
    }
    cell
}
