//! What the millimetre grid tells about the motion. Each step makes the motion accurate enough for the next:
//! first the rotation about z that brings points in front of the scanner, which hardly move, onto the grid;
//! then the same with more and more of the turn; then the whole motion at once; last, the evidence of float32
//! values that are rounded the wrong way.

use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};

use super::find::on_grid;
use super::motion::{Motion, Mover, part_of_turn};
use crate::scanner::thinned;

/// The unit of the grid, in metres.
const UNIT: f64 = 1e-3;

/// A point of the file; the value that was rounded to each float32 is known to half a unit in the last place.
#[derive(Clone, Copy)]
struct Sample {
    moved: [f64; 3],
    /// How far the rotation about z moves it, in metres per radian.
    lever: f64,
}

/// Completes a motion by its rotation about z. `None` if no rotation brings the points onto the grid.
pub fn with_yaw(motion: Motion, positions: &[[f64; 3]]) -> Option<Motion> {
    /// Number of points in the first search and in every later step, and the least number.
    const FIRST: usize = 120;
    const SAMPLE: usize = 1500;
    const FEWEST: usize = 60;
    /// In metres: with a smaller lever the rotation moves no point by a unit.
    const LEAST_REACH: f64 = 1e-3;
    /// Factor by which each step extends the part of the turn.
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

/// The rotation about z with which the y of points in front of the scanner are nearest to the grid.
fn search_yaw(motion: Motion, samples: &[Sample], reach: f64) -> Option<Motion> {
    /// In radians a turn: a car that skids.
    const LARGEST: f64 = 0.3;
    /// The most values that are tried.
    const MOST: f64 = 2000.0;
    /// A coherence of y that points on no grid do not reach by chance.
    const LEAST: f64 = 0.3;
    // One step moves the farthest point by a tenth of a unit.
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

/// The change of the rotation about z that brings x and y closer to the grid.
fn yaw_step(motion: &Motion, samples: &[Sample]) -> f64 {
    let mover = Mover::new(motion);
    let (mut square, mut right) = (f64::MIN_POSITIVE, 0.0);
    for sample in samples {
        let point @ [x, y, _] = mover.undone(sample.moved, part_of_turn(&sample.moved));
        let part = part_of_turn(&point);
        for (value, by) in [(x, part * y), (y, -part * x)] {
            // The nearer a value is to the middle between two units, the less it tells.
            let miss = (value / UNIT * TAU).sin() * UNIT / TAU;
            square += by * by;
            right -= by * miss;
        }
    }
    right / square
}

/// Improves all components of the motion, so that points on the grid are moved onto those of the file. `None`
/// if they do not come near them.
pub fn polished(mut motion: Motion, positions: &[[f64; 3]]) -> Option<Motion> {
    const SAMPLE: usize = 6000;
    /// In metres, for each round.
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

/// In metres: larger than the error of the formula for any point that it explains.
pub const NEAR: f64 = 2e-5;

/// Changes the motion until few points are rounded to another float32 than the file's, which makes it far
/// more accurate than least squares can. `points` are as measured, `positions` as in the file.
pub fn sharpened(mut motion: Motion, points: &[[f32; 3]], positions: &[[f32; 3]]) -> Motion {
    const ROUNDS: usize = 30;
    /// In metres: values that are farther than this from the border of their float32 will not cross it.
    const NEAR_BORDER: f64 = 2e-8;
    /// The same for later rounds, as a multiple of the largest error across a border.
    const NEAR_BORDER_OF_LARGEST: f64 = 100.0;
    /// How strongly the points that fit hold the motion in place, at most.
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

/// One point in this many is used to tell how the motion moves points.
const WHOLE_SAMPLE: usize = 8;

/// A measured point, and the limits of its moved coordinates before they were rounded to float32.
struct Rounded {
    point: [f64; 3],
    values: [[f64; 2]; 3],
}

impl Rounded {
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

/// The least and the greatest of the values that are rounded to this float32.
fn values_of(value: f32) -> [f64; 2] {
    let middle = |next: f32| (f64::from(value) + f64::from(next)) * 0.5;
    [middle(value.next_down()), middle(value.next_up())]
}

/// The normal equations of a change of the motion.
#[derive(Default)]
struct System {
    normal: SMatrix<f64, 6, 6>,
    right: SVector<f64, 6>,
}

impl System {
    /// Adds the condition that a point must be moved farther by `miss`, in metres.
    fn add(&mut self, point: &[f64; 3], miss: [f64; 3]) {
        self.add_axes(point, miss, |_| true);
    }

    /// The same for some of the axes.
    fn add_axes(&mut self, point: &[f64; 3], miss: [f64; 3], counts: impl Fn(usize) -> bool) {
        let [x, y, z] = *point;
        // A small rotation moves a point by its cross product with it.
        let slopes = [[0.0, z, -y, 1.0, 0.0, 0.0], [-z, 0.0, x, 0.0, 1.0, 0.0], [y, -x, 0.0, 0.0, 0.0, 1.0]];
        let part = part_of_turn(point);
        for axis in (0..3).filter(|&axis| counts(axis)) {
            let slope = SVector::from(slopes[axis]) * part;
            self.normal += slope * slope.transpose();
            self.right += slope * miss[axis];
        }
    }

    /// The solution; no change if there is none.
    fn step(&self) -> [f64; 6] {
        self.normal.cholesky().map_or([0.0; 6], |cholesky| cholesky.solve(&self.right).into())
    }
}
