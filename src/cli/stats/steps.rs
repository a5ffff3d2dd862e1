//! `lidarpc stats --steps`: time and size of each coding step.

use std::io::{self, BufReader, Read, Write};

use crate::files::sequence::find_frames;
use crate::frame::{EncoderConfig, ProjectionKind, Stage, StageReport};
use crate::scanner::FLOAT_RANGES;
use crate::stream::{self, DecodeOptions, DecodedFrame, FrameInput};
use anyhow::Result;
use serde::Serialize;

use crate::cli::args::{StatsArgs, encoder_config};
use crate::cli::console::Console;
use crate::cli::encoding::encode_in_memory;
use crate::cli::errors::about;
use crate::cli::input::{is_stream, name_of, open};
use crate::cli::output::print_json;
use crate::cli::readable;

/// The complete report; all values are means over frames.
#[derive(Serialize)]
struct Steps {
    frames: u64,
    /// The range step of paper mode's range image, in words; none if the input is a stream.
    #[serde(skip_serializing_if = "Option::is_none")]
    range_step: Option<String>,
    bytes: Bytes,
    /// Seconds in one thread; none if the input is a stream.
    #[serde(skip_serializing_if = "Option::is_none")]
    encoding_seconds: Option<Times>,
    decoding_seconds: Times,
}

/// The article's Tables II and III.
#[derive(Serialize)]
struct Bytes {
    original: f64,
    after_conversion: f64,
    after_prediction: f64,
    contour_map: f64,
    side_data: f64,
    ranges: f64,
    rest: f64,
    after_coding: f64,
}

/// The article's Tables IV and VI.
#[derive(Serialize)]
struct Times {
    steps: Vec<(&'static str, f64)>,
    total: f64,
}

/// Reports on a stream, or on scans, which are then encoded in memory with the given options.
pub fn run(args: &StatsArgs, console: Console) -> Result<()> {
    let (encoding, decoding, range_step) = if is_stream(&args.input) {
        let input = open(&args.input)?.reader();
        let decoded = decode(input, args, console).map_err(|error| about(error, &name_of(&args.input)))?;
        (None, decoded, None)
    } else {
        let frames = find_frames(std::slice::from_ref(&args.input))?.frames;
        let frames = FrameInput::from_files(frames);
        let config = encoder_config("stats", &args.coding, args.threads.threads);
        let (encoding, stream) = encode_in_memory(&frames, &config, console)?;
        (Some(encoding), decode(&stream[..], args, console)?, range_step(&config))
    };
    let steps = Steps {
        frames: decoding.frames,
        range_step,
        bytes: Bytes::of(&decoding),
        encoding_seconds: encoding.as_ref().map(Times::of),
        decoding_seconds: Times::of(&decoding),
    };
    if args.json {
        return print_json(&steps);
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    steps.print(&mut out)?;
    out.flush()?;
    Ok(())
}

/// The range step, on which all sizes depend.
fn range_step(config: &EncoderConfig) -> Option<String> {
    match config.projection {
        ProjectionKind::Ideal { range_step_um: FLOAT_RANGES, .. } => Some("float32".to_owned()),
        ProjectionKind::Ideal { range_step_um, .. } => {
            Some(format!("steps of {} mm (--step)", f64::from(range_step_um) / 1000.0))
        }
        ProjectionKind::Calibrated { .. } => None,
    }
}

fn decode(
    input: impl Read + Send,
    args: &StatsArgs,
    console: Console,
) -> crate::ground::error::Result<StageReport> {
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let bar = console.bar(None, "decoding");
    let mut stages = StageReport::default();
    let decoded = stream::decode(BufReader::new(input), &options, DecodedFrame::checked, |frame| {
        bar.inc(1);
        stages.add(&frame.stages);
        Ok(())
    });
    bar.finish_and_clear();
    decoded.map(|_| stages)
}

impl Bytes {
    fn of(report: &StageReport) -> Self {
        let mean = |bytes: u64| bytes as f64 / report.frames.max(1) as f64;
        Bytes {
            original: mean(report.original),
            after_conversion: mean(report.converted),
            after_prediction: mean(report.predicted),
            contour_map: mean(report.contour),
            side_data: mean(report.side),
            ranges: mean(report.ranges),
            rest: mean(report.rest),
            after_coding: mean(report.coded()),
        }
    }

    fn rows(&self) -> [(&'static str, f64); 8] {
        [
            ("original", self.original),
            ("after conversion", self.after_conversion),
            ("after prediction", self.after_prediction),
            ("contour map", self.contour_map),
            ("side data", self.side_data),
            ("ranges", self.ranges),
            ("the rest", self.rest),
            ("after coding", self.after_coding),
        ]
    }
}

impl Times {
    fn of(report: &StageReport) -> Self {
        let mean = |seconds: f64| seconds / report.frames.max(1) as f64;
        Times {
            steps: Stage::ALL
                .iter()
                .map(|step| (step.name(), mean(report.time(*step).as_secs_f64())))
                .collect(),
            total: mean(report.total_time().as_secs_f64()),
        }
    }
}

impl Steps {
    fn print(&self, out: &mut impl Write) -> io::Result<()> {
        let ranges = self.range_step.as_ref().map_or(String::new(), |step| format!(", ranges in {step}"));
        writeln!(out, "mean of {}{ranges}\n", readable::count(self.frames, "frame"))?;
        writeln!(out, "{:<20} {:>12}", "bytes", "a frame")?;
        for (name, bytes) in self.bytes.rows() {
            writeln!(out, "{name:<20} {bytes:>12.0}")?;
        }
        let with = |times: Option<f64>| times.map_or("-".to_owned(), |s| format!("{:.2}", 1e3 * s));
        writeln!(out, "\n{:<20} {:>12} {:>12}", "milliseconds", "encoding", "decoding")?;
        for (place, (name, decoding)) in self.decoding_seconds.steps.iter().enumerate() {
            let encoding = self.encoding_seconds.as_ref().map(|times| times.steps[place].1);
            writeln!(out, "{name:<20} {:>12} {:>12}", with(encoding), with(Some(*decoding)))?;
        }
        let encoding = self.encoding_seconds.as_ref().map(|times| times.total);
        writeln!(
            out,
            "{:<20} {:>12} {:>12}",
            "total",
            with(encoding),
            with(Some(self.decoding_seconds.total))
        )
    }
}
