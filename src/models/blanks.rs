//! The positions of blanks, the records without a measured point: the formula's position at a range of 0
//! (whose zeros have the signs of the direction), one of two positions that earlier blanks had (such as zeros
//! and NaN, in turn), or anything else. FORMAT.md 8.19.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::scanner::CoordinateGrid;

/// Number of positions that are remembered.
const KEPT: usize = 2;

/// The position of a blank.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Formula,
    Kept(usize),
    Other,
}

/// All kinds, in the order of their numbers.
const KINDS: [Kind; 4] = [Kind::Formula, Kind::Kept(0), Kind::Kept(1), Kind::Other];

impl Kind {
    /// Its place in [`KINDS`].
    fn number(self) -> usize {
        match self {
            Kind::Formula => 0,
            Kind::Kept(slot) => 1 + slot,
            Kind::Other => 1 + KEPT,
        }
    }
}

/// The adaptive models of blanks.
#[derive(Clone, Default)]
pub struct BlankModel {
    /// Whether a blank is of the same kind as the one before, in the context of that kind.
    same_kind: [AdaptiveBit; KINDS.len()],
    /// Whether it is of the first of the other kinds; if not, whether it is of the second.
    other_kind: [[AdaptiveBit; 2]; KINDS.len()],
    /// Differences from the last blank without the formula's position, in float32 units.
    differences: [IntegerModel; 3],
}

impl BlankModel {
    /// Codes the positions of a frame's blanks, in the order of the file. `formula` gives the position of each
    /// by the scanner's formula at a range of 0.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        formula: impl Fn(usize) -> [f32; 3],
        positions: &mut [[f32; 3]],
    ) {
        let same = |a: &[f32; 3], b: &[f32; 3]| a.map(f32::to_bits) == b.map(f32::to_bits);
        let mut kind = Kind::Formula;
        let mut kept = [[0.0; 3]; KEPT];
        // Which of these the last blank without the formula's position has.
        let mut last = 0;
        for (blank, position) in positions.iter_mut().enumerate() {
            if coder.is_exhausted() {
                return;
            }
            let is = |kind: Kind| match kind {
                Kind::Formula => same(position, &formula(blank)),
                Kind::Kept(slot) => same(position, &kept[slot]),
                Kind::Other => true,
            };
            let wanted = match kind {
                _ if !C::ENCODES => kind,
                Kind::Formula | Kind::Kept(_) if is(kind) => kind,
                _ => KINDS.into_iter().find(|kind| is(*kind)).unwrap_or(Kind::Other),
            };
            kind = self.code_kind(coder, kind, wanted);
            match kind {
                Kind::Formula => *position = formula(blank),
                Kind::Kept(slot) => {
                    *position = kept[slot];
                    last = slot;
                }
                Kind::Other => {
                    for axis in 0..3 {
                        let before = CoordinateGrid::unit_of_float(kept[last][axis]);
                        let difference = CoordinateGrid::unit_of_float(position[axis]) - before;
                        let difference = self.differences[axis].code_signed(coder, difference);
                        position[axis] = CoordinateGrid::Float32.value(before.wrapping_add(difference), 0.0);
                    }
                    last = (last + 1) % KEPT;
                    kept[last] = *position;
                }
            }
        }
    }

    /// Codes a blank's kind, given that of the blank before.
    fn code_kind<C: BitCoder>(&mut self, coder: &mut C, before: Kind, kind: Kind) -> Kind {
        let context = before.number();
        if self.same_kind[context].code(coder, kind == before) {
            return before;
        }
        let mut others = KINDS.into_iter().filter(|other| *other != before);
        for (is_next, other) in self.other_kind[context].iter_mut().zip(&mut others) {
            if is_next.code(coder, kind == other) {
                return other;
            }
        }
        others.next().unwrap_or(Kind::Other)
    }
}
