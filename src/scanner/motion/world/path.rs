//! The path of the scanner through a sweep: linear between knots in time, as near as possible to the poses
//! that the firings imply.

use std::collections::HashMap;

use nalgebra::{Matrix6, Vector6};

use super::sweep::Vector;
use super::{Metric, between};

/// The position in metres, then the rotation in radians.
pub type Six = Vector6<f64>;

/// The information of a firing on its pose: the sum of squares is `squares - 2 d right + d normal d`, if the
/// pose differs by d from the current one.
#[derive(Clone, Copy)]
pub struct Told {
    pub normal: Matrix6<f64>,
    pub right: Six,
    pub squares: f64,
}

impl Default for Told {
    fn default() -> Self {
        Told { normal: Matrix6::zeros(), right: Six::zeros(), squares: 0.0 }
    }
}

/// The firings whose poses lie on a path.
#[derive(Clone, Copy)]
pub struct Firings<'a> {
    /// Times in microseconds.
    pub times: &'a [f64],
    pub poses: &'a [Six],
    pub told: &'a [Told],
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

/// The optimal poses of the knots, given their pieces, and the decrease of the sum of squares compared to
/// poses that are all 0.
fn solved(pieces: &[&Piece]) -> Option<(Vec<Six>, f64)> {
    /// Regularises knots without information, relative to the information on the others.
    const RIDGE: f64 = 1e-13;
    let knots = pieces.len() + 1;
    let mut diagonal = vec![Matrix6::zeros(); knots];
    let mut right = vec![Six::zeros(); knots];
    for (knot, piece) in pieces.iter().enumerate() {
        diagonal[knot] += piece.normal[0];
        diagonal[knot + 1] += piece.normal[2];
        right[knot] += piece.right[0];
        right[knot + 1] += piece.right[1];
    }
    let all = diagonal.iter().fold(Six::repeat(1e-6), |sum, block: &Matrix6<f64>| sum + block.diagonal());
    for block in &mut diagonal {
        for i in 0..6 {
            block[(i, i)] += all[i] * RIDGE;
        }
    }
    let whole = right.clone();
    let mut chol = Vec::with_capacity(knots);
    for knot in 0..knots {
        if knot > 0 {
            // Off the diagonal, the rows are those of the preceding knot.
            let off = &pieces[knot - 1].normal[1];
            let before: &nalgebra::Cholesky<f64, _> = &chol[knot - 1];
            let solved = before.solve(off);
            diagonal[knot] -= off.transpose() * solved;
            let change = solved.transpose() * right[knot - 1];
            right[knot] -= change;
        }
        chol.push(diagonal[knot].cholesky()?);
    }
    let mut poses = vec![Six::zeros(); knots];
    for knot in (0..knots).rev() {
        let mut rest = right[knot];
        if knot + 1 < knots {
            rest -= pieces[knot].normal[1] * poses[knot + 1];
        }
        poses[knot] = chol[knot].solve(&rest);
    }
    let less = whole.iter().zip(&poses).map(|(right, pose)| right.dot(pose)).sum();
    Some((poses, less))
}

impl<'a> Firings<'a> {
    /// The best path with these knots. With a lever, the path sags between knots as the preceding path
    /// implies.
    pub fn path(&self, knots: &[f64], sag: Option<(&Vector, &Path)>) -> Option<Path> {
        let mut before = sag.map(|(lever, path)| (*lever, path.clone()));
        let rounds = if sag.is_some() { 2 } else { 1 };
        for round in 0..rounds {
            let mut pieces = vec![Piece::new(); knots.len() - 1];
            for ((time, pose), told) in self.times.iter().zip(self.poses).zip(self.told) {
                let piece = piece_at(knots, *time);
                let part = (time - knots[piece]) / (knots[piece + 1] - knots[piece]);
                let mut from = *pose;
                if let Some((lever, path)) = &before {
                    from -= path.at(*time, lever) - path.at(*time, &Vector::zeros());
                }
                pieces[piece].add(part, &told.normal, &(told.right + told.normal * from));
            }
            let (poses, _) = solved(&pieces.iter().collect::<Vec<_>>())?;
            let path = Path { times: knots.to_vec(), poses };
            if round + 1 == rounds {
                return Some(path);
            }
            before = before.map(|(lever, _)| (lever, path));
        }
        None
    }
}

/// Searches for the times of knots.
pub struct KnotSearch<'a> {
    firings: Firings<'a>,
    /// The right-hand sides and the sum of squares, relative to a straight line through the whole sweep.
    right: Vec<Six>,
    squares: f64,
    pieces: HashMap<[u64; 2], Piece>,
}

/// Minimum time between knots, in microseconds.
const LEAST_GAP: f64 = 100.0;

impl<'a> KnotSearch<'a> {
    pub fn new(firings: Firings<'a>) -> Self {
        let last = firings.times.len() - 1;
        let (start, end) = (firings.times[0], firings.times[last]);
        let mut squares = 0.0;
        let right = (0..=last)
            .map(|number| {
                let (told, pose) = (&firings.told[number], firings.poses[number]);
                let part = (firings.times[number] - start) / (end - start);
                let off = pose - (firings.poses[0] * (1.0 - part) + firings.poses[last] * part);
                let push = told.normal * off;
                squares += told.squares + 2.0 * told.right.dot(&off) + push.dot(&off);
                told.right + push
            })
            .collect();
        KnotSearch { firings, right, squares, pieces: HashMap::new() }
    }

    fn ends(&self) -> [f64; 2] {
        [self.firings.times[0], self.firings.times[self.firings.times.len() - 1]]
    }

    /// The sum of squares with knots at these times.
    pub fn squares(&mut self, knots: &[f64]) -> f64 {
        let key = |pair: &[f64]| [pair[0].to_bits(), pair[1].to_bits()];
        for (number, pair) in knots.windows(2).enumerate() {
            if !self.pieces.contains_key(&key(pair)) {
                let times = self.firings.times;
                let from = if number == 0 { 0 } else { times.partition_point(|time| *time < pair[0]) };
                let is_last = number + 2 == knots.len();
                let to = if is_last { times.len() } else { times.partition_point(|time| *time < pair[1]) };
                let mut piece = Piece::new();
                for firing in from..to {
                    let part = (times[firing] - pair[0]) / (pair[1] - pair[0]);
                    piece.add(part, &self.firings.told[firing].normal, &self.right[firing]);
                }
                self.pieces.insert(key(pair), piece);
            }
        }
        let pieces: Vec<&Piece> = knots.windows(2).map(|pair| &self.pieces[&key(pair)]).collect();
        solved(&pieces).map_or(f64::INFINITY, |(_, less)| self.squares - less)
    }

    /// Moves knots by these steps, in microseconds, as long as that reduces the sum of squares.
    pub fn moved(&mut self, mut knots: Vec<f64>, steps: &[f64]) -> (Vec<f64>, f64) {
        const MOST_ROUNDS: usize = 4;
        let mut best = self.squares(&knots);
        for step in steps {
            for _ in 0..MOST_ROUNDS {
                let before = best;
                for knot in 1..knots.len() - 1 {
                    for step in [-step, *step] {
                        let time = knots[knot] + step;
                        if time <= knots[knot - 1] + LEAST_GAP || time >= knots[knot + 1] - LEAST_GAP {
                            continue;
                        }
                        let old = std::mem::replace(&mut knots[knot], time);
                        let now = self.squares(&knots);
                        if now < best - 1e-6 {
                            best = now;
                        } else {
                            knots[knot] = old;
                        }
                    }
                }
                if best == before {
                    break;
                }
            }
        }
        (knots, best)
    }

    /// Adds knots one by one, where they help most, until there are `most` or the next would help less than
    /// `gain`.
    pub fn grown(&mut self, knots: Option<Vec<f64>>, most: usize, gain: f64) -> Vec<f64> {
        /// Distance in microseconds between the times that are tried, and their minimum distance from the
        /// ends and from other knots.
        const TRIED: f64 = 1000.0;
        const FROM_END: f64 = 500.0;
        const FROM_KNOT: f64 = 300.0;
        const STEPS: [f64; 5] = [1600.0, 400.0, 130.0, 40.0, 12.0];
        let [start, end] = self.ends();
        let mut knots = knots.unwrap_or_else(|| vec![start, end]);
        let mut best = self.squares(&knots);
        while knots.len() < most {
            let places = (0..).map(|n| start + FROM_END + TRIED * f64::from(n));
            let places = places.take_while(|place| *place < end - FROM_END);
            let tried = places.filter(|place| knots.iter().all(|knot| (knot - place).abs() > FROM_KNOT));
            let with = |place: f64| {
                let mut more = knots.clone();
                more.insert(more.partition_point(|knot| *knot < place), place);
                more
            };
            let tried: Vec<Vec<f64>> = tried.map(with).collect();
            let found = tried.into_iter().map(|knots| (self.squares(&knots), knots));
            let Some((_, more)) = found.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
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
}
