//! Undoing motion compensation through a world frame: each firing of a turning scanner was moved by its own
//! pose to coordinates of a map, which were rounded to float32, and from there back to the scanner at one
//! moment, rounded to float32 again (nuScenes). For a point p of a firing with the scanner's position T and
//! rotation w:
//!
//! ```text
//! g = f32(Q (R(w) p + T) + o)          the map's coordinates; on coarse axes float32 is a lattice
//! v = f32(Q^T (g - o))                 the point of the file
//! ```
//!
//! Q and o describe the position of the file's axes in the map. The pose is linear between [`Knot`]s in time;
//! the first firings have poses of their own. `undo` estimates all this from the points alone. Deviations
//! from the formula are listed as corrections: steps of the lattices first, then float32 units.
//! FORMAT.md 8.15, "Through a map".

mod axes;
mod path;
mod payload;
mod refine;
mod sweep;
mod undo;

pub use undo::{measured, undo};

use super::{corrected, unless_nan};
use crate::scanner::CoordinateGrid;

/// Records of a firing.
const SLOTS: usize = 32;
/// Microseconds from one firing to the next; after the last firing of most packets it is one more.
const FIRING_US: f64 = 46.0;
/// Firings of a packet.
const PACKET: usize = 12;
/// After every `PACKETS`-th packet the next firing is not late.
const PACKETS: usize = 25;
/// Metres and radians per unit of poses.
const POSITION_UNIT: f64 = 1.0 / (1u64 << 30) as f64;
const ROTATION_UNIT: f64 = 1.0 / (1u64 << 36) as f64;
/// Microseconds per unit of the knots' times.
const TIME_UNIT: f64 = 0.25;

/// A bound above the deviation of any point in steps of a lattice.
const MOST_LATTICE_STEPS: f64 = (1u64 << 40) as f64;

/// The pose of the scanner: position in metres along the file's axes, and rotation as axis times angle in
/// radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pose {
    /// Position in 2^-30 m.
    pub position: [i64; 3],
    /// Rotation in 2^-36 radians.
    pub rotation: [i64; 3],
}

/// The pose at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Knot {
    /// Time since the first firing, in quarters of a microsecond.
    pub time: u32,
    /// The pose.
    pub pose: Pose,
}

/// A record that the formula misses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Correction {
    /// Its number in the file.
    pub record: u32,
    /// The values added along the first two axes of the map, in steps of their lattices.
    pub steps: [i64; 2],
    /// The values added to the coordinates of the file, in float32 units.
    pub units: [i64; 3],
}

/// The parameters of the firing times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Times {
    /// The last firing of the first packet; it and those before have poses of their own.
    pub border: u32,
    /// The first packet after which the next firing is not late.
    pub short: u32,
}

impl Times {
    /// The firing times in microseconds: one more after each packet, except every 25th.
    fn of_firings(self, firings: usize) -> Vec<f64> {
        let (border, short) = (self.border as usize, self.short as usize);
        let is_late = |firing: usize| {
            let packet = firing.checked_sub(border).filter(|since| since % PACKET == 0).map(|s| s / PACKET);
            packet.is_some_and(|packet| packet < short || (packet - short) % PACKETS != 0)
        };
        let mut time = 0.0;
        (0..firings)
            .map(|firing| {
                let now = time;
                time += FIRING_US + f64::from(u8::from(is_late(firing)));
                now
            })
            .collect()
    }
}

/// How a scan was moved through a world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// Q: axis of the rotation to the map's axes; its length is the angle in radians.
    pub rotation: [f64; 3],
    /// o: the position of the scanner in the map, in metres.
    pub origin: [f64; 3],
    /// The binary exponent of the lattice's step in metres, along the first two axes of the map: at most 0.
    /// None if the lattice is too fine.
    pub lattices: [Option<i32>; 2],
    /// The firing times.
    pub times: Times,
    /// The poses of the firings up to the first border.
    pub first: Vec<Pose>,
    /// The poses of the other firings: at least two knots, in ascending order of time.
    pub knots: Vec<Knot>,
    /// The deviations from the formula, in ascending order of records.
    pub corrections: Vec<Correction>,
}

/// A rotation matrix by its rows. What streams rely on is computed in this order of operations, which a
/// library might change.
type Rows3 = [[f64; 3]; 3];

/// The rotation about an axis whose length is the angle in radians: Rodrigues' formula.
fn rotation(axis: [f64; 3]) -> Rows3 {
    let [x, y, z] = axis;
    let angle = (x * x + y * y + z * z).sqrt();
    let [x, y, z] = if angle > 0.0 { axis.map(|a| a / angle) } else { [0.0; 3] };
    let (sin, cos) = libm::sincos(angle);
    let rest = 1.0 - cos;
    [
        [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
        [y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
        [z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest],
    ]
}

fn transposed(matrix: &Rows3) -> Rows3 {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[column][row]))
}

#[inline]
fn times_vector(matrix: &Rows3, v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn times_matrix(a: &Rows3, b: &Rows3) -> Rows3 {
    let columns = transposed(b).map(|column| times_vector(a, column));
    transposed(&columns)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The position and the rotation of a pose, in metres and radians.
type Metric = [[f64; 3]; 2];

impl Pose {
    fn metric(&self) -> Metric {
        [self.position.map(|v| v as f64 * POSITION_UNIT), self.rotation.map(|v| v as f64 * ROTATION_UNIT)]
    }
}

/// The pose at a time between two knots. If a car moves straight while it rotates, the scanner, `lever` above
/// the ground, moves along a curve that sags from the straight line.
fn between(knots: [(f64, &Metric); 2], time: f64, lever: [f64; 3]) -> Metric {
    let [(start, a), (end, b)] = knots;
    let part = (time - start) / (end - start);
    let [mut place, turn]: Metric = std::array::from_fn(|half| {
        std::array::from_fn(|axis| a[half][axis] * (1.0 - part) + b[half][axis] * part)
    });
    let rate: [f64; 3] = std::array::from_fn(|axis| (b[1][axis] - a[1][axis]) / (end - start));
    let bend = cross(rate, cross(rate, lever));
    let sag = -0.5 * (time - start) * (end - time);
    place = std::array::from_fn(|axis| place[axis] + bend[axis] * sag);
    [place, turn]
}

/// The motion from the scanner to the map: g = f32(turn p + shift).
struct ToMap {
    turn: Rows3,
    shift: [f64; 3],
}

impl ToMap {
    #[inline]
    fn world(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = times_vector(&self.turn, point);
        std::array::from_fn(|axis| f64::from((turned[axis] + self.shift[axis]) as f32))
    }
}

/// The formula, prepared for use.
struct Formula<'w> {
    world: &'w World,
    /// Q, and the inverse.
    axes: Rows3,
    back: Rows3,
    movers: Vec<ToMap>,
    /// Steps of the lattices in metres; 0 for no lattice.
    steps: [f64; 2],
}

impl<'w> Formula<'w> {
    fn new(world: &'w World, records: usize) -> Self {
        let axes = rotation(world.rotation);
        let back = transposed(&axes);
        let lever = times_vector(&back, [0.0, 0.0, world.origin[2]]);
        let mover = |[place, turn]: Metric| {
            let shift = times_vector(&axes, place);
            ToMap {
                turn: times_matrix(&axes, &rotation(turn)),
                shift: std::array::from_fn(|axis| shift[axis] + world.origin[axis]),
            }
        };
        let movers = world.poses(records.div_ceil(SLOTS), lever).into_iter().map(mover).collect();
        let step = |exponent: i32| f64::from_bits(((1023 + exponent) as u64) << 52);
        let steps = world.lattices.map(|lattice| lattice.map_or(0.0, step));
        Formula { world, axes, back, movers, steps }
    }

    /// The map's coordinates of a record, without its correction.
    fn world(&self, record: usize, measured: &[f32; 3]) -> [f64; 3] {
        self.movers[record / SLOTS].world(measured.map(f64::from))
    }

    /// The file's coordinates of a point of the map, displaced by `steps` of the lattices.
    fn file(&self, mut world: [f64; 3], steps: &[i64; 2]) -> [f32; 3] {
        for axis in 0..2 {
            world[axis] += steps[axis] as f64 * self.steps[axis];
        }
        let origin = self.world.origin;
        let moved = times_vector(&self.back, std::array::from_fn(|axis| world[axis] - origin[axis]));
        moved.map(|metres| metres as f32)
    }

    /// The steps of the lattices from the map's coordinates to those of a point of the file.
    fn steps_to(&self, world: &[f64; 3], position: &[f32; 3]) -> [i64; 2] {
        let there = times_vector(&self.axes, position.map(f64::from));
        std::array::from_fn(|axis| {
            let off = there[axis] + self.world.origin[axis] - world[axis];
            let steps = off / self.steps[axis];
            if steps.abs() < MOST_LATTICE_STEPS { steps.round_ties_even() as i64 } else { 0 }
        })
    }
}

impl World {
    /// The poses of the firings.
    fn poses(&self, firings: usize, lever: [f64; 3]) -> Vec<Metric> {
        let knots: Vec<(f64, Metric)> =
            self.knots.iter().map(|knot| (f64::from(knot.time) * TIME_UNIT, knot.pose.metric())).collect();
        let mut poses: Vec<Metric> = self.first.iter().take(firings).map(Pose::metric).collect();
        let mut piece = 0;
        for time in self.times.of_firings(firings).into_iter().skip(poses.len()) {
            while piece + 2 < knots.len() && knots[piece + 1].0 <= time {
                piece += 1;
            }
            let [a, b] = [&knots[piece], &knots[piece + 1]];
            poses.push(between([(a.0, &a.1), (b.0, &b.1)], time, lever));
        }
        poses
    }

    /// Records the points of the file's `positions` that the formula misses, given the decoded measured
    /// points: those that are not `near` it.
    pub fn find_corrections(
        &mut self,
        measured: &[[f32; 3]],
        positions: &[[f32; 3]],
        near: impl Fn(&[f32; 3], &[f32; 3]) -> bool,
    ) {
        let formula = Formula::new(self, measured.len());
        let unit = CoordinateGrid::unit_of_float;
        let mut corrections = Vec::new();
        for (record, (measured, position)) in measured.iter().zip(positions).enumerate() {
            let world = formula.world(record, measured);
            if near(position, &unless_nan(measured, formula.file(world, &[0; 2]))) {
                continue;
            }
            let steps = formula.steps_to(&world, position);
            let given = unless_nan(measured, formula.file(world, &steps));
            let units = std::array::from_fn(|axis| unit(position[axis]) - unit(given[axis]));
            corrections.push(Correction { record: record as u32, steps, units });
        }
        self.corrections = corrections;
    }

    /// Moves the points of a scan, in the order of the file. Corrections of records that do not exist are
    /// ignored.
    pub fn apply(&self, positions: &mut [[f32; 3]]) {
        let formula = Formula::new(self, positions.len());
        let mut corrections = self.corrections.iter().peekable();
        for (record, position) in positions.iter_mut().enumerate() {
            let found = corrections.next_if(|correction| correction.record as usize == record);
            let correction = found.copied().unwrap_or_default();
            let given =
                unless_nan(position, formula.file(formula.world(record, position), &correction.steps));
            *position = corrected(given, &correction.units);
        }
    }
}

#[cfg(test)]
mod tests {
    //! Tests of the section: what is written is read back, and damage is rejected or harmless. Whole sweeps are
    //! in `tests/compensation.rs`.

    use super::*;
    use crate::ground::random::Rng;

    fn example() -> (Vec<[f32; 3]>, World) {
        let points: Vec<[f32; 3]> =
            (0..100).map(|n| if n % 3 == 0 { [0.0; 3] } else { [n as f32 * 0.1, -1.5, 0.25] }).collect();
        let knot =
            |time, x| Knot { time, pose: Pose { position: [x, -5, 1 << 40], rotation: [1 << 30, -x, 7] } };
        let correction = |record, steps, units| Correction { record, steps, units };
        let world = World {
            rotation: [0.1, -0.2, 3.0],
            origin: [1500.0, -20.0, 1.5],
            lattices: [Some(-13), None],
            times: Times { border: 1, short: 2 },
            first: vec![Pose { position: [1, 2, 3], rotation: [-4, 5, -6] }; 2],
            knots: vec![knot(0, -100), knot(1000, 1 << 29), knot(1001, 9)],
            corrections: vec![
                correction(0, [1, 0], [0; 3]),
                correction(3, [1, 0], [0; 3]),
                correction(32, [-(1 << 39), 0], [1 << 33, -1, 0]),
                correction(99, [0; 2], [0, 0, -70_000]),
            ],
        };
        (points, world)
    }

    #[test]
    fn numbers_come_back() {
        let (points, world) = example();
        let payload = world.to_payload(&points);
        assert_eq!(World::from_payload(&payload, &points).unwrap(), world);
    }

    #[test]
    fn damage_is_refused_or_does_no_harm() {
        let (points, world) = example();
        let payload = world.to_payload(&points);
        let mut random = Rng::keyed(5, &[]);
        for round in 0..3000 {
            let mut bytes = payload.clone();
            for _ in 0..1 + round % 4 {
                let place = random.below(bytes.len());
                bytes[place] = random.below(256) as u8;
            }
            bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.below(bytes.len() + 1) });
            if let Ok(world) = World::from_payload(&bytes, &points) {
                let measured = &points;
                let mut points = points.clone();
                points[1] = [f32::NAN, f32::MAX, f32::NEG_INFINITY];
                world.apply(&mut points);
                assert_eq!(World::from_payload(&world.to_payload(measured), measured).unwrap(), world);
            }
        }
    }

    #[test]
    fn impossible_worlds_are_refused() {
        let (points, world) = example();
        for place in 0..6 {
            for value in [f64::NAN, f64::INFINITY, -2e9] {
                let mut payload = world.to_payload(&points);
                payload[8 * place..][..8].copy_from_slice(&value.to_le_bytes());
                assert!(World::from_payload(&payload, &points).is_err(), "{place} {value}");
            }
        }
    }
}
