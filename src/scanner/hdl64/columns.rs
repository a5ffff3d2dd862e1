//! The shifts between the azimuth ticks of the beams: all beams fire together, so their occupied ticks agree
//! best when their columns are aligned.

use std::cmp::Reverse;

use pulp::NullaryFnOnce;
use rayon::prelude::*;

use super::beams::{Beam, Point};
use crate::ground::lanes::dispatch;
use crate::scanner::Hdl64;

/// For each beam, the whole number of ticks by which its columns are shifted against those of the beam with
/// the most points, judged from one scan that contains both.
pub(crate) fn column_shifts(model: &Hdl64, beams: &[&Beam]) -> Vec<i64> {
    /// The share of the turn that is used first, and the number of shifts that are then left.
    const SHARE: usize = 2;
    const LIKELY: usize = 100;
    // The beams of a firing look within 36 degrees of each other.
    let widest = i64::from(model.ticks / 10);
    let filled =
        |row: usize| (0..beams[row].scans.len()).map(|scan| beams[row].points_in(scan)).sum::<usize>();
    let reference = (0..beams.len()).max_by_key(|&row| filled(row)).unwrap_or(0);
    let in_scan = |pieces: &Vec<&[Point]>| (!pieces.is_empty()).then(|| used_ticks(model, reference, pieces));
    let of_reference: Vec<Option<Vec<u8>>> =
        beams.get(reference).map_or_else(Vec::new, |beam| beam.scans.iter().map(in_scan).collect());
    let best = |row: usize| {
        let mut pairs = beams[row].scans.iter().zip(&of_reference);
        let shared = pairs.find_map(|(mine, theirs)| (!mine.is_empty()).then_some((mine, theirs.as_ref()?)));
        let Some((mine, theirs)) = shared else { return 0 };
        let mine = used_ticks(model, row, mine);
        // The best of some shifts, judged by a part of the turn.
        let best = |shifts: &[i64], part: &[u8], count: usize| -> Vec<i64> {
            let agreements = dispatch(Agreements { mine: part, theirs, shifts });
            let mut found: Vec<_> = agreements.into_iter().zip(shifts.iter().copied()).collect();
            let worth = |&(agreement, shift): &(u32, i64)| (Reverse(agreement), shift.abs(), shift);
            if count < found.len() {
                found.select_nth_unstable_by_key(count, worth);
            }
            found.into_iter().take(count).map(|(_, shift)| shift).collect()
        };
        // A part of the turn tells which shifts deserve a closer look.
        let likely = best(&(-widest..=widest).collect::<Vec<_>>(), &mine[..mine.len() / SHARE], LIKELY);
        best(&likely, &mine, 1).first().copied().unwrap_or(0)
    };
    (0..beams.len()).into_par_iter().map(best).collect()
}

/// The arguments of [`column_shifts`]' search for the number of ticks that two beams both use, for each
/// shift; `mine` may cover a part of the turn. A struct, so that the function can be compiled for several
/// vector units.
struct Agreements<'a> {
    mine: &'a [u8],
    theirs: &'a [u8],
    shifts: &'a [i64],
}

impl NullaryFnOnce for Agreements<'_> {
    type Output = Vec<u32>;

    #[inline(always)]
    fn call(self) -> Vec<u32> {
        let Agreements { mine, theirs, shifts } = self;
        let mut agreements = vec![0; shifts.len()];
        for (found, shift) in agreements.iter_mut().zip(shifts) {
            let start = shift.rem_euclid(theirs.len() as i64) as usize;
            let (head, tail) = mine.split_at(mine.len().min(theirs.len() - start));
            *found = agreement(head, &theirs[start..]) + agreement(tail, &theirs[..start]);
        }
        agreements
    }
}

/// Number of ticks that both use.
#[inline(always)]
fn agreement(a: &[u8], b: &[u8]) -> u32 {
    /// Sums of bytes, in runs so short that none overflows, are what vector units do best.
    const RUN: usize = 128;
    let mut sum = 0;
    for (a, b) in a.chunks(RUN).zip(b.chunks(RUN)) {
        let mut run = 0u8;
        for (a, b) in a.iter().zip(b) {
            run += a & b;
        }
        sum += u32::from(run);
    }
    sum
}

/// 1 for each tick at which the beam has a point, else 0.
fn used_ticks(model: &Hdl64, row: usize, pieces: &[&[Point]]) -> Vec<u8> {
    let mut used = vec![0; model.ticks as usize];
    let points = pieces.iter().copied().flatten();
    points.for_each(|p| used[model.nearest_tick(row, p.azimuth, p.rho) as usize] = 1);
    used
}
