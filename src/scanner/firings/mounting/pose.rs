//! Where a scanner is and how it is turned, from points alone.
//!
//! Points of a laser that follow one another in a file are near one another, whatever comes between them: they
//! are found as *trails*, without a channel that tells the lasers. All points of a laser lie on a cone, or
//! nearly, around the axis of the scanner; the apex of the cone is on the axis, but may be another for each
//! laser, as beams may start away from the axis. Planes through short pieces of trails, which meet near the
//! scanner, give a first estimate, and least squares on the cones of the trails the rest: at height z along
//! the axis and distance rho from it, `z = A rho + B`, with an A and a B for each trail. Trails need not be
//! whole: there are hundreds, and only the pose is common to all.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::scanner::{median, thinned};

/// The axis of a scanner, and where its beams start, in metres.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// A unit vector. Which end is up is not known.
    pub axis: Vector3<f64>,
    /// The point of the axis from whose height the beams start.
    pub apex: Vector3<f64>,
    /// How far from the axis the beams start, each in its direction; 0 if they start on it.
    pub along: f64,
}

/// Fewest planes that determine a pose.
const FEWEST: usize = 20;
/// Number of points, or of planes, that are used.
const SAMPLE: usize = 4000;
/// In radians: the largest median distance of the points from their cones.
const ON_CONE: f64 = 3e-5;

/// The pose of the scanner that measured these points, which are in the order of the file; `rows` has the
/// same points row after row, if a channel tells the rows. `None` if none is found.
pub fn find(points: &[Vector3<f64>], rows: Option<&[Vector3<f64>]>) -> Option<Pose> {
    /// About by how many radians scanners turn until a laser fires again. Firings may have been left out.
    const TURNED: [f64; 3] = [6e-3, 2e-2, 6e-2];
    /// Metres: nearer points are left out, as trails lead them astray, unless there are few others.
    const NEAREST: [f64; 3] = [2.0, 1.0, 0.5];
    /// Numbers of neighbouring points of a trail through which a plane is laid.
    const OF_PLANES: [usize; 4] = [16, 8, 32, 64];
    /// In radians: the median distance of points from the cones of a pose that is certainly right. Rounding
    /// to millimetres leaves more.
    const SURE: f64 = 1e-6;
    /// If the distances of two poses that were found differ by no more than this part, they are the same.
    const SAME: f64 = 0.05;
    let mut best: Option<(Pose, f64)> = None;
    let orders = [Some(points), rows].into_iter().flatten();
    for (points, turned) in orders.flat_map(|points| TURNED.map(|turned| (points, turned))) {
        // Most points are near the scanner.
        let middle = [0, 1, 2].map(|axis| median(thinned(points, SAMPLE).map(|point| point[axis])));
        let middle = Vector3::from(middle);
        let trails = trails(points, &middle, turned);
        for nearest in NEAREST {
            let far = beyond(nearest, &middle, &trails);
            for start in OF_PLANES.into_iter().filter_map(|count| from_planes(&far, count)) {
                let next = refined(start, &beyond(nearest, &start.apex, &trails), SAMPLE);
                let next = next.map(|(pose, left)| {
                    let all = beyond(nearest, &pose.apex, &trails);
                    let by_more = if left < ON_CONE { refined(pose, &all, 4 * SAMPLE) } else { None };
                    by_more.unwrap_or((pose, left))
                });
                let Some((pose, left)) = next else { continue };
                if left < SURE || best.is_some_and(|(_, other)| (left - other).abs() < SAME * other) {
                    return (left < ON_CONE).then_some(pose);
                }
                best = best.filter(|(_, other)| *other < left).or(next);
            }
            if 2 * far.iter().map(Vec::len).sum::<usize>() > points.len() {
                break;
            }
        }
    }
    best.filter(|(_, left)| *left < ON_CONE).map(|(pose, _)| pose)
}

/// The points of trails that are at least so many metres from another, of trails with enough of them.
fn beyond(nearest: f64, from: &Vector3<f64>, trails: &[Trail]) -> Vec<Trail> {
    const FEWEST: usize = 30;
    let far = |trail: &Trail| -> Trail {
        trail.iter().filter(|point| (*point - from).norm() > nearest).copied().collect()
    };
    trails.iter().filter(|trail| trail.len() >= FEWEST).map(far).filter(|far| far.len() >= FEWEST).collect()
}

/// A trail: points that were probably measured by one laser, one after the other.
type Trail = Vec<Vector3<f64>>;

/// The trails of points in the order of a file. `turned`: how far the next point of a trail may be, as a part
/// of the distance from the middle of all points.
fn trails(points: &[Vector3<f64>], middle: &Vector3<f64>, turned: f64) -> Vec<Trail> {
    /// A sufficient number of points.
    const MOST: usize = 50_000;
    /// In metres: what is nearer is near in any case.
    const NEAR: f64 = 0.02;
    /// Number of points after which a trail is given up, when another one begins.
    const PATIENCE: usize = 400;
    /// Number of points after which those to be given up are looked for again.
    const INTERVAL: usize = 50;
    let points = &points[..points.len().min(MOST)];
    let mut trails: Vec<Trail> = Vec::new();
    let mut ends = Ends::default();
    let mut next = INTERVAL;
    for (number, point) in points.iter().enumerate() {
        let from_middle = point - middle;
        let reach = NEAR + turned * from_middle.norm();
        let place = from_middle.map(|metres| metres as f32);
        match ends.nearest(&place).filter(|(_, square)| f64::from(*square) < reach * reach) {
            Some((end, _)) => {
                trails[ends.trails[end].0].push(*point);
                ends.set(end, &place, number);
            }
            None => {
                if number >= next {
                    ends.give_up(number.saturating_sub(PATIENCE));
                    next = number + INTERVAL;
                }
                ends.push(&place, (trails.len(), number));
                trails.push(vec![*point]);
            }
        }
    }
    trails
}

/// The last point of each trail that is not given up, coordinate by coordinate.
#[derive(Default)]
struct Ends {
    coordinates: [Vec<f32>; 3],
    /// Of each: the trail, and the number of the point.
    trails: Vec<(usize, usize)>,
    /// Squares of distances, kept for their memory.
    squares: Vec<f32>,
}

impl Ends {
    /// The first of the ends nearest to a point, and the square of its distance.
    fn nearest(&mut self, point: &Vector3<f32>) -> Option<(usize, f32)> {
        const LANES: usize = 8;
        let [x, y, z] = &self.coordinates;
        let square = |((x, y), z): ((&f32, &f32), &f32)| {
            let (x, y, z) = (x - point.x, y - point.y, z - point.z);
            x * x + y * y + z * z
        };
        self.squares.clear();
        self.squares.extend(x.iter().zip(y).zip(z).map(square));
        let lesser = |a: f32, b: f32| if b < a { b } else { a };
        let (whole, rest) = self.squares.as_chunks::<LANES>();
        let lanes = whole.iter().fold([f32::INFINITY; LANES], |mut least, squares| {
            least.iter_mut().zip(squares).for_each(|(least, square)| *least = lesser(*least, *square));
            least
        });
        let least = lanes.iter().chain(rest).copied().fold(f32::INFINITY, lesser);
        let place = self.squares.iter().position(|square| *square == least)?;
        Some((place, least))
    }

    fn set(&mut self, place: usize, point: &Vector3<f32>, number: usize) {
        self.coordinates.iter_mut().zip(point).for_each(|(values, value)| values[place] = *value);
        self.trails[place].1 = number;
    }

    fn push(&mut self, point: &Vector3<f32>, trail: (usize, usize)) {
        self.coordinates.iter_mut().zip(point).for_each(|(values, value)| values.push(*value));
        self.trails.push(trail);
    }

    /// Removes those whose points are before this number.
    fn give_up(&mut self, number: usize) {
        for values in &mut self.coordinates {
            let mut trails = self.trails.iter();
            values.retain(|_| trails.next().is_some_and(|(_, last)| *last >= number));
        }
        self.trails.retain(|(_, last)| *last >= number);
    }
}

/// A plane through neighbouring points.
struct Plane {
    normal: Vector3<f64>,
    middle: Vector3<f64>,
}

impl Plane {
    /// The distance of a point, in metres.
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.normal.dot(&(self.middle - point)).abs()
    }
}

/// The planes through so many neighbouring points of a trail each, where these determine one.
fn planes(windows: &[&[Vector3<f64>]]) -> Vec<Plane> {
    /// Square metres: points must spread in a second direction, by more than roundings,
    const WIDE: f64 = 1e-4;
    /// and relative to the first, by more than a row is curved,
    const STRAIGHT: f64 = 1e-3;
    /// but not in the third, relative to the second.
    const FLAT: f64 = 0.02;
    let planes = thinned(windows, SAMPLE).filter_map(|window| {
        let (middle, spread) = moments(window);
        let eigen = spread.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [least, second, most] = order.map(|place| eigen.eigenvalues[place]);
        let normal = eigen.eigenvectors.column(order[0]).into_owned();
        (second > WIDE.max(STRAIGHT * most) && least < FLAT * second).then_some(Plane { normal, middle })
    });
    planes.collect()
}

/// The mean of some points, and their covariance.
fn moments(points: &[Vector3<f64>]) -> (Vector3<f64>, Matrix3<f64>) {
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let spread = points.iter().map(|point| (point - middle) * (point - middle).transpose());
    (middle, spread.sum::<Matrix3<f64>>() / points.len() as f64)
}

/// The eigenvector of the least eigenvalue.
fn least_direction(matrix: Matrix3<f64>) -> Vector3<f64> {
    let eigen = matrix.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
}

/// About the pose, by planes through so many neighbouring points of trails: they meet in a point of the axis,
/// from which the directions of a trail lie on a cone around it.
fn from_planes(trails: &[Trail], count: usize) -> Option<Pose> {
    /// Iterations of least squares in which what deviates gets less weight.
    const ROUNDS: usize = 20;
    /// Metres, and sines of angles: what deviates by less has equal weight.
    const NEAR: f64 = 0.01;
    const SMALL: f64 = 3e-3;
    /// Metres: nearer points tell no direction.
    const NEAREST: f64 = 0.3;
    let windows: Vec<&[Vector3<f64>]> = trails.iter().flat_map(|trail| trail.chunks_exact(count)).collect();
    let planes = planes(&windows);
    if planes.len() < FEWEST {
        return None;
    }
    let mut weights = vec![1.0; planes.len()];
    let mut apex = Vector3::zeros();
    for _ in 0..ROUNDS {
        let (mut system, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (plane, weight) in planes.iter().zip(&weights) {
            system += plane.normal * plane.normal.transpose() * *weight;
            right += plane.normal * (plane.normal.dot(&plane.middle) * weight);
        }
        apex = system.cholesky()?.solve(&right);
        for (plane, weight) in planes.iter().zip(&mut weights) {
            *weight = 1.0 / (plane.distance(&apex) + NEAR);
        }
    }
    let spreads = thinned(&windows, SAMPLE / 4).map(|window| {
        let directions: Vec<Vector3<f64>> =
            window.iter().filter_map(|point| (point - apex).try_normalize(NEAREST)).collect();
        moments(&directions).1
    });
    let spreads: Vec<Matrix3<f64>> = spreads.filter(|spread| spread.iter().all(|v| v.is_finite())).collect();
    let mut axis = Vector3::z();
    let mut weights = vec![1.0; spreads.len()];
    for _ in 0..ROUNDS {
        axis = least_direction(spreads.iter().zip(&weights).map(|(spread, weight)| spread * *weight).sum());
        for (spread, weight) in spreads.iter().zip(&mut weights) {
            *weight = 1.0 / (axis.dot(&(spread * axis)).max(0.0).sqrt() + SMALL);
        }
    }
    Some(Pose { axis, apex, along: 0.0 })
}

/// The pose for which the points of each trail lie on a cone, and their median distance from it, in radians, if
/// there is one near this pose. `most`: about how many points are used.
fn refined(mut pose: Pose, trails: &[Trail], most: usize) -> Option<(Pose, f64)> {
    const MOST_ROUNDS: usize = 30;
    /// Rounds, and the median distance from the cones, in radians, that a good start leaves after them.
    const SOON: [(usize, f64); 2] = [(6, 3e-3), (12, 3e-4)];
    /// Radians, or metres: a smaller step is the last.
    const LEAST: f64 = 1e-9;
    /// Number of trails that are enough, and fewest points of a trail that are used.
    const FEWEST_TRAILS: usize = 60;
    const FEWEST_USED: usize = 8;
    let all: usize = trails.iter().map(Vec::len).sum();
    // Some trails, or if there are few, some points of each.
    let of_trails = (all / most).min(trails.len() / FEWEST_TRAILS).max(1);
    let of_points = (all / of_trails / most).max(1);
    let used = |trail: &Trail| trail.iter().step_by(of_points).copied().collect::<Trail>();
    let trails = trails.iter().step_by(of_trails).map(used);
    let trails: Vec<Trail> = trails.filter(|trail| trail.len() >= FEWEST_USED).collect();
    let mut weights: Vec<Vec<f64>> = trails.iter().map(|trail| vec![1.0; trail.len()]).collect();
    for round in 0..MOST_ROUNDS {
        let (step, left) = step(&pose, &trails, &mut weights)?;
        pose = pose.changed_by(&step);
        if SOON.iter().any(|(soon, most)| round == *soon && left > *most) {
            return None;
        }
        if step.amax() < LEAST || round + 1 == MOST_ROUNDS {
            let pose = pose.with_start(&trails, &weights);
            return pose.apex.iter().all(|metres| metres.is_finite()).then_some((pose, left));
        }
    }
    None
}

/// The unknowns: rotations of the axis towards two directions across it, and shifts along these.
const UNKNOWNS: usize = 4;

/// A point as seen from a pose: its height along the axis, its distance from it, and what a step adds to by
/// how much it is higher than its cone.
struct Sighted {
    height: f64,
    distance: f64,
    slopes: SVector<f64, UNKNOWNS>,
}

impl Pose {
    /// `slope` is that of the cone.
    fn sighted(&self, point: &Vector3<f64>, slope: f64) -> Sighted {
        let from = point - self.apex;
        let height = from.dot(&self.axis);
        let outward = from - self.axis * height;
        let distance = outward.norm();
        let outward = outward / distance;
        let [one, other] = across(&self.axis);
        let tilts = [from.dot(&one), from.dot(&other)].map(|along| along * (1.0 + slope * height / distance));
        let shifts = [outward.dot(&one), outward.dot(&other)].map(|along| along * slope);
        Sighted { height, distance, slopes: [tilts[0], tilts[1], shifts[0], shifts[1]].into() }
    }

    /// The pose after a step, which is kept short.
    fn changed_by(&self, step: &SVector<f64, UNKNOWNS>) -> Self {
        /// Radians, and metres.
        const FARTHEST: f64 = 0.2;
        let step = step.map(|value| value.clamp(-FARTHEST, FARTHEST));
        let [one, other] = across(&self.axis);
        Pose {
            axis: (self.axis + one * step[0] + other * step[1]).normalize(),
            apex: self.apex + one * step[2] + other * step[3],
            ..*self
        }
    }

    /// The pose with the start of the beams: at the height `up` and the distance `along` from the axis, all
    /// cones have `B = up - A along`.
    fn with_start(&self, trails: &[Trail], weights: &[Vec<f64>]) -> Self {
        const ROUNDS: usize = 10;
        /// Metres: what deviates by less has equal weight; beams that start nearer to the axis start on it.
        const NEAR: f64 = 1e-5;
        const ON_AXIS: f64 = 1e-4;
        /// Slopes of steeper cones are known less well.
        const STEEPEST: f64 = 2.0;
        let cones = trails.iter().zip(weights).filter_map(|(trail, weights)| {
            let points = trail.iter().map(|point| self.sighted(point, 0.0));
            let line =
                Line::of(points.map(|seen| (seen.distance, seen.height)).zip(weights.iter().copied()))?;
            (line.slope.abs() < STEEPEST).then_some(((line.slope, line.start), trail.len() as f64))
        });
        let cones: Vec<Weighted> = cones.collect();
        let fitted = |fit: fn(&[Weighted]) -> Line| {
            let mut weighted = cones.clone();
            let mut start = Line::default();
            for _ in 0..ROUNDS {
                start = fit(&weighted);
                for (((slope, height), weight), (_, points)) in weighted.iter_mut().zip(&cones) {
                    *weight = points / (start.above(*slope, *height).abs() + NEAR);
                }
            }
            start
        };
        let start = fitted(|cones| Line::of(cones.iter().copied()).unwrap_or_default());
        let start = match start.slope.abs() < ON_AXIS {
            true => fitted(|cones| {
                let sums = cones.iter().map(|((_, height), weight)| (height * weight, *weight));
                let (height, weight) = sums.fold((0.0, 0.0), |sum, next| (sum.0 + next.0, sum.1 + next.1));
                Line { slope: 0.0, start: height / weight }
            }),
            false => start,
        };
        Pose { apex: self.apex + self.axis * start.start, along: 0.0 - start.slope, ..*self }
    }
}

/// A point of two coordinates, and its weight.
type Weighted = ((f64, f64), f64);

/// A line `y = slope x + start`.
#[derive(Clone, Copy, Default)]
struct Line {
    slope: f64,
    start: f64,
}

impl Line {
    /// The line nearest to some points, each with a weight.
    fn of(points: impl Iterator<Item = Weighted> + Clone) -> Option<Self> {
        let weight: f64 = points.clone().map(|(_, weight)| weight).sum();
        let mean = |of: fn((f64, f64)) -> f64| {
            points.clone().map(|(point, weight)| weight * of(point)).sum::<f64>() / weight
        };
        let (x, y) = (mean(|point| point.0), mean(|point| point.1));
        let products =
            points.map(|((a, b), weight)| (weight * (a - x) * (a - x), weight * (a - x) * (b - y)));
        let (square, product) = products.fold((0.0, 0.0), |sum, next| (sum.0 + next.0, sum.1 + next.1));
        let slope = product / square;
        slope.is_finite().then_some(Line { slope, start: y - slope * x })
    }

    /// By how much a point is above it.
    fn above(&self, x: f64, y: f64) -> f64 {
        y - self.slope * x - self.start
    }
}

/// The lines of the heights of a trail's points, and of each of their slopes, by distance from the axis.
fn lines(seen: &[Sighted], weights: &[f64]) -> [Line; 1 + UNKNOWNS] {
    let points = || seen.iter().zip(weights);
    let weight: f64 = weights.iter().sum();
    let middle = points().map(|(seen, weight)| weight * seen.distance).sum::<f64>() / weight;
    let mut square = 0.0;
    // Of each line: the sums of values, and of their products with distances.
    let mut sums = [[0.0; 2]; 1 + UNKNOWNS];
    for (seen, weight) in points() {
        let off = seen.distance - middle;
        square += weight * off * off;
        let slopes = &seen.slopes;
        for (sum, value) in sums.iter_mut().zip([seen.height, slopes[0], slopes[1], slopes[2], slopes[3]]) {
            *sum = [sum[0] + weight * value, sum[1] + weight * off * value];
        }
    }
    sums.map(|[sum, product]| {
        let slope = product / square;
        if slope.is_finite() { Line { slope, start: sum / weight - slope * middle } } else { Line::default() }
    })
}

/// A step of least squares towards a pose from which each trail lies on a cone of its own, given the weights
/// of the points, which it brings up to date. Returns the change, and the median of what deviations are left,
/// in radians.
fn step(pose: &Pose, trails: &[Trail], weights: &mut [Vec<f64>]) -> Option<(SVector<f64, UNKNOWNS>, f64)> {
    /// Iterations in which what deviates gets less weight.
    const ROUNDS: usize = 3;
    const RIDGE: f64 = 1e-9;
    /// Radians: the least median deviation.
    const LEAST: f64 = 1e-8;
    type Row = SVector<f64, UNKNOWNS>;
    let seen: Vec<Vec<Sighted>> = trails
        .iter()
        .zip(&*weights)
        .map(|(trail, weights)| {
            let flat = trail.iter().map(|point| pose.sighted(point, 0.0));
            let heights = flat.map(|seen| (seen.distance, seen.height)).zip(weights.iter().copied());
            let slope = Line::of(heights).map_or(0.0, |line| line.slope);
            trail.iter().map(|point| pose.sighted(point, slope)).collect()
        })
        .collect();
    let (mut change, mut middle) = (Row::zeros(), f64::INFINITY);
    for _ in 0..ROUNDS {
        // The cone of each trail is eliminated.
        let (mut system, mut right) = (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), Row::zeros());
        let mut rows: Vec<Vec<(f64, Row)>> = Vec::with_capacity(seen.len());
        for (seen, weights) in seen.iter().zip(&*weights) {
            let [height, slopes @ ..] = lines(seen, weights);
            let of_trail = seen.iter().map(|seen| {
                let row =
                    [0, 1, 2, 3].map(|unknown| slopes[unknown].above(seen.distance, seen.slopes[unknown]));
                (height.above(seen.distance, seen.height), Row::from(row))
            });
            let of_trail: Vec<(f64, Row)> = of_trail.collect();
            for ((miss, row), weight) in of_trail.iter().zip(weights) {
                system += row * row.transpose() * *weight;
                right -= row * (miss * weight);
            }
            rows.push(of_trail);
        }
        (0..UNKNOWNS).for_each(|place| system[(place, place)] *= 1.0 + RIDGE);
        change = system.cholesky()?.solve(&right);
        let left = |(miss, row): &(f64, Row), seen: &Sighted| (miss + row.dot(&change)).abs() / seen.distance;
        let pairs = rows.iter().flatten().zip(seen.iter().flatten());
        middle = median(pairs.map(|(row, seen)| left(row, seen)));
        for ((rows, seen), weights) in rows.iter().zip(&seen).zip(weights.iter_mut()) {
            for ((row, seen), weight) in rows.iter().zip(seen).zip(weights) {
                let least = 0.1 * middle.max(LEAST);
                *weight = (left(row, seen) / least + 1.0).recip() / (seen.distance * seen.distance);
            }
        }
    }
    change.iter().all(|value| value.is_finite()).then_some((change, middle))
}

/// Two directions across another, all at right angles.
pub(super) fn across(axis: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let aside = if axis.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let one = axis.cross(&aside).normalize();
    [one, axis.cross(&one)]
}
