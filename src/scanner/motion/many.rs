//! Many points at a time, on vector units: where they were measured, and where compensation moves them.

use std::f64::consts::TAU;

use pulp::NullaryFnOnce;

use super::turn::Mover;
use crate::ground::angle;
use crate::ground::lanes::{dispatch, lanes};
use crate::scanner::{AT_ONCE, nearest_millimetre};

/// A point of the file, in metres, and the part of the turn at which it was seen, as accurately as known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    pub position: [f64; 3],
    pub part: f64,
}

/// Where the points were measured, to within a few micrometres. Also updates their parts of the turn.
pub fn undone(mover: &Mover, seen: &mut [Seen]) -> Vec<[f64; 3]> {
    dispatch(Undone { mover, seen })
}

/// Where compensation moves points, up to f64 rounding.
pub fn moved<T>(mover: &Mover, items: &[T], point: impl Fn(&T) -> [f64; 3]) -> Vec<[f64; 3]> {
    dispatch(Moved { mover, items, point })
}

/// The measured points on the millimetre grid from which points of a file were computed; 0 for points beyond
/// the reach of any scanner. Just behind the scanner they may have been moved from the end of the turn past
/// its beginning, or vice versa.
pub fn measured(mover: &Mover, positions: &[[f32; 3]]) -> Vec<[f32; 3]> {
    dispatch(Measured { mover, positions })
}

/// The numbers of the points that are moved to within `reach` of their positions in the file, in metres along
/// an axis, and have a coordinate within `border` of a value that is rounded to another float32.
pub fn near_border(
    mover: &Mover,
    points: &[[f32; 3]],
    positions: &[[f32; 3]],
    [reach, border]: [f64; 2],
) -> Vec<usize> {
    dispatch(NearBorder { mover, points, positions, reach, border })
}

/// Whether a point is within the reach of scanners.
#[inline(always)]
pub fn is_in_reach(position: &[f32; 3]) -> bool {
    /// In metres; beyond the reach of any scanner.
    const FARTHEST: f32 = 1000.0;
    let [x, y, z] = position;
    // False for NaN too.
    (x.abs() < FARTHEST) & (y.abs() < FARTHEST) & (z.abs() < FARTHEST)
}

/// One array for each axis.
#[inline(always)]
fn by_axis<const N: usize>(points: impl Fn(usize) -> [f64; 3]) -> [[f64; N]; 3] {
    let points: [[f64; 3]; N] = lanes(points);
    [lanes(|i| points[i][0]), lanes(|i| points[i][1]), lanes(|i| points[i][2])]
}

struct Undone<'a> {
    mover: &'a Mover,
    seen: &'a mut [Seen],
}

impl NullaryFnOnce for Undone<'_> {
    type Output = Vec<[f64; 3]>;

    #[inline(always)]
    fn call(self) -> Vec<[f64; 3]> {
        let Undone { mover, seen } = self;
        let mut points = vec![[0.0; 3]; seen.len()];
        let (blocks, rest) = seen.as_chunks_mut::<AT_ONCE>();
        let (of_blocks, of_rest) = points.as_chunks_mut::<AT_ONCE>();
        for (seen, points) in blocks.iter_mut().zip(of_blocks) {
            undo_block(mover, seen, points);
        }
        for (seen, point) in rest.iter_mut().zip(of_rest) {
            undo_block(mover, std::array::from_mut(seen), std::array::from_mut(point));
        }
        points
    }
}

#[inline(always)]
fn undo_block<const N: usize>(mover: &Mover, seen: &mut [Seen; N], points: &mut [[f64; 3]; N]) {
    let (undone, parts): (_, [f64; N]) =
        mover.nearly_undone::<N>(&by_axis(|i| seen[i].position), lanes(|i| seen[i].part));
    for i in 0..N {
        points[i] = [undone[0][i], undone[1][i], undone[2][i]];
        seen[i].part = parts[i];
    }
}

struct Moved<'a, T, F> {
    mover: &'a Mover,
    items: &'a [T],
    point: F,
}

impl<T, F: Fn(&T) -> [f64; 3]> NullaryFnOnce for Moved<'_, T, F> {
    type Output = Vec<[f64; 3]>;

    #[inline(always)]
    fn call(self) -> Vec<[f64; 3]> {
        let Moved { mover, items, point } = self;
        let mut points = vec![[0.0; 3]; items.len()];
        let (blocks, rest) = items.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = points.as_chunks_mut::<AT_ONCE>();
        for (items, points) in blocks.iter().zip(of_blocks) {
            let [x, y, z] = mover.nearly_moved::<AT_ONCE>(&by_axis(|i| point(&items[i])));
            *points = lanes(|i| [x[i], y[i], z[i]]);
        }
        for (item, to) in rest.iter().zip(of_rest) {
            let [[x], [y], [z]] = mover.nearly_moved::<1>(&by_axis(|_| point(item)));
            *to = [x, y, z];
        }
        points
    }
}

struct NearBorder<'a> {
    mover: &'a Mover,
    points: &'a [[f32; 3]],
    positions: &'a [[f32; 3]],
    reach: f64,
    border: f64,
}

impl NullaryFnOnce for NearBorder<'_> {
    type Output = Vec<usize>;

    #[inline(always)]
    fn call(self) -> Vec<usize> {
        let NearBorder { mover, points, positions, reach, border } = self;
        let mut found = Vec::new();
        let (blocks, rest) = points.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = positions.as_chunks::<AT_ONCE>();
        for (number, (points, positions)) in blocks.iter().zip(of_blocks).enumerate() {
            let near = are_near_border(mover, points, positions, [reach, border]);
            for (lane, _) in near.iter().enumerate().filter(|(_, is_near)| **is_near) {
                found.push(number * AT_ONCE + lane);
            }
        }
        for (number, (point, position)) in rest.iter().zip(of_rest).enumerate() {
            if are_near_border(mover, &[*point], &[*position], [reach, border]) == [true] {
                found.push(blocks.len() * AT_ONCE + number);
            }
        }
        found
    }
}

#[inline(always)]
fn are_near_border<const N: usize>(
    mover: &Mover,
    points: &[[f32; 3]; N],
    positions: &[[f32; 3]; N],
    [reach, border]: [f64; 2],
) -> [bool; N] {
    let formula: [[f64; N]; 3] = mover.nearly_moved(&by_axis(|i| {
        let [x, y, z] = points[i];
        [f64::from(x), f64::from(y), f64::from(z)]
    }));
    let miss = |axis: usize, i: usize| (formula[axis][i] - f64::from(positions[i][axis])).abs();
    let misses: [[f64; N]; 3] = [lanes(|i| miss(0, i)), lanes(|i| miss(1, i)), lanes(|i| miss(2, i))];
    let clear = |axis: usize, i: usize| half_step(positions[i][axis]) - misses[axis][i];
    lanes(|i| {
        let farthest = misses[0][i].max(misses[1][i]).max(misses[2][i]);
        let least = clear(0, i).min(clear(1, i)).min(clear(2, i));
        // If only some are NaN, the maximum is not.
        let is_number = !(misses[0][i] + misses[1][i] + misses[2][i]).is_nan();
        is_number & (farthest <= reach) & (least < border)
    })
}

/// Half the distance from a float32 value to the next one away from zero.
#[inline(always)]
fn half_step(value: f32) -> f64 {
    const EXPONENT: u32 = 0x7f80_0000;
    f64::from(f32::from_bits(value.to_bits() & EXPONENT)) * (0.5 * f32::EPSILON as f64)
}

struct Measured<'a> {
    mover: &'a Mover,
    positions: &'a [[f32; 3]],
}

impl NullaryFnOnce for Measured<'_> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn call(self) -> Vec<[f32; 3]> {
        let Measured { mover, positions } = self;
        let mut points = vec![[0.0; 3]; positions.len()];
        let (blocks, rest) = positions.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = points.as_chunks_mut::<AT_ONCE>();
        for (positions, points) in blocks.iter().zip(of_blocks) {
            *points = measured_block(mover, positions);
        }
        for (position, point) in rest.iter().zip(of_rest) {
            [*point] = measured_block(mover, std::array::from_ref(position));
        }
        points
    }
}

#[inline(always)]
fn measured_block<const N: usize>(mover: &Mover, positions: &[[f32; 3]; N]) -> [[f32; 3]; N] {
    /// Points beyond this part of a turn, in either direction, are near the seam behind the scanner.
    const NEAR_SEAM: f64 = 0.45;
    let in_reach: [bool; N] = lanes(|i| is_in_reach(&positions[i]));
    let moved: [[f64; N]; 3] = by_axis(|i| {
        let [x, y, z] = positions[i];
        if in_reach[i] { [f64::from(x), f64::from(y), f64::from(z)] } else { [0.0; 3] }
    });
    let part: [f64; N] = lanes(|i| angle::atan2(moved[1][i], moved[0][i]) * (1.0 / TAU));
    let mut points = on_grid(&mover.nearly_undone(&moved, part).0);
    let near_seam: [bool; N] = lanes(|i| part[i].abs() >= NEAR_SEAM);
    if near_seam.contains(&true) {
        let others = on_grid(&mover.nearly_undone(&moved, lanes(|i| part[i] - part[i].signum())).0);
        let (own, other) = (misses(mover, &points, &moved), misses(mover, &others, &moved));
        for (points, others) in points.iter_mut().zip(&others) {
            *points = lanes(|i| if near_seam[i] && other[i] < own[i] { others[i] } else { points[i] });
        }
    }
    let [x, y, z] = points;
    lanes(|i| if in_reach[i] { [x[i], y[i], z[i]] } else { [0.0; 3] })
}

/// The largest distance along an axis, in metres, between measured points after compensation and their
/// positions in the file.
#[inline(always)]
fn misses<const N: usize>(mover: &Mover, points: &[[f32; N]; 3], moved: &[[f64; N]; 3]) -> [f64; N] {
    let [x, y, z] = points;
    let formula: [[f64; N]; 3] = mover.nearly_moved(&[
        lanes(|i| f64::from(x[i])),
        lanes(|i| f64::from(y[i])),
        lanes(|i| f64::from(z[i])),
    ]);
    let miss = |axis: usize, i: usize| (formula[axis][i] - moved[axis][i]).abs();
    lanes(|i| miss(0, i).max(miss(1, i)).max(miss(2, i)))
}

/// Points in metres, rounded to whole millimetres.
#[inline(always)]
fn on_grid<const N: usize>(points: &[[f64; N]; 3]) -> [[f32; N]; 3] {
    let [x, y, z] = points;
    [
        lanes(|i| nearest_millimetre(x[i])),
        lanes(|i| nearest_millimetre(y[i])),
        lanes(|i| nearest_millimetre(z[i])),
    ]
}
