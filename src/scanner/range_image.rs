//! The points of a scan as a range image: one row for each laser, one column for each firing.
//!
//! A cell holds the range in steps of the scanner, or 0 if there is no return. Points that deviate from the
//! scanner's formula by more than a few grid units, whose cell is taken already, or that are in no column
//! stay outside as *strays*.

use crate::ground::grid::Grid;

/// The range image of a scan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RangeImage {
    /// The column tick of each column.
    pub columns: Vec<u32>,
    /// Further data about each column that the scanner's family needs; empty if the ticks are enough.
    pub spans: Vec<u32>,
    /// Rows x columns; range in steps, 0 = no return.
    pub steps: Grid<u32>,
    /// Whether every cell is a record of the file. Those without a return are *blanks*, as scanners and
    /// programs store them (zeros, NaN, or the scanner's own position).
    pub is_full: bool,
    /// Echoes, further returns of the cells, in row order of the cells: a scanner may report more than one
    /// return per shot. Full images have none.
    pub echoes: Vec<Echo>,
}

/// A further return of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Echo {
    /// The index of the cell, counted row after row.
    pub cell: u32,
    /// Range in steps.
    pub steps: u32,
}

impl RangeImage {
    /// An image without returns.
    pub fn new(rows: usize, columns: Vec<u32>) -> Self {
        RangeImage {
            steps: Grid::new(rows, columns.len()),
            columns,
            spans: Vec::new(),
            is_full: false,
            echoes: Vec::new(),
        }
    }

    /// Number of returns.
    pub fn returns(&self) -> usize {
        self.steps.cells().iter().filter(|&&steps| steps > 0).count()
    }

    /// Number of records of the file in the image: returns, echoes and blanks.
    pub fn records(&self) -> usize {
        if self.is_full { self.steps.cells().len() } else { self.returns() + self.echoes.len() }
    }

    /// Number of blanks.
    pub fn blanks(&self) -> usize {
        if self.is_full { self.steps.cells().len() - self.returns() } else { 0 }
    }

    /// Which cells hold a return.
    pub fn occupancy(&self) -> Grid<bool> {
        self.steps.map(|&steps| steps > 0)
    }
}

/// One return of the range image, or a blank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Return {
    /// Row of the image.
    pub row: u32,
    /// Column of the image.
    pub column: u32,
    /// Azimuth tick of the laser.
    pub tick: u32,
    /// Range in steps; 0 for a blank.
    pub steps: u32,
    /// 0 for the first return of a cell, else the number of the echo, from 1.
    pub echo: u32,
}
