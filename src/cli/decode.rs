//! `lidarpc decode`

use std::io::{self, Write};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use lidarpc::codec::{DecodeOptions, DecodedFrame};
use lidarpc::error::Error;

use super::args::DecodeArgs;
use super::errors::about;
use super::input::{Input, is_dash, name_of, open};
use super::output::FolderOutput;
use super::{progress, table};

pub fn run(args: &DecodeArgs, quiet: bool) -> Result<()> {
    let start = Instant::now();
    let input = open(&args.input)?;
    let options = DecodeOptions {
        threads: args.threads.threads,
        frames: args.frames.unwrap_or_default(),
        ..DecodeOptions::default()
    };
    if is_dash(&args.output) {
        return to_stdout(args, input, &options);
    }
    let mut folder = FolderOutput::create(&args.output, args.force)?;
    let bar = progress::bar(None, "decoding", quiet);
    let mut bytes = 0;
    let decoded = input.decode(&options, |frame| {
        bar.inc(1);
        bytes += frame.bytes.len() as u64;
        folder.write(&frame.header.name, &frame.bytes)
    });
    bar.finish_and_clear();
    decoded.map_err(|error| about(error, &name_of(&args.input)))?;
    folder.finish()?;
    if !quiet {
        let frames = table::count(bar.position(), "frame");
        eprintln!("{frames}: {} in {:.1} s", table::bytes(bytes), start.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Writes the one frame that was asked for to stdout.
fn to_stdout(args: &DecodeArgs, input: Input, options: &DecodeOptions) -> Result<()> {
    let mut only: Option<DecodedFrame> = None;
    let decoded = input.decode(options, |frame| match only.replace(frame) {
        None => Ok(()),
        Some(_) => {
            Err(Error::InvalidConfig("stdout takes one frame; choose one, as by --frames 5".to_owned()))
        }
    });
    decoded.map_err(|error| about(error, &name_of(&args.input)))?;
    let Some(frame) = only else { bail!("{}: holds no frame", name_of(&args.input)) };
    let mut stdout = io::stdout().lock();
    stdout.write_all(&frame.bytes).and_then(|()| stdout.flush()).context("stdout")
}
