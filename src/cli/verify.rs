//! `lidarpc verify`

use std::io::{self, Write};
use std::path::Path;

use crate::ground::error::Error;
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Result, bail};
use serde::Serialize;

use super::args::VerifyArgs;
use super::errors::{about, line};
use super::input::{Originals, for_each_file, name_of, open};
use super::output::print_json;
use super::{progress, table};

/// What was found, for machines.
#[derive(Serialize)]
struct Report {
    file: String,
    whole: bool,
    /// What is wrong, if it is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    frames: u64,
    file_bytes: u64,
    /// Whether the frames were held against the originals.
    compared: bool,
}

pub fn run(args: &VerifyArgs, quiet: bool) -> Result<()> {
    let mut originals = match &args.against[..] {
        [] => None,
        inputs => Some(Originals::find(inputs)?),
    };
    let mut reports = Vec::new();
    let verified = for_each_file("verify", &args.inputs, |input| {
        let mut report = Report {
            file: name_of(input),
            whole: false,
            error: None,
            frames: 0,
            file_bytes: 0,
            compared: originals.is_some(),
        };
        let verified = verify(args, input, originals.as_mut(), &mut report, quiet);
        report.whole = verified.is_ok();
        report.error = verified.as_ref().err().map(line);
        if !quiet && !args.json && report.whole {
            let same = if report.compared { ", all as the originals" } else { "" };
            let (frames, bytes) = (table::count(report.frames, "frame"), table::bytes(report.file_bytes));
            writeln!(io::stdout(), "{}: whole; {frames}, {bytes}{same}", report.file)?;
        }
        reports.push(report);
        verified
    });
    if args.json {
        match &reports[..] {
            [report] => print_json(report)?,
            reports => print_json(&reports)?,
        }
    }
    verified?;
    if let Some(missing) = originals.as_ref().and_then(Originals::left_over) {
        let names: Vec<_> = args.inputs.iter().map(|input| name_of(input)).collect();
        bail!("{}: not in {}", missing.display(), names.join(", "));
    }
    Ok(())
}

/// Decodes a file, and counts what it holds.
fn verify(
    args: &VerifyArgs,
    path: &Path,
    mut originals: Option<&mut Originals>,
    report: &mut Report,
    quiet: bool,
) -> Result<()> {
    let input = open(path)?;
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let bar = progress::bar(input.frame_count(options.limits), "verifying", quiet);
    let decoded = input.decode(&options, DecodedFrame::checked, |frame| {
        bar.inc(1);
        report.frames += 1;
        report.file_bytes += frame.header.file_size;
        let Some(originals) = &mut originals else { return Ok(()) };
        if originals.take(&frame.header.name)? != frame.to_bytes()? {
            let what = format!("frame {} ({:?}) is not the original", frame.number, frame.header.name);
            return Err(Error::Usage(what));
        }
        Ok(())
    });
    bar.finish_and_clear();
    decoded.map(drop).map_err(|error| about(error, &name_of(path)))
}
