//! Inter prediction (article, V): what the frame before lets expect of this one.

pub mod registration;

mod reference;
mod render;

pub use reference::{Layer, Reference};

use std::sync::OnceLock;

use crate::article::prediction::snake::path;
use crate::ground::grid::Grid;
use crate::inter::registration::{RigidMotion, Surface};
use crate::scanner::Hdl64;
use crate::scanner::RangeImage;
use render::render;

/// Ticks that a column of the frame before may be off.
const COLUMN_REACH: u32 = 2;

/// The most cells of an image that is predicted from another, or another from it: what is made of them takes
/// about a hundred bytes a cell. No scanner has more than a few hundred thousand.
pub const MOST_CELLS: usize = 1 << 22;

/// The frame before, as both sides know it.
#[derive(Debug, Default)]
pub struct Past {
    image: RangeImage,
    /// Context levels of intensities, of the same shape.
    levels: Grid<u16>,
    /// Made when it is first asked for.
    surface: OnceLock<Surface>,
}

impl Past {
    /// Of a range image and the context levels of its intensities.
    pub fn new(image: RangeImage, levels: Grid<u16>) -> Self {
        Past { image, levels, surface: OnceLock::new() }
    }

    /// Its surfaces.
    pub fn surface(&self, sensor: &Hdl64) -> &Surface {
        self.surface.get_or_init(|| Surface::of(sensor, &self.image.columns, &self.image.steps))
    }

    /// What it lets expect in an image with these columns, after the scanner has moved.
    pub fn reference(&self, sensor: &Hdl64, columns: &[u32], motion: &RigidMotion) -> Reference {
        Reference {
            same: self.same_cells(columns),
            moved: render(self.surface(sensor), &self.levels, motion, sensor, columns),
        }
    }

    /// The same without the moved surfaces: quick, and of use if the scanner stands still.
    pub fn same_cells_alone(&self, columns: &[u32]) -> Reference {
        Reference { same: self.same_cells(columns), ..Reference::new(self.image.steps.rows(), columns.len()) }
    }

    /// The part of the returns of an image, or of a sample of them, whose same cell is as far away in this one.
    pub fn agreement(&self, columns: &[u32], steps: &Grid<u32>) -> f64 {
        /// Steps.
        const AS_FAR: u32 = 10;
        /// Rows and columns of which one is looked at.
        const ROWS: usize = 3;
        const COLUMNS: usize = 5;
        let nearest = self.nearest_columns(columns);
        let (mut agreeing, mut returns) = (0u32, 0u32);
        for row in (0..steps.rows()).step_by(ROWS) {
            let cells = steps.row(row).iter().zip(&nearest).step_by(COLUMNS);
            for (steps, nearest) in cells.filter(|(steps, _)| **steps > 0) {
                let before = nearest.map_or(0, |nearest| self.image.steps[(row, nearest)]);
                returns += 1;
                agreeing += u32::from(before > 0 && steps.abs_diff(before) <= AS_FAR);
            }
        }
        f64::from(agreeing) / f64::from(returns.max(1))
    }

    /// The same cells: of the nearest column, if it is near.
    fn same_cells(&self, columns: &[u32]) -> Layer {
        let rows = self.image.steps.rows();
        let mut layer =
            Layer { steps: Grid::new(rows, columns.len()), levels: Grid::new(rows, columns.len()) };
        let nearest = self.nearest_columns(columns);
        for row in 0..rows {
            let cells = layer.steps.row_mut(row).iter_mut().zip(layer.levels.row_mut(row)).zip(&nearest);
            for ((steps, level), nearest) in cells.filter_map(|(cell, nearest)| Some((cell, (*nearest)?))) {
                *steps = self.image.steps[(row, nearest)];
                *level = self.levels[(row, nearest)];
            }
        }
        layer
    }

    /// The nearest column of this frame to each of some columns (ticks, rising), if it is near.
    fn nearest_columns(&self, columns: &[u32]) -> Vec<Option<usize>> {
        let off = |column: usize, tick: u32| self.image.columns.get(column).map(|other| other.abs_diff(tick));
        let mut nearest = 0;
        let nearest_to = |&tick: &u32| {
            while off(nearest + 1, tick)
                .is_some_and(|next| off(nearest, tick).is_none_or(|this| next <= this))
            {
                nearest += 1;
            }
            off(nearest, tick).is_some_and(|off| off <= COLUMN_REACH).then_some(nearest)
        };
        columns.iter().map(nearest_to).collect()
    }
}

/// The predicted range of each return, in steps, for a general-purpose back-end: the moved surface's, or
/// that of the same cell. Where there is neither it is that of the return before on the snake's path, so that
/// the differences along it are those of the ranges themselves.
pub fn ranges(reference: &Reference, occupancy: &Grid<bool>) -> Grid<u32> {
    let mut ranges = Grid::new(occupancy.rows(), occupancy.columns());
    let mut last = 0;
    for cell in path(occupancy) {
        let found = [&reference.moved, &reference.same].map(|layer| layer.steps[cell]);
        last = found.into_iter().find(|&steps| steps > 0).unwrap_or(last);
        ranges[cell] = last;
    }
    ranges
}
