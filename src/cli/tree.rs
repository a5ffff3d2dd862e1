//! Trees: each drive of a tree is encoded to a stream of its own in a folder, and each stream of a folder is
//! decoded to a folder of its own.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::files::names::natural_cmp;
use crate::files::sequence::{FoundFile, LeftOut, LeftOutKind, STREAM_EXTENSION};
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Error;
use crate::ground::team::{locked, resolve_threads};
use crate::study::metrics;
use anyhow::{Context, Result, bail, ensure};
use indicatif::ProgressBar;
use serde::Serialize;

use super::args::{DecodeArgs, EncodeArgs, wrong_usage};
use super::console::{Console, to_stderr};
use super::encoding::{Done, encode_inputs};
use super::errors::{NotWhole, say};
use super::frames::{self, InputFiles};
use super::input::{is_dash, streams_below};
use super::output::{create_folders, parent, print_json};
use super::readable;
use super::report::{LeftOutReport, StreamReport, summary};

/// Whether an output is a folder: it is one, or its name ends in a slash.
pub fn is_folder(output: &Path) -> bool {
    output.is_dir() || output.to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR])
}

/// A drive, and the path of its stream.
struct Drive {
    output: PathBuf,
    found: InputFiles,
}

/// The machine-readable report.
#[derive(Serialize)]
struct TreeReport<'a> {
    drives: Vec<&'a StreamReport>,
    /// Items left out of all inputs; the drives do not list their own.
    left_out: Vec<LeftOutReport>,
}

/// `encode` into a folder: a stream for each drive.
pub fn encode(args: &EncodeArgs, config: &EncoderConfig, console: Console) -> Result<()> {
    let start = Instant::now();
    let (drives, left_out) = drives(args, console)?;
    let threads = resolve_threads(config.threads);
    let jobs = args.jobs.map_or(if drives.len() >= threads { threads } else { 1 }, usize::from);
    let each = EncoderConfig { threads: (threads / jobs).max(1), ..config.clone() };
    let frames = drives.iter().map(|drive| drive.found.frames.len() as u64).sum();
    let bar =
        console.bar(Some(frames), format!("encoding {}", readable::count(drives.len() as u64, "drive")));
    let reports = encode_each(args, &each, &drives, jobs, &bar, console);
    bar.finish_and_clear();
    let failed = reports.iter().filter(|report| report.is_err()).count();
    let reports: Vec<DriveReport> = reports.into_iter().flatten().collect();
    if args.json {
        print_json(&TreeReport {
            drives: reports.iter().map(|report| &report.stream).collect(),
            left_out: LeftOutReport::of(&left_out),
        })?;
    } else if !console.is_quiet {
        let (complete, done): (Vec<_>, Vec<_>) =
            reports.into_iter().partition(|report| report.stream.was_complete);
        print(&done, complete.len(), args.verbose, start);
    }
    ensure!(failed == 0, "{failed} of {} failed", readable::count(drives.len() as u64, "drive"));
    Ok(())
}

/// Encodes drives, `jobs` at a time. Their reports, in the order of the drives; errors are printed as they
/// occur.
fn encode_each(
    args: &EncodeArgs,
    config: &EncoderConfig,
    drives: &[Drive],
    jobs: usize,
    bar: &ProgressBar,
    console: Console,
) -> Vec<Result<DriveReport>> {
    let (next, reports) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(drives.len()) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(drive) = drives.get(number) else { break };
                    let report = encode_drive(args, config, drive, console);
                    if let Err(error) = &report {
                        bar.suspend(|| say(error));
                    }
                    bar.inc(drive.found.frames.len() as u64);
                    locked(&reports).insert(number, report);
                }
            });
        }
    });
    reports.into_inner().unwrap_or_else(PoisonError::into_inner).into_values().collect()
}

/// Prints a line for each drive, unless there are many, and one for all. `complete` had been encoded before.
fn print(done: &[DriveReport], complete: usize, is_verbose: bool, start: Instant) {
    /// The largest number of drives whose lines are printed unasked.
    const FEW: usize = 20;
    if done.is_empty() && complete > 0 {
        let drives = readable::count(complete as u64, "drive");
        to_stderr(format_args!("{drives}: already complete, from these files with these settings"));
        return;
    }
    for DriveReport { stream, line } in done.iter().filter(|_| done.len() <= FEW || is_verbose) {
        to_stderr(format_args!("{}: {line}", stream.file));
    }
    let of_all =
        |count: fn(&StreamReport) -> u64| done.iter().map(|report| count(&report.stream)).sum::<u64>();
    let (before, after) = (of_all(|report| report.file_bytes), of_all(|report| report.stream_bytes));
    let complete = match complete {
        0 => String::new(),
        drives => format!(", {} there already", readable::count(drives as u64, "drive")),
    };
    to_stderr(format_args!(
        "{}, {}: {} -> {} ({}){complete} in {:.1} s",
        readable::count(done.len() as u64, "drive"),
        readable::count(of_all(|report| report.frames), "frame"),
        readable::bytes(before),
        readable::bytes(after),
        readable::percent(metrics::ratio(before, after)),
        start.elapsed().as_secs_f64(),
    ));
}

/// The drives of the inputs, and what is left out of these. As the same names may occur in several inputs,
/// folders are searched one by one, and files are grouped by their folders.
fn drives(args: &EncodeArgs, console: Console) -> Result<(Vec<Drive>, LeftOut)> {
    let mut inputs: Vec<(PathBuf, Vec<PathBuf>)> = Vec::new();
    for input in &args.inputs {
        let folder = if input.is_dir() { input.as_path() } else { parent(input) };
        match inputs.iter_mut().find(|(known, _)| !input.is_dir() && known == folder) {
            Some((_, files)) => files.push(input.clone()),
            None => inputs.push((folder.to_path_buf(), vec![input.clone()])),
        }
    }
    let several = inputs.len() > 1;
    let (mut drives, mut left_out) = (BTreeMap::new(), LeftOut::default());
    for (folder, inputs) in &inputs {
        let whole = fs::canonicalize(folder).with_context(|| folder.display().to_string())?;
        let own_name = PathBuf::from(whole.file_name().unwrap_or_default());
        let args = EncodeArgs { inputs: inputs.clone(), ..args.clone() };
        let mut found = frames::find(&args, console)?;
        left_out.extend(std::mem::take(&mut found.left_out));
        for (drive, found) in drives_of(&args, found, &mut left_out, console)? {
            let below = match (drive.is_empty(), several) {
                (true, _) => own_name.clone(),
                (false, false) => PathBuf::from(drive),
                (false, true) => own_name.join(drive),
            };
            let mut output = args.output().join(below).into_os_string();
            output.push(".");
            output.push(STREAM_EXTENSION);
            if drives.insert(PathBuf::from(&output), found).is_some() {
                let what = "would become a file that another input becomes too; encode them apart".to_owned();
                bail!(Error::Input { path: folder.clone(), what });
            }
        }
    }
    let mut drives: Vec<_> = drives.into_iter().map(|(output, found)| Drive { output, found }).collect();
    drives.sort_by(|a, b| natural_cmp(&a.output.to_string_lossy(), &b.output.to_string_lossy()));
    Ok((drives, left_out))
}

/// The files found, drive by drive, with names below the drive; files in no drive are left out.
fn drives_of(
    args: &EncodeArgs,
    found: InputFiles,
    left_out: &mut LeftOut,
    console: Console,
) -> Result<BTreeMap<String, InputFiles>> {
    let mut drives: BTreeMap<String, InputFiles> = BTreeMap::new();
    let mut beyond = LeftOut::default();
    let frames = found.frames.into_iter().map(|file| (true, file));
    let files = frames.chain(found.beside.into_iter().map(|file| (false, file)));
    for (is_scan, FoundFile { path, name, drive, time }) in files {
        let name = match drive.is_empty() {
            true => name,
            false => name.get(drive.len() + 1..).unwrap_or_default().to_owned(),
        };
        let file = FoundFile { path, name, drive: String::new(), time };
        match (is_scan, drives.get_mut(&drive)) {
            (true, _) => drives.entry(drive).or_default().frames.push(file),
            (false, Some(drive)) => drive.beside.push(file),
            (false, None) => {
                let bytes = fs::metadata(&file.path).map_or(0, |about| about.len());
                beyond.add(LeftOutKind::OutsideDrives, file.path.display().to_string(), bytes);
            }
        }
    }
    frames::check_left_out(&beyond, &frames::name_of_inputs(&args.inputs), args.strict, console)?;
    left_out.extend(beyond);
    Ok(drives)
}

/// The report on a drive, machine-readable and as a line of text.
struct DriveReport {
    stream: StreamReport,
    line: String,
}

/// Encodes a drive or, with `--resume`, compares its complete stream with it.
fn encode_drive(
    args: &EncodeArgs,
    config: &EncoderConfig,
    drive: &Drive,
    console: Console,
) -> Result<DriveReport> {
    let start = Instant::now();
    let args = &EncodeArgs { output: Some(drive.output.clone()), ..args.clone() };
    let place = drive.output.display().to_string();
    if let Some(folder) = drive.output.parent() {
        create_folders(folder)?;
    }
    let mut config = config.clone();
    frames::settle(&drive.found.frames, &mut config, &place, console)?;
    let Done { encoded, was_complete, .. } = encode_inputs(args, &config, &drive.found, Console::SILENT)?;
    if args.rm {
        drive.found.delete(&args.inputs, &encoded, (&place, console))?;
    }
    let seconds = start.elapsed().as_secs_f64();
    let mut stream = StreamReport::of(args, &config, &encoded, &drive.found.left_out, seconds);
    stream.was_complete = was_complete;
    Ok(DriveReport { stream, line: summary(args, &config, &encoded) })
}

/// `decode` for a folder of streams: `decode_stream` decodes each into a folder with its path and name.
pub fn decode(args: &DecodeArgs, mut decode_stream: impl FnMut(&DecodeArgs) -> Result<()>) -> Result<()> {
    let [input] = &args.inputs[..] else {
        wrong_usage("decode", "a folder of streams is decoded by itself");
    };
    if is_dash(args.output()) {
        wrong_usage("decode", "stdout takes one frame, and so a single file; give -o FOLDER");
    }
    let streams = streams_below(input)?;
    let (mut failed, mut not_whole) = (0, 0);
    for stream in &streams {
        let below = stream.strip_prefix(input).unwrap_or(stream).with_extension("");
        let args = DecodeArgs {
            inputs: vec![stream.clone()],
            output: Some(args.output().join(below)),
            ..args.clone()
        };
        if let Err(error) = decode_stream(&args) {
            say(&error);
            match error.is::<NotWhole>() {
                true => not_whole += 1,
                false => failed += 1,
            }
        }
    }
    let files = readable::count(streams.len() as u64, "file");
    ensure!(failed == 0, "{failed} of {files} failed");
    match not_whole {
        0 => Ok(()),
        _ => {
            Err(NotWhole(format!("{not_whole} of {files} damaged; what is intact of them was saved")).into())
        }
    }
}
