//! `lidarpc encode`

use std::fs::{self, File};
use std::io::{self, BufReader, Seek, Write};
use std::path::PathBuf;
use std::time::Instant;

use crate::container::Unit;
use crate::edit;
use crate::files::sequence::{FoundFile, LeftOut, STREAM_EXTENSION};
use crate::files::{ArrivedFile, ArrivingFrames};
use crate::frame::{EncoderConfig, Intensity, Positions};
use crate::ground::error::Error;
use crate::stream::{self, DecodeOptions, DecodedFrame, Encoded, FrameInput};
use crate::study::metrics;
use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;

use super::args::{EncodeArgs, encoder_config, wrong_usage};
use super::cleanup::SayOnSignal;
use super::errors::about;
use super::frames::{self, Found};
use super::input::is_dash;
use super::output::{FileOutput, check_json, name_of_output, print_json};
use super::partial::{self, PartialOutput};
use super::{messages, progress, recording, table, tree};

pub fn run(args: &EncodeArgs, quiet: bool) -> Result<()> {
    let args = &EncodeArgs { output: Some(output_of(args)), verify: args.verify || args.rm, ..args.clone() };
    let is_piped = args.inputs.iter().any(|input| is_dash(input));
    let mut config = encoder_config("encode", &args.coding, args.threads.threads);
    check(args, &config);
    if args.messages {
        return messages::encode(args, &config, quiet);
    }
    if args.inputs.iter().any(|input| recording::is_recording(input)) {
        return recording::encode(args, &config, quiet);
    }
    if !args.topic.is_empty() {
        wrong_usage("encode", "--topic chooses clouds of a recording; the input is none");
    }
    if tree::is_folder(args.output()) && !is_piped {
        return tree::encode(args, &config, quiet);
    }
    if args.jobs.is_some() {
        wrong_usage("encode", "--jobs counts the drives that are encoded into a folder; the output is none");
    }
    let start = Instant::now();
    let found = match is_piped {
        true => None,
        false => Some(frames::find(args, quiet)?),
    };
    if let Some(found) = &found {
        frames::settle(&found.frames, &mut config, &frames::name_of_inputs(&args.inputs), quiet)?;
    }
    let before = match args.resume && !args.force {
        true => {
            partial::complete(args.output()).map_err(|error| about(error, &name_of_output(args.output())))?
        }
        false => None,
    };
    let was_complete = before.is_some();
    let (encoded, left_out) = match (args.resume, &found) {
        (true, Some(found)) => {
            let encoded = match before {
                Some(stream) => confirm(args, &config, &found.inputs(), stream, quiet)?,
                None => encode_in_runs(args, &config, &found.inputs(), quiet)?,
            };
            (encoded, found.left_out.clone())
        }
        (_, found) => encode_whole(args, &config, found.as_ref(), quiet)?,
    };
    let seconds = start.elapsed().as_secs_f64();
    if args.verbose {
        for (frame, stages) in encoded.frames.iter().zip(&encoded.frame_stages) {
            let (name, original, coded) = (frame.name.escape_debug(), stages.original, stages.coded());
            let share = table::percent(metrics::ratio(original, coded));
            eprintln!("{name}: {} -> {} ({share})", table::bytes(original), table::bytes(coded));
        }
    }
    if args.json {
        let report = Report::of(args, &config, &encoded, &left_out, seconds);
        print_json(&Report { was_complete, ..report })?;
    } else if was_complete && !quiet {
        let (name, frames) =
            (name_of_output(args.output()), table::count(encoded.frames.len() as u64, "frame"));
        let verified = if args.verify { ", verified" } else { "" };
        eprintln!("{name}: already complete, from these {frames} with these settings{verified}");
    } else if !quiet {
        eprintln!("{} in {seconds:.1} s", summary(args, &config, &encoded));
    }
    if let Some(found) = found.filter(|_| args.rm) {
        remove(&found, &args.inputs)?;
    }
    Ok(())
}

/// Ends the program if these options do not go together.
fn check(args: &EncodeArgs, config: &EncoderConfig) {
    let is_piped = args.inputs.iter().any(|input| is_dash(input));
    let is_stdout = is_dash(args.output());
    for (wrong, what) in [
        (args.rm && is_stdout, "--rm needs an output that can be read again, not stdout"),
        (args.rm && is_piped, "--rm deletes files; stdin is none"),
        (args.verify && is_stdout, "--verify needs an output that can be read again, not stdout"),
        (args.resume && is_stdout, "--resume needs an output that stays, not stdout"),
        (args.resume && is_piped, "--resume needs inputs that can be read again, not stdin"),
        (args.all && is_piped, "--all keeps the files of folders, not of stdin"),
        (is_piped && args.inputs.len() > 1, "`-`, for frames from stdin, stands alone"),
    ] {
        if wrong {
            wrong_usage("encode", what);
        }
    }
    check_json("encode", args.json, args.output());
    if args.rm && !config.is_exact() {
        let what = "--rm deletes only what comes back as it was: leave out what makes the output lossy";
        wrong_usage("encode", what);
    }
}

/// The output, or by default a file beside the input, with its name and the extension of streams.
fn output_of(args: &EncodeArgs) -> PathBuf {
    if let Some(output) = &args.output {
        return output.clone();
    }
    let name = match &args.inputs[..] {
        [input] if !is_dash(input) && !recording::is_recording(input) => input.file_name(),
        _ => None,
    };
    let Some(name) = name else {
        let is_recording = args.inputs.len() == 1 && recording::is_recording(&args.inputs[0]);
        wrong_usage(
            "encode",
            match is_recording {
                true => "say where to: by -o FILE.mcap the whole recording, by -o FILE.lpc the clouds alone",
                false => "say where to, by -o FILE: the input gives no name for the output",
            },
        );
    };
    let mut name = name.to_owned();
    name.push(".");
    name.push(STREAM_EXTENSION);
    args.inputs[0].with_file_name(name)
}

/// Deletes the encoded files, and the folders that this leaves empty.
pub fn remove(found: &Found, inputs: &[PathBuf]) -> Result<()> {
    for FoundFile { path, .. } in found.frames.iter().chain(&found.beside) {
        let removed = if path.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
        removed.map_err(|error| about(error.into(), &path.display().to_string()))?;
        let above =
            path.ancestors().skip(1).take_while(|above| inputs.iter().any(|input| above.starts_with(input)));
        // Folders that are not empty remain.
        above.take_while(|above| fs::remove_dir(above).is_ok()).for_each(drop);
    }
    Ok(())
}

/// Encodes to a file that exists only when complete. `found`: the frames, unless they come from stdin.
pub fn encode_whole(
    args: &EncodeArgs,
    config: &EncoderConfig,
    found: Option<&Found>,
    quiet: bool,
) -> Result<(Encoded, LeftOut)> {
    let mut output = FileOutput::binary(args.output(), args.force)?;
    if let Some(left) = partial::left_for(args.output())
        && !quiet
    {
        eprintln!(
            "lidarpc: {} of an interrupted run is left as it is; --resume goes on with it",
            left.display()
        );
    }
    let name = name_of_output(args.output());
    let (encoded, left_out) = match found {
        Some(found) => {
            let encoded = write_files(config, &found.inputs(), &mut output, quiet);
            (encoded.map_err(|error| about(error, &name))?, found.left_out.clone())
        }
        None => {
            let (encoded, left_out) =
                write_live(config, &mut output, quiet).map_err(|error| about(error, &name))?;
            frames::check_left_out(&left_out, "stdin", args.strict, quiet)?;
            if encoded.frames.is_empty() {
                ensure!(
                    !args.strict,
                    "stdin: held no frame; check what writes to it, or encode without --strict"
                );
                if !quiet {
                    eprintln!("lidarpc: stdin: held no frame, and so does {name}");
                }
            }
            (encoded, left_out)
        }
    };
    if args.verify {
        let Some(file) = output.reopen()? else { bail!("--verify needs a file that can be read again") };
        compare(args, &encoded, file, quiet).with_context(|| name.clone())?;
    }
    output.finish().map_err(|error| about(error, &name))?;
    Ok((encoded, left_out))
}

/// Encodes to a file that is kept if this is interrupted, and continues what an interrupted run left.
fn encode_in_runs(
    args: &EncodeArgs,
    config: &EncoderConfig,
    frames: &[FrameInput],
    quiet: bool,
) -> Result<Encoded> {
    let name = name_of_output(args.output());
    let words =
        format!("interrupted; what is done is kept in {name}.partial, and the same command goes on with it");
    let _words = (!quiet).then(|| SayOnSignal::new(words));
    let output = PartialOutput::open(args.output(), args.force)?;
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let encoded =
        output.files().and_then(|files| edit::encode_resuming(frames, config, files, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    if args.verify {
        compare(args, &encoded, output.reopen()?, quiet).with_context(|| name.clone())?;
    }
    output.finish().map_err(|error| about(error, &name))?;
    Ok(encoded)
}

/// Confirms that the output of an earlier run is what this run would write.
///
/// # Errors
/// With what differs.
fn confirm(
    args: &EncodeArgs,
    config: &EncoderConfig,
    frames: &[FrameInput],
    mut stream: File,
    quiet: bool,
) -> Result<Encoded> {
    let name = name_of_output(args.output());
    let bar = progress::bar(Some(frames.len() as u64), "comparing", quiet);
    let encoded = edit::confirm_complete(frames, config, &stream, &|| bar.inc(1));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| match error {
        Error::Usage(what) => {
            let what = format!("exists, but {what}; use --force to overwrite it, or choose another output");
            Error::Input { path: args.output().to_path_buf(), what }.into()
        }
        _ => about(error, &name),
    })?;
    if args.verify {
        stream.rewind().map_err(|error| about(error.into(), &name))?;
        compare(args, &encoded, stream, quiet).with_context(|| name.clone())?;
    }
    Ok(encoded)
}

fn write_files(
    config: &EncoderConfig,
    frames: &[FrameInput],
    output: &mut FileOutput,
    quiet: bool,
) -> crate::ground::error::Result<Encoded> {
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let mut writer = output.writer();
    let encoded = stream::encode(frames, config, &mut writer, &|| bar.inc(1));
    let encoded = encoded.and_then(|encoded| Ok(writer.flush().map(|()| encoded)?));
    bar.finish_and_clear();
    encoded
}

/// Encodes frames from stdin as they arrive.
fn write_live(
    config: &EncoderConfig,
    output: &mut FileOutput,
    quiet: bool,
) -> crate::ground::error::Result<(Encoded, LeftOut)> {
    let bar = progress::bar(None, "encoding", quiet);
    let mut writer = output.writer();
    let mut arriving = ArrivingFrames::new(io::stdin());
    let input = |ArrivedFile { name, bytes }| FrameInput::memory(name, bytes);
    let frames = arriving.by_ref().map(|file| file.map(input));
    let encoded = stream::encode_live(frames, config, &mut writer, &|| bar.inc(1));
    let encoded = encoded.and_then(|encoded| Ok(writer.flush().map(|()| encoded)?));
    bar.finish_and_clear();
    Ok((encoded?, arriving.left_out().clone()))
}

/// Decodes the output and compares it with the input.
fn compare(args: &EncodeArgs, encoded: &Encoded, file: File, quiet: bool) -> Result<()> {
    let options = DecodeOptions { threads: args.threads.threads, ..DecodeOptions::default() };
    let bar = progress::bar(Some(encoded.frames.len() as u64), "verifying", quiet);
    let mut decoded = Vec::new();
    // Not the header's checksum, which the encoder wrote, but that of the decoded bytes.
    let identify = |frame: DecodedFrame| {
        let (mut crc, mut size) = (0, 0);
        frame.write(|piece| {
            (crc, size) = (crc32c::crc32c_append(crc, piece), size + piece.len() as u64);
            Ok(())
        })?;
        Ok((frame.header.name, crc, size))
    };
    let result = stream::decode(BufReader::new(file), &options, identify, |file| {
        bar.inc(1);
        decoded.push(file);
        Ok(())
    });
    bar.finish_and_clear();
    result?;
    let original = encoded.frames.iter();
    let original = original.map(|frame| (frame.name.clone(), frame.file_crc, frame.file_size));
    ensure!(
        original.eq(decoded),
        "decodes to something else, so it does not get this name; please report this"
    );
    Ok(())
}

/// Files in which no points were recognised, and which are therefore stored as bytes.
fn plain_bytes(encoded: &Encoded) -> impl Iterator<Item = &str> {
    let frames = encoded.frames.iter().filter(|frame| frame.stamp.unit != Unit::Beside);
    frames.filter(|frame| frame.point_count == 0 && frame.file_size > 0).map(|frame| &frame.name[..])
}

/// The result in one line: what was saved, what was lost, and other remarks on the files.
pub fn summary(args: &EncodeArgs, config: &EncoderConfig, encoded: &Encoded) -> String {
    let ratio = metrics::ratio(encoded.file_bytes(), encoded.stream_bytes);
    let of_scans = encoded.stream_bytes - encoded.beside_coded;
    let bits = metrics::bits_per_point(of_scans, encoded.points);
    let beside = match encoded.beside {
        0 => String::new(),
        files => format!(
            ", of them {} in {} beside the scans, which alone take {}",
            table::bytes(encoded.beside_bytes),
            table::count(files, "file"),
            table::percent(metrics::ratio(encoded.file_bytes() - encoded.beside_bytes, of_scans))
        ),
    };
    let mut line = format!(
        "{}{}: {} -> {} ({}{beside}, {} bits a point), {}",
        table::count(encoded.frames.len() as u64 - encoded.beside, "frame"),
        match encoded.resumed_frames {
            0 => String::new(),
            resumed => format!(", {resumed} of them from the interrupted run"),
        },
        table::bytes(encoded.file_bytes()),
        table::bytes(encoded.stream_bytes),
        table::percent(ratio),
        table::decimals(bits),
        fidelity(config, Some(encoded)),
    );
    let mut plain = plain_bytes(encoded);
    if let Some(first) = plain.next() {
        let first = first.replace(char::is_control, "?");
        line.push_str(&match plain.count() {
            0 => format!(", 1 file as plain bytes ({first})"),
            more => format!(", {} files as plain bytes (such as {first})", more + 1),
        });
    }
    if encoded.unmodelled > 0 {
        line.push_str(&format!(", {} without a model that fits", table::count(encoded.unmodelled, "frame")));
    }
    if args.verify {
        line.push_str(match config.positions {
            _ if config.is_exact() => {
                ", verified (names and bytes; times and permissions of files are not stored)"
            }
            Positions::Bounded { .. } => ", verified (names, and that all points are within the bound)",
            _ => ", verified (names, and that every frame decodes as it did while it was encoded)",
        });
    }
    line
}

/// How accurately points are restored, and in paper mode how many were dropped, if that was counted.
pub fn fidelity(config: &EncoderConfig, encoded: Option<&Encoded>) -> String {
    let mut words = match config.positions {
        Positions::Exact => "lossless".to_owned(),
        Positions::Bounded { max_error_um, .. } => {
            let within = format!("within {} mm", f64::from(max_error_um) / 1000.0);
            match encoded
                .map_or((0, 0), |encoded| (encoded.exact, encoded.frames.len() as u64 - encoded.beside))
            {
                (0, _) => within,
                (exact, scans) if exact == scans => {
                    format!("{within} (all exact: the bound saves nothing here)")
                }
                (exact, scans) => {
                    format!("{within} ({exact} of {scans} exact, where the bound saves nothing)")
                }
            }
        }
        Positions::Formula => match encoded {
            Some(encoded) => {
                let dropped = encoded.outliers + encoded.lost;
                let share = table::percent(metrics::ratio(encoded.points, dropped));
                format!("paper mode: {} points dropped ({share})", table::grouped(dropped))
            }
            None => "paper mode".to_owned(),
        },
    };
    words.push_str(&match config.intensity {
        Intensity::Exact => String::new(),
        Intensity::None => ", intensities dropped".to_owned(),
        Intensity::Rounded { step_millionths } => {
            format!(", intensities in steps of {}", f64::from(step_millionths) / 1e6)
        }
    });
    words
}

/// The machine-readable report.
#[derive(Serialize)]
pub struct Report {
    pub file: String,
    #[serde(flatten)]
    fidelity: FidelityReport,
    pub frames: u64,
    /// Files beside the scans; their bytes are included in `file_bytes`.
    files_beside: u64,
    bytes_beside: u64,
    /// Whether the output was complete before, so that nothing was encoded.
    was_complete: bool,
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

/// How accurately points are restored.
#[derive(Serialize)]
pub struct FidelityReport {
    mode: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_error_m: Option<f64>,
}

impl FidelityReport {
    /// That of these settings.
    pub fn of(config: &EncoderConfig) -> Self {
        let (mode, max_error_m) = match config.positions {
            Positions::Exact => ("exact", None),
            Positions::Bounded { max_error_um, .. } => ("bounded", Some(f64::from(max_error_um) * 1e-6)),
            Positions::Formula => ("paper", None),
        };
        FidelityReport { mode, max_error_m }
    }
}

#[derive(Serialize)]
pub struct LeftOutReport {
    what: &'static str,
    count: u64,
    bytes: u64,
    first: String,
}

impl LeftOutReport {
    /// An entry for each kind of item that was left out.
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

impl Report {
    /// The report of a run.
    pub fn of(
        args: &EncodeArgs,
        config: &EncoderConfig,
        encoded: &Encoded,
        left_out: &LeftOut,
        seconds: f64,
    ) -> Self {
        Report {
            file: args.output().display().to_string(),
            fidelity: FidelityReport::of(config),
            frames: encoded.frames.len() as u64 - encoded.beside,
            files_beside: encoded.beside,
            bytes_beside: encoded.beside_bytes,
            was_complete: false,
            resumed_frames: encoded.resumed_frames,
            points: encoded.points,
            outliers_dropped: encoded.outliers,
            points_lost: encoded.lost,
            file_bytes: encoded.file_bytes(),
            stream_bytes: encoded.stream_bytes,
            ratio: metrics::ratio(encoded.file_bytes(), encoded.stream_bytes),
            bits_per_point: metrics::bits_per_point(
                encoded.stream_bytes - encoded.beside_coded,
                encoded.points,
            ),
            plain_bytes: plain_bytes(encoded).map(str::to_owned).collect(),
            unmodelled_frames: encoded.unmodelled,
            exact_frames: encoded.exact,
            left_out: LeftOutReport::of(left_out),
            verified: args.verify,
            seconds,
        }
    }
}
