//! The last digits of how a sweep was moved: the path's knots, the map's origin relative to its lattices and
//! float32 values, and the axes with the origin, from pairs of float32 coordinates in the file and in the
//! map.

use std::f64::consts::TAU;

use nalgebra::{Matrix6, Rotation3, UnitQuaternion, Vector6};

use super::path::{Information, KnotSearch, Path, PathFirings, Six};
use super::sweep::{Matrix, Vector};
use super::undo::{Errors, MEAN_FIRING_US, Search, rotated, turn_of};
use super::{Knot, PACKETS, POSITION_UNIT, Pose, ROTATION_UNIT, SLOTS, TIME_UNIT, Times, World};
use crate::ground::floats::round_ties_even;
use crate::scanner::CoordinateGrid;

/// Deviations of more than this many standard errors are ignored.
const CLIP: f64 = 6.0;

/// The firings after the first packet, and their path.
struct Following {
    times: Vec<f64>,
    /// The first of the firings, and their times.
    first: usize,
    path: Path,
}

impl Following {
    fn times(&self) -> &[f64] {
        &self.times[self.first..]
    }
}

impl Search {
    /// Determines everything to the last digits that the file allows.
    pub(super) fn world(&mut self) -> Option<World> {
        self.begin_origin();
        let (times, short) = self.find_times()?;
        let mut following = Following { times, first: self.border + 1, path: Path::default() };
        for round in 0..3 {
            self.find_knots(&mut following, round)?;
            self.read_ticks();
            self.find_binades();
        }
        for axis in self.fine_axes() {
            let near = self.origin[axis];
            self.origin[axis] = self.phase(axis, near, spacing(near), |record| self.is_none[record]);
        }
        for _ in 0..2 {
            self.anchor_near();
            self.fit(&mut following, None)?;
        }
        self.find_digits();
        self.fit(&mut following, None)?;
        for _ in 0..2 {
            self.anchor_all();
            self.fit(&mut following, None)?;
        }
        self.fit_first(&following);
        for inside in [0.3, 0.3, 0.1, 0.1, 0.1, 0.1] {
            self.fit(&mut following, Some(inside))?;
        }
        self.quantised(&following, short)
    }

    /// Starts near the middle of a binade, at the right phase of the lattices.
    fn begin_origin(&mut self) {
        /// Metres: points near the scanner determine the phase of a lattice.
        const NEAR: f64 = 0.3;
        /// The height of the scanner above the ground, which is the zero of the map.
        const HEIGHT: f64 = 1.8;
        let middle = |step: f64| 1.5 * step * f64::from(1 << 23);
        self.origin = Vector::new(middle(self.steps[0]), middle(self.fine_step), HEIGHT);
        let fine: Vec<usize> = self.fine_axes().collect();
        for axis in (0..2).filter(|axis| !fine.contains(axis)) {
            let (step, is_near) =
                (self.steps[axis], |r: usize| self.is_none[r] || self.points[r].norm() < NEAR);
            self.origin[axis] = self.phase(axis, middle(step), step, is_near);
        }
    }

    /// The firing times that give the best path, and the first packet after which the next firing is not
    /// late.
    fn find_times(&self) -> Option<(Vec<f64>, usize)> {
        let even: Vec<f64> = (0..self.firings).map(|firing| firing as f64 * MEAN_FIRING_US).collect();
        let information = self.information_of_all(0, Errors::Rounding(1.0, [0.0, 3e-7, 5e-8]), 8.0);
        let knots =
            KnotSearch::new(PathFirings { times: &even, poses: &self.poses, information: &information })
                .grown(None, 9, 300.0);
        let tried = (0..PACKETS).map(|short| {
            let times = self.times(short).of_firings(self.firings);
            let at = |knot: &f64| {
                let place = even.partition_point(|time| time < knot).clamp(1, even.len() - 1);
                let part = (knot - even[place - 1]) / (even[place] - even[place - 1]);
                times[place - 1] + (times[place] - times[place - 1]) * part
            };
            let moved: Vec<f64> = knots.iter().map(at).collect();
            let squares =
                KnotSearch::new(PathFirings { times: &times, poses: &self.poses, information: &information })
                    .squares(&moved);
            (squares, times, short)
        });
        tried.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, times, short)| (times, short))
    }

    fn times(&self, short: usize) -> Times {
        Times { border: self.border as u32, short: short as u32 }
    }

    fn lever(&self) -> Vector {
        self.axes.transpose() * Vector::new(0.0, 0.0, self.origin.z)
    }

    /// Searches for the knots of the path, and fits the path.
    fn find_knots(&mut self, following: &mut Following, round: usize) -> Option<()> {
        const MOST: [usize; 3] = [11, 14, 16];
        const GAINS: [f64; 3] = [100.0, 60.0, 60.0];
        const STEPS: [f64; 4] = [12.0, 4.0, 1.0, 0.25];
        let more = if round == 0 { [0.0, 2e-7, 3e-8] } else { [0.0; 3] };
        let first = following.first;
        let information = self.information_of_all(first, Errors::Rounding(1.0, more), CLIP);
        let firings =
            PathFirings { times: following.times(), poses: &self.poses[first..], information: &information };
        let search = KnotSearch::new(firings);
        // The second round starts anew, now that the map's origin is nearly right.
        let begun = (round == 2).then(|| following.path.times.clone());
        let knots = search.grown(begun, MOST[round], GAINS[round]);
        let (knots, _) = search.moved(knots, &STEPS);
        let straight = firings.path(&knots, None)?;
        let path = firings.path(&knots, Some((&self.lever(), &straight)))?;
        self.go_along(following, path);
        Some(())
    }

    fn go_along(&mut self, following: &mut Following, path: Path) {
        let lever = self.lever();
        for (pose, time) in self.poses[following.first..].iter_mut().zip(following.times()) {
            *pose = path.at(*time, &lever);
        }
        following.path = path;
    }

    /// Fits the path again, with the same knots. `inside`: the weight of points inside their roundings, if it
    /// is to be small.
    fn fit(&mut self, following: &mut Following, inside: Option<f64>) -> Option<()> {
        let first = following.first;
        let errors = inside.map_or(Errors::Rounding(1.0, [0.0; 3]), Errors::Inside);
        let information = self.information_of_all(first, errors, CLIP);
        let firings =
            PathFirings { times: following.times(), poses: &self.poses[first..], information: &information };
        let path = firings.path(&following.path.times, Some((&self.lever(), &following.path)))?;
        self.go_along(following, path);
        Some(())
    }

    /// The map's origin, modulo a lattice's step, from points near the scanner; the value next to `near`.
    fn phase(&self, axis: usize, near: f64, step: f64, is_used: impl Fn(usize) -> bool) -> f64 {
        let (mut re, mut im) = (0.0, 0.0);
        for record in (0..self.points.len()).filter(|&record| is_used(record)) {
            let (sin, cos) = libm::sincos((self.mapped[record][axis] + near) / step * TAU);
            re += cos;
            im += sin;
        }
        near - libm::atan2(im, re) / TAU * step
    }

    /// The map's origin along axes without a lattice: where the deviations of the points grow as the spacing
    /// of float32 does.
    fn find_binades(&mut self) {
        /// Every `SPARSE`-th firing is enough.
        const SPARSE: usize = 4;
        for axis in self.fine_axes() {
            let tried: Vec<f64> = if axis == 1 {
                let low = self.fine_step * f64::from(1 << 23);
                let part = |number: u32| low * libm::exp2(f64::from(number) / 41.0);
                (0..41).map(part).flat_map(|value| [value, -value]).collect()
            } else {
                (0..75).map(|number| 1.0 + 0.02 * f64::from(number)).collect()
            };
            // The deviation, the square of the file's rounding error, and the position.
            let mut points = Vec::new();
            for firing in (0..self.firings).step_by(SPARSE) {
                points.extend(self.misses(firing).map(|(record, miss, _)| {
                    (
                        miss[axis],
                        self.roundings[record].squares[axis] / 12.0 + 1e-16,
                        self.mapped[record][axis],
                    )
                }));
            }
            let mut sizes: Vec<f64> = points.iter().map(|point| point.0.abs()).collect();
            sizes.sort_unstable_by(f64::total_cmp);
            let most = 20.0 * sizes[sizes.len() / 2];
            points.retain(|point| point.0.abs() < most);
            // A logarithm of a product takes less than those of its factors, which are above 1e-16.
            let unlikely = |origin: f64| -> f64 {
                let of_points = |points: &[(f64, f64, f64)]| {
                    let (mut product, mut sum) = (1.0, 0.0);
                    for (miss, in_file, place) in points {
                        let in_map = spacing(origin + place);
                        let square = in_map * in_map / 12.0 + in_file;
                        product *= square;
                        sum += (miss * miss / square).min(16.0);
                    }
                    0.5 * (libm::log(product) + sum)
                };
                points.chunks(16).map(of_points).sum()
            };
            let best = tried.into_iter().map(|origin| (unlikely(origin), origin));
            if let Some((_, origin)) = best.min_by(|a, b| a.0.total_cmp(&b.0)) {
                self.origin[axis] = origin;
            }
        }
    }

    fn is_coarse(&self, axis: usize) -> bool {
        self.steps.get(axis).is_some_and(|step| *step > 0.0)
    }

    fn fine_axes(&self) -> impl Iterator<Item = usize> + use<> {
        let is_coarse: [bool; 3] = std::array::from_fn(|axis| self.is_coarse(axis));
        (0..3).filter(move |axis| !is_coarse[*axis])
    }

    /// The points in the map according to the formula.
    fn formula(&self) -> Vec<Vector> {
        let mut all = Vec::with_capacity(self.points.len());
        for firing in 0..self.firings {
            let turn = self.axes * turn_of(&self.poses[firing]);
            let shift = self.axes * self.poses[firing].fixed_rows::<3>(0) + self.origin;
            all.extend(self.of_firing(firing).map(|record| turn * self.measured[record] + shift));
        }
        all
    }

    /// The points in the map, rounded. Records for which `of_file` is true are taken from the file; the
    /// others from the file along axes with a lattice, and from the formula along the rest.
    fn targets(&self, formula: &[Vector], of_file: impl Fn(usize) -> bool) -> Vec<Vector> {
        let of_record = |record: usize| {
            let there = rounded(self.mapped[record] + self.origin);
            if of_file(record) {
                return there;
            }
            let mut target = rounded(formula[record]);
            for axis in (0..2).filter(|&axis| self.is_coarse(axis)) {
                target[axis] = there[axis];
            }
            target
        };
        (0..self.points.len()).map(of_record).collect()
    }

    /// Changes the axes and the origin, and everything that depends on them.
    fn anchor(&mut self, pairs: &[Pair], limits: &[f64]) {
        let axes;
        (axes, self.origin) = rigid(pairs, self.axes, self.origin, limits);
        self.set_axes(axes);
    }

    /// Fits the axes to records without a return, and along the axes of lattices to points that are not too
    /// far.
    fn anchor_near(&mut self) {
        /// Metres along an axis of the file.
        const FARTHEST: f64 = 60.0;
        let formula = self.formula();
        let targets = self.targets(&formula, |record| self.is_none[record]);
        let mut pairs = Vec::new();
        let mut last_none = usize::MAX;
        for (record, map) in targets.into_iter().enumerate() {
            let file = self.points[record];
            if self.is_none[record] && record / SLOTS != last_none {
                last_none = record / SLOTS;
                pairs.extend(self.pairs_of_file(record, map));
            } else if !self.is_none[record] && file.amax() < FARTHEST {
                for axis in (0..2).filter(|&axis| self.is_coarse(axis)) {
                    let direction = self.axes.row(axis).transpose();
                    let error = self.roundings[record].squares[axis].sqrt();
                    pairs.push(Pair { file, map, direction, error });
                }
            }
        }
        self.anchor(&pairs, &[1e9, 1e9, 1e9, 3.0, 1.0, 0.8]);
    }

    /// The pairs of a point of the file and one of the map, along each axis of the file.
    fn pairs_of_file(&self, record: usize, map: Vector) -> [Pair; 3] {
        std::array::from_fn(|axis| {
            let file = self.points[record];
            Pair { file, map, direction: Vector::ith(axis, 1.0), error: spacing(file[axis]) }
        })
    }

    /// The deviation of a record in float32 units, if it corresponds to this point of the map.
    fn units_off(&self, record: usize, map: &Vector) -> [i64; 3] {
        let given = self.axes.transpose() * (map - self.origin);
        let unit = CoordinateGrid::unit_of_float;
        std::array::from_fn(|axis| unit(self.positions[record][axis]) - unit(given[axis] as f32))
    }

    /// The last binary digits of the origin along axes without a lattice, and its position in the binade:
    /// those for which most points are reproduced.
    fn find_digits(&mut self) {
        /// Metres from the scanner along an axis: nearer points carry less information.
        const NEAR: f64 = 3.0;
        /// Every `SPARSE`-th point is enough.
        const SPARSE: usize = 4;
        const DIGITS: i32 = 7;
        let formula = self.formula();
        let far: Vec<usize> = (0..self.points.len())
            .filter(|&record| self.mapped[record].amax() > NEAR)
            .step_by(SPARSE)
            .collect();
        let from = self.origin;
        let is_coarse = [0, 1].map(|axis| self.is_coarse(axis));
        let count = |origin: &Vector| {
            let is_given = |record: &&usize| {
                let record = **record;
                let mut map = rounded(formula[record] - from + origin);
                for axis in (0..2).filter(|&axis| is_coarse[axis]) {
                    map[axis] = f64::from((self.mapped[record][axis] + origin[axis]) as f32);
                }
                let off = map - origin;
                (0..3).all(|axis| self.axes.column(axis).dot(&off) as f32 == self.positions[record][axis])
            };
            far.iter().filter(is_given).count()
        };
        let mut origin = from;
        for round in 0..2 {
            for axis in [1, 2].into_iter().filter(|&axis| !self.is_coarse(axis)) {
                let step = spacing(origin[axis]);
                let mut best = count(&origin);
                for digit in 0..DIGITS {
                    let mut tried = origin;
                    tried[axis] += step * f64::from(1 << digit);
                    let of_tried = count(&tried);
                    if of_tried > best {
                        (origin, best) = (tried, of_tried);
                    }
                }
                let (count_of, apart) = if round == 0 { (15, 0.02) } else { (10, 0.002) };
                let coarse = step * f64::from(1 << DIGITS) * 4.0;
                let tried = (-count_of..=count_of).map(|number| {
                    let mut tried = origin;
                    tried[axis] += round_ties_even(f64::from(number) * apart / coarse) * coarse;
                    (count(&tried), -i32::abs(number), tried)
                });
                if let Some((_, _, best)) = tried.max_by_key(|(count, near, _)| (*count, *near)) {
                    origin = best;
                }
            }
        }
        self.origin = origin;
    }

    /// Fits the axes to all points that are reproduced to within one float32 unit.
    fn anchor_all(&mut self) {
        /// Metres of height in the map below which float32 is too fine.
        const HIGH: f64 = 0.5;
        let formula = self.formula();
        let targets = self.targets(&formula, |_| false);
        let mut pairs = Vec::new();
        for (record, map) in targets.into_iter().enumerate() {
            let [x, y, _] = self.units_off(record, &map);
            if x.abs().max(y.abs()) <= 1 && (map.z.abs() > HIGH || self.is_none[record]) {
                pairs.extend(self.pairs_of_file(record, map));
            }
        }
        self.anchor(&pairs, &[60.0, 20.0, 6.0, 3.0, 2.0, 1.0, 0.8, 0.7]);
    }

    /// The poses of the firings before the path.
    fn fit_first(&mut self, following: &Following) {
        /// Factors of the rounding errors, large at first: these poses are not known well.
        const LOOSE: [f64; 8] = [300.0, 300.0, 300.0, 10.0, 10.0, 1.0, 1.0, 1.0];
        /// Regularises what the points of one firing do not determine: of positions, of rotations.
        const RIDGE: [f64; 2] = [1e4, 1e6];
        let first = following.first.min(self.firings - super::PACKET - 1);
        let times = &following.times;
        let span = super::PACKET;
        let rate = (self.poses[first + span] - self.poses[first]) / (times[first + span] - times[first]);
        for firing in 0..first {
            let mut pose = self.poses[first] + rate * (times[firing] - times[first]);
            pose.fixed_rows_mut::<3>(0).copy_from(&self.places[firing]);
            self.poses[firing] = pose;
        }
        for times_error in LOOSE {
            for record in 0..first * SLOTS {
                let place = self.poses[record / SLOTS].fixed_rows::<3>(0);
                let range = (self.points[record] - place).norm();
                if !self.is_none[record] {
                    self.reread(record, range);
                }
            }
            let information: Vec<Information> = (0..first)
                .map(|firing| self.information(firing, Errors::Rounding(times_error, [0.0; 3]), CLIP))
                .collect();
            let line = [times[0], times[first - 1]];
            let firings = PathFirings {
                times: &times[..first],
                poses: &self.poses[..first],
                information: &information,
            };
            let path = if first > 2 { firings.path(&line, None) } else { None };
            for firing in 0..first {
                if let Some(path) = &path {
                    self.poses[firing] = path.at(times[firing], &Vector::zeros());
                } else {
                    let ridge = Six::from_fn(|i, _| RIDGE[i / 3]);
                    let normal = information[firing].normal + Matrix6::from_diagonal(&ridge);
                    if let Some(cholesky) = normal.cholesky() {
                        self.poses[firing] += cholesky.solve(&information[firing].right);
                    }
                }
            }
        }
    }

    /// The world with its numbers as a stream holds them.
    fn quantised(&self, following: &Following, short: usize) -> Option<World> {
        let units = |metres: &[f64], unit: f64| -> [i64; 3] {
            std::array::from_fn(|axis| (metres[axis] / unit).round_ties_even() as i64)
        };
        let pose = |pose: &Six| Pose {
            position: units(&pose.as_slice()[..3], POSITION_UNIT),
            rotation: units(&pose.as_slice()[3..], ROTATION_UNIT),
        };
        let knot = |(time, of_knot): (&f64, &Six)| Knot {
            time: (time / TIME_UNIT).round_ties_even() as u32,
            pose: pose(of_knot),
        };
        let step = |step: f64| (step > 0.0).then(|| libm::ilogb(step));
        let path = &following.path;
        let world = World {
            rotation: axis_of(self.axes),
            origin: self.origin.into(),
            lattices: self.steps.map(step),
            times: self.times(short),
            first: self.poses[..following.first].iter().map(pose).collect(),
            knots: path.times.iter().zip(&path.poses).map(knot).collect(),
            corrections: Vec::new(),
        };
        world.is_possible().then_some(world)
    }
}

/// The axis of a rotation, with the angle as its length.
fn axis_of(rotation: Matrix) -> [f64; 3] {
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let sin = quaternion.imag().norm();
    let angle = 2.0 * libm::atan2(sin, quaternion.w);
    if sin > 0.0 { (quaternion.imag() * (angle / sin)).into() } else { [0.0; 3] }
}

/// The distance from a float32 value to the next.
#[inline]
pub fn spacing(value: f64) -> f64 {
    let binade = f32::from_bits((value as f32).to_bits() & 0x7f80_0000);
    f64::from(binade.max(f32::MIN_POSITIVE) * f32::EPSILON)
}

fn rounded(v: Vector) -> Vector {
    v.map(|metres| f64::from(metres as f32))
}

/// A condition: along a direction, a point of the file corresponds to one of the map.
struct Pair {
    file: Vector,
    map: Vector,
    /// The direction, in the file's axes.
    direction: Vector,
    /// The standard error, in metres.
    error: f64,
}

/// The rotation and the origin that map the map's points to those of the file, using fewer and fewer of the
/// pairs: those whose deviation is below each of `limits`, in multiples of their error.
fn rigid(pairs: &[Pair], mut axes: Matrix, mut origin: Vector, limits: &[f64]) -> (Matrix, Vector) {
    let middle = pairs.iter().fold(Vector::zeros(), |sum, pair| sum + pair.file) / pairs.len().max(1) as f64;
    for limit in limits {
        let mut normal = Matrix6::zeros();
        let mut right = Vector6::zeros();
        for pair in pairs {
            let there = axes.transpose() * (pair.map - origin);
            let off = (pair.file - there).dot(&pair.direction) / pair.error;
            if off.abs() < *limit {
                let turn = (there - middle).cross(&pair.direction) / pair.error;
                let place = pair.direction / pair.error;
                let row = Vector6::new(turn.x, turn.y, turn.z, place.x, place.y, place.z);
                // The lower triangle is enough for the decomposition.
                for column in 0..6 {
                    for i in column..6 {
                        normal[(i, column)] += row[i] * row[column];
                    }
                }
                right += row * off;
            }
        }
        let scale = normal.diagonal().map(|d: f64| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let scaled = Matrix6::from_diagonal(&scale) * normal * Matrix6::from_diagonal(&scale);
        let Some(cholesky) = (scaled + Matrix6::identity() * 1e-13).cholesky() else { break };
        let step = cholesky.solve(&right.component_mul(&scale)).component_mul(&scale);
        if !step.iter().all(|part| part.is_finite()) {
            break;
        }
        let turn = rotated(&Vector::new(step[0], step[1], step[2]));
        // v = turn (there - middle) + middle + shift
        let shift = Vector::new(step[3], step[4], step[5]) + middle - turn * middle;
        axes *= turn.transpose();
        origin -= axes * shift;
        axes = orthonormal(axes);
    }
    (axes, origin)
}

fn orthonormal(axes: Matrix) -> Matrix {
    let svd = axes.svd(true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => u * v_t,
        _ => axes,
    }
}
