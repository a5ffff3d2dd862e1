//! Estimates the motion of a scan, and moves its points back.

use std::f64::consts::TAU;

use super::motion::{Mover, part_of_turn};
use super::{Motion, Turn, cones, grid};
use crate::scanner::{Coordinates, split_beams, thinned};

/// The points as they were measured, on the millimetre grid, and the motion that moved them to those of the
/// file; its list of misses is still empty. `None` if the points were not measured on that grid, or not moved
/// in this way.
pub fn undo(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, Turn)> {
    if !may_be_moved(positions) {
        return None;
    }
    let in_reach: Vec<[f32; 3]> =
        positions.iter().filter(|position| is_in_reach(position)).copied().collect();
    let beams = split_beams(&in_reach);
    let in_reach: Vec<[f64; 3]> = in_reach.into_iter().map(|position| position.map(f64::from)).collect();
    let mut motion = Motion::default();
    // Cones treat the motion as if there were no rotation about z, until that rotation is known.
    for _ in 0..2 {
        motion = grid::with_yaw(cones::improved(motion, &beams)?, &in_reach)?;
    }
    let motion = grid::polished(motion, &in_reach)?;
    let mover = Mover::new(&motion);
    let points: Vec<[f32; 3]> = positions.iter().map(|position| measured(&mover, position)).collect();
    let motion = grid::sharpened(motion, &points, positions);

    (motion.is_possible() && explains(&Mover::new(&motion), &points, positions))
        .then_some((points, Turn { motion, misses: Vec::new() }))
}

/// Whether the formula gives nearly all points of a sample exactly.
fn explains(mover: &Mover, points: &[[f32; 3]], positions: &[[f32; 3]]) -> bool {
    const SAMPLE: usize = 2000;
    /// A scan is left as it is if the formula misses more than one point in this many.
    const FEWEST_TO_A_MISS: usize = 20;
    let pairs: Vec<_> = points.iter().zip(positions).collect();
    let is_missed = |(point, position): &&(&[f32; 3], &[f32; 3])| {
        mover.moved(point.map(f64::from)).map(|metres| metres as f32) != **position
    };
    let sample: Vec<_> = thinned(&pairs, SAMPLE).collect();
    sample.iter().copied().filter(is_missed).count() * FEWEST_TO_A_MISS <= sample.len()
}

/// A quick test of a scan: moved points lie on no grid, except right in front of the scanner, where
/// compensation does not move them.
fn may_be_moved(positions: &[[f32; 3]]) -> bool {
    /// y / x of points that even the fastest car moves by less than a third of a millimetre.
    const IN_FRONT: f32 = 5e-4;
    /// Fewer points are no evidence.
    const FEWEST: u32 = 4;
    /// A coherence that points on no grid do not reach by chance.
    const LEAST: f64 = 0.4;
    if Coordinates::of(positions.iter().step_by(7).flatten()) != Coordinates::Float32 {
        return false;
    }
    let in_front = positions.iter().filter(|[x, y, _]| *x > 0.5 && y.abs() < IN_FRONT * x && x.is_finite());
    let (mut sum, mut count) = (0.0, 0u32);
    for [x, _, z] in in_front.filter(|[_, _, z]| z.is_finite()) {
        sum += [x, z].map(|v| (f64::from(*v) * 1000.0 * TAU).cos()).iter().sum::<f64>();
        count += 2;
    }
    count < 2 * FEWEST || sum > LEAST * f64::from(count)
}

fn is_in_reach(position: &[f32; 3]) -> bool {
    /// In metres; farther away than any scanner sees.
    const FARTHEST: f32 = 1000.0;
    // False for NaN, too.
    position.iter().all(|v| v.abs() < FARTHEST)
}

/// The measured millimetres of a point in metres.
pub(super) fn on_grid(point: [f64; 3]) -> [f32; 3] {
    let grid = Coordinates::Millimetre;
    point.map(|metres| grid.value(grid.unit_of(metres), metres))
}

/// The measured point from which a point of the file was made. Just behind the scanner it may have been moved
/// from the end of the turn past its beginning, or the other way round.
fn measured(mover: &Mover, position: &[f32; 3]) -> [f32; 3] {
    /// Points beyond this fraction of a turn, in either direction, are near that seam.
    const NEAR_SEAM: f64 = 0.45;
    if !is_in_reach(position) {
        return [0.0; 3];
    }
    let moved = position.map(f64::from);
    let part = part_of_turn(&moved);
    let point = on_grid(mover.undone(moved, part));
    if part.abs() < NEAR_SEAM {
        return point;
    }
    let other = on_grid(mover.undone(moved, part - part.signum()));
    let miss = |point: &[f32; 3]| {
        let formula = mover.moved(point.map(f64::from));
        (0..3).map(|axis| (formula[axis] - moved[axis]).abs()).fold(0.0, f64::max)
    };
    if miss(&other) < miss(&point) { other } else { point }
}
