//! `lidarpc encode`

use std::io::{self, BufReader, Write};
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::{CommandFactory, error::ErrorKind};
use lidarpc::codec::{self, DecodeOptions, Encoded, EncoderConfig, FrameInput};
use lidarpc::io::sequence::find_frames;
use lidarpc::io::{ArrivedFile, ArrivingFrames};
use lidarpc::metrics;

use super::args::{Args, EncodeArgs};
use super::errors::about;
use super::input::is_dash;
use super::output::{FileOutput, name_of_output};
use super::{coding, progress, table};

pub fn run(args: &EncodeArgs, quiet: bool) -> Result<()> {
    if args.verify && is_dash(&args.output) {
        let what = "--verify needs an output that can be read again, not stdout";
        Args::command().error(ErrorKind::ArgumentConflict, what).exit();
    }
    let config = coding::config(&args.coding, &args.threads);
    let start = Instant::now();
    let frames = find_inputs(&args.inputs, quiet)?;
    let mut output = FileOutput::create(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let encoded = write_stream(&config, frames, &mut output, quiet).map_err(|error| about(error, &name))?;
    if args.verify {
        compare(args, &encoded, &output, quiet).with_context(|| name.clone())?;
    }
    output.finish().map_err(|error| about(error, &name))?;
    if !quiet {
        eprintln!("{} in {:.1} s", summary(&encoded), start.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Where the frames come from.
enum Frames {
    /// Files, all of them known.
    Files(Vec<FrameInput>),
    /// Stdin, as they arrive.
    Live,
}

/// The frames to encode. Says what is left out: whoever archives a folder should know.
fn find_inputs(inputs: &[PathBuf], quiet: bool) -> Result<Frames> {
    if inputs.iter().any(|input| is_dash(input)) {
        if inputs.len() > 1 {
            let what = "`-`, for frames from stdin, stands alone";
            Args::command().error(ErrorKind::ArgumentConflict, what).exit();
        }
        return Ok(Frames::Live);
    }
    let found = find_frames(inputs)?;
    if let Some(first) = found.left_out.first()
        && !quiet
    {
        let count = table::count(found.left_out.len() as u64, "file");
        eprintln!("lidarpc: left out {count} not known as a scan, such as {}", first.display());
    }
    Ok(Frames::Files(found.frames.into_iter().map(FrameInput::File).collect()))
}

fn write_stream(
    config: &EncoderConfig,
    frames: Frames,
    output: &mut FileOutput,
    quiet: bool,
) -> lidarpc::error::Result<Encoded> {
    let total = match &frames {
        Frames::Files(files) => Some(files.len() as u64),
        Frames::Live => None,
    };
    let bar = progress::bar(total, "encoding", quiet);
    let mut writer = output.writer();
    let encoded = match frames {
        Frames::Files(files) => codec::encode(&files, config, &mut writer, &|| bar.inc(1)),
        Frames::Live => {
            let frames = ArrivingFrames::new(io::stdin())
                .map(|file| file.map(|ArrivedFile { name, bytes }| FrameInput::Memory { name, bytes }));
            codec::encode_live(frames, config, &mut writer, &|| bar.inc(1))
        }
    };
    let encoded = encoded.and_then(|encoded| Ok(writer.flush().map(|()| encoded)?));
    bar.finish_and_clear();
    encoded
}

/// Decodes what was written and compares it with what was read.
fn compare(args: &EncodeArgs, encoded: &Encoded, output: &FileOutput, quiet: bool) -> Result<()> {
    let Some(file) = output.reopen()? else { bail!("--verify needs a file that can be read again") };
    let options = DecodeOptions { threads: args.threads.threads, ..DecodeOptions::default() };
    let bar = progress::bar(Some(encoded.frames.len() as u64), "verifying", quiet);
    let mut decoded = Vec::new();
    let result = codec::decode(BufReader::new(file), &options, |frame| {
        bar.inc(1);
        // Not the header's checksum, which the encoder wrote: that of the bytes that came out.
        decoded.push((frame.header.name, crc32c::crc32c(&frame.bytes), frame.bytes.len() as u64));
        Ok(())
    });
    bar.finish_and_clear();
    result?;
    let original = encoded.frames.iter();
    let original = original.map(|frame| (frame.name.clone(), frame.file_crc, frame.file_size));
    ensure!(original.eq(decoded), "decodes to something else; nothing was kept, please report this");
    Ok(())
}

fn summary(encoded: &Encoded) -> String {
    let ratio = metrics::ratio(encoded.file_bytes(), encoded.stream_bytes);
    let bits = metrics::bits_per_point(encoded.stream_bytes, encoded.points);
    format!(
        "{}: {} -> {} ({}, {} bits a point)",
        table::count(encoded.frames.len() as u64, "frame"),
        table::bytes(encoded.file_bytes()),
        table::bytes(encoded.stream_bytes),
        table::percent(ratio),
        table::decimals(bits),
    )
}
