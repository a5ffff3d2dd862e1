//! `lidarpc encode`

use crate::edit;
use crate::stream;
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use std::time::Instant;

use crate::files::sequence::find_frames;
use crate::files::{ArrivedFile, ArrivingFrames, LeftOut, LeftOutPaths, starts_as_scan};
use crate::frame::settings::EncoderConfig;
use crate::stream::{DecodeOptions, DecodedFrame, Encoded, FrameInput};
use crate::study::metrics;
use anyhow::{Context, Result, bail, ensure};
use clap::{CommandFactory, error::ErrorKind};

use super::args::{Args, EncodeArgs};
use super::errors::about;
use super::input::is_dash;
use super::output::{FileOutput, name_of_output};
use super::partial::{self, PartialOutput};
use super::{coding, progress, table};

pub fn run(args: &EncodeArgs, quiet: bool) -> Result<()> {
    let is_piped = args.inputs.iter().any(|input| is_dash(input));
    for (wrong, what) in [
        (args.verify && is_dash(&args.output), "--verify needs an output that can be read again, not stdout"),
        (args.resume && is_dash(&args.output), "--resume needs an output that stays, not stdout"),
        (args.resume && is_piped, "--resume needs inputs that can be read again, not stdin"),
        (is_piped && args.inputs.len() > 1, "`-`, for frames from stdin, stands alone"),
    ] {
        if wrong {
            Args::command().error(ErrorKind::ArgumentConflict, what).exit();
        }
    }
    let config = coding::config(&args.coding, &args.threads);
    let start = Instant::now();
    let encoded = match args.resume {
        true => encode_in_runs(args, &config, quiet)?,
        false => encode_whole(args, &config, quiet)?,
    };
    if !quiet {
        eprintln!("{} in {:.1} s", summary(&encoded), start.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Encodes into a file that is there as a whole or not at all.
fn encode_whole(args: &EncodeArgs, config: &EncoderConfig, quiet: bool) -> Result<Encoded> {
    let is_live = args.inputs.iter().any(|input| is_dash(input));
    let frames = if is_live { Frames::Live } else { Frames::Files(find_inputs(args, quiet)?) };
    let mut output = FileOutput::create(&args.output, args.force)?;
    if let Some(left) = partial::left_for(&args.output)
        && !quiet
    {
        eprintln!(
            "lidarpc: {} of an interrupted run is left as it is; --resume goes on with it",
            left.display()
        );
    }
    let name = name_of_output(&args.output);
    let encoded = write_stream(config, frames, &mut output, quiet).map_err(|error| about(error, &name))?;
    if args.verify {
        let Some(file) = output.reopen()? else { bail!("--verify needs a file that can be read again") };
        compare(args, &encoded, file, quiet).with_context(|| name.clone())?;
    }
    output.finish().map_err(|error| about(error, &name))?;
    Ok(encoded)
}

/// Encodes into a file that stays if this is interrupted, and goes on with what an interrupted run has left.
fn encode_in_runs(args: &EncodeArgs, config: &EncoderConfig, quiet: bool) -> Result<Encoded> {
    let frames = find_inputs(args, quiet)?;
    let output = PartialOutput::open(&args.output, args.force)?;
    let name = name_of_output(&args.output);
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let encoded =
        output.files().and_then(|files| edit::encode_resuming(&frames, config, files, &|| bar.inc(1)));
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &name))?;
    if args.verify {
        compare(args, &encoded, output.reopen()?, quiet).with_context(|| name.clone())?;
    }
    output.finish().map_err(|error| about(error, &name))?;
    Ok(encoded)
}

/// Where the frames come from.
enum Frames {
    /// Files, all of them known.
    Files(Vec<FrameInput>),
    /// Stdin, as they arrive.
    Live,
}

/// The frames to encode. Says what is left out: whoever archives a folder should know.
fn find_inputs(args: &EncodeArgs, quiet: bool) -> Result<Vec<FrameInput>> {
    let found = find_frames(&args.inputs)?;
    if !args.force_bytes {
        args.inputs.iter().filter(|input| input.is_file()).try_for_each(|input| check_scan(input))?;
    }
    let files = LeftOutPaths {
        count: found.left_out.len() as u64,
        first: found.left_out.first().map(|path| path.display().to_string()),
    };
    tell_left_out(&LeftOut { files, ..LeftOut::default() }, quiet);
    Ok(found.frames.into_iter().map(FrameInput::file).collect())
}

fn tell_left_out(left_out: &LeftOut, quiet: bool) {
    let LeftOut { files, symbolic_links } = left_out;
    for (LeftOutPaths { count, first }, what, note) in [
        (files, "file", " not known as a scan"),
        (symbolic_links, "symbolic link", ", as the archive does not hold what they point to"),
    ] {
        if let Some(first) = first
            && !quiet
        {
            let what = table::count(*count, what);
            eprintln!("lidarpc: left out {what}{note}, such as {first}");
        }
    }
}

/// Refuses a file that is named and holds no scan: it would be packed as bytes, and no better than by others.
fn check_scan(path: &Path) -> Result<()> {
    /// Bytes that a header takes at most.
    const HEADER: u64 = 1 << 20;
    let unreadable = |error: io::Error| about(error.into(), &path.display().to_string());
    let mut start = Vec::new();
    File::open(path).map_err(unreadable)?.take(HEADER).read_to_end(&mut start).map_err(unreadable)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    ensure!(
        starts_as_scan(&name, &start),
        "{}: holds no scan that is known (.bin, .pcd, .ply); --force-bytes takes it as plain bytes",
        path.display()
    );
    Ok(())
}

fn write_stream(
    config: &EncoderConfig,
    frames: Frames,
    output: &mut FileOutput,
    quiet: bool,
) -> crate::ground::error::Result<Encoded> {
    let total = match &frames {
        Frames::Files(files) => Some(files.len() as u64),
        Frames::Live => None,
    };
    let bar = progress::bar(total, "encoding", quiet);
    let mut writer = output.writer();
    let encoded = match frames {
        Frames::Files(files) => stream::encode(&files, config, &mut writer, &|| bar.inc(1)),
        Frames::Live => {
            let mut arriving = ArrivingFrames::new(io::stdin());
            let input = |ArrivedFile { name, bytes }| FrameInput::memory(name, bytes);
            let frames = arriving.by_ref().map(|file| file.map(input));
            let encoded = stream::encode_live(frames, config, &mut writer, &|| bar.inc(1));
            bar.suspend(|| tell_left_out(arriving.left_out(), quiet));
            encoded
        }
    };
    let encoded = encoded.and_then(|encoded| Ok(writer.flush().map(|()| encoded)?));
    bar.finish_and_clear();
    encoded
}

/// Decodes what was written and compares it with what was read.
fn compare(args: &EncodeArgs, encoded: &Encoded, file: File, quiet: bool) -> Result<()> {
    let options = DecodeOptions { threads: args.threads.threads, ..DecodeOptions::default() };
    let bar = progress::bar(Some(encoded.frames.len() as u64), "verifying", quiet);
    let mut decoded = Vec::new();
    // Not the header's checksum, which the encoder wrote: that of the bytes that came out.
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

fn summary(encoded: &Encoded) -> String {
    let ratio = metrics::ratio(encoded.file_bytes(), encoded.stream_bytes);
    let bits = metrics::bits_per_point(encoded.stream_bytes, encoded.points);
    format!(
        "{}{}: {} -> {} ({}, {} bits a point)",
        table::count(encoded.frames.len() as u64, "frame"),
        match encoded.resumed_frames {
            0 => String::new(),
            resumed => format!(", {resumed} of them from the interrupted run"),
        },
        table::bytes(encoded.file_bytes()),
        table::bytes(encoded.stream_bytes),
        table::percent(ratio),
        table::decimals(bits),
    )
}
