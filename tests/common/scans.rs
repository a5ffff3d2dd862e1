//! Scans for tests: simulated ones, also in the form in which other scanners or programs would store them.

use std::f64::consts::{PI, TAU};

use lidarpc::internals::scanner::hdl64::sine_and_cosine;
use lidarpc::internals::study::synth::{Beam, STEP, SynthConfig, TICKS, drive, scanner_beams};

const TICK_DEGREES: f64 = 0.09;

/// x, y, z and intensity.
pub type Points = Vec<[f32; 4]>;

/// A narrow, thinned drive: fast, but sufficient for a scanner to be fitted.
pub fn small(seed: u64, frames: usize) -> SynthConfig {
    SynthConfig { seed, frames, beams: 8, thinning: 10, ..SynthConfig::default() }
}

/// The frames of a simulated drive.
pub fn scans(config: &SynthConfig) -> Vec<Points> {
    drive(config).map(|frame| frame.points).collect()
}

/// The points with coordinates rounded to this number of decimal places, as most programs write them: some
/// zeros are negative.
pub fn rounded(points: &[[f32; 4]], places: i32) -> Points {
    let unit = 10f64.powi(places);
    let round = |metres: f32| ((f64::from(metres) * unit).round() / unit) as f32;
    points.iter().map(|&[x, y, z, intensity]| [round(x), round(y), round(z), intensity]).collect()
}

/// Azimuth in radians, 0 to 2 pi; a y of -0.0 was below the seam before it was rounded.
pub fn azimuth(point: &[f32; 4]) -> f64 {
    let azimuth = f64::from(point[1]).atan2(f64::from(point[0]));
    if azimuth.is_sign_negative() { azimuth + TAU } else { azimuth }
}

/// The rows of a scan: a new one begins where the azimuth falls back.
pub fn rows(points: &[[f32; 4]]) -> Vec<Points> {
    points.chunk_by(|a, b| azimuth(b) - azimuth(a) > -3.0).map(<[_]>::to_vec).collect()
}

/// The scan of [`scans`] as float32 coordinates that were never rounded to the millimetre: the integers of
/// each point are recovered and passed through the formula.
pub fn unrounded(config: &SynthConfig, points: &[[f32; 4]]) -> Points {
    from_integers(config, points, |beam, tick, d| {
        let (sin, cos) = beam.elevation.to_radians().sin_cos();
        let rho = d * cos + beam.range_offset;
        let phi = (tick as f64 * TICK_DEGREES + beam.turn).to_radians() + (beam.side / rho).atan();
        [(rho * phi.cos()) as f32, (rho * phi.sin()) as f32, (d * sin + beam.height) as f32]
    })
}

/// The same, computed in single precision like KITTI-360's program.
pub fn single_precision(config: &SynthConfig, points: &[[f32; 4]]) -> Points {
    from_integers(config, points, |beam, tick, d| {
        let (sin_v, cos_v) = beam.elevation.to_radians().sin_cos();
        let (sin, cos) = (sin_v as f32, cos_v as f32);
        let offset = beam.range_offset / cos_v;
        let distance = (d + offset) as f32;
        let aside = (beam.side / (f64::from(distance) * f64::from(cos))).atan().to_degrees();
        // The program counts ticks from another tick.
        let first = i64::from(beam.shift);
        let counted = (tick - first).rem_euclid(i64::from(TICKS));
        let added = beam.turn + first as f64 * TICK_DEGREES;
        let turned = (f64::from((counted as f64 * TICK_DEGREES) as f32) + added) as f32;
        let degrees = (f64::from(turned) + aside) as f32;
        let degrees = match degrees {
            below if below < 0.0 => below + 360.0,
            above if above >= 360.0 => above - 360.0,
            within => within,
        };
        let (sine, cosine) = sine_and_cosine((f64::from(degrees) * (PI / 180.0)) as f32);
        let z = (f64::from(distance * sin) + (beam.height - offset * sin_v)) as f32;
        [distance * (cos * cosine), distance * (cos * sine), z]
    })
}

/// Recovers beam, tick and range of each point, and passes them through a formula.
fn from_integers(
    config: &SynthConfig,
    points: &[[f32; 4]],
    formula: impl Fn(&Beam, i64, f64) -> [f32; 3],
) -> Points {
    let beams = scanner_beams(config);
    let rows = rows(points);
    assert_eq!(rows.len(), beams.len(), "each beam has a row");
    let again = |beam: &Beam, point: &[f32; 4]| {
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(point[axis]));
        let (sin, cos) = beam.elevation.to_radians().sin_cos();
        let distance = (x.hypot(y) - beam.range_offset) * cos + (z - beam.height) * sin;
        let turned = (azimuth(point) - (beam.side / x.hypot(y)).atan()).to_degrees() - beam.turn;
        let [x, y, z] =
            formula(beam, (turned / TICK_DEGREES).round() as i64, (distance / STEP).round() * STEP);
        [x, y, z, point[3]]
    };
    let of_row = |(beam, row): (&Beam, Points)| row.iter().map(|p| again(beam, p)).collect::<Points>();
    beams.iter().zip(rows).flat_map(of_row).collect()
}

/// The scan from another position, as stored by programs that compensate for motion: float32 values off any
/// grid.
pub fn moved(points: &[[f32; 4]]) -> Points {
    let (sin, cos) = 0.01f64.sin_cos();
    let turn = |&[x, y, z, i]: &[f32; 4]| {
        let (x, y) = (f64::from(x), f64::from(y));
        [(x * cos - y * sin + 0.0137) as f32, (x * sin + y * cos - 0.0071) as f32, z, i]
    };
    points.iter().map(turn).collect()
}

/// The scan as stored by programs that compensate for the motion within the turn: each point is moved by a
/// part of the motion that corresponds to its azimuth, from -pi to pi, as a part of the turn.
pub fn compensated(points: &[[f32; 4]], rotation: [f64; 3], translation: [f64; 3]) -> Points {
    let moved = |&[x, y, z, intensity]: &[f32; 4]| {
        let point = [x, y, z].map(f64::from);
        let part = point[1].atan2(point[0]) / TAU;
        // The exponential of the cross product with the rotation, as a series.
        let [rx, ry, rz] = rotation.map(|r| r * part);
        let (mut term, mut sum) = (point, point);
        for n in 1..12 {
            let [x, y, z] = term;
            term = [ry * z - rz * y, rz * x - rx * z, rx * y - ry * x].map(|v| v / f64::from(n));
            sum = [0, 1, 2].map(|axis| sum[axis] + term[axis]);
        }
        let [x, y, z] = [0, 1, 2].map(|axis| (sum[axis] + part * translation[axis]) as f32);
        [x, y, z, intensity]
    };
    points.iter().map(moved).collect()
}

/// A permutation of the points.
pub fn shuffled(points: &[[f32; 4]], seed: u64) -> Points {
    let mut points = points.to_vec();
    let mut random = Random(seed);
    for i in (1..points.len()).rev() {
        points.swap(i, random.below(i as u64 + 1) as usize);
    }
    points
}

/// Points anywhere, on the grid of the files.
pub fn random_points(count: usize, seed: u64) -> Points {
    let mut random = Random(seed);
    let mut metres = |reach: u64| ((random.below(2 * reach) as f64 - reach as f64) / 1000.0) as f32;
    (0..count).map(|_| [metres(60_000), metres(60_000), metres(3000), 0.25]).collect()
}

/// A small generator of numbers for tests (SplitMix64).
pub struct Random(pub u64);

impl Random {
    /// Any number.
    pub fn number(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// A number below `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.number() % end
    }
}
