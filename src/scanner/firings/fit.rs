//! Finds a scanner of firings from points alone: the range step and the azimuth ticks by their coherence, elevations
//! and azimuth offsets as medians that are rounded as makers round them, the order of the lasers by who follows whom,
//! and the recipe by trying all of them.

use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::order::{Order, STEADY, VLP_16, order, timed, vlp_16};
use super::projection::{Place, nearest, without_echoes};
use super::recipe::whole_steps;
use super::{ANGLE_UNIT, Build, Firings, Laser, Origin, Recipe, Timing};
use crate::ground::rounding::round_ties_even;
use crate::scan::ScanFile;
use crate::scanner::motion::RigidMotion;
use crate::scanner::{Coordinates, REACH, Return};

/// Range steps that scanners have, in micrometres, coarse ones first: what lies on one lies on its parts too.
const RANGE_STEPS_UM: [u32; 9] = [12_000, 10_000, 8_000, 5_000, 4_000, 2_500, 2_000, 1_000, 500];
/// Ticks a turn that scanners have: few ones first, for the same reason, and hundredths of degrees.
const TICKS: [u32; 5] = [512, 1024, 2048, 4096, 36_000];
/// Values on a grid are as coherent as this, if they are float32.
const COHERENT: f64 = 0.9;
/// A scanner that explains fewer of the points than this is none.
const LEAST_SHARE: f64 = 0.5;
/// Parts of a tick by which the azimuths of a laser are off whole ticks, at most, if a program knows no others.
const WHOLE_PHASE: f64 = 0.02;
/// Points that tell enough.
const SAMPLE: usize = 4000;
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
    fn new(position: [f64; 3], moved: Option<Moved>) -> Option<Self> {
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

/// Fits a scanner to a sample of a sequence's scans, and gives the share of the returns that it explains. None if
/// the points are not those of such a scanner, firing by firing.
pub fn fit(sample: &[ScanFile]) -> Option<(Firings, f64)> {
    let scan = sample.iter().max_by_key(|scan| scan.cloud.positions.len())?;
    let points = scan.cloud.positions.iter().map(|position| Point::new(position.map(f64::from), None));
    fit_points(scan, points)
}

/// The same for one scan whose points were moved: these are all of them.
pub fn fit_moved(scan: &ScanFile, moved: &[Moved]) -> Option<Firings> {
    let positions = moved.iter().map(|point| point.measured.map(|metres| metres as f32)).collect();
    let mut measured = scan.clone();
    measured.cloud.positions = positions;
    let points = moved.iter().map(|point| Point::new(point.measured, Some(*point)));
    fit_points(&measured, points).map(|(scanner, _)| scanner)
}

/// The same, given the points that have a direction among those of the scan.
fn fit_points(scan: &ScanFile, points: impl Iterator<Item = Option<Point>>) -> Option<(Firings, f64)> {
    let (numbers, points): (Vec<usize>, Vec<Point>) =
        points.enumerate().filter_map(|(record, point)| Some((record, point?))).unzip();
    let step = (points.len() / SAMPLE).max(1);
    let values: Vec<f32> =
        points.iter().step_by(step).flat_map(|point| point.position.map(|value| value as f32)).collect();
    let coordinates = Coordinates::finest_of(&values);
    let found = Found { scan, numbers, points, coordinates };
    let scanners = found.on_axis().filter(|scanners| !scanners.is_empty()).or_else(|| found.off_axis())?;
    let shares = scanners.into_iter().map(|scanner| {
        let image = scanner.project(&scan.cloud, REACH).image;
        (
            scanner,
            (image.returns() + image.echoes.len()) as f64 / found.points.len().max(1) as f64,
            image.columns.len(),
        )
    });
    // Of those that explain about as much, that of the fewest columns: there firings are whole.
    // A timing of two firings a block must be worth its name.
    let worth = |(scanner, share, columns): &(Firings, f64, usize)| {
        let simple = if scanner.build.timing.firings(scanner.rows()) > 1 { 0.999 } else { 1.0 };
        simple * share / (1.0 + *columns as f64 / found.points.len().max(1) as f64)
    };
    let best = shares.max_by(|a, b| worth(a).total_cmp(&worth(b)));
    let (scanner, share, _) = best.filter(|(_, share, _)| *share >= LEAST_SHARE)?;
    // Decimal digits are no help to a recipe that is not the right one.
    let is_digits = matches!(coordinates, Coordinates::Digits(_));
    let scanner = match is_digits.then(|| found.given(&scanner)) {
        Some((given, all)) if 2 * given <= all => {
            let build = Build { coordinates: Coordinates::Float32, ..scanner.build };
            Firings::new(build, scanner.lasers, scanner.rows_of_slots)
                .line_by_line(scanner.rows_of_lines)
                .lagging(scanner.lags)
        }
        _ => scanner,
    };
    Some((scanner, share))
}

/// What is known of a scan before its scanner is.
pub(super) struct Found<'s> {
    pub scan: &'s ScanFile,
    /// The records of the points.
    pub numbers: Vec<usize>,
    pub points: Vec<Point>,
    pub coordinates: Coordinates,
}

impl Found<'_> {
    /// Scanners whose beams start in one point that may have made the scan.
    fn on_axis(&self) -> Option<Vec<Firings>> {
        let Found { scan, numbers, points, coordinates } = self;
        let range_step_um = range_step(points.iter().map(|point| point.range))?;
        let records = scan.cloud.positions.len();
        let mut elevations = completed(elevations(points)?);
        let row = |point: &Point| {
            let row = nearest(&elevations, point.elevation);
            ((elevations[row] - point.elevation).abs() < ON_CONE).then_some(row)
        };
        let rows: Vec<Option<usize>> = points.iter().map(row).collect();
        let places: Vec<(usize, usize)> =
            numbers.iter().zip(&rows).filter_map(|(record, row)| Some((*record, (*row)?))).collect();
        let grid = RecordGrid::find(&places, records, elevations.len());
        if let Some(grid) = &grid {
            // Lasers that have seen nothing: their records are there all the same.
            while elevations.len() < grid.lines.len() {
                elevations.push(elevations[elevations.len() - 1] - UNSEEN);
            }
        }
        let of_rows = by_rows(points, &rows, elevations.len(), TRIED);
        let more_of_rows = by_rows(points, &rows, elevations.len(), 10 * TRIED);
        let ticks = ticks(&of_rows)?;
        let phases: Vec<f64> =
            of_rows.iter().map(|points| phase(points.iter().map(|point| in_ticks(point, ticks))).0).collect();
        let sequence = points.iter().zip(&rows).filter_map(|(point, row)| {
            let tick = round_ties_even(in_ticks(point, ticks) - phases[(*row)?]) as i64;
            Some(((*row)?, tick.rem_euclid(i64::from(ticks)) as u32))
        });
        let sequence: Vec<(usize, u32)> = sequence.collect();
        // Echoes tell nothing of the order.
        let mut firsts = sequence.clone();
        firsts.dedup();
        let own = match &grid {
            Some(grid) => Some(grid.order(&places, &sequence, ticks)),
            None => order(&firsts, elevations.len(), ticks),
        };
        let orders = [own, vlp_16(&elevations)];
        let lines = grid.filter(|grid| grid.by_lines).map_or_else(Vec::new, |grid| grid.lines);
        let near_axes = near_axes(points, &rows, elevations.len());
        let constants = Constants { elevations, phases, of_rows, more_of_rows, near_axes };
        let none = vec![0.0; constants.elevations.len()];
        let are_whole = constants.phases.iter().all(|phase| phase.abs() < WHOLE_PHASE);
        let scanner = |order: &Order, offsets: &[f64], ahead: &[f64]| {
            let build = Build {
                recipe: Recipe::VelodyneRos,
                ticks,
                range_step_um,
                coordinates: *coordinates,
                origin: Origin::default(),
                timing: order.timing.clone(),
            };
            let (build, lasers, are_own) = constants.with_recipe(&build, offsets)?;
            let scanner =
                Firings::new(build, lasers, order.rows_of_slots.clone()).line_by_line(lines.clone());
            let behind =
                ahead.iter().map(|ahead| (-*ahead as i64).rem_euclid(i64::from(ticks)) as u32).collect();
            let lags = ahead.iter().any(|ahead| *ahead != 0.0);
            Some((if lags { scanner.lagging(behind) } else { scanner }, are_own))
        };
        let candidates = |order: Order| {
            let of_offsets = scanner(&order, &order.shifts, &none);
            // Programs that know whole ticks alone add a laser's to the firing's.
            let are_ticks = are_whole && order.shifts.iter().any(|shift| *shift != 0.0);
            let of_lags = are_ticks.then(|| scanner(&order, &none, &order.shifts)).flatten();
            let given = |(scanner, _): &(Firings, bool)| self.given(scanner).0;
            let of_lags =
                of_lags.filter(|lags| of_offsets.as_ref().is_none_or(|other| given(lags) > given(other)));
            match (of_lags, of_offsets) {
                (Some((scanner, _)), _) => {
                    let starts = std::iter::once(&0).chain(&order.other_starts);
                    let begun = starts.map(|&start| scanner.clone().begun_at(start));
                    begun.flat_map(|scanner| self.with_timings(scanner, false)).collect()
                }
                (None, Some((scanner, are_own))) => self.with_timings(scanner, order.is_steady && !are_own),
                (None, None) => Vec::new(),
            }
        };
        Some(orders.into_iter().flatten().flat_map(candidates).collect())
    }

    /// How many points a scanner's recipe gives to the last bit, and how many it explains.
    fn given(&self, scanner: &Firings) -> (usize, usize) {
        let positions = &self.scan.cloud.positions;
        let places = scanner.places(positions, REACH + 0.5 * scanner.range_step_m());
        let is_given = |place: &&Place| {
            let found = Return { row: place.row, column: 0, tick: place.tick, steps: place.steps, echo: 0 };
            scanner.gives(&found, &positions[place.point as usize].map(f64::from), 0..3)
        };
        (places.iter().filter(is_given).count(), places.len())
    }

    /// A scanner, and if its firings have no tick of their own, the same with the timings that fit best.
    pub(super) fn with_timings(&self, scanner: Firings, is_steady: bool) -> Vec<Firings> {
        if is_steady {
            return vec![scanner];
        }
        let places = scanner.places(&self.scan.cloud.positions, REACH + 0.5 * scanner.range_step_m());
        let (places, _) = without_echoes(places);
        let timed = [1, 2].into_par_iter().filter_map(|firings| timed(&scanner, &places, firings));
        let mut all: Vec<Firings> = timed.collect();
        all.insert(0, scanner);
        all
    }
}

/// The coarsest step on which most ranges (metres) lie.
pub(super) fn range_step(ranges: impl Iterator<Item = f64> + Clone) -> Option<u32> {
    /// Metres: float32 coordinates tell nearer ranges no better.
    const NEAREST: f64 = 0.5;
    const FEWEST: usize = 200;
    let far = ranges.filter(|range| *range > NEAREST);
    let step = (far.clone().count() / SAMPLE).max(1);
    let ranges: Vec<f64> = far.step_by(step).collect();
    let is_on =
        |um: &u32| strength(ranges.iter().map(|range| range / (f64::from(*um) * 1e-6)), 0.0) > COHERENT;
    RANGE_STEPS_UM.into_iter().find(|um| ranges.len() >= FEWEST && is_on(um))
}

/// How coherent values are with the whole numbers, and with this phase: 1 if all lie on them.
pub(super) fn strength(values: impl Iterator<Item = f64>, phase: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for value in values {
        sum += libm::cos((value - phase) * TAU);
        count += 1;
    }
    sum / f64::from(count.max(1))
}

/// The phase of values against the whole numbers, in parts of one, and how coherent they are.
pub(super) fn phase(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut re, mut im, mut count) = (0.0, 0.0, 0);
    for value in values {
        re += libm::cos(value * TAU);
        im += libm::sin(value * TAU);
        count += 1;
    }
    (libm::atan2(im, re) / TAU, (re * re + im * im).sqrt() / f64::from(count.max(1)))
}

/// Radians: the points of a laser lie this near to its cone.
pub(super) const ON_CONE: f64 = 1e-4;

/// The elevations of the lasers, from the highest to the lowest: the narrow heaps of the points' elevations. None if most points
/// lie in none.
pub(super) fn elevations(points: &[Point]) -> Option<Vec<f64>> {
    const FEWEST_LASERS: usize = 4;
    const MOST_LASERS: usize = 512;
    /// Metres: elevations of nearer points are not sharp, or only if their coordinates are.
    const NEAREST: [f64; 2] = [0.3, 0.05];
    let step = (points.len() / (16 * SAMPLE)).max(1);
    let sample = points.iter().step_by(step);
    let heaps = |nearest: f64| {
        let far = sample.clone().filter(|point| point.range > nearest);
        let mut all: Vec<f64> = far.map(|point| point.elevation).collect();
        all.sort_unstable_by(|a, b| b.total_cmp(a));
        (narrow_heaps(&all), all.len())
    };
    let [far, near] = NEAREST.map(heaps);
    let ((inside, found), all) = if near.0.0 > far.0.0 { near } else { far };
    let is_scanner =
        (FEWEST_LASERS..=MOST_LASERS).contains(&found.len()) && inside as f64 >= LEAST_SHARE * all as f64;
    is_scanner.then_some(found)
}

/// The middles of the narrow heaps of some falling elevations, and how many of these are in one.
fn narrow_heaps(elevations: &[f64]) -> (usize, Vec<f64>) {
    /// Radians between the heaps of two lasers.
    const GAP: f64 = 6e-5;
    let fewest = (elevations.len() / 2000).max(8);
    let heaps = elevations.chunk_by(|a, b| a - b < GAP);
    let narrow = heaps.filter(|heap| heap.len() >= fewest && heap[0] - heap[heap.len() - 1] < 2.0 * ON_CONE);
    narrow.fold((0, Vec::new()), |(inside, mut middles), heap| {
        middles.push(heap[heap.len() / 2]);
        (inside + heap.len(), middles)
    })
}

/// Radians from the lowest laser to one that has seen nothing, wherever it looks.
const UNSEEN: f64 = 1e-3;

/// A file in which each laser has a record in each firing, whether it saw something or not.
pub(super) struct RecordGrid {
    /// The row of each line: of each slot if the file holds firing after firing.
    pub lines: Vec<u32>,
    /// Whether the file holds row after row.
    pub by_lines: bool,
    /// Firings.
    pub width: usize,
}

impl RecordGrid {
    /// Finds the grid of a file with so many records, of which these have these rows; none if it has none.
    fn find(places: &[(usize, usize)], records: usize, rows: usize) -> Option<Self> {
        /// Lasers that may have seen nothing, for one that has.
        const MOST_LINES: usize = 2;
        const FEWEST_COLUMNS: usize = 8;
        let whole = (rows..=MOST_LINES * rows).filter(|lines| records.is_multiple_of(*lines));
        let grids = whole.flat_map(|lines| [(lines, false), (lines, true)]);
        let mut grids = grids.filter(|(lines, _)| records / lines >= FEWEST_COLUMNS);
        grids.find_map(|(lines, by_lines)| Self::of(places, rows, (lines, records / lines), by_lines))
    }

    /// The grid of these lines, if each row has one of its own.
    fn of(
        places: &[(usize, usize)],
        rows: usize,
        (lines, width): (usize, usize),
        by_lines: bool,
    ) -> Option<Self> {
        /// The least part of the returns that is where it belongs.
        const LEAST: f64 = 0.95;
        let mut counts = vec![0u32; lines * rows];
        for (record, row) in places {
            let line = if by_lines { record / width } else { record % lines };
            counts[line * rows + row] += 1;
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
        if f64::from(inside) < LEAST * places.len() as f64 || places.is_empty() {
            return None;
        }
        // The other rows, seen or not, are those of the other lines.
        let seen = (0u32..).zip(taken).filter(|(_, taken)| !taken).map(|(row, _)| row);
        let mut rest = seen.chain(rows as u32..);
        let lines = row_of_line.into_iter().map(|row| row.or_else(|| rest.next())).collect::<Option<_>>()?;
        Some(RecordGrid { lines, by_lines, width })
    }

    /// The order of the lasers, and the ticks by which each is ahead of the one with the most returns.
    fn order(&self, places: &[(usize, usize)], sequence: &[(usize, u32)], ticks: u32) -> Order {
        let rows = self.lines.len();
        let mut counts = vec![0u32; rows];
        places.iter().for_each(|(_, row)| counts[*row] += 1);
        let first = (0..rows).rev().max_by_key(|&row| counts[row]).unwrap_or(0);
        let column = |record: usize| if self.by_lines { record % self.width } else { record / rows };
        let mut tick_of_column = vec![None; self.width];
        let found =
            || places.iter().zip(sequence).map(|((record, row), (_, tick))| (column(*record), *row, *tick));
        found()
            .filter(|(_, row, _)| *row == first)
            .for_each(|(column, _, tick)| tick_of_column[column] = Some(tick));
        let mut ahead: Vec<Vec<i64>> = vec![Vec::new(); rows];
        for (column, row, tick) in found() {
            let turn = i64::from(ticks);
            if let Some(first) = tick_of_column[column] {
                ahead[row].push((i64::from(tick) - i64::from(first) + turn / 2).rem_euclid(turn) - turn / 2);
            }
        }
        let all: usize = ahead.iter().map(Vec::len).sum();
        let shift = |mut ahead: Vec<i64>| {
            ahead.sort_unstable();
            let most = ahead.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
            most.map_or((0.0, 0), |same| (same[0] as f64, same.len()))
        };
        let (shifts, same): (Vec<f64>, Vec<usize>) = ahead.into_iter().map(shift).unzip();
        let is_steady = same.into_iter().sum::<usize>() as f64 >= STEADY * all as f64;
        let shifts = if is_steady { shifts } else { vec![0.0; rows] };
        let other_starts = Vec::new();
        Order { rows_of_slots: self.lines.clone(), other_starts, shifts, timing: Timing::Together, is_steady }
    }
}

/// The elevations of a VLP-16, if those that were found are some of them: which lasers are missing matters, for azimuths
/// go on while they fire.
fn completed(elevations: Vec<f64>) -> Vec<f64> {
    let mut all = VLP_16.map(|degrees| f64::from(degrees).to_radians());
    all.sort_unstable_by(|a, b| b.total_cmp(a));
    let is_known = |found: &f64| all.iter().any(|known| (known - found).abs() < ON_CONE);
    if elevations.iter().all(is_known) { all.to_vec() } else { elevations }
}

/// Some points of each row, the far ones where there are enough.
fn by_rows(points: &[Point], rows: &[Option<usize>], count: usize, most: usize) -> Vec<Vec<Point>> {
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
fn near_axes(points: &[Point], rows: &[Option<usize>], count: usize) -> Vec<Vec<Point>> {
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

/// The ticks a turn on which the azimuths of most rows lie, each with a phase of its own.
fn ticks(of_rows: &[Vec<Point>]) -> Option<u32> {
    let coherence = |ticks: u32| {
        let of_row = |points: &Vec<Point>| {
            let (_, strength) = phase(points.iter().map(|point| in_ticks(point, ticks)));
            (strength * points.len() as f64, points.len() as f64)
        };
        let (sum, count) = of_rows.iter().map(of_row).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        sum / f64::max(count, 1.0)
    };
    TICKS.into_iter().find(|&ticks| coherence(ticks) > COHERENT)
}

/// The azimuth of a point, clockwise from ahead. Where y is ahead all ticks are a quarter of a turn further, which is a
/// whole number.
fn in_ticks(point: &Point, ticks: u32) -> f64 {
    let [x, y, _] = point.position;
    libm::atan2(-y, x) / TAU * f64::from(ticks)
}

/// What is known of the lasers before it is rounded as their maker wrote it.
struct Constants {
    /// Radians, falling.
    elevations: Vec<f64>,
    /// Azimuth offsets, in ticks, but for whole ones.
    phases: Vec<f64>,
    /// Some points of each.
    of_rows: Vec<Vec<Point>>,
    /// Ten times as many.
    more_of_rows: Vec<Vec<Point>>,
    /// Some that are nearest to an axis.
    near_axes: Vec<Vec<Point>>,
}

impl Constants {
    /// Of the recipes, the one that gives the most points to the last bit, the first of equals, with the lasers'
    /// constants. `shifts` are the whole ticks that each is ahead of the others; if it is not, the third is true.
    fn with_recipe(&self, build: &Build, shifts: &[f64]) -> Option<(Build, Vec<Laser>, bool)> {
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
        // Recipes that give fewer than another are of no interest.
        let most = AtomicUsize::new(0);
        let tried = Recipe::ALL.into_par_iter().filter(|recipe| !recipe.is_off_axis()).map(|recipe| {
            let any = Firings::new(Build { recipe, ..build.clone() }, Vec::new(), Vec::new());
            let least = most.load(Ordering::Relaxed);
            let (common, exact) = self.common(&any, &offsets, &few, least);
            let own = self.own(&any, &offsets, &few, exact.max(least));
            let exact = own.unwrap_or(exact);
            most.fetch_max(exact, Ordering::Relaxed);
            (any, common, own.is_some(), exact)
        });
        let tried: Vec<_> = tried.collect();
        let (any, common, are_own, exact) = tried.into_iter().rev().max_by_key(|(.., exact)| *exact)?;
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let may_turn = any.build.recipe.adds_in_single() && 2 * exact > points;
        let of_row = |row: usize| {
            let offset = offsets[row] + f64::from(common) * tick;
            let (mut laser, exact) = self.laser(&any, row, offset, 0);
            // It may be off by whole ticks of its own, for want of points, or because as many pass until it fires.
            if may_turn && 4 * exact < 3 * self.of_rows[row].len() {
                laser = self.turned(&any, row, offset).0;
            }
            let sums = matches!(any.build.recipe, Recipe::Nebula | Recipe::Nebula2023);
            if sums { self.of_sums(&any, row, laser) } else { laser }
        };
        let lasers = (0..self.elevations.len()).into_par_iter().map(of_row).collect();
        Some((any.build, lasers, are_own))
    }

    /// How many points of these rows come out if each is off by whole ticks of its own, if that is at least three quarters
    /// and twice as many as come out anyway: lasers of which ticks pass until they fire.
    fn own(&self, any: &Firings, offsets: &[f64], few: &[usize], exact: usize) -> Option<usize> {
        let points: usize = few.iter().map(|&row| self.of_rows[row].len()).sum();
        let are_moved = few.iter().any(|&row| self.of_rows[row].iter().any(|point| point.moved.is_some()));
        if 2 * exact > points || are_moved || !any.build.recipe.adds_in_single() {
            return None;
        }
        let own = few.iter().map(|&row| self.turned(any, row, offsets[row]).1).sum::<usize>();
        (own >= 2 * exact && 4 * own >= 3 * points).then_some(own)
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

/// Steps to either side in which the constant of a program is looked for that wrote it with fewer digits.
const NEIGHBOURS: i32 = 12;

/// An angle in degrees as its maker may have written it, in units: with three digits, with six, two, four and seven, and
/// as it is.
fn roundings(degrees: f64) -> [i64; 6] {
    let units = 1.0 / ANGLE_UNIT;
    [1e3, 1e6, 1e2, 1e4, 1e7, units]
        .map(|digits| (round_ties_even(degrees * digits) * (units / digits)).round() as i64)
}
