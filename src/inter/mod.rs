//! Inter prediction (article, V): prediction of the current frame from the frame before.
//! FORMAT.md 4.3 and 8.13.

pub mod registration;

mod render;

use std::sync::OnceLock;

use crate::ground::grid::Grid;
use crate::inter::registration::{RigidMotion, Surface};
use crate::scanner::hdl64::Hdl64;
use crate::scanner::{MOST_STEPS, RangeImage, Scanner};
use render::render;

/// A column of the frame before may be this many ticks away from the current one.
const COLUMN_REACH: u32 = 2;

/// The largest number of cells in an image used for inter prediction, as the reference or as the predicted
/// image: prediction takes about a hundred bytes a cell. No scanner has more than a few hundred thousand
/// cells.
pub const MOST_CELLS: usize = 1 << 22;

/// The returns along the snake's path (article, V-C), which runs through the rows alternately forwards and
/// backwards: the reference of a row's first return is right above it.
pub fn snake_path(occupancy: &Grid<bool>) -> impl Iterator<Item = (usize, usize)> {
    let columns = occupancy.columns();
    let cells = (0..occupancy.rows()).flat_map(move |row| {
        (0..columns).map(move |i| (row, if row % 2 == 0 { i } else { columns - 1 - i }))
    });
    cells.filter(|&cell| occupancy[cell])
}

/// The frame before, as known to both encoder and decoder.
#[derive(Debug, Default)]
pub struct Past {
    image: RangeImage,
    /// Intensity levels as contexts (1 to 128), of the same shape.
    levels: Grid<u16>,
    /// The surfaces, computed when they are first needed.
    surface: OnceLock<Surface>,
}

impl Past {
    /// Creates the past from a range image and the context levels of its intensities.
    pub fn new(image: RangeImage, levels: Grid<u16>) -> Self {
        Past { image, levels, surface: OnceLock::new() }
    }

    /// The surfaces of the frame.
    pub fn surface(&self, scanner: &Hdl64) -> &Surface {
        self.surface.get_or_init(|| Surface::of(scanner, &self.image.columns, &self.image.steps))
    }

    /// The reference of an image with these columns, after this motion of the scanner.
    pub fn reference(&self, scanner: &Hdl64, columns: &[u32], motion: &RigidMotion) -> Reference {
        Reference {
            same: self.same_cells(columns),
            moved: render(self.surface(scanner), &self.levels, motion, scanner, columns),
        }
    }

    /// As [`reference`](Self::reference), without the moved surfaces: fast, and useful while the scanner
    /// stands still.
    pub fn same_cells_alone(&self, columns: &[u32]) -> Reference {
        Reference { same: self.same_cells(columns), ..Reference::new(self.image.steps.rows(), columns.len()) }
    }

    /// As [`same_cells_alone`](Self::same_cells_alone), for any scanner: columns may be in any order, and the
    /// nearest one may be up to one firing away. `ticks` is the number of ticks in a turn.
    pub fn same_directions(&self, columns: &[u32], ticks: u32) -> Reference {
        let nearest = self.nearest_directions(columns, ticks);
        let same = self.layer(&nearest);
        Reference { moved: same.clone(), same }
    }

    /// The share of an image's returns, estimated from a sample, whose ranges agree with those of the same
    /// cells here.
    pub fn agreement(&self, columns: &[u32], steps: &Grid<u32>, scanner: &Scanner) -> f64 {
        /// Largest difference of ranges that agree, in metres.
        const AS_FAR: f64 = 0.02;
        /// Every `ROWS`-th row and every `COLUMNS`-th column are sampled.
        const ROWS: usize = 3;
        const COLUMNS: usize = 5;
        let as_far = (AS_FAR / scanner.range_step_m()).min(f64::from(MOST_STEPS)) as u32;
        let nearest = match scanner.firings() {
            Some(scanner) => self.nearest_directions(columns, scanner.build().ticks),
            None => self.nearest_columns(columns),
        };
        let (mut agreeing, mut returns) = (0u32, 0u32);
        for row in (0..steps.rows()).step_by(ROWS) {
            let cells = steps.row(row).iter().zip(&nearest).step_by(COLUMNS);
            for (steps, nearest) in cells.filter(|(steps, _)| **steps > 0) {
                let before = nearest.map_or(0, |nearest| self.image.steps[(row, nearest)]);
                returns += 1;
                agreeing += u32::from(before > 0 && steps.abs_diff(before) <= as_far);
            }
        }
        f64::from(agreeing) / f64::from(returns.max(1))
    }

    /// The same cells, each from the nearest column within reach.
    fn same_cells(&self, columns: &[u32]) -> Layer {
        self.layer(&self.nearest_columns(columns))
    }

    /// The layer with these columns of this frame.
    fn layer(&self, nearest: &[Option<usize>]) -> Layer {
        let (rows, columns) = (self.image.steps.rows(), nearest.len());
        let mut layer = Layer { steps: Grid::new(rows, columns), levels: Grid::new(rows, columns) };
        for row in 0..rows {
            let cells = layer.steps.row_mut(row).iter_mut().zip(layer.levels.row_mut(row)).zip(nearest);
            for ((steps, level), nearest) in cells.filter_map(|(cell, nearest)| Some((cell, (*nearest)?))) {
                *steps = self.image.steps[(row, nearest)];
                *level = self.levels[(row, nearest)];
            }
        }
        layer
    }

    /// For each of some columns (ticks, ascending), the nearest column of this frame within reach.
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

    /// For each of some columns, in any order, the column of this frame with the nearest tick on the circle,
    /// the first of equally near ones; none if it is farther than the usual distance between columns.
    fn nearest_directions(&self, columns: &[u32], ticks: u32) -> Vec<Option<usize>> {
        let mut by_tick: Vec<(u32, usize)> =
            self.image.columns.iter().enumerate().map(|(column, &tick)| (tick, column)).collect();
        by_tick.sort_unstable();
        by_tick.dedup_by_key(|(tick, _)| *tick);
        let apart = |a: u32, b: u32| a.abs_diff(b).min(ticks - a.abs_diff(b).min(ticks));
        let mut gaps: Vec<u32> = by_tick.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        gaps.sort_unstable();
        let reach = gaps.get(gaps.len() / 2).copied().unwrap_or(0);
        let nearest = |&tick: &u32| {
            let after = by_tick.partition_point(|(other, _)| *other < tick);
            let before = after.checked_sub(1).unwrap_or(by_tick.len().saturating_sub(1));
            let after = if after < by_tick.len() { after } else { 0 };
            let candidates = [by_tick.get(before), by_tick.get(after)].into_iter().flatten();
            let (other, column) = candidates.min_by_key(|(other, _)| apart(*other, tick))?;
            (apart(*other, tick) <= reach).then_some(*column)
        };
        columns.iter().map(nearest).collect()
    }
}

/// The predicted range of each return, in steps, for a back-end: that of the moved surface, or else of the
/// same cell. If there is neither, the prediction of the preceding return on the snake's path is repeated, so
/// that the differences along the path are differences of the ranges themselves.
pub fn ranges(reference: &Reference, occupancy: &Grid<bool>) -> Grid<u32> {
    let mut ranges = Grid::new(occupancy.rows(), occupancy.columns());
    let mut last = 0;
    for cell in snake_path(occupancy) {
        let found = [&reference.moved, &reference.same].map(|layer| layer.steps[cell]);
        last = found.into_iter().find(|&steps| steps > 0).unwrap_or(last);
        ranges[cell] = last;
    }
    ranges
}

/// The values of an earlier frame for each cell of the image to be coded: tables of the same size as that
/// image, 0 where there is no value.
#[derive(Clone, Debug, Default)]
pub struct Layer {
    /// Ranges, in steps.
    pub steps: Grid<u32>,
    /// Intensity levels as contexts, 1 to 128.
    pub levels: Grid<u16>,
}

/// The reference of a frame.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// The same cell of the frame before.
    pub same: Layer,
    /// The surfaces of the frame before, as seen from the scanner's current position.
    pub moved: Layer,
}

impl Reference {
    /// The predicted ranges: those of the moved surfaces, or else of the same cells.
    pub fn ranges(&self) -> Grid<u32> {
        let mut ranges = self.moved.steps.clone();
        let same = ranges.cells_mut().iter_mut().zip(self.same.steps.cells());
        same.filter(|(range, _)| **range == 0).for_each(|(range, same)| *range = *same);
        ranges
    }

    /// An empty reference for an image of this size.
    pub fn new(rows: usize, columns: usize) -> Self {
        let layer = Layer { steps: Grid::new(rows, columns), levels: Grid::new(rows, columns) };
        Reference { same: layer.clone(), moved: layer }
    }

    /// The rows above `row`, and the remaining rows.
    pub fn split(self, row: usize) -> [Self; 2] {
        let [same, moved] = [self.same, self.moved].map(|layer| {
            let ([steps, steps_below], [levels, levels_below]) =
                (layer.steps.split(row), layer.levels.split(row));
            [Layer { steps, levels }, Layer { steps: steps_below, levels: levels_below }]
        });
        let ([same, same_below], [moved, moved_below]) = (same, moved);
        [Reference { same, moved }, Reference { same: same_below, moved: moved_below }]
    }
}
