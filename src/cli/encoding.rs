//! Encodes scans with a progress bar: to a file that exists only when it is complete, or in memory.

use std::fs::File;
use std::io::{BufReader, Seek};

use crate::edit;
use crate::files::sequence::LeftOut;
use crate::frame::{EncoderConfig, StageReport};
use crate::ground::error::{self, Error};
use crate::stream::{self, DecodeOptions, DecodedFrame, EncodeStatistics, FrameInput};
use anyhow::{Context, Result, bail, ensure};

use super::args::EncodeArgs;
use super::console::Console;
use super::errors::about;
use super::frames::InputFiles;
use super::output::{FileOutput, name_of_output};
use super::partial::{self, PartialOutput};
use super::signals::SayOnSignal;

/// The result of a run.
pub struct Done {
    pub encoded: EncodeStatistics,
    pub left_out: LeftOut,
    /// Whether the output was complete before, so that nothing was encoded.
    pub was_complete: bool,
}

/// Encodes files, with `--resume` in one or more runs. An output that is complete is then compared with the
/// files and the settings.
///
/// # Errors
/// If a file cannot be read; if the output exists, cannot be written, or decodes to something else; if a
/// complete one differs.
pub fn encode_inputs(
    args: &EncodeArgs,
    config: &EncoderConfig,
    found: &InputFiles,
    console: Console,
) -> Result<Done> {
    let complete = match args.resume && !args.force {
        true => {
            partial::complete(args.output()).map_err(|error| about(error, &name_of_output(args.output())))?
        }
        false => None,
    };
    let was_complete = complete.is_some();
    let encoded = match complete {
        Some(stream) => confirm(args, config, &found.inputs(), stream, console)?,
        None if args.resume => encode_in_runs(args, config, &found.inputs(), console)?,
        None => encode_files(args, config, found, console)?,
    };
    Ok(Done { encoded, left_out: found.left_out.clone(), was_complete })
}

/// Encodes files to the output, which exists only when it is complete and, if that is wanted, verified.
///
/// # Errors
/// If a file cannot be read, or if the output exists, cannot be written, or decodes to something else.
fn encode_files(
    args: &EncodeArgs,
    config: &EncoderConfig,
    found: &InputFiles,
    console: Console,
) -> Result<EncodeStatistics> {
    let mut output = create_output(args, console)?;
    let frames = found.inputs();
    let bar = console.bar(Some(frames.len() as u64), "encoding");
    let encoded = output.write(|out| stream::encode(&frames, config, out, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name_of_output(args.output())))?;
    finish_output(args, output, &encoded, console)?;
    Ok(encoded)
}

/// Encodes to a file that is kept if this is interrupted, and continues what an interrupted run left.
fn encode_in_runs(
    args: &EncodeArgs,
    config: &EncoderConfig,
    frames: &[FrameInput],
    console: Console,
) -> Result<EncodeStatistics> {
    let name = name_of_output(args.output());
    let words =
        format!("interrupted; what is done is kept in {name}.partial, and the same command goes on with it");
    let _words = (!console.is_quiet).then(|| SayOnSignal::new(words));
    let output = PartialOutput::open(args.output(), args.force)?;
    let bar = console.bar(Some(frames.len() as u64), "encoding");
    let encoded =
        output.files().and_then(|files| edit::encode_resuming(frames, config, files, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    if args.verify {
        verify(args, &encoded, output.reopen()?, console)?;
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
    console: Console,
) -> Result<EncodeStatistics> {
    let name = name_of_output(args.output());
    let bar = console.bar(Some(frames.len() as u64), "comparing");
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
        verify(args, &encoded, stream, console)?;
    }
    Ok(encoded)
}

/// Creates the output. Tells if there is also one of an interrupted run.
///
/// # Errors
/// If it exists or cannot be written.
pub fn create_output(args: &EncodeArgs, console: Console) -> Result<FileOutput> {
    let output = FileOutput::binary(args.output(), args.force)?;
    if let Some(left) = partial::left_for(args.output()) {
        console.say(format_args!(
            "lidarpc: {} of an interrupted run is left as it is; --resume goes on with it",
            left.display()
        ));
    }
    Ok(output)
}

/// Verifies the output, if that is wanted, and gives it its name.
///
/// # Errors
/// If it decodes to something else, or if renaming fails.
pub fn finish_output(
    args: &EncodeArgs,
    output: FileOutput,
    encoded: &EncodeStatistics,
    console: Console,
) -> Result<()> {
    if args.verify {
        let Some(file) = output.reopen()? else { bail!("--verify needs a file that can be read again") };
        verify(args, encoded, file, console)?;
    }
    output.finish().map_err(|error| about(error, &name_of_output(args.output())))
}

/// Decodes the output and compares it with the input.
///
/// # Errors
/// If it cannot be decoded, or decodes to something else.
pub fn verify(args: &EncodeArgs, encoded: &EncodeStatistics, file: File, console: Console) -> Result<()> {
    let name = || name_of_output(args.output());
    let options = DecodeOptions { threads: args.threads.threads, ..DecodeOptions::default() };
    let bar = console.bar(Some(encoded.frames.len() as u64), "verifying");
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
    result.with_context(name)?;
    let original = encoded.frames.iter();
    let original = original.map(|frame| (frame.name.clone(), frame.file_crc, frame.file_size));
    ensure!(
        original.eq(decoded),
        "{}: decodes to something else, so it does not get this name; please report this",
        name()
    );
    Ok(())
}

/// Encodes scans in memory. Returns the time and size of each stage, and the stream.
///
/// # Errors
/// If a scan cannot be read or encoded.
pub fn encode_in_memory(
    frames: &[FrameInput],
    config: &EncoderConfig,
    console: Console,
) -> error::Result<(StageReport, Vec<u8>)> {
    let bar = console.bar(Some(frames.len() as u64), "encoding");
    let mut stream = Vec::new();
    let encoded = stream::encode(frames, config, &mut stream, &|| bar.inc(1));
    bar.finish_and_clear();
    Ok((encoded?.stages, stream))
}
