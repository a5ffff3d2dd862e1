//! The numbers of a mounting, from positions in the frame of the scanner and in the file: by least squares, and then
//! to the last bit.

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use super::{Mounting, TransformOrder};
use crate::ground::floats::{round_ties_even, square};
use crate::scanner::thinned;

/// A position in the frame of the scanner, not rounded, and in the file.
pub(super) type Pair = ([f64; 3], [f32; 3]);

/// Number of points that are used where every bit counts.
pub(super) const FEW: usize = 2000;

/// A float32 unit at a coordinate, in metres.
pub(super) fn unit_at(coordinate: f32) -> f64 {
    f64::from(coordinate.abs().next_up()) - f64::from(coordinate.abs())
}

/// How many coordinates a mounting does not reproduce, by the one of these orders of operations that
/// reproduces the most. Constant orders make loops without branches.
#[inline(always)]
pub(super) fn missed<const N: usize>(
    mounting: &Mounting,
    orders: &[TransformOrder; N],
    pairs: impl Iterator<Item = Pair>,
) -> u32 {
    /// Metres: smaller coordinates are more accurate than the mounting is known at first.
    const SMALL: f32 = 0.5;
    let mut missed = [0; N];
    for (point, position) in pairs {
        for axis in 0..3 {
            let row = &mounting.rows[axis];
            let counts = position[axis].abs() > SMALL;
            for (order, missed) in orders.iter().zip(&mut missed) {
                let differs = order.coordinate(row, &point) as f32 != position[axis];
                *missed += u32::from(differs & counts);
            }
        }
    }
    missed.into_iter().min().unwrap_or(0)
}

/// For each round of least squares, the least error, in metres, that is told from others, and how many times
/// the error of a coordinate counts.
pub(super) type Rounds = [(f64, f64)];
pub(super) const COARSE: [(f64, f64); 4] = [(1e-6, f64::INFINITY), (1e-6, 8.0), (2e-7, 4.0), (2e-7, 4.0)];
/// Small coordinates determine the last digits, if everything is computed in double precision.
const FINE: [(f64, f64); 6] =
    [(1e-7, 4.0), (1e-8, 4.0), (1e-9, 2.0), (1e-10, 1.0), (1e-11, 1.0), (1e-11, 1.0)];

/// The mounting, in double precision, that brings points nearest to their positions in the file.
pub(super) fn least_squares(pairs: &[Pair], start: &Mounting, rounds: &Rounds) -> Option<Mounting> {
    /// Metres: points farther off belong to other returns.
    const FARTHEST: f64 = 5e-3;
    let mut mounting = Mounting { order: TransformOrder::Double, ..*start };
    for &(least, most) in rounds {
        for axis in 0..3 {
            let row = mounting.rows[axis];
            let (mut system, mut right) = (SMatrix::<f64, 4, 4>::zeros(), SVector::<f64, 4>::zeros());
            for (point, position) in pairs {
                let [x, y, z] = *point;
                let unit = unit_at(position[axis]).max(least);
                let miss = f64::from(position[axis]) - (row[0] * x + row[1] * y + row[2] * z + row[3]);
                if miss.abs() < FARTHEST.min(most * unit) {
                    let slopes = SVector::from([x, y, z, 1.0]);
                    let weight = 1.0 / square(unit / least);
                    system += slopes * slopes.transpose() * weight;
                    right += slopes * (miss * weight);
                }
            }
            let change = system.cholesky()?.solve(&right);
            mounting.rows[axis] = std::array::from_fn(|place| row[place] + change[place]);
        }
    }
    Some(mounting)
}

/// The numbers of a scanner's mounting to the last bit, and the order of its operations: those that reproduce
/// the most coordinates; and how many of a sample they reproduce.
pub(super) fn last_bits(pairs: &[Pair], start: &Mounting) -> Option<(Mounting, usize)> {
    /// What was written may reproduce fewer coordinates, as some lasers' constants are not known to the last
    /// bit yet.
    const AS_GOOD: f64 = 0.99;
    let rounded = |(point, position): &Pair| (TransformOrder::Double.rounded_first(*point), *position);
    let rounded: Vec<Pair> = pairs.iter().map(rounded).collect();
    let squares = |pairs: &[Pair]| {
        let start = least_squares(pairs, start, &COARSE)?;
        Some((start, least_squares(pairs, &start, &FINE).unwrap_or(start)))
    };
    let (of_rounded, of_unrounded) = (squares(&rounded)?, squares(pairs)?);
    let few: Vec<Pair> = thinned(pairs, FEW).copied().collect();
    let found = TransformOrder::ALL.into_par_iter().map(|order| {
        let (start, fine) = if order.rounds_first() { of_rounded } else { of_unrounded };
        let starts = if order.is_single() { vec![start] } else { vec![fine, start] };
        let axes = [0, 1, 2].map(|axis| {
            let sharpened = starts.iter().map(|start| sharpened(order, start.rows[axis], &few, axis));
            // The first one wins ties.
            let best = sharpened.reduce(|best, next| if next.1 > best.1 { next } else { best });
            let (row, exact) = best.unwrap_or_default();
            let written = written(start.rows[axis]).into_iter().map(|row| order.in_its_precision(row));
            let written = written.map(|row| (row, exact_along(order, &row, &few, axis)));
            let written = written.reduce(|best, next| if next.1 > best.1 { next } else { best });
            written.filter(|(_, written)| *written as f64 > AS_GOOD * exact as f64).unwrap_or((row, exact))
        });
        let exact: usize = axes.iter().map(|(_, exact)| exact).sum();
        (Mounting { order, rows: axes.map(|(row, _)| row) }, exact)
    });
    let found: Vec<(Mounting, usize)> = found.collect();
    // The first one wins ties.
    found.into_iter().rev().max_by_key(|(_, exact)| *exact)
}

/// A row as its author may have written it, if it turns by whole quarters of a turn: with a translation of
/// tenths of millimetres or of micrometres, and for cosines of 0 also what programs compute as the cosine or
/// sine of such an angle.
fn written([a, b, c, t]: [f64; 4]) -> Vec<[f64; 4]> {
    /// How near a number must be to what was written.
    const NEAR: f64 = 2e-6;
    /// The cosine of pi / 2 and the sine of pi in double precision.
    const ZEROS: [f64; 5] = [
        0.0,
        6.123_233_995_736_766e-17,
        -6.123_233_995_736_766e-17,
        1.224_646_799_147_353_2e-16,
        -1.224_646_799_147_353_2e-16,
    ];
    let nearest = |value: f64, parts: f64| {
        let written = round_ties_even(value * parts) / parts;
        ((written - value).abs() < NEAR).then_some(written)
    };
    let [Some(a), Some(b), Some(c)] = [a, b, c].map(|value| nearest(value, 1.0)) else { return Vec::new() };
    let t = nearest(t, 1e4).or_else(|| nearest(t, 1e6)).unwrap_or(t);
    let values = |value: f64| if value == 0.0 { ZEROS.to_vec() } else { vec![value] };
    let mut rows = Vec::new();
    for a in values(a) {
        for b in values(b) {
            rows.extend(values(c).into_iter().map(|c| [a, b, c, t]));
        }
    }
    rows
}

/// How many coordinates a row reproduces along an axis to the last bit.
fn exact_along(order: TransformOrder, row: &[f64; 4], pairs: &[Pair], axis: usize) -> usize {
    let is_exact = |(point, position): &&Pair| order.coordinate(row, point) as f32 == position[axis];
    pairs.iter().filter(is_exact).count()
}

/// The row near another one that reproduces the most coordinates along an axis to the last bit, and how many.
fn sharpened(order: TransformOrder, row: [f64; 4], pairs: &[Pair], axis: usize) -> ([f64; 4], usize) {
    /// Units to either side in which each number is searched.
    const FARTHEST: i32 = 6;
    /// Units of numbers in double precision, and rounds for others, whose unit is that of float32.
    const FINE: [f64; 4] = [1e-8, 1e-9, 1e-10, 1e-11];
    const ROUNDS: usize = 4;
    let exact = |row: &[f64; 4]| exact_along(order, row, pairs, axis);
    let neighbour = |value: f64, steps: i32, unit: Option<f64>| match unit {
        Some(unit) => value + f64::from(steps) * unit,
        None => f64::from(f32::from_bits((value as f32).to_bits().wrapping_add_signed(steps))),
    };
    let units: Vec<Option<f64>> =
        if order.is_single() { vec![None; ROUNDS] } else { FINE.map(Some).to_vec() };
    let row = order.in_its_precision(row);
    let mut best = (row, exact(&row));
    for unit in units {
        let before = best.1;
        for place in 0..4 {
            let value = best.0[place];
            for steps in (1..=FARTHEST).flat_map(|steps| [steps, -steps]) {
                let mut row = best.0;
                row[place] = neighbour(value, steps, unit);
                let count = exact(&row);
                if count > best.1 {
                    best = (row, count);
                }
            }
        }
        if order.is_single() && best.1 == before {
            break;
        }
    }
    best
}
