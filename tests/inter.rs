//! P frames: frames predicted from the one before.

use std::sync::LazyLock;

use crate::common::formats::kitti;
use crate::common::scans::{random_points, scans};
use crate::common::streams::at_level;
use crate::common::{File, decode_files, encode_files, put_together, round_trip, take_apart};
use lidarpc::internals::backend::BACKENDS;
use lidarpc::internals::container::{CodedFrame, Section, SectionKind};
use lidarpc::internals::frame::settings::{
    Coder, EncoderConfig, FrameOrder, Mode, PredictionChoice, ProjectionKind,
};
use lidarpc::internals::frame::{FrameParameters, Prediction};
use lidarpc::internals::study::synth::SynthConfig;

/// A drive of five frames.
static DRIVE: LazyLock<Vec<File>> = LazyLock::new(|| {
    let frames = scans(&SynthConfig { frames: 5, beams: 32, thinning: 4, ..SynthConfig::default() });
    (0..).zip(&frames).map(|(number, points)| (format!("{number}.bin"), kitti(points))).collect()
});

fn frames(stream: &[u8]) -> Vec<CodedFrame> {
    take_apart(stream).1.into_iter().flat_map(|group| group.frames).collect()
}

fn predictions(stream: &[u8]) -> Vec<Prediction> {
    frames(stream).iter().map(|frame| FrameParameters::of(frame).unwrap().prediction).collect()
}

fn sizes(stream: &[u8]) -> Vec<usize> {
    let size = |frame: &CodedFrame| frame.sections.iter().map(|section| section.payload.len()).sum();
    frames(stream).iter().map(size).collect()
}

fn intra() -> EncoderConfig {
    EncoderConfig { prediction: PredictionChoice::Always(Prediction::None), ..at_level(8) }
}

const I: Prediction = Prediction::None;
const P: Prediction = Prediction::Inter;

#[test]
fn p_frames_come_back_and_are_smaller() {
    let inter = round_trip(&DRIVE, &at_level(8));
    let intra = round_trip(&DRIVE, &intra());
    assert_eq!(predictions(&inter), [I, P, P, P, P]);
    assert_eq!(predictions(&intra), [I; 5]);
    let [inter, intra] = [sizes(&inter), sizes(&intra)];
    assert_eq!(inter[0], intra[0]);
    for (inter, intra) in inter.iter().zip(&intra).skip(1) {
        assert!(inter < intra, "{inter} bytes, {intra} without the frame before");
    }
}

#[test]
fn quicker_levels_take_p_frames_if_told() {
    let told = EncoderConfig { prediction: PredictionChoice::EveryReference, ..at_level(6) };
    assert_eq!(predictions(&round_trip(&DRIVE, &told)), [I, P, P, P, P]);
    assert_eq!(predictions(&round_trip(&DRIVE, &at_level(6))), [I; 5]);
    let told = EncoderConfig { level: at_level(3).level, ..told };
    assert!(told.check().unwrap_err().to_string().contains("inter prediction needs level 6"));
}

#[test]
fn where_the_scanner_stands_still_quicker_levels_take_p_frames_by_themselves() {
    let standing = SynthConfig { speed: 0.0, yaw_rate: 0.0, noise: 0.004, ..SynthConfig::default() };
    let frames = scans(&SynthConfig { frames: 3, beams: 8, ..standing });
    let drive: Vec<File> =
        (0..).zip(&frames).map(|(number, points)| (format!("{number}.bin"), kitti(points))).collect();
    for level in [6, 7] {
        let inter = round_trip(&drive, &at_level(level));
        assert_eq!(predictions(&inter), [I, P, P], "level {level}");
        let alone = EncoderConfig { prediction: PredictionChoice::Always(I), ..at_level(level) };
        let [inter, alone] = [inter, round_trip(&drive, &alone)].map(|stream| sizes(&stream)[2]);
        assert!(inter * 20 < alone * 19, "level {level}: {inter} bytes, {alone} without the frame before");
    }
    assert_eq!(predictions(&round_trip(&drive, &at_level(3))), [I; 3]);
}

#[test]
fn orders_and_groups_say_which_frames_are_p_frames() {
    let coded = |order, gop| predictions(&encode_files(&DRIVE, &EncoderConfig { order, gop, ..at_level(8) }));
    assert_eq!(coded(FrameOrder::Time, 5), [I, P, I, P, I]);
    assert_eq!(coded(FrameOrder::Time, 3), [I, P, I, I, P]);
    assert_eq!(coded(FrameOrder::Ratio, 2), [I, P, I, P, I]);
    assert_eq!(coded(FrameOrder::Ratio, 1), [I; 5]);
}

#[test]
fn a_frame_that_shows_something_else_costs_hardly_more_than_alone() {
    let other = scans(&SynthConfig { frames: 1, beams: 32, thinning: 4, seed: 99, ..SynthConfig::default() });
    let mut files = DRIVE.clone();
    files[2].1 = kitti(&other[0]);
    files.insert(3, ("2a.bin".to_owned(), Vec::new()));
    files.insert(4, ("2b.bin".to_owned(), kitti(&random_points(50, 1))));
    files.insert(5, ("2c.bin".to_owned(), kitti(&[[5.0, 0.0, 0.0, 0.5]])));
    let [inter, intra] = [at_level(8), intra()].map(|config| sizes(&round_trip(&files, &config)));
    for (inter, intra) in inter.iter().zip(&intra) {
        // P frames adapt the models somewhat differently from I frames, which shows first with random points.
        // These frames are small, the smallest with one point: the ends of arithmetic codes may differ by a
        // byte.
        assert!(*inter <= intra + intra / 30 + 1, "{inter} bytes, {intra} without the frame before");
    }
}

#[test]
fn every_back_end_decodes_its_p_frames() {
    let paper = EncoderConfig {
        projection: ProjectionKind::Ideal { columns: 500, range_step_um: 5000 },
        prediction: PredictionChoice::Smallest,
        level: at_level(8).level,
        ..EncoderConfig::preset(Mode::Paper)
    };
    let coders: Vec<_> = BACKENDS.iter().map(|backend| Coder::Backend(backend.id())).collect();
    let still = vec![DRIVE[0].clone(), ("0a.bin".to_owned(), DRIVE[0].1.clone()), DRIVE[1].clone()];
    for coder in coders.into_iter().chain([Coder::Context]) {
        for config in [EncoderConfig { coder, ..paper.clone() }, EncoderConfig { coder, ..at_level(8) }] {
            let stream = encode_files(&still, &config);
            assert_eq!(predictions(&stream)[1], P, "{coder:?}: a scan twice");
            let decoded = decode_files(&stream).unwrap();
            // The header of each frame has the checksum of the encoder's result, with which decoding
            // compares.
            assert_eq!(decoded.len(), still.len());
        }
    }
}

#[test]
fn images_of_very_many_cells_are_coded_alone() {
    let with_columns = |columns| EncoderConfig {
        projection: ProjectionKind::Ideal { columns, range_step_um: 5000 },
        coder: Coder::Backend(lidarpc::internals::backend::LZMA),
        prediction: PredictionChoice::EveryReference,
        ..EncoderConfig::preset(Mode::Paper)
    };
    assert_eq!(predictions(&encode_files(&DRIVE[..2], &with_columns(1000)))[1], P);
    // 64 rows of so many columns are more than 2^22 cells.
    let stream = encode_files(&DRIVE[..2], &with_columns(66_000));
    assert!(!predictions(&stream).contains(&P));
    assert_eq!(decode_files(&stream).unwrap().len(), 2);
}

#[test]
fn the_stream_does_not_depend_on_threads() {
    let with = |threads| encode_files(&DRIVE, &EncoderConfig { threads, gop: 2, ..at_level(8) });
    assert!(with(1) == with(8));
}

#[test]
fn a_p_frame_without_the_one_before_is_an_error() {
    let (scanners, mut groups) = take_apart(&encode_files(&DRIVE, &at_level(8)));
    let parameters = FrameParameters { prediction: P, ..FrameParameters::default() };
    let section = Section { kind: SectionKind::Parameters, payload: parameters.to_payload() };
    let first = &mut groups[0].frames[0].sections[0];
    assert_eq!(std::mem::replace(first, section).kind, SectionKind::Parameters);
    let error = decode_files(&put_together(&scanners, &groups)).unwrap_err().to_string();
    assert!(error.contains("no frame before"), "{error}");
}
