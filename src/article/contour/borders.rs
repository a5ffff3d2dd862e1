//! The bitmap of borders, in blocks of 4 x 4 cells. For each row of blocks, first which of them contain a
//! border, then the bits of those that do, line by line, so that everything above a bit is known.
//! FORMAT.md 8.11, "Borders".

use super::returns::Returns;
use crate::entropy::{BitCoder, MixedBits};

/// Rows and columns of a block.
const BLOCK: usize = 4;
/// Number of opinions that are mixed: those of all views and two more.
const OPINIONS: usize = 8;
const BLOCK_VIEWS: [usize; 4] = [1 << 7, 1 << 9, 32 << 4, 1 << 10];
const BIT_VIEWS: [usize; 6] = [1 << 10, 1 << 12, 128 << 4, 1 << 12, 1 << 9, 1 << 12];
/// Rows of blocks from this number on share their contexts.
const BLOCK_ROWS: usize = 32;
/// Rows from this number on share their contexts.
const ROWS: usize = 128;

/// The adaptive models of borders.
#[derive(Clone)]
pub struct BorderModel {
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
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, returns: &Returns, borders: &[bool]) -> Vec<bool> {
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
            near | row.min(ROWS - 1) << 4,
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
