//! `lidarpc verify`

use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};

use crate::ground::error::Error;
use crate::stream::container::FrameHeader;
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
    // Compared by the thread that has decoded the frame: no frame waits in memory for those before it.
    let compared = originals.as_mut().map(Mutex::new);
    let check = |frame: DecodedFrame| {
        let DecodedFrame { number, header: FrameHeader { name, file_size, .. }, .. } = &frame;
        let Some(originals) = &compared else { return frame.write(|_| Ok(())).map(|()| *file_size) };
        let original = originals.lock().unwrap_or_else(PoisonError::into_inner).take(name)?;
        if original != frame.to_bytes()? {
            return Err(Error::Usage(format!("frame {number} ({name:?}) is not the original")));
        }
        Ok(*file_size)
    };
    let frames = input.decode(&options, check, |file_size| {
        bar.inc(1);
        bytes += file_size;
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
