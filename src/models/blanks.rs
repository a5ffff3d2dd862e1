//! The positions of blanks, the records without a measured point: the formula's position at a range of 0
//! (whose zeros have the signs of the direction), the same as for the last blank that had another (zeros, NaN, the
//! position of the scanner), or anything else. FORMAT.md 8.19.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::scanner::Coordinates;

/// The kinds of positions of blanks.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Formula,
    Before,
    Other,
}

const KINDS: usize = 3;

/// The adaptive models of blanks.
#[derive(Clone, Default)]
pub struct BlankModel {
    /// Whether a blank is of the same kind as the one before, in the context of that kind.
    same_kind: [AdaptiveBit; KINDS],
    /// Which of the two other kinds it is.
    later_kind: [AdaptiveBit; KINDS],
    /// Differences from the last blank without the formula's position, in float32 units.
    differences: [IntegerModel; 3],
}

impl BlankModel {
    /// Codes the positions of a frame's blanks, in the order of the file. `formula` gives the positions by
    /// the scanner's formula at a range of 0.
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
            // The encoder changes to another kind only if the current one cannot express the position, or
            // would express it as a difference although another can exactly.
            let stays = C::ENCODES && is(kind) && (kind != Kind::Other || !is(first) && !is(second));
            if !self.same_kind[context].code(coder, stays) {
                let is_later = self.later_kind[context].code(coder, C::ENCODES && !is(first));
                kind = if is_later { second } else { first };
            }
            match kind {
                Kind::Formula => {
                    *position = formula;
                    continue;
                }
                Kind::Before => *position = before,
                Kind::Other => {
                    for axis in 0..3 {
                        let last = Coordinates::unit_of_float(before[axis]);
                        let difference = Coordinates::unit_of_float(position[axis]) - last;
                        let difference = self.differences[axis].code_signed(coder, difference);
                        position[axis] = Coordinates::Float32.value(last.wrapping_add(difference), 0.0);
                    }
                }
            }
            before = *position;
        }
    }
}
