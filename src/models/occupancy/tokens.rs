//! Occupancy as tokens: eight cells each, as their difference from the row above. FORMAT.md 8.16.

use crate::entropy::TokenCoder;
use crate::ground::grid::Grid;

/// Cells in a token.
const CELLS: usize = 8;
/// Kinds of eight cells: all occupied, none, and two in between.
const KINDS: usize = 4;
/// A context consists of the kinds of the cells above and of the cells before.
pub const OCCUPANCY_CONTEXTS: usize = KINDS * KINDS;

/// Codes every cell.
pub fn code_occupancy<C: TokenCoder>(coder: &mut C, occupancy: &mut Grid<bool>) {
    let (rows, columns) = (occupancy.rows(), occupancy.columns());
    // Above the first row all cells count as occupied, because most are.
    let mut above = vec![u8::MAX; columns.div_ceil(CELLS)];
    for row in 0..rows {
        if coder.is_exhausted() {
            return;
        }
        let mut before = u8::MAX;
        for (cells, above) in occupancy.row_mut(row).chunks_mut(CELLS).zip(&mut above) {
            let missing = u8::MAX << (cells.len() - 1) << 1;
            let context = kind(*above) * KINDS + kind(before);
            let mut filled = missing;
            if C::ENCODES {
                cells.iter().enumerate().for_each(|(i, &cell)| filled |= u8::from(cell) << i);
            }
            filled = coder.token(context, filled ^ *above) ^ *above;
            if !C::ENCODES {
                cells.iter_mut().enumerate().for_each(|(i, cell)| *cell = filled >> i & 1 == 1);
            }
            (*above, before) = (filled | missing, filled | missing);
        }
    }
}

fn kind(cells: u8) -> usize {
    match cells.count_ones() {
        8 => 0,
        0 => 1,
        4..8 => 2,
        _ => 3,
    }
}
