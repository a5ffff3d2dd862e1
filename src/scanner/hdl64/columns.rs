//! The azimuth ticks that are columns: the gaps between them alternate in a slow beat of the firing rate
//! against the ticks. FORMAT.md 8.2.

use crate::entropy::{AdaptiveBit, BitCoder};

/// The distance from the last odd gap is counted up to this value.
const LONGEST_RUN: usize = 31;

/// The adaptive models of columns.
#[derive(Clone)]
pub struct Hdl64ColumnModel {
    used: Vec<AdaptiveBit>,
}

impl Default for Hdl64ColumnModel {
    fn default() -> Self {
        Hdl64ColumnModel { used: vec![AdaptiveBit::default(); 4 * (LONGEST_RUN + 1) * 4] }
    }
}

impl Hdl64ColumnModel {
    /// Codes a set of ticks below `ticks`, as ascending numbers.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, ticks: u32, columns: &mut Vec<u32>) {
        let known = std::mem::take(columns);
        let mut known = known.iter().peekable();
        let (mut gap, mut run, mut last_gap) = (0usize, 0, 0);
        for tick in 0..ticks {
            let used = known.next_if_eq(&&tick).is_some();
            let context = (gap.min(3) * (LONGEST_RUN + 1) + run) * 4 + last_gap.min(3);
            if self.used[context].code(coder, used) {
                columns.push(tick);
                // The short gap is the rare one; the probability of the next depends on the distance from the
                // last.
                run = if gap == 0 { 0 } else { (run + 1).min(LONGEST_RUN) };
                last_gap = gap;
                gap = 0;
            } else {
                gap += 1;
            }
        }
    }
}
