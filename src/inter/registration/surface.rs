//! The surfaces in a range image: the position of each return, and the orientation of the surface there.
//! FORMAT.md 4.3, "Surfels".

use crate::ground::grid::Grid;
use crate::scanner::hdl64::{Alignment, Hdl64};

/// A return and the surface around it.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    /// Position in metres.
    pub position: [f64; 3],
    /// Perpendicular to the surface, of any length; zero if unknown.
    pub normal: [f64; 3],
    /// Its row and column in the image.
    pub cell: (u32, u32),
}

/// The surfels of an image, row by row.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// The surfels of all returns.
    pub surfels: Vec<Surfel>,
}

/// Neighbours in a row belong to one surface if their ranges differ by less than this many metres plus this
/// share of the range.
const ROW_GAP: f64 = 0.2;
const ROW_GAP_SHARE: f64 = 0.03;
/// As for rows, for neighbours in a column, which are far apart on the ground.
const COLUMN_GAP: f64 = 0.3;
const COLUMN_GAP_SHARE: f64 = 0.15;
/// Distance, in columns, to the neighbours in a row that give its slope: over a longer distance, noise
/// matters less.
const ROW_REACH: isize = 2;

impl Surface {
    /// The surfaces in the ranges `steps` (rows x columns, 0 = no return) at these column ticks; the same on
    /// every platform.
    pub fn of(scanner: &Hdl64, columns: &[u32], steps: &Grid<u32>) -> Self {
        let alignment = Alignment::of(scanner, columns.len());
        let mut positions = Grid::new(steps.rows(), steps.columns());
        for row in 0..steps.rows() {
            let cells = positions.row_mut(row).iter_mut().zip(steps.row(row)).zip(columns);
            for ((position, &steps), &column) in cells.filter(|((_, steps), _)| **steps > 0) {
                *position = scanner.point(row, scanner.tick_of_column(row, column), steps);
            }
        }
        let image = Image { scanner, alignment: &alignment, positions: &positions, steps };
        let mut surfels = Vec::new();
        for row in 0..steps.rows() {
            for column in (0..steps.columns()).filter(|&column| steps[(row, column)] > 0) {
                surfels.push(Surfel {
                    position: positions[(row, column)],
                    normal: image.normal(row, column),
                    cell: (row as u32, column as u32),
                });
            }
        }
        Surface { surfels }
    }
}

struct Image<'a> {
    scanner: &'a Hdl64,
    alignment: &'a Alignment,
    positions: &'a Grid<[f64; 3]>,
    steps: &'a Grid<u32>,
}

impl Image<'_> {
    fn normal(&self, row: usize, column: usize) -> [f64; 3] {
        match (self.along(row, column), self.across(row, column)) {
            (Some(along), Some(across)) => cross(along, across),
            _ => [0.0; 3],
        }
    }

    /// The slope along the row.
    fn along(&self, row: usize, column: usize) -> Option<[f64; 3]> {
        let range = self.scanner.metres(self.steps[(row, column)]);
        let gap = ROW_GAP + ROW_GAP_SHARE * range;
        let beside = |right: isize| {
            (1..=ROW_REACH).rev().find_map(|reach| {
                let column =
                    column.checked_add_signed(right * reach).filter(|&c| c < self.steps.columns())?;
                self.near((row, column), range, gap)
            })
        };
        let here = self.positions[(row, column)];
        match (beside(-1), beside(1)) {
            (Some((_, left)), Some((_, right))) => Some(difference(right, left)),
            (Some((_, left)), None) => Some(difference(here, left)),
            (None, Some((_, right))) => Some(difference(right, here)),
            (None, None) => None,
        }
    }

    /// The slope across the rows, to the neighbour whose range differs less.
    fn across(&self, row: usize, column: usize) -> Option<[f64; 3]> {
        let range = self.scanner.metres(self.steps[(row, column)]);
        let gap = COLUMN_GAP + COLUMN_GAP_SHARE * range;
        let width = self.steps.columns();
        let beside = |down: isize| {
            let other = row.checked_add_signed(down).filter(|&row| row < self.steps.rows())?;
            let column = (column + width - self.alignment.turn(row) + self.alignment.turn(other)) % width;
            self.near((other, column), range, gap)
        };
        let here = self.positions[(row, column)];
        match (beside(-1), beside(1)) {
            (Some((off_above, above)), Some((off_below, below))) => {
                Some(if off_above < off_below { difference(here, above) } else { difference(below, here) })
            }
            (Some((_, above)), None) => Some(difference(here, above)),
            (None, Some((_, below))) => Some(difference(below, here)),
            (None, None) => None,
        }
    }

    /// The position of a cell's return and the difference of the ranges, if both returns are on the same
    /// surface.
    fn near(&self, cell: (usize, usize), range: f64, gap: f64) -> Option<(f64, [f64; 3])> {
        let steps = self.steps[cell];
        let off = (self.scanner.metres(steps) - range).abs();
        (steps > 0 && off < gap).then(|| (off, self.positions[cell]))
    }
}

fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> [f64; 3] {
    [b * f - c * e, c * d - a * f, a * e - b * d]
}

/// The scalar product.
#[inline]
pub fn dot([a, b, c]: [f64; 3], [d, e, f]: [f64; 3]) -> f64 {
    a * d + b * e + c * f
}
