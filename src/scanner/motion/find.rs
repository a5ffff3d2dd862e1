//! Estimates the motion of a scan and moves its points back.

use std::f64::consts::TAU;

use super::cones::Cones;
use super::grid::Yaw;
use super::many::{self, Seen, is_in_reach};
use super::turn::Mover;
use super::{Motion, Turn, grid};
use crate::scanner::hdl64::{BeamPoint, split_beams};
use crate::scanner::{CoordinateGrid, thinned};

/// The points as they were measured, on the millimetre grid, and the motion that moved them to those of the
/// file, with a list of misses that is still empty. `None` if the points were not measured on that grid, or
/// not moved in this way.
pub fn undo(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, Turn)> {
    if !may_be_moved(positions) {
        return None;
    }
    let in_reach: Vec<[f32; 3]> =
        positions.iter().filter(|position| is_in_reach(position)).copied().collect();
    let beams = split_beams(&in_reach);
    let seen = |point: &BeamPoint| {
        let turn = point.azimuth / TAU;
        Seen { position: point.position, part: if turn > 0.5 { turn - 1.0 } else { turn } }
    };
    let all: Vec<Seen> = beams.iter().flatten().map(seen).collect();
    let (mut cones, mut yaw) = (Cones::new(&beams, seen)?, Yaw::new(&all)?);
    let mut motion = Motion::default();
    // Cones are fitted as if there were no rotation about z, until that rotation is known.
    for _ in 0..2 {
        motion = yaw.with_yaw(cones.improved(motion, many::undone)?)?;
    }
    let motion = grid::polished(motion, &all)?;
    let points = many::measured(&Mover::new(&motion), positions);
    let motion = grid::sharpened(motion, &points, positions);

    (motion.is_possible() && reproduces_most(&Mover::new(&motion), &points, positions))
        .then_some((points, Turn { motion, misses: Vec::new() }))
}

/// Whether the formula reproduces nearly all points of a sample to the last bit.
fn reproduces_most(mover: &Mover, points: &[[f32; 3]], positions: &[[f32; 3]]) -> bool {
    const SAMPLE: usize = 2000;
    /// Of this many points, the formula may miss one; otherwise the scan is not changed.
    const FEWEST_TO_A_MISS: usize = 20;
    let pairs: Vec<_> = points.iter().zip(positions).collect();
    let is_missed = |(point, position): &&(&[f32; 3], &[f32; 3])| {
        mover.moved(point.map(f64::from)).map(|metres| metres as f32) != **position
    };
    let sample: Vec<_> = thinned(&pairs, SAMPLE).collect();
    sample.iter().copied().filter(is_missed).count() * FEWEST_TO_A_MISS <= sample.len()
}

/// A quick test of a scan: moved points are on no grid, except straight in front of the scanner, where
/// compensation does not move them.
fn may_be_moved(positions: &[[f32; 3]]) -> bool {
    /// |y / x| of points that even the fastest car moves by less than a third of a millimetre.
    const IN_FRONT: f32 = 5e-4;
    /// Minimum number of points for a conclusion.
    const FEWEST: u32 = 4;
    /// Minimum coherence, which points on no grid do not reach by chance.
    const LEAST: f64 = 0.4;
    /// Number of points that are tested for being on the grid.
    const SAMPLE: usize = 2000;
    if CoordinateGrid::of(thinned(positions, SAMPLE).flatten()) != CoordinateGrid::Float32 {
        return false;
    }
    let in_front = positions.iter().filter(|[x, y, _]| *x > 0.5 && y.abs() < IN_FRONT * x && x.is_finite());
    let (mut sum, mut count) = (0.0, 0u32);
    for [x, _, z] in in_front.filter(|[_, _, z]| z.is_finite()) {
        sum += [x, z].map(|v| libm::cos(f64::from(*v) * 1000.0 * TAU)).iter().sum::<f64>();
        count += 2;
    }
    count < 2 * FEWEST || sum > LEAST * f64::from(count)
}
