//! Streams that were written once and must decode for ever, to the same bytes.
//!
//! Each `testdata/golden/*.lpc` has a list beside it, `*.txt`, of the files that it decodes to: a
//! line `name size crc32c` each. New ones, after a change of the format, are written by
//! `cargo test --test golden -- --ignored write_golden`; old ones are never written anew.

mod common;

use std::fs;
use std::path::PathBuf;

use common::formats::{kitti, nuscenes, pcd_extra, pcd_text, pcd_xyz, ply, ply_big_endian, ply_text};
use common::scans::{compensated, random_points, scans, single_precision, small, unrounded};
use common::streams::at_level;
use common::{File, decode_files, encode_files, first_files, in_package, round_trip};
use lidarpc::article::image_coding::{ImageCodec, ImageConfig, Rate};
use lidarpc::backend::BACKENDS;
use lidarpc::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::frame::{Intensity, Prediction};
use lidarpc::study::synth::SynthConfig;

fn folder() -> PathBuf {
    in_package("testdata/golden")
}

/// The list of files, as it stands beside a stream.
fn list(files: &[File]) -> String {
    let line = |(name, bytes): &File| format!("{name} {} {:08x}\n", bytes.len(), crc32c::crc32c(bytes));
    files.iter().map(line).collect()
}

#[test]
fn every_golden_stream_decodes_to_what_it_did() {
    let entries = fs::read_dir(folder()).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut streams: Vec<PathBuf> = entries.filter(|path| path.extension() == Some("lpc".as_ref())).collect();
    streams.sort();
    for path in &streams {
        let shown = path.display();
        let stream = fs::read(path).unwrap();
        let files = decode_files(&stream).unwrap_or_else(|error| panic!("{shown}: {error}"));
        let expected = fs::read_to_string(path.with_extension("txt"))
            .unwrap_or_else(|error| panic!("{shown}: the list beside it: {error}"));
        assert_eq!(list(&files), expected, "{shown}");
        if path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with("-drive")) {
            assert!(files == drive_files(), "{shown}: not the bytes of testdata/drive");
        }
        println!("{shown}: {} files, as expected", files.len());
    }
    assert!(!streams.is_empty(), "no golden stream in {}", folder().display());
}

fn drive_files() -> Vec<File> {
    first_files(&in_package("testdata/drive"), usize::MAX)
}

/// One file of each kind, in and out of order, with and without a fitted scanner.
fn odd_files() -> Vec<File> {
    let config = small(3, 4);
    let frames = scans(&config);
    let mut changed = frames[0].clone();
    changed.swap(40, 900);
    changed.splice(100..100, random_points(30, 1));
    changed[7] = [f32::NAN, f32::INFINITY, -0.0, f32::from_bits(1)];
    changed[9] = [0.0; 4];
    changed[11][3] = f32::from_bits(0x7f80_0001);
    let some = &frames[2][..200];
    [
        ("0-scan.bin", kitti(&frames[1])),
        ("1-changed.bin", [kitti(&changed), vec![1, 2, 3]].concat()),
        ("2-empty.bin", Vec::new()),
        ("3-fields.pcd", pcd_extra(&frames[2])),
        ("4-no-intensity.pcd", pcd_xyz(&frames[3])),
        ("5-text.pcd", pcd_text(some)),
        ("6-ring.pcd.bin", nuscenes(some)),
        ("7-colour.ply", ply(some)),
        ("8-random.bin", kitti(&random_points(200, 2))),
        ("9-no-scan.pcd", b"VERSION 0.7, but damaged".to_vec()),
    ]
    .map(|(name, bytes)| (name.to_owned(), bytes))
    .to_vec()
}

/// PLY of the encodings that need more than a copy.
fn ply_files() -> Vec<File> {
    let frames = scans(&small(3, 2));
    vec![
        ("0-big.ply".to_owned(), ply_big_endian(&frames[0])),
        ("1-text.ply".to_owned(), ply_text(&frames[1])),
    ]
}

/// A scanner whose coordinates were not rounded to the millimetre.
fn float_files() -> Vec<File> {
    let config = small(5, 2);
    let frames = scans(&config).into_iter().enumerate();
    frames.map(|(n, points)| (format!("{n}.bin"), kitti(&unrounded(&config, &points)))).collect()
}

/// The same, computed in single precision.
fn single_precision_files() -> Vec<File> {
    let config = SynthConfig { beams: 2, thinning: 4, ..small(5, 3) };
    let frames = scans(&config).into_iter().enumerate();
    frames.map(|(n, points)| (format!("{n}.bin"), kitti(&single_precision(&config, &points)))).collect()
}

/// Scans that were corrected for the motion within the turn, but for a few points.
fn compensated_files() -> Vec<File> {
    let frames = scans(&small(8, 3));
    let file = |(n, points): (u8, &common::scans::Points)| {
        let mut points = compensated(points, [0.0005, 0.0011, -0.02], [-0.8, 0.04, 0.01 * f64::from(n)]);
        points[3] = [f32::NAN, 0.5, -0.0, 0.25];
        points[300][2] += 0.125;
        (format!("{n}.bin"), kitti(&points))
    };
    (0..).zip(&frames).map(file).collect()
}

/// A scanner that does not move.
fn standing_still_files() -> Vec<File> {
    let still = SynthConfig { speed: 0.0, yaw_rate: 0.0, noise: 0.004, beams: 2, ..small(9, 3) };
    named(&scans(&SynthConfig { thinning: 1, ..still }))
}

#[test]
#[ignore = "writes testdata/golden"]
fn write_golden() {
    fs::create_dir_all(folder()).unwrap();
    // Two frames a group, so that there is more than one group.
    let alone = PredictionChoice::Always(Prediction::None);
    let exact = EncoderConfig { gop: 2, prediction: alone, ..at_level(9) };
    for (name, files) in [
        ("v1-exact-drive", drive_files()),
        ("v1-exact-odd-files", odd_files()),
        ("v1-exact-float32", float_files()),
    ] {
        write(name, || round_trip(&files, &exact));
    }
    for backend in BACKENDS {
        let config = EncoderConfig {
            gop: 2,
            projection: ProjectionKind::Ideal { columns: 500, range_step_um: 10_000 },
            coder: Coder::Backend(backend.id()),
            ..EncoderConfig::preset(Mode::Paper)
        };
        let name = format!("v2-paper-{}", backend.name());
        write(&name, || encode_files(&named(&scans(&small(6, 2))), &config));
    }
    for codec in ImageCodec::ALL {
        let config = EncoderConfig {
            projection: ProjectionKind::Ideal { columns: 500, range_step_um: 10_000 },
            coder: Coder::Image(codec),
            image: ImageConfig { passes: 3, rate: Rate::Bits(16.0) },
            ..EncoderConfig::preset(Mode::Paper)
        };
        let name = format!("v2-paper-{}", codec.name());
        write(&name, || encode_files(&named(&scans(&small(6, 2))), &config));
    }
    let lzma = EncoderConfig { coder: Coder::Backend(lidarpc::backend::LZMA), ..exact };
    write("v2-exact-lzma-odd-files", || round_trip(&odd_files(), &lzma));
    write("v2-exact-inter-drive", || round_trip(&drive_files(), &at_level(9)));
    write("v2-exact-inter-odd-files", || round_trip(&odd_files(), &at_level(9)));
    let bounded = EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 });
    write("v2-bounded-frames", || encode_files(&drive_files(), &bounded));
    write("v2-bounded-odd-files", || encode_files(&odd_files(), &bounded));
    let rounded = EncoderConfig {
        intensity: Intensity::Rounded { step_millionths: 50_000 },
        ..EncoderConfig::preset(Mode::Bounded { max_error_um: 500 })
    };
    write("v2-bounded-rounded-odd-files", || encode_files(&odd_files(), &rounded));
    write("v2-bounded-ply", || encode_files(&ply_files(), &rounded));
    write("v2-exact-ply", || round_trip(&ply_files(), &EncoderConfig::default()));
    write("v3-exact-single-precision", || round_trip(&single_precision_files(), &EncoderConfig::default()));
    write("v3-bounded-single-precision", || encode_files(&single_precision_files(), &bounded));
    for (level, what) in [(2, "tokens"), (3, "fitted-tokens"), (6, "balanced")] {
        write(&format!("v3-exact-{what}"), || round_trip(&drive_files(), &at_level(level)));
        write(&format!("v3-exact-{what}-odd-files"), || round_trip(&odd_files(), &at_level(level)));
        let bounded = EncoderConfig { level: at_level(level).level, ..rounded.clone() };
        write(&format!("v3-bounded-{what}"), || encode_files(&drive_files(), &bounded));
    }
    write("v3-exact-compensated", || round_trip(&compensated_files(), &EncoderConfig::default()));
    write("v3-bounded-compensated", || encode_files(&compensated_files(), &bounded));
    for (level, what) in [(2, "tokens"), (3, "fitted-tokens"), (6, "balanced"), (9, "deep")] {
        write(&format!("v4-exact-{what}"), || round_trip(&drive_files(), &at_level(level)));
        write(&format!("v4-exact-{what}-odd-files"), || round_trip(&odd_files(), &at_level(level)));
        let bounded = EncoderConfig { level: at_level(level).level, ..rounded.clone() };
        write(&format!("v4-bounded-{what}"), || encode_files(&odd_files(), &bounded));
    }
    // So that balanced P frames take the same cells, and the moved surfaces.
    write("v4-exact-balanced-standing-still", || round_trip(&standing_still_files(), &at_level(6)));
    let told = EncoderConfig { prediction: PredictionChoice::EveryReference, ..at_level(6) };
    write("v4-exact-balanced-inter-drive", || round_trip(&drive_files(), &told));
    for (level, what) in [(1, "packed"), (6, "light"), (8, "mixed")] {
        write(&format!("v5-exact-{what}"), || round_trip(&drive_files(), &at_level(level)));
        write(&format!("v5-exact-{what}-odd-files"), || round_trip(&odd_files(), &at_level(level)));
        write(&format!("v5-exact-{what}-float32"), || round_trip(&float_files(), &at_level(level)));
        let bounded = EncoderConfig { level: at_level(level).level, ..rounded.clone() };
        write(&format!("v5-bounded-{what}"), || encode_files(&odd_files(), &bounded));
    }
    write("v5-exact-light-standing-still", || round_trip(&standing_still_files(), &at_level(6)));
    write("v5-exact-light-inter-drive", || round_trip(&drive_files(), &told));
    for (coder, name) in [(Coder::Context, "context"), (Coder::Backend(lidarpc::backend::LZMA), "lzma")] {
        let config = EncoderConfig {
            projection: ProjectionKind::Ideal { columns: 500, range_step_um: 10_000 },
            coder,
            intensity: Intensity::Exact,
            prediction: PredictionChoice::Smallest,
            ..EncoderConfig::preset(Mode::Paper)
        };
        // Twice the same, so that a back-end has a use for the frame before.
        let still = vec![scans(&small(6, 1)).swap_remove(0); 2];
        write(&format!("v2-paper-inter-{name}"), || encode_files(&named(&still), &config));
    }
}

fn write(name: &str, encode: impl FnOnce() -> Vec<u8>) {
    let path = folder().join(name).with_extension("lpc");
    if path.exists() {
        println!("{} is there, and stays as it is", path.display());
        return;
    }
    let stream = encode();
    let files = decode_files(&stream).unwrap();
    fs::write(path.with_extension("txt"), list(&files)).unwrap();
    fs::write(&path, stream).unwrap();
    println!("{}: {} files", path.display(), files.len());
}

fn named(frames: &[common::scans::Points]) -> Vec<File> {
    (0..).zip(frames).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
}
