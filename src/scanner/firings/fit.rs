//! Fits a scanner of firings to points alone: the range step and the azimuth ticks by the coherence of the
//! points with them, the lasers by their cones and [constants](super::constants), and their order by which
//! laser follows which.

use std::borrow::Cow;
use std::f64::consts::TAU;

use rayon::prelude::*;

use super::blur::Blur;
use super::constants::{Constants, LaserFit, Moved, Point, TRIED, by_rows, near_axes};
use super::order::{FiringOrder, STEADY, VLP_16, lines, order, timed, vlp_16};
use super::projection::{nearest, without_echoes};
use super::timing::Span;
use super::{Build, Firings, Origin, Recipe, Timing};
use crate::ground::angle::shorter_way;
use crate::ground::floats::round_ties_even;
use crate::scan::{PointCloud, ScanFile, fullest};
use crate::scanner::{CoordinateGrid, PLAUSIBLE_LASERS, REACH};

/// Range steps of known scanners, in micrometres, coarse ones first: multiples of a step are also multiples
/// of its divisors.
const RANGE_STEPS_UM: [u32; 9] = [12_000, 10_000, 8_000, 5_000, 4_000, 2_500, 2_000, 1_000, 500];
/// Ticks per turn of known scanners: small numbers first, for the same reason, and hundredths of degrees.
const TICKS: [u32; 5] = [512, 1024, 2048, 4096, HUNDREDTHS];
const HUNDREDTHS: u32 = 36_000;
/// Minimum coherence of float32 values that lie on a grid.
const COHERENT: f64 = 0.9;
/// The same for values before their coordinates were rounded, which is known less well.
const COHERENT_BEFORE: f64 = 0.75;
/// Minimum coherence that rounded coordinates may leave.
const LEAST_COHERENT: f64 = 0.1;
/// A scanner that explains more than this share of the points need not be improved.
const NEARLY_ALL: f64 = 0.995;
/// A scanner that explains a smaller share of the points is rejected.
const LEAST_SHARE: f64 = 0.5;
/// Largest distance of a laser's azimuths from whole ticks, as a fraction of a tick, if a program knows only
/// whole ticks.
const WHOLE_PHASE: f64 = 0.02;
/// A sufficient number of points.
const SAMPLE: usize = 4000;
/// Distances of the focal points of Velodyne's scanners from their axes, in micrometres: VLP-16, VLP-32,
/// VLS-128, HDL-32E.
const FOCAL_POINTS_UM: [i32; 4] = [41_910, 42_400, 58_630, 28_956];

/// Fits a scanner to a sample of a sequence's scans: to the one with the most returns and, as long as that
/// helps, to another that the scanner explains less well, which may show other lasers. `None` if no
/// scanner of this family explains enough of the points.
pub fn fit(sample: &[ScanFile]) -> Option<Firings> {
    fit_by(sample, |cloud| {
        let points = cloud.positions.iter().map(|position| Point::new(position.map(f64::from), None));
        fit_points(cloud, points, 0.0)
    })
}

/// As [`fit`], given the fit to one scan.
pub(super) fn fit_by(
    sample: &[ScanFile],
    fit_scan: impl Fn(&PointCloud) -> Option<Firings>,
) -> Option<Firings> {
    /// A share of the points that is worth another fit, and the largest number of these.
    const WORTH: f64 = 0.005;
    const MOST: usize = 2;
    let mut seen = Cow::Borrowed(&fullest(sample)?.cloud);
    let mut best = fit_scan(&seen)?;
    for _ in 0..MOST {
        let explained = |cloud: &PointCloud| best.explained_share(&cloud.positions);
        let less = LEAST_SHARE..explained(&seen) - WORTH;
        let shares = sample.iter().map(|scan| (explained(&scan.cloud), &scan.cloud));
        let worst = shares.filter(|(share, _)| less.contains(share)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, worst)) = worst else { break };
        let Some(more) = joined(&seen, worst, best.rows_of_lines.len()) else { break };
        let worth =
            |scanner: &Firings| scanner.reproduced(&more.positions).0 + scanner.explained(&more.positions);
        let of_more = fit_scan(&more).filter(|of_more| shows_same_lasers(of_more, &seen, worst));
        match of_more.filter(|of_more| worth(of_more) > worth(&best)) {
            Some(of_more) => (best, seen) = (of_more, Cow::Owned(more)),
            None => break,
        }
    }
    Some(best)
}

/// Whether two scans show many of the same lasers of a scanner that was fitted to both. Those of two scanners of
/// a kind, whose elevations differ by little, do not.
fn shows_same_lasers(scanner: &Firings, one: &PointCloud, other: &PointCloud) -> bool {
    let seen = |cloud: &PointCloud| -> Vec<bool> {
        let places = scanner.places(&cloud.positions, REACH + 0.5 * scanner.range_step_m());
        let fewest = fewest_of(places.len());
        let mut counts = vec![0; scanner.rows()];
        places.iter().for_each(|place| counts[place.row as usize] += 1);
        counts.into_iter().map(|count| count >= fewest).collect()
    };
    let (one, other) = (seen(one), seen(other));
    let count = |seen: &[bool]| seen.iter().filter(|seen| **seen).count();
    let both = one.iter().zip(&other).filter(|(one, other)| **one && **other).count();
    2 * both >= count(&one).min(count(&other))
}

/// Two scans as one, as though the scanner had turned on. If files are in the order of `lines`, so is this
/// one. `None` if they have different fields, or only returns, of which nothing tells how many are in a line.
fn joined(one: &PointCloud, other: &PointCloud, lines: usize) -> Option<PointCloud> {
    let both = one.followed_by(other)?;
    if lines == 0 {
        return Some(both);
    }
    let width = |cloud: &PointCloud| {
        let records = cloud.positions.len();
        let is_grid = records.is_multiple_of(lines) && cloud.measured() < records;
        is_grid.then_some(records / lines)
    };
    let (width, other_width) = (width(one)?, width(other)?);
    let order = (0..lines).flat_map(|line| {
        let start = one.positions.len() + line * other_width;
        (line * width..(line + 1) * width).chain(start..start + other_width)
    });
    Some(both.select(&order.map(|record| record as u32).collect::<Vec<_>>()))
}

/// Fits a scanner to one scan whose points were moved; `moved` has all of them. `mean_offset`: as in [`ScanFacts`].
pub fn fit_moved(cloud: &PointCloud, moved: &[Moved], mean_offset: f64) -> Option<Firings> {
    let positions = moved.iter().map(|point| point.measured.map(|metres| metres as f32)).collect();
    let measured = PointCloud { positions, ..cloud.clone() };
    let points = moved.iter().map(|point| Point::new(point.measured, Some(point)));
    fit_points(&measured, points, mean_offset)
}

/// The same, given a point for each record of the scan, or `None` for records without a direction.
fn fit_points<'m>(
    cloud: &'m PointCloud,
    points: impl Iterator<Item = Option<Point<'m>>>,
    mean_offset: f64,
) -> Option<Firings> {
    let (numbers, points): (Vec<usize>, Vec<Point>) =
        points.enumerate().filter_map(|(record, point)| Some((record, point?))).unzip();
    let measured = points.len();
    let step = (measured / SAMPLE).max(1);
    let values: Vec<f32> =
        points.iter().step_by(step).flat_map(|point| point.position.map(|value| value as f32)).collect();
    let coordinates = CoordinateGrid::finest_of(&values);
    let blur = Blur::of(coordinates);
    // Rounding leaves the farthest points clearest; nearer ones are used only if those do not show all
    // lasers.
    let mut best: Option<Candidate> = None;
    for nearest in blur.nearest(&points) {
        let (numbers, points) = beyond(nearest, &numbers, &points);
        let facts = ScanFacts { cloud, numbers, points, measured, coordinates, blur, nearest, mean_offset };
        let has_nearly_all = facts.points.len() as f64 > NEARLY_ALL * measured as f64;
        let next = facts.best();
        best = next.into_iter().chain(best).reduce(|a, b| if b.worth > a.worth { b } else { a });
        if has_nearly_all || best.as_ref().is_some_and(|best| best.share > NEARLY_ALL) {
            break;
        }
    }
    let Candidate { scanner, .. } = best.filter(|best| best.share >= LEAST_SHARE)?;
    // Decimal digits do not help a recipe that is wrong.
    let is_digits = matches!(coordinates, CoordinateGrid::Digits(_));
    match is_digits.then(|| scanner.reproduced(&cloud.positions)) {
        Some((reproduced, all)) if 2 * reproduced <= all => {
            let build = Build { coordinates: CoordinateGrid::Float32, ..scanner.build };
            let unrounded = Firings::new(build, scanner.lasers, scanner.rows_of_slots);
            Some(unrounded.line_by_line(scanner.rows_of_lines).lagging(scanner.lags))
        }
        _ => Some(scanner),
    }
}

/// The points whose ranges are at least `nearest`, in metres, with their record numbers.
fn beyond<'p, 'm>(
    nearest: f64,
    numbers: &'p [usize],
    points: &'p [Point<'m>],
) -> (Cow<'p, [usize]>, Cow<'p, [Point<'m>]>) {
    if nearest <= 0.0 {
        return (numbers.into(), points.into());
    }
    let all = numbers.iter().copied().zip(points.iter().copied());
    let (numbers, points): (Vec<_>, Vec<_>) = all.filter(|(_, point)| point.range >= nearest).unzip();
    (numbers.into(), points.into())
}

/// Facts about a scan from which the fit starts.
pub(super) struct ScanFacts<'s> {
    pub cloud: &'s PointCloud,
    /// The record number of each point.
    pub numbers: Cow<'s, [usize]>,
    pub points: Cow<'s, [Point<'s>]>,
    /// Number of all points, also of those that rounding has moved too far to be among `points`.
    pub measured: usize,
    pub coordinates: CoordinateGrid,
    pub blur: Blur,
    /// In metres: the range of the nearest of `points`, or less.
    pub nearest: f64,
    /// In degrees: the mean of the azimuth offsets of all lasers, to half a tick. 0 if it is not known.
    pub mean_offset: f64,
}

/// A scanner that may have measured a scan.
struct Candidate {
    scanner: Firings,
    /// The share of the points that it explains.
    share: f64,
    worth: f64,
}

impl ScanFacts<'_> {
    /// The scanner that explains the scan best.
    fn best(&self) -> Option<Candidate> {
        let on_axis = self.starting_in_one_point(Origin::default()).filter(|scanners| !scanners.is_empty());
        let focal = || (!self.blur.is_any()).then(|| self.through_focal_point()).flatten();
        let elsewhere = || focal().or_else(|| self.off_axis());
        let scanners = on_axis.or_else(elsewhere).or_else(|| Some(vec![self.ouster()?]))?;
        let candidates: Vec<Candidate> =
            scanners.into_par_iter().map(|scanner| self.candidate(scanner)).collect();
        candidates.into_iter().max_by(|a, b| a.worth.total_cmp(&b.worth))
    }

    /// Among scanners that explain about as many points, the one with the fewest columns is best, because its
    /// firings are whole. A timing with two firings per block must explain enough to be worth it. Points that
    /// were rounded may be explained by a timing that is not theirs, but not as accurately.
    fn candidate(&self, scanner: Firings) -> Candidate {
        let measured = self.measured.max(1) as f64;
        let projection = scanner.project(self.cloud, REACH);
        let image = &projection.image;
        let share = (image.returns() + image.echoes.len()) as f64 / measured;
        let simple = if scanner.build.timing.firings(scanner.rows()) > 1 { 0.999 } else { 1.0 };
        let accuracy = if self.blur.is_any() { scanner.accuracy(&projection, self.cloud) } else { 1.0 };
        // A column takes about a quarter of the bits of a stray.
        let columns = (1.0 + image.columns.len() as f64 / measured).sqrt().sqrt();
        let worth = simple * share / columns * accuracy;
        Candidate { scanner, share, worth }
    }

    /// In radians: the largest distance of a laser's points from its cone.
    pub(super) fn on_cone(&self) -> f64 {
        ON_CONE.max(self.blur.angle(self.nearest))
    }

    /// By how many ticks points may seem to be beside their own.
    pub(super) fn slack(&self, ticks: u32) -> u32 {
        if self.blur.is_any() { self.blur.ticks(self.nearest, ticks) } else { 0 }
    }

    /// Scanners whose beams intersect in a focal point and that may have measured the scan.
    fn through_focal_point(&self) -> Option<Vec<Firings>> {
        let tried = FOCAL_POINTS_UM.into_iter().filter_map(|along_um| {
            let origin = Origin { along_um, up_um: 0 };
            let [focal, _] = origin.metres();
            let points: Vec<Point> = self.points.iter().map(|point| point.through(focal)).collect();
            let numbers = Cow::Borrowed(&self.numbers[..]);
            let found = ScanFacts { cloud: self.cloud, numbers, points: points.into(), ..*self };
            let scanners = found.starting_in_one_point(origin)?;
            let (reproduced, all) = scanners.first()?.reproduced(&self.cloud.positions);
            (2 * reproduced > all).then_some((reproduced, scanners))
        });
        tried.max_by_key(|(reproduced, _)| *reproduced).map(|(_, scanners)| scanners)
    }

    /// Scanners whose beams all start in `origin` and that may have measured the scan.
    fn starting_in_one_point(&self, origin: Origin) -> Option<Vec<Firings>> {
        let ScanFacts { points, coordinates, blur, mean_offset, .. } = self;
        let range_step_um = range_step(points.iter().map(|point| point.range), *blur)?;
        let Rows { elevations, of_points: rows, places, grid } = self.rows()?;
        let of_rows = by_rows(points, &rows, elevations.len(), TRIED);
        let more_of_rows = by_rows(points, &rows, elevations.len(), 10 * TRIED);
        let for_ticks = if blur.is_any() { &more_of_rows } else { &of_rows };
        let ticks = ticks(for_ticks, *blur)?;
        let phases: Vec<f64> =
            for_ticks.iter().map(|points| phase_of_ticks(points, ticks, *blur).0).collect();
        let sequence = points.iter().zip(&rows).filter_map(|(point, row)| {
            let tick = round_ties_even(in_ticks(point, ticks) - phases[(*row)?]) as i64;
            Some(((*row)?, tick.rem_euclid(i64::from(ticks)) as u32))
        });
        let sequence: Vec<(usize, u32)> = sequence.collect();
        let slack = self.slack(ticks);
        let (own, lines) =
            match grid.filter(|grid| grid.columns_are_firings(&places, &sequence, ticks, slack)) {
                Some(grid) => {
                    let order = grid.order(&places, &sequence, ticks);
                    (Some(order), if grid.shape.by_lines { grid.lines } else { Vec::new() })
                }
                None => self.order_and_lines(sequence, elevations.len(), ticks),
            };
        let known = vlp_16(&elevations);
        // A VLP-16's lasers have no offsets: what the file shows are the ticks that pass while they fire.
        let own = own.map(|own| match &known {
            Some(known) => {
                let is_steady = own.is_steady && own.shifts == known.shifts;
                FiringOrder { shifts: known.shifts.clone(), is_steady, ..own }
            }
            None => own,
        });
        let near_axes = near_axes(points, &rows, elevations.len());
        let constants =
            Constants { elevations, phases, mean_offset: *mean_offset, of_rows, more_of_rows, near_axes };
        let build = Build {
            recipe: Recipe::VelodyneRos,
            ticks,
            range_step_um,
            coordinates: *coordinates,
            origin,
            timing: Timing::Together,
            mounting: None,
        };
        let mut from_one_point =
            FromOnePoint { found: self, constants, build, lines, determined: Vec::new() };
        let of_known = known.map(|order| from_one_point.scanners(&order)).unwrap_or_default();
        // How a VLP-16's azimuth advances need not be estimated.
        if of_known.iter().any(|scanner| self.shows_timing_of(scanner)) {
            return Some(of_known);
        }
        let of_own = own.map(|order| from_one_point.scanners(&order)).unwrap_or_default();
        Some(of_own.into_iter().chain(of_known).collect())
    }

    /// Whether a scanner explains nearly all points, and its azimuth advances while its lasers fire.
    pub(super) fn shows_timing_of(&self, scanner: &Firings) -> bool {
        let image = scanner.project(self.cloud, REACH).image;
        let advancing = image.spans.iter().filter(|span| Span::unpacked(**span).ticks > 0).count();
        image.returns() as f64 > NEARLY_ALL * self.measured as f64 && 2 * advancing > image.columns.len()
    }

    /// The rows of the points, whose beams all start in one point.
    fn rows(&self) -> Option<Rows> {
        let on_cone = self.on_cone();
        let mut elevations = completed(elevations(&self.points, on_cone)?);
        let row = |point: &Point| {
            let row = nearest(&elevations, point.elevation);
            ((elevations[row] - point.elevation).abs() < on_cone).then_some(row)
        };
        let of_points: Vec<Option<usize>> = self.points.iter().map(row).collect();
        let places: Vec<(usize, usize)> = self
            .numbers
            .iter()
            .zip(&of_points)
            .filter_map(|(record, row)| Some((*record, (*row)?)))
            .collect();
        let records = self.cloud.positions.len();
        let has_blanks = self.measured < records;
        let grid = RecordGrid::find(&places, records, elevations.len(), has_blanks);
        if let Some(grid) = &grid {
            // Lasers without returns still have records.
            while elevations.len() < grid.lines.len() {
                elevations.push(elevations[elevations.len() - 1] - UNSEEN);
            }
        }
        Some(Rows { elevations, of_points, places, grid })
    }

    /// The order in which lasers fire, and the rows of the lines if points come line by line, given the row
    /// and the tick of each point.
    fn order_and_lines(
        &self,
        mut sequence: Vec<(usize, u32)>,
        rows: usize,
        ticks: u32,
    ) -> (Option<FiringOrder>, Vec<u32>) {
        // Echoes say nothing about the order.
        sequence.dedup();
        if let Some(order) = order(&sequence, rows, ticks, self.slack(ticks)) {
            return (Some(order), Vec::new());
        }
        match lines(&sequence, rows, ticks) {
            Some(lines) => (Some(FiringOrder::of_lines(&sequence, rows, ticks)), lines),
            None => (None, Vec::new()),
        }
    }

    /// The scanner and, if the lasers of a firing have different ticks, the same scanner with the timings
    /// that fit best.
    pub(super) fn with_timings(&self, scanner: Firings, is_steady: bool) -> Vec<Firings> {
        if is_steady {
            return vec![scanner];
        }
        let places = scanner.places(&self.cloud.positions, REACH + 0.5 * scanner.range_step_m());
        let (places, _) = without_echoes(places);
        // If rows lag, blocks of two firings are not tried.
        let most = if scanner.lags.is_empty() { 2 } else { 1 };
        let timed = (1..=most).into_par_iter().filter_map(|firings| timed(&scanner, &places, firings));
        let mut all: Vec<Firings> = timed.collect();
        all.insert(0, scanner);
        all
    }
}

/// The rows of a scan's points.
struct Rows {
    /// In radians, one for each row.
    elevations: Vec<f64>,
    /// The row of each point, if it is near a row's cone.
    of_points: Vec<Option<usize>>,
    /// The record numbers and rows of the points that have a row.
    places: Vec<(usize, usize)>,
    grid: Option<RecordGrid>,
}

/// What determines the scanners whose beams all start in one point, but for the order in which their lasers
/// fire.
struct FromOnePoint<'f, 's> {
    found: &'f ScanFacts<'s>,
    constants: Constants<'f>,
    build: Build,
    lines: Vec<u32>,
    /// What was determined for which offsets: several orders may have the same.
    determined: Vec<(Vec<f64>, Option<LaserFit>)>,
}

impl FromOnePoint<'_, '_> {
    /// The scanners whose lasers fire in an order.
    fn scanners(&mut self, order: &FiringOrder) -> Vec<Firings> {
        let none = vec![0.0; self.constants.elevations.len()];
        let of_offsets = self.scanner(order, &order.shifts, &none);
        // Programs that know only whole ticks add a laser's ticks to those of the firing.
        let are_whole = self.constants.phases.iter().all(|phase| phase.abs() < WHOLE_PHASE);
        let are_ticks = are_whole && order.shifts.iter().any(|shift| *shift != 0.0);
        let of_lags = are_ticks.then(|| self.scanner(order, &none, &order.shifts)).flatten();
        let positions = &self.found.cloud.positions;
        let reproduced = |(scanner, _): &(Firings, bool)| scanner.reproduced(positions).0;
        let of_lags = of_lags
            .filter(|lags| of_offsets.as_ref().is_none_or(|other| reproduced(lags) > reproduced(other)));
        match (of_lags, of_offsets) {
            (Some((scanner, _)), _) => {
                let starts = std::iter::once(&0).chain(&order.other_starts);
                let begun = starts.map(|&start| scanner.clone().begun_at(start));
                begun.flat_map(|scanner| self.found.with_timings(scanner, false)).collect()
            }
            (None, Some((scanner, are_turned))) => {
                self.found.with_timings(scanner, order.is_steady && !are_turned)
            }
            (None, None) => Vec::new(),
        }
    }

    /// The scanner whose lasers have these offsets and look ahead by these ticks, and whether each offset was
    /// corrected by whole ticks of its own.
    fn scanner(&mut self, order: &FiringOrder, offsets: &[f64], ahead: &[f64]) -> Option<(Firings, bool)> {
        let FromOnePoint { constants, build, determined, .. } = self;
        if determined.iter().all(|(known, _)| known != offsets) {
            determined.push((offsets.to_vec(), constants.determine(build, offsets)));
        }
        let (_, found) = determined.iter().find(|(known, _)| known == offsets)?;
        let LaserFit { recipe, lasers, are_turned } = found.clone()?;
        let build = Build { recipe, timing: order.timing.clone(), ..build.clone() };
        let scanner =
            Firings::new(build, lasers, order.rows_of_slots.clone()).line_by_line(self.lines.clone());
        let ticks = i64::from(self.build.ticks);
        let behind = ahead.iter().map(|ahead| (-*ahead as i64).rem_euclid(ticks) as u32).collect();
        let lags = ahead.iter().any(|ahead| *ahead != 0.0);
        Some((if lags { scanner.lagging(behind) } else { scanner }, are_turned))
    }
}

/// The coarsest step on which most of the ranges (in metres) lie.
pub(super) fn range_step(ranges: impl Iterator<Item = f64> + Clone, blur: Blur) -> Option<u32> {
    /// In metres: nearer ranges are ignored, as float32 coordinates do not determine them better.
    const NEAREST: f64 = 0.5;
    const FEWEST: usize = 200;
    let far = ranges.filter(|range| *range > NEAREST);
    let step = (far.clone().count() / SAMPLE).max(1);
    let ranges: Vec<f64> = far.step_by(step).collect();
    let is_on = |um: &u32| {
        let metres = f64::from(*um) * 1e-6;
        let most = blur.coherence(metres);
        let least = most * if blur.is_any() { COHERENT_BEFORE } else { COHERENT };
        most > LEAST_COHERENT && strength(ranges.iter().map(|range| range / metres), 0.0) > least
    };
    // Rounding hides steps that are finer than its own.
    let hidden = blur.is_any().then(|| blur.step_um());
    let is_enough = ranges.len() >= FEWEST;
    RANGE_STEPS_UM.into_iter().find(|um| is_enough && is_on(um)).or(hidden.filter(|_| is_enough))
}

/// How coherent values are with the whole numbers plus this phase: 1 if all lie on them.
pub(super) fn strength(values: impl Iterator<Item = f64>, phase: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for value in values {
        sum += libm::cos((value - phase) * TAU);
        count += 1;
    }
    sum / f64::from(count.max(1))
}

/// The phase of values relative to the whole numbers, as a fraction of one, and their coherence.
pub(super) fn phase(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut re, mut im, mut count) = (0.0, 0.0, 0);
    for value in values {
        re += libm::cos(value * TAU);
        im += libm::sin(value * TAU);
        count += 1;
    }
    (libm::atan2(im, re) / TAU, (re * re + im * im).sqrt() / f64::from(count.max(1)))
}

/// In radians: the largest distance of a laser's points from its cone, if coordinates are not rounded.
pub(super) const ON_CONE: f64 = 1e-4;

/// The elevations of the lasers, from the highest to the lowest: narrow clusters of the points' elevations.
/// `None` if fewer than half of the points lie in clusters, or the number of clusters is not that of a
/// scanner.
pub(super) fn elevations(points: &[Point], on_cone: f64) -> Option<Vec<f64>> {
    /// In metres: the elevations of nearer points are blurred. The second limit is for precise coordinates.
    const NEAREST: [f64; 2] = [0.3, 0.05];
    let [far, near] = NEAREST;
    let step = (points.len() / (16 * SAMPLE)).max(1);
    let sample = points.iter().step_by(step).filter(|point| point.range > near);
    let mut all: Vec<(f64, bool)> = sample.map(|point| (point.elevation, point.range > far)).collect();
    all.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let heaps = |all: Vec<f64>| (narrow_heaps(&all, on_cone, fewest_of(all.len())), all.len());
    let far = heaps(all.iter().filter(|(_, is_far)| *is_far).map(|(elevation, _)| *elevation).collect());
    let near = heaps(all.into_iter().map(|(elevation, _)| elevation).collect());
    let ((inside, found), all) = if near.0.0 > far.0.0 { near } else { far };
    let is_scanner = PLAUSIBLE_LASERS.contains(&found.len()) && inside as f64 >= LEAST_SHARE * all as f64;
    is_scanner.then_some(found)
}

/// The smallest cluster that may be that of a laser, among this number of points.
pub(super) fn fewest_of(points: usize) -> usize {
    (points / 2000).max(8)
}

/// Given descending elevations: how many lie in narrow clusters of at least `fewest` each, at most `on_cone`
/// radians from their middle, and the medians of the clusters.
pub(super) fn narrow_heaps(elevations: &[f64], on_cone: f64, fewest: usize) -> (usize, Vec<f64>) {
    /// Radians between the clusters of two lasers, at least.
    const GAP: f64 = 6e-5;
    let gap = GAP.max(on_cone / 3.0);
    let heaps = elevations.chunk_by(|a, b| a - b < gap);
    let narrow = heaps.filter(|heap| heap.len() >= fewest && heap[0] - heap[heap.len() - 1] < 2.0 * on_cone);
    narrow.fold((0, Vec::new()), |(inside, mut middles), heap| {
        middles.push(heap[heap.len() / 2]);
        (inside + heap.len(), middles)
    })
}

/// Radians from the lowest laser to one without returns, whose elevation is unknown.
const UNSEEN: f64 = 1e-3;

/// The grid of a file in which each laser has a record in each firing, with or without a return.
pub(super) struct RecordGrid {
    /// The row of each line; of each slot if the file holds firing after firing.
    pub lines: Vec<u32>,
    pub shape: GridShape,
}

/// How the records of a file form a grid.
#[derive(Clone, Copy)]
pub(super) struct GridShape {
    pub lines: usize,
    /// Number of firings.
    pub width: usize,
    /// Whether the file holds row after row, not firing after firing.
    pub by_lines: bool,
}

impl GridShape {
    /// The line, or the slot, of a record.
    pub fn line(&self, record: usize) -> usize {
        if self.by_lines { record / self.width } else { record % self.lines }
    }

    /// The firing of a record.
    pub fn column(&self, record: usize) -> usize {
        if self.by_lines { record % self.width } else { record / self.lines }
    }
}

impl RecordGrid {
    /// Finds the grid of a file with this number of records; `places` has the record and the row of each
    /// return. `None` if the file has no grid. Without blanks, the number of records may be a multiple of the
    /// number of lines by chance: then nearly all returns must be in their places.
    fn find(places: &[(usize, usize)], records: usize, rows: usize, has_blanks: bool) -> Option<Self> {
        /// Largest number of lines per row with returns; the other lines belong to lasers without returns.
        const MOST_LINES: usize = 2;
        const FEWEST_COLUMNS: usize = 8;
        let whole = (rows..=MOST_LINES * rows).filter(|lines| records.is_multiple_of(*lines));
        let grids = whole.flat_map(|lines| [(lines, false), (lines, true)]);
        let grids = grids.filter(|(lines, _)| records / lines >= FEWEST_COLUMNS);
        let least = if has_blanks { 0.95 } else { 0.999 };
        let shape = |(lines, by_lines)| GridShape { lines, width: records / lines, by_lines };
        grids.map(shape).find_map(|shape| Self::of(places, rows, shape, least))
    }

    /// The grid of this shape, if it puts at least the share `least` of the returns into the line of their
    /// row.
    fn of(places: &[(usize, usize)], rows: usize, shape: GridShape, least: f64) -> Option<Self> {
        let lines = shape.lines;
        let mut counts = vec![0u32; lines * rows];
        for (record, row) in places {
            counts[shape.line(*record) * rows + row] += 1;
        }
        let mut row_of_line = vec![None; lines];
        let (mut taken, mut inside) = (vec![false; rows], 0);
        for (line, counts) in counts.chunks_exact(rows).enumerate() {
            let (row, &most) = counts.iter().enumerate().max_by_key(|(_, count)| **count)?;
            if most > 0 && !std::mem::replace(&mut taken[row], true) {
                row_of_line[line] = Some(row as u32);
                inside += most;
            }
        }
        if f64::from(inside) < least * places.len() as f64 || places.is_empty() {
            return None;
        }
        // The remaining rows, with or without returns, belong to the remaining lines.
        let seen = (0u32..).zip(taken).filter(|(_, taken)| !taken).map(|(row, _)| row);
        let mut rest = seen.chain(rows as u32..);
        let lines = row_of_line.into_iter().map(|row| row.or_else(|| rest.next())).collect::<Option<_>>()?;
        Some(RecordGrid { lines, shape })
    }

    /// The ticks by which each row's returns are ahead of that of the row with the most returns, in the same
    /// column.
    fn ahead(&self, places: &[(usize, usize)], sequence: &[(usize, u32)], ticks: u32) -> Vec<Vec<i64>> {
        let rows = self.lines.len();
        let mut counts = vec![0u32; rows];
        places.iter().for_each(|(_, row)| counts[*row] += 1);
        let first = (0..rows).rev().max_by_key(|&row| counts[row]).unwrap_or(0);
        let mut tick_of_column = vec![None; self.shape.width];
        let found = || {
            let all = places.iter().zip(sequence);
            all.map(|((record, row), (_, tick))| (self.shape.column(*record), *row, *tick))
        };
        found()
            .filter(|(_, row, _)| *row == first)
            .for_each(|(column, _, tick)| tick_of_column[column] = Some(tick));
        let mut ahead: Vec<Vec<i64>> = vec![Vec::new(); rows];
        for (column, row, tick) in found() {
            if let Some(first) = tick_of_column[column] {
                ahead[row].push(shorter_way(i64::from(tick) - i64::from(first), i64::from(ticks)));
            }
        }
        ahead
    }

    /// Whether the returns of a column are those of one firing. In an image with a column for each step of the
    /// azimuth, as SLAM programs make them, some are those of the firing before or after.
    fn columns_are_firings(
        &self,
        places: &[(usize, usize)],
        sequence: &[(usize, u32)],
        ticks: u32,
        slack: u32,
    ) -> bool {
        /// Minimum share of the returns that are as far ahead as most of their row.
        const LEAST: f64 = 0.9;
        /// Ticks by which returns of one firing differ, because the azimuth advances while lasers fire.
        const ADVANCE: i64 = 2;
        let near = ADVANCE + i64::from(slack);
        let (mut inside, mut all) = (0, 0);
        for mut ahead in self.ahead(places, sequence, ticks) {
            ahead.sort_unstable();
            let middle = ahead.get(ahead.len() / 2).copied().unwrap_or(0);
            inside += ahead.iter().filter(|ticks| (**ticks - middle).abs() <= near).count();
            all += ahead.len();
        }
        inside as f64 >= LEAST * all as f64
    }

    /// The order of the lasers, and the ticks by which each is ahead of the one with the most returns.
    fn order(&self, places: &[(usize, usize)], sequence: &[(usize, u32)], ticks: u32) -> FiringOrder {
        let rows = self.lines.len();
        let ahead = self.ahead(places, sequence, ticks);
        let all: usize = ahead.iter().map(Vec::len).sum();
        let shift = |mut ahead: Vec<i64>| {
            ahead.sort_unstable();
            let most = ahead.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
            most.map_or((0.0, 0), |same| (same[0] as f64, same.len()))
        };
        let (shifts, same): (Vec<f64>, Vec<usize>) = ahead.into_iter().map(shift).unzip();
        let is_steady = same.into_iter().sum::<usize>() as f64 >= STEADY * all as f64;
        let shifts = if is_steady { shifts } else { vec![0.0; rows] };
        FiringOrder {
            rows_of_slots: self.lines.clone(),
            other_starts: Vec::new(),
            half_start: None,
            shifts,
            timing: Timing::Together,
            is_steady,
        }
    }
}

/// All elevations of a VLP-16, if the given ones are among them. It matters which lasers are missing, because
/// the azimuth advances while they fire.
pub(super) fn completed(elevations: Vec<f64>) -> Vec<f64> {
    let mut all = VLP_16.map(|degrees| f64::from(degrees).to_radians());
    all.sort_unstable_by(|a, b| b.total_cmp(a));
    let is_known = |found: &f64| all.iter().any(|known| (known - found).abs() < ON_CONE);
    if elevations.iter().all(is_known) { all.to_vec() } else { elevations }
}

/// The number of ticks per turn on which the azimuths of most rows lie, each row with a phase of its own.
pub(super) fn ticks(of_rows: &[Vec<Point>], blur: Blur) -> Option<u32> {
    let coherence = |ticks: u32| {
        let of_row = |points: &Vec<Point>| {
            let (_, strength) = phase_of_ticks(points, ticks, blur);
            (strength * points.len() as f64, points.len() as f64)
        };
        let (sum, count) = of_rows.iter().map(of_row).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        sum / f64::max(count, 1.0)
    };
    let least = if blur.is_any() { COHERENT_BEFORE } else { COHERENT };
    // Rounding hides hundredths of degrees if all points are near.
    let hidden = blur.is_any().then_some(HUNDREDTHS);
    TICKS.into_iter().find(|&ticks| coherence(ticks) > least).or(hidden)
}

/// The phase of a row's azimuths in ticks, and their coherence as it was before coordinates were rounded.
fn phase_of_ticks(points: &[Point], ticks: u32, blur: Blur) -> (f64, f64) {
    /// Standard deviations of a strength that chance does not reach.
    const SURE: f64 = 3.0;
    let (phase, strength) = phase(points.iter().map(|point| in_ticks(point, ticks)));
    let count = points.len().max(1) as f64;
    let left = points.iter().map(|point| blur.coherence_of_ticks(point, ticks)).sum::<f64>() / count;
    let is_seen = !blur.is_any() || strength * count.sqrt() > SURE;
    match is_seen && left > LEAST_COHERENT {
        true => (phase, strength / left),
        false => (0.0, 0.0),
    }
}

/// The azimuth of a point in ticks, clockwise from x. If y is ahead, all azimuths differ by a quarter of a
/// turn, which is a whole number of ticks.
pub(super) fn in_ticks(point: &Point, ticks: u32) -> f64 {
    let [x, y, _] = point.position;
    libm::atan2(-y, x) / TAU * f64::from(ticks)
}
