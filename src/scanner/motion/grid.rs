//! What the millimetre grid tells of the motion. Each step makes the motion sharp enough for the next: the
//! rotation about z that brings points in front of the scanner onto the grid, where little of the motion is
//! made; then with ever more of the turn; then all of the motion at once; last, what roundings to float32
//! gone the wrong way tell.

use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};

use super::find::on_grid;
use super::motion::{Motion, Mover, part_of_turn};
use crate::scanner::thinned;

/// Metres of a unit of the grid.
const UNIT: f64 = 1e-3;

/// A point as the file has it, with the float32 value it was rounded from known to half a unit in the last
/// place.
#[derive(Clone, Copy)]
struct Sample {
    moved: [f64; 3],
    /// How far the rotation about z moves it, in metres a radian.
    lever: f64,
}

/// Completes a motion by its rotation about z. None if nothing brings the points onto the grid.
pub fn with_yaw(motion: Motion, positions: &[[f64; 3]]) -> Option<Motion> {
    /// Points of the first search, of every later step, and the fewest.
    const FIRST: usize = 120;
    const SAMPLE: usize = 1500;
    const FEWEST: usize = 60;
    /// Metres; the rotation moves no point by a unit that has less of a lever.
    const LEAST_REACH: f64 = 1e-3;
    /// How much more of the turn each step looks at.
    const GROWTH: f64 = 4.0;
    let mut samples: Vec<Sample> = positions
        .iter()
        .map(|&moved| Sample { moved, lever: part_of_turn(&moved).abs() * moved[0].hypot(moved[1]) })
        .collect();
    samples.sort_by(|a, b| a.lever.total_cmp(&b.lever));
    let first = &samples[..FIRST.min(samples.len())];
    let mut reach = first.last()?.lever.max(LEAST_REACH);
    let mut motion = search_yaw(motion, first, reach).filter(|_| first.len() >= FEWEST)?;
    let farthest = samples.last()?.lever;
    while reach < farthest {
        reach *= GROWTH;
        let within = samples.partition_point(|sample| sample.lever <= reach);
        let near: Vec<Sample> = thinned(&samples[..within], SAMPLE).copied().collect();
        for _ in 0..2 {
            motion.rotation[2] += yaw_step(&motion, &near);
        }
    }
    Some(motion)
}

/// The rotation about z for which points in front of the scanner have the y most nearly on the grid.
fn search_yaw(motion: Motion, samples: &[Sample], reach: f64) -> Option<Motion> {
    /// Radians a turn: a car that drifts.
    const LARGEST: f64 = 0.3;
    /// Most places to look at.
    const MOST: f64 = 2000.0;
    /// Coherence of y that no points on no grid have by chance.
    const LEAST: f64 = 0.3;
    // A step moves the farthest point by a tenth of a unit.
    let places = (LARGEST * reach / (0.1 * UNIT)).ceil().min(MOST) as i32;
    let coherence = |place: i32| {
        let yaw = f64::from(place) / f64::from(places.max(1)) * LARGEST;
        let motion = Motion { rotation: [motion.rotation[0], motion.rotation[1], yaw], ..motion };
        let mover = Mover::new(&motion);
        let phase = |s: &Sample| mover.undone(s.moved, part_of_turn(&s.moved))[1] / UNIT * TAU;
        (samples.iter().map(|s| phase(s).cos()).sum::<f64>() / samples.len() as f64, motion)
    };
    let (best, motion) = (-places..=places).map(coherence).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best > LEAST).then_some(motion)
}

/// How much farther the rotation about z brings x and y onto the grid.
fn yaw_step(motion: &Motion, samples: &[Sample]) -> f64 {
    let mover = Mover::new(motion);
    let (mut square, mut right) = (f64::MIN_POSITIVE, 0.0);
    for sample in samples {
        let point @ [x, y, _] = mover.undone(sample.moved, part_of_turn(&sample.moved));
        let part = part_of_turn(&point);
        for (value, by) in [(x, part * y), (y, -part * x)] {
            // The nearer a value is to the middle between two units, the less it says.
            let miss = (value / UNIT * TAU).sin() * UNIT / TAU;
            square += by * by;
            right -= by * miss;
        }
    }
    right / square
}

/// Brings all values of the motion to where points rounded to the grid are moved onto those of the file. None if they
/// do not come that near.
pub fn polished(mut motion: Motion, positions: &[[f64; 3]]) -> Option<Motion> {
    const SAMPLE: usize = 6000;
    /// Metres, in each round.
    const REACH: [f64; 5] = [3e-4, 1e-4, NEAR, NEAR, NEAR];
    let sample: Vec<[f64; 3]> = thinned(positions, SAMPLE).copied().collect();
    let mut taken = 0;
    for reach in REACH {
        let mover = Mover::new(&motion);
        let mut system = System::default();
        taken = 0;
        for &moved in &sample {
            let point = on_grid(mover.undone(moved, part_of_turn(&moved))).map(f64::from);
            let formula = mover.moved(point);
            let miss: [f64; 3] = std::array::from_fn(|axis| moved[axis] - formula[axis]);
            if miss.iter().all(|m| m.abs() < reach) {
                system.add(&point, miss);
                taken += 1;
            }
        }
        motion = motion.changed_by(&system.step());
    }
    (taken * 2 > sample.len()).then_some(motion)
}

/// Metres: farther than the formula ever misses a point that it explains.
pub const NEAR: f64 = 2e-5;

/// Moves the motion until few points are rounded to another float32 than the file's, which makes it far
/// sharper than least squares can. `points` are as measured, `positions` as in the file.
pub fn sharpened(mut motion: Motion, points: &[[f32; 3]], positions: &[[f32; 3]]) -> Motion {
    const ROUNDS: usize = 30;
    /// What is no nearer to the border of its float32 value than this, in metres, will not cross it.
    const NEAR_BORDER: f64 = 2e-8;
    /// The same in later rounds, in parts of the largest step over a border.
    const NEAR_BORDER_OF_LARGEST: f64 = 100.0;
    /// How much the points that fit hold the motion in place, at most.
    const INERTIA: f64 = 0.02;
    let mover = Mover::new(&motion);
    let mut whole = System::default();
    let mut near_border = Vec::new();
    for (number, (point, position)) in points.iter().zip(positions).enumerate() {
        let point = point.map(f64::from);
        let formula = mover.moved(point);
        if !(0..3).all(|axis| (formula[axis] - f64::from(position[axis])).abs() <= NEAR) {
            continue;
        }
        if number % WHOLE_SAMPLE == 0 {
            whole.add(&point, [0.0; 3]);
        }
        let rounded = Rounded { point, values: position.map(values_of) };
        if rounded.clearance(&formula) < NEAR_BORDER {
            near_border.push(rounded);
        }
    }
    for _ in 0..ROUNDS {
        let mover = Mover::new(&motion);
        let mut system = System::default();
        let (mut beyond, mut largest) = (0, 0.0);
        for rounded in &near_border {
            let miss = rounded.miss(&mover.moved(rounded.point));
            if miss != [0.0; 3] {
                system.add_axes(&rounded.point, miss, |axis| miss[axis] != 0.0);
                beyond += 1;
                largest = miss.iter().fold(largest, |largest: f64, m| largest.max(m.abs()));
            }
        }
        if beyond == 0 {
            break;
        }
        let share = f64::from(beyond) / points.len() as f64;
        system.normal += whole.normal * (WHOLE_SAMPLE as f64 * INERTIA * share.min(1.0));
        motion = motion.changed_by(&system.step());
        near_border.retain(|rounded| {
            rounded.clearance(&mover.moved(rounded.point)) < NEAR_BORDER_OF_LARGEST * largest
        });
    }
    motion
}

/// One point in so many tells how the motion moves points.
const WHOLE_SAMPLE: usize = 8;

/// A point as measured, and what its moved coordinates were before they were rounded to float32.
struct Rounded {
    point: [f64; 3],
    values: [[f64; 2]; 3],
}

impl Rounded {
    /// How far the formula is outside, in metres.
    fn miss(&self, formula: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let [low, high] = self.values[axis];
            formula[axis].clamp(low, high) - formula[axis]
        })
    }

    /// How far inside it is along the axis where it is least so; below 0 outside.
    fn clearance(&self, formula: &[f64; 3]) -> f64 {
        let clear =
            |axis: usize| (formula[axis] - self.values[axis][0]).min(self.values[axis][1] - formula[axis]);
        clear(0).min(clear(1)).min(clear(2))
    }
}

/// The least and the greatest of the values that are rounded to this one.
fn values_of(value: f32) -> [f64; 2] {
    let middle = |next: f32| (f64::from(value) + f64::from(next)) * 0.5;
    [middle(value.next_down()), middle(value.next_up())]
}

/// The normal equations of a step of the motion.
#[derive(Default)]
struct System {
    normal: SMatrix<f64, 6, 6>,
    right: SVector<f64, 6>,
}

impl System {
    /// The point must be moved by so much farther, in metres.
    fn add(&mut self, point: &[f64; 3], miss: [f64; 3]) {
        self.add_axes(point, miss, |_| true);
    }

    /// The same for some axes.
    fn add_axes(&mut self, point: &[f64; 3], miss: [f64; 3], counts: impl Fn(usize) -> bool) {
        let [x, y, z] = *point;
        // Small rotations turn a point by their cross product with it.
        let slopes = [[0.0, z, -y, 1.0, 0.0, 0.0], [-z, 0.0, x, 0.0, 1.0, 0.0], [y, -x, 0.0, 0.0, 0.0, 1.0]];
        let part = part_of_turn(point);
        for axis in (0..3).filter(|&axis| counts(axis)) {
            let slope = SVector::from(slopes[axis]) * part;
            self.normal += slope * slope.transpose();
            self.right += slope * miss[axis];
        }
    }

    /// The solution; no step where there is none.
    fn step(&self) -> [f64; 6] {
        self.normal.cholesky().map_or([0.0; 6], |cholesky| cholesky.solve(&self.right).into())
    }
}
