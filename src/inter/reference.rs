//! What an earlier frame lets expect in each cell of this one.

use crate::ground::grid::Grid;

/// What an earlier frame holds for each cell of the image that is to be coded: rows x columns, as many
/// as there are in that; 0 = nothing.
#[derive(Clone, Debug, Default)]
pub struct Layer {
    /// Ranges, in steps.
    pub steps: Grid<u32>,
    /// Context levels of intensities, 1 to 128.
    pub levels: Grid<u16>,
}

/// The reference of a frame.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// The same cell of the frame before.
    pub same: Layer,
    /// What the surfaces of the frame before look like from where the scanner is now.
    pub moved: Layer,
}

impl Reference {
    /// What ranges to expect: those of the moved surfaces, or else of the same cells.
    pub fn ranges(&self) -> Grid<u32> {
        let mut ranges = self.moved.steps.clone();
        let same = ranges.cells_mut().iter_mut().zip(self.same.steps.cells());
        same.filter(|(range, _)| **range == 0).for_each(|(range, same)| *range = *same);
        ranges
    }

    /// Of an image of this size: nothing.
    pub fn new(rows: usize, columns: usize) -> Self {
        let layer = Layer { steps: Grid::new(rows, columns), levels: Grid::new(rows, columns) };
        Reference { same: layer.clone(), moved: layer }
    }
}
