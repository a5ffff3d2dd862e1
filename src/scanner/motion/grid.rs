//! The motion as determined by the millimetre grid. Each stage makes it accurate enough for the next: first
//! the rotation about z that brings points in front of the scanner, which hardly move, onto the grid; then
//! the same for growing parts of the turn; then the whole motion at once; finally the correction of
//! coordinates that are rounded to the wrong float32 value.

use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};

use super::many::{self, Seen};
use super::turn::{Motion, Mover, part_of_turn};
use crate::ground::angle::rough_sine;
use crate::scanner::{nearest_millimetre, thinned};

/// The unit of the grid, in metres.
const UNIT: f64 = 1e-3;

/// Points from which the rotation about z is estimated. A point's lever is how far the rotation moves it, in
/// metres per radian.
pub struct Yaw {
    /// The points with the shortest levers, and the longest of these levers.
    first: Vec<Seen>,
    reach: f64,
    /// Samples with increasingly long levers.
    farther: Vec<Vec<Seen>>,
}

impl Yaw {
    /// `None` if there are too few points.
    pub fn new(points: &[Seen]) -> Option<Self> {
        /// Number of points in the first search and in each later one, and the minimum number.
        const FIRST: usize = 120;
        const SAMPLE: usize = 1500;
        const FEWEST: usize = 60;
        /// In metres: with a shorter lever the rotation moves no point by a unit.
        const LEAST_REACH: f64 = 1e-3;
        /// Factor by which each search extends the lever.
        const GROWTH: f64 = 4.0;
        if points.len() < FEWEST {
            return None;
        }
        let lever = |Seen { position: [x, y, _], part }: &Seen| part.abs() * (x * x + y * y).sqrt();
        let levers: Vec<f64> = points.iter().map(lever).collect();
        let farthest = levers.iter().copied().fold(0.0, f64::max);
        let mut sorted = levers.clone();
        let (_, &mut nearest, _) = sorted.select_nth_unstable_by(FIRST.min(levers.len()) - 1, f64::total_cmp);
        let within = |reach: f64, most: usize| -> Vec<Seen> {
            let count = levers.iter().filter(|lever| **lever <= reach).count();
            let near = levers.iter().zip(points).filter(|(lever, _)| **lever <= reach);
            near.step_by(count.div_ceil(most).max(1)).map(|(_, seen)| *seen).collect()
        };
        let reach = nearest.max(LEAST_REACH);
        let wider = |reach: &f64| (*reach < farthest).then_some(reach * GROWTH);
        let reaches = std::iter::successors(Some(reach), wider).skip(1);
        Some(Yaw {
            first: within(nearest, FIRST),
            reach,
            farther: reaches.map(|reach| within(reach, SAMPLE)).collect(),
        })
    }

    /// Adds the rotation about z to a motion. `None` if no rotation brings the points onto the grid.
    pub fn with_yaw(&mut self, motion: Motion) -> Option<Motion> {
        let mut motion = search_yaw(motion, &mut self.first, self.reach)?;
        for near in &mut self.farther {
            for _ in 0..2 {
                motion.rotation[2] += yaw_step(&motion, near);
            }
        }
        Some(motion)
    }
}

/// The rotation about z for which the y of points in front of the scanner are nearest to the grid.
fn search_yaw(motion: Motion, samples: &mut [Seen], reach: f64) -> Option<Motion> {
    /// In radians a turn: a skidding car.
    const LARGEST: f64 = 0.3;
    /// Largest number of values that are tried in each direction.
    const MOST: f64 = 2000.0;
    /// Number of steps around the best value that are tried again more exactly.
    const AROUND: i32 = 2;
    /// Minimum coherence of y, which points on no grid do not reach by chance.
    const LEAST: f64 = 0.3;
    // One step moves the farthest point by a tenth of a unit.
    let places = (LARGEST * reach / (0.1 * UNIT)).ceil().min(MOST) as i32;
    let step = LARGEST / f64::from(places.max(1));
    let with_yaw = |yaw: f64| Motion { rotation: [motion.rotation[0], motion.rotation[1], yaw], ..motion };
    // A rotation is undone in proportion to the part of the turn at which a point was seen, and that part
    // itself depends on the rotation. In this variable y changes linearly.
    let even = |yaw: f64| yaw / (1.0 + yaw / TAU);
    let points = many::undone(&Mover::new(&with_yaw(0.0)), samples);
    let slopes: Vec<f64> = points.iter().zip(&*samples).map(|([x, ..], seen)| -seen.part * x).collect();
    let roughly = |yaw: f64| {
        let even = even(yaw);
        let turns = points.iter().zip(&slopes).map(|([_, y, _], slope)| (y + slope * even) / UNIT);
        turns.map(|turns| rough_sine(turns + 0.25)).sum::<f64>()
    };
    let yaws = (-places..=places).map(|place| f64::from(place) * step);
    let (_, rough) = yaws.map(|yaw| (roughly(yaw), yaw)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let coherence = |yaw: f64| {
        let points = many::undone(&Mover::new(&with_yaw(yaw)), &mut samples.to_vec());
        points.iter().map(|[_, y, _]| libm::cos(y / UNIT * TAU)).sum::<f64>() / points.len() as f64
    };
    let near = (-AROUND..=AROUND).map(|place| rough + f64::from(place) * step);
    let (best, yaw) = near.map(|yaw| (coherence(yaw), yaw)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best > LEAST).then_some(with_yaw(yaw))
}

/// The change of the rotation about z that brings x and y closer to the grid.
fn yaw_step(motion: &Motion, samples: &mut [Seen]) -> f64 {
    let points = many::undone(&Mover::new(motion), samples);
    let (mut square, mut right) = (f64::MIN_POSITIVE, 0.0);
    for ([x, y, _], Seen { part, .. }) in points.into_iter().zip(&*samples) {
        for (value, by) in [(x, part * y), (y, -part * x)] {
            // Values near the midpoint between two units have less weight.
            let miss = rough_sine(value / UNIT) * UNIT / TAU;
            square += by * by;
            right -= by * miss;
        }
    }
    right / square
}

/// Improves all components of the motion, so that points on the grid are moved onto those of the file. `None`
/// if they do not come close.
pub fn polished(mut motion: Motion, points: &[Seen]) -> Option<Motion> {
    const SAMPLE: usize = 6000;
    /// Reach in metres, for each iteration.
    const REACH: [f64; 5] = [3e-4, 1e-4, NEAR, NEAR, NEAR];
    let mut sample: Vec<Seen> = thinned(points, SAMPLE).copied().collect();
    let mut taken = 0;
    for reach in REACH {
        let mover = Mover::new(&motion);
        let mut system = System::default();
        taken = 0;
        let points = many::undone(&mover, &mut sample);
        let points: Vec<[f64; 3]> = points
            .into_iter()
            .map(|point| point.map(|metres| f64::from(nearest_millimetre(metres))))
            .collect();
        for ((point, formula), seen) in
            points.iter().zip(many::moved(&mover, &points, |point| *point)).zip(&sample)
        {
            let miss: [f64; 3] = std::array::from_fn(|axis| seen.position[axis] - formula[axis]);
            if miss.iter().all(|m| m.abs() < reach) {
                system.add(point, seen.part, miss, |_| true);
                taken += 1;
            }
        }
        motion = motion.changed_by(&system.step());
    }
    (taken * 2 > sample.len()).then_some(motion)
}

/// In metres: larger than the error of the formula for any point that it explains.
pub const NEAR: f64 = 2e-5;

/// Changes the motion until few points are rounded to a float32 other than the file's, which makes it far
/// more accurate than least squares can. `points` are as measured, `positions` as in the file.
pub fn sharpened(motion: Motion, points: &[[f32; 3]], positions: &[[f32; 3]]) -> Motion {
    /// Every `SAMPLE`-th point is used first, and to determine how the motion moves points.
    const SAMPLE: usize = 8;
    /// In metres: values farther than this from the boundary of their float32 will not cross it.
    const NEAR_BORDER: f64 = 2e-8;
    /// The same after the sample has made the motion more accurate, times the number of points: with more
    /// points the motion is more accurate.
    const NEARER_BORDER: f64 = 2.5e-4;
    let some = |all: &[[f32; 3]]| all.iter().step_by(SAMPLE).copied().collect::<Vec<_>>();
    let (few, few_positions) = (some(points), some(positions));
    let mut mean = System::default();
    for number in many::near_border(&Mover::new(&motion), &few, &few_positions, [NEAR, f64::INFINITY]) {
        let point = few[number].map(f64::from);
        mean.add(&point, part_of_turn(&point), [0.0; 3], |_| true);
    }
    mean = System::default().and(&mean, 1.0 / few.len() as f64);
    let nearer = NEAR_BORDER.min(NEARER_BORDER / points.len() as f64);
    let stages = [(&few[..], &few_positions[..], NEAR_BORDER), (points, positions, nearer)];
    stages.into_iter().fold(motion, |motion, (points, positions, border)| {
        let near = many::near_border(&Mover::new(&motion), points, positions, [NEAR, border]);
        let rounded = |number: usize| Rounded::new(points[number].map(f64::from), &positions[number]);
        rounded_right(motion, near.into_iter().map(rounded).collect(), &mean)
    })
}

/// Changes the motion until few of these points are rounded to a float32 other than the file's. `mean` is the
/// system of an average point.
fn rounded_right(mut motion: Motion, mut points: Vec<Rounded>, mean: &System) -> Motion {
    const ROUNDS: usize = 30;
    /// Values will not cross the boundary of their float32 if they are farther from it than this multiple of
    /// the largest error across a boundary.
    const NEAR_BORDER: f64 = 100.0;
    /// How strongly the points that fit hold the motion in place.
    const INERTIA: f64 = 0.02;
    let mut best = (u32::MAX, motion);
    for _ in 0..ROUNDS {
        let formulas = many::moved(&Mover::new(&motion), &points, |rounded| rounded.point);
        let mut system = System::default();
        let (mut beyond, mut largest) = (0, 0.0);
        for (rounded, formula) in points.iter().zip(&formulas) {
            let miss = rounded.miss(formula);
            if miss != [0.0; 3] {
                system.add(&rounded.point, part_of_turn(&rounded.point), miss, |axis| miss[axis] != 0.0);
                beyond += 1;
                largest = miss.iter().fold(largest, |largest: f64, m| largest.max(m.abs()));
            }
        }
        if beyond < best.0 {
            best = (beyond, motion);
        }
        if beyond == 0 {
            break;
        }
        motion = motion.changed_by(&system.and(mean, INERTIA * f64::from(beyond)).step());
        let mut formulas = formulas.iter();
        points.retain(|rounded| {
            formulas.next().is_none_or(|formula| rounded.clearance(formula) < NEAR_BORDER * largest)
        });
    }
    best.1
}

/// A measured point, and the limits of its moved coordinates before they were rounded to float32.
struct Rounded {
    point: [f64; 3],
    values: [[f64; 2]; 3],
}

impl Rounded {
    fn new(point: [f64; 3], position: &[f32; 3]) -> Self {
        /// Relative difference between evaluations of the formula that are exact up to f64 rounding. Points
        /// are moved across a boundary by this margin.
        const ROUNDED: f64 = 4e-16;
        let rounded = point.iter().map(|metres| metres.abs()).sum::<f64>() * ROUNDED;
        let values = position.map(|value| {
            let [low, high] = values_of(value);
            let inside = rounded.min(0.25 * (high - low));
            [low + inside, high - inside]
        });
        Rounded { point, values }
    }

    /// How far the formula's coordinates are outside these limits, in metres.
    fn miss(&self, formula: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let [low, high] = self.values[axis];
            formula[axis].clamp(low, high) - formula[axis]
        })
    }

    /// The least distance inside the limits over the axes; negative outside.
    fn clearance(&self, formula: &[f64; 3]) -> f64 {
        let clear =
            |axis: usize| (formula[axis] - self.values[axis][0]).min(self.values[axis][1] - formula[axis]);
        clear(0).min(clear(1)).min(clear(2))
    }
}

/// The least and the greatest value that are rounded to this float32.
fn values_of(value: f32) -> [f64; 2] {
    let middle = |next: f32| (f64::from(value) + f64::from(next)) * 0.5;
    [middle(value.next_down()), middle(value.next_up())]
}

/// The normal equations of a change of the motion.
#[derive(Clone, Copy, Default)]
struct System {
    /// The lower triangle.
    normal: [[f64; 6]; 6],
    right: [f64; 6],
}

impl System {
    /// Adds the condition that a point at this part of the turn must be moved farther by `miss`, in metres,
    /// along the axes for which `counts` is true.
    #[inline(always)]
    fn add(&mut self, [x, y, z]: &[f64; 3], part: f64, miss: [f64; 3], counts: impl Fn(usize) -> bool) {
        let [x, y, z] = [x, y, z].map(|metres| metres * part);
        // A small rotation moves a point by its cross product with it; the other derivatives are 0.
        let slopes = [([1, 2, 3], [z, -y, part]), ([0, 2, 4], [-z, x, part]), ([0, 1, 5], [y, -x, part])];
        for (axis, (unknowns, slopes)) in slopes.into_iter().enumerate().filter(|(axis, _)| counts(*axis)) {
            for i in 0..3 {
                let row = unknowns[i];
                self.right[row] += slopes[i] * miss[axis];
                (0..=i).for_each(|j| self.normal[row][unknowns[j]] += slopes[i] * slopes[j]);
            }
        }
    }

    /// The sum with `times` times the normal matrix of another system, whose points hold the motion in place.
    fn and(mut self, other: &System, times: f64) -> Self {
        for (row, of_other) in self.normal.iter_mut().zip(&other.normal) {
            row.iter_mut().zip(of_other).for_each(|(sum, value)| *sum += value * times);
        }
        self
    }

    /// The solution; no change if there is none.
    fn step(&self) -> [f64; 6] {
        let normal =
            SMatrix::<f64, 6, 6>::from_fn(|row, column| self.normal[row.max(column)][row.min(column)]);
        normal.cholesky().map_or([0.0; 6], |cholesky| cholesky.solve(&SVector::from(self.right)).into())
    }
}
