//! `lidarpc verify`

use std::io::{self, Write};

use crate::ground::error::Error;
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Result, bail};

use super::args::VerifyArgs;
use super::errors::about;
use super::input::{Originals, name_of, open};
use super::{progress, table};

pub fn run(args: &VerifyArgs, quiet: bool) -> Result<()> {
    let input = open(&args.input)?;
    let mut originals = match &args.against[..] {
        [] => None,
        inputs => Some(Originals::find(inputs)?),
    };
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let bar = progress::bar(None, "verifying", quiet);
    let mut bytes = 0;
    let frames = input.decode(&options, DecodedFrame::checked, |frame| {
        bar.inc(1);
        bytes += frame.header.file_size;
        let Some(originals) = &mut originals else { return Ok(()) };
        if originals.take(&frame.header.name)? != frame.to_bytes()? {
            let what = format!("frame {} ({:?}) is not the original", frame.number, frame.header.name);
            return Err(Error::Usage(what));
        }
        Ok(())
    });
    bar.finish_and_clear();
    let frames = frames.map_err(|error| about(error, &name_of(&args.input)))?;
    if let Some(missing) = originals.as_ref().and_then(Originals::left_over) {
        bail!("{}: not in {}", missing.display(), name_of(&args.input));
    }
    if !quiet {
        let same = if originals.is_some() { ", all as the originals" } else { "" };
        let (name, frames) = (name_of(&args.input), table::count(frames, "frame"));
        writeln!(io::stdout(), "{name}: whole; {frames}, {}{same}", table::bytes(bytes))?;
    }
    Ok(())
}
