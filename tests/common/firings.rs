//! Made-up scanners of the `firings` family, and scans by them in a room with random walls.

use std::f64::consts::TAU;

use lidarpc::internals::scan::sorted::file_order;
use lidarpc::internals::scan::{Channel, Field, ScalarType};
use lidarpc::internals::scanner::firings::{Build, Firings, Laser, Origin, Recipe, Timing};
use lidarpc::internals::scanner::{CoordinateGrid, Echo, RangeImage, Return};

use super::scans::Points;

/// A scanner of 32 lasers that fire out of order and have azimuth offsets to either side, with constants as
/// in the files of the recipe's manufacturer.
pub fn made_up(recipe: Recipe) -> Firings {
    let (ticks, range_step_um) = match recipe {
        Recipe::SingleRangeXAhead => (2048, 1000),
        recipe if recipe.measures_from_axis() => (1024, 1000),
        recipe if is_robosense(recipe) => (36_000, 2500),
        Recipe::DoubleYAhead => (36_000, 2000),
        _ => (36_000, 4000),
    };
    let degrees = |thousandths: i64| thousandths * 1_000_000;
    let laser = |row: i64| match recipe {
        recipe if is_robosense(recipe) => Laser {
            elevation: degrees(15_000 - 1_230 * row),
            azimuth: degrees([2_270, -7_900, 2_320, -7_850][row as usize % 4]),
        },
        Recipe::LsLidar => Laser { elevation: degrees(15_000 - 1_000 * row), azimuth: degrees(20_250) },
        _ => Laser {
            elevation: degrees(15_000 - 1_237 * row + row % 3),
            azimuth: degrees([1_400, -4_200, 4_200, -1_400][row as usize % 4]),
        },
    };
    let origin = match recipe {
        recipe if is_robosense(recipe) => Origin { along_um: 34_980, up_um: 0 },
        Recipe::LsLidar => Origin { along_um: 36_100, up_um: 0 },
        Recipe::Ouster | Recipe::OusterRos => Origin { along_um: 15_806, up_um: 38_195 },
        Recipe::OusterEarly => Origin { along_um: -12_163, up_um: 36_180 },
        Recipe::VelodyneDecoder => Origin { along_um: 42_400, up_um: 0 },
        Recipe::VelodyneDecoderHdl32e => Origin { along_um: 28_956, up_um: 0 },
        _ => Origin::default(),
    };
    let coordinates = CoordinateGrid::Float32;
    let build =
        Build { recipe, ticks, range_step_um, coordinates, origin, timing: Timing::Together, mounting: None };
    Firings::new(build, (0..32).map(laser).collect(), (0..32).map(|slot| slot * 5 % 32).collect())
}

/// Whether it is a version of RoboSense's driver with a table of hundredths of degrees.
fn is_robosense(recipe: Recipe) -> bool {
    matches!(
        recipe,
        Recipe::RoboSense | Recipe::RoboSenseEarly | Recipe::RoboSenseFused | Recipe::RoboSenseEarlyFused
    )
}

/// A generator of pseudo-random numbers, each below the given end.
fn numbers(mut state: u64) -> impl FnMut(u64) -> u64 {
    move |end| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % end
    }
}

/// A turn of a scanner of the `firings` family, with every `thinning`-th firing; one cell in ten has no
/// return, which is a record in an Ouster's files.
pub fn image(scanner: &Firings, thinning: u32) -> RangeImage {
    let Build { recipe, ticks, range_step_um, ref timing, .. } = *scanner.build();
    let mut below = numbers(7 + recipe as u64);
    let step = (ticks / 1800).max(1) * thinning;
    let (mut columns, mut spans, mut tick) = (Vec::new(), Vec::new(), ticks / 3);
    for _ in 0..ticks / step {
        columns.push(tick % ticks);
        let next = if step > 1 { step - 1 + below(3) as u32 } else { 1 };
        spans.push(next << 1);
        tick += next;
    }
    let mut image = RangeImage::new(32, columns);
    image.is_full = recipe.measures_from_axis();
    if timing.is_interpolated() {
        image.spans = spans;
    }
    for (place, steps) in image.steps.cells_mut().iter_mut().enumerate() {
        let metres = 5.0 + (place % 1009) as f64 * 0.02 + below(1000) as f64 * 1e-4;
        *steps = if below(10) == 0 { 0 } else { (metres * 1e6 / f64::from(range_step_um)) as u32 };
    }
    image
}

/// The image with second returns in some cells.
pub fn with_echoes(mut image: RangeImage) -> RangeImage {
    let mut below = numbers(3);
    let cells = (0u32..).zip(image.steps.cells()).filter(|(_, steps)| **steps > 0);
    let mut echoes = Vec::new();
    for (cell, steps) in cells.filter(|(cell, _)| cell % 7 < 3) {
        let steps = if below(3) == 0 { *steps } else { steps + 100 + below(400) as u32 };
        echoes.push(Echo { cell, steps });
    }
    image.echoes = echoes;
    image
}

/// The points of an image in the order of a file; blanks are zeros.
pub fn points(scanner: &Firings, image: &RangeImage) -> Points {
    let point = |found: Return| {
        let [x, y, z] = match found.steps {
            0 => [0.0; 3],
            _ => scanner.position(&found, 0.0).map(|metres| metres as f32),
        };
        [x, y, z, (found.steps % 100) as f32]
    };
    scanner.file_order(image).into_iter().map(point).collect()
}

/// Points with their rows and the time stamps of their packets, of `firings` firings each, at 111
/// microseconds per firing.
pub fn stamped(scanner: &Firings, image: &RangeImage, firings: u32) -> (Points, Vec<u16>, Vec<f64>) {
    let of =
        |found: Return| (found.row as u16, 1.635e9 + f64::from(found.column / firings * firings) * 111e-6);
    let (rows, times) = scanner.file_order(image).into_iter().map(of).unzip();
    (points(scanner, image), rows, times)
}

/// Moves points by a fraction of a motion: each by the fraction between its time stamp and the last one. The
/// rotation is computed with a quaternion.
pub fn moved_by_stamps(points: &Points, times: &[f64], rotation: [f64; 3], translation: [f64; 3]) -> Points {
    let ends = times.iter().fold([f64::MAX, f64::MIN], |[a, b], time| [a.min(*time), b.max(*time)]);
    let angle = rotation.iter().map(|r| r * r).sum::<f64>().sqrt();
    let moved = |(&[x, y, z, i], time): (&[f32; 4], &f64)| {
        let part = (ends[1] - time) / (ends[1] - ends[0]);
        let (sin, w) = (0.5 * part * angle).sin_cos();
        let q = rotation.map(|r| if angle > 0.0 { r / angle * sin } else { 0.0 });
        let v = [x, y, z].map(f64::from);
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let once = cross(q, v).map(|v| 2.0 * v);
        let twice = cross(q, once);
        let [x, y, z] = [0, 1, 2].map(|k| (v[k] + w * once[k] + twice[k] + part * translation[k]) as f32);
        [x, y, z, i]
    };
    points.iter().zip(times).map(moved).collect()
}

/// The records as left by a program that sorts them by time although they are already in that order.
pub fn sorted<T: Copy>(records: &[T], times: &[f64]) -> Vec<T> {
    let bytes = times.iter().flat_map(|time| time.to_le_bytes()).collect();
    let keys = Channel { field: Field::new("timestamp", ScalarType::F64), bytes };
    file_order(&keys).into_iter().map(|record| records[record as usize]).collect()
}

/// The same scanner with lasers that fire one after another, 1.57 of 55.56 microseconds apart, followed by a
/// pause.
pub fn timed(scanner: &Firings) -> Firings {
    let part = |slot: i32| (f64::from(slot) * 1.57 / 55.56 * f64::from(1 << 24)) as u32;
    let build = Build { timing: Timing::Parts((0..32).map(part).collect()), ..scanner.build().clone() };
    Firings::new(build, scanner.lasers().to_vec(), (0..32).collect())
}

/// A scan of a VLP-32C as computed by Autoware's nebula from packets of twelve blocks, but with tables of
/// cosine and sine that are rounded once. A laser's azimuth offset, 1.4 or 4.2 degrees to either side, is
/// subtracted in hundredths of a degree before the lookup; the rotation until it fires is added, and is 0 in
/// the last block of a packet.
pub fn vlp_32c(packets: usize) -> Points {
    const BLOCKS: usize = 12;
    let mut below = numbers(11);
    let lasers: Vec<(f32, i32)> = (0..32)
        .map(|laser| {
            let degrees = 15.0 - 1.25 * f64::from(laser * 7 % 32) - 0.003 * f64::from(laser % 3);
            (degrees.to_radians() as f32, [140, -420, -140, 420][laser as usize * 5 % 7 % 4])
        })
        .collect();
    let mut points = Vec::new();
    let mut azimuth = 1234u32;
    for _ in 0..packets {
        let blocks: Vec<u32> = (0..BLOCKS)
            .map(|_| {
                azimuth += 19 + below(3) as u32;
                azimuth
            })
            .collect();
        for (block, &azimuth) in blocks.iter().enumerate() {
            let next = blocks.get(block + 1);
            let passing = next.map_or(0.0, |next| (next - azimuth) as f32);
            for (laser, &(elevation, aside)) in lasers.iter().enumerate() {
                let raw = 900 + 5 * laser as u32 + below(40) as u32;
                if below(8) == 0 {
                    continue;
                }
                let passed = passing * 2.304 / 55.296 * laser as f32;
                let tick = (azimuth as f32 + passed - aside as f32).round().rem_euclid(36_000.0);
                let angle = f64::from((f64::from(0.01f32 * tick) * std::f64::consts::PI / 180.0) as f32);
                let distance = raw as f32 * 0.004f32;
                let flat = distance * f64::from(elevation).cos() as f32;
                let (sin, cos) = (angle.sin() as f32, angle.cos() as f32);
                let high = distance * f64::from(elevation).sin() as f32;
                points.push([flat * cos, -(flat * sin), high, (raw % 97) as f32]);
            }
        }
    }
    points
}

/// A scan of a VLP-16 as computed by the package velodyne-decoder from packets of twelve blocks, but with
/// tables of cosine and sine that are rounded once. The azimuth advances at the packet's average rate; the
/// height of each laser is that of its beam, which passes through a point 41.91 mm in front of the axis.
pub fn velodyne_decoder_vlp_16(packets: usize) -> Points {
    const BLOCKS: usize = 12;
    const DEGREES: [i32; 16] = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];
    let mut below = numbers(13);
    let time = |block: usize, laser: usize| {
        (55.296e-6 * (2 * block + laser / 16) as f64 + 2.304e-6 * (laser % 16) as f64) as f32
    };
    let mut points = Vec::new();
    let mut azimuth = 4321u32;
    for _ in 0..packets {
        let blocks: [u32; BLOCKS] = std::array::from_fn(|_| {
            azimuth += 39 + below(3) as u32;
            azimuth
        });
        let rate = (blocks[BLOCKS - 1] - blocks[0]) as f32 / (time(BLOCKS - 1, 0) - time(0, 0));
        for (block, &azimuth) in blocks.iter().enumerate() {
            for laser in 0..32 {
                let raw = 1500 + 9 * (laser % 16) as u32 + below(60) as u32;
                if below(8) == 0 {
                    continue;
                }
                let tick = (azimuth as f32 + rate * (time(block, laser) - time(block, 0)))
                    .round()
                    .rem_euclid(36_000.0);
                let turn = f64::from(0.01f32 * tick * (std::f64::consts::PI / 180.0) as f32);
                let elevation = f64::from(f64::from(DEGREES[laser % 16]).to_radians() as f32);
                let distance = raw as f32 * 0.002f32;
                let flat = distance * elevation.cos() as f32;
                let high = distance * elevation.sin() as f32 + 0.04191f32 * (-elevation).tan() as f32;
                points.push([flat * turn.cos() as f32, -flat * turn.sin() as f32, high, (raw % 97) as f32]);
            }
        }
    }
    points
}

/// The same image with half of the lasers only in every other firing, and the other half in the firings
/// between, as Hesai's 128-channel scanners fire.
pub fn taking_turns(mut image: RangeImage) -> RangeImage {
    for row in image.steps.rows() / 2..image.steps.rows() {
        let cells = image.steps.row_mut(row).iter_mut().enumerate();
        cells.filter(|(column, _)| (column + row / 3) % 2 == 0).for_each(|(_, steps)| *steps = 0);
    }
    image
}

/// The range in millimetres that an Ouster measures in a room that becomes longer from a corner on, by row
/// and column.
fn ouster_range(row: usize, measured: usize) -> Option<u32> {
    let millimetres = 2000 + 37 * (measured % 97) + row * row + measured * 7 % 13;
    (!(measured * 31 + row * 17).is_multiple_of(9)).then_some(millimetres as u32)
}

/// The same scan with the fields that Ouster's ROS driver writes: a signal of twelve bits as the intensity, a
/// time, a reflectivity, a ring, ambient light, and the range in millimetres.
pub fn ouster_fields(rows: usize) -> Vec<u8> {
    let width = 512;
    let fields =
        ("x y z intensity t reflectivity ring ambient range", "4 4 4 4 4 2 2 2 4", "F F F F U U U U U");
    super::formats::pcd(fields.0, fields.1, fields.2, &ouster(rows, OusterDriver::Sdk), |record, point| {
        let (row, column) = (record / width, record % width);
        let range = ouster_range(row, (column + width - OUSTER_SHIFTS[row % 4]) % width).unwrap_or(0);
        let [x, y, z, _] = point;
        let signal = range * 7 % 3001;
        let mut bytes = [x, y, z, signal as f32].map(f32::to_le_bytes).concat();
        bytes.extend((column as u32 * 195_312 + 5).to_le_bytes());
        bytes.extend((range as u16 / 40 % 50).to_le_bytes());
        bytes.extend([row as u16, 16 * (record * record % 1013) as u16].map(u16::to_le_bytes).as_flattened());
        bytes.extend(range.to_le_bytes());
        bytes
    })
}

/// By how many columns each row of an Ouster is shifted.
const OUSTER_SHIFTS: [usize; 4] = [24, 8, 504, 488];

/// A program that computes an Ouster's points in the frame of its case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OusterDriver {
    /// In double precision.
    Sdk,
    /// In single precision.
    Ros,
    /// In double precision; it turns directions to that frame, but not where beams start.
    Early,
}

/// A scan of an Ouster in a room: an image row by row, each row shifted by its own number of columns, and
/// zeros where there is no return.
pub fn ouster(rows: usize, driver: OusterDriver) -> Points {
    let width = 512;
    let shift = |row: usize| OUSTER_SHIFTS[row % 4];
    let mut points = vec![[0.0; 4]; rows * width];
    for (row, column) in (0..rows).flat_map(|row| (0..width).map(move |column| (row, column))) {
        let measured = (column + width - shift(row)) % width;
        let altitude = (21.17 - 44.16 / rows as f64 * row as f64 + 0.01 * (row % 3) as f64).to_radians();
        let offsets: [f64; 4] = [-8.48, -2.83, 2.81, 8.5];
        let azimuth = -offsets[row % 4].to_radians();
        let encoder = TAU - measured as f64 * (TAU / width as f64);
        let Some(millimetres) = ouster_range(row, measured) else { continue };
        let millimetres = f64::from(millimetres);
        let (start, aside) = (encoder, encoder + azimuth);
        let beam = [aside.cos() * altitude.cos(), aside.sin() * altitude.cos(), altitude.sin()];
        let ahead = [start.cos(), start.sin(), 0.0];
        let turned = [-1.0, -1.0, 1.0];
        let of_start = if driver == OusterDriver::Early { [1.0; 3] } else { turned };
        let mut point = [0.0; 4];
        for axis in 0..3 {
            let direction = turned[axis] * beam[axis] * 0.001;
            let up = if axis == 2 { 36.18 } else { 0.0 };
            let offset = (of_start[axis] * 27.116 * (ahead[axis] - beam[axis]) + up) * 0.001;
            point[axis] = match driver {
                OusterDriver::Ros => millimetres as f32 * direction as f32 + offset as f32,
                OusterDriver::Sdk | OusterDriver::Early => (millimetres * direction + offset) as f32,
            };
        }
        points[row * width + column] = point;
    }
    points
}

/// A program that moves points to the frame of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mover {
    /// In single precision with vector units: the products of z and y are added to the translation first.
    Pcl,
    /// In single precision, from left to right.
    LeftToRight,
    /// In single precision, the first product apart from the other two.
    Eigen,
    /// In single precision with fused products and sums.
    NumPy,
    /// In double precision, rounded once.
    NumPyDouble,
    /// In double precision, rounded after the rotation and after the translation.
    NuScenes,
}

impl Mover {
    pub const ALL: [Mover; 6] =
        [Mover::Pcl, Mover::LeftToRight, Mover::NumPy, Mover::NumPyDouble, Mover::NuScenes, Mover::Eigen];

    /// Points rotated about x, then about y, then about z by these degrees, and moved by these metres.
    pub fn moved(self, points: &Points, degrees: [f64; 3], metres: [f64; 3]) -> Points {
        let [a, b, c] = degrees.map(f64::to_radians).map(f64::sin_cos);
        let rows = [
            [b.1 * c.1, a.0 * b.0 * c.1 - a.1 * c.0, a.1 * b.0 * c.1 + a.0 * c.0],
            [b.1 * c.0, a.0 * b.0 * c.0 + a.1 * c.1, a.1 * b.0 * c.0 - a.0 * c.1],
            [-b.0, a.0 * b.1, a.1 * b.1],
        ];
        let coordinate = |axis: usize, [x, y, z]: [f32; 3]| {
            let ([p, q, r], t) = (rows[axis].map(|number| number as f32), metres[axis] as f32);
            let turned: f64 = rows[axis].iter().zip([x, y, z]).map(|(row, v)| row * f64::from(v)).sum();
            match self {
                Mover::Pcl => {
                    let sum = z * r + t;
                    let sum = y * q + sum;
                    x * p + sum
                }
                Mover::LeftToRight => {
                    let sum = x * p + y * q;
                    let sum = sum + z * r;
                    sum + t
                }
                Mover::Eigen => {
                    let sum = y * q + z * r;
                    let sum = x * p + sum;
                    sum + t
                }
                Mover::NumPy => {
                    let sum = (f64::from(x) * f64::from(p)) as f32;
                    let sum = f32::mul_add(q, y, sum);
                    f32::mul_add(r, z, sum) + t
                }
                Mover::NumPyDouble => (turned + metres[axis]) as f32,
                Mover::NuScenes => (f64::from(turned as f32) + metres[axis]) as f32,
            }
        };
        let moved = |[x, y, z, i]: &[f32; 4]| {
            let [u, v, w] = [0, 1, 2].map(|axis| coordinate(axis, [*x, *y, *z]));
            [u, v, w, *i]
        };
        points.iter().map(moved).collect()
    }
}

/// A turn of an HDL-32E, laser after laser, whose points a program keeps in double precision until it has
/// turned them by these degrees about x and raised them: at 180 degrees, the files of the Oxford Radar
/// RobotCar data set.
pub fn unrounded_hdl_32e(degrees: f64, up: f64, thinning: u64) -> Points {
    let mut below = numbers(11);
    let (sin_turn, cos_turn) = match degrees {
        180.0 => (0.0, -1.0),
        _ => degrees.to_radians().sin_cos(),
    };
    let mut turn = Points::new();
    let mut ticks = Vec::new();
    let mut tick = 18_000;
    while tick < 18_000 + 36_000 {
        ticks.push(tick % 36_000);
        tick += (32 + below(3)) * thinning;
    }
    for laser in 0..32 {
        let elevation = (1862.0 - f64::from(laser) * 232.7).round() * 1e-4;
        for tick in &ticks {
            let range = (3000 + 40 * (tick / 1000) + below(200) + 100 * laser as u64) as f64 * 0.002;
            if below(10) == 0 {
                continue;
            }
            let azimuth = *tick as f64 * TAU / 36_000.0;
            let flat = elevation.cos() * range;
            let [x, y, z] = [azimuth.sin() * flat, azimuth.cos() * flat, elevation.sin() * range];
            let moved = [x, cos_turn * y - sin_turn * z, sin_turn * y + cos_turn * z + up];
            let [x, y, z] = moved.map(|metres| metres as f32);
            turn.push([x, y, z, (range as u32 % 100) as f32]);
        }
    }
    turn
}
