//! Which cells of the range image hold a return.

use crate::entropy::{BitCoder, MixedBits};
use crate::grid::Grid;

const VIEWS: usize = 4;
const OPINIONS: usize = VIEWS + 1;
/// The opinion that is always the same.
const CONSTANT: f32 = 0.3;
const VIEW_SIZES: [usize; VIEWS] = [1 << 10, 128 * 16, 1 << 12, 1 << 10];
/// Beams beyond this many share their contexts.
const ROW_CONTEXTS: usize = 128;

/// What the coder has learned about occupancy.
pub struct OccupancyModel {
    filled: MixedBits<VIEWS, OPINIONS>,
}

impl Default for OccupancyModel {
    fn default() -> Self {
        let mut start = [0.4; OPINIONS];
        start[VIEWS] = 0.0;
        OccupancyModel { filled: MixedBits::new(VIEW_SIZES, 64, start, 0.003) }
    }
}

impl OccupancyModel {
    /// Codes every cell.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, occupancy: &mut Grid<bool>) {
        let width = occupancy.columns();
        // Empty cells in each column so far, halved with every row: how long ago and how many.
        let mut empty_above = vec![0u32; width];
        for row in 0..occupancy.rows() {
            let mut run = 0usize;
            for column in 0..width {
                let cells = &*occupancy;
                let at = |rows_up: usize, offset: isize| {
                    let cell = (row.checked_sub(rows_up), column.checked_add_signed(offset));
                    match cell {
                        (Some(row), Some(column)) if column < width => usize::from(cells[(row, column)]),
                        // Outside counts as a return: most cells are.
                        _ => 1,
                    }
                };
                let near = at(0, -1) | at(1, 0) << 1 | at(1, -1) << 2 | at(1, 1) << 3;
                let left = at(0, -2) | at(0, -3) << 1;
                let above = at(2, 0) | at(1, 2) << 1 | at(1, -2) << 2 | at(2, 1) << 3;
                let run_level = run.min(255).checked_ilog2().map_or(0, |r| r as usize + 1);
                let views = [
                    near | left << 4 | above << 6,
                    row.min(ROW_CONTEXTS - 1) * 16 + near,
                    (run_level.min(7) * 8 + (at(1, 0) | at(1, 1) << 1 | at(1, 2) << 2)) * 64
                        + (at(1, 3)
                            | at(1, 4) << 1
                            | at(2, 0) << 2
                            | at(2, 2) << 3
                            | at(0, -1) << 4
                            | at(3, 0) << 5),
                    (empty_above[column] as usize >> 2) * 16 + near,
                ];
                let set = near | (at(2, 0) << 4) | (at(0, -2) << 5);
                let west = at(0, -1) == 1;
                let filled =
                    self.filled.code(coder, set, &views, [CONSTANT; OPINIONS], occupancy[(row, column)]);
                occupancy[(row, column)] = filled;
                empty_above[column] = empty_above[column] >> 1 | u32::from(!filled) << 7;
                run = if filled == west { run + 1 } else { 0 };
            }
        }
    }
}
