//! Small streams that use every section, to be damaged.

use std::sync::LazyLock;

use lidarpc::internals::article::image_coding::ImageCodec;
use lidarpc::internals::backend::{self, BACKENDS, Level};
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::internals::stream::container::{Group, ScannerRecord};

use super::formats::{kitti, pcd_extra, pcd_text};
use super::scans::{compensated, random_points, scans, small};
use super::{File, encode_files, take_apart};

/// Scanners and groups.
pub type Parts = (Vec<ScannerRecord>, Vec<Group>);

/// Small streams that use every section between them, taken apart.
pub static STREAMS: LazyLock<Vec<Parts>> = LazyLock::new(|| {
    let frames = scans(&small(3, 3));
    let mut odd = frames[1].clone();
    odd.swap(40, 900);
    odd.splice(100..100, random_points(40, 1));
    odd[7][3] = f32::NAN;
    let scanner =
        vec![("0.bin", kitti(&frames[0])), ("1.bin", kitti(&odd)), ("2.pcd", pcd_extra(&frames[2]))];
    let still = vec![("0.bin", kitti(&frames[0])), ("1.bin", kitti(&frames[0]))];
    let mut moved = compensated(&frames[0], [0.001, 0.0, 0.03], [-0.8, 0.1, 0.02]);
    moved[3] = [f32::NAN, 1.0, -1.0, 0.5];
    let random = random_points(300, 2);
    let others = vec![
        ("0.bin", [kitti(&random), vec![1; 9]].concat()),
        ("1.pcd", pcd_extra(&random)),
        ("2.pcd", pcd_text(&random)),
        ("3.bin", Vec::new()),
        ("4.ply", b"ply, or not".to_vec()),
    ];
    let coded = |files: &[(&str, Vec<u8>)], config: EncoderConfig| {
        let files: Vec<File> = files.iter().map(|(name, bytes)| (name.to_string(), bytes.clone())).collect();
        take_apart(&encode_files(&files, &EncoderConfig { gop: 20, threads: 1, ..config }))
    };
    let mut streams = vec![
        coded(&scanner, at_level(1)),
        coded(&scanner, at_level(2)),
        coded(&scanner, at_level(3)),
        coded(&scanner, at_level(8)),
        coded(&scanner, EncoderConfig::default()),
        coded(&scanner, at_level(9)),
        coded(&others, EncoderConfig::default()),
        coded(&[("0.bin", kitti(&moved))], EncoderConfig::default()),
        coded(&scanner, with_back_end(backend::LZMA)),
        // P frames, by context, as tokens and by a back-end.
        coded(&still, at_level(9)),
        coded(&still, EncoderConfig::default()),
        coded(
            &still,
            EncoderConfig { prediction: PredictionChoice::Smallest, ..with_back_end(backend::LZMA) },
        ),
    ];
    let by_image = |codec| EncoderConfig { coder: Coder::Image(codec), ..with_back_end(backend::LZMA) };
    streams.extend(ImageCodec::ALL.map(|codec| coded(&still, by_image(codec))));
    let bounded = EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 });
    streams.extend([coded(&scanner, bounded.clone()), coded(&others, bounded)]);
    streams.extend(BACKENDS.iter().map(|backend| coded(&scanner[..1], with_back_end(backend.id()))));
    streams
});

/// Exact mode, quicker or smaller.
pub fn at_level(level: u8) -> EncoderConfig {
    EncoderConfig { level: Level::new(level).unwrap(), ..EncoderConfig::default() }
}

/// Paper mode with a small image.
pub fn with_back_end(id: u8) -> EncoderConfig {
    EncoderConfig {
        projection: ProjectionKind::Ideal { columns: 200, range_step_um: 10_000 },
        coder: Coder::Backend(id),
        ..EncoderConfig::preset(Mode::Paper)
    }
}
