//! `lidarpc decode` for streams: into a folder, or a single frame to stdout.

use std::io::{self, BufReader, IsTerminal, Write};
use std::path::Path;
use std::time::Instant;

use crate::container::FrameKind;
use crate::edit::{self, Recovered};
use crate::ground::error::{Error, Limits, one_line};
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::args::{DecodeArgs, check_usage, wrong_usage};
use super::console::Console;
use super::conversion::Converter;
use super::errors::{about, say};
use super::input::{ChosenFrames, Input, is_dash, is_pipe, name_of, open, report_files_left_out};
use super::losses::{LossReport, Losses};
use super::output::{FolderOutput, FrameNames};
use super::readable;

/// The machine-readable report.
#[derive(Default, Serialize)]
pub struct Report {
    folder: String,
    frames: u64,
    /// Files beside the scans; their bytes are included in `file_bytes`.
    files_beside: u64,
    file_bytes: u64,
    /// The losses of each damaged file.
    lost: Vec<LossReport>,
    seconds: f64,
}

impl Report {
    /// The report in a line.
    fn summary(&self) -> String {
        let Report { folder, file_bytes, seconds, .. } = self;
        let folder = one_line(folder);
        let frames = readable::frames_and_files(self.frames, self.files_beside);
        format!("{folder}: {frames}: {} in {seconds:.1} s", readable::bytes(*file_bytes))
    }
}

/// Decodes streams. The machine-readable report of what was decoded into a folder is added to `reports`.
pub fn run(args: &DecodeArgs, reports: &mut Vec<Report>, console: Console) -> Result<()> {
    let [first, others @ ..] = &args.inputs[..] else { return Ok(()) };
    let chooses = args.frames.is_some() || args.time.is_some();
    let is_stdout = is_dash(args.output());
    check_usage(
        "decode",
        [
            (
                chooses && !others.is_empty(),
                "--frames and --time choose frames of one file; decode the files one by one",
            ),
            (is_stdout && !others.is_empty(), "stdout takes one frame, and so a single file"),
        ],
    );
    let limits = args.limits.limits();
    let chosen = ChosenFrames::of("decode", first, (args.frames, args.time), limits, console)?;
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits,
        frames: chosen.range,
        ..DecodeOptions::default()
    };
    let converter = Converter::new(args.format);
    match is_stdout {
        true => to_stdout(args, first, (&options, &chosen), &converter, console),
        false => to_folder(args, (&options, &chosen), &converter, reports, console),
    }
}

/// Decodes the inputs into a folder, and reports.
fn to_folder(
    args: &DecodeArgs,
    (options, chosen): (&DecodeOptions, &ChosenFrames),
    converter: &Converter,
    reports: &mut Vec<Report>,
    console: Console,
) -> Result<()> {
    let start = Instant::now();
    // Before any output is created. Only one input is open at a time, as the system limits their number.
    let counts = args.inputs.iter().map(|path| frame_count(path, options.limits));
    let total = counts.sum::<Result<Option<u64>>>()?.map(|total| options.frames.count_of(total));
    let folder = FolderOutput::create(args.output(), args.force)?.keeping(&args.inputs);
    let bar = console.bar(total, "decoding");
    let mut report = Report { folder: args.output().display().to_string(), ..Report::default() };
    let mut errors = Vec::new();
    for path in &args.inputs {
        let input = open(path)?;
        let mut losses = Losses::new(path, options.frames);
        let mut files = 0;
        let write = |frame: DecodedFrame| {
            if !chosen.contains(&frame.header.stamp) {
                return Ok(None);
            }
            let is_beside = frame.header.stamp.kind == FrameKind::Beside;
            let file = converter.file(frame)?;
            Ok(Some((folder.write(file.name(), |give| file.write(give))?, is_beside)))
        };
        let count = |written: Option<(u64, bool)>| {
            bar.inc(1);
            files += 1;
            let Some((file_bytes, is_beside)) = written else { return Ok(()) };
            report.frames += u64::from(!is_beside);
            report.files_beside += u64::from(is_beside);
            report.file_bytes += file_bytes;
            Ok(())
        };
        let left_out = decode(args, input, options, &mut losses, write, count).map_err(|error| {
            bar.finish_and_clear();
            about(error, &name_of(path))
        })?;
        report_files_left_out(path, left_out, console);
        report.lost.extend(losses.report());
        errors.extend(losses.check(files).err());
    }
    bar.finish_and_clear();
    folder.finish()?;
    converter.report_unconverted(console);
    report.seconds = start.elapsed().as_secs_f64();
    if !args.json {
        console.say(report.summary());
    }
    reports.push(report);
    // The caller prints the first error, after the others.
    let mut errors = errors.into_iter();
    let first = errors.next();
    errors.for_each(|error| say(&error));
    first.map_or(Ok(()), Err)
}

/// The number of frames in a stream, if it can be determined without decoding.
///
/// # Errors
/// If the stream cannot be opened.
fn frame_count(path: &Path, limits: Limits) -> Result<Option<u64>> {
    if is_dash(path) || is_pipe(path) {
        return Ok(None);
    }
    Ok(open(path)?.frame_count(limits))
}

/// Decodes as the arguments say: all frames or an error, or the intact ones. Calls `work` on each frame, and
/// passes the results to `sink`, in order. Returns the number of files beside the scans that are left out
/// because only some frames are wanted; of a damaged stream, those that are intact.
fn decode<T: Send>(
    args: &DecodeArgs,
    input: Input,
    options: &DecodeOptions,
    losses: &mut Losses,
    work: impl Fn(DecodedFrame) -> crate::ground::error::Result<T> + Sync,
    mut sink: impl FnMut(T) -> crate::ground::error::Result<()>,
) -> crate::ground::error::Result<u64> {
    if !args.keep_going {
        return input.decode(options, work, sink);
    }
    let mut names = FrameNames::default();
    edit::recover(BufReader::new(input.rewindable()?), options, |part| match part {
        // Only now: whether a frame is lost with its group is known after the whole group is decoded.
        Recovered::Frame(frame) => match names.check(frame.number, &frame.header) {
            Ok(()) => sink(work(*frame)?),
            Err(fault) => {
                losses.report_frame(&fault);
                Ok(())
            }
        },
        Recovered::Lost(lost) => {
            losses.report_loss(&lost);
            Ok(())
        }
    })
}

/// Writes the single selected frame to stdout.
fn to_stdout(
    args: &DecodeArgs,
    path: &Path,
    (options, chosen): (&DecodeOptions, &ChosenFrames),
    converter: &Converter,
    console: Console,
) -> Result<()> {
    if io::stdout().is_terminal() {
        wrong_usage(
            "decode",
            "the terminal would show bytes; give -o FOLDER, or a pipe or a file for stdout",
        );
    }
    let input = open(path)?;
    let mut only: Option<DecodedFrame> = None;
    let mut losses = Losses::new(path, options.frames);
    let decoded = decode(args, input, options, &mut losses, DecodedFrame::checked, |frame| {
        if !chosen.contains(&frame.header.stamp) {
            return Ok(());
        }
        match only.replace(frame) {
            None => Ok(()),
            Some(_) => Err(Error::Usage("stdout takes one frame; choose one, as by --frames 5".to_owned())),
        }
    });
    decoded.map_err(|error| about(error, &name_of(path)))?;
    let Some(frame) = only else { bail!("{}: holds no frame", name_of(path)) };
    let file = converter.file(frame)?;
    let mut stdout = io::stdout().lock();
    let written = file.write(&mut |piece| Ok(stdout.write_all(piece)?));
    written.and_then(|()| Ok(stdout.flush()?)).context("stdout")?;
    converter.report_unconverted(console);
    losses.check(1)
}
