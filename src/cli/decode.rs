//! `lidarpc decode`

use std::collections::HashMap;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::container::Unit;
use crate::edit::{self, Recovered};
use crate::files::sequence::STREAM_EXTENSION;
use crate::files::{FileFormat, Give, convert, is_convertible};
use crate::ground::error::{Error, Limits};
use crate::scan::ScanFile;
use crate::stream::{DecodeOptions, DecodedFrame};
use anyhow::{Context, Result, bail};
use serde::Serialize;

use super::args::{DecodeArgs, FormatArg, wrong_usage};
use super::errors::{about, say};
use super::input::{
    Input, check_stdin_once, chosen_frames, is_dash, is_pipe, is_recording, name_of, open,
    tell_files_left_out,
};
use super::losses::{LossReport, Losses};
use super::output::{FolderOutput, check_json, print_json};
use super::{messages, progress, recording, table, tree};

/// The machine-readable report.
#[derive(Serialize)]
struct Report {
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
        let folder = folder.replace(char::is_control, "?");
        let frames = table::frames_and_files(self.frames, self.files_beside);
        format!("{folder}: {frames}: {} in {seconds:.1} s", table::bytes(*file_bytes))
    }
}

pub fn run(args: &DecodeArgs, quiet: bool) -> Result<()> {
    let args = &DecodeArgs { output: Some(output_of(args)), ..args.clone() };
    check_stdin_once("decode", &args.inputs);
    check_json("decode", args.json, args.output());
    if args.inputs.iter().any(|input| input.is_dir()) {
        return tree::decode_all(args, quiet);
    }
    if args.inputs.iter().any(|input| is_recording(input)) {
        return recording::decode(args, quiet);
    }
    if !args.topic.is_empty() {
        wrong_usage("decode", "--topic chooses clouds of a recording; the input is none");
    }
    let [first, others @ ..] = &args.inputs[..] else { return Ok(()) };
    if (args.frames.is_some() || args.time.is_some()) && !others.is_empty() {
        wrong_usage("decode", "--frames and --time choose frames of one file; decode the files one by one");
    }
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        frames: chosen_frames("decode", first, (args.frames, args.time), args.limits.limits(), quiet)?,
        ..DecodeOptions::default()
    };
    let converter = Converter::new(args.format);
    if args.messages {
        return messages::decode(args, &options, &converter, quiet);
    }
    if is_dash(args.output()) {
        if !others.is_empty() {
            wrong_usage("decode", "stdout takes one frame, and so a single file");
        }
        return to_stdout(args, first, &options, &converter, quiet);
    }
    to_folder(args, &options, &converter, quiet)
}

/// Decodes the inputs into a folder, and reports.
fn to_folder(args: &DecodeArgs, options: &DecodeOptions, converter: &Converter, quiet: bool) -> Result<()> {
    let start = Instant::now();
    // Before any output is created. Only one input is open at a time, as the system limits their number.
    let counts = args.inputs.iter().map(|path| frame_count(path, options.limits));
    let total = counts.sum::<Result<Option<u64>>>()?.map(|total| options.frames.count_of(total));
    let folder = FolderOutput::create(args.output(), args.force)?.keeping(&args.inputs);
    let bar = progress::bar(total, "decoding", quiet);
    let (mut files, mut bytes, mut beside) = (0, 0, 0);
    let mut all_losses = Vec::new();
    for path in &args.inputs {
        let input = open(path)?;
        let before = files;
        let mut losses = Losses::new(path, options.frames);
        let write = |frame: DecodedFrame| {
            let is_beside = frame.header.stamp.unit == Unit::Beside;
            let file = converter.file(frame)?;
            Ok((folder.write(file.name(), |give| file.write(give))?, is_beside))
        };
        let count = |(file_bytes, is_beside): (u64, bool)| {
            bar.inc(1);
            files += 1;
            bytes += file_bytes;
            beside += u64::from(is_beside);
            Ok(())
        };
        let left_out = decode(args, input, options, &mut losses, write, count).map_err(|error| {
            bar.finish_and_clear();
            about(error, &name_of(path))
        })?;
        tell_files_left_out(path, left_out, quiet);
        all_losses.push((losses, files - before));
    }
    bar.finish_and_clear();
    folder.finish()?;
    converter.tell(quiet);
    let report = Report {
        folder: args.output().display().to_string(),
        frames: files - beside,
        files_beside: beside,
        file_bytes: bytes,
        lost: all_losses.iter().filter_map(|(losses, _)| losses.report()).collect(),
        seconds: start.elapsed().as_secs_f64(),
    };
    if args.json {
        print_json(&report)?;
    } else if !quiet {
        eprintln!("{}", report.summary());
    }
    let mut damaged = all_losses.iter().filter_map(|(losses, frames)| losses.check(*frames).err());
    let Some(error) = damaged.next() else { return Ok(()) };
    damaged.for_each(|error| say(&error));
    Err(error)
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

/// The output, or by default a folder beside the input, with its name.
fn output_of(args: &DecodeArgs) -> PathBuf {
    if let Some(output) = &args.output {
        return output.clone();
    }
    match &args.inputs[..] {
        [input] if input.extension().is_some_and(|ending| ending == STREAM_EXTENSION) => {
            input.with_extension("")
        }
        _ => wrong_usage("decode", "say where to, by -o FOLDER: the input gives no name for the output"),
    }
}

/// Decodes as the arguments say: all frames or an error, or the intact ones. Calls `work` on each frame, and
/// passes the results to `sink`, in order. Returns the number of files beside the scans that are left out because only
/// some frames are wanted; of a damaged stream, those that are intact.
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
    edit::recover(BufReader::new(input.rewindable()?), options, |part| match part {
        // Only now: whether a frame is lost with its group is known after the whole group is decoded.
        Recovered::Frame(frame) => sink(work(*frame)?),
        Recovered::Lost(lost) => {
            losses.tell(&lost);
            Ok(())
        }
    })
}

/// Writes the single selected frame to stdout.
fn to_stdout(
    args: &DecodeArgs,
    path: &Path,
    options: &DecodeOptions,
    converter: &Converter,
    quiet: bool,
) -> Result<()> {
    let input = open(path)?;
    let mut only: Option<DecodedFrame> = None;
    let mut losses = Losses::new(path, options.frames);
    let decoded =
        decode(args, input, options, &mut losses, DecodedFrame::checked, |frame| match only.replace(frame) {
            None => Ok(()),
            Some(_) => Err(Error::Usage("stdout takes one frame; choose one, as by --frames 5".to_owned())),
        });
    decoded.map_err(|error| about(error, &name_of(path)))?;
    let Some(frame) = only else { bail!("{}: holds no frame", name_of(path)) };
    let file = converter.file(frame)?;
    let mut stdout = io::stdout().lock();
    let written = file.write(&mut |piece| Ok(stdout.write_all(piece)?));
    written.and_then(|()| Ok(stdout.flush()?)).context("stdout")?;
    converter.tell(quiet);
    losses.check(1)
}

/// A file to write.
pub enum File {
    /// The original file.
    Original(Box<DecodedFrame>),
    /// A file in another format.
    Converted(Box<ScanFile>),
}

impl File {
    pub fn name(&self) -> &str {
        match self {
            File::Original(frame) => &frame.header.name,
            File::Converted(scan) => &scan.name,
        }
    }

    /// Passes its bytes to `give`, piece by piece.
    pub fn write(&self, give: &mut Give<'_>) -> crate::ground::error::Result<()> {
        match self {
            File::Original(frame) => frame.write(give),
            File::Converted(scan) => crate::files::write(scan, give),
        }
    }
}

/// Converts frames to files: the original ones, or in another format.
pub struct Converter {
    format: Option<FileFormat>,
    /// The frames' own names, by the names of the written files.
    names: Mutex<HashMap<String, String>>,
    /// Files without points, which cannot be converted: their number, and the number and name of the first frame of them.
    pointless: Mutex<(u64, Option<(u64, String)>)>,
}

impl Converter {
    fn new(format: Option<FormatArg>) -> Self {
        let format = format.map(FormatArg::format);
        Converter { format, names: Mutex::default(), pointless: Mutex::default() }
    }

    /// Tells how many files were not converted.
    pub fn tell(&self, quiet: bool) {
        let pointless = self.pointless.lock().unwrap_or_else(PoisonError::into_inner);
        if let ((count, Some((_, first))), false) = (&*pointless, quiet) {
            let first = first.replace(char::is_control, "?");
            let files = table::count(*count, "file");
            eprintln!(
                "lidarpc: {files} without points, such as {first}: not converted, but written as stored"
            );
        }
    }

    /// The file of a frame. Files without points are not converted.
    ///
    /// # Errors
    /// If the frame cannot be converted, or if another frame already has its file name.
    pub fn file(&self, frame: DecodedFrame) -> crate::ground::error::Result<File> {
        // Points in memory are converted to a format that names their channels.
        let of_points = (frame.header.stamp.unit == Unit::Points).then_some(FileFormat::Pcd);
        let is_beside = frame.header.stamp.unit == Unit::Beside;
        let Some(format) = self.format.filter(|_| !is_beside).or(of_points) else {
            return Ok(File::Original(Box::new(frame)));
        };
        let frame = frame.checked()?;
        let name = frame.header.name.clone();
        let file = if !is_convertible(&frame.scan) {
            let mut pointless = self.pointless.lock().unwrap_or_else(PoisonError::into_inner);
            pointless.0 += 1;
            let this = (frame.number, name.clone());
            pointless.1 = Some(pointless.1.take().map_or(this.clone(), |first| first.min(this)));
            File::Original(Box::new(frame))
        } else {
            let DecodedFrame { number, mut scan, .. } = frame;
            if scan.name.is_empty() {
                scan.name = format!("{number:06}");
            }
            File::Converted(Box::new(convert(&scan, format)?))
        };
        let mut names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(other) = names.insert(file.name().to_owned(), name.clone()) {
            let what = format!("becomes {}, as {other} does; decode them apart, by --frames", file.name());
            return Err(Error::Input { path: name.into(), what });
        }
        drop(names);
        Ok(file)
    }
}
