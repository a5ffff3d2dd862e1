//! Exact mode: whatever the files hold, they come back byte for byte.

mod common;

use std::sync::LazyLock;

use common::formats::{kitti, nuscenes, pcd_extra, pcd_text, pcd_xyz, ply};
use common::scans::{Points, moved, random_points, rows, scans, shuffled, small, unrounded};
use common::{File, cases, first_files, real_folders, round_trip, section_bytes};
use lidarpc::bitstream::SectionKind;
use lidarpc::codec::EncoderConfig;
use lidarpc::io::parse;
use lidarpc::sensor::fit;
use lidarpc::synth::SynthConfig;
use proptest::prelude::*;

/// Settings with this many frames a group.
fn gop(gop: usize) -> EncoderConfig {
    EncoderConfig { gop, threads: 2, ..EncoderConfig::default() }
}

/// Scans to start from: two scanners, one off the millimetre grid, one off every grid.
static SCANS: LazyLock<Vec<Vec<Points>>> = LazyLock::new(|| {
    let (one, other) = (small(1, 3), SynthConfig { beams: 16, thinning: 20, ..small(7, 2) });
    let ones = scans(&one);
    let floats = ones.iter().map(|points| unrounded(&one, points)).collect();
    let corrected = ones.iter().map(|points| moved(points)).collect();
    vec![ones, scans(&other), floats, corrected]
});

// ---- anything at all ----

/// How points become a file.
#[derive(Clone, Copy, Debug)]
enum Format {
    Kitti,
    Nuscenes,
    PcdXyz,
    PcdExtra,
    PcdText,
    Ply,
}

impl Format {
    const ALL: [Format; 6] =
        [Format::Kitti, Format::Nuscenes, Format::PcdXyz, Format::PcdExtra, Format::PcdText, Format::Ply];

    fn write(self, points: &[[f32; 4]]) -> Vec<u8> {
        match self {
            Format::Kitti => kitti(points),
            Format::Nuscenes => nuscenes(points),
            Format::PcdXyz => pcd_xyz(points),
            Format::PcdExtra => pcd_extra(points),
            Format::PcdText => pcd_text(points),
            Format::Ply => ply(points),
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Format::Kitti => "bin",
            Format::Nuscenes => "pcd.bin",
            Format::PcdXyz | Format::PcdExtra | Format::PcdText => "pcd",
            Format::Ply => "ply",
        }
    }
}

/// What is done to a scan. Places are counted modulo the number of points.
#[derive(Clone, Debug)]
enum Change {
    Shuffle(u64),
    Reverse,
    SwapRows(usize, usize),
    Swap(usize, usize),
    Keep(usize, usize),
    Delete(usize, usize),
    Duplicate(usize, usize),
    Coordinate(usize, usize, f32),
    Ulps(usize, usize, i32),
    Millimetres(usize, usize, i32),
    Intensity(usize, f32),
    AllIntensities(f32),
    /// All points become this one.
    OneCell(usize),
}

impl Change {
    fn apply(&self, points: &mut Points) {
        let count = points.len();
        if count == 0 {
            return;
        }
        let range = |from: usize, length: usize| from % count..(from % count + length).min(count);
        match *self {
            Change::Shuffle(seed) => *points = shuffled(points, seed),
            Change::Reverse => points.reverse(),
            Change::SwapRows(a, b) => {
                let mut rows = rows(points);
                let (a, b) = (a % rows.len(), b % rows.len());
                rows.swap(a, b);
                *points = rows.concat();
            }
            Change::Swap(a, b) => points.swap(a % count, b % count),
            Change::Keep(from, length) => *points = points[range(from, length)].to_vec(),
            Change::Delete(from, length) => drop(points.drain(range(from, length))),
            Change::Duplicate(from, length) => {
                let again = points[range(from, length)].to_vec();
                points.splice(from % count..from % count, again);
            }
            Change::Coordinate(at, axis, value) => points[at % count][axis] = value,
            Change::Ulps(at, axis, ulps) => {
                let value = &mut points[at % count][axis];
                *value = f32::from_bits(value.to_bits().wrapping_add_signed(ulps));
            }
            Change::Millimetres(at, axis, mm) => {
                let value = &mut points[at % count][axis];
                *value = (((f64::from(*value) * 1000.0).round() + f64::from(mm)) / 1000.0) as f32;
            }
            Change::Intensity(at, value) => points[at % count][3] = value,
            Change::AllIntensities(factor) => points.iter_mut().for_each(|p| p[3] *= factor),
            Change::OneCell(at) => {
                let point = points[at % count];
                points.iter_mut().for_each(|p| *p = point);
            }
        }
    }
}

/// Values that break things.
fn odd_value() -> impl Strategy<Value = f32> {
    let listed = [0.0, -0.0, f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, -1e-45, 0.001];
    let large = [f32::MAX, f32::MIN, 1e6, 999_999.94, -131.07, 16_777.217, 1e12, -0.0005, 65.535];
    prop_oneof![
        prop::sample::select([listed, large].concat()),
        any::<u32>().prop_map(f32::from_bits),
        (-9000i32..9000).prop_map(|n| n as f32 / 100.0),
    ]
}

fn change() -> impl Strategy<Value = Change> {
    let (at, axis) = (any::<usize>, || 0usize..3);
    prop_oneof![
        1 => any::<u64>().prop_map(Change::Shuffle),
        1 => Just(Change::Reverse),
        2 => (at(), at()).prop_map(|(a, b)| Change::SwapRows(a, b)),
        2 => (at(), at()).prop_map(|(a, b)| Change::Swap(a, b)),
        1 => (at(), prop_oneof![Just(1), 0usize..1500]).prop_map(|(a, n)| Change::Keep(a, n)),
        2 => (at(), 0usize..900).prop_map(|(a, n)| Change::Delete(a, n)),
        2 => (at(), 1usize..300).prop_map(|(a, n)| Change::Duplicate(a, n)),
        6 => (at(), axis(), odd_value()).prop_map(|(a, x, v)| Change::Coordinate(a, x, v)),
        3 => (at(), axis(), -2i32..3).prop_map(|(a, x, n)| Change::Ulps(a, x, n)),
        4 => (at(), axis(), -6i32..7).prop_map(|(a, x, n)| Change::Millimetres(a, x, n)),
        4 => (at(), odd_value()).prop_map(|(a, v)| Change::Intensity(a, v)),
        1 => prop::sample::select(vec![0.0, 255.0, 256.0, 100.0, 0.3, f32::NAN]).prop_map(Change::AllIntensities),
        1 => at().prop_map(Change::OneCell),
    ]
}

/// A scan with changes, as a file: its extension and bytes.
fn changed_scan() -> impl Strategy<Value = Quiet> {
    let scan = (0..4usize, 0..3usize).prop_map(|(kind, frame)| {
        let frames = &SCANS[kind];
        frames[frame % frames.len()].clone()
    });
    let format = prop_oneof![3 => Just(Format::Kitti), 2 => prop::sample::select(&Format::ALL[..])];
    let tail = prop_oneof![3 => Just(Vec::new()), 1 => prop::collection::vec(any::<u8>(), 0..20)];
    let cut = prop_oneof![4 => Just(0usize), 1 => 0usize..5000];
    (scan, prop::collection::vec(change(), 0..8), format, tail, cut).prop_map(
        |(mut points, changes, format, tail, cut)| {
            changes.iter().for_each(|change| change.apply(&mut points));
            let mut bytes = format.write(&points);
            bytes.truncate(bytes.len().saturating_sub(cut));
            bytes.extend(tail);
            Quiet(format.extension(), bytes)
        },
    )
}

/// Bytes of no meaning under a meaningful name.
fn noise() -> impl Strategy<Value = Quiet> {
    let extension = prop::sample::select(vec!["bin", "pcd", "ply", "pcd.bin", "txt"]);
    let byte = prop_oneof![Just(0u8), Just(255), any::<u8>()];
    (extension, prop::collection::vec(byte, 0..700)).prop_map(|(e, bytes)| Quiet(e, bytes))
}

/// A file's extension and bytes. Shows no bytes: a failure would print megabytes of them.
#[derive(Clone)]
struct Quiet(&'static str, Vec<u8>);

impl Quiet {
    fn named(self, stem: impl std::fmt::Display) -> File {
        (format!("{stem}.{}", self.0), self.1)
    }
}

impl std::fmt::Debug for Quiet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} bytes", self.0, self.1.len())
    }
}

proptest! {
    #![proptest_config(cases(48))]

    #[test]
    fn any_folder_comes_back(
        files in prop::collection::vec(prop_oneof![3 => changed_scan(), 1 => noise()], 0..=4),
        gop_length in 1usize..5
    ) {
        let files: Vec<File> = files.into_iter().enumerate().map(|(n, file)| file.named(n)).collect();
        round_trip(&files, &gop(gop_length));
    }

    #[test]
    fn any_frame_among_good_ones_comes_back(odd in changed_scan(), place in 0usize..3) {
        let mut files = good_files();
        files.insert(place, odd.named("odd"));
        round_trip(&files, &gop(20));
    }
}

// ---- what the promise names, one by one ----

/// Two frames by one scanner.
fn good_files() -> Vec<File> {
    let file = |(n, points): (usize, &Points)| (format!("{n:010}.bin"), kitti(points));
    SCANS[0].iter().take(2).enumerate().map(file).collect()
}

/// A file must come back alone and after good frames, which a sensor model was fitted to.
fn comes_back(extension: &str, bytes: Vec<u8>) {
    let odd = (format!("odd.{extension}"), bytes);
    round_trip(std::slice::from_ref(&odd), &gop(20));
    round_trip(&[good_files(), vec![odd]].concat(), &gop(20));
}

/// The first good frame, with a change.
fn good_but(change: impl FnOnce(&mut Points)) -> Vec<u8> {
    let mut points = SCANS[0][0].clone();
    change(&mut points);
    kitti(&points)
}

fn each_coordinate_in_turn(value: f32) {
    comes_back("bin", good_but(|points| (0..90).for_each(|n| points[n * 15][n % 4] = value)));
    comes_back("bin", kitti(&[[value; 4]]));
    comes_back("bin", kitti(&[[value; 4]; 40]));
}

#[test]
fn good_frames_come_back_through_the_sensor_model() {
    for (n, frames) in SCANS.iter().take(3).enumerate() {
        let files: Vec<File> =
            frames.iter().enumerate().map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect();
        let bytes = section_bytes(&round_trip(&files, &gop(20)));
        assert!(bytes[&SectionKind::Range] > bytes.get(&SectionKind::Points).copied().unwrap_or(0), "{n}");
    }
}

#[test]
fn one_frame_groups_and_long_groups_come_back() {
    let many: Vec<File> = (0..12).map(|n| (format!("{n}.bin"), kitti(&SCANS[0][n % 3]))).collect();
    let short = round_trip(&many, &gop(1));
    let long = round_trip(&many, &gop(100));
    assert!(long.len() < short.len(), "long groups learn more");
}

#[test]
fn no_file_and_an_empty_file() {
    round_trip(&[], &gop(20));
    for extension in ["bin", "pcd", "ply", "pcd.bin"] {
        comes_back(extension, Vec::new());
    }
}

#[test]
fn a_length_that_is_no_multiple_of_a_record() {
    for length in [1, 7, 15, 17, 31, 16 * 700 + 5] {
        comes_back("bin", kitti(&SCANS[0][0])[..length].to_vec());
    }
}

#[test]
fn not_a_number() {
    for bits in [0x7fc0_0000u32, 0xffc0_0000, 0x7f80_0001, 0xffff_ffff, 0x7fa5_5aa5] {
        each_coordinate_in_turn(f32::from_bits(bits));
    }
}

#[test]
fn infinities() {
    each_coordinate_in_turn(f32::INFINITY);
    each_coordinate_in_turn(f32::NEG_INFINITY);
}

#[test]
fn zeros_of_both_signs() {
    each_coordinate_in_turn(-0.0);
    each_coordinate_in_turn(0.0);
    let zeros = [[0.0, 0.0, 0.0, 0.0], [-0.0, 0.0, -0.0, -0.0], [0.0, -0.0, 0.0, 0.5]];
    comes_back("bin", good_but(|points| zeros.iter().for_each(|zero| points.insert(77, *zero))));
    comes_back("bin", kitti(&zeros));
}

/// A coordinate that rounds to zero keeps the formula's sign in real files; here also the other one.
#[test]
fn zeros_of_either_sign_where_the_formula_gives_zero() {
    let sample: Vec<_> = good_files().into_iter().map(|(name, bytes)| parse(&name, bytes)).collect();
    let sensor = fit(&sample).expect("a scanner is found");
    let mut zeros = Points::new();
    for (row, tick) in (0..sensor.rows()).flat_map(|row| [0, 999, 1000, 1999, 2000, 3999].map(|t| (row, t))) {
        for steps in (1500..30_000).step_by(7) {
            let rounded = sensor.point(row, tick, steps).map(|v| ((v * 1000.0).round() / 1000.0) as f32);
            if rounded[0] == 0.0 || rounded[1] == 0.0 {
                zeros.push([rounded[0], rounded[1], rounded[2], 0.5]);
            }
        }
    }
    assert!(zeros.len() > 50, "{} points on an axis", zeros.len());
    let other = |p: &[f32; 4]| p.map(|v| if v == 0.0 { -v } else { v });
    let others: Points = zeros.iter().map(other).collect();
    for points in [&zeros, &others] {
        comes_back(
            "bin",
            good_but(|good| *good = points.iter().flat_map(|p| [&good[..30], &[*p]].concat()).collect()),
        );
        comes_back("bin", good_but(|good| good.extend(points)));
    }
}

#[test]
fn denormals_and_the_largest_numbers() {
    for value in [f32::from_bits(1), -1e-40, f32::MIN_POSITIVE, f32::MAX, f32::MIN, 1e6, 999_999.94] {
        each_coordinate_in_turn(value);
    }
}

#[test]
fn duplicate_points() {
    comes_back("bin", good_but(|points| *points = points.iter().flat_map(|p| [*p, *p]).collect()));
    comes_back("bin", good_but(|points| points.extend(points.clone())));
    comes_back("bin", good_but(|points| *points = vec![points[99]; 3000]));
}

#[test]
fn random_points_come_back() {
    comes_back("bin", kitti(&random_points(3000, 5)));
    comes_back("pcd", pcd_extra(&random_points(800, 6)));
}

#[test]
fn shuffled_and_reversed_order() {
    comes_back("bin", kitti(&shuffled(&SCANS[0][0], 3)));
    comes_back("bin", good_but(|points| points.reverse()));
    comes_back("bin", good_but(|points| *points = rows(points).into_iter().rev().flatten().collect()));
}

#[test]
fn one_point() {
    for at in [0, 500, 1500] {
        comes_back("bin", kitti(&SCANS[0][0][at..=at]));
        comes_back("pcd", pcd_xyz(&SCANS[0][0][at..=at]));
    }
}

#[test]
fn points_next_to_the_formula() {
    for off in [-5, -4, -3, -1, 1, 2, 4] {
        comes_back(
            "bin",
            good_but(|points| {
                (0..points.len()).step_by(3).for_each(|n| Change::Millimetres(n, n % 3, off).apply(points));
            }),
        );
    }
    comes_back(
        "bin",
        good_but(|points| (0..points.len()).for_each(|n| Change::Ulps(n, n % 4, 1).apply(points))),
    );
}

#[test]
fn several_scanners_in_one_folder() {
    let files: Vec<File> = SCANS
        .iter()
        .enumerate()
        .flat_map(|(n, frames)| {
            frames.iter().enumerate().map(move |(m, p)| (format!("{m}-{n}.bin"), kitti(p)))
        })
        .collect();
    round_trip(&files, &gop(4));
}

#[test]
fn frames_with_and_without_intensity() {
    let points = &SCANS[0][0];
    let files = [("a.bin", kitti(points)), ("b.pcd", pcd_xyz(points)), ("c.bin", kitti(points))];
    round_trip(&files.map(|(name, bytes)| (name.to_owned(), bytes)), &gop(20));
}

#[test]
fn intensities_off_every_grid_and_on_others() {
    for scale in [2.55f32, 255.0, 256.0, 0.001, -1.0] {
        comes_back("bin", good_but(|points| points.iter_mut().for_each(|p| p[3] *= scale)));
    }
    comes_back("bin", good_but(|points| points[3][3] = f32::NAN));
}

#[test]
fn a_pcd_with_extra_fields_or_a_damaged_header() {
    for format in Format::ALL {
        let bytes = format.write(&SCANS[0][0][..300]);
        comes_back(format.extension(), bytes.clone());
        for place in (0..300.min(bytes.len())).step_by(23) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 4;
            round_trip(&[(format!("x.{}", format.extension()), damaged)], &gop(20));
        }
    }
}

#[test]
fn real_scans_come_back() {
    for folder in real_folders() {
        let files = first_files(&folder, 2);
        let size: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
        let stream = round_trip(&files, &EncoderConfig::default());
        println!("{}: {:.2} %", folder.display(), 100.0 * stream.len() as f64 / size.max(1) as f64);
    }
}
