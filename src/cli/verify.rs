//! `lidarpc verify`

use std::io::{self, BufReader, Write};
use std::path::Path;
use std::sync::Mutex;

use crate::container::{FrameHeader, FrameKind};
use crate::edit::{self, Recovered};
use crate::ground::error::Error;
use crate::ground::lanes::keep_to_plain_code;
use crate::ground::team::locked;
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Result, bail};
use serde::Serialize;

use super::args::{VerifyArgs, wrong_usage};
use super::console::Console;
use super::errors::{about, line};
use super::input::{Input, Originals, for_each_file, is_recording, name_of, open, with_folders_searched};
use super::losses::{LossReport, Losses};
use super::output::{FrameNames, print_json};
use super::{readable, recording};

/// The machine-readable report.
#[derive(Default, Serialize)]
struct Report {
    file: String,
    whole: bool,
    /// What is wrong, if the file is damaged.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    /// All that is lost by damage, which `error` is only the first of; `None` if the input cannot be read again.
    #[serde(skip_serializing_if = "Option::is_none")]
    lost: Option<LossReport>,
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
                let clouds = readable::count(self.frames, "compressed cloud");
                format!("{}, of which {clouds}", readable::count(messages, "message"))
            }
            None => readable::frames_and_files(self.frames, self.files_beside),
        };
        let bytes = readable::bytes(self.file_bytes);
        let same = if self.compared { ", all as the originals" } else { "" };
        let deep = if self.deep { ", decoded without vector units" } else { "" };
        format!("{}: whole; {frames}, {bytes}{same}{deep}", self.file)
    }
}

pub fn run(args: &VerifyArgs, console: Console) -> Result<()> {
    let inputs = with_folders_searched(&args.inputs)?;
    if !args.against.is_empty() && inputs.iter().any(|input| is_recording(input)) {
        wrong_usage("verify", "--against compares scans; a recording is compared by `encode --verify`");
    }
    if !args.against.is_empty() && inputs != args.inputs {
        wrong_usage("verify", "--against compares the streams of a folder one by one; give one of them");
    }
    if args.deep {
        keep_to_plain_code();
    }
    let mut originals = match &args.against[..] {
        [] => None,
        inputs => Some(Originals::find(inputs)?),
    };
    let mut reports = Vec::new();
    let verified = for_each_file("verify", &inputs, |input| {
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
            [report] if inputs == args.inputs => print_json(report)?,
            reports => print_json(&reports)?,
        }
    }
    verified?;
    if let Some((missing, count)) = originals.as_ref().and_then(Originals::left_over) {
        let names: Vec<_> = inputs.iter().map(|input| name_of(input)).collect();
        let all = if count > 1 { format!("; {count} scans are missing in all") } else { String::new() };
        bail!("{}: not in {}{all}", missing.display(), names.join(", "));
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
        let found = recording::examine(path, Some(args.limits.limits()), args.threads.threads, console)?;
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
        let DecodedFrame { number, header, .. } = &frame;
        let FrameHeader { name, file_size, stamp, .. } = header;
        let counted = (*file_size, stamp.kind == FrameKind::Beside);
        // Points in memory and messages may have any names.
        if matches!(stamp.kind, FrameKind::File | FrameKind::Beside) {
            locked(&names).check(*number, header)?;
        }
        let Some(originals) = &compared else { return frame.write(|_| Ok(())).map(|()| counted) };
        let original = locked(originals).take(name)?;
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
    let Err(error) = decoded else { return Ok(()) };
    if error.is_damage() {
        report.lost = find_losses(path, &options)?;
    }
    Err(about(error, &name_of(path)))
}

/// Reports all damage of a stream, of which an error tells only the first; `None` if the stream cannot be read
/// again.
fn find_losses(path: &Path, options: &DecodeOptions) -> Result<Option<LossReport>> {
    let Input::File(file) = open(path)? else { return Ok(None) };
    let mut losses = Losses::new(path, options.frames);
    let tell = |part| {
        if let Recovered::Lost(lost) = part {
            losses.report_loss(&lost);
        }
        Ok(())
    };
    match edit::recover(BufReader::new(file), options, tell) {
        // That nothing is intact is what the error says.
        Ok(_) | Err(Error::DamagedInput(_)) => Ok(losses.report()),
        Err(error) => Err(about(error, &name_of(path))),
    }
}
