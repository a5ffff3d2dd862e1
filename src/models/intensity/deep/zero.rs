//! Whether an intensity is 0 because the return was too weak. This is a case of its own, not the lowest of a
//! surface's possible levels. FORMAT.md 8.5, "Levels, if `coder` is 1".

use super::surroundings::Surroundings;
use super::views::NARROW_SECTOR;
use crate::entropy::{BitCoder, MixedBits};

const VIEWS: usize = 8;
const OPINIONS: usize = 12;
/// Binary logarithm of the number of counters of each view: contexts share them by hashing.
const SLOT_BITS: u32 = 16;
/// Number of weight sets: by which of six neighbours are 0, and whether there is a reference.
const SETS: usize = 128;
/// Rows from this number on share their contexts.
const ROW_CONTEXTS: usize = 128;

/// The adaptive models of zeros.
#[derive(Clone)]
pub struct ZeroModel {
    bits: MixedBits<VIEWS, OPINIONS>,
}

impl Default for ZeroModel {
    fn default() -> Self {
        ZeroModel { bits: MixedBits::new([1 << SLOT_BITS; VIEWS], SETS, 0.25, 0.0, 0.002) }
    }
}

impl ZeroModel {
    /// Codes whether a level is 0. `prediction` is the predicted level if it is not.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        around: &Surroundings,
        (row, column): (usize, usize),
        prediction: f32,
        is_zero: bool,
    ) -> bool {
        let row = row.min(ROW_CONTEXTS - 1);
        let zeros = around.zeros;
        let [west, north, same, moved] =
            [around.west, around.north, around.same, around.moved].map(usize::from);
        let coarse = (prediction * 0.625) as usize;
        let contexts = [
            zeros,
            zeros & 0xff | row << 8,
            zeros & 0x1f | coarse << 5 | row << 12,
            zeros & 0xf | west << 4 | row << 12,
            zeros & 3 | same << 2 | (west / 8) << 10,
            zeros & 3 | west << 2 | north << 10,
            zeros & 0xf | row << 4 | (column / NARROW_SECTOR) << 11,
            zeros & 0x33 | (same / 2) << 6 | (moved / 2) << 13 | coarse / 2 << 20,
        ];
        let places = contexts.map(slot);
        let set = zeros & 0x3f | usize::from(around.has_reference()) << 6;
        self.bits.code(coder, set, &places, 0.0, is_zero)
    }
}

/// The slot of a context.
fn slot(context: usize) -> usize {
    ((context as u32).wrapping_mul(0x9e37_79b1) >> (32 - SLOT_BITS)) as usize
}
