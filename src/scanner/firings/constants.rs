//! The constants of lasers, to the last bit of the file's coordinates: elevations and azimuth offsets rounded as makers round
//! them, and the recipe by trying all of them.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::recipe::whole_steps;
use super::{ANGLE_UNIT, Build, Firings, Laser, Recipe};
use crate::ground::rounding::round_ties_even;
use crate::scanner::Return;
use crate::scanner::motion::RigidMotion;

/// Points of each laser that recipes are tried on.
pub(super) const TRIED: usize = 60;

/// A return of the sample, in metres and radians.
#[derive(Clone, Copy)]
pub(super) struct Point {
    pub position: [f64; 3],
    pub range: f64,
    pub elevation: f64,
    /// How it came to where it is in the file, if that is elsewhere.
    pub moved: Option<Moved>,
}

/// A point that was moved after it was measured.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// Where it was measured, as well as that is known, in metres.
    pub measured: [f64; 3],
    /// What moved it.
    pub(in crate::scanner) motion: RigidMotion,
    /// Where it is in the file.
    pub position: [f32; 3],
}

impl Point {
    /// None for what has no direction.
    pub fn new(position: [f64; 3], moved: Option<Moved>) -> Option<Self> {
        let [x, y, z] = position;
        let rho = (x * x + y * y).sqrt();
        let range = (rho * rho + z * z).sqrt();
        (range.is_finite() && rho > 0.0).then(|| Point {
            position,
            range,
            elevation: libm::atan2(z, rho),
            moved,
        })
    }

    /// Whether a scanner's recipe gives its coordinates in the file to the last bit, along these axes.
    fn is_given_by(&self, scanner: &Firings, found: &Return, axes: std::ops::Range<usize>) -> bool {
        let Some(Moved { motion, position, .. }) = &self.moved else {
            return scanner.gives(found, &self.position, axes);
        };
        let mut start = self.position;
        let formula = scanner.position(found, 0.0);
        axes.clone().for_each(|axis| start[axis] = formula[axis]);
        let moved = motion.moved(start);
        axes.into_iter().all(|axis| moved[axis] as f32 == position[axis])
    }
}

/// Some points of each row, the far ones where there are enough.
pub(super) fn by_rows(
    points: &[Point],
    rows: &[Option<usize>],
    count: usize,
    most: usize,
) -> Vec<Vec<Point>> {
    let mut of_rows = vec![Vec::new(); count];
    for (point, row) in points.iter().zip(rows) {
        if let Some(row) = row {
            of_rows[*row].push(*point);
        }
    }
    for row in &mut of_rows {
        let far: Vec<Point> = row.iter().filter(|point| point.range > 3.0).copied().collect();
        let of = if far.len() >= most { far } else { std::mem::take(row) };
        let step = (of.len() / most).max(1);
        *row = of.into_iter().step_by(step).collect();
    }
    of_rows
}

/// The points of each row that are nearest to an axis of the file.
pub(super) fn near_axes(points: &[Point], rows: &[Option<usize>], count: usize) -> Vec<Vec<Point>> {
    /// Of a row.
    const MOST: usize = 40;
    /// As parts of the distance.
    const NEAR: f64 = 0.1;
    let aside = |point: &Point| {
        let [x, y, _] = point.position.map(f64::abs);
        x.min(y) / x.max(y)
    };
    let mut near = vec![Vec::new(); count];
    for (point, row) in points.iter().zip(rows) {
        if let Some(row) = row.filter(|_| aside(point) < NEAR) {
            near[row].push(*point);
        }
    }
    for row in &mut near {
        row.sort_by(|a, b| aside(a).total_cmp(&aside(b)));
        row.truncate(MOST);
    }
    near
}

/// What is known of the lasers before it is rounded as their maker wrote it.
pub(super) struct Constants {
    /// Radians, falling.
    pub elevations: Vec<f64>,
    /// Azimuth offsets, in ticks, but for whole ones.
    pub phases: Vec<f64>,
    /// Some points of each.
    pub of_rows: Vec<Vec<Point>>,
    /// Ten times as many.
    pub more_of_rows: Vec<Vec<Point>>,
    /// Some that are nearest to an axis.
    pub near_axes: Vec<Vec<Point>>,
}

impl Constants {
    /// Of the recipes, the one that gives the most points to the last bit, the first of equals, with the lasers'
    /// constants, and whether each is off by whole ticks of its own. `shifts` are those that each is ahead of the others.
    pub fn with_recipe(&self, build: &Build, shifts: &[f64]) -> Option<(Build, Vec<Laser>, bool)> {
        /// Lasers that tell which recipe it is.
        const FEW: usize = 6;
        let tick = 360.0 / f64::from(build.ticks);
        let ahead = self.phases.iter().zip(shifts).map(|(phase, shift)| (phase + shift) * tick);
        let ahead: Vec<f64> = ahead.collect();
        let mean = ahead.iter().sum::<f64>() / ahead.len().max(1) as f64;
        let middle = round_ties_even(-mean / tick) * tick;
        let offsets: Vec<f64> = ahead.into_iter().map(|offset| offset + middle).collect();
        let mut few: Vec<usize> = (0..self.elevations.len()).collect();
        few.sort_by_key(|&row| std::cmp::Reverse(self.of_rows[row].len()));
        few.truncate((few.len() / 2).max(FEW));
        let few: Vec<usize> = few.iter().step_by((few.len() / FEW).max(1)).copied().collect();
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let recipes = Recipe::ALL.into_par_iter().filter(|recipe| !recipe.is_off_axis());
        let known =
            recipes.map(|recipe| Firings::new(Build { recipe, ..build.clone() }, Vec::new(), Vec::new()));
        // Recipes that give fewer than another are of no interest.
        let most = AtomicUsize::new(0);
        let tried = known.clone().map(|any| {
            let (common, exact) = self.common(&any, &offsets, &few, most.load(Ordering::Relaxed));
            most.fetch_max(exact, Ordering::Relaxed);
            (any, common, exact)
        });
        let best = first_of_equals(tried.collect(), |(.., exact)| *exact)?;
        let turned = (4 * best.2 < 3 * points).then(|| {
            let tried = known.map(|any| {
                let exact = self.exact_turned(&any, &offsets, &few);
                (any, 0, exact)
            });
            first_of_equals(tried.collect(), |(.., exact)| *exact)
        });
        let turned = turned.flatten().filter(|(.., exact)| 4 * exact >= 3 * points);
        let are_turned = turned.is_some();
        let (any, common, exact) = turned.unwrap_or(best);
        let may_turn = any.build.recipe.adds_in_single() && 2 * exact > points;
        let of_row = |row: usize| {
            let offset = offsets[row] + f64::from(common) * tick;
            let (mut laser, exact) = self.laser(&any, row, offset, 0);
            // It may be off by whole ticks of its own, for want of points, or because as many pass until it fires.
            if may_turn && 4 * exact < 3 * self.of_rows[row].len() {
                laser = self.turned(&any, row, offset).0;
            }
            let sums = matches!(any.build.recipe, Recipe::Nebula | Recipe::Nebula2023 | Recipe::Once);
            if sums { self.of_sums(&any, row, laser) } else { laser }
        };
        let lasers = (0..self.elevations.len()).into_par_iter().map(of_row).collect();
        Some((any.build, lasers, are_turned))
    }

    /// How many points of these rows come out if each is off by whole ticks of its own, as lasers are of which ticks pass until
    /// they fire; 0 if nothing tells so.
    fn exact_turned(&self, any: &Firings, offsets: &[f64], few: &[usize]) -> usize {
        let are_moved = few.iter().any(|&row| self.of_rows[row].iter().any(|point| point.moved.is_some()));
        if are_moved || !any.build.recipe.adds_in_single() {
            return 0;
        }
        few.iter().map(|&row| self.turned(any, row, offsets[row]).1).sum()
    }

    /// The laser near another by which the most of many points come out to the last bit, where sums in single precision tell an
    /// offset only by many points, and an elevation by its cosine only then.
    fn of_sums(&self, any: &Firings, row: usize, laser: Laser) -> Laser {
        let points = &self.more_of_rows[row];
        let sharpest = |laser: Laser| sharpest(any, laser, points, &self.near_axes[row]);
        let first = sharpest(laser);
        if first.1 == points.len() {
            return first.0;
        }
        let step = any.build.recipe.angle_step(laser.elevation_degrees()) / ANGLE_UNIT;
        let steps = (1..=SAME as i32).flat_map(|steps| [steps, -steps]);
        let others = steps.map(|steps| laser.elevation + (f64::from(steps) * step).round() as i64);
        let others = others.map(|elevation| Laser { elevation, ..laser });
        let high = exact_points(any, laser, points, 2..3, 0);
        let same_sine = others.filter(|other| exact_points(any, *other, points, 2..3, high) >= high);
        same_sine.map(sharpest).fold(first, |best, next| if next.1 > best.1 { next } else { best }).0
    }

    /// The constants of a laser whose azimuth offset, in degrees, is off by some whole ticks, and how many of its points
    /// they give to the last bit.
    fn turned(&self, any: &Firings, row: usize, offset: f64) -> (Laser, usize) {
        /// Ticks that pass while the lasers fire, at most.
        const MOST: i32 = 40;
        let tick = 360.0 / f64::from(any.build.ticks);
        let (laser, exact) = self.laser(any, row, offset, 0);
        let points = &self.of_rows[row];
        if exact == points.len() {
            return (laser, exact);
        }
        let off = (1..=MOST).flat_map(|ticks| [ticks, -ticks]).map(|ticks| offset + f64::from(ticks) * tick);
        let lasers = off.clone().map(|degrees| Laser { azimuth: roundings(degrees)[0], ..laser });
        let (best, _) = best_of(any, lasers, points, laser);
        let (other, others) = self.laser(any, row, best.azimuth_degrees(), exact);
        // By chance, or by another recipe, none gives most.
        if others > exact && 4 * others >= 3 * points.len() { (other, others) } else { (laser, exact) }
    }

    /// The whole ticks by which all offsets are off, as far as these rows tell, and how many of their points come out:
    /// perhaps 0 if they are fewer than `least`.
    fn common(&self, any: &Firings, offsets: &[f64], few: &[usize], least: usize) -> (i32, usize) {
        /// Where ticks are thousandths of degrees, whole ones make a difference only in single precision: how far off
        /// they are looked for.
        const FARTHEST: i32 = 1200;
        const NEAR: i32 = 4;
        /// Of the points one in so many is enough for that.
        const SPARSE: usize = 4;
        /// Of points that were moved it is not: how many are held against more.
        const LIKELIEST: usize = 32;
        /// Offsets that are none, in degrees.
        const NONE: f64 = 1e-5;
        /// Degrees: by chance, an offset is not as near to a thousandth.
        const NEAR_THOUSANDTH: f64 = 1e-4;
        let tick = 360.0 / f64::from(any.build.ticks);
        let is_whole = 360_000 % any.build.ticks == 0;
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let has_none = offsets.iter().all(|offset| offset.abs() < NONE);
        let is_known = is_whole && (has_none || !any.build.recipe.adds_in_single());
        // Of the points, as many may be missed.
        let (mut found, mut left) = (Vec::new(), points - least.min(points));
        for &row in few {
            let least = if is_known { self.of_rows[row].len().saturating_sub(left) } else { 0 };
            let (laser, exact) = self.laser(any, row, offsets[row], least);
            if exact < least {
                return (0, 0);
            }
            if is_known {
                left -= self.of_rows[row].len() - exact;
            }
            found.push((laser, exact));
        }
        let exact: usize = found.iter().map(|(_, exact)| exact).sum();
        if exact == points || is_known {
            return (0, exact);
        }
        // The nearest to the middle of equals.
        let rising = |most: i32| (1..=most).flat_map(|common| [common, -common]);
        if !is_whole {
            let thousandth = (1e-3 / ANGLE_UNIT) as i64;
            let worth = |lasers: &[(Laser, usize)]| {
                let exact: usize = lasers.iter().map(|(_, exact)| exact).sum();
                (exact, lasers.iter().filter(|(laser, _)| laser.azimuth % thousandth == 0).count())
            };
            let mut best = (0, worth(&found));
            for common in rising(NEAR) {
                let offset = |row: usize| offsets[row] + f64::from(common) * tick;
                let lasers: Vec<_> = few.iter().map(|&row| self.laser(any, row, offset(row), 0)).collect();
                let worth = worth(&lasers);
                if worth > best.1 {
                    best = (common, worth);
                }
            }
            return (best.0, best.1.0);
        }
        // Heights tell whether it is this recipe at all.
        let heights = few
            .iter()
            .zip(&found)
            .map(|(&row, (laser, _))| exact_points(any, *laser, &self.of_rows[row], 2..3, 0));
        let heights = heights.sum::<usize>();
        if 2 * heights < points || heights < least {
            return (0, exact);
        }
        let fewer: Vec<Vec<Point>> =
            few.iter().map(|&row| self.of_rows[row].iter().step_by(SPARSE).copied().collect()).collect();
        let are_moved = fewer.iter().flatten().any(|point| point.moved.is_some());
        // Sums in single precision tell the last digits, so these had better be right.
        let is_thousandth = |&row: &usize| {
            let off = offsets[row] - roundings(offsets[row])[0] as f64 * ANGLE_UNIT;
            off.abs() < NEAR_THOUSANDTH
        };
        let are_thousandths = are_moved || few.iter().all(is_thousandth);
        // How many of some points come out, or 0 if they are fewer than `least`.
        let count = |common: i32, points: &[Vec<Point>], least: usize| {
            let all: usize = points.iter().map(Vec::len).sum();
            let mut left = all.checked_sub(least)?;
            for ((&row, (laser, _)), points) in few.iter().zip(&found).zip(points) {
                let degrees = offsets[row] + f64::from(common) * tick;
                let azimuth = if are_thousandths {
                    roundings(degrees)[0]
                } else {
                    (degrees / ANGLE_UNIT).round() as i64
                };
                let least = points.len().saturating_sub(left);
                let exact = exact_points(any, Laser { azimuth, ..*laser }, points, 0..3, least);
                left = left.checked_sub(points.len() - exact)?;
            }
            Some(least + left)
        };
        let all = std::iter::once(0).chain(rising(FARTHEST));
        let common = if are_thousandths && !are_moved {
            // Of all points as many may be missed, so no more of these; and of the right one most come out.
            let size: usize = fewer.iter().map(Vec::len).sum();
            let least = size.saturating_sub(points - least.min(points)).max(size * 3 / 4).max(1);
            let found = all.fold((least - 1, 0), |best, common| {
                count(common, &fewer, best.0 + 1).map_or(best, |count| (count, common))
            });
            found.1
        } else {
            // Before the motion is known well, or the last digits are, few points come out, so the likeliest are held
            // against more of them.
            let more: Vec<Vec<Point>> = few.iter().map(|&row| self.more_of_rows[row].clone()).collect();
            let mut counted: Vec<_> = all.map(|common| (count(common, &fewer, 0), common)).collect();
            counted.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
            counted.truncate(LIKELIEST);
            let count = |common: i32| match are_moved {
                true => count(common, &more, 0).unwrap_or(0),
                false => few
                    .iter()
                    .zip(&found)
                    .map(|(&row, (laser, _))| {
                        let azimuth = ((offsets[row] + f64::from(common) * tick) / ANGLE_UNIT).round() as i64;
                        polished(any, Laser { azimuth, ..*laser }, &self.of_rows[row]).1
                    })
                    .sum(),
            };
            // The first of equals.
            let counted = counted.into_iter().map(|(_, common)| (count(common), common));
            counted.fold((0, 0), |best, next| if next.0 > best.0 { next } else { best }).1
        };
        let offset = |row: usize| offsets[row] + f64::from(common) * tick;
        let sum = few.iter().map(|&row| self.laser(any, row, offset(row), 0).1).sum();
        if sum > exact { (common, sum) } else { (0, exact) }
    }

    /// The constants of a laser, given its azimuth offset in degrees, and how many of its points they give to the last
    /// bit: perhaps 0 if they are fewer than `least`.
    fn laser(&self, any: &Firings, row: usize, offset: f64, least: usize) -> (Laser, usize) {
        let points = &self.of_rows[row];
        // Ranges are whole steps, so heights tell the elevation better than the positions do.
        let elevation = |point: &Point| {
            let steps = whole_steps(point.range, any.range_step_m())?;
            Some(libm::asin((point.position[2] / (f64::from(steps) * any.range_step_m())).clamp(-1.0, 1.0)))
        };
        let mut elevations: Vec<f64> = points.iter().filter_map(elevation).collect();
        elevations.sort_by(f64::total_cmp);
        let elevation = elevations.get(elevations.len() / 2).copied().unwrap_or(self.elevations[row]);
        let [elevation, azimuth] =
            [elevation.to_degrees(), offset].map(|angle| (angle / ANGLE_UNIT).round() as i64);
        // The height tells the elevation, but for those that have the same sine.
        let of_elevation =
            |elevation: i64, least| exact_points(any, Laser { elevation, azimuth }, points, 2..3, least);
        // Heights near 0 come out only by a motion that is known better than it can be.
        let are_moved = points.iter().any(|point| point.moved.is_some());
        let (axes, least_high) = if are_moved { (0..2, 0) } else { (0..3, least) };
        let wanted = (points.len(), least_high);
        let elevations = angles(any.build.recipe, elevation, wanted, 0.0, of_elevation).0;
        let mut best = (Laser { elevation, azimuth }, 0);
        for elevation in elevations.into_iter().take(SAME) {
            let of_azimuth = |azimuth: i64, least| {
                exact_points(any, Laser { elevation, azimuth }, points, axes.clone(), least)
            };
            // No fewer than the best so far.
            let wanted = (points.len(), least.max(best.1 + 1));
            let (azimuths, exact) = angles(any.build.recipe, azimuth, wanted, AZIMUTH_STEP, of_azimuth);
            if exact > best.1 {
                best = (Laser { elevation, azimuth: azimuths.first().copied().unwrap_or(azimuth) }, exact);
            }
            if exact == points.len() {
                break;
            }
        }
        best
    }
}

/// Of some things the one worth the most, the first of equals.
fn first_of_equals<T>(all: Vec<T>, worth: impl Fn(&T) -> usize) -> Option<T> {
    all.into_iter().rev().max_by_key(worth)
}

/// The laser with the azimuth offset near its own by which the most of some points come out to the last bit, and how many do.
fn polished(any: &Firings, laser: Laser, points: &[Point]) -> (Laser, usize) {
    /// Steps to either side.
    const FARTHEST: i64 = 12;
    let steps = std::iter::once(0).chain((1..=FARTHEST).flat_map(|steps| [steps, -steps]));
    let tried = steps.map(|steps| Laser { azimuth: laser.azimuth + steps * AZIMUTH_STEP as i64, ..laser });
    best_of(any, tried, points, laser)
}

/// The same to the last bit of the offset in degrees, which points near the axes tell: there sums of angles are small.
fn sharpest(any: &Firings, laser: Laser, points: &[Point], near_axes: &[Point]) -> (Laser, usize) {
    /// Units to either side.
    const FARTHEST: f64 = 4.0 * AZIMUTH_STEP;
    let (laser, exact) = polished(any, laser, points);
    let step = (any.build.recipe.angle_step(laser.azimuth_degrees()) / ANGLE_UNIT).max(1.0);
    let steps = (1..=(FARTHEST / step) as i32).flat_map(|steps| [steps, -steps]);
    let azimuths =
        std::iter::once(0).chain(steps).map(|steps| laser.azimuth + (f64::from(steps) * step) as i64);
    let best = best_of(any, azimuths.map(|azimuth| Laser { azimuth, ..laser }), near_axes, laser).0;
    let exact_so = exact_points(any, best, points, 0..3, exact);
    if exact_so >= exact { (best, exact_so) } else { (laser, exact) }
}

/// The laser by which the most points come out to the last bit, the first of equals, and how many do; `none` if none do.
pub(super) fn best_of(
    any: &Firings,
    lasers: impl Iterator<Item = Laser>,
    points: &[Point],
    none: Laser,
) -> (Laser, usize) {
    lasers.fold((none, 0), |best, laser| {
        let exact = exact_points(any, laser, points, 0..3, best.1 + 1);
        if exact > best.1 { (laser, exact) } else { best }
    })
}

/// Azimuth offsets are not told better apart, in units.
const AZIMUTH_STEP: f64 = 1e-6 / ANGLE_UNIT;
/// Elevations of the same sine in single precision, at most.
const SAME: usize = 12;

/// How many points of a laser come out to the last bit along these axes; 0 as soon as they are sure to be fewer than
/// `least`.
pub(super) fn exact_points(
    any: &Firings,
    laser: Laser,
    points: &[Point],
    axes: std::ops::Range<usize>,
    least: usize,
) -> usize {
    let scanner = any.of_laser(laser);
    let is_exact = |point: &Point| {
        let Some((steps, tick)) = scanner.locate(0, point.position) else { return false };
        point.is_given_by(&scanner, &Return { row: 0, column: 0, tick, steps, echo: 0 }, axes.clone())
    };
    let mut missed = 0;
    for point in points {
        missed += usize::from(!is_exact(point));
        if missed + least > points.len() {
            return 0;
        }
    }
    points.len() - missed
}

/// The angles near another, in units, by which the most points come out, and how many do: as its maker may have written
/// it, and its neighbours as the program's numbers go, but not finer than a step. Fewer than `least` of the points count as
/// none. `count` says how many come out by an angle, or 0 if they are fewer than it is told.
fn angles(
    recipe: Recipe,
    near: i64,
    (points, least): (usize, usize),
    least_step: f64,
    count: impl Fn(i64, usize) -> usize,
) -> (Vec<i64>, usize) {
    let mut best: (Vec<i64>, usize) = (Vec::new(), 0);
    let try_all = |best: &mut (Vec<i64>, usize), angles: &mut dyn Iterator<Item = i64>| {
        for angle in angles {
            let count = count(angle, best.1.max(least));
            if count > best.1 {
                *best = (vec![angle], count);
            } else if count == best.1 && !best.0.contains(&angle) {
                best.0.push(angle);
            }
        }
    };
    let [thousandths, others @ ..] = roundings(near as f64 * ANGLE_UNIT);
    try_all(&mut best, &mut std::iter::once(thousandths).chain(others));
    if best.1 == points {
        return best;
    }
    if recipe == Recipe::Pandar64 {
        let short = round_ties_even(near as f64 * ANGLE_UNIT * 1e3 / SHORT_PI) * 1e-3 * SHORT_PI;
        try_all(&mut best, &mut std::iter::once((short / ANGLE_UNIT).round() as i64));
    }
    // Programs that keep single precision write seven digits, or more.
    let step = (recipe.angle_step(near as f64 * ANGLE_UNIT) / ANGLE_UNIT).max(least_step);
    let around = [thousandths, others[0]].into_iter();
    let neighbours = around.flat_map(|around| {
        let steps = (1..=NEIGHBOURS).flat_map(|steps| [steps, -steps]);
        steps.map(move |steps| around + (f64::from(steps) * step).round() as i64)
    });
    try_all(&mut best, &mut neighbours.into_iter());
    best
}

/// Some programs turn degrees into radians by 3.1415926: their angles are thousandths of degrees times this.
const SHORT_PI: f64 = 31_415_926.0 / 1e7 / std::f64::consts::PI;

/// Steps to either side in which the constant of a program is looked for that wrote it with fewer digits.
const NEIGHBOURS: i32 = 12;

/// An angle in degrees as its maker may have written it, in units: with three digits, with six, two, four and seven, and
/// as it is.
fn roundings(degrees: f64) -> [i64; 6] {
    let units = 1.0 / ANGLE_UNIT;
    [1e3, 1e6, 1e2, 1e4, 1e7, units]
        .map(|digits| (round_ties_even(degrees * digits) * (units / digits)).round() as i64)
}
