//! Views of the surroundings of an intensity, each of which selects a context.
//! FORMAT.md 8.5, "Levels, if `coder` is 1".

use super::surroundings::Surroundings;
use crate::entropy::hash;
use crate::models::quantise::signed_level;

pub const VIEWS: usize = 10;
/// Rows from this number on share their contexts.
const ROW_CONTEXTS: usize = 128;
/// Columns of a sector, whose counters carry over from frame to frame.
const WIDE_SECTOR: usize = 64;
pub const NARROW_SECTOR: usize = 32;

/// The hash of each view's context.
pub fn hashes(around: &Surroundings, (row, column): (usize, usize), prediction: f32) -> [u32; VIEWS] {
    let row = row.min(ROW_CONTEXTS - 1) as u32;
    let Surroundings { west, west2, west3, north, same, moved, .. } = *around;
    let [w, w2, w3, n, same, moved] = [west, west2, west3, north, same, moved].map(u32::from);
    let (wide, narrow) = ((column / WIDE_SECTOR) as u32, (column / NARROW_SECTOR) as u32);
    let change = signed_level((prediction - around.base()) as i32) as u32;
    // In steps of 1.6 levels.
    let coarse = (prediction * 0.625) as u32;
    // Fields of eight bits, the beam in seven.
    let contexts = [
        w / 2 | (w2 / 2) << 8,
        w / 2 | (n / 2) << 8,
        moved | coarse << 8 | (same / 4) << 16,
        row | (w / 4) << 7 | (w2 / 4) << 15 | (w3 / 4) << 23,
        row | w << 7 | change << 15,
        w | w3 << 8,
        row / 32 | w << 2 | w2 << 10,
        row | (same / 2) << 7 | (moved / 2) << 15,
        row / 2 | (w / 2) << 6 | wide << 14,
        row | (w / 4) << 7 | narrow << 15,
    ];
    std::array::from_fn(|view| hash(view, contexts[view]))
}
