//! The constants of lasers, such that the file's coordinates are reproduced to the last bit: elevations and
//! azimuth offsets, rounded as manufacturers round them, and the recipe, found by trying all of them.

use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::arithmetic::whole_steps;
use super::blur::Blur;
use super::recipe::SumPrecision;
use super::{ANGLE_UNIT, Build, Firings, Laser, Mounting, Origin, Recipe};
use crate::ground::angle;
use crate::ground::floats::round_ties_even;
use crate::scanner::Return;
use crate::scanner::motion::Displacement;

/// Number of points of each laser on which recipes are tried.
pub(super) const TRIED: usize = 60;

/// A return of the sample, in metres and radians.
#[derive(Clone, Copy)]
pub(super) struct Point<'m> {
    pub position: [f64; 3],
    /// As seen from where its beam starts, or from where its range is measured.
    pub range: f64,
    pub elevation: f64,
    /// Clockwise from x; approximate.
    pub azimuth: f64,
    /// How it was moved to its position in the file, if it was.
    pub moved: Option<&'m Moved>,
}

/// A point that was moved after it was measured.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// The measured position, as accurately as it is known, in metres.
    pub measured: [f64; 3],
    /// How it was moved.
    pub(in crate::scanner) by: MovedBy,
    /// The position in the file.
    pub position: [f32; 3],
}

/// How a point was moved after it was measured.
#[derive(Clone, Copy, Debug)]
pub(in crate::scanner) enum MovedBy {
    /// By a motion of its own, of which it shows little.
    Motion(Displacement),
    /// To the frame of a vehicle; the measured position is accurate to the last bit.
    Mounting(Mounting),
}

impl<'m> Point<'m> {
    /// `None` if the position is not finite or lies on the axis.
    pub fn new(position: [f64; 3], moved: Option<&'m Moved>) -> Option<Self> {
        let [x, y, z] = position;
        let rho = (x * x + y * y).sqrt();
        let range = (rho * rho + z * z).sqrt();
        (range.is_finite() && rho > 0.0).then(|| Point {
            position,
            range,
            elevation: libm::atan2(z, rho),
            azimuth: angle::atan2(-y, x),
            moved,
        })
    }

    /// This point as measured by a beam through a focal point, this many metres in front of the axis.
    pub fn through(self, focal: f64) -> Self {
        let [x, y, z] = self.position;
        let rho = (x * x + y * y).sqrt();
        let elevation = libm::atan2(z, rho - focal);
        Point { range: rho / libm::cos(elevation), elevation, ..self }
    }

    /// Whether the point was moved by a motion of its own, so that its measured position is not known to the last
    /// bit.
    fn was_in_motion(&self) -> bool {
        matches!(self.moved, Some(Moved { by: MovedBy::Motion(_), .. }))
    }

    /// Whether a scanner's recipe reproduces the point's coordinates in the file to the last bit, along these
    /// axes.
    pub(super) fn is_reproduced_by(
        &self,
        scanner: &Firings,
        found: &Return,
        axes: std::ops::Range<usize>,
    ) -> bool {
        let Some(Moved { by, position, .. }) = self.moved else {
            return scanner.reproduces(found, &self.position, axes);
        };
        let mut start = self.position;
        let formula = match by {
            MovedBy::Mounting(mounting) if !mounting.order.rounds_first() => scanner.unrounded(found),
            _ => scanner.position(found, 0.0),
        };
        axes.clone().for_each(|axis| start[axis] = formula[axis]);
        let (moved, mut shown) = match by {
            MovedBy::Motion(motion) => (motion.moved(start), axes),
            MovedBy::Mounting(mounting) => (mounting.moved(&start), 0..3),
        };
        shown.all(|axis| moved[axis] as f32 == position[axis])
    }
}

/// About `most` points of each row, only far ones if there are enough.
pub(super) fn by_rows<'m>(
    points: &[Point<'m>],
    rows: &[Option<usize>],
    count: usize,
    most: usize,
) -> Vec<Vec<Point<'m>>> {
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

/// The points of each row that are nearest to a coordinate axis of the file.
pub(super) fn near_axes<'m>(
    points: &[Point<'m>],
    rows: &[Option<usize>],
    count: usize,
) -> Vec<Vec<Point<'m>>> {
    /// Largest number of points of a row.
    const MOST: usize = 40;
    /// Distance from the axis, as a fraction of the coordinate along it.
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

/// What is known about the lasers before their constants are rounded as the manufacturer wrote them.
pub(super) struct Constants<'m> {
    /// In radians, from the highest to the lowest.
    pub elevations: Vec<f64>,
    /// Azimuth offsets in ticks, without whole ticks.
    pub phases: Vec<f64>,
    /// The mean of the azimuth offsets, in degrees, to half a tick. 0 if it is not known.
    pub mean_offset: f64,
    /// Some points of each laser.
    pub of_rows: Vec<Vec<Point<'m>>>,
    /// Ten times as many points of each laser.
    pub more_of_rows: Vec<Vec<Point<'m>>>,
    /// The points of each laser that are nearest to an axis.
    pub near_axes: Vec<Vec<Point<'m>>>,
}

/// What reproduces the points of a scan.
#[derive(Clone)]
pub(super) struct LaserFit {
    pub recipe: Recipe,
    /// With their constants.
    pub lasers: Vec<Laser>,
    /// Whether each offset was corrected by whole ticks of its own.
    pub are_turned: bool,
}

/// What a recipe reproduces of a few rows.
#[derive(Clone)]
struct TriedRecipe<'r> {
    /// Its scanner without lasers.
    bare: &'r Firings,
    /// The whole ticks by which all offsets are wrong.
    common: i32,
    /// Number of points.
    exact: usize,
}

impl TriedRecipe<'_> {
    /// Whether the recipe adds angles.
    fn adds(&self) -> bool {
        self.bare.build.recipe.sum().is_some()
    }
}

impl Constants<'_> {
    /// The recipe that reproduces the most points to the last bit (the first one on ties), and the lasers.
    /// `shifts` are the whole ticks by which each laser is ahead of the others.
    pub fn determine(&self, build: &Build, shifts: &[f64]) -> Option<LaserFit> {
        let offsets = self.offsets(build.ticks, shifts);
        if Blur::of(build.coordinates).is_any() {
            return Some(self.of_rounded(build, &offsets));
        }
        let few = self.few_rows();
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let is_on_axis = build.origin == Origin::default();
        let recipes = Recipe::ALL.into_iter().filter(|recipe| match is_on_axis {
            true => recipe.may_start_in_one_point(),
            false => recipe.starts_in_beam(),
        });
        let known = recipes.map(|recipe| Firings::without_lasers(Build { recipe, ..build.clone() }));
        let known: Vec<Firings> = known.collect();
        let tried = self.tried(&known, &offsets, &few, points);
        let best = first_of_equals(tried.clone(), |tried| tried.exact)?;
        let turned = (4 * best.exact < 3 * points).then(|| {
            let exact = |bare: &Firings| self.exact_turned(bare, &offsets, &few);
            let tried = known.par_iter().map(|bare| TriedRecipe { bare, common: 0, exact: exact(bare) });
            first_of_equals(tried.collect(), |tried| tried.exact)
        });
        let turned = turned.flatten().filter(|turned| 4 * turned.exact >= 3 * points);
        let are_turned = turned.is_some();
        let rivals = match turned {
            Some(turned) => vec![turned],
            // Recipes that add angles differ so little that several may reproduce all of these points.
            None if best.adds() => {
                tried.into_iter().filter(|tried| tried.adds() && tried.exact == best.exact).collect()
            }
            None => vec![best],
        };
        let tick = 360.0 / f64::from(build.ticks);
        let fits = rivals.into_iter().map(|TriedRecipe { bare, common, exact }| {
            let may_turn = bare.build.recipe.adds_in_single() && 2 * exact > points;
            let of_row = |row| self.laser_of(bare, row, offsets[row] + f64::from(common) * tick, may_turn);
            let lasers: Vec<Laser> = (0..self.elevations.len()).into_par_iter().map(of_row).collect();
            (bare, lasers)
        });
        let fits: Vec<(&Firings, Vec<Laser>)> = fits.collect();
        let (bare, lasers) = match fits.len() {
            1 => fits.into_iter().next()?,
            _ => first_of_equals(fits, |(bare, lasers)| self.worth(bare, lasers))?,
        };
        Some(LaserFit { recipe: bare.build.recipe, lasers, are_turned })
    }

    /// The azimuth offsets in degrees, given the whole ticks by which each laser is ahead of the others, such
    /// that their mean is within half a tick of what is known of it.
    fn offsets(&self, ticks: u32, shifts: &[f64]) -> Vec<f64> {
        let tick = 360.0 / f64::from(ticks);
        let ahead = self.phases.iter().zip(shifts).map(|(phase, shift)| (phase + shift) * tick);
        let ahead: Vec<f64> = ahead.collect();
        let mean = ahead.iter().sum::<f64>() / ahead.len().max(1) as f64;
        let middle = round_ties_even((self.mean_offset - mean) / tick) * tick;
        ahead.into_iter().map(|offset| offset + middle).collect()
    }

    /// Some of the rows with the most points: the recipe is chosen by them.
    fn few_rows(&self) -> Vec<usize> {
        /// Number of rows, if there are as many.
        const FEW: usize = 6;
        let mut rows: Vec<usize> = (0..self.elevations.len()).collect();
        rows.sort_by_key(|&row| std::cmp::Reverse(self.of_rows[row].len()));
        rows.truncate((rows.len() / 2).max(FEW));
        rows.iter().step_by((rows.len() / FEW).max(1)).copied().collect()
    }

    /// Tries recipes on all `points` of these rows. One that reproduces fewer than another need not be counted
    /// to the end, and one after the first that reproduces all of them need not be tried, unless it adds
    /// angles.
    fn tried<'r>(
        &self,
        known: &'r [Firings],
        offsets: &[f64],
        few: &[usize],
        points: usize,
    ) -> Vec<TriedRecipe<'r>> {
        let (most, first_perfect) = (AtomicUsize::new(0), AtomicUsize::new(usize::MAX));
        let tried = known.par_iter().enumerate().filter_map(|(number, bare)| {
            let is_needless = number > first_perfect.load(Ordering::Relaxed);
            if is_needless && bare.build.recipe.sum().is_none() {
                return None;
            }
            let (common, exact) = self.common(bare, offsets, few, most.load(Ordering::Relaxed));
            most.fetch_max(exact, Ordering::Relaxed);
            if exact == points {
                first_perfect.fetch_min(number, Ordering::Relaxed);
            }
            Some(TriedRecipe { bare, common, exact })
        });
        tried.collect()
    }

    /// What lasers are worth: the number of points that they reproduce to the last bit, in hundredths; more
    /// for those of lasers whose constants have few digits, which is likely with the right recipe only.
    fn worth(&self, bare: &Firings, lasers: &[Laser]) -> usize {
        let of_row = |(laser, points): (&Laser, &Vec<Point>)| {
            let round = [laser.elevation, laser.azimuth].map(|angle| usize::from(is_thousandth(angle)));
            reproduced_points(bare, *laser, points, 0..3, 0) * (100 + round[0] + round[1])
        };
        lasers.iter().zip(&self.more_of_rows).map(of_row).sum()
    }

    /// The constants of a laser, given its azimuth offset in degrees, as accurately as its points determine
    /// them. If `may_turn`, the offset may be wrong by whole ticks of its own, because there were too few
    /// points or because ticks pass until the laser fires.
    fn laser_of(&self, bare: &Firings, row: usize, offset: f64, may_turn: bool) -> Laser {
        let (elevations, _) = self.elevations(bare, row, 0);
        let (mut laser, exact) = self.laser_among(bare, row, offset, &elevations, 0);
        if may_turn && 4 * exact < 3 * self.of_rows[row].len() {
            laser = self.turned(bare, row, offset, &elevations).0;
        }
        if bare.build.recipe.sum().is_some() { self.of_sums(bare, row, laser) } else { laser }
    }

    /// What reproduces points whose coordinates were rounded, given the offsets of the lasers in degrees.
    /// Rounding hides which recipe it was, and the last digits of constants.
    fn of_rounded(&self, build: &Build, offsets: &[f64]) -> LaserFit {
        /// Digits of angles in degrees; the last are those of the unit.
        const DIGITS: [f64; 4] = [1.0, 1e2, 1e3, 1.0 / ANGLE_UNIT];
        /// In degrees: the largest error of an angle.
        const UNSURE: f64 = 2e-3;
        let recipe = Recipe::DoubleXAhead;
        let bare = Firings::without_lasers(Build { recipe, ..build.clone() });
        let written = |degrees: f64| {
            let rounded = DIGITS.map(|digits| round_ties_even(degrees * digits) / digits);
            let near = rounded.into_iter().filter(move |rounded| (rounded - degrees).abs() < UNSURE);
            near.map(|degrees| (degrees / ANGLE_UNIT).round() as i64)
        };
        let of_row = |row: usize| {
            let elevations = written(self.elevations[row].to_degrees());
            let lasers = elevations
                .flat_map(|elevation| written(offsets[row]).map(move |azimuth| Laser { elevation, azimuth }));
            let none = lasers.clone().last().unwrap_or_default();
            best_of(&bare, lasers, &self.more_of_rows[row], (none, 0)).0
        };
        let lasers = (0..self.elevations.len()).into_par_iter().map(of_row).collect();
        LaserFit { recipe, lasers, are_turned: false }
    }

    /// Number of points of these rows that are reproduced if each offset is corrected by whole ticks of its
    /// own, as is necessary if ticks pass between the lasers of a firing. 0 if points were moved, if the
    /// recipe does not round sums to single precision, or if it does not reproduce three quarters of the
    /// heights.
    fn exact_turned(&self, bare: &Firings, offsets: &[f64], few: &[usize]) -> usize {
        if self.are_moved(few) || !bare.build.recipe.adds_in_single() {
            return 0;
        }
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let elevations = self.elevations_of(bare, few, (3 * points).div_ceil(4));
        let exact = |(&row, (elevations, _)): (&usize, &(Vec<i64>, usize))| {
            self.turned(bare, row, offsets[row], elevations).1
        };
        few.iter().zip(&elevations).map(exact).sum()
    }

    /// The laser near another one that reproduces the most of many points to the last bit. With sums in
    /// single precision, only many points determine the offset, and only then does the cosine distinguish
    /// elevations of equal sine.
    fn of_sums(&self, bare: &Firings, row: usize, laser: Laser) -> Laser {
        let points = &self.more_of_rows[row];
        // Constants of few digits that reproduce most points are right: other points have another cause.
        if is_thousandth(laser.elevation) && is_thousandth(laser.azimuth) {
            let least = points.len() * 97 / 100;
            if reproduced_points(bare, laser, points, 0..3, least) >= least {
                return laser;
            }
        }
        let mut best = polished(bare, (laser, 0), points);
        if best.1 < points.len() {
            let step = bare.build.recipe.angle_step(laser.elevation_degrees()) / ANGLE_UNIT;
            let steps = (1..=SAME as i32).flat_map(|steps| [steps, -steps]);
            let others = steps.map(|steps| laser.elevation + (f64::from(steps) * step).round() as i64);
            let high = reproduced_points(bare, laser, points, 2..3, 0);
            for elevation in others {
                let other = Laser { elevation, ..laser };
                if reproduced_points(bare, other, points, 2..3, high) >= high {
                    let polished = polished(bare, (other, best.1), points);
                    best = if polished.1 > best.1 { polished } else { best };
                }
            }
        }
        sharpest(bare, best, points, &self.near_axes[row])
    }

    /// The constants of a laser whose azimuth offset, in degrees, is wrong by an unknown number of whole
    /// ticks, and how many of its points they reproduce to the last bit, given the likeliest elevations.
    fn turned(&self, bare: &Firings, row: usize, offset: f64, elevations: &[i64]) -> (Laser, usize) {
        /// Largest number of ticks: 40 pass while lasers fire, and the order of a sparse scan may be wrong by more.
        const MOST: i32 = 200;
        let tick = 360.0 / f64::from(bare.build.ticks);
        let (laser, exact) = self.laser_among(bare, row, offset, elevations, 0);
        let points = &self.of_rows[row];
        if exact == points.len() {
            return (laser, exact);
        }
        let off = (1..=MOST).flat_map(|ticks| [ticks, -ticks]).map(|ticks| offset + f64::from(ticks) * tick);
        let lasers = off.map(|degrees| Laser { azimuth: roundings(degrees)[0], ..laser });
        let lasers = lasers.filter(|laser| may_be_right(bare, *laser, points));
        let (best, _) = best_of(bare, lasers, points, (laser, 0));
        let (other, others) = self.laser_among(bare, row, best.azimuth_degrees(), elevations, exact);
        // A chance match, or another recipe, does not reproduce most points.
        if others > exact && 4 * others >= 3 * points.len() { (other, others) } else { (laser, exact) }
    }

    /// The whole ticks by which all offsets are wrong, as far as these rows determine them, and how many of
    /// their points are then reproduced: possibly 0 if there are fewer than `least`.
    fn common(&self, bare: &Firings, offsets: &[f64], few: &[usize], least: usize) -> (i32, usize) {
        /// Smaller offsets, in degrees, count as none.
        const NONE: f64 = 1e-5;
        let is_whole = 360_000 % bare.build.ticks == 0;
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let has_none = offsets.iter().all(|offset| offset.abs() < NONE);
        let is_known = is_whole && (has_none || !bare.build.recipe.adds_in_single());
        // Heights do not depend on the offset, so they show whether this is the right recipe at all. The
        // heights of points that were moved show nothing.
        let elevations = self.elevations_of(bare, few, if self.are_moved(few) { 0 } else { least });
        if elevations.is_empty() {
            return (0, 0);
        }
        // `left` is the number of points that may still be missed.
        let (mut found, mut left) = (Vec::new(), points - least.min(points));
        for (&row, (elevations, _)) in few.iter().zip(&elevations) {
            let least = if is_known { self.of_rows[row].len().saturating_sub(left) } else { 0 };
            // `least` depends on what other threads have found so far, so it must not decide whether to give
            // up.
            let wanted = if is_known { least.max(1) } else { 0 };
            let (laser, exact) = self.laser_among(bare, row, offsets[row], elevations, wanted);
            if exact < least {
                return (0, 0);
            }
            if is_known {
                left -= self.of_rows[row].len() - exact;
            }
            found.push((laser, exact));
        }
        let exact: usize = found.iter().map(|(_, exact)| exact).sum();
        // Sums of degrees depend on the error only where they pass the end of the turn.
        let is_shown = bare.build.recipe.sum() != Some(SumPrecision::Degrees);
        if is_known || (exact == points && is_shown) {
            return (0, exact);
        }
        let tried = Tried { constants: self, bare, offsets, rows: few, elevations: &elevations, found };
        if is_whole { tried.common_in_single_precision(least) } else { tried.common_of_fractions() }
    }

    /// Whether points of these rows were moved.
    fn are_moved(&self, rows: &[usize]) -> bool {
        rows.iter().any(|&row| self.of_rows[row].iter().any(|point| point.moved.is_some()))
    }

    /// The likeliest elevations of these lasers, in units, and for how many points they reproduce the height;
    /// nothing if there are certainly fewer than `least` of these points.
    fn elevations_of(&self, bare: &Firings, rows: &[usize], least: usize) -> Vec<(Vec<i64>, usize)> {
        let points: usize = rows.iter().map(|&row| self.of_rows[row].len()).sum();
        let mut left = points.checked_sub(least);
        let mut all = Vec::new();
        for &row in rows {
            let Some(may_miss) = left else { return Vec::new() };
            let size = self.of_rows[row].len();
            let found = self.elevations(bare, row, size.saturating_sub(may_miss));
            left = may_miss.checked_sub(size - found.1);
            all.push(found);
        }
        if left.is_some() { all } else { Vec::new() }
    }

    /// The same for one laser.
    fn elevations(&self, bare: &Firings, row: usize, least: usize) -> (Vec<i64>, usize) {
        let points = &self.of_rows[row];
        // Ranges are whole steps, so the height and the rounded range give the elevation more accurately than
        // the position does, if beams start in the axis.
        let elevation = |point: &Point| {
            if bare.build.origin != Origin::default() {
                return Some(point.elevation);
            }
            let steps = whole_steps(point.range, bare.range_step_m())?;
            Some(libm::asin((point.position[2] / (f64::from(steps) * bare.range_step_m())).clamp(-1.0, 1.0)))
        };
        let mut elevations: Vec<f64> = points.iter().filter_map(elevation).collect();
        elevations.sort_by(f64::total_cmp);
        let elevation = elevations.get(elevations.len() / 2).copied().unwrap_or(self.elevations[row]);
        let elevation = (elevation.to_degrees() / ANGLE_UNIT).round() as i64;
        // The height determines the elevation, except among elevations of the same sine.
        let azimuth = 0;
        let of_elevation = |elevation: i64, least| {
            reproduced_points(bare, Laser { elevation, azimuth }, points, 2..3, least)
        };
        angles(bare.build.recipe, elevation, (points.len(), least), 0.0, of_elevation)
    }

    /// The constants of a laser, given its azimuth offset in degrees and its likeliest elevations, and how
    /// many of its points they reproduce to the last bit: possibly none if there are fewer than `least`. If
    /// that is 0, gives up where the offset is clearly wrong.
    fn laser_among(
        &self,
        bare: &Firings,
        row: usize,
        offset: f64,
        elevations: &[i64],
        least: usize,
    ) -> (Laser, usize) {
        /// With the right offset, one point in this number or more is reproduced unless points were moved.
        const FEW: usize = 8;
        let points = &self.of_rows[row];
        let azimuth = (offset / ANGLE_UNIT).round() as i64;
        let are_moved = self.are_moved(&[row]);
        // Heights near 0 are reproduced only if the motion is known more accurately than it can be.
        let axes = if are_moved { 0..2 } else { 0..3 };
        let elevation = elevations.first().copied();
        let elevation = elevation.unwrap_or((self.elevations[row].to_degrees() / ANGLE_UNIT).round() as i64);
        let mut best = (Laser { elevation, azimuth }, 0);
        for &elevation in elevations.iter().take(SAME) {
            let of_azimuth = |azimuth: i64, least| {
                reproduced_points(bare, Laser { elevation, azimuth }, points, axes.clone(), least)
            };
            // Only more points than the best so far count.
            let wanted = (points.len(), least.max(best.1 + 1));
            let (azimuths, exact) = angles(bare.build.recipe, azimuth, wanted, AZIMUTH_STEP, of_azimuth);
            if exact > best.1 {
                best = (Laser { elevation, azimuth: azimuths.first().copied().unwrap_or(azimuth) }, exact);
            }
            // Elevations of the same sine differ little in their cosine, so if the first one reproduces
            // hardly any point, the offset is wrong.
            let most_of_wrong = if are_moved { 0 } else { points.len() / FEW };
            if exact == points.len() || (best.1 <= most_of_wrong && least == 0) {
                break;
            }
        }
        best
    }
}

/// The lasers of some rows, found with a recipe whose offsets may all be wrong by the same number of ticks.
struct Tried<'c> {
    constants: &'c Constants<'c>,
    /// Without lasers.
    bare: &'c Firings,
    /// The azimuth offsets of all rows, in degrees.
    offsets: &'c [f64],
    rows: &'c [usize],
    /// The likeliest elevations of each of these rows, and for how many points they reproduce the height.
    elevations: &'c [(Vec<i64>, usize)],
    /// The laser of each of these rows, and how many of its points it reproduces.
    found: Vec<(Laser, usize)>,
}

impl Tried<'_> {
    /// The offset of a row, in degrees, if all are wrong by this number of ticks.
    fn offset(&self, row: usize, common: i32) -> f64 {
        self.offsets[row] + f64::from(common) * (360.0 / f64::from(self.bare.build.ticks))
    }

    /// From the middle outwards, so that the smallest error wins ties.
    fn rising(most: i32) -> impl Iterator<Item = i32> {
        (1..=most).flat_map(|common| [common, -common])
    }

    /// The error, and the number of points that are then reproduced, if ticks are no whole thousandths of
    /// degrees. With the right one most offsets are.
    fn common_of_fractions(&self) -> (i32, usize) {
        /// The largest error that is tried.
        const FARTHEST: i32 = 4;
        let exact = |lasers: &[(Laser, usize)]| lasers.iter().map(|(_, exact)| exact).sum::<usize>();
        let worth = |lasers: &[(Laser, usize)]| {
            let thousandths = lasers.iter().filter(|(laser, _)| is_thousandth(laser.azimuth)).count();
            (exact(lasers), thousandths)
        };
        let (mut best, mut of_best) = (0, self.found.clone());
        for common in Self::rising(FARTHEST) {
            let mut lasers = Vec::new();
            for (&row, (elevations, _)) in self.rows.iter().zip(self.elevations) {
                let offset = self.offset(row, common);
                lasers.push(self.constants.laser_among(self.bare, row, offset, elevations, 0));
                // With the right error lasers reproduce no fewer points than with another.
                if exact(&lasers) < exact(&of_best[..lasers.len()]) {
                    break;
                }
            }
            if lasers.len() == self.rows.len() && worth(&lasers) > worth(&of_best) {
                (best, of_best) = (common, lasers);
            }
        }
        (best, exact(&of_best))
    }

    /// The same if ticks are whole thousandths of degrees: whole ticks then matter only because the recipe
    /// rounds sums to single precision. The error is 0 if fewer than `least` points would be reproduced.
    fn common_in_single_precision(&self, least: usize) -> (i32, usize) {
        /// The largest error that is tried.
        const FARTHEST: i32 = 1200;
        /// Every n-th point is enough to try errors.
        const SPARSE: usize = 4;
        /// In degrees: no offset is this near to a thousandth by chance.
        const NEAR_THOUSANDTH: f64 = 1e-4;
        let Constants { of_rows, more_of_rows, .. } = self.constants;
        let exact: usize = self.found.iter().map(|(_, exact)| exact).sum();
        let points: usize = self.rows.iter().map(|&row| of_rows[row].len()).sum();
        let lasers = self.rows.iter().zip(&self.found);
        let heights: usize = lasers
            .map(|(&row, (laser, _))| reproduced_points(self.bare, *laser, &of_rows[row], 2..3, 0))
            .sum();
        if 2 * heights < points || heights < least {
            return (0, exact);
        }
        let Build { recipe, ticks, .. } = self.bare.build;
        let adds_degrees = recipe.sum() == Some(SumPrecision::Degrees);
        // Of sums of degrees, the error is shown only by points near the end of the turn.
        let farthest = f64::from(FARTHEST) * TAU / f64::from(ticks);
        let is_near_end = |point: &&Point| {
            let [x, y, _] = point.position;
            recipe.azimuth(x, y).abs() < farthest
        };
        let fewer = |&row: &usize| -> Vec<Point> {
            match adds_degrees {
                true => more_of_rows[row].iter().filter(is_near_end).copied().collect(),
                false => of_rows[row].iter().step_by(SPARSE).copied().collect(),
            }
        };
        let fewer: Vec<Vec<Point>> = self.rows.iter().map(fewer).collect();
        // Sums in single precision depend on the last digits of the offsets, so these should be right.
        let is_thousandth = |&row: &usize| {
            let off = self.offsets[row] - roundings(self.offsets[row])[0] as f64 * ANGLE_UNIT;
            off.abs() < NEAR_THOUSANDTH
        };
        let are_moved = self.constants.are_moved(self.rows);
        let are_thousandths = are_moved || self.rows.iter().all(is_thousandth);
        if adds_degrees && exact == points && (are_moved || !are_thousandths) {
            return (0, exact);
        }
        let all = std::iter::once(0).chain(Self::rising(FARTHEST));
        let common = if are_thousandths && !are_moved {
            let size: usize = fewer.iter().map(Vec::len).sum();
            // With the right error most points are reproduced.
            let fewest = (size * 3 / 4).max(1);
            if adds_degrees {
                self.best_errors(all, &fewer, fewest).first().copied().unwrap_or(0)
            } else {
                // No more of these points may be missed than of all points.
                let least = size.saturating_sub(points - least.min(points)).max(fewest);
                let more: Vec<Vec<Point>> = self.rows.iter().map(|&row| more_of_rows[row].clone()).collect();
                let errors = self.best_errors(all, &fewer, least).into_iter();
                let best = errors.fold((0, 0), |best, common| {
                    self.count(common, true, &more, best.0 + 1).map_or(best, |count| (count, common))
                });
                best.1
            }
        } else {
            self.likeliest(all, are_moved, &fewer)
        };
        let exact_so = |(&row, (elevations, _)): (&usize, &(Vec<i64>, usize))| {
            self.constants.laser_among(self.bare, row, self.offset(row, common), elevations, 0).1
        };
        let sum = self.rows.iter().zip(self.elevations).map(exact_so).sum();
        if sum >= exact { (common, sum) } else { (0, exact) }
    }

    /// The errors of offsets in whole thousandths of degrees that reproduce the most of these points, but at
    /// least `least`: the first ones, if there are many.
    fn best_errors(&self, all: impl Iterator<Item = i32>, points: &[Vec<Point>], least: usize) -> Vec<i32> {
        let (mut most, mut best) = (least, Vec::new());
        for common in all {
            let Some(count) = self.count(common, true, points, most) else { continue };
            if count > most {
                (most, best) = (count, Vec::new());
            }
            best.push(common);
        }
        best.truncate(LIKELIEST);
        best
    }

    /// The number of these points of the rows that are reproduced if all offsets are wrong by this number of
    /// ticks, or `None` if there are fewer than `least`.
    fn count(
        &self,
        common: i32,
        are_thousandths: bool,
        points: &[Vec<Point>],
        least: usize,
    ) -> Option<usize> {
        let all: usize = points.iter().map(Vec::len).sum();
        let mut left = all.checked_sub(least)?;
        for ((&row, (laser, _)), points) in self.rows.iter().zip(&self.found).zip(points) {
            let degrees = self.offset(row, common);
            let azimuth =
                if are_thousandths { roundings(degrees)[0] } else { (degrees / ANGLE_UNIT).round() as i64 };
            let least = points.len().saturating_sub(left);
            let laser = Laser { azimuth, ..*laser };
            let exact = match may_be_right(self.bare, laser, points) {
                true => reproduced_points(self.bare, laser, points, 0..3, least),
                false => 0,
            };
            left = left.checked_sub(points.len() - exact)?;
        }
        Some(least + left)
    }

    /// The error with which the most points are reproduced, while the motion or the last digits of the
    /// offsets are not known well. Few points are then reproduced, so the likeliest errors are compared on
    /// more points.
    fn likeliest(&self, all: impl Iterator<Item = i32>, are_moved: bool, fewer: &[Vec<Point>]) -> i32 {
        let Constants { of_rows, more_of_rows, .. } = self.constants;
        let mut counted: Vec<_> =
            all.map(|common| (self.count(common, are_moved, fewer, 0), common)).collect();
        counted.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        counted.truncate(LIKELIEST);
        let more: Vec<Vec<Point>> = self.rows.iter().map(|&row| more_of_rows[row].clone()).collect();
        let polished = |common: i32, (&row, (laser, _)): (&usize, &(Laser, usize))| {
            let azimuth = (self.offset(row, common) / ANGLE_UNIT).round() as i64;
            polished(self.bare, (Laser { azimuth, ..*laser }, 0), &of_rows[row]).1
        };
        let count = |common: i32| match are_moved {
            true => self.count(common, true, &more, 0).unwrap_or(0),
            false => self.rows.iter().zip(&self.found).map(|laser| polished(common, laser)).sum(),
        };
        // The first one wins ties.
        let counted = counted.into_iter().map(|(_, common)| (count(common), common));
        counted.fold((0, 0), |best, next| if next.0 > best.0 { next } else { best }).1
    }
}

/// Number of errors that are compared on more points.
const LIKELIEST: usize = 32;

/// The element that is worth the most, the first one on ties.
fn first_of_equals<T>(all: Vec<T>, worth: impl Fn(&T) -> usize) -> Option<T> {
    all.into_iter().rev().max_by_key(worth)
}

/// The laser with an azimuth offset near the given one that reproduces the most points to the last bit, and
/// how many: the given one if none reproduces more than the given number.
fn polished(bare: &Firings, (laser, exact): (Laser, usize), points: &[Point]) -> (Laser, usize) {
    /// Steps to either side.
    const FARTHEST: i64 = 12;
    let steps = std::iter::once(0).chain((1..=FARTHEST).flat_map(|steps| [steps, -steps]));
    let tried = steps.map(|steps| Laser { azimuth: laser.azimuth + steps * AZIMUTH_STEP as i64, ..laser });
    best_of(bare, tried, points, (laser, exact))
}

/// The offset of a laser to the last bit in degrees, unless it then reproduces fewer than `exact` points.
/// Points near the axes determine it, because sums of angles are small there.
fn sharpest(bare: &Firings, (laser, exact): (Laser, usize), points: &[Point], near_axes: &[Point]) -> Laser {
    /// Units to either side.
    const FARTHEST: f64 = 4.0 * AZIMUTH_STEP;
    let step = (bare.build.recipe.angle_step(laser.azimuth_degrees()) / ANGLE_UNIT).max(1.0);
    let steps = (1..=(FARTHEST / step) as i32).flat_map(|steps| [steps, -steps]);
    let azimuths =
        std::iter::once(0).chain(steps).map(|steps| laser.azimuth + (f64::from(steps) * step) as i64);
    let (best, _) = best_of(bare, azimuths.map(|azimuth| Laser { azimuth, ..laser }), near_axes, (laser, 0));
    if reproduced_points(bare, best, points, 0..3, exact) >= exact { best } else { laser }
}

/// The laser that reproduces the most points to the last bit, the first one on ties, and how many; `best` if
/// none reproduces more than that one.
pub(super) fn best_of(
    bare: &Firings,
    lasers: impl Iterator<Item = Laser>,
    points: &[Point],
    best: (Laser, usize),
) -> (Laser, usize) {
    lasers.fold(best, |best, laser| {
        let exact = reproduced_points(bare, laser, points, 0..3, best.1 + 1);
        if exact > best.1 { (laser, exact) } else { best }
    })
}

/// The resolution of azimuth offsets, in units.
const AZIMUTH_STEP: f64 = 1e-6 / ANGLE_UNIT;
/// Largest number of elevations with the same sine in single precision.
const SAME: usize = 12;

/// Whether a laser reproduces one of its first points or more, as it does if its constants are right, unless
/// points were moved by a motion.
fn may_be_right(bare: &Firings, laser: Laser, points: &[Point]) -> bool {
    const SOME: usize = 20;
    let some = &points[..points.len().min(SOME)];
    some.iter().any(Point::was_in_motion) || reproduced_points(bare, laser, some, 0..3, 1) > 0
}

/// Number of points of a laser that are reproduced to the last bit along these axes; 0 as soon as there are
/// certainly fewer than `least`.
pub(super) fn reproduced_points(
    bare: &Firings,
    laser: Laser,
    points: &[Point],
    axes: std::ops::Range<usize>,
    least: usize,
) -> usize {
    let scanner = bare.of_laser(laser);
    let is_on_axis = bare.build.origin == Origin::default();
    let is_exact = |point: &Point| {
        let located = match is_on_axis {
            true => scanner.locate_from_axis(0, point.range, point.azimuth),
            false => scanner.locate(0, point.position),
        };
        let Some((steps, tick)) = located else { return false };
        point.is_reproduced_by(&scanner, &Return { row: 0, column: 0, tick, steps, echo: 0 }, axes.clone())
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

/// The angles near another, in units, that reproduce the most points, and how many. Tries the angle as its
/// manufacturer may have written it, and neighbours at the resolution of the program's numbers, but in steps
/// of at least `least_step`. Fewer than `least` points count as none. `count` returns the number of points
/// that an angle reproduces, or 0 if there are fewer than its second argument.
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
    let radians = round_ties_even((near as f64 * ANGLE_UNIT).to_radians() * 1e4) * 1e-4;
    try_all(&mut best, &mut std::iter::once((radians.to_degrees() / ANGLE_UNIT).round() as i64));
    if matches!(recipe, Recipe::Pandar64 | Recipe::Pandar64InDegrees) {
        let short = round_ties_even(near as f64 * ANGLE_UNIT * 1e3 / SHORT_PI) * 1e-3 * SHORT_PI;
        try_all(&mut best, &mut std::iter::once((short / ANGLE_UNIT).round() as i64));
    }
    // Programs that use single precision write seven digits or more.
    let step = (recipe.angle_step(near as f64 * ANGLE_UNIT) / ANGLE_UNIT).max(least_step);
    let around = [thousandths, others[0]].into_iter();
    let neighbours = around.flat_map(|around| {
        let steps = (1..=NEIGHBOURS).flat_map(|steps| [steps, -steps]);
        steps.map(move |steps| around + (f64::from(steps) * step).round() as i64)
    });
    try_all(&mut best, &mut neighbours.into_iter());
    best
}

/// Some programs convert degrees to radians with 3.1415926 for pi: their angles are thousandths of degrees
/// times this.
const SHORT_PI: f64 = 31_415_926.0 / 1e7 / std::f64::consts::PI;

/// Number of steps to either side that are tried, for a constant that a program wrote with fewer digits.
const NEIGHBOURS: i32 = 12;

/// Whether an angle, in units, is a whole number of thousandths of a degree.
fn is_thousandth(angle: i64) -> bool {
    angle % (1e-3 / ANGLE_UNIT) as i64 == 0
}

/// An angle in degrees as its manufacturer may have written it, in units: with three, six, two, four and
/// seven digits, and unrounded.
fn roundings(degrees: f64) -> [i64; 6] {
    let units = 1.0 / ANGLE_UNIT;
    [1e3, 1e6, 1e2, 1e4, 1e7, units]
        .map(|digits| (round_ties_even(degrees * digits) * (units / digits)).round() as i64)
}
