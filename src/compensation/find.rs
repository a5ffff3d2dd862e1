//! Finds the motion of a scan, and moves its points back.

use std::f64::consts::TAU;

use super::motion::{Mover, part_of_turn};
use super::{Compensation, Miss, Motion, cones, grid};
use crate::sensor::{Coordinates, split_beams};

/// Scans of which the formula misses more points than one in so many are taken as they are.
const FEWEST_TO_A_MISS: usize = 20;

/// Points as they were measured, on the millimetre grid, and how they were moved to those of the file. None
/// if these were not measured so, or moved so.
pub fn undo(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, Compensation)> {
    if !may_be_moved(positions) {
        return None;
    }
    let finite: Vec<[f64; 3]> = positions.iter().filter_map(finite).collect();
    let beams = split_beams(positions);
    let mut motion = Motion::default();
    // Cones judge the motion as if there were no rotation about z, until that is known.
    for _ in 0..2 {
        motion = grid::with_yaw(cones::improved(motion, &beams)?, &finite)?;
    }
    let motion = grid::polished(motion, &finite)?;
    let mover = Mover::new(&motion);
    let points: Vec<[f32; 3]> = positions.iter().map(|position| measured(&mover, position)).collect();
    let motion = grid::sharpened(motion, &points, positions);

    let mut compensation = Compensation { motion, misses: Vec::new() };
    let mut moved = points.clone();
    compensation.apply(&mut moved);
    for ((number, file), formula) in (0u32..).zip(positions).zip(&moved) {
        let unit = Coordinates::unit_of_float;
        let units: [i64; 3] = std::array::from_fn(|axis| unit(file[axis]) - unit(formula[axis]));
        if units != [0; 3] {
            compensation.misses.push(Miss { point: number, units });
        }
    }
    (compensation.misses.len() * FEWEST_TO_A_MISS <= points.len()).then_some((points, compensation))
}

/// A quick look at a scan: points on no grid, but for those right in front of the scanner, which compensation
/// does not move.
fn may_be_moved(positions: &[[f32; 3]]) -> bool {
    /// y / x of points that even the fastest car moves by less than a third of a millimetre.
    const IN_FRONT: f32 = 5e-4;
    const FEWEST: usize = 4;
    /// Coherence that points on no grid do not have by chance.
    const LEAST: f64 = 0.4;
    if Coordinates::of(positions.iter().step_by(7).flatten()) != Coordinates::Float32 {
        return false;
    }
    let in_front = positions.iter().filter(|[x, y, _]| *x > 0.5 && y.abs() < IN_FRONT * x && x.is_finite());
    let (mut sum, mut count) = (0.0, 0);
    for [x, _, z] in in_front.filter(|[_, _, z]| z.is_finite()) {
        sum += [x, z].map(|v| (f64::from(*v) * 1000.0 * TAU).cos()).iter().sum::<f64>();
        count += 2;
    }
    count >= 2 * FEWEST && sum > LEAST * f64::from(count as u32)
}

fn finite(position: &[f32; 3]) -> Option<[f64; 3]> {
    /// Metres; farther than any scanner sees.
    const FARTHEST: f32 = 1e4;
    // False for NaN, too.
    position.iter().all(|v| v.abs() < FARTHEST).then(|| position.map(f64::from))
}

/// The millimetres that a point in metres was measured as.
pub(super) fn on_grid(point: [f64; 3]) -> [f32; 3] {
    let grid = Coordinates::Millimetre;
    point.map(|metres| grid.value(grid.unit_of(metres), metres))
}

/// What a point of the file was measured as. Just behind the scanner it may have been moved from the end of
/// the turn to beyond its beginning, or the other way.
fn measured(mover: &Mover, position: &[f32; 3]) -> [f32; 3] {
    /// Parts of a turn near that seam.
    const NEAR_SEAM: f64 = 0.45;
    let Some(moved) = finite(position) else { return [0.0; 3] };
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
