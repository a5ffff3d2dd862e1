//! The points of a scan as a range image: one row for each laser, one column for each firing.
//!
//! A cell holds the range in steps of the scanner, or 0 if there is no return. Points that deviate from the
//! scanner's formula by more than a few grid units, whose cell is taken already, or that are in no column
//! stay outside as *strays*.

use crate::ground::grid::Grid;

/// The finest azimuth grid allowed, in ticks a turn: 0.001 degree.
pub const MOST_TICKS: u64 = 360_000;
/// The largest number of rows of a range image: more lasers than any scanner has.
pub const MOST_ROWS: u64 = 1024;
/// The coarsest range step, in micrometres.
pub const MOST_RANGE_STEP_UM: u64 = 1_000_000;
/// The range step that means that steps are the bits of ranges in metres as float32.
pub const FLOAT_RANGES: u32 = 0;
/// The longest range in any range image, in steps.
pub const MOST_STEPS: u32 = (1 << 24) - 1;
/// The number of bits of a range, in steps, in a lossless image, unless the scanner's ranges are longer:
/// those of an HDL-64E are not.
pub const LEAST_RANGE_BITS: u32 = 16;
/// The largest error of the formula, in metres along an axis in addition to half a range step, for a point of
/// a lossless image.
pub const REACH: f64 = 0.003;

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

/// A range image and the points of its cells.
#[derive(Debug, Default)]
pub struct Projection {
    /// The range image.
    pub image: RangeImage,
    /// For each cell, the number of the point in it; meaningful only for cells with a return.
    pub point_of_cell: Grid<u32>,
    /// The point of each echo.
    pub point_of_echo: Vec<u32>,
    /// The points outside the image, in ascending order.
    pub strays: Vec<u32>,
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
