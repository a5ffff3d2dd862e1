//! Which region each piece belongs to.

use super::pieces::Pieces;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::error::{Error, Result};
use crate::grid::Grid;

/// Regions used last that have short names.
const RECENT: usize = 4;
/// Kinds of surroundings.
const CONTEXTS: usize = 8;

/// What the coder has learned about the regions of pieces.
#[derive(Default)]
pub struct ValueModel {
    is_left: [AdaptiveBit; CONTEXTS],
    is_above: [AdaptiveBit; CONTEXTS],
    is_above_right: [AdaptiveBit; CONTEXTS],
    is_new: [AdaptiveBit; CONTEXTS],
    is_recent: [AdaptiveBit; RECENT],
    back: IntegerModel,
}

/// The regions of returns around one; 0 = none.
struct Around {
    left: u32,
    above: u32,
    above_right: u32,
}

impl Around {
    /// What is known before a piece's region is: how its neighbours' compare.
    fn context(&self) -> usize {
        usize::from(self.left == self.above)
            | usize::from(self.above == self.above_right) << 1
            | usize::from(self.left == self.above_right) << 2
    }
}

impl ValueModel {
    /// Codes the region of each piece where it first holds a return. Regions are numbered from 1 on as
    /// they appear. Returns how many there are.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        pieces: &Pieces,
        labels: &mut Grid<u32>,
    ) -> Result<u32> {
        let mut region_of = vec![0u32; pieces.cells()];
        let mut above = vec![0u32; occupancy.columns() + 1];
        let mut recent = [0u32; RECENT];
        let mut regions = 0;
        for row in 0..occupancy.rows() {
            let mut left = 0;
            for column in 0..occupancy.columns() {
                let cell = (row, column);
                if !occupancy[cell] {
                    labels[cell] = 0;
                    continue;
                }
                let region = &mut region_of[pieces.of(cell)];
                if *region == 0 {
                    let around = Around { left, above: above[column], above_right: above[column + 1] };
                    *region = self.code_region(coder, &around, &recent, regions, labels[cell])?;
                    regions = regions.max(*region);
                    keep_recent(&mut recent, *region);
                }
                (labels[cell], left, above[column]) = (*region, *region, *region);
            }
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
        let context = around.context();
        let Around { left, above, above_right } = *around;
        if left > 0 && self.is_left[context].code(coder, region == left) {
            return Ok(left);
        }
        if above > 0 && above != left && self.is_above[context].code(coder, region == above) {
            return Ok(above);
        }
        let other = above_right > 0 && above_right != above && above_right != left;
        if other && self.is_above_right[context].code(coder, region == above_right) {
            return Ok(above_right);
        }
        if self.is_new[context].code(coder, region > regions) {
            return Ok(regions + 1);
        }
        for (model, &candidate) in self.is_recent.iter_mut().zip(recent) {
            let excluded = [0, left, above].contains(&candidate) || (other && candidate == above_right);
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

/// Puts a region in front of those used last.
fn keep_recent(recent: &mut [u32; RECENT], region: u32) {
    let place = recent.iter().position(|other| *other == region).unwrap_or(RECENT - 1);
    recent[..=place].rotate_right(1);
    recent[0] = region;
}
