//! The shifts between the azimuth ticks of the beams: all beams fire together, so their occupied ticks agree
//! best when their columns are aligned.

use std::cmp::Reverse;

use pulp::NullaryFnOnce;
use rayon::prelude::*;

use super::Hdl64;
use super::beams::{Beam, Point};
use crate::ground::lanes::dispatch;

/// For each beam, the whole number of ticks by which its columns are shifted relative to those of the beam
/// with the most points, estimated from one scan that contains both.
pub(crate) fn column_shifts(model: &Hdl64, beams: &[&Beam]) -> Vec<i64> {
    // The beams of a firing are within 36 degrees of each other.
    let widest = i64::from(model.ticks / 10);
    let filled =
        |row: usize| (0..beams[row].scans.len()).map(|scan| beams[row].points_in(scan)).sum::<usize>();
    let reference = (0..beams.len()).max_by_key(|&row| filled(row)).unwrap_or(0);
    let in_scan = |pieces: &Vec<&[Point]>| (!pieces.is_empty()).then(|| used_ticks(model, reference, pieces));
    let of_reference: Vec<Option<Vec<u64>>> =
        beams.get(reference).map_or_else(Vec::new, |beam| beam.scans.iter().map(in_scan).collect());
    let best = |row: usize| {
        let mut pairs = beams[row].scans.iter().zip(&of_reference);
        let shared = pairs.find_map(|(mine, theirs)| (!mine.is_empty()).then_some((mine, theirs.as_ref()?)));
        let Some((mine, theirs)) = shared else { return 0 };
        let mine = used_ticks(model, row, mine);
        let agreements = dispatch(Agreements { mine: &mine, theirs, ticks: model.ticks as usize, widest });
        let worth = |&(agreement, shift): &(u32, i64)| (Reverse(agreement), shift.abs(), shift);
        agreements.into_iter().zip(-widest..).min_by_key(worth).map_or(0, |(_, shift)| shift)
    };
    (0..beams.len()).into_par_iter().map(best).collect()
}

/// The arguments of the search in [`column_shifts`] for the number of ticks used by both of two beams, for
/// each shift of up to `widest` ticks either way. A struct, so that the function can be compiled for several
/// vector units.
struct Agreements<'a> {
    mine: &'a [u64],
    theirs: &'a [u64],
    ticks: usize,
    widest: i64,
}

impl NullaryFnOnce for Agreements<'_> {
    type Output = Vec<u32>;

    #[inline(always)]
    fn call(self) -> Vec<u32> {
        let Agreements { mine, theirs, ticks, widest } = self;
        // Longer than a turn: the ticks continue from the start.
        let mut round = vec![0u64; (2 * ticks).div_ceil(BITS) + 1];
        for tick in (0..ticks).filter(|tick| theirs[tick / BITS] >> (tick % BITS) & 1 == 1) {
            [tick, tick + ticks].into_iter().for_each(|tick| round[tick / BITS] |= 1 << (tick % BITS));
        }
        let mut agreements = Vec::with_capacity(2 * widest as usize + 1);
        for shift in -widest..=widest {
            let start = shift.rem_euclid(ticks as i64) as usize;
            let (bits, theirs) = (start % BITS, &round[start / BITS..]);
            let mut both = 0;
            for ((mine, low), high) in mine.iter().zip(theirs).zip(&theirs[1..]) {
                // Shifted twice, since a shift by the full word length is not allowed.
                both += (mine & (low >> bits | high << 1 << (BITS - 1 - bits))).count_ones();
            }
            agreements.push(both);
        }
        agreements
    }
}

/// Ticks per word.
const BITS: usize = u64::BITS as usize;

/// A bit for each tick: 1 if the beam has a point there.
fn used_ticks(model: &Hdl64, row: usize, pieces: &[&[Point]]) -> Vec<u64> {
    let mut used = vec![0; (model.ticks as usize).div_ceil(BITS)];
    for point in pieces.iter().copied().flatten() {
        let tick = model.nearest_tick(row, point.azimuth, point.rho) as usize;
        used[tick / BITS] |= 1 << (tick % BITS);
    }
    used
}
