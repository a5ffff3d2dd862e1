//! Estimates how a sweep was moved through the world frame, in stages that are each accurate enough for the
//! next: the scanner's positions from records without a return, its rotations from ranges and ticks being
//! whole numbers, the axes of the map from its lattices, then the path and the origin in the map alternately.

use nalgebra::Matrix3;

use super::path::{Information, PathFirings, Six};
use super::refine::spacing;
use super::sweep::{
    FAR_STEPS, Hdl32e, Matrix, Reading, Returnless, Ticks, Vector, returnless, shared_place, ticks, turned,
};
use super::{FIRING_US, SLOTS, World, axes, rotation};

/// The points as they were measured, and how they were moved to those of the file, with a list of corrections
/// that is still empty. None if the points were not moved in this way.
pub fn undo(positions: &[[f32; 3]]) -> Option<(Vec<[f32; 3]>, World)> {
    let mut search = Search::begun(positions)?;
    let world = search.world()?;
    Some((search.measured(), world))
}

/// The points as they were measured, without the last digits of how they were moved: this is enough for the
/// fit of the scanner.
pub fn measured(positions: &[[f32; 3]]) -> Option<Vec<[f32; 3]>> {
    Search::begun(positions).map(|search| search.measured())
}

/// A quick test: firings of 32 records, many of them with records without a return, all at the scanner's
/// position.
fn may_be_moved(positions: &[[f32; 3]]) -> bool {
    const FEWEST_FIRINGS: usize = 200;
    const MOST_FIRINGS: usize = 4000;
    /// Number of firings that are tested, and how many of them must have such records.
    const SAMPLE: usize = 64;
    const FEWEST: usize = 12;
    /// Metres; beyond the reach of any scanner.
    const FARTHEST: f32 = 1000.0;
    let firings = positions.len() / SLOTS;
    if !positions.len().is_multiple_of(SLOTS) || !(FEWEST_FIRINGS..=MOST_FIRINGS).contains(&firings) {
        return false;
    }
    let sample = positions.chunks_exact(SLOTS).step_by(firings / SAMPLE);
    let with_none = sample.filter(|firing| shared_place(firing).is_some()).count();
    with_none >= FEWEST && positions.iter().flatten().all(|metres| metres.abs() < FARTHEST)
}

/// Number of knots of the path before it is known well, and the mean number of microseconds between firings.
const EVEN_KNOTS: usize = 46;
pub(super) const MEAN_FIRING_US: f64 = FIRING_US + 0.08;

/// A sweep, and the current estimates of how it was moved.
pub(super) struct Search {
    pub(super) scanner: Hdl32e,
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) points: Vec<Vector>,
    pub(super) is_none: Vec<bool>,
    pub(super) firings: usize,
    /// The axes of the map as rows, and the lattices along the first two: 0 if too fine.
    pub(super) axes: Matrix,
    pub(super) steps: [f64; 2],
    pub(super) fine_step: f64,
    /// The points along the axes of the map.
    pub(super) mapped: Vec<Vector>,
    pub(super) roundings: Vec<Roundings>,
    pub(super) origin: Vector,
    pub(super) readings: Vec<Reading>,
    /// The points according to the readings.
    pub(super) measured: Vec<Vector>,
    pub(super) poses: Vec<Six>,
    /// The last firing of the first packet.
    pub(super) border: usize,
    /// The scanner's positions, according to records without a return.
    pub(super) places: Vec<Vector>,
}

/// The standard errors by which deviations are weighted.
#[derive(Clone, Copy)]
pub(super) enum Errors {
    /// In metres along each axis of the map.
    Fixed([f64; 3]),
    /// The rounding errors of float32 times a factor, plus an error in metres along each axis of the map.
    Rounding(f64, [f64; 3]),
    /// The rounding errors of float32, where points within their roundings have this weight only.
    Inside(f64),
}

/// The rounding errors of a point of the file, along the axes of the map: the sum of what the spacings of its
/// float32 coordinates contribute, and the sum of the squares.
#[derive(Clone, Copy)]
pub(super) struct Roundings {
    sum: Vector,
    pub(super) squares: Vector,
}

/// Sums over the points of a firing of weights w, deviations d along an axis of the map, and rotated measured
/// points t, from which the axis' information on the pose follows.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// w, w d and w d d.
    weight: f64,
    push: f64,
    squares: f64,
    /// w t and w d t.
    points: Vector,
    pushed: Vector,
    /// w t t: xx, xy, xz, yy, yz, zz.
    products: [f64; 6],
}

impl Sums {
    #[inline]
    fn add(&mut self, weight: f64, off: f64, turned: &Vector) {
        let push = weight * off;
        let weighted = turned * weight;
        self.weight += weight;
        self.push += push;
        self.squares += push * off;
        self.points += weighted;
        self.pushed += turned * push;
        let products = [
            weighted.x * turned.x,
            weighted.x * turned.y,
            weighted.x * turned.z,
            weighted.y * turned.y,
            weighted.y * turned.z,
            weighted.z * turned.z,
        ];
        for (sum, product) in self.products.iter_mut().zip(products) {
            *sum += product;
        }
    }

    /// Adds the information along this direction: if the pose changes by (p, r), a deviation changes by
    /// direction p + (t x direction) r.
    fn add_to(&self, direction: &Vector, information: &mut Information) {
        let lever = -direction.cross_matrix();
        let [xx, xy, xz, yy, yz, zz] = self.products;
        let products = Matrix::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let both = direction * (lever * self.points).transpose();
        let add = |information: &mut Information, at: (usize, usize), block: Matrix| {
            let mut there = information.normal.fixed_view_mut::<3, 3>(at.0, at.1);
            there += block;
        };
        add(information, (0, 0), direction * direction.transpose() * self.weight);
        add(information, (0, 3), both);
        add(information, (3, 0), both.transpose());
        add(information, (3, 3), lever * products * lever.transpose());
        let [place, turn] = [direction * self.push, lever * self.pushed];
        information.right += Six::new(place.x, place.y, place.z, turn.x, turn.y, turn.z);
        information.squares += self.squares;
    }
}

impl Search {
    /// The estimates up to the readings; none if it is not such a sweep.
    fn begun(positions: &[[f32; 3]]) -> Option<Self> {
        /// The minimum share of points that must have the ticks of the driver's rule.
        const LEAST: f64 = 0.9;
        if !may_be_moved(positions) {
            return None;
        }
        let points: Vec<Vector> =
            positions.iter().map(|position| Vector::from(position.map(f64::from))).collect();
        let Returnless { places, is_none } = returnless(positions)?;
        let firings = places.len();
        let scanner = Hdl32e::new();
        let turns = followed(&scanner, &points, &places, &is_none);
        let axes::Axes { rows, steps } = axes::find(&points, &is_none)?;
        let is_coarse = |step: f64| if step >= axes::FINE { step } else { 0.0 };
        let poses = places
            .iter()
            .zip(&turns)
            .map(|(place, turn)| Six::new(place.x, place.y, place.z, turn.x, turn.y, turn.z))
            .collect();
        let mut search = Search {
            scanner,
            positions: positions.to_vec(),
            points,
            mapped: Vec::new(),
            roundings: Vec::new(),
            is_none,
            firings,
            axes: rows,
            steps: steps.map(is_coarse),
            fine_step: steps[1],
            origin: Vector::zeros(),
            readings: Vec::new(),
            measured: Vec::new(),
            poses,
            border: 0,
            places,
        };
        search.set_axes(rows);
        search.read();
        let times: Vec<f64> = (0..firings).map(|firing| firing as f64 * MEAN_FIRING_US).collect();
        let knots = even(times[firings - 1], EVEN_KNOTS);
        let errors = Errors::Fixed([(steps[0] / 3.46).max(1e-6), (steps[1] / 3.46).max(2e-6), 1e-6]);
        for clip in [100.0, 30.0, 4.0, 4.0] {
            search.follow(&times, &knots, errors, clip)?;
        }
        search.read();
        for clip in [4.0, 4.0] {
            search.follow(&times, &knots, errors, clip)?;
        }
        let share = search.read_ticks();
        search.follow(&times, &knots, errors, 4.0)?;
        (share > LEAST).then_some(search)
    }

    pub(super) fn of_firing(&self, firing: usize) -> std::ops::Range<usize> {
        firing * SLOTS..(firing + 1) * SLOTS
    }

    /// A point in the scanner's coordinates.
    fn seen(&self, record: usize, turn: &Matrix) -> Vector {
        let pose = &self.poses[record / SLOTS];
        turn.transpose() * (self.points[record] - pose.fixed_rows::<3>(0))
    }

    /// Determines the reading of every record by itself.
    fn read(&mut self) {
        self.readings = Vec::with_capacity(self.points.len());
        for firing in 0..self.firings {
            let turn = turn_of(&self.poses[firing]);
            for record in self.of_firing(firing) {
                self.readings.push(Hdl32e::reading(&self.seen(record, &turn)));
            }
        }
        self.measure();
    }

    /// Determines the readings of all records by the rule of the ticks, and returns the share of far points
    /// whose own ticks agree.
    pub(super) fn read_ticks(&mut self) -> f64 {
        self.read();
        let is_far = |record: &usize| !self.is_none[*record] && self.readings[*record].steps > FAR_STEPS;
        let own: Vec<Option<i64>> = (0..self.points.len())
            .map(|record| Some(record).filter(is_far).map(|record| self.readings[record].tick))
            .collect();
        let Ticks { ticks, border, share } = ticks(&own);
        self.border = border;
        for (reading, tick) in self.readings.iter_mut().zip(ticks) {
            reading.tick = self::nearer(*reading, tick);
        }
        self.measure();
        share
    }

    fn measure(&mut self) {
        let of_record = |record: usize| match self.is_none[record] {
            true => Vector::zeros(),
            false => self.scanner.vector(record % SLOTS, self.readings[record]),
        };
        self.measured = (0..self.points.len()).map(of_record).collect();
    }

    /// The measured points as floats: those of the formula if it is close, otherwise those that the pose
    /// implies.
    fn measured(&self) -> Vec<[f32; 3]> {
        /// In metres, along an axis.
        const NEAR: f64 = 3e-4;
        let mut measured = Vec::with_capacity(self.points.len());
        for firing in 0..self.firings {
            let turn = turn_of(&self.poses[firing]);
            for record in self.of_firing(firing) {
                let seen = self.seen(record, &turn);
                measured.push(if self.is_none[record] {
                    [0.0; 3]
                } else if (seen - self.measured[record]).amax() < NEAR {
                    self.scanner.position(record % SLOTS, self.readings[record])
                } else {
                    seen.map(|metres| metres as f32).into()
                });
            }
        }
        measured
    }

    /// Determines the reading of a record again, given its range.
    pub(super) fn reread(&mut self, record: usize, range: f64) {
        self.readings[record].steps = Hdl32e::steps(range);
        self.measured[record] = self.scanner.vector(record % SLOTS, self.readings[record]);
    }

    /// Changes the axes of the map, and everything that follows from them.
    pub(super) fn set_axes(&mut self, axes: Matrix) {
        let shares = axes.abs();
        let squares = shares.component_mul(&shares);
        self.axes = axes;
        self.mapped = self.points.iter().map(|point| axes * point).collect();
        let along = |spacings: &Vector| Roundings {
            sum: shares * spacings,
            squares: squares * spacings.component_mul(spacings),
        };
        self.roundings = self.points.iter().map(|point| along(&point.map(spacing))).collect();
    }

    /// The deviations along the axes of the map, and the rotated measured point.
    pub(super) fn misses(&self, firing: usize) -> impl Iterator<Item = (usize, Vector, Vector)> + '_ {
        let turn = turn_of(&self.poses[firing]);
        let place: Vector = self.poses[firing].fixed_rows::<3>(0).into();
        self.of_firing(firing).map(move |record| {
            let turned = turn * self.measured[record];
            (record, self.mapped[record] - self.axes * (turned + place), turned)
        })
    }

    /// The information of a firing on its pose. Deviations of more than `clip` standard errors are ignored.
    pub(super) fn information(&self, firing: usize, errors: Errors, clip: f64) -> Information {
        /// The weight of points outside their roundings.
        const OUTSIDE: f64 = 30.0;
        /// The share of the file's rounding that is taken into account.
        const IN_FILE: f64 = 0.3;
        let mut sums = [Sums::default(); 3];
        for (record, miss, turned) in self.misses(firing) {
            let roundings = &self.roundings[record];
            let in_map = (self.mapped[record] + self.origin).map(spacing);
            for (axis, sums) in sums.iter_mut().enumerate() {
                let in_file = roundings.squares[axis];
                let rounding = (in_map[axis] * in_map[axis] + in_file) / 12.0 + 1e-20;
                let square = match errors {
                    Errors::Fixed(error) => error[axis] * error[axis],
                    Errors::Rounding(times, more) => times * times * (rounding + more[axis] * more[axis]),
                    Errors::Inside(_) => rounding,
                };
                let mut off = miss[axis];
                if off * off >= clip * clip * square {
                    continue;
                }
                let mut weight = 1.0 / square;
                if let Errors::Inside(inside) = errors {
                    let half = in_map[axis] / 2.0 + IN_FILE * roundings.sum[axis];
                    let beyond = off - off.clamp(-half, half);
                    weight *= if beyond == 0.0 { inside } else { OUTSIDE };
                    off = if beyond == 0.0 { off } else { beyond };
                }
                sums.add(weight, off, &turned);
            }
        }
        let mut information = Information::default();
        for (axis, sums) in sums.iter().enumerate() {
            sums.add_to(&self.axes.row(axis).transpose(), &mut information);
        }
        information
    }

    pub(super) fn information_of_all(&self, from: usize, errors: Errors, clip: f64) -> Vec<Information> {
        (from..self.firings).map(|firing| self.information(firing, errors, clip)).collect()
    }

    /// Fits the poses of all firings to a path with these knots.
    fn follow(&mut self, times: &[f64], knots: &[f64], errors: Errors, clip: f64) -> Option<()> {
        let information = self.information_of_all(0, errors, clip);
        let path = PathFirings { times, poses: &self.poses, information: &information }.path(knots, None)?;
        self.poses = times.iter().map(|time| path.at(*time, &Vector::zeros())).collect();
        Some(())
    }
}

/// The tick according to the rule if the reading's own tick is close to it, otherwise the reading's own.
fn nearer(reading: Reading, tick: i64) -> i64 {
    /// Ticks by which near points may be off, as their floats are not fine enough.
    const NEAR: i64 = 4;
    let most = if reading.steps > FAR_STEPS { 1 } else { NEAR };
    if turned(reading.tick, tick).abs() <= most { tick } else { reading.tick }
}

fn even(end: f64, count: usize) -> Vec<f64> {
    (0..count).map(|number| end * number as f64 / (count - 1) as f64).collect()
}

/// The rotation about an axis whose length is the angle in radians.
pub(super) fn rotated(axis: &Vector) -> Matrix {
    Matrix::from_row_slice(rotation((*axis).into()).as_flattened())
}

/// The rotation of a pose.
pub(super) fn turn_of(pose: &Six) -> Matrix {
    rotated(&Vector::new(pose[3], pose[4], pose[5]))
}

/// The rotations of all firings, one by one from the last, which is not rotated.
fn followed(scanner: &Hdl32e, points: &[Vector], places: &[Vector], is_none: &[bool]) -> Vec<Vector> {
    /// Number of firings from which the next is extrapolated, and the minimum number for a straight line.
    const LOOK_BACK: usize = 24;
    const FEWEST_OF_LINE: usize = 12;
    /// In metres: a point this far from a reading's has another reading.
    const NEAR: f64 = 3e-4;
    const FEWEST: usize = 3;
    /// Square metres: regularises rotations that the points do not determine.
    const RIDGE: f64 = 0.25;
    let mut turns = vec![Vector::zeros(); places.len()];
    for firing in (0..places.len()).rev() {
        let after = &turns[firing + 1..(firing + 1 + LOOK_BACK).min(places.len())];
        let mut turn = match after.len() {
            0 => Vector::zeros(),
            count @ 1..FEWEST_OF_LINE => after.iter().sum::<Vector>() / count as f64,
            _ => extrapolated(after),
        };
        for _ in 0..2 {
            let rotation = rotated(&turn);
            let (mut normal, mut right, mut count) = (Matrix3::identity() * RIDGE, Vector::zeros(), 0);
            for slot in (0..SLOTS).filter(|slot| !is_none[firing * SLOTS + slot]) {
                let off = points[firing * SLOTS + slot] - places[firing];
                let reading = Hdl32e::reading(&(rotation.transpose() * off));
                let turned = rotation * scanner.vector(slot, reading);
                let miss = off - turned;
                if reading.steps > FAR_STEPS && miss.amax() < NEAR {
                    let cross = turned.cross_matrix();
                    normal += cross.transpose() * cross;
                    right += turned.cross(&miss);
                    count += 1;
                }
            }
            let Some(cholesky) = normal.cholesky().filter(|_| count >= FEWEST) else { break };
            turn += cholesky.solve(&right);
        }
        turns[firing] = turn;
    }
    turns
}

/// The value before the first, by a straight line through all values.
fn extrapolated(values: &[Vector]) -> Vector {
    let count = values.len() as f64;
    let middle = (count + 1.0) / 2.0;
    let mean = values.iter().sum::<Vector>() / count;
    let (mut slope, mut square) = (Vector::zeros(), 0.0);
    for (number, value) in values.iter().enumerate() {
        let at = number as f64 + 1.0 - middle;
        slope += (value - mean) * at;
        square += at * at;
    }
    mean - slope * (middle / square)
}
