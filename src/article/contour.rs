//! The contour map (article, IV-D.1): the region of each return, coded as borders and the regions of the
//! pieces between them. The same functions code it in both directions. FORMAT.md 8.11.
//!
//! A return is on a border if the next return to its right or below it, however far away, belongs to another
//! region. The bitmap of borders is coded in blocks of 4 x 4 cells: for each row of blocks, first which of
//! them contain a border, then the bits of those that do, line by line, so that everything above a bit is
//! known. A return that is not on a border is joined with the next returns to its right and below; joined
//! returns are a *piece*. The region of each piece is coded in scan order. Single returns between borders,
//! the article's exceptions, are pieces like others. The image does not wrap around: the seam is one column
//! of many.
//!
//! The file holds the model with its numbering of regions, then returns with their neighbours, borders,
//! pieces, and the regions of pieces.

use std::ops::Range;

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel, MixedBits};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// The adaptive models of contour maps.
#[derive(Clone, Default)]
pub struct ContourModel {
    borders: BorderModel,
    values: ValueModel,
}

impl ContourModel {
    /// Codes the labels (rows x columns) of the cells that hold a return. The encoder's must be numbered as
    /// by [`renumber`]; a decoder's are ignored except for their size. Returns the number of regions.
    ///
    /// Rows should be [aligned](crate::scanner::hdl64::Alignment::align), since vertical borders are cheap.
    ///
    /// # Errors
    /// If the stream refers to a region that does not exist.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        labels: &mut Grid<u32>,
    ) -> Result<u32> {
        let returns = Returns::of(occupancy);
        let (mut regions_of, mut borders) = (vec![0; returns.len()], Vec::new());
        if C::ENCODES {
            (0..returns.len()).for_each(|number| regions_of[number] = labels[returns.cell(number)]);
            borders = borders_of(&returns, &regions_of);
        }
        let borders = self.borders.code(coder, &returns, &borders);
        let pieces = pieces_of(&returns, &borders);
        let regions = self.values.code(coder, &returns, &pieces, &mut regions_of)?;
        *labels = Grid::new(occupancy.rows(), occupancy.columns());
        (0..returns.len()).for_each(|number| labels[returns.cell(number)] = regions_of[number]);
        Ok(regions)
    }
}

/// Numbers the labels of returns from 1 in the order of their first appearance in the scan; 0 elsewhere.
/// Returns the old label of each number, from 1 on.
pub fn renumber(occupancy: &Grid<bool>, labels: &mut Grid<u32>) -> Vec<u32> {
    let end = labels.cells().iter().max().map_or(0, |most| *most as usize + 1);
    let (mut numbers, mut old) = (vec![0; end], Vec::new());
    for row in 0..labels.rows() {
        for (label, filled) in labels.row_mut(row).iter_mut().zip(occupancy.row(row)) {
            if !filled {
                *label = 0;
                continue;
            }
            let number = &mut numbers[*label as usize];
            if *number == 0 {
                old.push(*label);
                *number = old.len() as u32;
            }
            *label = *number;
        }
    }
    old
}

/// Whether each return differs from the next one to the right or below.
fn borders_of(returns: &Returns, regions_of: &[u32]) -> Vec<bool> {
    let is_border = |number: usize| {
        let differs = |other: Option<usize>| other.is_some_and(|o| regions_of[o] != regions_of[number]);
        differs(returns.right(number)) || differs(returns.below(number))
    };
    (0..returns.len()).map(is_border).collect()
}

/// Returns, with the next one in each direction of their row and column, however far away.
struct Returns {
    columns: usize,
    /// The number of each row's first return, and the end of the last row.
    row_starts: Vec<usize>,
    /// Row and column of each return.
    cells: Vec<(u32, u32)>,
    above: Vec<Option<u32>>,
    below: Vec<Option<u32>>,
}

impl Returns {
    /// The returns of an image.
    fn of(occupancy: &Grid<bool>) -> Self {
        let (columns, row_starts) = (occupancy.columns(), vec![0]);
        let mut returns =
            Returns { columns, row_starts, cells: Vec::new(), above: Vec::new(), below: Vec::new() };
        let mut last = vec![None; columns];
        for row in 0..occupancy.rows() {
            for (column, _) in occupancy.row(row).iter().enumerate().filter(|(_, filled)| **filled) {
                returns.push((row, column), &mut last[column]);
            }
            returns.row_starts.push(returns.len());
        }
        returns
    }

    /// Adds a return; `last` is the last one in its column, and becomes this one.
    fn push(&mut self, (row, column): (usize, usize), last: &mut Option<u32>) {
        let number = self.len() as u32;
        let above = last.replace(number);
        if let Some(above) = above {
            self.below[above as usize] = Some(number);
        }
        self.cells.push((row as u32, column as u32));
        self.above.push(above);
        self.below.push(None);
    }

    /// Number of returns.
    fn len(&self) -> usize {
        self.cells.len()
    }

    /// Number of columns of the image.
    fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows of the image.
    fn rows(&self) -> usize {
        self.row_starts.len() - 1
    }

    /// Row and column of a return.
    fn cell(&self, number: usize) -> (usize, usize) {
        let (row, column) = self.cells[number];
        (row as usize, column as usize)
    }

    /// The returns of a row.
    fn in_row(&self, row: usize) -> Range<usize> {
        self.row_starts[row]..self.row_starts[row + 1]
    }

    /// The return before it in its row.
    fn left(&self, number: usize) -> Option<usize> {
        number.checked_sub(1).filter(|&left| self.cells[left].0 == self.cells[number].0)
    }

    /// The return after it in its row.
    fn right(&self, number: usize) -> Option<usize> {
        self.cells.get(number + 1).filter(|right| right.0 == self.cells[number].0).map(|_| number + 1)
    }

    /// The return before it in its column.
    fn above(&self, number: usize) -> Option<usize> {
        self.above[number].map(|above| above as usize)
    }

    /// The return after it in its column.
    fn below(&self, number: usize) -> Option<usize> {
        self.below[number].map(|below| below as usize)
    }
}

/// Rows and columns of a block.
const BLOCK: usize = 4;
/// Number of opinions that are mixed: those of all views and two more.
const OPINIONS: usize = 8;
const BLOCK_VIEWS: [usize; 4] = [1 << 7, 1 << 9, 32 << 4, 1 << 10];
const BIT_VIEWS: [usize; 6] = [1 << 10, 1 << 12, 128 << 4, 1 << 12, 1 << 9, 1 << 12];
/// Rows of blocks from this number on share their contexts.
const BLOCK_ROWS: usize = 32;
/// Rows from this number on share their contexts.
const BIT_ROWS: usize = 128;

/// The adaptive models of borders.
#[derive(Clone)]
struct BorderModel {
    blocks: MixedBits<4, OPINIONS>,
    bits: MixedBits<6, OPINIONS>,
}

impl Default for BorderModel {
    fn default() -> Self {
        BorderModel {
            blocks: MixedBits::new(BLOCK_VIEWS, 32, 0.4, 0.0, 0.005),
            bits: MixedBits::new(BIT_VIEWS, 64, 0.25, 0.0, 0.01),
        }
    }
}

/// A row of blocks. Block b is entry b + 1, because there is an additional block on each side.
struct Stripe {
    /// The first row of its cells.
    top: usize,
    /// Number of uncoded returns in each block.
    to_code: Vec<usize>,
    /// Whether there is a border in each block; a block without returns has the value of the one to its left.
    has_border: Vec<bool>,
    /// Whether a border in each block was already coded.
    border_seen: Vec<bool>,
}

impl Stripe {
    fn new(top: usize, columns: usize) -> Self {
        let blocks = columns.div_ceil(BLOCK) + 2;
        Stripe {
            top,
            to_code: vec![0; blocks],
            has_border: vec![false; blocks],
            border_seen: vec![false; blocks],
        }
    }
}

/// The known part of the bitmap.
struct Known<'a> {
    returns: &'a Returns,
    /// The bit of each return; false if it is not yet coded.
    bits: Vec<bool>,
    /// The last bit in each column.
    last: Vec<bool>,
    /// Which blocks of the row above contain a border.
    blocks_above: Vec<bool>,
}

impl BorderModel {
    /// Codes which returns are on a border. The encoder passes them in `borders`, which may be empty in a
    /// decoder.
    fn code<C: BitCoder>(&mut self, coder: &mut C, returns: &Returns, borders: &[bool]) -> Vec<bool> {
        let (rows, columns) = (returns.rows(), returns.columns());
        let mut known = Known {
            returns,
            bits: vec![false; returns.len()],
            last: vec![false; columns],
            blocks_above: Stripe::new(0, columns).has_border,
        };
        for top in (0..rows).step_by(BLOCK) {
            let numbers = returns.in_row(top).start..returns.in_row((top + BLOCK).min(rows) - 1).end;
            let is_border = |number: usize| C::ENCODES && borders[number];
            let mut stripe = Stripe::new(top, columns);
            for number in numbers.clone() {
                let block = known.block_of(number);
                stripe.to_code[block] += 1;
                stripe.has_border[block] |= is_border(number);
            }
            self.code_blocks(coder, &known, &mut stripe);
            for number in numbers {
                let block = known.block_of(number);
                stripe.to_code[block] -= 1;
                let bit = stripe.has_border[block]
                    && self.code_bit(coder, &known, &stripe, number, is_border(number));
                stripe.border_seen[block] |= bit;
                known.learn(number, bit);
            }
            known.blocks_above = stripe.has_border;
        }
        known.bits
    }

    /// Codes which blocks of a row contain a border, skipping blocks without returns.
    fn code_blocks<C: BitCoder>(&mut self, coder: &mut C, known: &Known, stripe: &mut Stripe) {
        for block in 1..stripe.to_code.len() - 1 {
            if stripe.to_code[block] == 0 {
                stripe.has_border[block] = stripe.has_border[block - 1];
                continue;
            }
            let (set, views) = known.around_block(stripe, block);
            let has_border = self.blocks.code(coder, set, &views, 0.0, stripe.has_border[block]);
            stripe.has_border[block] = has_border;
        }
    }

    fn code_bit<C: BitCoder>(
        &mut self,
        coder: &mut C,
        known: &Known,
        stripe: &Stripe,
        number: usize,
        border: bool,
    ) -> bool {
        let (set, views) = known.around_bit(stripe, number);
        self.bits.code(coder, set, &views, 0.0, border)
    }
}

impl Known<'_> {
    fn block_of(&self, number: usize) -> usize {
        self.returns.cell(number).1 / BLOCK + 1
    }

    fn learn(&mut self, number: usize, bit: bool) {
        self.bits[number] = bit;
        self.last[self.returns.cell(number).1] = bit;
    }

    /// The contexts of a block: which blocks around it contain borders, and the bits right above it.
    fn around_block(&self, stripe: &Stripe, block: usize) -> (usize, [usize; BLOCK_VIEWS.len()]) {
        let left = usize::from(stripe.has_border[block - 1]);
        let left_of_left = usize::from(block > 1 && stripe.has_border[block - 2]);
        let above = |block: usize| usize::from(self.blocks_above[block]);
        let near = left | above(block) << 1 | above(block - 1) << 2 | above(block + 1) << 3;
        // 1 to 3 returns, 4 to 7, 8 to 15, or all 16.
        let fill = stripe.to_code[block].ilog2().max(1) as usize - 1;
        let column = (block - 1) * BLOCK;
        let bit = |column: usize| usize::from(self.last.get(column).is_some_and(|bit| *bit));
        let touching = (0..BLOCK).fold(0, |bits, i| bits | bit(column + i) << i);
        let before = bit(column.wrapping_sub(1)) | bit(column.wrapping_sub(2)) << 1;
        let after = bit(column + BLOCK) | bit(column + BLOCK + 1) << 1;
        let row = (stripe.top / BLOCK).min(BLOCK_ROWS - 1);
        let views = [
            near | fill << 4 | left_of_left << 6,
            touching | before << 4 | after << 6 | left << 8,
            near | row << 4,
            touching | near << 4 | fill << 8,
        ];
        (usize::from(touching > 0) | near << 1, views)
    }

    /// The contexts of a bit: the bits around it, gaps between the returns, and whether its block still needs
    /// a border.
    fn around_bit(&self, stripe: &Stripe, number: usize) -> (usize, [usize; BIT_VIEWS.len()]) {
        let returns = self.returns;
        let bit = |other: Option<usize>| other.map_or(0, |other| usize::from(self.bits[other]));
        let left = |of: Option<usize>| of.and_then(|of| returns.left(of));
        let right = |of: Option<usize>| of.and_then(|of| returns.right(of));
        let above = |of: Option<usize>| of.and_then(|of| returns.above(of));
        let (w, n) = (returns.left(number), returns.above(number));
        let (ww, nn, nw, ne) = (left(w), above(n), left(n), right(n));
        let nee = right(ne);
        let near = bit(w) | bit(n) << 1 | bit(nw) << 2 | bit(ne) << 3;
        let straight = bit(ww) | bit(nn) << 1;
        let wide = near | straight << 4 | bit(nee) << 6;
        let (row, column) = returns.cell(number);
        let block = column / BLOCK + 1;
        let lacks = usize::from(stripe.border_seen[block]) | stripe.to_code[block] << 1;
        let beside =
            usize::from(stripe.has_border[block + 1]) | usize::from(stripe.has_border[block - 1]) << 1;
        let gaps = Gaps::around(returns, number);
        let views = [
            wide | bit(left(nw)) << 7 | bit(right(nn)) << 8 | bit(left(nn)) << 9,
            near | gaps.ahead << 4 | gaps.behind << 8,
            near | row.min(BIT_ROWS - 1) << 4,
            wide | bit(left(ww)) << 7 | bit(above(nn)) << 8 | bit(right(nee)) << 9 | (gaps.ahead & 3) << 10,
            near | lacks << 4,
            near | beside << 4 | gaps.ahead << 6 | (column % BLOCK) << 10,
        ];
        (near | straight << 4, views)
    }
}

/// Numbers of empty cells between a return and the next in each direction: 0, 1, or 2 for more; 3 if there is
/// no return. Two directions are combined in a number.
struct Gaps {
    /// To the right, plus 4 times that below.
    ahead: usize,
    /// To the left, plus 4 times that above.
    behind: usize,
}

impl Gaps {
    fn around(returns: &Returns, number: usize) -> Self {
        let (row, column) = returns.cell(number);
        let gap = |other: Option<usize>| {
            other.map_or(3, |other| {
                let cell = returns.cell(other);
                (cell.0.abs_diff(row) + cell.1.abs_diff(column) - 1).min(2)
            })
        };
        Gaps {
            ahead: gap(returns.right(number)) | gap(returns.below(number)) << 2,
            behind: gap(returns.left(number)) | gap(returns.above(number)) << 2,
        }
    }
}

/// The piece of each return, determined by filling between the borders. A return that is not on a border is
/// in the same piece as the next returns to its right and below. A piece is identified by its first return.
fn pieces_of(returns: &Returns, borders: &[bool]) -> Vec<u32> {
    let mut first: Vec<u32> = (0..returns.len() as u32).collect();
    for number in (0..returns.len()).filter(|&number| !borders[number]) {
        for other in [returns.right(number), returns.below(number)].into_iter().flatten() {
            join(&mut first, number as u32, other as u32);
        }
    }
    // The first return of a piece precedes all others of it, so one pass is enough.
    for number in 0..first.len() {
        first[number] = first[first[number] as usize];
    }
    first
}

/// Joins the pieces of two returns; the earlier first return stays the first.
fn join(first: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(first, a), root(first, b));
    first[a.max(b) as usize] = a.min(b);
}

/// The first return of a piece; halves the path to it (union-find).
fn root(first: &mut [u32], mut number: u32) -> u32 {
    while first[number as usize] != number {
        first[number as usize] = first[first[number as usize] as usize];
        number = first[number as usize];
    }
    number
}

/// Number of recently used regions that have short codes.
const RECENT: usize = 4;
/// Classes of surroundings.
const VALUE_CONTEXTS: usize = 1 << 5;

/// The adaptive models of the regions of pieces.
#[derive(Clone, Default)]
struct ValueModel {
    is_left: [AdaptiveBit; VALUE_CONTEXTS],
    is_above: [AdaptiveBit; VALUE_CONTEXTS],
    is_above_right: [AdaptiveBit; VALUE_CONTEXTS],
    is_new: [AdaptiveBit; VALUE_CONTEXTS],
    is_recent: [AdaptiveBit; RECENT],
    back: IntegerModel,
}

/// The regions around the first return of a piece.
struct Around {
    /// The regions of the returns to the left, above, and above to the right, if the piece may belong to
    /// them. All different; 0 = none.
    candidates: [u32; 3],
    /// Regions that the piece cannot belong to because of the borders; 0 = none.
    ruled_out: [u32; 2],
    /// How the surrounding regions compare.
    context: usize,
}

impl ValueModel {
    /// Codes the region of each piece at its first return, and assigns it to all its returns. Regions are
    /// numbered from 1 in order of appearance. Returns their number.
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        returns: &Returns,
        pieces: &[u32],
        regions_of: &mut [u32],
    ) -> Result<u32> {
        let mut recent = [0u32; RECENT];
        let mut regions = 0;
        for number in 0..returns.len() {
            let first = pieces[number] as usize;
            if first < number {
                regions_of[number] = regions_of[first];
                continue;
            }
            let around = Around::of(returns, pieces, regions_of, number);
            let region = self.code_region(coder, &around, &recent, regions, regions_of[number])?;
            regions_of[number] = region;
            regions = regions.max(region);
            keep_recent(&mut recent, region);
        }
        Ok(regions)
    }

    fn code_region<C: BitCoder>(
        &mut self,
        coder: &mut C,
        around: &Around,
        recent: &[u32; RECENT],
        regions: u32,
        region: u32,
    ) -> Result<u32> {
        let Around { candidates, ruled_out, context } = *around;
        let models = [&mut self.is_left, &mut self.is_above, &mut self.is_above_right];
        for (model, candidate) in models.into_iter().zip(candidates) {
            if candidate > 0 && model[context].code(coder, region == candidate) {
                return Ok(candidate);
            }
        }
        if self.is_new[context].code(coder, region > regions) {
            return Ok(regions + 1);
        }
        for (model, &candidate) in self.is_recent.iter_mut().zip(recent) {
            let excluded =
                candidate == 0 || candidates.contains(&candidate) || ruled_out.contains(&candidate);
            if !excluded && model.code(coder, region == candidate) {
                return Ok(candidate);
            }
        }
        let back = self.back.code(coder, u64::from(regions.wrapping_sub(region)));
        let back = u32::try_from(back).ok().filter(|back| *back < regions);
        back.map(|back| regions - back)
            .ok_or_else(|| Error::corrupt("contour map: a region that is not there"))
    }
}

impl Around {
    fn of(returns: &Returns, pieces: &[u32], regions_of: &[u32], number: usize) -> Self {
        let (left, above) = (returns.left(number), returns.above(number));
        let right_of = |other: Option<usize>| other.and_then(|other| returns.right(other));
        let left_of = |other: Option<usize>| other.and_then(|other| returns.left(other));
        // Pieces that begin later do not have a region yet.
        let region = |other: Option<usize>| {
            let first = other.map(|other| pieces[other] as usize).filter(|&first| first < number);
            first.map_or(0, |first| regions_of[first])
        };
        let [l, a, ar, al] = [left, above, right_of(above), left_of(above)].map(region);
        let begins_at = |other: Option<usize>| other.is_some_and(|other| pieces[other] as usize == number);
        let is_more = begins_at(right_of(Some(number))) || begins_at(returns.below(number));
        let context = usize::from(l == a)
            | usize::from(a == ar) << 1
            | usize::from(l == ar) << 2
            | usize::from(l == al) << 3
            | usize::from(is_more) << 4;
        // The return before a new piece is on a border: if everything else that it borders on belongs to its
        // own region, the piece does not.
        let alone = |own: u32, beside: Option<usize>| beside.is_none_or(|_| region(beside) == own);
        let below_left = left.and_then(|left| returns.below(left));
        let not_left = if alone(l, below_left) { l } else { 0 };
        let not_above = if alone(a, right_of(above)) { a } else { 0 };
        let ruled_out = [not_left, not_above];
        let mut candidates = [l, a, ar];
        for i in 0..candidates.len() {
            if ruled_out.contains(&candidates[i]) || candidates[..i].contains(&candidates[i]) {
                candidates[i] = 0;
            }
        }
        Around { candidates, ruled_out, context }
    }
}

/// Moves a region to the front of those used most recently.
fn keep_recent(recent: &mut [u32; RECENT], region: u32) {
    let place = recent.iter().position(|other| *other == region).unwrap_or(RECENT - 1);
    recent[..=place].rotate_right(1);
    recent[0] = region;
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};

    /// Codes labels, decodes them and compares; returns the number of bytes.
    fn comes_back(occupancy: &Grid<bool>, labels: &Grid<u32>) -> usize {
        let mut numbered = labels.clone();
        let regions = renumber(occupancy, &mut numbered).len() as u32;
        let mut encoder = ArithmeticEncoder::default();
        let mut coded = numbered.clone();
        assert_eq!(ContourModel::default().code(&mut encoder, occupancy, &mut coded).unwrap(), regions);
        assert_eq!(coded, numbered);
        let bytes = encoder.finish();
        let mut decoded = Grid::new(occupancy.rows(), occupancy.columns());
        let mut decoder = ArithmeticDecoder::new(&bytes);
        assert_eq!(ContourModel::default().code(&mut decoder, occupancy, &mut decoded).unwrap(), regions);
        assert_eq!(decoded, numbered);
        bytes.len()
    }

    fn grid<T: Clone + Default>(rows: usize, columns: usize, value: impl Fn(usize, usize) -> T) -> Grid<T> {
        let mut grid = Grid::new(rows, columns);
        for row in 0..rows {
            for column in 0..columns {
                grid[(row, column)] = value(row, column);
            }
        }
        grid
    }

    #[test]
    fn odd_maps_come_back() {
        let all = grid(64, 100, |_, _| true);
        comes_back(&Grid::new(0, 0), &Grid::new(0, 0));
        comes_back(&Grid::new(64, 0), &Grid::new(64, 0));
        comes_back(&Grid::new(64, 100), &Grid::new(64, 100));
        comes_back(&grid(64, 100, |r, c| (r, c) == (20, 30)), &grid(64, 100, |_, _| 9));
        assert!(comes_back(&all, &grid(64, 100, |_, _| 5)) < 40, "one region");
        comes_back(&all, &grid(64, 100, |r, c| (r * 100 + c) as u32));
        comes_back(&all, &grid(64, 100, |r, c| 1 + (r + c) as u32 % 2));
        // More rows than have their own contexts.
        comes_back(&grid(300, 20, |r, c| (r * c) % 5 > 0), &grid(300, 20, |r, c| (r / 7 + c / 3) as u32));
    }

    #[test]
    fn sixty_thousand_regions_come_back() {
        comes_back(&grid(64, 1000, |r, c| (r + c) % 16 != 0), &grid(64, 1000, |r, c| (r * 1000 + c) as u32));
    }

    #[test]
    fn numbers_are_in_order_of_appearance() {
        let occupancy = grid(2, 3, |r, c| (r, c) != (0, 0));
        let mut labels = grid(2, 3, |r, c| [[8, 7, 7], [9, 3, 7]][r][c]);
        assert_eq!(renumber(&occupancy, &mut labels), [7, 9, 3]);
        assert_eq!(labels.cells(), [0, 1, 1, 2, 3, 1]);
    }

    #[test]
    fn cells_without_a_return_cost_nothing() {
        // A wall of three regions, complete and with two of three returns missing.
        let labels = grid(60, 300, |r, c| (c + r / 10) as u32 / 110);
        let sparse = grid(60, 300, |r, c| (r + c) % 3 == 0);
        let whole = grid(60, 300, |_, _| true);
        assert!(comes_back(&sparse, &labels) <= comes_back(&whole, &labels) + 10);
    }

    #[test]
    fn what_borders_imply_costs_nothing() {
        // A diagonal border between two regions: wherever a piece begins, the border determines its region.
        let stairs = grid(64, 64, |r, c| u32::from(r + c >= 64));
        assert!(comes_back(&grid(64, 64, |_, _| true), &stairs) < 60);
    }

    proptest! {
        #[test]
        fn any_map_comes_back(
            cells in prop::collection::vec((any::<bool>(), 0u32..5), 60),
            rows in prop::sample::select(vec![1usize, 3, 5, 10, 60]),
        ) {
            let columns = 60 / rows;
            let occupancy = grid(rows, columns, |r, c| cells[r * columns + c].0);
            comes_back(&occupancy, &grid(rows, columns, |r, c| cells[r * columns + c].1));
        }

        #[test]
        fn any_bytes_give_a_labelling_or_an_error(
            bytes in prop::collection::vec(any::<u8>(), 0..60),
            filled in prop::collection::vec(any::<bool>(), 60),
        ) {
            let occupancy = grid(6, 10, |r, c| filled[r * 10 + c]);
            let mut labels = Grid::new(6, 10);
            let mut decoder = ArithmeticDecoder::new(&bytes);
            let coded = ContourModel::default().code(&mut decoder, &occupancy, &mut labels);
            if let Ok(regions) = coded {
                for (label, filled) in labels.cells().iter().zip(occupancy.cells()) {
                    prop_assert_eq!((1..=regions).contains(label), *filled);
                    prop_assert!(*filled || *label == 0);
                }
            }
        }
    }
}
