//! The article's codec, and its parts in exact mode.

use std::path::PathBuf;
use std::sync::LazyLock;

use crate::common::formats::{kitti, pcd_extra, pcd_text, ply};
use crate::common::scans::{Points, random_points, scans, small};
use crate::common::{
    File, cases, decode_files, encode_files, first_files, real_folders, round_trip, section_bytes, take_apart,
};
use lidarpc::internals::article::image_coding::{ImageCodec, ImageConfig, Rate};
use lidarpc::internals::article::prediction::intra::{IntraConfig, RegionModels};
use lidarpc::internals::backend::BACKENDS;
use lidarpc::internals::backend::Packing;
use lidarpc::internals::container::SectionKind;
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::internals::frame::{FrameParameters, IntensityFidelity, OriginalFile, Prediction};
use lidarpc::internals::scan::{Channel, PointCloud};
use lidarpc::internals::scanner::hdl64::project_nearest;
use lidarpc::internals::scanner::{FLOAT_RANGES, RangeImage, Return, Scanner, ideal};
use lidarpc::internals::stream::{DecodeOptions, decode};
use lidarpc::internals::study::metrics::NearestErrors;
use proptest::prelude::*;

static SCANS: LazyLock<Vec<Points>> = LazyLock::new(|| scans(&small(1, 3)));

/// Paper mode with a small image.
fn paper() -> EncoderConfig {
    EncoderConfig { projection: image(500, 5000), threads: 1, ..EncoderConfig::preset(Mode::Paper) }
}

fn image(columns: u32, range_step_um: u32) -> ProjectionKind {
    ProjectionKind::Ideal { columns, range_step_um }
}

fn coders() -> impl Iterator<Item = Coder> {
    std::iter::once(Coder::Context).chain(BACKENDS.iter().map(|backend| Coder::Backend(backend.id())))
}

fn named(points: &[Points]) -> Vec<File> {
    (0..).zip(points).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
}

/// The parameters in the first section of a frame.
fn parameters(stream: &[u8]) -> Vec<FrameParameters> {
    let (_, groups) = take_apart(stream);
    let frames = groups.iter().flat_map(|group| &group.frames);
    frames
        .map(|frame| {
            let section = frame.sections.iter().find(|s| s.kind == SectionKind::Parameters).unwrap();
            FrameParameters::from_payload(&section.payload).unwrap()
        })
        .collect()
}

/// Encodes in paper mode and decodes; the decoded points must be those of the encoder's range image, bit for
/// bit, and the counts must be consistent.
fn keeps_the_image(files: &[File], config: &EncoderConfig) -> Vec<File> {
    let ProjectionKind::Ideal { columns, range_step_um } = config.projection else { panic!("no image") };
    let filtered = |cloud: &PointCloud| match config.outliers {
        Some(filter) => filter.filter(cloud),
        None => cloud.clone(),
    };
    let stream = encode_files(files, config);
    // The article's scanner, or one with the lasers of the fitted scanner.
    let record = take_apart(&stream).0.into_iter().next();
    let scanner = record.and_then(|record| Scanner::from_record(record.family, &record.payload).unwrap());
    let found = scanner.as_ref().and_then(Scanner::hdl64).cloned();
    let scanner = found.unwrap_or_else(|| ideal(columns, range_step_um));
    assert_eq!((scanner.ticks, scanner.range_step_um), (columns, range_step_um));
    let decoded = decode_files(&stream).unwrap();
    assert_eq!(decoded.len(), files.len());
    for (((name, bytes), (_, original)), parameters) in decoded.iter().zip(files).zip(parameters(&stream)) {
        let (before, after) = (parse(name, original.clone()), parse(name, bytes.clone()));
        let expected = project_nearest(&scanner, &filtered(&before.cloud)).image;
        let returns = expected.file_order(&scanner);
        let point = |found: &Return| scanner.point(found.row as usize, found.tick, found.steps);
        let same = returns.iter().map(|found| point(found).map(|v| (v as f32).to_bits()));
        assert!(same.eq(after.cloud.positions.iter().map(|p| p.map(f32::to_bits))), "{name} {config:?}");
        let Some(OriginalFile { file_size, points, outliers, lost }) = parameters.source else {
            assert!(before.records == 0 && bytes == original, "{name}");
            continue;
        };
        assert_eq!((file_size, points), (original.len() as u64, before.records as u64));
        assert_eq!(points, outliers + lost + after.records as u64);
        assert_eq!(after.records, expected.returns(), "the file holds as many points as its header says");
    }
    decoded
}

/// The predictions of ranges that this coder supports.
fn predictions(coder: Coder) -> Vec<PredictionChoice> {
    let all = [
        PredictionChoice::Always(Prediction::None),
        PredictionChoice::Always(Prediction::Intra),
        PredictionChoice::Smallest,
    ];
    all.into_iter()
        .filter(|&prediction| EncoderConfig { coder, prediction, ..paper() }.check().is_ok())
        .collect()
}

#[test]
fn every_back_end_keeps_the_image() {
    for coder in coders() {
        for prediction in predictions(coder) {
            keeps_the_image(&named(&SCANS), &EncoderConfig { coder, prediction, ..paper() });
        }
    }
}

#[test]
fn every_setting_keeps_the_image() {
    let files = named(&SCANS[..1]);
    for packing in Packing::ALL {
        for snake in [false, true] {
            keeps_the_image(&files, &EncoderConfig { packing: Some(packing), snake, ..paper() });
        }
    }
    let intra = IntraConfig { models: RegionModels::Fitted, ..IntraConfig::default() };
    keeps_the_image(&files, &EncoderConfig { intra, ..paper() });
    keeps_the_image(&files, &EncoderConfig { outliers: None, ..paper() });
    for projection in [image(1, 1_000_000), image(2000, 1), image(777, 20_000), image(360, FLOAT_RANGES)] {
        keeps_the_image(&files, &EncoderConfig { projection, ..paper() });
    }
    for projection in [image(2000, 100), image(100, 1_000_000)] {
        let prediction = PredictionChoice::Smallest;
        keeps_the_image(&files, &EncoderConfig { projection, coder: Coder::Context, prediction, ..paper() });
    }
}

#[test]
fn intensities_and_other_fields_stay_with_their_points() {
    let files = [("0.pcd".to_owned(), pcd_extra(&SCANS[0]))];
    let config = EncoderConfig { intensity: IntensityFidelity::Exact, ..paper() };
    let decoded = keeps_the_image(&files, &config);
    let before = parse("0.pcd", files[0].1.clone()).cloud;
    let after = parse("0.pcd", decoded[0].1.clone()).cloud;
    let before = config.outliers.unwrap().filter(&before);
    let scanner = ideal(500, 5000);
    let (from, to) = (project_nearest(&scanner, &before), project_nearest(&scanner, &after));
    for row in 0..64 {
        for column in (0..500).filter(|&column| from.image.steps[(row, column)] > 0) {
            let [a, b] = [&from, &to].map(|p| p.point_of_cell[(row, column)] as usize);
            assert_eq!(before.intensity[a].to_bits(), after.intensity[b].to_bits());
            for (before, after) in before.channels.iter().zip(&after.channels) {
                let width = before.field.width();
                assert_eq!(before.bytes[a * width..][..width], after.bytes[b * width..][..width]);
            }
        }
    }
    let dropped = decode_files(&encode_files(&files, &paper())).unwrap();
    assert!(parse("0.pcd", dropped[0].1.clone()).cloud.intensity.iter().all(|value| *value == 0.0));
}

#[test]
fn headers_tell_the_number_of_points_that_are_left() {
    let points = &SCANS[0][..1000];
    // Text rounds coordinates as the original file did, so its points differ from those of the image in the
    // last bits.
    for (name, bytes) in [("a.pcd", pcd_text(points)), ("a.ply", ply(points)), ("a.pcd", pcd_extra(points))] {
        let decoded = decode_files(&encode_files(&[(name.to_owned(), bytes)], &paper())).unwrap();
        let left = parse(name, decoded[0].1.clone());
        assert!(left.records > 0 && left.records < points.len() && left.suffix.is_empty(), "{name}");
        let header = String::from_utf8_lossy(&left.prefix);
        assert!(header.contains(&format!(" {}\n", left.records)), "{header}");
    }
}

#[test]
fn the_calibrated_image_loses_no_point() {
    let config = EncoderConfig {
        projection: ProjectionKind::CALIBRATED,
        outliers: None,
        intensity: IntensityFidelity::Exact,
        ..paper()
    };
    let stream = encode_files(&named(&SCANS), &config);
    for ((_, bytes), before) in decode_files(&stream).unwrap().into_iter().zip(SCANS.iter()) {
        let after = parse("0.bin", bytes).cloud;
        assert_eq!(after.positions.len(), before.len());
        let mut sorted = [after.intensity, before.iter().map(|point| point[3]).collect()];
        sorted.iter_mut().for_each(|values| values.sort_by(f32::total_cmp));
        assert_eq!(sorted[0], sorted[1]);
    }
    assert!(parameters(&stream).iter().all(|p| p.source.is_some_and(|source| source.lost == 0)));
}

#[test]
fn coarser_steps_of_the_calibrated_image_move_points_by_half_a_step() {
    for step_um in [5000, 20_000, 100_000] {
        let projection = ProjectionKind::Calibrated { range_step_um: Some(step_um) };
        let prediction = PredictionChoice::Smallest;
        let config =
            EncoderConfig { projection, outliers: None, coder: Coder::Context, prediction, ..paper() };
        let stream = encode_files(&named(&SCANS), &config);
        for ((_, bytes), before) in decode_files(&stream).unwrap().into_iter().zip(SCANS.iter()) {
            let (after, before) = (parse("0.bin", bytes).cloud, parse("0.bin", kitti(before)).cloud);
            assert_eq!(after.positions.len(), before.positions.len());
            let mut errors = [NearestErrors::default(); 2];
            errors[0].add(&after, &before);
            errors[1].add(&before, &after);
            let most = 0.5e-6 * f64::from(step_um) + 0.006;
            assert!(errors.iter().all(|errors| errors.max().unwrap() < most), "{errors:?}");
        }
    }
}

#[test]
fn odd_scans_are_coded() {
    let plane = |z: f32| (0..3000).map(move |i| [(i % 60) as f32 * 0.2 + 1.0, (i / 60) as f32 * 0.2, z, 0.5]);
    let odd: Vec<Points> = vec![
        vec![],
        vec![[1.0, 2.0, 0.5, 0.25]],
        vec![[5.0, 5.0, 0.1, 0.5]; 500],
        vec![[0.0; 4]; 20],
        vec![[f32::NAN, 1.0, 1.0, 0.5], [f32::INFINITY, 0.0, 0.0, 0.5], [1e30, 0.0, 0.0, 0.5]],
        plane(-1.7).collect(),
        plane(1.0).collect(),
        random_points(5000, 3),
    ];
    for prediction in predictions(paper().coder) {
        for outliers in [None, paper().outliers] {
            keeps_the_image(&named(&odd), &EncoderConfig { prediction, outliers, ..paper() });
        }
    }
}

#[test]
fn scans_without_a_calibrated_image_come_back() {
    let files = named(&[random_points(500, 1), random_points(300, 2)]);
    round_trip(&files, &EncoderConfig { projection: ProjectionKind::CALIBRATED, ..paper() });
}

#[test]
fn files_that_are_no_scans_come_back() {
    let files =
        [("a.pcd".to_owned(), b"VERSION 0.7, but damaged".to_vec()), ("b.bin".to_owned(), vec![1; 5])];
    round_trip(&files, &paper());
}

#[test]
fn every_back_end_is_exact_in_exact_mode() {
    let mut files = named(&SCANS[..2]);
    files.push(("x.bin".to_owned(), kitti(&random_points(300, 5))));
    for coder in coders() {
        for prediction in predictions(coder) {
            round_trip(&files, &EncoderConfig { coder, prediction, ..EncoderConfig::default() });
        }
    }
}

#[test]
fn real_scans_keep_their_image() {
    // Text files and integers have too few digits for the image's points.
    let is_binary = |folder: &&PathBuf| {
        let files = first_files(folder, 1);
        files.iter().all(|(name, bytes)| {
            name.ends_with(".bin")
                && !name.ends_with(".pcd.bin")
                && bytes.len() % 16 == 0
                && parse(name, bytes.clone()).layout.axes().is_none()
        })
    };
    for folder in real_folders().iter().filter(is_binary) {
        let config = EncoderConfig { projection: image(2000, 10_000), ..paper() };
        keeps_the_image(&first_files(folder, 1), &config);
        println!("{}: as expected", folder.display());
    }
}

/// The settings of an image coder with a small image.
fn by_image(codec: ImageCodec, bits: f64, prediction: PredictionChoice) -> EncoderConfig {
    let image = ImageConfig { rate: Rate::Bits(bits), ..ImageConfig::default() };
    EncoderConfig { coder: Coder::Image(codec), image, prediction, ..paper() }
}

const SOURCES: [PredictionChoice; 4] = [
    PredictionChoice::Always(Prediction::None),
    PredictionChoice::Always(Prediction::Intra),
    PredictionChoice::Always(Prediction::Inter),
    PredictionChoice::Smallest,
];

/// The decoded images of a stream, and the original images of its files in the same projection.
fn images(files: &[File], config: &EncoderConfig) -> (Vec<u8>, Vec<[RangeImage; 2]>) {
    let ProjectionKind::Ideal { columns, range_step_um } = config.projection else { panic!("no image") };
    let stream = encode_files(files, config);
    let mut decoded = Vec::new();
    let options = DecodeOptions { images: true, threads: 1, ..DecodeOptions::default() };
    decode(&stream[..], &options, Ok, |frame| {
        decoded.push(frame.image.map(|image| image.image).unwrap_or_default());
        Ok(())
    })
    .unwrap();
    let original = |(name, bytes): &File| {
        let cloud = config.outliers.unwrap().filter(&parse(name, bytes.clone()).cloud);
        project_nearest(&ideal(columns, range_step_um), &cloud).image
    };
    let pairs = decoded.into_iter().zip(files).map(|(decoded, file)| [original(file), decoded]).collect();
    (stream, pairs)
}

/// The error of ranges (equation 12), in steps.
fn error(pairs: &[[RangeImage; 2]]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for [original, decoded] in pairs {
        let cells = original.steps.cells().iter().zip(decoded.steps.cells());
        for (was, is) in cells.filter(|(was, _)| **was > 0) {
            sum += f64::from(was.abs_diff(*is)).powi(2);
            count += 1.0;
        }
    }
    (sum / count).sqrt()
}

#[test]
fn image_coders_spend_what_they_may_and_err_less_for_more() {
    let files = named(&SCANS);
    for codec in ImageCodec::ALL {
        for prediction in SOURCES {
            let mut errors = Vec::new();
            for bits in [5.0, 9.0, 16.0] {
                let (stream, pairs) = images(&files, &by_image(codec, bits, prediction));
                let returns: usize = pairs.iter().map(|[original, _]| original.returns()).sum();
                let sections = section_bytes(&stream);
                let kinds = [SectionKind::Residual, SectionKind::Contour, SectionKind::Regions];
                let spent: usize = kinds.iter().filter_map(|kind| sections.get(kind)).sum();
                assert!(spent as f64 * 8.0 <= bits * returns as f64, "{spent} bytes for {returns} returns");
                for [original, decoded] in &pairs {
                    assert!(original.occupancy() == decoded.occupancy(), "returns come and go");
                }
                errors.push(error(&pairs));
            }
            assert!(errors.is_sorted_by(|more, less| more > less), "{codec:?} {prediction:?} {errors:?}");
        }
    }
}

/// The points of the file are at the decoded ranges, as the encoder expects: a frame's checksum is that of
/// the decoded file.
#[test]
fn lossy_points_are_at_the_decoded_ranges() {
    let files = named(&SCANS);
    let scanner = ideal(500, 5000);
    for codec in ImageCodec::ALL {
        let config = by_image(codec, 3.0, PredictionChoice::Always(Prediction::Inter));
        let (stream, pairs) = images(&files, &config);
        for ((_, bytes), [original, decoded]) in decode_files(&stream).unwrap().into_iter().zip(&pairs) {
            let returns = decoded.file_order(&scanner);
            let point = |found: &Return| scanner.point(found.row as usize, found.tick, found.steps);
            let expected = returns.iter().map(|found| point(found).map(|v| (v as f32).to_bits()));
            let positions = parse("0.bin", bytes).cloud.positions;
            assert!(expected.eq(positions.iter().map(|p| p.map(f32::to_bits))));
            assert!(decoded.steps != original.steps, "nothing was lost");
        }
    }
}

#[test]
fn lossless_jpeg_2000_keeps_the_image() {
    let image = ImageConfig { rate: Rate::Lossless, ..ImageConfig::default() };
    let coder = Coder::Image(ImageCodec::Jpeg2000);
    let files = named(&SCANS);
    for prediction in SOURCES {
        keeps_the_image(&files, &EncoderConfig { coder, image, prediction, ..paper() });
        round_trip(&files[..1], &EncoderConfig { coder, image, prediction, ..EncoderConfig::default() });
    }
}

/// Slightly different ranges change the order of the formula's points in neighbouring columns: the data of a
/// point must follow it.
#[test]
fn lossy_points_of_the_calibrated_image_keep_their_intensities_and_fields() {
    let files: Vec<File> = (0..).zip(SCANS.iter()).map(|(n, p)| (format!("{n}.pcd"), pcd_extra(p))).collect();
    for (codec, bits) in [(ImageCodec::Jpeg, 3.0), (ImageCodec::Jpeg2000, 1.0)] {
        let config = EncoderConfig {
            projection: ProjectionKind::CALIBRATED,
            intensity: IntensityFidelity::Exact,
            outliers: None,
            ..by_image(codec, bits, PredictionChoice::Smallest)
        };
        for ((name, bytes), (_, original)) in
            decode_files(&encode_files(&files, &config)).unwrap().into_iter().zip(&files)
        {
            let [before, after] = [original.clone(), bytes].map(|bytes| parse(&name, bytes).cloud);
            // The intensity and the other fields of every point.
            let all = |cloud: &PointCloud| {
                let fields = |point: usize| -> Vec<u8> {
                    let value = |channel: &Channel| {
                        let width = channel.field.width();
                        channel.bytes[point * width..][..width].to_vec()
                    };
                    cloud.channels.iter().flat_map(value).collect()
                };
                let intensities = cloud.intensity.iter().enumerate();
                let mut all: Vec<_> = intensities.map(|(n, value)| (value.to_bits(), fields(n))).collect();
                all.sort();
                all
            };
            assert!(before.positions != after.positions && all(&before) == all(&after), "{name} {codec:?}");
        }
    }
}

#[test]
fn image_coders_refuse_what_they_cannot_do() {
    let lossy = by_image(ImageCodec::Jpeg2000, 2.0, PredictionChoice::Smallest);
    let lossless = ImageConfig { rate: Rate::Lossless, ..ImageConfig::default() };
    for (wrong, why) in [
        (EncoderConfig { coder: lossy.coder, ..EncoderConfig::default() }, "exact mode"),
        (EncoderConfig { projection: image(500, FLOAT_RANGES), ..lossy.clone() }, "choose a step"),
        (EncoderConfig { coder: Coder::Image(ImageCodec::Jpeg), image: lossless, ..paper() }, "jpeg always"),
        (EncoderConfig { image: ImageConfig { passes: 0, ..lossless }, ..lossy.clone() }, "passes"),
    ] {
        let message = wrong.check().unwrap_err().to_string();
        assert!(message.contains(why) && !message.contains('\n'), "{message}");
    }
}

proptest! {
    #![proptest_config(cases(24))]

    #[test]
    fn any_scan_keeps_its_image(
        coordinates in prop::collection::vec(prop::array::uniform3(-4000i16..4000), 0..300),
        columns in 1u32..400,
        range_step_um in prop::sample::select(vec![FLOAT_RANGES, 1000, 10_000, 250_000]),
        backend in prop::sample::select(BACKENDS.iter().map(|backend| backend.id()).collect::<Vec<_>>()),
        keep_outliers in any::<bool>(),
    ) {
        let points: Points = coordinates
            .iter()
            .map(|[x, y, z]| [f32::from(*x) * 0.01, f32::from(*y) * 0.01, f32::from(*z) * 0.002, 0.5])
            .collect();
        let config = EncoderConfig {
            projection: image(columns, range_step_um),
            coder: Coder::Backend(backend),
            outliers: paper().outliers.filter(|_| !keep_outliers),
            ..paper()
        };
        keeps_the_image(&named(&[points]), &config);
    }
}
