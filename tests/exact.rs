//! Exact mode: files are restored byte for byte, whatever they contain.

use std::collections::BTreeSet;

use crate::common::formats::{kitti, pcd_extra, pcd_xyz};
use crate::common::odd::{Change, Format, SCANS, changed_scan, noise};
use crate::common::scans::{Points, random_points, rows, scans, shuffled, small};
use crate::common::streams::{at_level, halved};
use crate::common::{
    File, cases, encode_files, first_files, real_folders, round_trip, section_bytes, take_apart,
};
use lidarpc::internals::container::{CodedFrame, Section, SectionKind};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::scanner::hdl64::fit;
use lidarpc::internals::study::synth::SynthConfig;
use proptest::prelude::*;

/// Settings with this many frames a group.
fn gop(gop: usize) -> EncoderConfig {
    EncoderConfig { gop, threads: 2, ..EncoderConfig::default() }
}

// ---- anything at all ----

proptest! {
    #![proptest_config(cases(48))]

    #[test]
    fn any_folder_comes_back(
        files in prop::collection::vec(prop_oneof![3 => changed_scan(), 1 => noise()], 0..=4),
        gop_length in 1usize..5,
        are_halved: bool
    ) {
        let files: Vec<File> = files.into_iter().enumerate().map(|(n, file)| file.named(n)).collect();
        let config = gop(gop_length);
        round_trip(&files, &if are_halved { halved(config) } else { config });
    }

    #[test]
    fn any_frame_among_good_ones_comes_back(odd in changed_scan(), place in 0usize..3) {
        let mut files = good_files();
        files.insert(place, odd.named("odd"));
        round_trip(&files, &gop(20));
    }
}

// ---- what the promise names, one by one ----

/// Two frames of one scanner.
fn good_files() -> Vec<File> {
    let file = |(n, points): (usize, &Points)| (format!("{n:010}.bin"), kitti(points));
    SCANS[0].iter().take(2).enumerate().map(file).collect()
}

/// A file must be restored, both alone and after good frames, to which a scanner was fitted.
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
fn images_with_many_returns_are_halved_whatever_the_threads() {
    let ranges = |stream: &[u8]| -> Vec<usize> {
        let frames = take_apart(stream).1.into_iter().flat_map(|group| group.frames);
        let is_range = |section: &&Section| section.kind == SectionKind::Range;
        frames.map(|frame| frame.sections.iter().filter(is_range).count()).collect()
    };
    let returns = SCANS[0].iter().take(2).map(Vec::len);
    // Strays are not returns.
    let [fewer, more] = [returns.clone().min().unwrap() / 2, returns.max().unwrap() + 1];
    for level in [6, 8, 9] {
        let with = |halved_from, threads| {
            round_trip(&good_files(), &EncoderConfig { halved_from, threads, ..at_level(level) })
        };
        assert_eq!([fewer, more].map(|from| ranges(&with(from, 1))), [[2, 2], [1, 1]], "level {level}");
        assert!(with(fewer, 1) == with(fewer, 2), "level {level}");
    }
    assert_eq!(ranges(&round_trip(&good_files(), &halved(at_level(3)))), [1, 1]);
}

#[test]
fn good_frames_come_back_through_the_scanner_model() {
    for (n, frames) in SCANS.iter().take(3).enumerate() {
        let files: Vec<File> =
            frames.iter().enumerate().map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect();
        let bytes = section_bytes(&round_trip(&files, &gop(20)));
        assert!(bytes[&SectionKind::Range] > bytes.get(&SectionKind::Strays).copied().unwrap_or(0), "{n}");
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

/// In real files a coordinate that rounds to zero has the formula's sign; here it also has the other one.
#[test]
fn zeros_of_either_sign_where_the_formula_gives_zero() {
    let sample: Vec<_> = good_files().into_iter().map(|(name, bytes)| parse(&name, bytes)).collect();
    let scanner = fit(&sample).expect("a scanner is found");
    let mut zeros = Points::new();
    for (row, tick) in (0..scanner.rows()).flat_map(|row| [0, 999, 1000, 1999, 2000, 3999].map(|t| (row, t)))
    {
        for steps in (1500..30_000).step_by(7) {
            let rounded = scanner.point(row, tick, steps).map(|v| ((v * 1000.0).round() / 1000.0) as f32);
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
    let (_, groups) = take_apart(&encode_files(&files, &gop(4)));
    let frames = || groups.iter().flat_map(|group| &group.frames);
    let tracks = [0, 1].map(|scanner| {
        let is_its = |frame: &&CodedFrame| frame.header.name.ends_with(&format!("-{scanner}.bin"));
        frames().filter(is_its).map(|frame| frame.header.stamp.track).collect::<BTreeSet<_>>()
    });
    // The scans of these two scanners are on different tracks.
    assert!(tracks.iter().all(|tracks| tracks.len() == 1) && tracks[0] != tracks[1], "{tracks:?}");
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

#[test]
fn frames_come_back_where_compressed_files_are_shorter() {
    // Points at a few places, in no order, each with its own intensity: no model knows what records repeat.
    let mut places = random_points(90, 4);
    (0u8..).zip(&mut places).for_each(|(n, place)| place[3] = f32::from(n.wrapping_mul(37) % 100) / 100.0);
    let mixed_up = |number: usize| number.wrapping_mul(0x9E37_79B9) >> 7;
    let scan =
        |scan: usize| -> Points { (0..4000).map(|n| places[mixed_up(n + 5000 * scan) % 90]).collect() };
    let files: Vec<File> = (0..4).map(|n| (format!("{n}.bin"), kitti(&scan(n)))).collect();
    let stream = round_trip(&files, &EncoderConfig::default());
    let (_, groups) = take_apart(&stream);
    assert_eq!(groups.len(), 1);
    for frame in &groups[0].frames {
        assert!(frame.sections.iter().any(|section| section.kind == SectionKind::Bytes));
    }
}

#[test]
fn a_compressor_is_tried_again_for_clouds_of_another_kind() {
    let far = |points: Points| -> Points {
        points.into_iter().map(|[x, y, z, i]| [x * 1.37, y * 0.73, z * 3.1, i]).collect()
    };
    let coordinates: Vec<f32> = far(random_points(64, 1)).iter().map(|point| point[0]).collect();
    let regular = |n: usize| [n % 64, n / 64 % 64, n / 7 % 64].map(|at| coordinates[at]);
    let regular = |n: usize| [&regular(n)[..], &[(n % 5) as f32]].concat().try_into().unwrap();
    let files = [far(random_points(5000, 2)), (0..5000).map(regular).collect()];
    let files: Vec<File> = (0..).zip(&files).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect();
    let [random, regular, both] = [&files[..1], &files[1..], &files[..]]
        .map(|files| round_trip(files, &EncoderConfig::default()).len());
    assert!(3 * regular < random, "{regular} bytes, {random} for random points");
    assert!(both < random + regular + 100, "{both} bytes, alone {random} and {regular}");
}

#[test]
fn a_scanner_whose_numbers_the_file_does_not_have_is_not_used() {
    // Coordinates that have lost bits, as in half precision: a scanner fits, but the corrections would take
    // more than the points.
    let scans = scans(&SynthConfig { beams: 16, thinning: 4, ..small(3, 2) });
    let cut = |v: f32| f32::from_bits(v.to_bits() & !0xfff);
    let cut: Vec<Points> = scans
        .iter()
        .map(|points| points.iter().map(|&[x, y, z, i]| [cut(x), cut(y), cut(z), i]).collect())
        .collect();
    let files: Vec<File> = (0..).zip(&cut).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect();
    for level in [1, 6] {
        let stream = round_trip(&files, &at_level(level));
        let (scanners, sections) = (take_apart(&stream).0, section_bytes(&stream));
        assert_eq!(scanners.len(), 1, "a scanner fits");
        assert!(!sections.contains_key(&SectionKind::Correction), "level {level}: {sections:?}");
    }
}

#[test]
fn intensities_that_are_nan_cost_little() {
    let with_nan: Vec<Points> = SCANS[0]
        .iter()
        .map(|points| {
            let is_nan = |n: usize| n.wrapping_mul(0x9E37_79B9) >> 9 & 7 < 2;
            let nan =
                |(n, &[x, y, z, i]): (usize, &[f32; 4])| [x, y, z, if is_nan(n) { f32::NAN } else { i }];
            points.iter().enumerate().map(nan).collect()
        })
        .collect();
    let files = |scans: &[Points]| -> Vec<File> {
        (0..).zip(scans).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
    };
    for level in [1, 3, 6, 9] {
        let [plain, with_nan] =
            [&SCANS[0], &with_nan].map(|scans| round_trip(&files(scans), &at_level(level)).len());
        assert!(with_nan * 4 < plain * 5, "level {level}: {with_nan} bytes, {plain} without");
    }
}
