//! Where a scanner is and how it is turned, from points alone.
//!
//! Neighbouring points of a file were measured by neighbouring beams, whose plane passes through the scanner:
//! - Points of a row follow one another: planes of all directions meet in the point where the beams start
//!   (the apex), and the directions of a row lie on a cone around the axis.
//! - Points of a firing follow one another: all planes contain the axis. Where on the axis beams start is
//!   where elevations form heaps, or, if many points are near, where the planes meet. If azimuth offsets bend
//!   the firings, planes do not contain the axis, but still meet in the apex; the axis is then that for which
//!   elevations form heaps.
//!
//! Such a first estimate is good to a thousandth; the cones of the lasers, which it then tells apart, give
//! the rest.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::scanner::thinned;

/// The axis of a scanner, and the point where its beams start, in metres.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// A unit vector. Which end is up is not known.
    pub axis: Vector3<f64>,
    pub apex: Vector3<f64>,
}

/// Fewest planes, and fewest points, that determine a pose.
const FEWEST: usize = 20;
/// Number of points, or of planes, that are used.
const SAMPLE: usize = 4000;
/// Smallest share of points that must be in heaps of elevations.
const LEAST_SHARE: f64 = 0.5;
/// In radians: the largest median distance of the points from their cones.
const ON_CONE: f64 = 3e-5;
/// In radians: how far off a pose that was found with fewer points may be.
const FOUND: f64 = 2e-4;
/// In metres, and as a sine: the largest median distances of the scanner from planes, and of its axis from
/// their directions.
const NEAR_PLANES: f64 = 0.06;
const IN_PLANES: f64 = 0.01;

/// The pose of the scanner that measured these points; `rows` has the same points row after row, if a channel
/// tells the rows. `None` if none is found.
pub fn find(points: &[Vector3<f64>], rows: Option<&[Vector3<f64>]>) -> Option<Pose> {
    /// Numbers of neighbouring points through which a plane is laid.
    const OF_ROWS: [usize; 3] = [16, 8, 32];
    const OF_FIRINGS: [usize; 3] = [12, 16, 32];
    /// In radians: half the distance between two lasers, at first.
    const APART: [f64; 3] = [6e-3, 3e-3, 1.5e-3];
    let sample: Vec<Vector3<f64>> = thinned(points, SAMPLE).copied().collect();
    let few: Vec<Vector3<f64>> = thinned(&sample, SAMPLE / 2).copied().collect();
    // Many scanners stand upright, and many clouds were moved by little.
    let upright = Pose { axis: Vector3::z(), apex: Vector3::zeros() };
    let usual = [upright, along_axis(upright, &sample)].into_iter();
    let refined_from = |start: Pose| {
        APART.into_iter().find_map(|apart| {
            let far = || farthest(&sample, &start.apex);
            refined(start, &few, apart).or_else(|| refined(start, &far(), apart))
        })
    };
    let from_any = |starts: Vec<Pose>| distinct(starts).into_iter().find_map(refined_from);
    let from_neighbours = || {
        let orders = rows.into_iter().chain([points]);
        let of_rows = orders.flat_map(|points| OF_ROWS.map(|count| from_rows(points, count)));
        let of_rows: Vec<Pose> = of_rows.flatten().collect();
        let of_firings = OF_FIRINGS.into_iter().filter_map(|count| from_firings(points, count));
        let of_firings = of_firings.flat_map(|firings| {
            // Rows tell the place along the axis, too.
            let places = of_rows.iter().map(move |rows| Pose { axis: firings.axis, apex: rows.apex });
            std::iter::once(along_axis(firings, &sample)).chain(places)
        });
        from_any(of_rows.iter().copied().chain(of_firings).collect()).or_else(|| {
            let upright = distinct(of_rows.iter().map(|rows| Pose { axis: Vector3::z(), ..*rows }).collect());
            let tilted = upright.iter().map(|pose| tilted(pose.apex, &farthest(&sample, &pose.apex)));
            tilted.into_iter().find_map(refined_from)
        })
    };
    usual
        .into_iter()
        .find_map(refined_from)
        .or_else(from_neighbours)
        .and_then(|pose| refined(pose, &sample, FOUND))
}

/// Poses without those that are nearly the same as an earlier one.
fn distinct(poses: Vec<Pose>) -> Vec<Pose> {
    /// In metres, and as a sine.
    const NEAR: f64 = 0.02;
    const ALONG: f64 = 3e-3;
    let mut distinct: Vec<Pose> = Vec::new();
    for pose in poses {
        let is_same = |other: &Pose| {
            (pose.apex - other.apex).norm() < NEAR && pose.axis.cross(&other.axis).norm() < ALONG
        };
        if !distinct.iter().any(is_same) {
            distinct.push(pose);
        }
    }
    distinct
}

/// The quarter of some points that is farthest from a point. If the place of the scanner is known to
/// centimetres only, the elevations of near points are wrong by several lasers.
fn farthest(points: &[Vector3<f64>], from: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| (b - from).norm_squared().total_cmp(&(a - from).norm_squared()));
    sorted.truncate(points.len() / 4);
    sorted
}

/// The pose with this apex whose axis is nearly upright, such that the elevations of some points form the
/// highest heaps.
fn tilted(apex: Vector3<f64>, points: &[Vector3<f64>]) -> Pose {
    /// In radians, and steps.
    const STEP: f64 = 5e-3;
    const FARTHEST: i32 = 40;
    /// The sine of a heap's width.
    const WIDE: f64 = 6e-3;
    let directions: Vec<Vector3<f64>> =
        points.iter().filter_map(|point| (point - apex).try_normalize(0.0)).collect();
    let tilts = (-FARTHEST..=FARTHEST).flat_map(|x| (-FARTHEST..=FARTHEST).map(move |y| [x, y]));
    let axes = tilts.map(|tilt| {
        let [x, y] = tilt.map(|steps| f64::from(steps) * STEP);
        Vector3::new(x, y, 1.0).normalize()
    });
    let height = |axis: &Vector3<f64>| {
        let mut heaps = [0u32; (2.0 / WIDE) as usize + 2];
        directions.iter().for_each(|direction| heaps[((direction.dot(axis) + 1.0) / WIDE) as usize] += 1);
        heaps.into_iter().map(|count| u64::from(count * count)).sum::<u64>()
    };
    Pose { axis: axes.max_by_key(height).unwrap_or_else(Vector3::z), apex }
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

/// The median of some values; infinite if there are none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The planes through so many neighbouring points each, where these determine one.
fn planes(points: &[Vector3<f64>], count: usize) -> Vec<Plane> {
    /// Square metres: points must spread in a second direction, by more than roundings,
    const WIDE: f64 = 1e-4;
    /// and relative to the first, by more than a row is curved,
    const STRAIGHT: f64 = 1e-3;
    /// but not in the third, relative to the second.
    const FLAT: f64 = 0.02;
    let windows: Vec<&[Vector3<f64>]> = points.chunks_exact(count).collect();
    let planes = thinned(&windows, SAMPLE).filter_map(|window| {
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

/// Number of iterations of least squares in which what deviates gets less weight.
const ROUNDS: usize = 20;

/// The pose if neighbouring points belong to one row; its apex is right if they belong to one firing, too.
fn from_rows(points: &[Vector3<f64>], count: usize) -> Option<Pose> {
    /// Metres, and sines of angles: what deviates by less has equal weight.
    const NEAR: f64 = 0.01;
    const SMALL: f64 = 3e-3;
    /// Metres: nearer points tell no direction.
    const NEAREST: f64 = 0.3;
    let planes = planes(points, count);
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
    if median(planes.iter().map(|plane| plane.distance(&apex))) > NEAR_PLANES {
        return None;
    }
    let windows: Vec<&[Vector3<f64>]> = points.chunks_exact(count).collect();
    let windows: Vec<&[Vector3<f64>]> = thinned(&windows, SAMPLE / 4).copied().collect();
    let directions = windows.iter().map(|window| {
        let directions: Vec<Vector3<f64>> =
            window.iter().filter_map(|point| (point - apex).try_normalize(NEAREST)).collect();
        moments(&directions).1
    });
    let spreads: Vec<Matrix3<f64>> =
        directions.filter(|spread| spread.iter().all(|v| v.is_finite())).collect();
    let mut axis = Vector3::z();
    let mut weights = vec![1.0; spreads.len()];
    for _ in 0..ROUNDS {
        axis = least_direction(spreads.iter().zip(&weights).map(|(spread, weight)| spread * *weight).sum());
        for (spread, weight) in spreads.iter().zip(&mut weights) {
            *weight = 1.0 / (axis.dot(&(spread * axis)).max(0.0).sqrt() + SMALL);
        }
    }
    Some(Pose { axis, apex })
}

/// The pose if neighbouring points belong to one firing: the apex is any point of the axis.
fn from_firings(points: &[Vector3<f64>], count: usize) -> Option<Pose> {
    /// Sines of angles, and metres.
    const SMALL: f64 = 0.01;
    const NEAR: f64 = 0.02;
    let planes = planes(points, count);
    if planes.len() < FEWEST {
        return None;
    }
    let weighted = |weights: &[f64]| -> Matrix3<f64> {
        planes
            .iter()
            .zip(weights)
            .map(|(plane, weight)| plane.normal * plane.normal.transpose() * *weight)
            .sum()
    };
    let mut axis = Vector3::z();
    let mut weights = vec![1.0; planes.len()];
    for _ in 0..ROUNDS {
        axis = least_direction(weighted(&weights));
        for (plane, weight) in planes.iter().zip(&mut weights) {
            *weight = 1.0 / (plane.normal.dot(&axis).abs() + SMALL);
        }
    }
    let mut apex = Vector3::zeros();
    let of_axis = weights.clone();
    for _ in 0..ROUNDS {
        // The part along the axis, which the planes leave open, is 0.
        let system = weighted(&weights);
        let free = axis * axis.transpose() * system.trace();
        let products = planes.iter().zip(&weights);
        let right: Vector3<f64> =
            products.map(|(plane, weight)| plane.normal * (plane.normal.dot(&plane.middle) * weight)).sum();
        let across = Matrix3::identity() - axis * axis.transpose();
        apex = (across * system * across + free).cholesky()?.solve(&(across * right));
        for ((plane, weight), of_axis) in planes.iter().zip(&mut weights).zip(&of_axis) {
            *weight = of_axis / (plane.distance(&apex) + NEAR);
        }
    }
    let is_in_planes = median(planes.iter().map(|plane| plane.normal.dot(&axis).abs())) < IN_PLANES;
    let is_near_planes = median(planes.iter().map(|plane| plane.distance(&apex))) < NEAR_PLANES;
    (is_in_planes && is_near_planes).then_some(Pose { axis, apex })
}

/// The pose with the apex where elevations form the highest heaps.
fn along_axis(pose: Pose, sample: &[Vector3<f64>]) -> Pose {
    /// Metres above and below points near the axis, and from trial to trial.
    const FARTHEST: f64 = 5.0;
    const STEP: f64 = 0.02;
    /// Radians of a heap.
    const WIDE: f64 = 4e-3;
    /// The part of the points that counts as near the axis.
    const NEAR: usize = 10;
    let few: Vec<Vector3<f64>> = thinned(sample, SAMPLE / 2).copied().collect();
    let mut by_distance: Vec<[f64; 2]> = few
        .iter()
        .map(|point| {
            let (from, along) = (point - pose.apex, (point - pose.apex).dot(&pose.axis));
            [(from - pose.axis * along).norm(), along]
        })
        .collect();
    by_distance.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let middle = median(by_distance[..few.len() / NEAR].iter().map(|[_, along]| *along));
    let places = (FARTHEST / STEP) as i32;
    let poses = (-places..=places).map(|place| {
        let along = middle + f64::from(place) * STEP;
        Pose { apex: pose.apex + pose.axis * along, ..pose }
    });
    let height = |pose: &Pose| {
        let mut heaps = vec![0u32; (std::f64::consts::PI / WIDE) as usize + 1];
        for point in &few {
            let elevation = pose.sighted(point).elevation + std::f64::consts::FRAC_PI_2;
            if let Some(heap) = heaps.get_mut((elevation / WIDE) as usize) {
                *heap += 1;
            }
        }
        heaps.into_iter().map(|count| u64::from(count * count)).sum::<u64>()
    };
    poses.max_by_key(height).unwrap_or(pose)
}

/// A point as seen from a pose.
struct Sighted {
    /// In metres.
    range: f64,
    /// In radians; NaN at the apex.
    elevation: f64,
    direction: Vector3<f64>,
}

impl Pose {
    fn sighted(&self, point: &Vector3<f64>) -> Sighted {
        let from = point - self.apex;
        let range = from.norm();
        let direction = from / range;
        Sighted { range, elevation: libm::asin(direction.dot(&self.axis).clamp(-1.0, 1.0)), direction }
    }
}

/// The pose for which the points of each laser lie on a cone, if there is one near a pose that is right to
/// less than half of `apart`, the distance of lasers in radians.
fn refined(mut pose: Pose, sample: &[Vector3<f64>], apart: f64) -> Option<Pose> {
    const MOST_ROUNDS: usize = 40;
    /// The round by which the lasers of a right start are known.
    const SOON: usize = 10;
    /// Below this width of heaps, in radians, the lasers are known.
    const KNOWN: f64 = 2e-4;
    /// What the rounding of coordinates leaves.
    const LEAST: f64 = 2e-6;
    let mut wide = apart;
    let mut lasers: Vec<f64> = Vec::new();
    for round in 0..MOST_ROUNDS {
        let seen: Vec<Sighted> = sample.iter().map(|point| pose.sighted(point)).collect();
        if wide > KNOWN || lasers.is_empty() {
            lasers = heaps(&seen, wide);
        }
        let of_lasers = nearest_of(&lasers, &seen, 1.5 * wide);
        let inside = of_lasers.iter().flatten().count();
        if lasers.len() < 3 || inside < FEWEST {
            return None;
        }
        let (step, left, means) = step(&pose, &seen, &of_lasers, lasers.len(), wide)?;
        pose = pose.changed_by(&step);
        lasers = means;
        if wide <= LEAST || round + 1 == MOST_ROUNDS {
            let is_found = left < ON_CONE && inside as f64 > LEAST_SHARE * sample.len() as f64;
            return is_found.then_some(pose);
        }
        if round == SOON && wide > KNOWN {
            return None;
        }
        if round > 2 {
            wide = (0.9 * wide).min(4.0 * left).max(LEAST);
        }
    }
    None
}

/// The elevations at which there are most points, in ascending order.
fn heaps(seen: &[Sighted], wide: f64) -> Vec<f64> {
    /// Bins to the width of a heap.
    const FINE: f64 = 4.0;
    /// Fewest points of a heap, and the part of a high heap that a low one has.
    const FEWEST: f64 = 8.0;
    const LOW: f64 = 0.1;
    let bin = |elevation: f64| ((elevation + std::f64::consts::FRAC_PI_2) / wide * FINE) as usize;
    let mut counts = vec![0.0; bin(std::f64::consts::FRAC_PI_2) + 2];
    seen.iter().filter(|seen| !seen.elevation.is_nan()).for_each(|seen| counts[bin(seen.elevation)] += 1.0);
    let kernel: Vec<f64> = (-8..=8).map(|off| libm::exp(-0.5 * (f64::from(off) / FINE).powi(2))).collect();
    let smooth: Vec<f64> = (0..counts.len())
        .map(|at| {
            let near = (0..kernel.len())
                .filter_map(|off| Some(counts.get((at + off).checked_sub(8)?)? * kernel[off]));
            near.sum()
        })
        .collect();
    let mut sorted = smooth.clone();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let least = (LOW * sorted[sorted.len() / 20]).max(FEWEST);
    let peaks = (1..smooth.len() - 1)
        .filter(|&at| smooth[at] > least && smooth[at] >= smooth[at - 1] && smooth[at] > smooth[at + 1]);
    peaks.map(|at| (at as f64 + 0.5) * wide / FINE - std::f64::consts::FRAC_PI_2).collect()
}

/// For each point, the laser of the nearest of some ascending elevations, if it is within `reach`.
fn nearest_of(lasers: &[f64], seen: &[Sighted], reach: f64) -> Vec<Option<usize>> {
    let nearest = |seen: &Sighted| {
        let after = lasers.partition_point(|laser| *laser < seen.elevation);
        let distance = |laser: &usize| (lasers[*laser] - seen.elevation).abs();
        let near = [after.checked_sub(1), (after < lasers.len()).then_some(after)];
        near.into_iter()
            .flatten()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .filter(|laser| distance(laser) < reach)
    };
    seen.iter().map(nearest).collect()
}

/// The unknowns: rotations of the axis towards two directions across it, and the apex.
const UNKNOWNS: usize = 5;

/// A step of least squares towards elevations that are the same for all points of a laser. Returns the change
/// of the pose, the median of what deviations are left, and the elevations.
fn step(
    pose: &Pose,
    seen: &[Sighted],
    of_lasers: &[Option<usize>],
    lasers: usize,
    wide: f64,
) -> Option<(SVector<f64, UNKNOWNS>, f64, Vec<f64>)> {
    /// Iterations in which what deviates gets less weight.
    const ROUNDS: usize = 3;
    const RIDGE: f64 = 1e-6;
    type Row = SVector<f64, UNKNOWNS>;
    let [one, other] = across(&pose.axis);
    let points: Vec<(usize, f64, Row)> = seen
        .iter()
        .zip(of_lasers)
        .filter_map(|(seen, laser)| {
            let direction = seen.direction;
            let [sin, cos] = [direction.dot(&pose.axis), libm::cos(seen.elevation)];
            let of_apex = (direction * sin - pose.axis) / seen.range;
            let slopes = [direction.dot(&one), direction.dot(&other), of_apex.x, of_apex.y, of_apex.z];
            (cos > 0.0).then_some(((*laser)?, seen.elevation, Row::from(slopes) / cos))
        })
        .collect();
    let mut weights = vec![1.0; points.len()];
    let (mut change, mut means) = (Row::zeros(), vec![0.0; lasers]);
    let mut left = Vec::new();
    for _ in 0..ROUNDS {
        // The elevation of each laser is eliminated.
        let mut sums = vec![(0.0, 0.0, Row::zeros()); lasers];
        for ((laser, elevation, slopes), weight) in points.iter().zip(&weights) {
            let sum = &mut sums[*laser];
            *sum = (sum.0 + weight, sum.1 + elevation * weight, sum.2 + slopes * *weight);
        }
        let centred: Vec<(f64, Row)> = points
            .iter()
            .map(|(laser, elevation, slopes)| {
                let (weight, sum, slope) = &sums[*laser];
                (elevation - sum / weight, slopes - slope / *weight)
            })
            .collect();
        let (mut system, mut right) = (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), Row::zeros());
        for ((miss, slopes), weight) in centred.iter().zip(&weights) {
            system += slopes * slopes.transpose() * *weight;
            right -= slopes * (miss * weight);
        }
        (0..UNKNOWNS).for_each(|place| system[(place, place)] *= 1.0 + RIDGE);
        change = system.cholesky()?.solve(&right);
        left = centred.iter().map(|(miss, slopes)| (miss + slopes.dot(&change)).abs()).collect();
        weights = left.iter().map(|left| 1.0 / (left + 0.1 * wide)).collect();
        means = sums.iter().map(|(weight, sum, slope)| (sum + slope.dot(&change)) / weight).collect();
    }
    let middle = median(left.into_iter());
    means.retain(|mean| mean.is_finite());
    means.sort_by(f64::total_cmp);
    change.iter().all(|value| value.is_finite()).then_some((change, middle, means))
}

/// Two directions across another, all at right angles.
pub(super) fn across(axis: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let aside = if axis.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let one = axis.cross(&aside).normalize();
    [one, axis.cross(&one)]
}

impl Pose {
    /// The pose after a step, which is kept short.
    fn changed_by(&self, step: &SVector<f64, UNKNOWNS>) -> Self {
        /// Radians, and metres.
        const FARTHEST: f64 = 0.2;
        let step = step.map(|value| value.clamp(-FARTHEST, FARTHEST));
        let [one, other] = across(&self.axis);
        Pose {
            axis: (self.axis + one * step[0] + other * step[1]).normalize(),
            apex: self.apex + Vector3::new(step[2], step[3], step[4]),
        }
    }
}
