//! Fits the sensor model to the sequence itself, with no prior knowledge of the scanner but its
//! grids: 0.09 degree azimuth ticks and 2 mm range steps (Velodyne HDL-64E).
//!
//! The steps for each beam: (1) z against rho, a robust line, gives elevation and height; (2) the
//! sideways offset is the one that makes the azimuth ticks most coherent; (3) the phase of the
//! range on its grid gives the range offset; (4) all five constants by least squares on x, y, z.

use std::f64::consts::TAU;

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use super::{BeamConstants, Coordinates, SensorModel};
use crate::scan::{PointCloud, ScanFile};

/// Azimuth ticks a turn of the scanners that the fit knows.
const TICKS: u32 = 4000;
/// Their range step in micrometres.
const RANGE_STEP_UM: u32 = 2000;
const RANGE_STEP: f64 = RANGE_STEP_UM as f64 * 1e-6;
const TICK: f64 = TAU / TICKS as f64;
/// Fewer points than this do not determine a beam.
const FEWEST_POINTS: usize = 100;
/// Points of a beam used where a sample is enough.
const SAMPLE: usize = 1500;
/// A model that puts fewer of the points than this within reach of its corrections is dropped.
const LEAST_SHARE: f64 = 0.5;

/// Fits a model to a sample of the sequence's scans. None if the points are not those of such a
/// scanner, stored beam by beam.
pub fn fit(sample: &[ScanFile]) -> Option<SensorModel> {
    let (coordinates, scans) = alike(sample)?;
    let rows = scans.first()?.len();
    let constants: Vec<_> = (0..rows)
        .into_par_iter()
        .map(|row| {
            let points: Vec<_> = scans.iter().flat_map(|beams| beams[row].iter().copied()).collect();
            fit_beam(&points, coordinates)
        })
        .collect();
    let constants = fill_gaps(constants)?;
    let constants = constants.into_iter().map(BeamConstants::quantise).collect();
    let mut model = SensorModel::new(coordinates, TICKS, RANGE_STEP_UM, constants);
    let shifts = column_shifts(&model, &scans);
    model.set_column_shifts(&shifts);
    (explained_share(&model, &scans) >= LEAST_SHARE).then_some(model)
}

/// The points of one beam in one scan, in metres.
type BeamPoints = Vec<[f64; 3]>;

/// Splits the scans into beams where the azimuth wraps around, and keeps the largest set of scans
/// that have the same grid of coordinates and number of beams: whichever are odd are left out.
fn alike(sample: &[ScanFile]) -> Option<(Coordinates, Vec<Vec<BeamPoints>>)> {
    let kinds = sample.iter().map(|scan| &scan.cloud).filter_map(|cloud| {
        let beams = split_beams(cloud);
        let grid = Coordinates::of(cloud.positions.iter().step_by(7).flatten());
        (beams.len() > 1).then_some(((grid, beams.len()), beams))
    });
    let scans: Vec<_> = kinds.collect();
    let frequency = |kind: (Coordinates, usize)| scans.iter().filter(|(other, _)| *other == kind).count();
    let kind = scans.iter().map(|(kind, _)| *kind).max_by_key(|&kind| (frequency(kind), kind.1))?;
    Some((kind.0, scans.into_iter().filter(|(other, _)| *other == kind).map(|(_, beams)| beams).collect()))
}

/// Splits one scan; a short step back over the seam is not a new beam.
fn split_beams(cloud: &PointCloud) -> Vec<BeamPoints> {
    /// More beams than any scanner has: the points are in some other order.
    const MOST_BEAMS: usize = 256;
    let mut beams = vec![BeamPoints::new()];
    let mut row = 0usize;
    let mut last = None;
    for position in &cloud.positions {
        let point = position.map(f64::from);
        if !point.iter().all(|v| v.is_finite()) || (point[0] == 0.0 && point[1] == 0.0) {
            continue;
        }
        let azimuth = point[1].atan2(point[0]).rem_euclid(TAU);
        let step = azimuth - last.replace(azimuth).unwrap_or(azimuth);
        if step < -5.0 {
            row += 1;
        } else if step > 5.0 {
            row = row.saturating_sub(1);
        }
        if row >= MOST_BEAMS {
            return Vec::new();
        }
        if row == beams.len() {
            beams.push(BeamPoints::new());
        }
        beams[row].push(point);
    }
    beams
}

/// Beams with too few points get the constants of their neighbours, evenly between; they only
/// have to be plausible.
fn fill_gaps(constants: Vec<Option<[f64; 5]>>) -> Option<Vec<[f64; 5]>> {
    let known: Vec<usize> = (0..constants.len()).filter(|&row| constants[row].is_some()).collect();
    if known.len() * 2 < constants.len() || known.is_empty() {
        return None;
    }
    let at = |row: usize| constants[row].unwrap_or_default();
    let between = |row: usize| {
        let above = known.iter().copied().filter(|&k| k <= row).next_back();
        let below = known.iter().copied().find(|&k| k >= row);
        match (above, below) {
            (Some(a), Some(b)) if a < b => {
                let share = (row - a) as f64 / (b - a) as f64;
                std::array::from_fn(|i| at(a)[i] + share * (at(b)[i] - at(a)[i]))
            }
            (Some(a), _) => at(a),
            (None, Some(b)) => at(b),
            (None, None) => at(row),
        }
    };
    Some((0..constants.len()).map(between).collect())
}

/// (V, b, c, h, rot) of one beam, in radians and metres.
fn fit_beam(points: &[[f64; 3]], coordinates: Coordinates) -> Option<[f64; 5]> {
    if points.len() < FEWEST_POINTS {
        return None;
    }
    let polar: Vec<Polar> = points.iter().map(|&p| Polar::of(p)).collect();
    let (height, slope) = height_line(&polar);
    let elevation = slope.atan();
    let far = far_sample(&polar);
    let (side, rot) = side_offset(&far);
    let offset = range_phase(&polar, elevation);
    let start = [elevation, offset, height + slope * offset, side, rot];
    Some(refine(start, points, &polar, coordinates))
}

/// A point seen from the axis: horizontal distance, azimuth, height.
#[derive(Clone, Copy)]
struct Polar {
    rho: f64,
    azimuth: f64,
    z: f64,
}

impl Polar {
    fn of([x, y, z]: [f64; 3]) -> Self {
        Polar { rho: x.hypot(y), azimuth: y.atan2(x), z }
    }
}

/// Step 1: z = height + slope * rho, by least squares with weights that fall with the miss.
fn height_line(polar: &[Polar]) -> (f64, f64) {
    let (mut height, mut slope) = (0.0, 0.0);
    for round in 0..15 {
        let [mut n, mut r, mut rr, mut z, mut rz] = [0.0; 5];
        for p in polar {
            let miss = (p.z - height - slope * p.rho).abs();
            let weight = match round {
                0 => 1.0,
                _ if miss > 0.02 && round > 2 => 0.0,
                _ => 1.0 / miss.max(3e-4),
            };
            n += weight;
            r += weight * p.rho;
            rr += weight * p.rho * p.rho;
            z += weight * p.z;
            rz += weight * p.rho * p.z;
        }
        let determinant = n * rr - r * r;
        if determinant.abs() < 1e-12 {
            break;
        }
        slope = (n * rz - r * z) / determinant;
        height = (z - slope * r) / n;
    }
    (height, slope)
}

/// Points far enough for their azimuth to be sharp, thinned.
fn far_sample(polar: &[Polar]) -> Vec<Polar> {
    for least in [5.0, 3.2, 0.0] {
        let far: Vec<_> = polar.iter().copied().filter(|p| p.rho > least).collect();
        if far.len() >= 500 || least == 0.0 {
            return far.iter().step_by(far.len().div_ceil(SAMPLE).max(1)).copied().collect();
        }
    }
    Vec::new()
}

/// Strength and phase (radians) of a set of values on a grid of `period`.
fn coherence(values: impl Iterator<Item = f64>, period: f64) -> (f64, f64) {
    let (mut re, mut im) = (0.0, 0.0);
    for value in values {
        let (sin, cos) = (value / period * TAU).sin_cos();
        re += cos;
        im += sin;
    }
    (re.hypot(im), im.atan2(re))
}

/// Step 2: the sideways offset h that makes the azimuths fall on the ticks, and the phase rot.
fn side_offset(far: &[Polar]) -> (f64, f64) {
    let at = |h: f64| coherence(far.iter().map(|p| p.azimuth - (h / p.rho).atan()), TICK);
    let best = (-60..=60).map(|mm| f64::from(mm) * 1e-3).max_by(|&a, &b| at(a).0.total_cmp(&at(b).0));
    let h = best.unwrap_or(0.0);
    (h, at(h).1 / TAU * TICK)
}

/// Step 3: the phase of the range on its grid, as the offset b in metres.
fn range_phase(polar: &[Polar], elevation: f64) -> f64 {
    let mut ranges: Vec<f64> = polar.iter().map(|p| p.rho / elevation.cos()).collect();
    ranges.sort_by(f64::total_cmp);
    let middle = &ranges[ranges.len() / 20..ranges.len() * 17 / 20];
    coherence(middle.iter().copied(), RANGE_STEP).1 / TAU * RANGE_STEP * elevation.cos()
}

/// Step 4: Gauss-Newton on the misses of x, y and z, the integers held; repeated, as the integers
/// change with the constants.
fn refine(start: [f64; 5], points: &[[f64; 3]], polar: &[Polar], coordinates: Coordinates) -> [f64; 5] {
    let mut constants = start;
    let thin = points.len().div_ceil(4 * SAMPLE);
    let least_squares = |constants: &[f64; 5], thin: usize, reach: f64| {
        let mut system = System::default();
        for (point, p) in points.iter().zip(polar).step_by(thin) {
            let miss = misses(constants, point, p);
            if miss.iter().all(|m| m.abs() < reach) {
                system.add(miss, slopes(constants, point, p));
            }
        }
        system
    };
    for reach in [0.004, 0.004, 0.0015, 0.0015, 0.0015, 0.0015] {
        least_squares(&constants, thin, reach).step(&mut constants);
    }
    let whole = least_squares(&constants, 1, 0.0015);
    whole.step(&mut constants);
    if coordinates == Coordinates::Millimetre {
        centre_in_roundings(&mut constants, points, polar, &whole);
    }
    constants
}

/// A coordinate rounded to the millimetre misses by up to half of one however right the constants
/// are: only what misses by more says that they are wrong. Moves the constants until little does,
/// which makes them far sharper than least squares can.
fn centre_in_roundings(constants: &mut [f64; 5], points: &[[f64; 3]], polar: &[Polar], whole: &System) {
    const ROUNDS: usize = 16;
    /// Metres.
    const HALF_UNIT: f64 = 5e-4;
    const REACH: f64 = 0.0015;
    /// How much the points that fit hold the constants in place.
    const INERTIA: f64 = 0.003;
    for _ in 0..ROUNDS {
        let mut system = System { normal: whole.normal * INERTIA, ..System::default() };
        for (point, p) in points.iter().zip(polar) {
            let miss = misses(constants, point, p);
            let largest = miss.iter().fold(0.0f64, |largest, m| largest.max(m.abs()));
            if largest > HALF_UNIT && largest < REACH {
                let beyond = miss.map(|m| m - m.clamp(-HALF_UNIT, HALF_UNIT));
                system.add(beyond, slopes(constants, point, p));
            }
        }
        system.step(constants);
    }
}

/// The normal equations of a least-squares problem in the five constants.
#[derive(Default)]
struct System {
    normal: SMatrix<f64, 5, 5>,
    right: SVector<f64, 5>,
}

impl System {
    fn add(&mut self, miss: [f64; 3], slopes: [[f64; 5]; 3]) {
        for (m, slope) in miss.into_iter().zip(slopes) {
            if m != 0.0 {
                let slope = SVector::from(slope);
                self.normal += slope * slope.transpose();
                self.right += slope * m;
            }
        }
    }

    /// Moves the constants to the solution; where there is none they stay.
    fn step(&self, constants: &mut [f64; 5]) {
        if let Some(cholesky) = self.normal.cholesky() {
            let step = cholesky.solve(&self.right);
            constants.iter_mut().zip(step.iter()).for_each(|(constant, s)| *constant += s);
        }
    }
}

/// The formula's d, rho and phi at the integers nearest to a point.
fn at_integers(&[v, b, c, h, rot]: &[f64; 5], z: f64, p: &Polar) -> [f64; 3] {
    let (sin_v, cos_v) = (libm::sin(v), libm::cos(v));
    let d = (((p.rho - b) * cos_v + (z - c) * sin_v) / RANGE_STEP).round() * RANGE_STEP;
    let tick = ((p.azimuth - (h / p.rho).atan() - rot) / TICK).round() * TICK;
    let rho = d * cos_v + b;
    [d, rho, tick + rot + (h / rho).atan()]
}

/// How far the formula misses a point, in metres.
fn misses(constants: &[f64; 5], &[x, y, z]: &[f64; 3], p: &Polar) -> [f64; 3] {
    let [d, rho, phi] = at_integers(constants, z, p);
    let (sin, cos) = phi.sin_cos();
    [x - rho * cos, y - rho * sin, z - d * constants[0].sin() - constants[2]]
}

/// The slopes of the formula's x, y and z against (V, b, c, h, rot).
fn slopes(constants: &[f64; 5], &[_, _, z]: &[f64; 3], p: &Polar) -> [[f64; 5]; 3] {
    let [d, rho, phi] = at_integers(constants, z, p);
    let [v, _, _, h, _] = *constants;
    let (sin_v, cos_v) = v.sin_cos();
    let (sin, cos) = phi.sin_cos();
    let square = rho * rho + h * h;
    let rho_by = [-d * sin_v, 1.0, 0.0, 0.0, 0.0];
    let phi_by_rho = -h / square;
    let phi_by = [rho_by[0] * phi_by_rho, phi_by_rho, 0.0, rho / square, 1.0];
    let x_by = std::array::from_fn(|i| cos * rho_by[i] - rho * sin * phi_by[i]);
    let y_by = std::array::from_fn(|i| sin * rho_by[i] + rho * cos * phi_by[i]);
    let z_by = [d * cos_v, 0.0, 1.0, 0.0, 0.0];
    [x_by, y_by, z_by]
}

/// The whole number of ticks by which each beam's columns are moved against those of the fullest
/// beam: where their occupancies agree most.
fn column_shifts(model: &SensorModel, scans: &[Vec<BeamPoints>]) -> Vec<i64> {
    /// The beams of one firing look within 36 degrees of each other.
    const WIDEST: i64 = TICKS as i64 / 10;
    /// Scans used.
    const SCANS: usize = 3;
    let rows = model.rows();
    let used: Vec<Vec<Vec<u8>>> = scans
        .iter()
        .take(SCANS)
        .map(|beams| (0..rows).map(|row| used_ticks(model, row, &beams[row])).collect())
        .collect();
    let filled = |row: usize| used.iter().map(|scan| agreement(&scan[row], &scan[row])).sum::<u32>();
    let reference = (0..rows).max_by_key(|&row| filled(row)).unwrap_or(0);
    let agreement_at = |row: usize, shift: i64| {
        let start = shift.rem_euclid(i64::from(TICKS)) as usize;
        let overlap = |scan: &Vec<Vec<u8>>| {
            let (mine, theirs) = (&scan[row], &scan[reference]);
            let (head, tail) = mine.split_at(mine.len() - start);
            agreement(head, &theirs[start..]) + agreement(tail, &theirs[..start])
        };
        used.iter().map(overlap).sum::<u32>()
    };
    let best = |row| (-WIDEST..=WIDEST).max_by_key(|&shift| (agreement_at(row, shift), -shift.abs()));
    (0..rows).into_par_iter().map(|row| best(row).unwrap_or(0)).collect()
}

/// How many ticks both have in use.
fn agreement(a: &[u8], b: &[u8]) -> u32 {
    // Sums of bytes, in runs short enough not to overflow one, are what vector units do best.
    let run = |(a, b): (&[u8], &[u8])| u32::from(a.iter().zip(b).map(|(a, b)| a & b).sum::<u8>());
    a.chunks(255).zip(b.chunks(255)).map(run).sum()
}

/// 1 for each tick that holds a point of beam `row`, else 0.
fn used_ticks(model: &SensorModel, row: usize, points: &[[f64; 3]]) -> Vec<u8> {
    let mut used = vec![0; TICKS as usize];
    for (tick, _) in points.iter().filter_map(|&p| model.invert(row, p)) {
        used[tick as usize] = 1;
    }
    used
}

/// Share of the points that the formula gives to within what its corrections reach.
fn explained_share(model: &SensorModel, scans: &[Vec<BeamPoints>]) -> f64 {
    /// Metres.
    const REACH: f64 = 0.0016;
    let mut explained = 0usize;
    let mut total = 0usize;
    for (row, point) in scans
        .iter()
        .flat_map(|beams| beams.iter().enumerate())
        .flat_map(|(row, points)| points.iter().step_by(5).map(move |point| (row, *point)))
    {
        total += 1;
        let Some((tick, steps)) = model.invert(row, point) else { continue };
        let formula = model.point(row, tick, steps);
        explained += usize::from(formula.iter().zip(point).all(|(f, p)| (f - p).abs() < REACH));
    }
    explained as f64 / total.max(1) as f64
}
