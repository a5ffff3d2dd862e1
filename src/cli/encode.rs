//! `lidarpc encode`

use std::fs::{self, File};
use std::io::{self, BufReader, Seek, Write};
use std::path::PathBuf;
use std::time::Instant;

use crate::edit;
use crate::files::sequence::{FoundFile, LeftOut, STREAM_EXTENSION};
use crate::files::{ArrivedFile, ArrivingFrames};
use crate::frame::EncoderConfig;
use crate::ground::error::Error;
use crate::stream::{self, DecodeOptions, DecodedFrame, Encoded, FrameInput};
use crate::study::metrics;
use anyhow::{Context, Result, bail, ensure};

use super::args::{EncodeArgs, encoder_config, wrong_usage};
use super::cleanup::SayOnSignal;
use super::errors::about;
use super::frames::{self, Found};
use super::input::is_dash;
use super::output::{FileOutput, check_json, name_of_output, print_json};
use super::partial::{self, PartialOutput};
use super::report::{StreamReport, summary};
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
        let mut report = StreamReport::of(args, &config, &encoded, &left_out, seconds);
        report.was_complete = was_complete;
        print_json(&report)?;
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
