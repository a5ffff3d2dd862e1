//! `lidarpc encode`, unless the input is a recording, messages, or a tree of drives.

use std::fs::File;
use std::io::{self, Seek};
use std::path::PathBuf;
use std::time::Instant;

use crate::edit;
use crate::files::sequence::{LeftOut, STREAM_EXTENSION};
use crate::files::{ArrivedFile, ArrivingFrames};
use crate::frame::EncoderConfig;
use crate::ground::error::Error;
use crate::stream::{self, Encoded, FrameInput};
use crate::study::metrics;
use anyhow::{Result, ensure};

use super::args::{EncodeArgs, encoder_config, wrong_usage};
use super::cleanup::SayOnSignal;
use super::encoding::{create_output, encode_files, finish_output, verify};
use super::errors::about;
use super::frames::{self, Found};
use super::input::{is_dash, is_recording};
use super::output::{check_json, name_of_output, print_json};
use super::partial::{self, PartialOutput};
use super::report::{StreamReport, summary};
use super::{messages, progress, recording, table, tree};

pub fn dispatch(args: &EncodeArgs, quiet: bool) -> Result<()> {
    let args = &EncodeArgs { output: Some(output_of(args)), verify: args.verify || args.rm, ..args.clone() };
    let is_piped = args.inputs.iter().any(|input| is_dash(input));
    let config = encoder_config("encode", &args.coding, args.threads.threads);
    check(args, &config);
    if args.messages {
        return messages::encode(args, &config, quiet);
    }
    if args.inputs.iter().any(|input| is_recording(input)) {
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
    run(args, config, quiet)
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
        [input] if !is_dash(input) && !is_recording(input) => input.file_name(),
        _ => None,
    };
    let Some(name) = name else {
        let is_recording = args.inputs.len() == 1 && is_recording(&args.inputs[0]);
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

/// The result of a run.
struct Done {
    encoded: Encoded,
    left_out: LeftOut,
    /// Whether the output was complete before, so that nothing was encoded.
    was_complete: bool,
}

/// Encodes folders and files of scans, or frames from stdin, to one stream.
pub fn run(args: &EncodeArgs, mut config: EncoderConfig, quiet: bool) -> Result<()> {
    let start = Instant::now();
    if args.inputs.iter().any(|input| is_dash(input)) {
        let done = encode_stdin(args, &config, quiet)?;
        return report(args, &config, &done, start, quiet);
    }
    let found = frames::find(args, quiet)?;
    frames::settle(&found.frames, &mut config, &frames::name_of_inputs(&args.inputs), quiet)?;
    let done = encode_found(args, &config, &found, quiet)?;
    report(args, &config, &done, start, quiet)?;
    if args.rm {
        found.delete(&args.inputs)?;
    }
    Ok(())
}

/// Encodes frames from stdin as they arrive.
fn encode_stdin(args: &EncodeArgs, config: &EncoderConfig, quiet: bool) -> Result<Done> {
    let name = name_of_output(args.output());
    let mut output = create_output(args, quiet)?;
    let bar = progress::bar(None, "encoding", quiet);
    let mut arriving = ArrivingFrames::new(io::stdin());
    let input = |ArrivedFile { name, bytes }| FrameInput::memory(name, bytes);
    let frames = arriving.by_ref().map(|file| file.map(input));
    let encoded = output.write(|out| stream::encode_live(frames, config, out, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    let left_out = arriving.left_out().clone();
    frames::check_left_out(&left_out, "stdin", args.strict, quiet)?;
    if encoded.frames.is_empty() {
        ensure!(!args.strict, "stdin: held no frame; check what writes to it, or encode without --strict");
        if !quiet {
            eprintln!("lidarpc: stdin: held no frame, and so does {name}");
        }
    }
    finish_output(args, output, &encoded, quiet)?;
    Ok(Done { encoded, left_out, was_complete: false })
}

/// Encodes files, with `--resume` in one or more runs.
fn encode_found(args: &EncodeArgs, config: &EncoderConfig, found: &Found, quiet: bool) -> Result<Done> {
    let complete = match args.resume && !args.force {
        true => {
            partial::complete(args.output()).map_err(|error| about(error, &name_of_output(args.output())))?
        }
        false => None,
    };
    let was_complete = complete.is_some();
    let encoded = match complete {
        Some(stream) => confirm(args, config, &found.inputs(), stream, quiet)?,
        None if args.resume => encode_in_runs(args, config, &found.inputs(), quiet)?,
        None => encode_files(args, config, found, quiet)?,
    };
    Ok(Done { encoded, left_out: found.left_out.clone(), was_complete })
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
        verify(args, &encoded, output.reopen()?, quiet)?;
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
        verify(args, &encoded, stream, quiet)?;
    }
    Ok(encoded)
}

/// Reports what was encoded: frame by frame if that is wanted, then as JSON or in a line.
fn report(args: &EncodeArgs, config: &EncoderConfig, done: &Done, start: Instant, quiet: bool) -> Result<()> {
    let seconds = start.elapsed().as_secs_f64();
    let Done { encoded, left_out, was_complete } = done;
    if args.verbose {
        for (frame, stages) in encoded.frames.iter().zip(&encoded.frame_stages) {
            let (name, original, coded) = (frame.name.escape_debug(), stages.original, stages.coded());
            let share = table::percent(metrics::ratio(original, coded));
            eprintln!("{name}: {} -> {} ({share})", table::bytes(original), table::bytes(coded));
        }
    }
    if args.json {
        let mut report = StreamReport::of(args, config, encoded, left_out, seconds);
        report.was_complete = *was_complete;
        print_json(&report)?;
    } else if *was_complete && !quiet {
        let name = name_of_output(args.output());
        let frames = table::count(encoded.frames.len() as u64, "frame");
        let verified = if args.verify { ", verified" } else { "" };
        eprintln!("{name}: already complete, from these {frames} with these settings{verified}");
    } else if !quiet {
        eprintln!("{} in {seconds:.1} s", summary(args, config, encoded));
    }
    Ok(())
}
