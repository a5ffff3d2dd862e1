//! The prediction of each cell of the current frame from an earlier frame. FORMAT.md 4.3.

use crate::ground::grid::Grid;

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
