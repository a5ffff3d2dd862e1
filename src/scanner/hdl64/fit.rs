//! Fits the scanner's formula to the sequence itself, with no prior knowledge of the scanner except its
//! grids: azimuth ticks of 0.09 degrees and range steps of 2 mm (Velodyne HDL-64E).
//!
//! For each beam: (1) a robust line through z against rho gives elevation and height; (2) the sideways offset
//! is the one that makes the azimuth ticks most coherent; (3) the phase of the range on its grid gives the
//! range offset; (4) least squares on x, y and z gives all five constants.

use std::cmp::Reverse;
use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};
use pulp::{NullaryFnOnce, Simd, WithSimd};
use rayon::prelude::*;

use super::beams::{Beam, Cone, Point, align, split_beams};
use super::column_shifts::column_shifts;
use super::formula::small_atan;
use super::sharpen::sharpen;
use super::{BeamConstants, Hdl64, Refinement};
use crate::ground::angle::rough_sine;
use crate::ground::floats::round_ties_even;
use crate::ground::lanes::{dispatch, lanes};
use crate::scan::ScanFile;
use crate::scanner::{AT_ONCE, CoordinateGrid, thinned};

/// Azimuth ticks in a turn of the scanners that this fit handles.
const TICKS: u32 = 4000;
/// Their range step in micrometres.
pub const RANGE_STEP_UM: u32 = 2000;
const RANGE_STEP: f64 = RANGE_STEP_UM as f64 * 1e-6;
const TICK: f64 = TAU / TICKS as f64;
/// Minimum number of points that determine a beam.
const FEWEST_POINTS: usize = 40;
/// Number of a beam's points that are used where a sample is enough.
const SAMPLE: usize = 1500;
/// Minimum share of a beam's points within reach of the corrections; with fewer the constants are wrong.
const LEAST_OF_BEAM: f64 = 0.7;
/// Minimum share of the points that the scanner must explain.
const LEAST_SHARE: f64 = 0.5;

/// Fits a scanner to a sample of the sequence's scans. `None` if the points are not those of such a scanner,
/// stored beam by beam.
pub fn fit(sample: &[ScanFile]) -> Option<Hdl64> {
    let scans: Vec<(CoordinateGrid, Vec<Vec<Point>>)> = sample
        .par_iter()
        .map(|scan| {
            (
                CoordinateGrid::of(scan.cloud.positions.iter().step_by(7).flatten()),
                split_beams(&scan.cloud.positions),
            )
        })
        .collect();
    let on = |grid: CoordinateGrid| -> Vec<&[Vec<Point>]> {
        scans.iter().filter(|(other, _)| *other == grid).map(|(_, beams)| beams.as_slice()).collect()
    };
    let mut grids = [CoordinateGrid::Millimetre, CoordinateGrid::Float32];
    grids.sort_by_key(|&grid| Reverse(on(grid).iter().copied().flatten().map(Vec::len).sum::<usize>()));
    grids.into_iter().find_map(|grid| fit_scans(grid, &on(grid)))
}

/// Whether a scan is certainly from such a scanner, judging by a few beams in its middle. If not, it may
/// still be.
pub fn is_evident(positions: &[[f32; 3]]) -> bool {
    /// Number of beams that are examined; scans with fewer are not.
    const BEAMS: usize = 5;
    /// In metres: points of another scanner beyond this distance are not on the ticks by chance.
    const FAR: f64 = 4.0;
    /// Minimum number of far points of a beam, and the share of them that the formula must explain.
    const FEWEST: usize = 50;
    const LEAST: f64 = 0.9;
    let (middle, half) = (positions.len() / 2, positions.len() / 10);
    let mut beams = split_beams(&positions[middle - half..middle + half]);
    // The first and the last beam are incomplete.
    if beams.len() < BEAMS + 2 {
        beams = split_beams(positions);
    }
    let middle = (beams.len() / 2).saturating_sub(BEAMS / 2);
    let Some(beams) = beams.get(middle..middle + BEAMS) else { return false };
    let coordinates = CoordinateGrid::of(positions.iter().step_by(7).flatten());
    let is_evident = |beam: &&Vec<Point>| {
        let far: Vec<Point> = beam.iter().filter(|point| point.rho > FAR).copied().collect();
        far.len() >= FEWEST
            && fit_beam(beam, coordinates).is_some_and(|constants| explained_share(&constants, &far) >= LEAST)
    };
    2 * beams.iter().filter(is_evident).count() > BEAMS
}

/// Fits a scanner to scans whose coordinates are on the same grid.
fn fit_scans(coordinates: CoordinateGrid, scans: &[&[Vec<Point>]]) -> Option<Hdl64> {
    let beams = align(scans);
    let fit = |beam: &Beam| fit_beam(&beam.points(), coordinates).map(BeamConstants::quantise);
    let constants: Vec<_> = beams.par_iter().map(fit).collect();
    let (beams, constants): (Vec<&Beam>, Vec<BeamConstants>) =
        beams.iter().zip(constants).filter_map(|(beam, constants)| Some((beam, constants?))).unzip();
    let taken = |scan: usize| beams.iter().map(|beam| beam.points_in(scan)).sum::<usize>();
    let total = |scan: usize| scans[scan].iter().map(Vec::len).sum::<usize>();
    let used = (0..scans.len()).filter(|&scan| taken(scan) > 0);
    let (taken, total) = used.fold((0, 0), |sum, scan| (sum.0 + taken(scan), sum.1 + total(scan)));
    if taken == 0 || (taken as f64) < LEAST_SHARE * total as f64 {
        return None;
    }
    let mut model = Hdl64::new(coordinates, TICKS, RANGE_STEP_UM, constants);
    let shifts = column_shifts(&model, &beams);
    model.set_column_shifts(&shifts);
    Some(match coordinates {
        CoordinateGrid::Float32 => in_single_precision(model, &beams),
        _ => model,
    })
}

/// The scanner with single-precision arithmetic, if this reproduces more of the coordinates exactly.
fn in_single_precision(model: Hdl64, beams: &[&Beam]) -> Hdl64 {
    /// Number of points of each beam that are compared.
    const COMPARED: usize = 200;
    let points: Vec<Vec<Point>> = beams.par_iter().map(|beam| beam.points()).collect();
    let refinements: Vec<Option<Refinement>> =
        points.par_iter().enumerate().map(|(row, points)| sharpen(&model, row, points)).collect();
    if refinements.iter().all(Option::is_none) {
        return model;
    }
    let refined =
        model.clone().with_refinements(refinements.into_iter().map(Option::unwrap_or_default).collect());
    let exact = |model: &Hdl64| {
        let of_point = |row: usize, point: &Point| {
            let Some((tick, steps)) = model.invert(row, point.position) else { return 0 };
            let position = model.position_at(row, tick, model.metres(steps));
            position.iter().zip(point.position).filter(|(a, b)| f64::from(**a as f32) == *b).count()
        };
        let of_beam = |(row, points): (usize, &Vec<Point>)| {
            thinned(points, COMPARED).map(|point| of_point(row, point)).sum::<usize>()
        };
        points.par_iter().enumerate().map(of_beam).sum::<usize>()
    };
    if exact(&refined) > exact(&model) { refined } else { model }
}

/// The constants of one beam. `None` if there are too few points, or if they are not those of such a beam.
fn fit_beam(points: &[Point], coordinates: CoordinateGrid) -> Option<[f64; 5]> {
    if points.len() < FEWEST_POINTS {
        return None;
    }
    let cone = Cone::fit(&thinned(points, SAMPLE / 3).copied().collect::<Vec<_>>());
    let elevation = libm::atan(cone.slope);
    let (side, rot) = side_offset(&far_sample(points));
    let offset = range_phase(points, elevation);
    let start = [elevation, offset, cone.height + cone.slope * offset, side, rot];
    let constants = refine(start, points, coordinates);
    (explained_share(&constants, points) >= LEAST_OF_BEAM).then_some(constants)
}

/// A sample of points that are far enough away for an accurate azimuth.
fn far_sample(points: &[Point]) -> Vec<Point> {
    for least in [5.0, 3.2, 0.0] {
        let far: Vec<&Point> = points.iter().filter(|p| p.rho > least).collect();
        if far.len() >= 500 || least == 0.0 {
            return thinned(&far, SAMPLE).map(|point| **point).collect();
        }
    }
    Vec::new()
}

/// Coherence and phase (radians) of a set of values on a grid of `period`.
fn coherence(values: &[f64], period: f64) -> (f64, f64) {
    let [re, im] = dispatch(Phasors { values, period });
    (libm::hypot(re, im), libm::atan2(im, re))
}

/// The arguments of [`coherence`], for a function compiled for several vector units: the sums of the cosines
/// and the sines.
struct Phasors<'a> {
    values: &'a [f64],
    period: f64,
}

impl NullaryFnOnce for Phasors<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn call(self) -> [f64; 2] {
        let by_period = 1.0 / self.period;
        let (mut re, mut im) = ([0.0; AT_ONCE], [0.0; AT_ONCE]);
        let (blocks, rest) = self.values.as_chunks::<AT_ONCE>();
        for block in blocks {
            let turns: [f64; AT_ONCE] = lanes(|i| block[i] * by_period);
            re = lanes(|i| re[i] + rough_sine(turns[i] + 0.25));
            im = lanes(|i| im[i] + rough_sine(turns[i]));
        }
        for (lane, value) in rest.iter().enumerate() {
            re[lane] += rough_sine(value * by_period + 0.25);
            im[lane] += rough_sine(value * by_period);
        }
        [re, im].map(|lanes| lanes.iter().sum())
    }
}

/// Step 2: the sideways offset h that brings the azimuths onto the ticks, and the phase rot. First
/// approximately, from a part of the points, then from all of them.
fn side_offset(far: &[Point]) -> (f64, f64) {
    // The azimuth, and the reciprocal of the distance.
    let sample = |count: usize| -> Vec<[f64; 2]> {
        thinned(far, count).map(|point| [point.azimuth, 1.0 / point.rho]).collect()
    };
    let at = |points: &[[f64; 2]], h: f64| {
        let angles: Vec<f64> =
            points.iter().map(|[azimuth, by_rho]| azimuth - small_atan(h * by_rho)).collect();
        coherence(&angles, TICK)
    };
    let best = |points: &[[f64; 2]], mm: &mut dyn Iterator<Item = i32>| {
        let strength = |mm: i32| at(points, f64::from(mm) * 1e-3).0;
        mm.map(|mm| (mm, strength(mm))).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(mm, _)| mm)
    };
    let rough = best(&sample(150), &mut (-60..=60).step_by(3));
    let h = f64::from(best(&sample(400), &mut (rough - 3..=rough + 3))) * 1e-3;
    (h, at(&sample(far.len()), h).1 / TAU * TICK)
}

/// Step 3: the phase of the range on its grid, as the offset b in metres.
fn range_phase(points: &[Point], elevation: f64) -> f64 {
    let mut ranges: Vec<f64> = thinned(points, SAMPLE).map(|p| p.rho / libm::cos(elevation)).collect();
    // Leaves out the nearest and the farthest ranges.
    let (first, end) = (ranges.len() / 20, ranges.len() * 17 / 20);
    ranges.select_nth_unstable_by(end, f64::total_cmp);
    ranges[..end].select_nth_unstable_by(first, f64::total_cmp);
    let middle = &ranges[first..end];
    coherence(middle, RANGE_STEP).1 / TAU * RANGE_STEP * libm::cos(elevation)
}

/// Step 4: Gauss-Newton on the errors of x, y and z, with the integers fixed; repeated, because the integers
/// change with the constants.
fn refine(start: [f64; 5], points: &[Point], coordinates: CoordinateGrid) -> [f64; 5] {
    let mut constants = start;
    let least_squares = |constants: &[f64; 5], count: usize, reach: f64| {
        let points: Vec<Point> = thinned(points, count).copied().collect();
        System::of(&FitFormula::new(constants), &points, reach, 0.0)
    };
    // The constants are far off at first, so a few points are enough.
    for (count, reach) in
        [(SAMPLE / 8, 0.004), (SAMPLE / 8, 0.004), (SAMPLE / 4, 0.0015), (SAMPLE / 2, 0.0015)]
    {
        least_squares(&constants, count, reach).step(&mut constants);
    }
    let good = least_squares(&constants, SAMPLE, 0.0015);
    good.step(&mut constants);
    if coordinates == CoordinateGrid::Millimetre {
        centre_in_roundings(&mut constants, points, &good);
    }
    constants
}

/// A coordinate rounded to the millimetre has an error of up to half a millimetre, however accurate the
/// constants are; only larger errors show that the constants are wrong. This moves the constants until few
/// errors are larger, which makes them far more accurate than least squares can.
fn centre_in_roundings(constants: &mut [f64; 5], points: &[Point], whole: &System) {
    const ROUNDS: usize = 12;
    /// In metres and radians: a round that moves no constant by more is the last.
    const SETTLED: f64 = 2e-8;
    /// In metres.
    const HALF_UNIT: f64 = 5e-4;
    const REACH: f64 = 0.0015;
    /// In metres: coordinates farther than this from a rounding boundary will not cross it, as least squares
    /// is accurate to a few micrometres.
    const NEAR_BORDER: f64 = 3e-5;
    /// How strongly the points inside their roundings hold the constants in place.
    const INERTIA: f64 = 0.003;
    let largest_misses = FitFormula::new(constants).largest_misses(points);
    let is_near_border = |largest: f64| largest > HALF_UNIT - NEAR_BORDER && largest < REACH;
    let near_border = points.iter().zip(largest_misses).filter(|(_, largest)| is_near_border(*largest));
    let points: Vec<Point> = near_border.map(|(point, _)| *point).collect();
    for _ in 0..ROUNDS {
        let formula = FitFormula::new(constants);
        let is_beyond = |largest: f64| largest > HALF_UNIT && largest < REACH;
        let misses = formula.largest_misses(&points);
        let beyond = points.iter().zip(misses).filter(|(_, largest)| is_beyond(*largest));
        let beyond: Vec<Point> = beyond.map(|(point, _)| *point).collect();
        let beyond = System::of(&formula, &beyond, REACH, HALF_UNIT);
        let moved =
            System { normal: whole.normal * INERTIA + beyond.normal, right: beyond.right }.step(constants);
        if moved < SETTLED {
            break;
        }
    }
}

/// The normal equations of a least-squares problem in the five constants.
struct System {
    /// Only the lower triangle is used.
    normal: SMatrix<f64, 5, 5>,
    right: SVector<f64, 5>,
}

impl System {
    /// The equations of the points that are within `reach` metres of the formula along all axes. Of these,
    /// only the coordinates count that are off by more than `slack` metres, each with an error that is
    /// smaller by `slack`.
    fn of(formula: &FitFormula, points: &[Point], reach: f64, slack: f64) -> Self {
        dispatch(Equations { formula, points, reach, slack })
    }

    /// Moves the constants to the solution, and returns the largest change; without a solution they are not
    /// changed.
    fn step(&self, constants: &mut [f64; 5]) -> f64 {
        let Some(cholesky) = self.normal.cholesky() else { return 0.0 };
        let step = cholesky.solve(&self.right);
        constants.iter_mut().zip(step.iter()).for_each(|(constant, s)| *constant += s);
        step.amax()
    }
}

/// The arguments of [`System::of`], for a function compiled for several vector units.
struct Equations<'a> {
    formula: &'a FitFormula,
    points: &'a [Point],
    reach: f64,
    slack: f64,
}

/// The elements of the lower triangle that are not 0, by row and column, in the equations of x and y and in
/// those of z.
const OF_X_AND_Y: [[usize; 2]; 10] =
    [[0, 0], [1, 0], [3, 0], [4, 0], [1, 1], [3, 1], [4, 1], [3, 3], [4, 3], [4, 4]];
const OF_Z: [[usize; 2]; 3] = [[0, 0], [2, 0], [2, 2]];

impl WithSimd for Equations<'_> {
    type Output = System;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> System {
        let mut sums = Sums::default();
        let (blocks, rest) = self.points.as_chunks();
        for block in blocks {
            self.add(simd, block, AT_ONCE, &mut sums);
        }
        if let Some(last) = rest.last() {
            let mut block = [*last; AT_ONCE];
            block[..rest.len()].copy_from_slice(rest);
            self.add(simd, &block, rest.len(), &mut sums);
        }
        let mut system = System { normal: SMatrix::zeros(), right: SVector::zeros() };
        for ([row, column], sum) in OF_X_AND_Y.into_iter().zip(sums.x_and_y) {
            system.normal[(row, column)] += sum.iter().sum::<f64>();
        }
        for ([row, column], sum) in OF_Z.into_iter().zip(sums.z) {
            system.normal[(row, column)] += sum.iter().sum::<f64>();
        }
        for (row, sum) in sums.right.iter().enumerate() {
            system.right[row] = sum.iter().sum();
        }
        system
    }
}

/// Sums of the products of which normal equations consist, in the order of [`OF_X_AND_Y`] and [`OF_Z`], lane
/// by lane.
#[derive(Default)]
struct Sums {
    x_and_y: [[f64; AT_ONCE]; OF_X_AND_Y.len()],
    z: [[f64; AT_ONCE]; OF_Z.len()],
    right: [[f64; AT_ONCE]; 5],
}

impl Equations<'_> {
    /// Adds the equations of the first `count` of some points.
    #[inline(always)]
    fn add<S: Simd>(&self, simd: S, points: &[Point; AT_ONCE], count: usize, sums: &mut Sums) {
        let sites = self.formula.at(points);
        let largest = sites.largest_misses();
        let [x_by, y_by, z_by] = self.formula.slopes(&sites);
        // 0 where a coordinate does not count.
        let beyond = |axis: usize| -> [[f64; AT_ONCE]; 2] {
            let miss = &sites.miss[axis];
            let beyond: [f64; AT_ONCE] = lanes(|i| miss[i] - miss[i].max(-self.slack).min(self.slack));
            let counts: [bool; AT_ONCE] =
                lanes(|i| (i < count) & (largest[i] < self.reach) & (beyond[i] != 0.0));
            [lanes(|i| if counts[i] { 1.0 } else { 0.0 }), lanes(|i| if counts[i] { beyond[i] } else { 0.0 })]
        };
        let [[x, x_miss], [y, y_miss], [z, z_miss]] = [beyond(0), beyond(1), beyond(2)];
        for (sum, [row, column]) in sums.x_and_y.iter_mut().zip(OF_X_AND_Y) {
            let of_x = [&x, &x_by[row], &x_by[column]];
            add_products(simd, sum, [of_x, [&y, &y_by[row], &y_by[column]]]);
        }
        for (sum, [row, column]) in sums.z.iter_mut().zip(OF_Z) {
            add_products(simd, sum, [[&z, &z_by[row], &z_by[column]]]);
        }
        for (row, sum) in sums.right.iter_mut().enumerate() {
            add_products(simd, sum, [[&x_by[row], &x_miss], [&y_by[row], &y_miss], [&z_by[row], &z_miss]]);
        }
    }
}

/// Adds products to a sum, lane by lane. It names the vectors: left to choose them, LLVM gathers the elements
/// of several sums.
#[inline(always)]
fn add_products<S: Simd, const FACTORS: usize, const PRODUCTS: usize>(
    simd: S,
    sum: &mut [f64; AT_ONCE],
    products: [[&[f64; AT_ONCE]; FACTORS]; PRODUCTS],
) {
    const { assert!(AT_ONCE.is_multiple_of(S::F64_LANES)) };
    let (sums, _) = S::as_mut_simd_f64s(sum);
    for (part, sum) in sums.iter_mut().enumerate() {
        for factors in products {
            let factor = |number: usize| S::as_simd_f64s(factors[number]).0[part];
            let product = (1..FACTORS).fold(factor(0), |product, i| simd.mul_f64s(product, factor(i)));
            *sum = simd.add_f64s(*sum, product);
        }
    }
}

/// The formula with the constants (V, b, c, h, rot) of a beam.
struct FitFormula {
    sin_v: f64,
    cos_v: f64,
    b: f64,
    c: f64,
    h: f64,
    rot: f64,
}

/// The formula at the integers nearest to each of `N` points.
#[derive(Clone, Copy)]
struct Sites<const N: usize> {
    d: [f64; N],
    rho: [f64; N],
    sin: [f64; N],
    cos: [f64; N],
    /// The error of the formula for each point along each axis, in metres.
    miss: [[f64; N]; 3],
}

impl<const N: usize> Sites<N> {
    /// The largest absolute error over the axes, for each point.
    #[inline(always)]
    fn largest_misses(&self) -> [f64; N] {
        let [x, y, z] = &self.miss;
        lanes(|i| x[i].abs().max(y[i].abs()).max(z[i].abs()))
    }
}

impl FitFormula {
    fn new(&[v, b, c, h, rot]: &[f64; 5]) -> Self {
        FitFormula { sin_v: libm::sin(v), cos_v: libm::cos(v), b, c, h, rot }
    }

    #[inline(always)]
    fn at<const N: usize>(&self, points: &[Point; N]) -> Sites<N> {
        let x: [f64; N] = lanes(|i| points[i].position[0]);
        let y: [f64; N] = lanes(|i| points[i].position[1]);
        let z: [f64; N] = lanes(|i| points[i].position[2]);
        let (rho_in_file, azimuth): ([f64; N], [f64; N]) =
            (lanes(|i| points[i].rho), lanes(|i| points[i].azimuth));
        let d: [f64; N] = lanes(|i| {
            let metres = (rho_in_file[i] - self.b) * self.cos_v + (z[i] - self.c) * self.sin_v;
            round_ties_even(metres * (1.0 / RANGE_STEP)) * RANGE_STEP
        });
        let rho: [f64; N] = lanes(|i| d[i] * self.cos_v + self.b);
        let by_rho: [f64; N] = lanes(|i| 1.0 / rho_in_file[i]);
        // phi is less than a tick away from the point's azimuth, so the point is rotated there by a few terms
        // of the series.
        let turn: [f64; N] = lanes(|i| {
            let (side, side_in_file) = (small_atan(self.h / rho[i]), small_atan(self.h * by_rho[i]));
            let ticks = (azimuth[i] - side_in_file - self.rot) * (1.0 / TICK);
            (round_ties_even(ticks) - ticks) * TICK + (side - side_in_file)
        });
        let sin_turn: [f64; N] = lanes(|i| turn[i] * (1.0 - turn[i] * turn[i] / 6.0));
        let cos_turn: [f64; N] = lanes(|i| 1.0 - turn[i] * turn[i] / 2.0);
        let cos: [f64; N] = lanes(|i| (x[i] * cos_turn[i] - y[i] * sin_turn[i]) * by_rho[i]);
        let sin: [f64; N] = lanes(|i| (y[i] * cos_turn[i] + x[i] * sin_turn[i]) * by_rho[i]);
        let miss = [
            lanes(|i| x[i] - rho[i] * cos[i]),
            lanes(|i| y[i] - rho[i] * sin[i]),
            lanes(|i| z[i] - d[i] * self.sin_v - self.c),
        ];
        Sites { d, rho, sin, cos, miss }
    }

    /// For each point, the largest error of the formula over the axes, in metres.
    fn largest_misses(&self, points: &[Point]) -> Vec<f64> {
        dispatch(LargestMisses { formula: self, points })
    }

    /// The derivatives of the formula's x, y and z with respect to (V, b, c, h, rot).
    #[inline(always)]
    fn slopes<const N: usize>(&self, Sites { d, rho, sin, cos, .. }: &Sites<N>) -> [[[f64; N]; 5]; 3] {
        let phi_by_h: [f64; N] = lanes(|i| rho[i] / (rho[i] * rho[i] + self.h * self.h));
        let phi_by_rho: [f64; N] = lanes(|i| -self.h / (rho[i] * rho[i] + self.h * self.h));
        let rho_by_v: [f64; N] = lanes(|i| -d[i] * self.sin_v);
        let back: [f64; N] = lanes(|i| -sin[i]);
        // In a loop, because a closure that is called twice would not be compiled for the same vector unit.
        let mut by_axis = [[[0.0; N]; 5]; 3];
        for (by, (ahead, aside)) in by_axis.iter_mut().zip([(cos, &back), (sin, cos)]) {
            *by = [
                lanes(|i| ahead[i] * rho_by_v[i] + rho[i] * aside[i] * rho_by_v[i] * phi_by_rho[i]),
                lanes(|i| ahead[i] + rho[i] * aside[i] * phi_by_rho[i]),
                [0.0; N],
                lanes(|i| rho[i] * aside[i] * phi_by_h[i]),
                lanes(|i| rho[i] * aside[i]),
            ];
        }
        by_axis[2] = [lanes(|i| d[i] * self.cos_v), [0.0; N], [1.0; N], [0.0; N], [0.0; N]];
        by_axis
    }
}

/// The arguments of [`FitFormula::largest_misses`], for a function compiled for several vector units.
struct LargestMisses<'a> {
    formula: &'a FitFormula,
    points: &'a [Point],
}

impl NullaryFnOnce for LargestMisses<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn call(self) -> Vec<f64> {
        let mut misses = vec![0.0; self.points.len()];
        let (blocks, rest) = self.points.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = misses.as_chunks_mut::<AT_ONCE>();
        for (block, misses) in blocks.iter().zip(of_blocks) {
            *misses = self.formula.at(block).largest_misses();
        }
        for (point, miss) in rest.iter().zip(of_rest) {
            [*miss] = self.formula.at(std::array::from_ref(point)).largest_misses();
        }
        misses
    }
}

/// The share of some points whose error is within the reach of the corrections.
fn explained_share(constants: &[f64; 5], points: &[Point]) -> f64 {
    /// In metres.
    const REACH: f64 = 0.0016;
    let points: Vec<Point> = thinned(points, SAMPLE).copied().collect();
    let misses = FitFormula::new(constants).largest_misses(&points);
    misses.iter().filter(|miss| **miss < REACH).count() as f64 / misses.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    #[test]
    fn each_point_counts_once_and_alike_on_every_vector_unit() {
        let formula = FitFormula::new(&[-0.1, 0.02, -0.05, 0.026, 0.3]);
        let mut random = Rng::keyed(1, &[]);
        let mut metres = || f64::from(random.below(40_000) as u32) * 1e-3 - 20.0;
        let points: Vec<Point> = (0..2 * AT_ONCE + 3)
            .map(|_| {
                let position @ [x, y, _] = [metres(), metres(), metres()];
                Point { position, rho: libm::hypot(x, y), azimuth: libm::atan2(y, x).rem_euclid(TAU) }
            })
            .collect();
        let of = |points| System::of(&formula, points, f64::INFINITY, 0.0);
        let whole = of(&points);
        let plain = Equations { formula: &formula, points: &points, reach: f64::INFINITY, slack: 0.0 }
            .with_simd(pulp::Scalar::new());
        assert_eq!((whole.normal, whole.right), (plain.normal, plain.right));
        let mut single = System { normal: SMatrix::zeros(), right: SVector::zeros() };
        for point in &points {
            let System { normal, right } = of(std::slice::from_ref(point));
            single.normal += normal;
            single.right += right;
        }
        assert!((whole.normal - single.normal).amax() < 1e-12 * whole.normal.amax());
        assert!((whole.right - single.right).amax() < 1e-12 * whole.right.amax());
    }
}
