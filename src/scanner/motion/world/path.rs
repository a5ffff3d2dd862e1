//! The path of the scanner through a sweep: linear between knots in time, as near as possible to the poses
//! that the firings imply.

use nalgebra::{ArrayStorage, Matrix6, Vector6};

use super::sweep::Vector;
use super::{Metric, between};

/// The position in metres, then the rotation in radians.
pub type Six = Vector6<f64>;

/// The information of a firing on its pose: the sum of squares is `squares - 2 d right + d normal d`, if the
/// pose differs by d from the current one.
#[derive(Clone, Copy)]
pub struct Information {
    pub normal: Matrix6<f64>,
    pub right: Six,
    pub squares: f64,
}

impl Default for Information {
    fn default() -> Self {
        Information { normal: Matrix6::zeros(), right: Six::zeros(), squares: 0.0 }
    }
}

/// The firings whose poses lie on a path.
#[derive(Clone, Copy)]
pub struct PathFirings<'a> {
    /// Times in microseconds.
    pub times: &'a [f64],
    pub poses: &'a [Six],
    pub information: &'a [Information],
}

/// The path's knots: times in microseconds, and poses.
#[derive(Clone, Default)]
pub struct Path {
    pub times: Vec<f64>,
    pub poses: Vec<Six>,
}

pub fn metric(pose: &Six) -> Metric {
    [[pose[0], pose[1], pose[2]], [pose[3], pose[4], pose[5]]]
}

pub fn six([place, turn]: Metric) -> Six {
    Six::new(place[0], place[1], place[2], turn[0], turn[1], turn[2])
}

/// The index of the piece of a path that contains a time.
fn piece_at(knots: &[f64], time: f64) -> usize {
    knots.partition_point(|knot| *knot <= time).saturating_sub(1).min(knots.len() - 2)
}

impl Path {
    /// The pose at a time.
    pub fn at(&self, time: f64, lever: &Vector) -> Six {
        let piece = piece_at(&self.times, time);
        let ends = [piece, piece + 1].map(|knot| metric(&self.poses[knot]));
        six(between(
            [(self.times[piece], &ends[0]), (self.times[piece + 1], &ends[1])],
            time,
            [lever.x, lever.y, lever.z],
        ))
    }
}

/// The information of the firings between two knots on the poses of these.
#[derive(Clone)]
struct Piece {
    /// The blocks for the first knot, for both, and for the second.
    normal: [Matrix6<f64>; 3],
    right: [Six; 2],
}

impl Piece {
    fn new() -> Self {
        Piece { normal: [Matrix6::zeros(); 3], right: [Six::zeros(); 2] }
    }

    fn add(&mut self, part: f64, normal: &Matrix6<f64>, right: &Six) {
        let rest = 1.0 - part;
        for (sum, weight) in self.normal.iter_mut().zip([rest * rest, rest * part, part * part]) {
            *sum += normal * weight;
        }
        self.right[0] += right * rest;
        self.right[1] += right * part;
    }
}

/// The information on the pose of a knot of all pieces on one side of it, whatever the poses of their other
/// knots are.
#[derive(Clone, Copy)]
struct Side {
    normal: Matrix6<f64>,
    right: Six,
    /// The decrease of the sum of squares by the poses of the other knots, compared to poses that are all 0;
    /// minus infinity if they are not determined.
    less: f64,
}

impl Side {
    /// The side of a knot at the end of a path.
    const NONE: Side = Side {
        normal: Matrix6::from_array_storage(ArrayStorage([[0.0; 6]; 6])),
        right: Six::from_array_storage(ArrayStorage([[0.0; 6]])),
        less: 0.0,
    };

    /// With another piece, from the knot of this side, which is the piece's first or second, to its other.
    fn across(&self, piece: &Piece, near: usize, ridge: &Matrix6<f64>) -> Side {
        let right = self.right + piece.right[near];
        let Some(cholesky) = (self.normal + piece.normal[2 * near] + ridge).cholesky() else {
            return Side { less: f64::NEG_INFINITY, ..Side::NONE };
        };
        // The block for both knots is symmetric.
        let both = &piece.normal[1];
        let solved = cholesky.solve(both);
        Side {
            normal: piece.normal[2 - 2 * near] - both * solved,
            right: piece.right[1 - near] - solved.transpose() * right,
            less: self.less + right.dot(&cholesky.solve(&right)),
        }
    }

    /// The optimal pose of a knot, given its sides, and the decrease of the sum of squares.
    fn joined(&self, other: &Side, ridge: &Matrix6<f64>) -> (Six, f64) {
        let right = self.right + other.right;
        match (self.normal + other.normal + ridge).cholesky() {
            None => (Six::zeros(), f64::NEG_INFINITY),
            Some(cholesky) => {
                let pose = cholesky.solve(&right);
                (pose, self.less + other.less + right.dot(&pose))
            }
        }
    }
}

/// Regularises knots without information, relative to the information of all firings on a pose.
fn ridge(all: &Matrix6<f64>) -> Matrix6<f64> {
    const RIDGE: f64 = 1e-13;
    Matrix6::from_diagonal(&((all.diagonal() + Six::repeat(1e-6)) * RIDGE))
}

impl<'a> PathFirings<'a> {
    /// The best path with these knots. With a lever, the path sags between knots as the preceding path
    /// implies.
    pub fn path(&self, knots: &[f64], sag: Option<(&Vector, &Path)>) -> Option<Path> {
        let mut before = sag.map(|(lever, path)| (*lever, path.clone()));
        let rounds = if sag.is_some() { 2 } else { 1 };
        let ridge = ridge(&self.information.iter().map(|information| information.normal).sum());
        for round in 0..rounds {
            let mut pieces = vec![Piece::new(); knots.len() - 1];
            for ((time, pose), information) in self.times.iter().zip(self.poses).zip(self.information) {
                let piece = piece_at(knots, *time);
                let part = (time - knots[piece]) / (knots[piece + 1] - knots[piece]);
                let mut from = *pose;
                if let Some((lever, path)) = &before {
                    from -= path.at(*time, lever) - path.at(*time, &Vector::zeros());
                }
                pieces[piece].add(
                    part,
                    &information.normal,
                    &(information.right + information.normal * from),
                );
            }
            let path = Path { times: knots.to_vec(), poses: solved(&pieces, &ridge)? };
            if round + 1 == rounds {
                return Some(path);
            }
            before = before.map(|(lever, _)| (lever, path));
        }
        None
    }
}

/// The optimal poses of the knots between these pieces.
fn solved(pieces: &[Piece], ridge: &Matrix6<f64>) -> Option<Vec<Six>> {
    let mut after = vec![Side::NONE];
    for piece in pieces.iter().rev() {
        after.push(after[after.len() - 1].across(piece, 1, ridge));
    }
    let mut before = Side::NONE;
    let mut poses = Vec::with_capacity(after.len());
    for (knot, after) in after.iter().rev().enumerate() {
        let (pose, less) = before.joined(after, ridge);
        poses.push(Some(pose).filter(|_| less.is_finite())?);
        before = pieces.get(knot).map_or(before, |piece| before.across(piece, 0, ridge));
    }
    Some(poses)
}

/// Sums over the first firings of a path, from which the pieces of any knots follow.
#[derive(Clone, Copy)]
struct Moments {
    /// Of the firings' information, multiplied by the powers 0, 1 and 2 of the part of the sweep before the
    /// firing.
    normal: [Matrix6<f64>; 3],
    /// By the powers 0 and 1.
    right: [Six; 2],
}

/// Searches for the times of knots.
pub struct KnotSearch<'a> {
    times: &'a [f64],
    /// Of all firings before each firing, and of all firings.
    moments: Vec<Moments>,
    ridge: Matrix6<f64>,
    /// The sum of squares of a straight line through the whole sweep.
    squares: f64,
}

/// Minimum time between knots, in microseconds.
const LEAST_GAP: f64 = 100.0;

impl<'a> KnotSearch<'a> {
    pub fn new(firings: PathFirings<'a>) -> Self {
        let PathFirings { times, poses, information } = firings;
        let last = times.len() - 1;
        let mut squares = 0.0;
        let mut sum = Moments { normal: [Matrix6::zeros(); 3], right: [Six::zeros(); 2] };
        let mut moments = vec![sum];
        for ((time, pose), information) in times.iter().zip(poses).zip(information) {
            let part = (time - times[0]) / (times[last] - times[0]);
            let off = pose - (poses[0] * (1.0 - part) + poses[last] * part);
            let push = information.normal * off;
            squares += information.squares + 2.0 * information.right.dot(&off) + push.dot(&off);
            let mut normal = information.normal;
            for sum in &mut sum.normal {
                *sum += normal;
                normal *= part;
            }
            let right = information.right + push;
            sum.right[0] += right;
            sum.right[1] += right * part;
            moments.push(sum);
        }
        KnotSearch { times, moments, ridge: ridge(&sum.normal[0]), squares }
    }

    fn ends(&self) -> [f64; 2] {
        [self.times[0], self.times[self.times.len() - 1]]
    }

    /// The piece between knots at these times, relative to the straight line.
    fn piece(&self, [first, second]: [f64; 2]) -> Piece {
        let [start, end] = self.ends();
        let firing = |knot: f64| self.times.partition_point(|time| *time < knot);
        let to = if second < end { firing(second) } else { self.times.len() };
        let [before, until] = [&self.moments[firing(first)], &self.moments[to]];
        let normal: [Matrix6<f64>; 3] =
            std::array::from_fn(|power| until.normal[power] - before.normal[power]);
        let right: [Six; 2] = std::array::from_fn(|power| until.right[power] - before.right[power]);
        // The weights of the knots are linear in the part p of the sweep: slope (b - p) and slope (p - a).
        let [a, b] = [first, second].map(|time| (time - start) / (end - start));
        let slope = 1.0 / (b - a);
        let square = slope * slope;
        Piece {
            normal: [
                (normal[2] - normal[1] * (2.0 * b) + normal[0] * (b * b)) * square,
                (normal[1] * (a + b) - normal[2] - normal[0] * (a * b)) * square,
                (normal[2] - normal[1] * (2.0 * a) + normal[0] * (a * a)) * square,
            ],
            right: [(right[0] * b - right[1]) * slope, (right[1] - right[0] * a) * slope],
        }
    }

    /// The sides of all knots after them.
    fn after(&self, knots: &[f64]) -> Vec<Side> {
        let mut sides = vec![Side::NONE; knots.len()];
        for knot in (1..knots.len()).rev() {
            sides[knot - 1] = self.across(&sides[knot], [knots[knot - 1], knots[knot]], 1);
        }
        sides
    }

    fn across(&self, side: &Side, pair: [f64; 2], near: usize) -> Side {
        side.across(&self.piece(pair), near, &self.ridge)
    }

    /// The sum of squares with the second of three knots between the sides of the first and the third.
    fn squares_between(&self, sides: [&Side; 2], [first, second, third]: [f64; 3]) -> f64 {
        let before = self.across(sides[0], [first, second], 0);
        let after = self.across(sides[1], [second, third], 1);
        self.squares - before.joined(&after, &self.ridge).1
    }

    /// The sum of squares with knots at these times.
    pub fn squares(&self, knots: &[f64]) -> f64 {
        self.squares - self.after(knots)[0].joined(&Side::NONE, &self.ridge).1
    }

    /// Moves knots by these steps, in microseconds, as long as that reduces the sum of squares.
    pub fn moved(&self, mut knots: Vec<f64>, steps: &[f64]) -> (Vec<f64>, f64) {
        const MOST_ROUNDS: usize = 4;
        let mut best = self.squares(&knots);
        for step in steps {
            for _ in 0..MOST_ROUNDS {
                let start = best;
                let after = self.after(&knots);
                let mut before = Side::NONE;
                for knot in 1..knots.len() - 1 {
                    let [last, next] = [knots[knot - 1], knots[knot + 1]];
                    for step in [-step, *step] {
                        let time = knots[knot] + step;
                        if time <= last + LEAST_GAP || time >= next - LEAST_GAP {
                            continue;
                        }
                        let now = self.squares_between([&before, &after[knot + 1]], [last, time, next]);
                        if now < best - 1e-6 {
                            best = now;
                            knots[knot] = time;
                        }
                    }
                    before = self.across(&before, [last, knots[knot]], 0);
                }
                if best == start {
                    break;
                }
            }
        }
        (knots, best)
    }

    /// Adds knots one by one, where they help most, until there are `most` or the next would help less than
    /// `gain`.
    pub fn grown(&self, knots: Option<Vec<f64>>, most: usize, gain: f64) -> Vec<f64> {
        const STEPS: [f64; 5] = [1600.0, 400.0, 130.0, 40.0, 12.0];
        let mut knots = knots.unwrap_or_else(|| self.ends().to_vec());
        let mut best = self.squares(&knots);
        while knots.len() < most {
            let Some(more) = self.with_another(&knots) else { break };
            let steps = if more.len() < 6 { &STEPS[..] } else { &STEPS[1..] };
            let (more, now) = self.moved(more, steps);
            let gained = best - now;
            if gained.is_nan() || gained < gain {
                break;
            }
            (knots, best) = (more, now);
        }
        knots
    }

    /// The knots and another where it helps most; none if there is no room.
    fn with_another(&self, knots: &[f64]) -> Option<Vec<f64>> {
        /// Distance in microseconds between the times that are tried, and their minimum distance from the
        /// ends and from other knots.
        const TRIED: f64 = 1000.0;
        const FROM_END: f64 = 500.0;
        const FROM_KNOT: f64 = 300.0;
        let [start, end] = self.ends();
        let times = (0..).map(|number| start + FROM_END + TRIED * f64::from(number));
        let times = times.take_while(|time| *time < end - FROM_END);
        let after = self.after(knots);
        let mut before = vec![Side::NONE];
        for pair in knots.windows(2) {
            before.push(self.across(&before[before.len() - 1], [pair[0], pair[1]], 0));
        }
        let tried =
            times.filter(|time| knots.iter().all(|knot| (knot - time).abs() > FROM_KNOT)).map(|time| {
                let next = knots.partition_point(|knot| *knot < time);
                let sides = [&before[next - 1], &after[next]];
                (self.squares_between(sides, [knots[next - 1], time, knots[next]]), next, time)
            });
        let (_, next, time) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let mut more = knots.to_vec();
        more.insert(next, time);
        Some(more)
    }
}
