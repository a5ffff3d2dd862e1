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
    let points: Vec<Point> = scan.cloud.positions.iter().filter_map(Point::new).collect();
    let elevations = elevations(&points)?;
    let falling: Vec<f64> = elevations.iter().map(|(median, _)| *median).collect();
    let rows: Vec<Option<u32>> = points
        .iter()
        .map(|point| {
            let row = nearest(&falling, point.elevation);
            ((falling[row] - point.elevation).abs() < ON_CONE).then_some(row as u32)
        })
        .collect();
    let of_rows = by_rows(&points, &rows, falling.len());
    let recipes = Recipe::ALL.into_par_iter().filter_map(|recipe| {
        let ticks = ticks(recipe, &of_rows)?;
        let any = Firings::new(recipe, (ticks, range_step_um), Timing::default(), Vec::new(), Vec::new());
        let found: Vec<(Laser, usize, usize)> =
            falling.iter().zip(&of_rows).map(|(elevation, points)| laser(&any, *elevation, points)).collect();
        let (exact, tried) =
            found.iter().fold((0, 0), |sum, (_, exact, tried)| (sum.0 + exact, sum.1 + tried));
        let lasers = found.into_iter().map(|(laser, _, _)| laser).collect::<Vec<_>>();
        Some((exact as f64 / tried.max(1) as f64, recipe, ticks, lasers))
    });
    let recipes: Vec<_> = recipes.collect();
    // The first of equals.
    let (_, recipe, ticks, lasers) = recipes.into_iter().rev().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let identity = (0..lasers.len() as u32).collect();
    let scanner = Firings::new(recipe, (ticks, range_step_um), Timing::default(), lasers.clone(), identity);
    let places = scanner.places(&scan.cloud.positions, REACH + 0.5 * scanner.range_step_m());
    let sequence: Vec<(u32, u32)> = places.iter().map(|place| (place.row, place.tick)).collect();
    let (slots, spread) = slots(&sequence, lasers.len(), ticks)?;
    let timing = if spread > 2.0 { Timing::VLP_16 } else { Timing::default() };
    let scanner = Firings::new(recipe, (ticks, range_step_um), timing, lasers, slots);
    let projection = scanner.project(&scan.cloud, REACH);
    let share = projection.image.returns() as f64 / points.len().max(1) as f64;
    (share >= LEAST_SHARE).then_some((scanner, share))
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

/// The elevations of the lasers, from the highest to the lowest, with the number of their points: the narrow heaps of
/// the points' elevations. None if most points lie in none.
fn elevations(points: &[Point]) -> Option<Vec<(f64, usize)>> {
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
    let found: Vec<(f64, usize)> = narrow.map(|heap| (heap[heap.len() / 2], heap.len())).collect();
    let inside: usize = found.iter().map(|(_, count)| count).sum();
    let is_scanner = (FEWEST_LASERS..=MOST_LASERS).contains(&found.len())
        && inside as f64 >= LEAST_SHARE * all.len() as f64;
    is_scanner.then_some(found)
}

/// Some points of each row, the far ones where there are enough.
fn by_rows(points: &[Point], rows: &[Option<u32>], count: usize) -> Vec<Vec<Point>> {
    let mut of_rows = vec![Vec::new(); count];
    for (point, row) in points.iter().zip(rows) {
        if let Some(row) = row {
            of_rows[*row as usize].push(*point);
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
fn ticks(recipe: Recipe, of_rows: &[Vec<Point>]) -> Option<u32> {
    let coherence = |ticks: u32| {
        let of_row = |points: &Vec<Point>| {
            let (_, strength) = phase(points.iter().map(|point| in_ticks(recipe, point, ticks)));
            (strength * points.len() as f64, points.len() as f64)
        };
        let (sum, count) = of_rows.iter().map(of_row).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        sum / f64::max(count, 1.0)
    };
    TICKS.into_iter().find(|&ticks| coherence(ticks) > COHERENT)
}

fn in_ticks(recipe: Recipe, point: &Point, ticks: u32) -> f64 {
    let [x, y, _] = point.position;
    recipe.azimuth(x, y) / TAU * f64::from(ticks)
}

/// The constants of a laser, how many of its points they give to the last bit, and of how many.
fn laser(any: &Firings, elevation: f64, points: &[Point]) -> (Laser, usize, usize) {
    let (recipe, ticks) = (any.recipe, any.ticks);
    let (offset, _) = phase(points.iter().map(|point| in_ticks(recipe, point, ticks)));
    let degrees = [elevation.to_degrees(), offset * 360.0 / f64::from(ticks)];
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
    let rounded = roundings(degrees[0]);
    let pairs =
        rounded.flat_map(|elevation| azimuths.clone().map(move |azimuth| Laser { elevation, azimuth }));
    try_all(&mut best, &mut pairs.clone());
    if best.is_some_and(|(_, count)| count < points.len()) {
        let (around, _) = best.unwrap_or_default();
        let step = recipe.elevation_step(around.elevation_degrees());
        let near = (-NEIGHBOURS..=NEIGHBOURS).map(|steps| {
            let elevation = around.elevation + (f64::from(steps) * step / ANGLE_UNIT).round() as i64;
            Laser { elevation, ..around }
        });
        try_all(&mut best, &mut near.clone());
    }
    let (laser, count) = best.unwrap_or_default();
    (laser, count, points.len())
}

/// Steps to either side in which the constant of a program is looked for that wrote it with fewer digits.
const NEIGHBOURS: i32 = 4;

/// An angle in degrees as its maker may have written it, in units: with three, two, one or no digits, and as it is.
fn roundings(degrees: f64) -> impl Iterator<Item = i64> + Clone {
    let units = 1.0 / ANGLE_UNIT;
    let rounded = move |digits: f64| (round_ties_even(degrees * digits) * (units / digits)).round() as i64;
    [rounded(1000.0), rounded(100.0), rounded(units)].into_iter()
}

/// The row of each slot, from who follows whom in a file, and how many ticks pass from the first slot to the last.
/// None if the points are not in the order of firings.
fn slots(sequence: &[(u32, u32)], rows: usize, ticks: u32) -> Option<(Vec<u32>, f64)> {
    let turned = |from: u32, to: u32| {
        let turn = i64::from(ticks);
        ((i64::from(to) - i64::from(from) + turn / 2).rem_euclid(turn) - turn / 2) as f64
    };
    let mut follows = vec![(0u32, 0.0f64); rows * rows];
    for pair in sequence.windows(2) {
        let [(from, before), (to, after)] = [pair[0], pair[1]];
        let turned = turned(before, after);
        let entry = &mut follows[from as usize * rows + to as usize];
        entry.0 += 1;
        // A jump in the file is no step.
        entry.1 += if turned.abs() < f64::from(ticks) / 100.0 { turned } else { 0.0 };
    }
    let again: u32 = (0..rows).map(|row| follows[row * rows + row].0).sum();
    if again as usize * 2 > sequence.len() {
        return None;
    }
    let count = |from: usize, to: usize| follows[from * rows + to].0;
    let of_row = |row: usize| (0..rows).map(|to| count(row, to)).sum::<u32>();
    let start = (0..rows).rev().max_by_key(|&row| of_row(row))?;
    let mut order = vec![start];
    let mut is_free = vec![true; rows];
    is_free[start] = false;
    while order.len() < rows {
        let last = order[order.len() - 1];
        let next = (0..rows).rev().filter(|&row| is_free[row]).max_by_key(|&row| count(last, row))?;
        is_free[next] = false;
        order.push(next);
    }
    // The firing begins after the longest step.
    let mean = |from: usize, to: usize| {
        let (count, sum) = follows[from * rows + to];
        if count == 0 { 0.0 } else { sum / f64::from(count) }
    };
    let step = |slot: usize| mean(order[slot], order[(slot + 1) % rows]).abs();
    let last = (0..rows).rev().max_by(|&a, &b| step(a).total_cmp(&step(b)))?;
    order.rotate_left((last + 1) % rows);
    let spread: f64 = order.windows(2).map(|pair| mean(pair[0], pair[1])).sum();
    Some((order.into_iter().map(|row| row as u32).collect(), spread.abs()))
}
