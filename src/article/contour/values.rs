//! The region of each piece. FORMAT.md 8.11, "Values".

use super::returns::Returns;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};

/// Number of recently used regions that have short codes.
const RECENT: usize = 4;
/// Classes of surroundings.
const CONTEXTS: usize = 1 << 5;

/// The adaptive models of the regions of pieces.
#[derive(Clone, Default)]
pub struct ValueModel {
    is_left: [AdaptiveBit; CONTEXTS],
    is_above: [AdaptiveBit; CONTEXTS],
    is_above_right: [AdaptiveBit; CONTEXTS],
    is_new: [AdaptiveBit; CONTEXTS],
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
    pub fn code<C: BitCoder>(
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
