//! How the beams' azimuth ticks are moved against each other: all beams fire together, so their
//! occupancies agree most where their columns are brought together.

use rayon::prelude::*;

use super::SensorModel;
use super::beams::{Beam, Point};

/// Scans that are enough for a beam.
const SCANS: usize = 2;

/// The whole number of ticks by which each beam's columns are moved against those of the fullest
/// beam.
pub(super) fn column_shifts(model: &SensorModel, beams: &[&Beam]) -> Vec<i64> {
    // The beams of one firing look within 36 degrees of each other.
    let widest = i64::from(model.ticks / 10);
    let used: Vec<Vec<Vec<u8>>> =
        beams.par_iter().enumerate().map(|(row, beam)| used_ticks(model, row, beam)).collect();
    let filled = |row: usize| used[row].iter().map(|scan| agreement(scan, scan)).sum::<u32>();
    let reference = (0..beams.len()).max_by_key(|&row| filled(row)).unwrap_or(0);
    let best = |row: usize| {
        let pairs = || used[row].iter().zip(&used[reference]);
        let pairs: Vec<_> = pairs().filter(|(a, b)| !a.is_empty() && !b.is_empty()).take(SCANS).collect();
        let agreement_at = |shift: i64| {
            let start = shift.rem_euclid(i64::from(model.ticks)) as usize;
            let overlap = |(mine, theirs): &(&Vec<u8>, &Vec<u8>)| {
                let (head, tail) = mine.split_at(mine.len() - start);
                agreement(head, &theirs[start..]) + agreement(tail, &theirs[..start])
            };
            pairs.iter().map(overlap).sum::<u32>()
        };
        (-widest..=widest).max_by_key(|&shift| (agreement_at(shift), -shift.abs())).unwrap_or(0)
    };
    (0..beams.len()).into_par_iter().map(best).collect()
}

/// How many ticks both have in use.
fn agreement(a: &[u8], b: &[u8]) -> u32 {
    // Sums of bytes, in runs short enough not to overflow one, are what vector units do best.
    let run = |(a, b): (&[u8], &[u8])| u32::from(a.iter().zip(b).map(|(a, b)| a & b).sum::<u8>());
    a.chunks(255).zip(b.chunks(255)).map(run).sum()
}

/// For each scan: 1 for each tick that holds a point of the beam, else 0; nothing if it has none.
fn used_ticks(model: &SensorModel, row: usize, beam: &Beam) -> Vec<Vec<u8>> {
    let used = |points: &Vec<Point>| {
        let mut used = vec![0; if points.is_empty() { 0 } else { model.ticks as usize }];
        let ticks = points.iter().filter_map(|p| model.invert(row, p.position));
        ticks.for_each(|(tick, _)| used[tick as usize] = 1);
        used
    };
    beam.scans.iter().map(used).collect()
}
