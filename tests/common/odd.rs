//! Scans with arbitrary changes, and files without meaning, for property tests.

use std::sync::LazyLock;

use lidarpc::internals::study::synth::{SynthConfig, SynthScanner};
use proptest::prelude::*;

use super::File;
use super::formats::{
    columns, csv, kitti, las, npy, npy_doubles, nuscenes, pcd_extra, pcd_ros, pcd_text, pcd_xyz, ply,
};
use super::scans::{Points, moved, rounded, rows, scans, shuffled, small, unrounded};

/// The scans to be changed: of two scanners, off the millimetre grid, and off every grid.
pub static SCANS: LazyLock<Vec<Vec<Points>>> = LazyLock::new(|| {
    let (one, other) = (small(1, 3), SynthConfig { beams: 16, thinning: 20, ..small(7, 2) });
    let ones = scans(&one);
    let floats = ones.iter().map(|points| unrounded(&one, points)).collect();
    let corrected = ones.iter().map(|points| moved(points)).collect();
    let firings = SynthConfig { scanner: SynthScanner::Vlp16, thinning: 16, ..small(3, 2) };
    vec![ones, scans(&other), floats, corrected, scans(&firings)]
});

/// The format in which points are written.
#[derive(Clone, Copy, Debug)]
pub enum Format {
    Kitti,
    Nuscenes,
    PcdXyz,
    PcdExtra,
    PcdRos,
    PcdText,
    Ply,
    Csv,
    Columns,
    Npy,
    NpyDoubles,
    Las,
}

impl Format {
    pub const ALL: [Format; 12] = [
        Format::Kitti,
        Format::Nuscenes,
        Format::PcdXyz,
        Format::PcdExtra,
        Format::PcdRos,
        Format::PcdText,
        Format::Ply,
        Format::Csv,
        Format::Columns,
        Format::Npy,
        Format::NpyDoubles,
        Format::Las,
    ];

    pub fn write(self, points: &[[f32; 4]]) -> Vec<u8> {
        match self {
            Format::Kitti => kitti(points),
            Format::Nuscenes => nuscenes(points),
            Format::PcdXyz => pcd_xyz(points),
            Format::PcdExtra => pcd_extra(points),
            Format::PcdRos => pcd_ros(points),
            Format::PcdText => pcd_text(points),
            Format::Ply => ply(points),
            Format::Csv => csv(points),
            Format::Columns => columns(points),
            Format::Npy => npy(points),
            Format::NpyDoubles => npy_doubles(points),
            Format::Las => las(points),
        }
    }

    pub fn extension(self) -> &'static str {
        match self {
            Format::Kitti => "bin",
            Format::Nuscenes => "pcd.bin",
            Format::PcdXyz | Format::PcdExtra | Format::PcdRos | Format::PcdText => "pcd",
            Format::Ply => "ply",
            Format::Csv => "csv",
            Format::Columns => "txt",
            Format::Npy | Format::NpyDoubles => "npy",
            Format::Las => "las",
        }
    }
}

/// A change to a scan. Indices are taken modulo the number of points.
#[derive(Clone, Debug)]
pub enum Change {
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
    /// All coordinates, to this number of decimal places.
    Rounded(i32),
    Intensity(usize, f32),
    AllIntensities(f32),
    /// All points become this one.
    OneCell(usize),
}

impl Change {
    pub fn apply(&self, points: &mut Points) {
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
            Change::Rounded(places) => *points = rounded(points, places),
            Change::Intensity(at, value) => points[at % count][3] = value,
            Change::AllIntensities(factor) => points.iter_mut().for_each(|p| p[3] *= factor),
            Change::OneCell(at) => {
                let point = points[at % count];
                points.iter_mut().for_each(|p| *p = point);
            }
        }
    }
}

/// Values that are likely to cause failures.
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
        2 => (1i32..5).prop_map(Change::Rounded),
        4 => (at(), odd_value()).prop_map(|(a, v)| Change::Intensity(a, v)),
        1 => prop::sample::select(vec![0.0, 255.0, 256.0, 100.0, 0.3, f32::NAN]).prop_map(Change::AllIntensities),
        1 => at().prop_map(Change::OneCell),
    ]
}

/// A scan with changes, as a file: its extension and bytes.
pub fn changed_scan() -> impl Strategy<Value = Quiet> {
    let scan = (0..5usize, 0..3usize).prop_map(|(kind, frame)| {
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

/// Meaningless bytes under a meaningful name.
pub fn noise() -> impl Strategy<Value = Quiet> {
    let extension = prop::sample::select(vec!["bin", "pcd", "ply", "pcd.bin", "txt"]);
    let byte = prop_oneof![Just(0u8), Just(255), any::<u8>()];
    (extension, prop::collection::vec(byte, 0..700)).prop_map(|(e, bytes)| Quiet(e, bytes))
}

/// A file's extension and bytes. The bytes are not printed: a failure would print megabytes of them.
#[derive(Clone)]
pub struct Quiet(pub &'static str, pub Vec<u8>);

impl Quiet {
    pub fn named(self, stem: impl std::fmt::Display) -> File {
        (format!("{stem}.{}", self.0), self.1)
    }
}

impl std::fmt::Debug for Quiet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {} bytes", self.0, self.1.len())
    }
}
