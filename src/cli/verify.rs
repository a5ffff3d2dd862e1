//! `lidarpc verify`

use std::io::{self, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use crate::container::{FrameHeader, FrameKind};
use crate::ground::error::Error;
use crate::ground::lanes::keep_to_plain_code;
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Result, bail};
use serde::Serialize;

use super::args::{VerifyArgs, wrong_usage};
use super::console::Console;
use super::errors::{about, line};
use super::input::{Originals, for_each_file, is_recording, name_of, open};
use super::output::{FrameNames, print_json};
use super::{recording, table};

/// The machine-readable report.
#[derive(Default, Serialize)]
struct Report {
    file: String,
    whole: bool,
    /// What is wrong, if the file is damaged.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    frames: u64,
    /// Files beside the scans; their bytes are included in `file_bytes`.
    files_beside: u64,
    file_bytes: u64,
    /// Of a recording, all messages; its frames are the compressed clouds among them.
    #[serde(skip_serializing_if = "Option::is_none")]
    messages: Option<u64>,
    /// Whether the frames were compared with the originals.
    compared: bool,
    /// Whether they were decoded without vector units.
    deep: bool,
}

impl Report {
    /// The report on a file that is whole, in a line.
    fn summary(&self) -> String {
        let frames = match self.messages {
            Some(messages) => {
                let clouds = table::count(self.frames, "compressed cloud");
                format!("{}, of which {clouds}", table::count(messages, "message"))
            }
            None => table::frames_and_files(self.frames, self.files_beside),
        };
        let bytes = table::bytes(self.file_bytes);
        let same = if self.compared { ", all as the originals" } else { "" };
        let deep = if self.deep { ", decoded without vector units" } else { "" };
        format!("{}: whole; {frames}, {bytes}{same}{deep}", self.file)
    }
}

pub fn run(args: &VerifyArgs, console: Console) -> Result<()> {
    if !args.against.is_empty() && args.inputs.iter().any(|input| is_recording(input)) {
        wrong_usage("verify", "--against compares scans; a recording is compared by `encode --verify`");
    }
    if args.deep {
        keep_to_plain_code();
    }
    let mut originals = match &args.against[..] {
        [] => None,
        inputs => Some(Originals::find(inputs)?),
    };
    let mut reports = Vec::new();
    let verified = for_each_file("verify", &args.inputs, |input| {
        let compared = originals.is_some();
        let mut report = Report { file: name_of(input), compared, deep: args.deep, ..Report::default() };
        let verified = verify(args, input, originals.as_mut(), &mut report, console);
        report.whole = verified.is_ok();
        report.error = verified.as_ref().err().map(line);
        if !console.is_quiet && !args.json && report.whole {
            writeln!(io::stdout(), "{}", report.summary())?;
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

/// Decodes a file, and counts its contents.
fn verify(
    args: &VerifyArgs,
    path: &Path,
    mut originals: Option<&mut Originals>,
    report: &mut Report,
    console: Console,
) -> Result<()> {
    if is_recording(path) {
        let found = recording::examine(path, true, args.threads.threads, console)?;
        (report.frames, report.file_bytes) = (found.clouds(), found.cloud_bytes());
        report.messages = Some(found.messages());
        return found.check();
    }
    let input = open(path)?;
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let bar = console.bar(input.frame_count(options.limits), "verifying");
    // Compared on the thread that decoded the frame, so that no frame waits in memory for those before it.
    let compared = originals.as_mut().map(Mutex::new);
    let names = Mutex::new(FrameNames::default());
    let check = |frame: DecodedFrame| {
        let DecodedFrame { number, header: FrameHeader { name, file_size, stamp, .. }, .. } = &frame;
        let counted = (*file_size, stamp.kind == FrameKind::Beside);
        // Points in memory and messages may have any names.
        if matches!(stamp.kind, FrameKind::File | FrameKind::Beside) {
            names.lock().unwrap_or_else(PoisonError::into_inner).check(*number, name)?;
        }
        let Some(originals) = &compared else { return frame.write(|_| Ok(())).map(|()| counted) };
        let original = originals.lock().unwrap_or_else(PoisonError::into_inner).take(name)?;
        if original != frame.to_bytes()? {
            return Err(Error::Usage(format!("frame {number} ({name:?}) is not the original")));
        }
        Ok(counted)
    };
    let decoded = input.decode(&options, check, |(file_size, is_beside)| {
        bar.inc(1);
        report.frames += u64::from(!is_beside);
        report.files_beside += u64::from(is_beside);
        report.file_bytes += file_size;
        Ok(())
    });
    bar.finish_and_clear();
    decoded.map(drop).map_err(|error| about(error, &name_of(path)))
}
