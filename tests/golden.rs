//! Streams that were written once and must stay readable, with the same result; and a check that the encoder
//! still writes them.
//!
//! Each `testdata/golden/*.lpc` has a list beside it, `*.txt`, of the files that it decodes to: a line `name
//! size crc32c` each. After a change of the encoder's output, they are written again by `cargo test --test
//! all -- --ignored write_golden`. This is allowed until the format is released; after that, the old ones are
//! kept under other names.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use crate::common::firings::{OusterDriver, ouster};
use crate::common::formats::{
    columns, csv, kitti, las, nclt, npy, npy_by_column, npy_doubles, npy_halves, nuscenes, padded_columns,
    pcd_characters, pcd_extra, pcd_text, pcd_velodyne, pcd_xyz, ply, ply_big_endian, ply_text,
};
use crate::common::scans::{compensated, random_points, rounded, scans, single_precision, small, unrounded};
use crate::common::streams::{KNOWN, at_level, halved, moved_through_a_map, with_back_end};
use crate::common::{
    self, File, decode_files, encode_files, in_package, put_together, round_trip, take_apart,
};
use lidarpc::internals::article::image_coding::{ImageCodec, ImageConfig, Rate};
use lidarpc::internals::backend::{BACKENDS, LZMA};
use lidarpc::internals::container::{FrameKind, Stamp, StreamHeader, Time, TimeSource};
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice};
use lidarpc::internals::frame::{FrameParameters, IntensityFidelity, Prediction};
use lidarpc::internals::inter::registration::QuantisedPose;
use lidarpc::internals::scanner::{RangeImage, firings};
use lidarpc::internals::stream::{FrameInput, encode};
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner};

/// The version of the format of the streams.
const VERSION: u16 = 1;

/// Encodes files, and may check that they come back.
type Encode = fn(&[File], &EncoderConfig) -> Vec<u8>;

/// A stream's name, and a function that makes it; exact streams by this `Encode`.
type Recipe = (String, Box<dyn Fn(Encode) -> Vec<u8>>);

fn folder() -> PathBuf {
    in_package("testdata/golden")
}

/// The list of files beside a stream.
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
        assert_eq!(StreamHeader::read_from(&mut &stream[..]).unwrap().version, VERSION, "{shown}");
        let files = decode_files(&stream).unwrap_or_else(|error| panic!("{shown}: {error}"));
        let expected = fs::read_to_string(path.with_extension("txt"))
            .unwrap_or_else(|error| panic!("{shown}: the list beside it: {error}"));
        assert_eq!(list(&files), expected, "{shown}");
        has_what_its_name_says(&shown.to_string(), &stream);
        println!("{shown}: {} files, as expected", files.len());
    }
    let name = |path: &PathBuf| path.file_stem().unwrap().to_string_lossy().into_owned();
    let names: BTreeSet<_> = streams.iter().map(name).collect();
    assert_eq!(names, recipes().into_iter().map(|(name, _)| name).collect());
}

/// The feature for which a stream is there.
fn has_what_its_name_says(name: &str, stream: &[u8]) {
    let (scanners, groups) = take_apart(stream);
    let frames = groups.iter().flat_map(|group| &group.frames);
    let parameters: Vec<_> = frames.map(|frame| FrameParameters::of(frame).unwrap()).collect();
    let p_frames = parameters.iter().filter(|frame| frame.prediction == Prediction::Inter).count();
    let has = |end: &str| name.strip_suffix(".lpc").is_some_and(|name| name.ends_with(end));
    let needs_p_frames = ["p-frames", "still"].into_iter().any(has);
    assert!(p_frames > 0 || !needs_p_frames, "{name}: it has no P frame");
    // Of the article's, each is the frame before once more.
    let moves = parameters.iter().any(|frame| frame.motion != QuantisedPose::default());
    assert!(moves || !has("p-frames") || name.contains("paper"), "{name}: its P frames have no motion");
    assert!(!has("halved") || parameters.iter().all(|frame| frame.halved), "{name}: it is not in halves");
    assert!(!name.contains("firings") || scanners.len() == 1, "{name}: no scanner was found in it");
}

/// On one platform only: others round sines and arc tangents differently, and the fit of the scanner uses
/// these.
#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn the_encoder_writes_every_golden_stream() {
    for (name, make) in recipes() {
        let expected = fs::read(folder().join(&name).with_extension("lpc")).unwrap();
        // The streams of the folder are decoded by another test.
        let written = make(encode_files);
        // Not by a checksum of the stream: as its parts end in theirs, that is the same whatever they hold.
        let first = written.iter().zip(&expected).position(|(a, b)| a != b);
        assert!(
            written == expected,
            "{name}: the encoder has changed: {} bytes, not {}, the first at {first:?}",
            written.len(),
            expected.len()
        );
    }
}

#[test]
#[ignore = "writes testdata/golden"]
fn write_golden() {
    drop(fs::remove_dir_all(folder()));
    fs::create_dir_all(folder()).unwrap();
    for (name, make) in recipes() {
        let path = folder().join(name).with_extension("lpc");
        let stream = make(round_trip);
        let files = decode_files(&stream).unwrap();
        fs::write(path.with_extension("txt"), list(&files)).unwrap();
        fs::write(&path, stream).unwrap();
        println!("{}: {} files", path.display(), files.len());
    }
}

/// The contents of a file in firing order.
#[derive(Clone, Copy, PartialEq)]
enum Cells {
    /// Returns only.
    Returns,
    /// Also blanks, which are zeros.
    Full,
    /// Also blanks, row after row.
    Lines,
    /// Second returns of some cells.
    Echoes,
    /// Returns at ticks that increase within a firing.
    Timed,
}

/// Two scans of a made-up scanner of the `firings` family that stands still.
fn firings_files(recipe: firings::Recipe, cells: Cells) -> Vec<File> {
    let mut scanner = common::firings::made_up(recipe);
    if cells == Cells::Lines {
        scanner = scanner.line_by_line((0..32).rev().collect());
    }
    if cells == Cells::Timed {
        scanner = common::firings::timed(&scanner);
    }
    // Ticks within a firing can be determined only from consecutive firings.
    let image = common::firings::image(&scanner, if cells == Cells::Timed { 1 } else { 12 });
    let image = match cells {
        Cells::Echoes => common::firings::with_echoes(image),
        _ => RangeImage { is_full: matches!(cells, Cells::Full | Cells::Lines), ..image },
    };
    let mut points = common::firings::points(&scanner, &image);
    if cells == Cells::Timed {
        points.truncate(4320);
    }
    named(&[points.clone(), points])
}

/// A scan of a VLP-16 that a program moved to the frame of a vehicle.
fn mounted_files(mover: common::firings::Mover) -> Vec<File> {
    let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 1, thinning: 3, ..small(4, 2) };
    let moved = |scan: &common::scans::Points| mover.moved(scan, [1.3, -2.1, 91.7], [1.2, 0.3, 1.9]);
    named(&scans(&config).iter().map(moved).collect::<Vec<_>>())
}

/// A scan of a scanner whose beams start away from the axis, moved to the frame of a vehicle.
fn mounted_off_axis_files() -> Vec<File> {
    let scanner = common::firings::made_up(firings::Recipe::RoboSense);
    let image = RangeImage { is_full: false, ..common::firings::image(&scanner, 4) };
    let points = common::firings::points(&scanner, &image);
    named(&[common::firings::Mover::Pcl.moved(&points, [1.0, -2.0, 30.0], [0.5, 0.1, 1.6])])
}

/// Two scans of an HDL-64E or a VLP-16 in files with other axes than the scanner's: y is up.
fn y_up_files(scanner: SynthScanner) -> Vec<File> {
    let config = SynthConfig { scanner, frames: 2, thinning: 6, ..small(8, 2) };
    let turned = |scan: &common::scans::Points| {
        scan.iter().map(|[x, y, z, intensity]| [-y, *z, -x, *intensity]).collect::<Vec<_>>()
    };
    named(&scans(&config).iter().map(turned).collect::<Vec<_>>())
}

/// Scans of a VLP-16 with the time of each point as ROS' driver computes it: that of its packet, of 24
/// firings, and that of its firing and laser, added in single precision. The second scan begins within a
/// packet.
fn timed_files() -> Vec<File> {
    let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 2, thinning: 6, ..small(6, 2) };
    let timed = |(scan, first): (&common::scans::Points, usize)| {
        let (mut firing, mut last) = (first, None);
        let times: Vec<f32> = scan
            .iter()
            .map(|[x, y, z, _]| {
                let degrees = z.atan2(x.hypot(*y)).to_degrees().round() as i32;
                // Lasers fire in the order of elevations -15, 1, -13, 3 and so on.
                let slot = if degrees < 0 { degrees + 15 } else { degrees };
                firing += usize::from(last.is_some_and(|last| slot <= last));
                last = Some(slot);
                let packet = (firing / 24 * 1327 + firing / 24 * firing / 24 % 50) as f64 * 1e-6;
                let of_firing = ((firing % 24) as f64 * 55.296 + f64::from(slot) * 2.304) * 1e-6;
                of_firing as f32 + packet as f32
            })
            .collect();
        common::formats::pcd("x y z intensity time", "4 4 4 4 4", "F F F F F", scan, |n, point| {
            [&point.map(f32::to_le_bytes).concat()[..], &times[n].to_le_bytes()].concat()
        })
    };
    let files = scans(&config).iter().zip([0, 7]).map(timed).collect::<Vec<_>>();
    (0..).zip(files).map(|(n, file)| (format!("{n}.pcd"), file)).collect()
}

/// A scan that was not rounded before it was moved, field after field, and one of which nothing tells that.
fn unrounded_files() -> Vec<File> {
    let scan = common::firings::unrounded_hdl_32e(180.0, -0.090_805, 1);
    let by_field = (0..4).flat_map(|field| scan.iter().map(move |point| point[field]));
    let by_field = by_field.flat_map(f32::to_le_bytes).collect();
    vec![("0.bin".to_owned(), by_field), ("1.bin".to_owned(), common::formats::kitti(&scan))]
}

/// Two scans of a VLP-16 whose coordinates were rounded to this number of decimal places; zeros have both
/// signs.
fn rounded_files(places: i32) -> Vec<File> {
    let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 2, thinning: 12, ..small(5, 2) };
    let mut scans: Vec<_> = scans(&config).iter().map(|scan| rounded(scan, places)).collect();
    scans[1].iter_mut().step_by(50).for_each(|point| point[1] = point[1].signum() * 0.0);
    named(&scans)
}

/// Two scans that were moved by their time stamps, and sorted by them.
fn stamped_files() -> Vec<File> {
    let scanner = common::firings::made_up(firings::Recipe::Pandar64);
    let (points, rows, times) = common::firings::stamped(&scanner, &common::firings::image(&scanner, 6), 3);
    let file = |(number, motion): (usize, [[f64; 3]; 2])| {
        let [rotation, translation] = motion;
        let points = common::firings::moved_by_stamps(&points, &times, rotation, translation);
        let (points, rows) =
            (common::firings::sorted(&points, &times), common::firings::sorted(&rows, &times));
        (format!("{number}.pcd"), common::formats::pcd_stamped(&points, &rows, &times))
    };
    let motions = [[[1e-5, -2e-5, 3e-5], [1e-4, 0.0, -5e-5]], [[0.001, 1e-4, 0.002], [0.8, 0.1, -0.02]]];
    motions.into_iter().enumerate().map(file).collect()
}

/// A scanner that does not move, seen by few beams.
fn standing_still_files() -> Vec<File> {
    let still = SynthConfig { speed: 0.0, yaw_rate: 0.0, noise: 0.004, beams: 2, ..small(9, 3) };
    named(&scans(&SynthConfig { thinning: 1, ..still }))
}

/// Two alternating scanners, as messages of a recording.
fn turns() -> Vec<u8> {
    let scans = [small(3, 2), SynthConfig { beams: 4, ..small(7, 2) }].map(|config| scans(&config));
    let message = |number: usize| {
        let (track, turn) = (number % 2, number / 2);
        let time =
            Time { source: TimeSource::Recording, nanoseconds: 1_316_998_000_000_000_000 + number as i64 };
        let stamp = Stamp { kind: FrameKind::Message, track: track as u8, time: Some(time) };
        FrameInput::memory(format!("{track}-{turn}.bin"), kitti(&scans[track][turn])).stamped(stamp)
    };
    let mut stream = Vec::new();
    encode(&(0..4).map(message).collect::<Vec<_>>(), &EncoderConfig::default(), &mut stream, &|| ()).unwrap();
    stream
}

/// Two drives with their own scanners, and the files beside their scans: text, an incompressible file, a file
/// with the same name as a scan, and an empty folder.
fn tree() -> Vec<u8> {
    let scan = |seed| kitti(&scans(&small(seed, 1))[0]);
    let frame = |drive: usize, name: &str, bytes| FrameInput::memory(name.to_owned(), bytes).of_drive(drive);
    let beside = Stamp { kind: FrameKind::Beside, ..Stamp::default() };
    let noise: Vec<u8> =
        random_points(20, 3).as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
    let frames = [
        frame(0, "a/data/0.bin", scan(3)),
        frame(1, "b/data/0.bin", scan(8)),
        frame(2, "a/poses.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n".repeat(20)).stamped(beside),
        frame(2, "a/image/0.png", noise.clone()).stamped(beside),
        frame(2, "b/labels/0.bin", noise).stamped(beside),
        frame(2, "b/none/", Vec::new()).stamped(beside),
    ];
    let mut stream = Vec::new();
    encode(&frames, &EncoderConfig::default(), &mut stream, &|| ()).unwrap();
    stream
}

/// A stream for each feature.
fn recipes() -> Vec<Recipe> {
    let mut recipes: Vec<Recipe> = Vec::new();
    for mover in common::firings::Mover::ALL {
        let name = format!("exact-firings-mounted-{}", format!("{mover:?}").to_lowercase());
        let make = move |encode: Encode| encode(&mounted_files(mover), &EncoderConfig::default());
        recipes.push((name, Box::new(make)));
    }
    let mut exact = |name: &str, files: fn() -> Vec<File>, config: EncoderConfig| {
        recipes.push((format!("exact-{name}"), Box::new(move |encode| encode(&files(), &config))));
    };
    // Two frames a group, so that there is more than one group; then P frames wherever possible.
    let every = PredictionChoice::EveryReference;
    let p_frames = |level| EncoderConfig { prediction: every, ..at_level(level) };
    for (level, name) in MODELLINGS {
        exact(name, altered_files(level), EncoderConfig { gop: 2, ..at_level(level) });
        if level > 3 {
            exact(&format!("{name}-p-frames"), moving_files, p_frames(level));
            exact(&format!("{name}-halved"), halved_files, halved(p_frames(level)));
        }
    }
    exact("odd-files", odd_files, EncoderConfig::default());
    exact(
        "lzma-odd-files",
        odd_files,
        EncoderConfig { coder: Coder::Backend(LZMA), ..EncoderConfig::default() },
    );
    exact("ply", ply_files, EncoderConfig::default());
    exact("tables", table_files, EncoderConfig::default());
    exact("arrow", arrow_files, EncoderConfig::default());
    exact("float32", || float_files(10), EncoderConfig::default());
    exact("float32-deep", || float_files(DEEP), at_level(9));
    exact("single-precision", single_precision_files, EncoderConfig::default());
    exact("compensated", compensated_files, EncoderConfig::default());
    exact(
        "firings-blanks",
        || firings_files(firings::Recipe::DoubleYAhead, Cells::Full),
        EncoderConfig::default(),
    );
    exact(
        "firings-lines",
        || firings_files(firings::Recipe::SingleRangeXAhead, Cells::Lines),
        EncoderConfig::default(),
    );
    exact(
        "firings-echoes",
        || firings_files(firings::Recipe::Nebula, Cells::Echoes),
        EncoderConfig::default(),
    );
    exact(
        "firings-off-axis",
        || firings_files(firings::Recipe::RoboSense, Cells::Timed),
        EncoderConfig::default(),
    );
    exact(
        "firings-off-axis-early",
        || firings_files(firings::Recipe::RoboSenseEarly, Cells::Returns),
        EncoderConfig::default(),
    );
    exact("firings-mounted-off-axis", mounted_off_axis_files, EncoderConfig::default());
    exact("y-up", || y_up_files(SynthScanner::Hdl64), EncoderConfig::default());
    exact("firings-y-up", || y_up_files(SynthScanner::Vlp16), EncoderConfig::default());
    exact("firings-mounted-unrounded", unrounded_files, EncoderConfig::default());
    exact(
        "firings-lslidar",
        || firings_files(firings::Recipe::LsLidar, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-apollo",
        || firings_files(firings::Recipe::Apollo, Cells::Returns),
        EncoderConfig::default(),
    );
    exact("firings-once", || firings_files(firings::Recipe::Once, Cells::Returns), EncoderConfig::default());
    exact(
        "firings-nebula-january-2023",
        || firings_files(firings::Recipe::NebulaJanuary2023, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-nebula-april-2023",
        || firings_files(firings::Recipe::NebulaApril2023, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-nebula-april-2023-pandar40",
        || firings_files(firings::Recipe::NebulaApril2023Pandar40, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-nebula-june-2023-pandar40",
        || firings_files(firings::Recipe::NebulaJune2023Pandar40, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-nebula-2025",
        || firings_files(firings::Recipe::Nebula2025, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-hesai-general-sdk",
        || firings_files(firings::Recipe::HesaiGeneralSdk, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-hesai-sdk-2",
        || firings_files(firings::Recipe::HesaiSdk2, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-ros-rslidar",
        || firings_files(firings::Recipe::RosRslidar, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-pandar64-in-degrees",
        || firings_files(firings::Recipe::Pandar64InDegrees, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-off-axis-fused",
        || firings_files(firings::Recipe::RoboSenseFused, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-off-axis-early-fused",
        || firings_files(firings::Recipe::RoboSenseEarlyFused, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-focal-point",
        || firings_files(firings::Recipe::VelodyneDecoder, Cells::Returns),
        EncoderConfig::default(),
    );
    exact(
        "firings-hdl32e-heights",
        || firings_files(firings::Recipe::VelodyneDecoderHdl32e, Cells::Echoes),
        EncoderConfig::default(),
    );
    exact("firings-ouster", || named(&[ouster(16, OusterDriver::Sdk)]), EncoderConfig::default());
    exact("firings-ouster-ros", || named(&[ouster(16, OusterDriver::Ros)]), EncoderConfig::default());
    exact("firings-ouster-early", || named(&[ouster(16, OusterDriver::Early)]), EncoderConfig::default());
    let ouster_fields = || vec![("0.pcd".to_owned(), common::firings::ouster_fields(16))];
    for (level, name) in [(1, "-packed"), (3, "-fitted-tokens"), (6, "")] {
        exact(&format!("firings-ouster-fields{name}"), ouster_fields, at_level(level));
    }
    exact("firings-turned", || named(&[common::firings::vlp_32c(12)]), EncoderConfig::default());
    exact("firings-millimetres", || rounded_files(3), EncoderConfig::default());
    exact("firings-centimetres", || rounded_files(2), EncoderConfig::default());
    exact("firings-timed", timed_files, EncoderConfig::default());
    exact("firings-stamped", stamped_files, EncoderConfig::default());
    exact("standing-still", standing_still_files, EncoderConfig::default());
    exact("firings-packed", || firing_files(12), at_level(1));
    exact("firings", || firing_files(12), at_level(6));
    exact("firings-deep", || firing_files(DEEP), at_level(9));
    for (level, name) in [(1, "-packed"), (3, "-fitted-tokens"), (6, ""), (9, "-deep")] {
        exact(&format!("trails{name}"), trail_files, at_level(level));
    }

    let mut lossy = |name: &str, files: fn() -> Vec<File>, config: EncoderConfig| {
        recipes.push((name.to_owned(), Box::new(move |_| encode_files(&files(), &config))));
    };
    let bounded = EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 });
    for (level, name) in MODELLINGS {
        let config = EncoderConfig { level: at_level(level).level, ..bounded.clone() };
        lossy(&format!("bounded-{name}"), altered_files(level), config);
    }
    let rounded = EncoderConfig {
        intensity: IntensityFidelity::Rounded { step_millionths: 50_000 },
        ..EncoderConfig::preset(Mode::Bounded { max_error_um: 500 })
    };
    lossy("bounded-rounded-odd-files", odd_files, rounded.clone());
    lossy("bounded-ply", ply_files, rounded.clone());
    lossy("bounded-tables", table_files, rounded);
    lossy("bounded-arrow", arrow_files, bounded.clone());
    lossy("bounded-single-precision", single_precision_files, bounded.clone());
    lossy("bounded-compensated", compensated_files, bounded);
    for backend in BACKENDS {
        lossy(&format!("paper-{}", backend.name()), two_scans, with_back_end(backend.id()));
    }
    for codec in ImageCodec::ALL {
        let config = EncoderConfig {
            coder: Coder::Image(codec),
            image: ImageConfig { passes: 3, rate: Rate::Bits(16.0) },
            ..with_back_end(LZMA)
        };
        lossy(&format!("paper-{}", codec.name()), two_scans, config);
    }
    for (coder, name) in [(Coder::Context, "context"), (Coder::Backend(LZMA), "lzma")] {
        let config = EncoderConfig {
            coder,
            intensity: IntensityFidelity::Exact,
            prediction: every,
            ..with_back_end(LZMA)
        };
        lossy(&format!("paper-{name}-p-frames"), twice_the_same, config);
    }
    // This is detected in whole sweeps only, which have many points, so the section is inserted.
    recipes.push((
        "exact-through-a-map".to_owned(),
        Box::new(|_| {
            let (scanners, groups) = moved_through_a_map(&KNOWN[1]);
            put_together(&scanners, &groups)
        }),
    ));
    recipes.push(("two-scanners".to_owned(), Box::new(|_| turns())));
    recipes.push(("tree".to_owned(), Box::new(|_| tree())));
    recipes
}

/// The modelling of each level; levels 7 and 8 differ only in P frames.
const MODELLINGS: [(u8, &str); 6] =
    [(1, "packed"), (2, "tokens"), (3, "fitted-tokens"), (6, "light"), (8, "mixed"), (9, "deep")];

/// The thinning of scans for level 9: the second decoder takes milliseconds for each of their points.
const DEEP: usize = 30;

/// Scans for a level that a scanner explains, one of them with points that it does not.
fn altered_files(level: u8) -> fn() -> Vec<File> {
    if level == 9 { || altered(DEEP, 250) } else { || altered(10, 900) }
}

/// The points `swapped` and 40 of the second scan change places.
fn altered(thinning: usize, swapped: usize) -> Vec<File> {
    let mut frames = scans(&SynthConfig { thinning, ..small(3, 3) });
    let changed = &mut frames[1];
    changed.swap(40, swapped);
    changed.splice(100..100, random_points(30, 1));
    changed[7] = [f32::NAN, f32::INFINITY, -0.0, f32::from_bits(1)];
    named(&frames)
}

/// A moving scanner, and points that it does not explain.
fn halved_files() -> Vec<File> {
    let mut frames = scans(&SynthConfig { beams: 7, thinning: 20, ..small(1, 2) });
    frames[1].splice(100..100, random_points(30, 1));
    named(&frames)
}

/// A moving scanner, with enough points for its motion to be estimated.
fn moving_files() -> Vec<File> {
    named(&scans(&SynthConfig { beams: 8, thinning: 5, ..small(1, 2) }))
}

fn two_scans() -> Vec<File> {
    named(&scans(&small(6, 2)))
}

/// A scan twice, so that the frame before is useful to all coders.
fn twice_the_same() -> Vec<File> {
    named(&vec![scans(&small(6, 1)).swap_remove(0); 2])
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
        ("5-characters.pcd", pcd_characters(some)),
        ("6-ring.pcd.bin", nuscenes(some)),
        ("7-colour.ply", ply(some)),
        ("8-random.bin", kitti(&random_points(200, 2))),
        ("9-no-scan.pcd", b"VERSION 0.7, but damaged".to_vec()),
    ]
    .map(|(name, bytes)| (name.to_owned(), bytes))
    .to_vec()
}

/// PLY in the encodings that need more than a copy.
fn ply_files() -> Vec<File> {
    let frames = scans(&small(3, 2));
    vec![
        ("0-big.ply".to_owned(), ply_big_endian(&frames[0])),
        ("1-text.ply".to_owned(), ply_text(&frames[1])),
    ]
}

/// Columns of text, with separators and ends of all kinds, an array, and records with integer coordinates.
fn table_files() -> Vec<File> {
    let frames = scans(&small(3, 7));
    vec![
        ("0.csv".to_owned(), csv(&frames[0])),
        ("1.txt".to_owned(), columns(&frames[1])),
        ("2.npy".to_owned(), npy(&frames[2])),
        ("4.las".to_owned(), las(&frames[4])),
        (
            "5.npy".to_owned(),
            npy_doubles(&[&frames[5][..], &[[f32::NAN, -f32::NAN, f32::INFINITY, -0.0]]].concat()),
        ),
        ("6.npy".to_owned(), npy_by_column(&frames[6])),
        ("7.txt".to_owned(), padded_columns(&frames[6])),
        (
            "3.xyz".to_owned(),
            String::from_utf8(columns(&frames[3])).unwrap().replace("; ", "\t").replace(';', "").into_bytes(),
        ),
    ]
}

/// Arrow files of pyarrow: half precision, doubles, and columns of more than one LZ4 block; and an array in
/// half precision.
fn arrow_files() -> Vec<File> {
    let vector = |name: &str| fs::read(in_package("testdata/vectors").join(name)).unwrap();
    let frame = &scans(&small(3, 2))[0];
    let names = ["pyarrow.lz4.feather", "pyarrow.plain.feather", "pyarrow.linked.feather"];
    let mut files: Vec<File> = names.map(|name| (name.to_owned(), vector(name))).to_vec();
    files.push(("table.npy".to_owned(), npy_halves(frame)));
    files
}

/// A VLP-16's scans as the ROS driver's records, one of them with points that no scanner explains.
fn firing_files(thinning: usize) -> Vec<File> {
    let config = SynthConfig { scanner: SynthScanner::Vlp16, frames: 2, thinning, ..small(4, 2) };
    let mut frames = scans(&config);
    frames[1].splice(100..100, random_points(10, 1));
    frames[1].swap(300, 500);
    let frames = frames.iter().enumerate();
    frames.map(|(number, points)| (format!("{number}.pcd"), pcd_velodyne(points))).collect()
}

/// Scans of a VLP-16 that no scanner explains, as they were moved with a car: with rings, without, each
/// firing twice with intensities off any grid, in half precision, in steps of 5 mm, and but for the last
/// hundred as differences of a map's coordinates in single precision; and a hundred points, the last one
/// again and again, with some 600 intensities on no grid.
fn trail_files() -> Vec<File> {
    let config = SynthConfig { scanner: SynthScanner::Vlp16, thinning: 2, ..small(9, 4) };
    let mut frames = scans(&config);
    for frame in &mut frames {
        frame.truncate(700);
        *frame = compensated(frame, [0.0005, 0.0011, -0.02], [-0.8, 0.04, 0.01]);
    }
    let twice = frames[2].chunks(16).flat_map(|firing| [firing, firing].concat());
    let off_grid = |[x, y, z, intensity]: [f32; 4]| [x, y, z, intensity * 0.123 + 0.1 * x];
    let twice: Vec<_> = twice.map(off_grid).collect();
    let to_half = |v: f32| f32::from_bits(v.to_bits() & !0x1fff);
    let half: Vec<_> =
        frames[3].iter().map(|&[x, y, z, i]| [to_half(x), to_half(y), to_half(z), i]).collect();
    let (most, rest) = frames[2].split_at(600);
    let through_map =
        |&[x, y, z, i]: &[f32; 4]| [(x + 1000.3) - 1000.3, (y - 12_345.6) + 12_345.6, (z + 80.1) - 80.1, i];
    let squashed = (0..10_000u32).map(|n| {
        let (phase, noise) = (n % 1180, n.wrapping_mul(2_654_435_761) >> 16 & 15);
        let level = phase.min(1180 - phase) + noise;
        let [x, y, z, _] = frames[1][(n as usize).min(99)];
        [x, y, z, (level as f32 / 641.0).sqrt()]
    });
    let squashed: Vec<_> = squashed.collect();
    let mapped: Vec<_> = most.iter().map(through_map).chain(rest.iter().copied()).collect();
    [
        ("0.pcd", pcd_velodyne(&frames[0])),
        ("1.bin", kitti(&frames[1])),
        ("2.bin", kitti(&twice)),
        ("3.bin", kitti(&half)),
        ("4.bin", nclt(&frames[0])),
        ("5.bin", kitti(&mapped)),
        ("6.bin", kitti(&squashed)),
    ]
    .map(|(name, bytes)| (name.to_owned(), bytes))
    .to_vec()
}

/// A scanner whose coordinates were not rounded to the millimetre.
fn float_files(thinning: usize) -> Vec<File> {
    let config = SynthConfig { thinning, ..small(5, 2) };
    let frames = scans(&config).into_iter().enumerate();
    frames.map(|(n, points)| (format!("{n}.bin"), kitti(&unrounded(&config, &points)))).collect()
}

/// The same, computed in single precision.
fn single_precision_files() -> Vec<File> {
    let config = SynthConfig { beams: 2, thinning: 4, ..small(5, 3) };
    let frames = scans(&config).into_iter().enumerate();
    frames.map(|(n, points)| (format!("{n}.bin"), kitti(&single_precision(&config, &points)))).collect()
}

/// Scans that were compensated for the motion within the turn, except for a few points.
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

fn named(frames: &[common::scans::Points]) -> Vec<File> {
    (0..).zip(frames).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
}
