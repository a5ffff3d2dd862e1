//! Points one by one, for scans without a scanner model and for the strays of others. FORMAT.md 8.4.
//!
//! A point that is the same as an earlier one to the bit is coded as its repeat. All others are predicted from those
//! before and, if the points are in turns, from the nearest one of the preceding turn: first the larger horizontal
//! coordinate, then the other one along the expected direction, then the height at the resulting distance.

use std::collections::HashMap;

use super::least_squares::LeastSquares;
use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::varint::saturated;
use crate::scanner::Coordinates;

/// Number of candidate predictions for each coordinate; the one with the smallest recent errors is used.
const CANDIDATES: usize = 4;
/// Classes of the recent errors, in bits.
const ERROR_BITS: usize = 36;

/// The adaptive models of points.
#[derive(Clone)]
pub struct PointModel {
    repeats: RepeatModel,
    coordinates: [CoordinateModel; 3],
    /// Height as a function of distance within a turn: a beam's cone.
    cone: LeastSquares<4>,
}

impl Default for PointModel {
    fn default() -> Self {
        PointModel {
            repeats: RepeatModel::default(),
            coordinates: std::array::from_fn(|_| CoordinateModel::new()),
            cone: LeastSquares::new(0.98),
        }
    }
}

impl PointModel {
    /// Codes positions one after the other. Most of them are on `grid`; `None` means one that is
    /// found and coded first.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Option<Coordinates>,
        positions: &mut [[f32; 3]],
    ) {
        let grid = grid.unwrap_or_else(|| code_grid(coder, Coordinates::of_most(positions)));
        let mut turns = TurnTracker::default();
        let mut repeats = Repeats::default();
        for index in 0..positions.len() {
            if coder.is_exhausted() {
                return;
            }
            if self.repeats.code(coder, &mut repeats, positions, index) {
                let [x, y, _] = finite(positions[index]);
                turns.push(index, direction(x, y));
                continue;
            }
            let before = |distance: usize| index.checked_sub(distance).map(|i| finite(positions[i]));
            let west = before(1).unwrap_or_default();
            let west2 = before(2).unwrap_or(west);
            let expected: [f64; 2] = std::array::from_fn(|axis| 2.0 * west[axis] - west2[axis]);
            let above = turns.nearest_above(direction(expected[0], expected[1]));
            let north = above.map_or(west, |i| finite(positions[i]));
            let north_west = above.map_or(west2, |i| finite(positions[i.saturating_sub(1)]));
            let near = [west, west2, north, north_west];
            positions[index] = self.code_point(coder, grid, &near, positions[index]);
            let [x, y, _] = finite(positions[index]);
            turns.push(index, direction(x, y));
        }
    }

    fn code_point<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Coordinates,
        near: &[[f64; 3]; 4],
        mut position: [f32; 3],
    ) -> [f32; 3] {
        let [west, west2, north, north_west] = near;
        let (major, minor) = if west[0].abs() >= west[1].abs() { (0, 1) } else { (1, 0) };

        let [w, ww, n, nw] = near.map(|p| p[major]);
        position[major] =
            self.coordinates[0].code(coder, grid, [w, 2.0 * w - ww, w + n - nw, n], position[major]);

        let along = finite(position)[major];
        let slope = |p: &[f64; 3]| if p[major] == 0.0 { 0.0 } else { p[minor] / p[major] };
        let [w, ww, n, nw] = near.map(|p| slope(&p));
        let slopes = [w, 2.0 * w - ww, w + n - nw, n];
        position[minor] = self.coordinates[1].code(coder, grid, slopes.map(|s| along * s), position[minor]);

        let distance = |p: &[f64; 3]| (p[0] * p[0] + p[1] * p[1]).sqrt();
        let own = distance(&finite(position));
        let at_distance = |p: &[f64; 3]| if distance(p) == 0.0 { p[2] } else { p[2] * own / distance(p) };
        let farther = (own - distance(west)).clamp(-CONE_REACH, CONE_REACH) as f32;
        let heights = [
            west[2] + f64::from(self.cone.predict(&[farther, 0.0, 0.0, 0.0])),
            at_distance(west),
            at_distance(north) + at_distance(west) - at_distance(north_west),
            2.0 * west[2] - west2[2],
        ];
        position[2] = self.coordinates[2].code(coder, grid, heights, position[2]);
        let rise = (finite(position)[2] - west[2]).clamp(-CONE_REACH, CONE_REACH) as f32;
        self.cone.learn(&[farther, 0.0, 0.0, 0.0], rise, 1.0);
        position
    }
}

/// How a point is the same as an earlier one.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Repeat {
    /// It is not, or is coded as if it were not.
    #[default]
    No,
    /// The point at the last distance: in a run of second returns that are the same as the first ones.
    Next,
    /// The position that the last `At` repeated, at first (0, 0, 0): that of points without a return.
    Held,
    /// The point so many points before.
    At(usize),
}

impl Repeat {
    /// Its number as a context.
    fn kind(self) -> usize {
        match self {
            Repeat::No => 0,
            Repeat::Next => 1,
            Repeat::Held => 2,
            Repeat::At(_) => 3,
        }
    }
}

/// Number of kinds of repeats.
const REPEAT_KINDS: usize = 4;

/// The adaptive models of repeats, by the kind of the point before.
#[derive(Clone, Default)]
struct RepeatModel {
    /// Also by whether the next point of a run is itself a repeat, which usually ends the run.
    is_repeat: [[AdaptiveBit; 2]; REPEAT_KINDS],
    is_at: [AdaptiveBit; REPEAT_KINDS],
    is_held: [AdaptiveBit; REPEAT_KINDS],
    distances: IntegerModel,
}

/// The repeats of a frame so far.
#[derive(Default)]
struct Repeats {
    last: Repeat,
    /// The last distance; 0 if there was none.
    distance: usize,
    held: [f32; 3],
    /// For each point, whether it is a repeat.
    are_repeats: Vec<bool>,
    /// Known to an encoder only: the last point with these bits.
    places: HashMap<[u32; 3], usize>,
}

impl Repeats {
    /// How a point is coded.
    fn find(&mut self, positions: &[[f32; 3]], index: usize) -> Repeat {
        /// A run that begins with a new distance has at least this many points; what fewer points have in common may
        /// be chance.
        const SHORTEST: usize = 4;
        let bits = |index: usize| positions.get(index).map(|position| position.map(f32::to_bits));
        let own = positions[index].map(f32::to_bits);
        let before = self.places.insert(own, index);
        let is_next = self.distance > 0 && index.checked_sub(self.distance).and_then(bits) == Some(own);
        let is_no_place = positions[index].iter().any(|value| !value.is_finite());
        let is_run = |before: usize| {
            (1..SHORTEST).all(|n| bits(index + n).is_some_and(|own| Some(own) == bits(before + n)))
        };
        match before {
            _ if is_next => Repeat::Next,
            _ if own == self.held.map(f32::to_bits) => Repeat::Held,
            Some(before) if is_no_place || is_run(before) => Repeat::At(index - before),
            _ => Repeat::No,
        }
    }
}

impl RepeatModel {
    /// Codes whether a point is the same as an earlier one. If so, sets its position and returns true.
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        repeats: &mut Repeats,
        positions: &mut [[f32; 3]],
        index: usize,
    ) -> bool {
        let repeat = if C::ENCODES { repeats.find(positions, index) } else { Repeat::No };
        let kind = repeats.last.kind();
        // The distance is at most `index`, except in damaged streams.
        let source = |distance: usize| index.checked_sub(distance).filter(|_| distance > 0);
        let ends = source(repeats.distance).is_some_and(|source| repeats.are_repeats[source]);
        let is_repeat = self.is_repeat[kind][usize::from(ends)].code(coder, repeat != Repeat::No);
        repeats.are_repeats.push(is_repeat);
        if !is_repeat {
            repeats.last = Repeat::No;
            return false;
        }
        let position_of = |distance: usize| source(distance).map_or([0.0; 3], |source| positions[source]);
        let position = if self.is_at[kind].code(coder, matches!(repeat, Repeat::At(_))) {
            let distance = if let Repeat::At(distance) = repeat { distance } else { 0 };
            repeats.distance = saturated(self.distances.code(coder, distance as u64));
            repeats.last = Repeat::At(repeats.distance);
            repeats.held = position_of(repeats.distance);
            repeats.held
        } else if self.is_held[kind].code(coder, repeat == Repeat::Held) {
            repeats.last = Repeat::Held;
            repeats.held
        } else {
            repeats.last = Repeat::Next;
            position_of(repeats.distance)
        };
        positions[index] = position;
        true
    }
}

/// Codes a grid by its numbers; those of none stand for `Float32`.
fn code_grid<C: BitCoder>(coder: &mut C, grid: Coordinates) -> Coordinates {
    let (kind, step) = grid.to_numbers();
    let kind = coder.code_plain(kind.into(), 2) as u32;
    let step = if kind < 2 { 0 } else { coder.code_plain(step.into(), 30) as u32 };
    Coordinates::from_numbers(kind, step).unwrap_or(Coordinates::Float32)
}

/// In metres; a larger step carries no information about a beam's cone.
const CONE_REACH: f64 = 1000.0;

/// One coordinate against several predictions.
#[derive(Clone)]
struct CoordinateModel {
    /// The recent error of each candidate, in bits.
    errors: [f32; CANDIDATES],
    raw: AdaptiveBit,
    /// Residuals for each candidate and class of recent error.
    residual: Vec<IntegerModel>,
}

impl CoordinateModel {
    fn new() -> Self {
        CoordinateModel {
            errors: [16.0; CANDIDATES],
            raw: AdaptiveBit::default(),
            residual: vec![IntegerModel::default(); ERROR_BITS],
        }
    }

    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Coordinates,
        predictions: [f64; CANDIDATES],
        value: f32,
    ) -> f32 {
        let best = (0..CANDIDATES).min_by(|&a, &b| self.errors[a].total_cmp(&self.errors[b])).unwrap_or(0);
        let units = predictions.map(|p| grid.unit_of(p));
        let fits = |unit: &i64| grid.value(*unit, predictions[best]).to_bits() == value.to_bits();
        let unit = grid.unit_in_file(value).filter(fits);
        if self.raw.code(coder, unit.is_none()) {
            return f32::from_bits(coder.code_plain(u64::from(value.to_bits()), 32) as u32);
        }
        let level = (self.errors[best] as usize).min(ERROR_BITS - 1);
        let residual = unit.unwrap_or(0).wrapping_sub(units[best]);
        let unit = units[best].wrapping_add(self.residual[level].code_signed(coder, residual));
        for (error, predicted) in self.errors.iter_mut().zip(units) {
            let bits = u64::BITS - unit.wrapping_sub(predicted).unsigned_abs().leading_zeros();
            *error = 0.8 * *error + 0.2 * bits as f32;
        }
        grid.value(unit, predictions[best])
    }
}

/// A position to predict from; coordinates that are not finite count as 0.
fn finite(position: [f32; 3]) -> [f64; 3] {
    position.map(|v| if v.is_finite() { f64::from(v) } else { 0.0 })
}

/// A measure of the azimuth without trigonometry: 0 to 4, increasing with the angle.
fn direction(x: f64, y: f64) -> f64 {
    let sum = x.abs() + y.abs();
    let part = if sum == 0.0 { 0.0 } else { y / sum };
    match (x < 0.0, y < 0.0) {
        (false, false) => part,
        (true, _) => 2.0 - part,
        (false, true) => 4.0 + part,
    }
}

/// Follows points around the axis, turn by turn, and finds neighbours in the preceding turn.
#[derive(Clone, Default)]
pub struct TurnTracker {
    above: Vec<(usize, f64)>,
    current: Vec<(usize, f64)>,
    cursor: usize,
}

impl TurnTracker {
    /// The index of the point of the preceding turn that is nearest to a direction.
    fn nearest_above(&mut self, direction: f64) -> Option<usize> {
        let apart = |cursor: usize| self.above.get(cursor).map(|(_, d)| (d - direction).abs());
        let mut cursor = self.cursor;
        while apart(cursor + 1).is_some_and(|next| apart(cursor).is_some_and(|here| next <= here)) {
            cursor += 1;
        }
        self.cursor = cursor;
        self.above.get(cursor).map(|(index, _)| *index)
    }

    /// Adds a point; a jump over most of a turn starts a new turn.
    fn push(&mut self, index: usize, direction: f64) {
        if self.current.last().is_some_and(|(_, last)| (direction - last).abs() > 3.0) {
            self.above = std::mem::take(&mut self.current);
            self.cursor = 0;
        }
        self.current.push((index, direction));
    }
}

/// For each position, the index of its neighbour in the preceding turn.
pub fn neighbours_above(positions: &[[f32; 3]]) -> Vec<Option<usize>> {
    let mut turns = TurnTracker::default();
    (0..positions.len())
        .map(|index| {
            let [x, y, _] = finite(positions[index]);
            let direction = direction(x, y);
            // Added first, so that the first point of a turn is compared with the turn just completed.
            turns.push(index, direction);
            turns.nearest_above(direction)
        })
        .collect()
}
