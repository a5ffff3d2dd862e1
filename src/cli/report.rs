//! What several commands report: how accurately points are restored, what is left out of the inputs, and how
//! small the output is.

use crate::container::FrameKind;
use crate::files::sequence::LeftOut;
use crate::frame::{EncoderConfig, IntensityFidelity, PositionFidelity};
use crate::ground::error::one_line;
use crate::stream::EncodeStatistics;
use crate::study::metrics;
use serde::Serialize;

use super::args::EncodeArgs;
use super::readable;

/// How accurately points are restored, in words. If `encoded` is given, also how many points paper mode
/// dropped, or how many scans bounded mode restores exactly.
pub fn fidelity(config: &EncoderConfig, encoded: Option<&EncodeStatistics>) -> String {
    let positions = match (config.positions, encoded) {
        (PositionFidelity::Exact, _) => "lossless".to_owned(),
        (PositionFidelity::Formula, None) => "paper mode".to_owned(),
        (PositionFidelity::Formula, Some(encoded)) => {
            let dropped = encoded.outliers + encoded.lost;
            let share = readable::percent(metrics::ratio(encoded.points, dropped));
            format!("paper mode: {} points dropped ({share})", readable::grouped(dropped))
        }
        (bounded @ PositionFidelity::Bounded { .. }, encoded) => {
            format!("{bounded}{}", encoded.map_or(String::new(), exact_scans))
        }
    };
    match config.intensity {
        IntensityFidelity::Exact => positions,
        intensity @ (IntensityFidelity::None | IntensityFidelity::Rounded { .. }) => {
            format!("{positions}, {intensity}")
        }
    }
}

/// How many scans bounded mode restores exactly, in brackets; nothing if there are none.
fn exact_scans(encoded: &EncodeStatistics) -> String {
    match (encoded.exact, scans(encoded)) {
        (0, _) => String::new(),
        (exact, scans) if exact == scans => " (all exact: the bound saves nothing here)".to_owned(),
        (exact, scans) => format!(" ({exact} of {scans} exact, where the bound saves nothing)"),
    }
}

/// The number of frames that are not files beside the scans.
fn scans(encoded: &EncodeStatistics) -> u64 {
    encoded.frames.len() as u64 - encoded.beside
}

/// The names of files in which no points were recognised, and which are therefore stored as bytes.
fn plain_files(encoded: &EncodeStatistics) -> impl Iterator<Item = &str> {
    let frames = encoded.frames.iter().filter(|frame| frame.stamp.kind != FrameKind::Beside);
    frames.filter(|frame| frame.point_count == 0 && frame.file_size > 0).map(|frame| &frame.name[..])
}

/// A run of `encode` in one line: what was saved, what was lost, and other remarks on the files.
pub fn summary(args: &EncodeArgs, config: &EncoderConfig, encoded: &EncodeStatistics) -> String {
    let (original, coded) = (encoded.file_bytes(), encoded.stream_bytes);
    let of_scans = coded - encoded.beside_coded;
    let resumed = match encoded.resumed_frames {
        0 => String::new(),
        frames => format!(", {frames} of them from the interrupted run"),
    };
    let beside = match encoded.beside {
        0 => String::new(),
        files => format!(
            ", of them {} in {} beside the scans, which alone take {}",
            readable::bytes(encoded.beside_bytes),
            readable::count(files, "file"),
            readable::percent(metrics::ratio(original - encoded.beside_bytes, of_scans))
        ),
    };
    let mut line = format!(
        "{}{resumed}: {} -> {} ({}{beside}, {} bits a point), {}",
        readable::count(scans(encoded), "frame"),
        readable::bytes(original),
        readable::bytes(coded),
        readable::percent(metrics::ratio(original, coded)),
        readable::decimals(metrics::bits_per_point(of_scans, encoded.points)),
        fidelity(config, Some(encoded)),
    );
    let mut plain = plain_files(encoded);
    if let Some(first) = plain.next() {
        let first = one_line(first);
        line.push_str(&match plain.count() {
            0 => format!(", 1 file as plain bytes ({first})"),
            more => format!(", {} files as plain bytes (such as {first})", more + 1),
        });
    }
    if encoded.unmodelled > 0 {
        line.push_str(&format!(
            ", {} without a model that fits",
            readable::count(encoded.unmodelled, "frame")
        ));
    }
    if args.verify {
        line.push_str(what_was_verified(config));
    }
    line
}

/// What `encode --verify` has compared.
fn what_was_verified(config: &EncoderConfig) -> &'static str {
    match config.positions {
        _ if config.is_exact() => {
            ", verified (names and bytes; times and permissions of files are not stored)"
        }
        PositionFidelity::Bounded { .. } => ", verified (names, and that all points are within the bound)",
        _ => ", verified (names, and that every frame decodes as it did while it was encoded)",
    }
}

/// The machine-readable report on a stream that `encode` wrote.
#[derive(Serialize)]
pub struct StreamReport {
    pub file: String,
    #[serde(flatten)]
    fidelity: FidelityReport,
    pub frames: u64,
    /// Files beside the scans; their bytes are included in `file_bytes`.
    files_beside: u64,
    bytes_beside: u64,
    /// Whether the output was complete before, so that nothing was encoded.
    pub was_complete: bool,
    resumed_frames: u64,
    points: u64,
    outliers_dropped: u64,
    points_lost: u64,
    pub file_bytes: u64,
    pub stream_bytes: u64,
    ratio: Option<f64>,
    bits_per_point: Option<f64>,
    /// Names of files in which no points were recognised.
    plain_bytes: Vec<String>,
    unmodelled_frames: u64,
    exact_frames: u64,
    left_out: Vec<LeftOutReport>,
    verified: bool,
    seconds: f64,
}

impl StreamReport {
    /// The report on a stream that was encoded now, not one that was complete before.
    pub fn of(
        args: &EncodeArgs,
        config: &EncoderConfig,
        encoded: &EncodeStatistics,
        left_out: &LeftOut,
        seconds: f64,
    ) -> Self {
        let (file_bytes, stream_bytes) = (encoded.file_bytes(), encoded.stream_bytes);
        let of_scans = stream_bytes - encoded.beside_coded;
        StreamReport {
            file: args.output().display().to_string(),
            fidelity: FidelityReport::of(config),
            frames: scans(encoded),
            files_beside: encoded.beside,
            bytes_beside: encoded.beside_bytes,
            was_complete: false,
            resumed_frames: encoded.resumed_frames,
            points: encoded.points,
            outliers_dropped: encoded.outliers,
            points_lost: encoded.lost,
            file_bytes,
            stream_bytes,
            ratio: metrics::ratio(file_bytes, stream_bytes),
            bits_per_point: metrics::bits_per_point(of_scans, encoded.points),
            plain_bytes: plain_files(encoded).map(str::to_owned).collect(),
            unmodelled_frames: encoded.unmodelled,
            exact_frames: encoded.exact,
            left_out: LeftOutReport::of(left_out),
            verified: args.verify,
            seconds,
        }
    }
}

/// How accurately points are restored, machine-readable.
#[derive(Serialize)]
pub struct FidelityReport {
    mode: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_error_m: Option<f64>,
}

impl FidelityReport {
    /// The report on points that are encoded with these settings.
    pub fn of(config: &EncoderConfig) -> Self {
        let (mode, max_error_m) = match config.positions {
            PositionFidelity::Exact => ("exact", None),
            PositionFidelity::Bounded { max_error_um, .. } => {
                ("bounded", Some(f64::from(max_error_um) * 1e-6))
            }
            PositionFidelity::Formula => ("paper", None),
        };
        FidelityReport { mode, max_error_m }
    }
}

/// The items of one kind that were left out of the inputs, machine-readable.
#[derive(Serialize)]
pub struct LeftOutReport {
    what: &'static str,
    count: u64,
    bytes: u64,
    first: String,
}

impl LeftOutReport {
    /// A report for each kind of item that was left out.
    pub fn of(left_out: &LeftOut) -> Vec<Self> {
        let each = left_out.0.iter().map(|(kind, paths)| LeftOutReport {
            what: kind.name(),
            count: paths.count,
            bytes: paths.bytes,
            first: paths.first.clone(),
        });
        each.collect()
    }
}
