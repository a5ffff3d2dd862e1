//! The positions of blanks, the records without a return: what the formula makes of a range of 0 (which has the signs of
//! the direction), the same as the blank before (zeros, NaN, the place of the scanner), or anything else.
//! FORMAT.md 8.19.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::varint::{unzigzag, zigzag};
use crate::scanner::Coordinates;

/// What the position of a blank is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Formula,
    Before,
    Other,
}

const KINDS: usize = 3;

/// What the coder has learned about blanks.
#[derive(Clone, Default)]
pub struct BlankModel {
    /// Whether a blank is of the same kind as the one before, by that.
    same_kind: [AdaptiveBit; KINDS],
    /// Which of the two other kinds it is.
    later_kind: [AdaptiveBit; KINDS],
    /// Differences from the blank before, in units of float32.
    differences: [IntegerModel; 3],
}

impl BlankModel {
    /// Codes the positions of a frame's blanks, in the order of the file. `formula` is what the scanner's formula gives
    /// for a range of 0.
    pub fn code<'p, C: BitCoder>(
        &mut self,
        coder: &mut C,
        blanks: impl Iterator<Item = ([f32; 3], &'p mut [f32; 3])>,
    ) {
        const ALL: [Kind; KINDS] = [Kind::Formula, Kind::Before, Kind::Other];
        let same = |a: &[f32; 3], b: &[f32; 3]| a.map(f32::to_bits) == b.map(f32::to_bits);
        let (mut kind, mut before) = (Kind::Formula, [0.0; 3]);
        for (formula, position) in blanks {
            if coder.is_exhausted() {
                return;
            }
            let is = |kind: Kind| match kind {
                Kind::Formula => same(position, &formula),
                Kind::Before => same(position, &before),
                Kind::Other => true,
            };
            let others = ALL.map(|other| (other, other != kind));
            let mut others = others.into_iter().filter(|(_, differs)| *differs).map(|(other, _)| other);
            let (Some(first), Some(second)) = (others.next(), others.next()) else { return };
            let context = kind as usize;
            // Another kind than the last is worth its bits only if it is no mere difference.
            let stays = C::ENCODES && is(kind) && (kind != Kind::Other || !is(first) && !is(second));
            if !self.same_kind[context].code(coder, stays) {
                let is_later = self.later_kind[context].code(coder, C::ENCODES && !is(first));
                kind = if is_later { second } else { first };
            }
            match kind {
                Kind::Formula => *position = formula,
                Kind::Before => *position = before,
                Kind::Other => {
                    for axis in 0..3 {
                        let last = Coordinates::unit_of_float(before[axis]);
                        let difference = Coordinates::unit_of_float(position[axis]) - last;
                        let coded = self.differences[axis].code(coder, zigzag(difference) & (u64::MAX >> 1));
                        position[axis] = Coordinates::Float32.value(last.wrapping_add(unzigzag(coded)), 0.0);
                    }
                }
            }
            before = *position;
        }
    }
}
