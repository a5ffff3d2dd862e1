//! How the beams' azimuth ticks are moved against each other: all beams fire together, so their
//! occupancies agree most where their columns are brought together.

use std::cmp::Reverse;

use rayon::prelude::*;

use super::SensorModel;
use super::beams::{Beam, Point};

/// The whole number of ticks by which each beam's columns are moved against those of the fullest
/// beam. One scan that both are in tells.
pub(super) fn column_shifts(model: &SensorModel, beams: &[&Beam]) -> Vec<i64> {
    /// The part of the turn that is looked at first, and how many shifts are then left.
    const SHARE: usize = 2;
    const LIKELY: usize = 100;
    // The beams of one firing look within 36 degrees of each other.
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
        // Of `count` ticks.
        let agreement_at = |shift: i64, count: usize| {
            let start = shift.rem_euclid(i64::from(model.ticks)) as usize;
            let (head, tail) = mine[..count].split_at(count.min(mine.len() - start));
            agreement(head, &theirs[start..]) + agreement(tail, &theirs[..start])
        };
        // A part of the turn tells which are worth a look.
        let mut rough: Vec<(u32, i64)> =
            (-widest..=widest).map(|shift| (agreement_at(shift, mine.len() / SHARE), shift)).collect();
        rough.sort_unstable_by_key(|&(agreement, shift)| (Reverse(agreement), shift.abs()));
        let likely = rough.iter().take(LIKELY).map(|(_, shift)| *shift);
        likely.max_by_key(|&shift| (agreement_at(shift, mine.len()), -shift.abs())).unwrap_or(0)
    };
    (0..beams.len()).into_par_iter().map(best).collect()
}

/// How many ticks both have in use.
fn agreement(a: &[u8], b: &[u8]) -> u32 {
    // Sums of bytes, in runs short enough not to overflow one, are what vector units do best.
    let run = |(a, b): (&[u8], &[u8])| u32::from(a.iter().zip(b).map(|(a, b)| a & b).sum::<u8>());
    a.chunks(255).zip(b.chunks(255)).map(run).sum()
}

/// 1 for each tick that holds a point of the beam, else 0.
fn used_ticks(model: &SensorModel, row: usize, pieces: &[&[Point]]) -> Vec<u8> {
    let mut used = vec![0; model.ticks as usize];
    let ticks = pieces.iter().copied().flatten().filter_map(|p| model.invert(row, p.position));
    ticks.for_each(|(tick, _)| used[tick as usize] = 1);
    used
}
