//! Finds a scanner of firings from points alone: the range step and the azimuth ticks by their coherence, elevations
//! and azimuth offsets as medians that are rounded as makers round them, the order of the lasers by who follows whom,
//! and the recipe by trying all of them.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::projection::nearest;
use super::recipe::steps_of;
use super::{ANGLE_UNIT, Firings, Laser, Recipe, Timing};
use crate::ground::rounding::round_ties_even;
use crate::scan::ScanFile;
use crate::scanner::{REACH, Return};

/// Range steps that scanners have, in micrometres, coarse ones first: what lies on one lies on its parts too.
const RANGE_STEPS_UM: [u32; 9] = [12_000, 10_000, 8_000, 5_000, 4_000, 2_500, 2_000, 1_000, 500];
/// Ticks a turn that scanners have: few ones first, for the same reason, and hundredths of degrees.
const TICKS: [u32; 5] = [512, 1024, 2048, 4096, 36_000];
/// Values on a grid are as coherent as this, if they are float32.
const COHERENT: f64 = 0.9;
/// A scanner that explains fewer of the points than this is none.
const LEAST_SHARE: f64 = 0.5;
/// Points that tell enough.
const SAMPLE: usize = 4000;
/// Points of each laser that recipes are tried on.
const TRIED: usize = 60;

/// A return of the sample, in metres and radians.
#[derive(Clone, Copy)]
struct Point {
    position: [f64; 3],
    range: f64,
    elevation: f64,
}

impl Point {
    /// None for what has no direction.
    fn new(position: &[f32; 3]) -> Option<Self> {
        let position @ [x, y, z] = position.map(f64::from);
        let rho = (x * x + y * y).sqrt();
        let range = (rho * rho + z * z).sqrt();
        (range.is_finite() && rho > 0.0).then(|| Point { position, range, elevation: libm::atan2(z, rho) })
    }
}

/// Fits a scanner to a sample of a sequence's scans, and gives the share of the returns that it explains. None if
/// the points are not those of such a scanner, firing by firing.
pub fn fit(sample: &[ScanFile]) -> Option<(Firings, f64)> {
    let scan = sample.iter().max_by_key(|scan| scan.cloud.positions.len())?;
    let range_step_um = range_step(&scan.cloud.positions)?;
    let records = scan.cloud.positions.len();
    let (numbers, points): (Vec<usize>, Vec<Point>) = scan
        .cloud
        .positions
        .iter()
        .enumerate()
        .filter_map(|(record, position)| Some((record, Point::new(position)?)))
        .unzip();
    let mut elevations = completed(elevations(&points)?);
    let row = |point: &Point| {
        let row = nearest(&elevations, point.elevation);
        ((elevations[row] - point.elevation).abs() < ON_CONE).then_some(row)
    };
    let rows: Vec<Option<usize>> = points.iter().map(row).collect();
    let places: Vec<(usize, usize)> =
        numbers.into_iter().zip(&rows).filter_map(|(record, row)| Some((record, (*row)?))).collect();
    let grid = RecordGrid::find(&places, records, elevations.len());
    if let Some(grid) = &grid {
        // Lasers that have seen nothing: their records are there all the same.
        while elevations.len() < grid.lines.len() {
            elevations.push(elevations[elevations.len() - 1] - UNSEEN);
        }
    }
    let of_rows = by_rows(&points, &rows, elevations.len());
    let ticks = ticks(&of_rows)?;
    let phases: Vec<f64> =
        of_rows.iter().map(|points| phase(points.iter().map(|point| in_ticks(point, ticks))).0).collect();
    let sequence = points.iter().zip(&rows).filter_map(|(point, row)| {
        let tick = round_ties_even(in_ticks(point, ticks) - phases[(*row)?]) as i64;
        Some(((*row)?, tick.rem_euclid(i64::from(ticks)) as u32))
    });
    let sequence: Vec<(usize, u32)> = sequence.collect();
    let own = match &grid {
        Some(grid) => Some(grid.order(&places, &sequence, ticks)),
        None => order(&sequence, elevations.len(), ticks),
    };
    let orders = [own, vlp_16(&elevations)];
    let lines = grid.filter(|grid| grid.by_lines).map_or_else(Vec::new, |grid| grid.lines);
    let constants = Constants { elevations, phases, of_rows };
    let scanners = orders.into_iter().flatten().filter_map(|Order { rows_of_slots, shifts, timing }| {
        let recipes: Vec<_> = Recipe::ALL
            .into_par_iter()
            .map(|recipe| constants.rounded(recipe, &shifts, (ticks, range_step_um)))
            .collect();
        // The first of equals.
        let (_, recipe, lasers) = recipes.into_iter().rev().max_by_key(|(exact, _, _)| *exact)?;
        let scanner = Firings::new(recipe, (ticks, range_step_um), timing, lasers, rows_of_slots)
            .line_by_line(lines.clone());
        let image = scanner.project(&scan.cloud, REACH).image;
        Some((scanner, image.returns() as f64 / points.len().max(1) as f64, image.columns.len()))
    });
    // Of those that explain about as much, that of the fewest columns: there firings are whole.
    let worth = |share: f64, columns: usize| share / (1.0 + columns as f64 / points.len().max(1) as f64);
    let best = scanners.max_by(|a, b| worth(a.1, a.2).total_cmp(&worth(b.1, b.2)));
    best.filter(|(_, share, _)| *share >= LEAST_SHARE).map(|(scanner, share, _)| (scanner, share))
}

/// The coarsest step on which most ranges lie.
fn range_step(positions: &[[f32; 3]]) -> Option<u32> {
    /// Metres: float32 coordinates tell nearer ranges no better.
    const NEAREST: f64 = 0.5;
    const FEWEST: usize = 200;
    let step = (positions.len() / SAMPLE).max(1);
    let points = positions.iter().step_by(step).filter_map(Point::new);
    let ranges: Vec<f64> = points.map(|point| point.range).filter(|range| *range > NEAREST).collect();
    let is_on =
        |um: &u32| strength(ranges.iter().map(|range| range / (f64::from(*um) * 1e-6)), 0.0) > COHERENT;
    RANGE_STEPS_UM.into_iter().find(|um| ranges.len() >= FEWEST && is_on(um))
}

/// How coherent values are with the whole numbers, and with this phase: 1 if all lie on them.
fn strength(values: impl Iterator<Item = f64>, phase: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for value in values {
        sum += libm::cos((value - phase) * TAU);
        count += 1;
    }
    sum / f64::from(count.max(1))
}

/// The phase of values against the whole numbers, in parts of one, and how coherent they are.
fn phase(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (mut re, mut im, mut count) = (0.0, 0.0, 0);
    for value in values {
        re += libm::cos(value * TAU);
        im += libm::sin(value * TAU);
        count += 1;
    }
    (libm::atan2(im, re) / TAU, (re * re + im * im).sqrt() / f64::from(count.max(1)))
}

/// Radians: the points of a laser lie this near to its cone.
const ON_CONE: f64 = 1e-4;

/// The elevations of the lasers, from the highest to the lowest: the narrow heaps of the points' elevations. None if most points lie in none.
fn elevations(points: &[Point]) -> Option<Vec<f64>> {
    /// Radians between the heaps of two lasers.
    const GAP: f64 = 6e-5;
    /// Metres: elevations of nearer points are not sharp.
    const NEAREST: f64 = 1.0;
    const FEWEST_LASERS: usize = 4;
    const MOST_LASERS: usize = 512;
    let step = (points.len() / (16 * SAMPLE)).max(1);
    let far = points.iter().step_by(step).filter(|point| point.range > NEAREST);
    let mut all: Vec<f64> = far.map(|point| point.elevation).collect();
    all.sort_unstable_by(|a, b| b.total_cmp(a));
    let fewest = (all.len() / 2000).max(8);
    let heaps = all.chunk_by(|a, b| a - b < GAP);
    let narrow = heaps.filter(|heap| heap.len() >= fewest && heap[0] - heap[heap.len() - 1] < 2.0 * ON_CONE);
    let found: Vec<&[f64]> = narrow.collect();
    let inside: usize = found.iter().map(|heap| heap.len()).sum();
    let is_scanner = (FEWEST_LASERS..=MOST_LASERS).contains(&found.len())
        && inside as f64 >= LEAST_SHARE * all.len() as f64;
    is_scanner.then(|| found.iter().map(|heap| heap[heap.len() / 2]).collect())
}

/// Radians from the lowest laser to one that has seen nothing, wherever it looks.
const UNSEEN: f64 = 1e-3;

/// A file in which each laser has a record in each firing, whether it saw something or not.
struct RecordGrid {
    /// The row of each line: of each slot if the file holds firing after firing.
    lines: Vec<u32>,
    /// Whether the file holds row after row.
    by_lines: bool,
    /// Firings.
    width: usize,
}

impl RecordGrid {
    /// Finds the grid of a file with so many records, of which these have these rows; none if it has none.
    fn find(places: &[(usize, usize)], records: usize, rows: usize) -> Option<Self> {
        /// Lasers that may have seen nothing, for one that has.
        const MOST_LINES: usize = 2;
        const FEWEST_COLUMNS: usize = 8;
        let whole = (rows..=MOST_LINES * rows).filter(|lines| records % lines == 0);
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
        let shift = |mut ahead: Vec<i64>| {
            ahead.sort_unstable();
            let most = ahead.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
            most.map_or(0.0, |same| same[0] as f64)
        };
        let shifts = ahead.into_iter().map(shift).collect();
        Order { rows_of_slots: self.lines.clone(), shifts, timing: Timing::default() }
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

/// The elevations of Velodyne's VLP-16 in degrees, in the order in which its lasers fire.
const VLP_16: [i32; 16] = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];

/// Some points of each row, the far ones where there are enough.
fn by_rows(points: &[Point], rows: &[Option<usize>], count: usize) -> Vec<Vec<Point>> {
    let mut of_rows = vec![Vec::new(); count];
    for (point, row) in points.iter().zip(rows) {
        if let Some(row) = row {
            of_rows[*row].push(*point);
        }
    }
    for row in &mut of_rows {
        let far: Vec<Point> = row.iter().filter(|point| point.range > 3.0).copied().collect();
        let of = if far.len() >= TRIED { far } else { std::mem::take(row) };
        let step = (of.len() / TRIED).max(1);
        *row = of.into_iter().step_by(step).collect();
    }
    of_rows
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
}

impl Constants {
    /// The lasers with constants by which a recipe gives the most points to the last bit, and how many.
    /// `shifts` are the whole ticks that each is ahead of the others.
    fn rounded(
        &self,
        recipe: Recipe,
        shifts: &[f64],
        (ticks, range_step_um): (u32, u32),
    ) -> (usize, Recipe, Vec<Laser>) {
        /// Whole ticks by which all offsets may be off.
        const COMMON: i32 = 4;
        let any = Firings::new(recipe, (ticks, range_step_um), Timing::default(), Vec::new(), Vec::new());
        let tick = 360.0 / f64::from(ticks);
        let offsets: Vec<f64> =
            self.phases.iter().zip(shifts).map(|(phase, shift)| (phase + shift) * tick).collect();
        let mean = offsets.iter().sum::<f64>() / offsets.len().max(1) as f64;
        let middle = round_ties_even(-mean / tick);
        // Only where a tick is no whole number of thousandths of a degree it matters.
        let is_whole = 360_000 % ticks == 0;
        let common = if is_whole { 0..=0 } else { -COMMON..=COMMON };
        let lasers = |common: i32| {
            let offset = (middle + f64::from(common)) * tick;
            let pairs = self.elevations.iter().zip(&offsets).zip(&self.of_rows);
            let found = pairs.map(|((elevation, azimuth), points)| {
                laser(&any, [elevation.to_degrees(), azimuth + offset], points)
            });
            let (lasers, exact): (Vec<Laser>, Vec<usize>) = found.unzip();
            (exact.into_iter().sum::<usize>(), recipe, lasers)
        };
        let in_thousandths = |lasers: &[Laser]| {
            let thousandth = (1e-3 / ANGLE_UNIT) as i64;
            lasers.iter().filter(|laser| laser.azimuth % thousandth == 0).count()
        };
        // The nearest to the middle of equals.
        let mut common: Vec<i32> = common.collect();
        common.sort_by_key(|common| -common.abs());
        let found = common.into_iter().map(lasers);
        let best = found.max_by_key(|(exact, _, lasers)| (*exact, in_thousandths(lasers)));
        best.unwrap_or((0, recipe, Vec::new()))
    }
}

/// The constants of a laser, given its elevation and azimuth offset in degrees, and how many of its points they give to
/// the last bit.
fn laser(any: &Firings, degrees: [f64; 2], points: &[Point]) -> (Laser, usize) {
    let exact = |laser: &Laser| {
        let scanner = any.of_laser(*laser);
        let is_exact = |point: &&Point| {
            let Some(steps) = steps_of(point.position, scanner.range_step_m()) else { return false };
            let [x, y, _] = point.position;
            let found = Return { row: 0, column: 0, tick: scanner.nearest_tick(0, x, y), steps };
            scanner.gives(&found, &point.position)
        };
        points.iter().filter(is_exact).count()
    };
    let mut best: Option<(Laser, usize)> = None;
    let try_all = |best: &mut Option<(Laser, usize)>, lasers: &mut dyn Iterator<Item = Laser>| {
        for laser in lasers {
            let count = exact(&laser);
            if best.is_none_or(|(_, most)| count > most) {
                *best = Some((laser, count));
            }
        }
    };
    let azimuths = roundings(degrees[1]);
    let pairs = roundings(degrees[0])
        .flat_map(|elevation| azimuths.clone().map(move |azimuth| Laser { elevation, azimuth }));
    try_all(&mut best, &mut pairs.clone());
    if best.is_some_and(|(_, count)| count < points.len()) {
        let (around, _) = best.unwrap_or_default();
        let step = any.recipe.elevation_step(around.elevation_degrees());
        let near = (-NEIGHBOURS..=NEIGHBOURS).map(|steps| {
            let elevation = around.elevation + (f64::from(steps) * step / ANGLE_UNIT).round() as i64;
            Laser { elevation, ..around }
        });
        try_all(&mut best, &mut near.clone());
    }
    best.unwrap_or_default()
}

/// Steps to either side in which the constant of a program is looked for that wrote it with fewer digits.
const NEIGHBOURS: i32 = 4;

/// An angle in degrees as its maker may have written it, in units: with three digits, with two, and as it is.
fn roundings(degrees: f64) -> impl Iterator<Item = i64> + Clone {
    let units = 1.0 / ANGLE_UNIT;
    let rounded = move |digits: f64| (round_ties_even(degrees * digits) * (units / digits)).round() as i64;
    [rounded(1000.0), rounded(100.0), rounded(units)].into_iter()
}

/// The order in which lasers fire.
struct Order {
    rows_of_slots: Vec<u32>,
    /// Whole ticks that each row is ahead.
    shifts: Vec<f64>,
    timing: Timing,
}

/// Finds the order of the lasers from rows and ticks in the order of a file. None if they are not in the order of
/// firings.
fn order(sequence: &[(usize, u32)], rows: usize, ticks: u32) -> Option<Order> {
    /// The part of the steps from one laser to another that are the same if all of a firing have one azimuth.
    const STEADY: f64 = 0.93;
    /// Fewer steps than these say nothing.
    const FEWEST: usize = 8;
    let mut order = cycle(sequence, rows)?;
    let mut slots = vec![0; rows];
    order.iter().enumerate().for_each(|(slot, &row)| slots[row] = slot);
    let turned = |from: u32, to: u32| {
        let turn = i64::from(ticks);
        (i64::from(to) - i64::from(from) + turn / 2).rem_euclid(turn) - turn / 2
    };
    // The steps from each laser to each that follows it in the file.
    let mut steps: Vec<Vec<i64>> = vec![Vec::new(); rows * rows];
    for pair in sequence.windows(2) {
        let [(from, before), (to, after)] = [pair[0], pair[1]];
        steps[slots[from] * rows + slots[to]].push(turned(before, after));
    }
    // The most frequent step, and how many are the same.
    let mode = |steps: &mut Vec<i64>| {
        steps.sort_unstable();
        let most = steps.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
        most.map_or((0, 0), |same| (same[0], same.len()))
    };
    let modes: Vec<(i64, usize)> = steps.iter_mut().map(mode).collect();
    // Those from each slot to the next one, the last followed by the first.
    let next = |slot: usize| slot * rows + (slot + 1) % rows;
    let share = |slot: usize| modes[next(slot)].1 as f64 / steps[next(slot)].len().max(1) as f64;
    let mean = |slot: usize| {
        let steps = &steps[next(slot)];
        steps.iter().sum::<i64>() as f64 / steps.len().max(1) as f64
    };
    let known = (0..rows * rows).filter(|&pair| steps[pair].len() >= FEWEST);
    let (same, all) = known.fold((0, 0), |(same, all), pair| (same + modes[pair].1, all + steps[pair].len()));
    // The steps from the last laser of a firing to the first of the next may differ.
    let ends = sequence.len() / rows.max(1);
    if same as f64 >= STEADY * all.saturating_sub(ends) as f64 {
        // One azimuth a firing: its end is where the steps differ most, or else, if the scanner turns by the same from
        // firing to firing, where it goes back from one end of the rows to the other.
        let seen = (0..rows).filter(|&slot| steps[next(slot)].len() >= FEWEST);
        let worst = seen.min_by(|&a, &b| share(a).total_cmp(&share(b))).unwrap_or(0);
        let jump = |slot: &usize| order[*slot].abs_diff(order[(*slot + 1) % rows]);
        let longest = (0..rows).rev().max_by_key(jump).unwrap_or(0);
        let start = (if share(worst) < STEADY { worst } else { longest } + 1) % rows;
        let (mut shifts, mut shift) = (vec![0.0; rows], 0);
        for slot in 0..rows {
            let place = (start + slot) % rows;
            shifts[order[place]] = shift as f64;
            shift += modes[next(place)].0;
        }
        order.rotate_left(start);
        let rows_of_slots = order.into_iter().map(|row| row as u32).collect();
        return Some(Order { rows_of_slots, shifts, timing: Timing::default() });
    }
    // The longest step is the one to the next firing.
    let last = (0..rows).max_by(|&a, &b| mean(a).abs().total_cmp(&mean(b).abs()))?;
    order.rotate_left((last + 1) % rows);
    let rows_of_slots = order.into_iter().map(|row| row as u32).collect();
    Some(Order { rows_of_slots, shifts: vec![0.0; rows], timing: Timing::default() })
}

/// The order of a VLP-16, if these are its elevations.
fn vlp_16(elevations: &[f64]) -> Option<Order> {
    let row = |degrees: i32| {
        let row = nearest(elevations, f64::from(degrees).to_radians());
        ((elevations[row].to_degrees() - f64::from(degrees)).abs() < 0.1).then_some(row as u32)
    };
    let rows_of_slots: Option<Vec<u32>> = VLP_16.map(row).into_iter().collect();
    let is_all = elevations.len() == VLP_16.len();
    let order =
        |rows_of_slots| Order { rows_of_slots, shifts: vec![0.0; VLP_16.len()], timing: Timing::VLP_16 };
    rows_of_slots.filter(|_| is_all).map(order)
}

/// The rows in the order in which they follow one another, round and round, beginning anywhere. None if they do not.
fn cycle(sequence: &[(usize, u32)], rows: usize) -> Option<Vec<usize>> {
    /// Rounds that tell enough.
    const ROUNDS: usize = 500;
    let mut counts = vec![0u32; rows];
    sequence.iter().for_each(|(row, _)| counts[*row] += 1);
    let again = sequence.windows(2).filter(|pair| pair[0].0 == pair[1].0).count();
    if again * 2 > sequence.len() {
        return None;
    }
    // Rounds begin with the row that is seen most.
    let first = (0..rows).rev().max_by_key(|&row| counts[row])?;
    let rounds = sequence.chunk_by(|_, next| next.0 != first);
    let is_single = |round: &&[(usize, u32)]| {
        let mut seen = vec![false; rows];
        round.len() > 1 && round.iter().all(|(row, _)| !std::mem::replace(&mut seen[*row], true))
    };
    let rounds: Vec<_> = rounds.filter(is_single).collect();
    let mut before = vec![0u32; rows * rows];
    for round in rounds.iter().step_by((rounds.len() / ROUNDS).max(1)) {
        for (place, (row, _)) in round.iter().enumerate() {
            round[place + 1..].iter().for_each(|(later, _)| before[row * rows + later] += 1);
        }
    }
    let precedes = |a: usize, b: usize| before[a * rows + b] > before[b * rows + a];
    let mut order: Vec<usize> = (0..rows).collect();
    order.sort_by_cached_key(|&row| {
        (row != first, rows - (0..rows).filter(|&other| precedes(row, other)).count())
    });
    Some(order)
}
