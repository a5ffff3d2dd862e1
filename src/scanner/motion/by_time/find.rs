//! Estimates how a scan was moved by its time stamps: least squares between the points of the file and those
//! of the scanner's formula. The formula's points are known as soon as the motion is known to within half a
//! range step.
//!
//! The first estimate, when all that is known is which points share a laser, is of another kind: the cones of
//! the lasers determine all of the motion except the rotation about their axis, and the azimuths, which are
//! whole ticks, determine that.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::{Moment, Stamped, parts};
use crate::ground::floats::square;
use crate::scan::{Channel, PointCloud, ScanFile};
use crate::scanner::firings::{self, Firings, Moved, MovedBy, Sight, fit_moved};
use crate::scanner::motion::cones::Cones;
use crate::scanner::motion::many::Seen;
use crate::scanner::motion::{Motion, Mover};
use crate::scanner::{CoordinateGrid, channel_of_lasers, median, thinned};

/// Number of points in a first search, and in the last one.
const SAMPLE: usize = 2000;
const LARGE_SAMPLE: usize = 20_000;

/// The points as they were measured, and how they were moved to those of the file, with a list of misses that
/// is still empty. None if the scanner's formula reproduces the points as they are, or if no motion makes it
/// reproduce most of them.
pub fn undo(cloud: &PointCloud, scanner: &Firings) -> Option<(Vec<[f32; 3]>, Stamped)> {
    /// Share of misses below which nothing can be gained.
    const FEW: f64 = 0.1;
    let sight = Sight::new(scanner);
    if scanner.build().coordinates != CoordinateGrid::Float32 || scanner.build().mounting.is_some() {
        return None;
    }
    let points = points_without_parts(cloud)?;
    let without = share(&sight, thinned(&points, SAMPLE), &Motion::default());
    if without > 1.0 - FEW {
        return None;
    }
    let all = Vec::from_iter(thinned(&points, LARGE_SAMPLE).copied());
    for (channel, moment) in candidates(&cloud.channels) {
        let parts = parts(&cloud.channels[channel], moment);
        let points = with_parts(&all, &parts);
        let few: Vec<Point> = thinned(&points, SAMPLE).copied().collect();
        let starts = [Some(Motion::default()), None].into_iter().filter_map(|known| match known {
            None if is_near(&sight, &few) => None,
            None => rough_motion(&points, &cloud.channels),
            known => known,
        });
        let mut found = starts.filter_map(|start| search(&sight, &few, start, &ROUNDS));
        let Some(motion) = found.find(|motion| is_better(share(&sight, few.iter(), motion), without)) else {
            continue;
        };
        let Some(motion) = last_digits(&sight, &points, motion) else { continue };
        if is_better(share(&sight, points.iter(), &motion), without) {
            let measured = measured(&sight, &cloud.positions, &parts, &motion);
            return Some((measured, Stamped { channel, moment, motion, misses: Vec::new() }));
        }
    }
    None
}

/// A scanner with constants that fit the points of a scan once these are moved back, given one that nearly
/// fits them as they are, if there is one. None if no motion makes them fit better.
pub fn fit(sample: &[ScanFile], near: Option<&Firings>) -> Option<Firings> {
    /// Number of scans that are tried.
    const MOST: usize = 3;
    // Rounding hides whether points were moved: also if the scanner near to them is one of unrounded coordinates,
    // because it reproduces too few.
    let may_be_moved = |scan: &&ScanFile| {
        let PointCloud { positions, channels, .. } = &scan.cloud;
        candidates(channels).next().is_some() && !CoordinateGrid::are_rounded(positions)
    };
    let found = sample.iter().filter(may_be_moved).take(MOST).find_map(|scan| fit_scan(scan, near));
    found.or_else(|| fit_half(sample.iter().find(may_be_moved)?, near?))
}

/// As [`fit_scan`], from the half of a scan that was moved the least: constants that fit the whole scan, as far
/// as it fits any, may be too far from the right ones for the motion to be found with them. `near` is found
/// from the whole scan.
fn fit_half(scan: &ScanFile, near: &Firings) -> Option<Firings> {
    /// Parts of the motion of the points that are used.
    const HALF: f64 = 0.5;
    let points = points_without_parts(&scan.cloud)?;
    let few: Vec<Point> = thinned(&points, SAMPLE).copied().collect();
    let without = share(&Sight::new(near), few.iter(), &Motion::default());
    if is_better(without, 0.0) || near.build().coordinates != CoordinateGrid::Float32 {
        return None;
    }
    let (channel, _) = candidates(&scan.cloud.channels).next()?;
    [Moment::Last, Moment::First].into_iter().find_map(|moment| {
        let parts = parts(&scan.cloud.channels[channel], moment);
        let half = (0u32..).zip(&parts).filter(|(_, part)| part.abs() < HALF).map(|(record, _)| record);
        let half = ScanFile { cloud: scan.cloud.select(&half.collect::<Vec<_>>()), ..scan.clone() };
        let of_half = firings::fit(std::slice::from_ref(&half))?;
        let fitted = fit_scan(&half, Some(&of_half)).unwrap_or(of_half);
        let few = with_parts(&few, &parts);
        let reproduced = |sight: &Sight| {
            let motion = search(sight, &few, Motion::default(), &ROUNDS)?;
            Some(share(sight, few.iter(), &motion))
        };
        let is_found = reproduced(&Sight::new(&fitted)).is_some_and(|share| is_better(share, without));
        is_found.then_some(fitted)
    })
}

fn fit_scan(scan: &ScanFile, near: Option<&Firings>) -> Option<Firings> {
    /// Each iteration improves the constants, and these the motion.
    const TRIES: usize = 3;
    /// A share of exactly reproduced points that need not be improved.
    const NEARLY_ALL: f64 = 0.95;
    let all = points_without_parts(&scan.cloud)?;
    let without =
        near.map_or(0.0, |near| share(&Sight::new(near), thinned(&all, SAMPLE), &Motion::default()));
    if is_better(without, 0.0) || near.is_some_and(|near| near.build().coordinates != CoordinateGrid::Float32)
    {
        return None;
    }
    for (channel, moment) in candidates(&scan.cloud.channels) {
        let parts = parts(&scan.cloud.channels[channel], moment);
        let points = with_parts(&all, &parts);
        let few: Vec<Point> = thinned(&points, LARGE_SAMPLE).copied().collect();
        let mut best: Option<(f64, Firings)> = None;
        let mut last = Motion::default();
        for _ in 0..TRIES {
            let motion = match best.as_ref().map(|(_, scanner)| scanner).or(near) {
                Some(scanner) => {
                    let sight = Sight::new(scanner);
                    let motion = search_with_constants(&sight, &few, last);
                    motion.filter(|motion| are_at_whole_steps(&pairs(&sight, &few, motion), motion))
                }
                None => rough_motion(&points, &scan.cloud.channels),
            };
            let Some(motion) = motion else { break };
            last = motion;
            let mover = Mover::new(&motion);
            let moved = |(position, part): (&[f32; 3], &f64)| {
                let motion = mover.at(*part);
                Moved {
                    measured: motion.undone(position.map(f64::from)),
                    by: MovedBy::Motion(motion),
                    position: *position,
                }
            };
            let moved: Vec<Moved> = scan.cloud.positions.iter().zip(&parts).map(moved).collect();
            let Some(fitted) = fit_moved(&scan.cloud, &moved, 0.0) else { break };
            let sight = Sight::new(&fitted);
            let few: Vec<Point> = thinned(&points, SAMPLE).copied().collect();
            let motion = search(&sight, &few, motion, &ROUNDS[SURE..]);
            let share = motion.map_or(0.0, |motion| share(&sight, few.iter(), &motion));
            drop(sight);
            if best.as_ref().is_some_and(|(best, _)| share <= *best) {
                break;
            }
            best = Some((share, fitted));
            if share > NEARLY_ALL {
                break;
            }
        }
        if let Some((_, scanner)) = best.filter(|(share, _)| is_better(*share, without)) {
            return Some(scanner);
        }
    }
    None
}

/// Whether a share of exactly reproduced points is worth a motion, given the share without one.
fn is_better(share: f64, without: f64) -> bool {
    share > 0.5 * (1.0 + without)
}

/// A point of the file, and its part of the motion.
#[derive(Clone, Copy)]
struct Point {
    /// Its number among those of the scan.
    number: usize,
    position: [f32; 3],
    part: f64,
}

/// The points from which a motion may be estimated; none if it is not searched for.
fn points_without_parts(cloud: &PointCloud) -> Option<Vec<Point>> {
    /// In metres; beyond the reach of any scanner.
    const FARTHEST: f32 = 1000.0;
    const FEWEST: usize = 200;
    candidates(&cloud.channels).next()?;
    // False for NaN too.
    let is_in_reach = |position: &[f32; 3]| position.iter().all(|metres| metres.abs() < FARTHEST);
    let points = cloud.positions.iter().enumerate();
    let points = points.filter(|(_, position)| is_in_reach(position) && **position != [0.0; 3]);
    let points: Vec<Point> =
        points.map(|(number, &position)| Point { number, position, part: 0.0 }).collect();
    (points.len() >= FEWEST).then_some(points)
}

fn with_parts(points: &[Point], parts: &[f64]) -> Vec<Point> {
    points.iter().map(|point| Point { part: parts[point.number], ..*point }).collect()
}

/// The channels that may hold time stamps, the widest first, and the moments to which points may have been
/// moved.
fn candidates(channels: &[Channel]) -> impl Iterator<Item = (usize, Moment)> {
    let times = [8, 4].into_iter().flat_map(move |size| {
        let of_size = channels.iter().enumerate();
        of_size.filter(move |(_, channel)| channel.field.scalar.size() == size && may_be_time(channel))
    });
    times.flat_map(|(channel, _)| Moment::ALL.map(|moment| (channel, moment)))
}

/// Whether the values of a channel seldom decrease from one record to the next, and are many.
fn may_be_time(channel: &Channel) -> bool {
    /// Time may go back at most once in this many records: at the end of each line if a file is stored row
    /// after row.
    const MOST_FALLS: usize = 10;
    const FEWEST: usize = 16;
    if channel.field.count != 1 {
        return false;
    }
    let parts = parts(channel, Moment::First);
    let falls = parts.windows(2).filter(|pair| pair[1] < pair[0]).count();
    let rises = parts.windows(2).filter(|pair| pair[1] > pair[0]).count();
    falls * MOST_FALLS <= parts.len() && rises >= FEWEST
}

/// The share of the points that are reproduced to the last bit.
fn share<'p>(sight: &Sight, points: impl Iterator<Item = &'p Point>, motion: &Motion) -> f64 {
    let mover = Mover::new(motion);
    let (mut exact, mut count) = (0, 0);
    for point in points {
        let motion = mover.at(point.part);
        let found = sight.nearest(motion.undone(point.position.map(f64::from)));
        let formula = found.map(|(_, formula)| motion.moved(formula).map(|metres| metres as f32));
        exact += usize::from(formula == Some(point.position));
        count += 1;
    }
    f64::from(exact as u32) / f64::from(count.max(1))
}

/// Whether most points are so near to the formula's that they were moved by less than `NEAR`.
fn is_near(sight: &Sight, points: &[Point]) -> bool {
    /// Metres; for ranges that are not whole steps the mean distance is greater.
    const NEAR: f64 = 3e-4;
    let is_near = |point: &&Point| {
        let there = point.position.map(f64::from);
        let formula = sight.nearest(there).map(|(_, formula)| formula);
        formula.is_some_and(|formula| (0..3).all(|axis| (formula[axis] - there[axis]).abs() < NEAR))
    };
    2 * points.iter().filter(is_near).count() > points.len()
}

/// The points as they were measured: those of the formula, if compensation moves them to (nearly) the file's;
/// otherwise the file's moved back.
fn measured(sight: &Sight, positions: &[[f32; 3]], parts: &[f64], motion: &Motion) -> Vec<[f32; 3]> {
    /// Metres.
    const NEAR: f64 = 2e-5;
    let mover = Mover::new(motion);
    let measured = |(position, part): (&[f32; 3], &f64)| {
        let motion = mover.at(*part);
        let there = position.map(f64::from);
        let undone = motion.undone(there);
        let formula = sight.nearest(undone).map(|(_, formula)| formula).filter(|formula| {
            let moved = motion.moved(*formula);
            (0..3).all(|axis| (moved[axis] - there[axis]).abs() < NEAR)
        });
        let found = formula.unwrap_or(undone).map(|metres| metres as f32);
        // NaNs are not changed, and points at the scanner carry no information.
        if *position == [0.0; 3] || found.iter().any(|metres| metres.is_nan()) { *position } else { found }
    };
    positions.iter().zip(parts).map(measured).collect()
}

/// For each iteration, the distance in metres up to which points have equal weight; farther points have less.
const ROUNDS: [f64; 8] = [1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7];
/// The first of these iterations for a motion that is nearly right.
const SURE: usize = 3;

/// The motion for which the formula's points are nearest to those of the file.
fn search(sight: &Sight, points: &[Point], mut motion: Motion, rounds: &[f64]) -> Option<Motion> {
    for &even in rounds {
        motion = step(&pairs(sight, points, &motion), 0, &motion, even)?;
    }
    motion.is_possible().then_some(motion)
}

/// The last digits of a motion that is nearly right, so that the formula's points do not change.
fn last_digits(sight: &Sight, points: &[Point], mut motion: Motion) -> Option<Motion> {
    /// As in [`ROUNDS`]; points with small coordinates determine the last digits.
    const ROUNDS: [f64; 5] = [1e-6, 1e-7, 1e-9, 1e-11, 1e-11];
    let pairs = pairs(sight, points, &motion);
    for even in ROUNDS {
        motion = step(&pairs, 0, &motion, even)?;
    }
    motion.is_possible().then_some(motion)
}

/// As [`search`], for a scanner whose lasers' elevations and azimuths may be slightly wrong.
fn search_with_constants(sight: &Sight, points: &[Point], mut motion: Motion) -> Option<Motion> {
    const ROUNDS: [f64; 4] = [1e-3, 1e-3, 1e-3, 1e-4];
    for even in ROUNDS {
        motion = step(&pairs(sight, points, &motion), sight.rows(), &motion, even)?;
    }
    motion.is_possible().then_some(motion)
}

/// A point of the file and that of the formula, in metres.
struct Pair {
    there: [f64; 3],
    formula: [f64; 3],
    row: u32,
    part: f64,
    /// Half a unit in the last place of each coordinate of the file.
    rounding: [f64; 3],
}

/// The points with those of the formula that are nearest to them once they are moved back.
fn pairs(sight: &Sight, points: &[Point], motion: &Motion) -> Vec<Pair> {
    let mover = Mover::new(motion);
    let pair = |point: &Point| {
        let there = point.position.map(f64::from);
        let (found, formula) = sight.nearest(mover.at(point.part).undone(there))?;
        let rounding = point.position.map(|metres| 0.5 * (f64::from(metres.next_up()) - f64::from(metres)));
        Some(Pair { there, formula, row: found.row, part: point.part, rounding })
    };
    points.iter().filter_map(pair).collect()
}

/// Whether most points are at the formula's ranges, as far as single precision tells: by the wrong motion, or
/// moved to another moment, they are up to half a range step beside them. The constants of lasers make little
/// difference to ranges.
fn are_at_whole_steps(pairs: &[Pair], motion: &Motion) -> bool {
    /// Largest median distance from the formula's range, in units of what rounding may do to it.
    const NEAR: f64 = 10.0;
    let mover = Mover::new(motion);
    let off = |pair: &Pair| {
        let moved = mover.at(pair.part).moved(pair.formula);
        let along = |of: &[f64; 3]| (0..3).map(|axis| of[axis] * pair.formula[axis]).sum::<f64>();
        let miss = [0, 1, 2].map(|axis| pair.there[axis] - moved[axis]);
        let unit = pair.rounding.iter().map(|rounding| square(*rounding)).sum::<f64>().sqrt();
        along(&miss).abs() / (along(&pair.formula).sqrt() * unit)
    };
    median(pairs.iter().map(off)) < NEAR
}

/// An iteration of weighted least squares. The constants of the first `rows` lasers are free, and eliminated.
fn step(pairs: &[Pair], rows: usize, motion: &Motion, even: f64) -> Option<Motion> {
    /// Metres: a point farther off belongs to another return.
    const FARTHEST: f64 = 0.05;
    /// Regularises components that the points do not determine, relative to their own scale.
    const RIDGE: f64 = 1e-12;
    let mover = Mover::new(motion);
    let mut lasers = vec![Laser::default(); rows];
    // Of a symmetric matrix, the upper half.
    let mut upper = [[0.0; 6]; 6];
    let mut right = SVector::<f64, 6>::zeros();
    for pair in pairs {
        let moved = mover.at(pair.part).moved(pair.formula);
        let [x, y, z] = pair.formula;
        let rho = (x * x + y * y).sqrt();
        // A small rotation moves a point by its cross product with it.
        let slopes = [[0.0, z, -y, 1.0, 0.0, 0.0], [-z, 0.0, x, 0.0, 1.0, 0.0], [y, -x, 0.0, 0.0, 0.0, 1.0]];
        // The same for changes of a laser's elevation and azimuth.
        let own = [[-z * x / rho, -y], [-z * y / rho, x], [rho, 0.0]];
        for axis in 0..3 {
            let miss = pair.there[axis] - moved[axis];
            if !(miss.abs() < FARTHEST && rho > 0.0) {
                continue;
            }
            let weight = 1.0 / square(pair.rounding[axis].max(even).max(miss.abs()));
            let slope = slopes[axis].map(|slope| slope * pair.part);
            for (row, sums) in upper.iter_mut().enumerate() {
                let weighted = slope[row] * weight;
                right[row] += weighted * miss;
                (row..6).for_each(|column| sums[column] += weighted * slope[column]);
            }
            if let Some(laser) = lasers.get_mut(pair.row as usize) {
                let own = Vector2::from(own[axis]);
                laser.system += own * own.transpose() * weight;
                laser.right += own * (miss * weight);
                laser.shared += own * SVector::from(slope).transpose() * weight;
            }
        }
    }
    let mut system = SMatrix::<f64, 6, 6>::from_fn(|row, column| upper[row.min(column)][row.max(column)]);
    for laser in lasers.iter().filter(|laser| laser.system.trace() > 0.0) {
        let system_of_laser = laser.system + Matrix2::identity() * (laser.system.trace() * RIDGE);
        let inverse = system_of_laser.try_inverse()?;
        system -= laser.shared.transpose() * inverse * laser.shared;
        right -= laser.shared.transpose() * (inverse * laser.right);
    }
    for place in 0..6 {
        system[(place, place)] *= 1.0 + RIDGE;
    }
    let change = system.cholesky()?.solve(&right);
    Some(motion.changed_by(&change.into()))
}

/// The sums for the two constants of a laser.
#[derive(Clone, Default)]
struct Laser {
    system: Matrix2<f64>,
    right: Vector2<f64>,
    shared: SMatrix<f64, 2, 6>,
}

/// The motion, as accurately as the size of ticks and steps allows. None if no channel distinguishes the
/// lasers, or no motion brings their points onto cones.
fn rough_motion(points: &[Point], channels: &[Channel]) -> Option<Motion> {
    let beams = beams(points, channels)?;
    let seen = |point: &Point| Seen { position: point.position.map(f64::from), part: point.part };
    let undone = |mover: &Mover, seen: &mut [Seen]| {
        seen.iter().map(|seen| mover.at(seen.part).undone(seen.position)).collect()
    };
    let mut cones = Cones::new(&beams, seen)?;
    let mut motion = cones.improved(Motion::default(), undone)?;
    // Cones are fitted as if there were no rotation about z, until that rotation is known.
    for _ in 0..2 {
        motion = with_yaw(motion, &beams)?;
        motion = cones.improved(motion, undone)?;
    }
    with_yaw(motion, &beams)
}

/// The points of each laser, if a channel tells the lasers.
fn beams(points: &[Point], channels: &[Channel]) -> Option<Vec<Vec<Point>>> {
    let channel = channel_of_lasers(channels)?;
    let key = |point: &Point| channel.value(point.number);
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| key(a).cmp(key(b)));
    Some(sorted.chunk_by(|a, b| key(a) == key(b)).map(<[Point]>::to_vec).collect())
}

/// A point's azimuth before the rotation about z is undone, and its part of the motion.
struct Azimuth {
    beam: usize,
    radians: f64,
    part: f64,
}

/// The motion with the rotation about z that brings azimuths onto ticks. None if no rotation does.
fn with_yaw(motion: Motion, beams: &[Vec<Point>]) -> Option<Motion> {
    /// Numbers of ticks in a turn that scanners have, the usual one first.
    const TICKS: [f64; 5] = [36_000.0, 1024.0, 2048.0, 512.0, 4096.0];
    /// Minimum coherence of azimuths that are on ticks.
    const COHERENT: f64 = 0.6;
    /// Share of the best coherence that counts as equally good.
    const AS_GOOD: f64 = 0.95;
    /// Radians in a scan by which a skidding car may turn more, or less, than the motion says.
    const FARTHEST: f64 = 0.3;
    /// The first part of the motion that is examined, and the factor by which it grows each time.
    const FIRST: f64 = 0.02;
    const GROWTH: f64 = 4.0;
    /// The resolution, in ticks, at the largest part; the number of values to either side that are tried
    /// later; and the largest number of azimuths.
    const FINE: f64 = 0.1;
    const NEAR: i32 = 10;
    const MOST: usize = 4000;
    let mover = Mover::new(&motion);
    let mut azimuths: Vec<Azimuth> = Vec::new();
    for (beam, points) in beams.iter().enumerate() {
        azimuths.extend(points.iter().map(|point| {
            let [x, y, _] = mover.at(point.part).undone(point.position.map(f64::from));
            Azimuth { beam, radians: libm::atan2(y, x), part: point.part }
        }));
    }
    azimuths.sort_by(|a, b| a.part.abs().total_cmp(&b.part.abs()));
    for ticks in TICKS {
        let coherence = |yaw: f64, azimuths: &[&Azimuth]| {
            let mut sums = vec![[0.0; 2]; beams.len()];
            for azimuth in azimuths {
                let (sin, cos) = libm::sincos((azimuth.radians - yaw * azimuth.part) * ticks);
                let sum = &mut sums[azimuth.beam];
                (sum[0], sum[1]) = (sum[0] + cos, sum[1] + sin);
            }
            sums.iter().map(|[cos, sin]| libm::hypot(*cos, *sin)).sum::<f64>() / azimuths.len().max(1) as f64
        };
        let (mut yaw, mut part) = (0.0, FIRST);
        let mut places = (FARTHEST * FIRST / (FINE * TAU / ticks)).ceil() as i32;
        let best = loop {
            let within = azimuths.partition_point(|azimuth| azimuth.part.abs() <= part);
            let near: Vec<&Azimuth> = thinned(&azimuths[..within], MOST).collect();
            let tried = (-places..=places).map(|place| yaw + f64::from(place) * FINE * TAU / ticks / part);
            let tried: Vec<(f64, f64)> = tried.map(|yaw| (coherence(yaw, &near), yaw)).collect();
            let best = tried.iter().map(|(coherence, _)| *coherence).fold(0.0, f64::max);
            // Time stamps are evenly spaced, so rotations that differ by whole ticks per time stamp look the
            // same: the smallest is the right one, since a car turns by less.
            let as_good = tried.into_iter().filter(|(coherence, _)| *coherence >= AS_GOOD * best);
            let is_first = part == FIRST;
            yaw = match is_first {
                true => as_good.map(|(_, yaw)| yaw).min_by(|a, b| a.abs().total_cmp(&b.abs()))?,
                false => as_good.max_by(|a, b| a.0.total_cmp(&b.0))?.1,
            };
            if part >= 1.0 || best < COHERENT {
                break best;
            }
            (part, places) = ((part * GROWTH).min(1.0), NEAR);
        };
        if best >= COHERENT {
            let [x, y, z] = motion.rotation;
            return Some(Motion { rotation: [x, y, z + yaw], ..motion });
        }
    }
    None
}

#[cfg(all(test, feature = "study"))]
mod tests {
    use super::*;
    use crate::files::parse;
    use crate::scan::{Field, ScalarType};
    use crate::study::synth::{SynthConfig, SynthScanner, drive};

    /// A scan of a VLP-16 with a time stamp for each 32 returns, moved to where they would have been at the last.
    fn moved_scan(motion: &Motion) -> ScanFile {
        let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 1, ..SynthConfig::default() };
        let points = drive(&config).next().expect("a frame").points;
        let times: Vec<u8> = (0..points.len()).flat_map(|n| ((n / 32) as f64 * 1e-3).to_le_bytes()).collect();
        let times = Channel { field: Field::new("timestamp", ScalarType::F64), bytes: times };
        let mover = Mover::new(motion);
        let moved = |([x, y, z, i], part): (&[f32; 4], f64)| {
            let [x, y, z] = mover.at(part).moved([*x, *y, *z].map(f64::from)).map(|metres| metres as f32);
            [x, y, z, *i]
        };
        let points: Vec<[f32; 4]> = points.iter().zip(parts(&times, Moment::Last)).map(moved).collect();
        let bytes = points.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut scan = parse("0.bin", bytes);
        scan.cloud.channels.push(times);
        scan
    }

    #[test]
    fn half_of_a_scan_shows_the_scanner_of_all() {
        let motion = Motion { rotation: [1.2e-5, 0.0, 0.0], translation: [-4.8e-5, -5.1e-5, 2.38e-4] };
        let scan = moved_scan(&motion);
        let near = firings::fit(std::slice::from_ref(&scan)).expect("a scanner that nearly fits");
        let found = fit_half(&scan, &near).expect("a scanner that fits what was measured");
        let (_, undone) = undo(&scan.cloud, &found).expect("the motion");
        for axis in 0..3 {
            let (rotation, translation) = (motion.rotation[axis], motion.translation[axis]);
            assert!((undone.motion.rotation[axis] - rotation).abs() < 1e-6, "{undone:?}");
            assert!((undone.motion.translation[axis] - translation).abs() < 1e-5, "{undone:?}");
        }
        // What was not moved needs no such search.
        let scan = moved_scan(&Motion::default());
        let exact = firings::fit(std::slice::from_ref(&scan)).expect("its scanner");
        assert!(fit_half(&scan, &exact).is_none());
    }
}
