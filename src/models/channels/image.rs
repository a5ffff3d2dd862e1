//! Integers that form an image, such as signals and ambient light: each is predicted from its neighbours by
//! least squares, and the difference is coded in contexts of the neighbours. FORMAT.md 8.9.

use crate::entropy::{BitCoder, MixedBits};
use crate::ground::grid::Grid;
use crate::models::least_squares::LeastSquares;

/// Views of a bit of a difference, and opinions on it.
const VIEWS: usize = 6;
const OPINIONS: usize = 8;
/// Neighbours and other numbers from which an integer is predicted.
const FEATURES: usize = 8;
/// Bits of a node of the tree of a difference.
const NODE_BITS: u32 = 6;
const NODES: usize = 1 << NODE_BITS;
/// Binary logarithm of the number of contexts of each view.
const CONTEXT_BITS: [u32; VIEWS] = [6, 10, 10, 12, 12, 12];
/// Integers are below this number.
pub const LIMIT: i64 = 1 << 16;
/// What each further integer leaves of the weight of those before.
const FORGET: f32 = 0.9995;
/// The largest square root of an integer.
const MOST_ROOT: f32 = 256.0;
/// Nodes of the tree of a difference: whether it is 0, its sign, its number of bits in unary, the two bits
/// after the highest one, by this number, and the lower ones.
const IS_ZERO: usize = 0;
const SIGN: usize = 1;
const OCTAVE: usize = 2;
const SECOND_BIT: usize = 20;
const THIRD_BIT: usize = 37;
const LOWER_BITS: usize = 55;

/// What is known of a coded integer.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    /// Its square root: the noise of counted photons is the same everywhere in roots.
    root: f32,
    /// How far the prediction of the root was off.
    error: f32,
    /// The integer + 1; 0 for none.
    number: u32,
}

/// Adaptive models of integers below [`LIMIT`].
#[derive(Clone)]
pub struct ImageModel {
    /// The integers of this frame so far, and those of the frame before.
    known: Grid<Known>,
    before: Grid<Known>,
    /// The last two integers of each row; those of records without a cell in row 0.
    of_row: Vec<[Known; 2]>,
    fit: LeastSquares<FEATURES>,
    bits: MixedBits<VIEWS, OPINIONS>,
}

impl Default for ImageModel {
    fn default() -> Self {
        ImageModel {
            known: Grid::default(),
            before: Grid::default(),
            of_row: Vec::new(),
            fit: LeastSquares::new(FORGET),
            bits: MixedBits::new(CONTEXT_BITS.map(|bits| NODES << bits), NODES, 0.3, 0.0, 0.004),
        }
    }
}

impl ImageModel {
    /// Starts an image with these numbers of rows and columns.
    pub fn start_frame(&mut self, (rows, columns): (usize, usize)) {
        self.before = std::mem::replace(&mut self.known, Grid::new(rows + 1, columns + 1));
        if (self.before.rows(), self.before.columns()) != (rows + 1, columns + 1) {
            self.before = Grid::default();
        }
        self.of_row = vec![[Known::default(); 2]; rows + 1];
    }

    /// Codes the integer of the next record. Its row and column are counted from 1; 0 if it has none. `steps`
    /// is its range, if that is known.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (row, column): (usize, usize),
        steps: u32,
        value: i64,
    ) -> i64 {
        let near = self.near((row, column));
        let features = [
            near.west.root,
            near.north.root,
            near.north_west.root,
            near.north_east.root,
            near.west_west.root,
            near.north_north.root,
            near.back.root,
            1.0,
        ];
        let root = self.fit.predict(&features).clamp(0.0, MOST_ROOT);
        let expected = ((root * root + 0.5) as i64).min(LIMIT - 1);
        let contexts = contexts(&near, row, steps, root, expected);
        let coded = self.code_difference(coder, &contexts, value - expected);
        let value = (expected + coded).clamp(0, LIMIT - 1);
        let actual = (value as f32).sqrt();
        self.fit.learn(&features, actual, 1.0);
        let known = Known { root: actual, error: (actual - root).abs(), number: value as u32 + 1 };
        if row > 0 && column > 0 {
            self.known[(row, column)] = known;
        }
        let of_row = &mut self.of_row[row];
        *of_row = [known, of_row[0]];
        value
    }

    /// The neighbours of a cell.
    fn near(&self, cell: (usize, usize)) -> Near {
        let (row, column) = (cell.0 as isize, cell.1 as isize);
        let at = |down: isize, right: isize| -> Option<Known> {
            let place = (usize::try_from(row + down).ok()?, usize::try_from(column + right).ok()?);
            let is_inside = place.0 < self.known.rows() && place.1 < self.known.columns();
            is_inside.then(|| self.known[place]).filter(|known| known.number > 0)
        };
        let [mut west, mut west_west] = self.of_row[cell.0];
        // Rows may come from top to bottom or the other way round, and so may columns.
        let up = if at(-1, 0).is_some() || at(1, 0).is_none() { -1 } else { 1 };
        let left = if at(0, -1).is_some() || at(0, 1).is_none() { -1 } else { 1 };
        let north = at(up, 0);
        let north_west = at(up, left);
        let north_east = at(up, -left);
        if west.number == 0 {
            west = north.or(north_west).or(north_east).unwrap_or_default();
        }
        if west_west.number == 0 {
            west_west = west;
        }
        let north = north.or(north_west).or(north_east).unwrap_or(west);
        let back = match self.before.rows() {
            0 => None,
            _ => Some(self.before[cell]).filter(|known| known.number > 0),
        };
        Near {
            west,
            west_west,
            north,
            north_north: at(2 * up, 0).unwrap_or(north),
            north_west: north_west.unwrap_or(north),
            north_east: north_east.unwrap_or(north),
            back: back.unwrap_or(west),
        }
    }

    fn code_difference<C: BitCoder>(
        &mut self,
        coder: &mut C,
        contexts: &[usize; VIEWS],
        difference: i64,
    ) -> i64 {
        let bits = &mut self.bits;
        let mut code = |node: usize, bit: bool| {
            let places = contexts.map(|context| context * NODES + node);
            bits.code(coder, node, &places, 0.0, bit)
        };
        if code(IS_ZERO, difference == 0) {
            return 0;
        }
        let is_negative = code(SIGN, difference < 0);
        let size = difference.unsigned_abs();
        let octave = size.max(1).ilog2();
        let mut count = 0;
        while count < LIMIT.ilog2() && code(OCTAVE + count as usize, octave > count) {
            count += 1;
        }
        let mut coded = 1;
        for at in (0..count).rev() {
            let node = match count - 1 - at {
                0 => SECOND_BIT + count as usize,
                1 => THIRD_BIT + count as usize,
                further => LOWER_BITS + (further as usize).min(8),
            };
            coded = coded << 1 | i64::from(code(node, size >> at & 1 == 1));
        }
        if is_negative { -coded } else { coded }
    }
}

/// The neighbours of a cell.
struct Near {
    west: Known,
    west_west: Known,
    north: Known,
    north_north: Known,
    north_west: Known,
    north_east: Known,
    /// The same cell in the frame before.
    back: Known,
}

/// The contexts of a difference, one for each view.
fn contexts(near: &Near, row: usize, steps: u32, root: f32, expected: i64) -> [usize; VIEWS] {
    let Near { west, north, north_west, north_east, .. } = near;
    // How far an integer is off, in half bits, if its root is off by this much.
    let half_bits = |error: f32| {
        let off = error * (2.0 * root + error) * 4.0 + 1.0;
        octave(off * off)
    };
    let errors = west.error + north.error + 0.5 * (north_west.error + north_east.error);
    let spread = (west.root - north.root).abs() + (north.root - north_west.root).abs();
    let (by_errors, by_spread) = (half_bits(errors / 3.0).min(39), half_bits(spread / 2.0).min(39));
    let level = level(expected);
    let slot = |view: usize, a: usize, b: usize| {
        let hash =
            (a as u32).wrapping_mul(0x9e37_79b1) ^ (b as u32).wrapping_mul(0x85eb_ca6b).rotate_left(13);
        (hash.wrapping_mul(0x9e37_79b1) >> (u32::BITS - CONTEXT_BITS[view])) as usize
    };
    [
        by_errors,
        slot(1, row, by_errors / 4),
        slot(2, expected as usize, 0),
        slot(3, west.number as usize, north.number as usize),
        slot(4, level * 64 + by_errors / 2, steps.checked_ilog2().map_or(0, |octave| octave as usize + 1)),
        slot(5, by_errors * 64 + by_spread, level),
    ]
}

/// An integer by its size, in quarters of octaves; exact if it is small.
fn level(integer: i64) -> usize {
    match integer.max(1).ilog2() as usize {
        0..3 => integer as usize,
        octave => (octave - 1) * 4 + (integer >> (octave - 2) & 3) as usize,
    }
}

/// Log2 of a number, at least 0, rounded down.
fn octave(number: f32) -> usize {
    (number.max(1.0).to_bits() >> (f32::MANTISSA_DIGITS - 1)) as usize - 127
}
