//! The bitmap of borders, in blocks of 4 x 4.

use crate::entropy::{AdaptiveBit, BitCoder, MixedBits};
use crate::grid::Grid;

/// Rows and columns of a block.
const BLOCK: usize = 4;
const VIEWS: usize = 4;
const OPINIONS: usize = 8;
const VIEW_SIZES: [usize; VIEWS] = [1 << 10, 1 << 10, 128 << 4, 1 << 12];
/// Beams beyond this many share their contexts.
const ROW_CONTEXTS: usize = 128;

/// What the coder has learned about borders.
pub struct BorderModel {
    /// Whether a block has no border, by its neighbours.
    empty: Vec<AdaptiveBit>,
    bits: MixedBits<VIEWS, OPINIONS>,
}

impl Default for BorderModel {
    fn default() -> Self {
        BorderModel {
            empty: vec![AdaptiveBit::default(); 1 << 5],
            bits: MixedBits::new(VIEW_SIZES, 64, 0.4, 0.0, 0.005),
        }
    }
}

impl BorderModel {
    /// Codes every cell, block by block.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, occupancy: &Grid<bool>, borders: &mut Grid<bool>) {
        let (rows, columns) = (borders.rows(), borders.columns());
        let mut empty = Grid::new(rows.div_ceil(BLOCK), columns.div_ceil(BLOCK));
        for block_row in 0..empty.rows() {
            for block_column in 0..empty.columns() {
                let block = (block_row, block_column);
                let is_empty = !C::ENCODES || cells_of(borders, block).all(|cell| !borders[cell]);
                let context = block_context(&empty, occupancy, block);
                empty[block] = self.empty[context].code(coder, is_empty);
                if !empty[block] {
                    for cell in cells_of(borders, block) {
                        borders[cell] = self.code_cell(coder, occupancy, borders, cell);
                    }
                }
            }
        }
    }

    fn code_cell<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        borders: &Grid<bool>,
        (row, column): (usize, usize),
    ) -> bool {
        let start = column / BLOCK * BLOCK;
        let at = |up: usize, offset: isize| -> usize {
            match (row.checked_sub(up), column.checked_add_signed(offset)) {
                (Some(row), Some(column)) if column < borders.columns() => {
                    usize::from(borders[(row, column)])
                }
                _ => 0,
            }
        };
        // Cells right of the block are known above it only.
        let right = |up: usize, offset: isize| {
            let known = row % BLOCK < up || column.wrapping_add_signed(offset) < start + BLOCK;
            if known { at(up, offset) } else { 0 }
        };
        let filled = |down: usize, offset: isize| -> usize {
            match column.checked_add_signed(offset) {
                Some(column) if row + down < occupancy.rows() && column < occupancy.columns() => {
                    usize::from(occupancy[(row + down, column)])
                }
                _ => 0,
            }
        };
        let near = at(0, -1) | at(1, 0) << 1 | at(1, -1) << 2 | right(1, 1) << 3;
        let wide =
            at(0, -2) | at(2, 0) << 1 | right(1, 2) << 2 | at(1, -2) << 3 | right(2, 1) << 4 | at(2, -1) << 5;
        let cells =
            filled(0, 0) | filled(0, 1) << 1 | filled(1, 0) << 2 | filled(1, 1) << 3 | filled(0, -1) << 4;
        let far = at(0, -3) | at(3, 0) << 1 | at(0, -4) << 2 | right(2, 2) << 3 | at(2, -2) << 4;
        let views = [
            near | wide << 4,
            near | cells << 4 | at(2, 0) << 9,
            row.min(ROW_CONTEXTS - 1) << 4 | near,
            near | (wide & 7) << 4 | far << 7,
        ];
        let set = near | (wide & 3) << 4;
        self.bits.code(coder, set, &views, 0.0, borders[(row, column)])
    }
}

/// What is known of the blocks around one, and whether it holds any return.
fn block_context(empty: &Grid<bool>, occupancy: &Grid<bool>, (row, column): (usize, usize)) -> usize {
    let at = |up: usize, offset: isize| -> usize {
        match (row.checked_sub(up), column.checked_add_signed(offset)) {
            (Some(row), Some(column)) if column < empty.columns() => usize::from(empty[(row, column)]),
            _ => 1,
        }
    };
    let filled = cells_of(occupancy, (row, column)).any(|cell| occupancy[cell]);
    at(0, -1) | at(1, 0) << 1 | at(1, -1) << 2 | at(1, 1) << 3 | usize::from(filled) << 4
}

/// The cells of a block that are in the image, in scan order.
fn cells_of(
    grid: &Grid<bool>,
    (row, column): (usize, usize),
) -> impl Iterator<Item = (usize, usize)> + use<> {
    let (rows, columns) = (grid.rows(), grid.columns());
    let (top, left) = (row * BLOCK, column * BLOCK);
    (top..(top + BLOCK).min(rows))
        .flat_map(move |row| (left..(left + BLOCK).min(columns)).map(move |column| (row, column)))
}
