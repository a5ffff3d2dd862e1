//! Which cells of the range image hold a return: mixed bits, and tokens of eight cells. FORMAT.md 8.3 and
//! 8.16.

use crate::entropy::{BitCoder, Counter, MixedBits, TokenCoder};
use crate::ground::grid::Grid;
use crate::inter::Reference;

/// Cells beyond each side that contexts include.
const MARGIN: usize = 4;
const VIEWS: usize = 4;
const OPINIONS: usize = 8;
const VIEW_SIZES: [usize; VIEWS] = [1 << 10, 128 * 16, 1 << 12, 1 << 10];
const REFERENCE_VIEWS: usize = 2;
const REFERENCE_VIEW_SIZES: [usize; REFERENCE_VIEWS] = [1 << 12, 1 << 9];
/// Number of weight sets for the surrounding cells, and the factor for those with a reference.
const SETS: usize = 64;
const REFERENCE_SETS: usize = 4;
/// Rows from this number on share their contexts.
const ROW_CONTEXTS: usize = 128;

/// The adaptive models of occupancy.
#[derive(Clone)]
pub struct OccupancyModel {
    filled: MixedBits<VIEWS, OPINIONS>,
    /// The counters of the reference's views, once there was a reference.
    reference: Option<[Vec<Counter>; REFERENCE_VIEWS]>,
    /// Magnitude of the log odds from which two views alone decide a cell.
    sure: f32,
}

/// The value for fast coding: most cells are this certain.
const SURE_IN_LIGHT: f32 = 2.5;

impl Default for OccupancyModel {
    fn default() -> Self {
        OccupancyModel {
            filled: MixedBits::new(VIEW_SIZES, SETS * (1 + REFERENCE_SETS), 0.4, 0.0, 0.003),
            reference: None,
            sure: f32::INFINITY,
        }
    }
}

impl OccupancyModel {
    /// Sets whether two views alone decide a cell from now on, where they are certain.
    pub fn use_light(&mut self, is_light: bool) {
        self.sure = if is_light { SURE_IN_LIGHT } else { f32::INFINITY };
    }

    /// Codes every cell. `reference` is the prediction from an earlier frame.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        reference: Option<&Reference>,
        occupancy: &mut Grid<bool>,
    ) {
        if reference.is_some() && self.reference.is_none() {
            self.filled.spread_sets(SETS);
            self.reference = Some(REFERENCE_VIEW_SIZES.map(|size| vec![Counter::default(); size]));
        }
        let width = occupancy.columns();
        // A history of each column: for each row above, whether its cell was empty. The bits move down with
        // every row.
        let mut empty_above = vec![0u32; width];
        // The current row and the three above. Cells outside count as occupied, because most cells are.
        let mut window = std::array::from_fn::<_, 4, _>(|_| vec![1u8; width + 2 * MARGIN]);
        for row in 0..occupancy.rows() {
            if coder.is_exhausted() {
                return;
            }
            window.rotate_right(1);
            let [current, above, above2, above3] = &mut window;
            let mut run = 0usize;
            // The cells to the left and, in the rows above, those up to the margin to the right of a column;
            // the latest cell is in the lowest bit.
            let (mut left, mut n_cells, mut n2_cells) = (usize::MAX, usize::MAX, usize::MAX);
            for cell in &above[MARGIN..2 * MARGIN] {
                n_cells = n_cells << 1 | usize::from(*cell);
            }
            for cell in &above2[MARGIN..MARGIN + 2] {
                n2_cells = n2_cells << 1 | usize::from(*cell);
            }
            for column in 0..width {
                n_cells = n_cells << 1 | usize::from(above[column + 2 * MARGIN]);
                n2_cells = n2_cells << 1 | usize::from(above2[column + MARGIN + 2]);
                let w: [usize; 3] = std::array::from_fn(|i| left >> i & 1);
                let n: [usize; 7] = std::array::from_fn(|i| n_cells >> (6 - i) & 1);
                let n2: [usize; 3] = std::array::from_fn(|i| n2_cells >> (2 - i) & 1);
                let n3 = usize::from(above3[column + MARGIN]);
                let near = w[0] | n[2] << 1 | n[1] << 2 | n[3] << 3;
                let run_level = run.min(255).checked_ilog2().map_or(0, |r| r as usize + 1);
                let views = [
                    near | w[1] << 4 | w[2] << 5 | n2[0] << 6 | n[4] << 7 | n[0] << 8 | n2[1] << 9,
                    row.min(ROW_CONTEXTS - 1) * 16 + near,
                    (run_level.min(7) * 8 + (n[2] | n[3] << 1 | n[4] << 2)) * 64
                        + (n[5] | n[6] << 1 | n2[0] << 2 | n2[2] << 3 | w[0] << 4 | n3 << 5),
                    (empty_above[column] as usize >> 2) * 16 + near,
                ];
                let set = near | n2[0] << 4 | w[1] << 5;
                let filled = &mut occupancy[(row, column)];
                let back = reference.map(|reference| Back::at(reference, (row, column)));
                *filled = match (back, &mut self.reference) {
                    (Some(back), Some([first, second])) => {
                        let places = back.places(near | w[1] << 4 | n2[0] << 5);
                        let extra = [&mut first[places[0]], &mut second[places[1]]];
                        let set = SETS * (1 + back.set()) + set;
                        self.filled.code_or_sure(coder, self.sure, set, &views, extra, *filled)
                    }
                    _ => self.filled.code_or_sure(coder, self.sure, set, &views, [], *filled),
                };
                let filled = *filled;
                current[column + MARGIN] = u8::from(filled);
                left = left << 1 | usize::from(filled);
                empty_above[column] = empty_above[column] >> 1 | u32::from(!filled) << 7;
                run = if usize::from(filled) == w[0] { run + 1 } else { 0 };
            }
        }
    }
}

/// The cells around a cell in which an earlier frame has returns.
struct Back {
    /// The cell itself, then left, right, above and below.
    around: usize,
    /// Two to the left, two to the right, below right and below left.
    wide: usize,
}

impl Back {
    fn at(reference: &Reference, cell: (usize, usize)) -> Self {
        let bits = |offsets: &[(isize, isize)]| {
            let filled = |&(down, right)| reference.same.steps.beside(cell, down, right) > 0;
            offsets.iter().enumerate().fold(0, |bits, (i, offset)| bits | usize::from(filled(offset)) << i)
        };
        Back {
            around: bits(&[(0, 0), (0, -1), (0, 1), (-1, 0), (1, 0)]),
            wide: bits(&[(0, -2), (0, 2), (1, 1), (1, -1)]),
        }
    }

    /// The contexts of the reference's views; `near` is six bits of the cells coded before.
    fn places(&self, near: usize) -> [usize; REFERENCE_VIEWS] {
        [self.around | near << 5 | (self.wide & 1) << 11, self.around | self.wide << 5]
    }

    fn set(&self) -> usize {
        self.around & 1 | usize::from(self.around == 0 || self.around == 31) << 1
    }
}

/// Cells in a token.
const CELLS: usize = 8;
/// Kinds of eight cells: all occupied, none, and two in between.
const KINDS: usize = 4;
/// A context consists of the kinds of the cells above and of the cells before.
pub const OCCUPANCY_CONTEXTS: usize = KINDS * KINDS;

/// Codes every cell as tokens: each is the difference of eight cells from those in the row above.
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
