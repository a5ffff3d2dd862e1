//! Inputs: what kind they are of, streams to read from a file or from stdin, and the scans to compare them
//! with.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use crate::container::{IndexedReader, MAGIC, Stamp};
use crate::files::names::{is_safe_path, natural_cmp};
use crate::files::sequence::{STREAM_EXTENSION, find_frames};
use crate::ground::error::{Error, Limits, Result};
use crate::stream::{self, DecodeOptions, DecodedFrame, FrameRange};
use anyhow::Context;

use super::args::wrong_usage;
use super::console::Console;
use super::errors::{about, is_closed_pipe, say};
use super::readable;
use super::time_range::{TimeRange, Times};

/// A stream to read.
pub enum Input {
    /// A seekable file.
    File(File),
    /// Anything else: stdin, a named pipe.
    Pipe(Box<dyn Read + Send>),
}

impl Input {
    /// Opens the file; `-` is stdin.
    ///
    /// # Errors
    /// If it cannot be opened, or is a folder.
    pub fn open(path: &Path) -> Result<Self> {
        if is_dash(path) {
            return Ok(Input::Pipe(Box::new(io::stdin())));
        }
        let mut file = File::open(path)?;
        if file.metadata()?.is_dir() {
            return Err(io::Error::from(io::ErrorKind::IsADirectory).into());
        }
        let can_seek = file.stream_position().is_ok();
        Ok(if can_seek { Input::File(file) } else { Input::Pipe(Box::new(file)) })
    }

    /// The number of frames in the stream, if it can be determined beforehand.
    pub fn frame_count(&self, limits: Limits) -> Option<u64> {
        let Input::File(file) = self else { return None };
        let index = IndexedReader::open(BufReader::new(file), limits);
        let mut file: &File = file;
        file.rewind().ok()?;
        Some(index.ok()?.index().frame_count())
    }

    /// The stream, to be read from the front.
    pub fn reader(self) -> Box<dyn Read + Send> {
        match self {
            Input::File(file) => Box::new(BufReader::new(file)),
            Input::Pipe(pipe) => Box::new(BufReader::new(pipe)),
        }
    }

    /// The stream as a file that can be read twice: a pipe is first copied to an unnamed temporary file.
    pub fn rewindable(self) -> Result<File> {
        match self {
            Input::File(file) => Ok(file),
            Input::Pipe(mut pipe) => {
                let mut copy = tempfile::tempfile()?;
                io::copy(&mut pipe, &mut copy)?;
                copy.rewind()?;
                Ok(copy)
            }
        }
    }

    /// Decodes the stream; if only some frames are requested and the input is seekable, only their groups are
    /// read. Returns the number of files beside the scans that are left out.
    ///
    /// # Errors
    /// As [`stream::decode`].
    pub fn decode<T: Send>(
        self,
        options: &DecodeOptions,
        work: impl Fn(DecodedFrame) -> Result<T> + Sync,
        sink: impl FnMut(T) -> Result<()>,
    ) -> Result<u64> {
        match self {
            Input::File(file) if !options.frames.is_all() => {
                stream::decode_indexed(BufReader::new(file), options, work, sink)
            }
            other => stream::decode(other.reader(), options, work, sink),
        }
    }
}

/// Says that files beside the scans are left out because only some frames are wanted.
pub fn report_files_left_out(path: &Path, files: u64, console: Console) {
    if files > 0 {
        let (name, files) = (name_of(path), readable::count(files, "file"));
        console.say(format_args!(
            "lidarpc: {name}: left out {files} beside the scans, which only a whole stream gives"
        ));
    }
}

/// Whether the path means stdin or stdout.
pub fn is_dash(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Whether the path is that of a pipe, which can be read only once: `<(command)` of a shell, for example.
pub fn is_pipe(path: &Path) -> bool {
    path.metadata().is_ok_and(|kind| !kind.is_file() && !kind.is_dir())
}

/// The first bytes of a file; `None` if it does not exist, is too short, or can be read only once.
fn first_bytes<const N: usize>(path: &Path) -> Option<[u8; N]> {
    let mut start = [0; N];
    let is_file = path.metadata().is_ok_and(|kind| kind.is_file());
    is_file.then(|| File::open(path)?.read_exact(&mut start)).and_then(io::Result::ok).map(|()| start)
}

/// Whether an input is a stream: it begins like one, or is stdin or a pipe.
pub fn is_stream(path: &Path) -> bool {
    is_dash(path) || is_pipe(path) || first_bytes(path) == Some(MAGIC)
}

/// Whether an input is a recording: by its first bytes, or, if it does not exist yet or cannot be read twice,
/// by its name.
pub fn is_recording(path: &Path) -> bool {
    const START: &[u8; 8] = b"\x89MCAP0\r\n";
    match first_bytes(path) {
        Some(start) => start == *START,
        None => is_named_as_recording(path),
    }
}

/// Whether the name is that of a recording.
pub fn is_named_as_recording(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// Ends the program if an input of a subcommand that takes only streams is a recording.
pub fn refuse_recordings(subcommand: &str, inputs: &[PathBuf], advice: &str) {
    if inputs.iter().any(|input| is_recording(input)) {
        wrong_usage(subcommand, format!("a recording is no stream; {advice}"));
    }
}

/// The name of an input in messages.
pub fn name_of(path: &Path) -> String {
    if is_dash(path) { "stdin".to_owned() } else { path.display().to_string() }
}

/// The original scans that a stream is compared with, by name.
pub struct Originals {
    files: HashMap<String, PathBuf>,
    /// Those that no stream had so far.
    left: BTreeSet<PathBuf>,
    /// The folder that contains them.
    folder: PathBuf,
}

impl Originals {
    /// Finds the scans as `encode` does.
    ///
    /// # Errors
    /// As [`find_frames`].
    pub fn find(inputs: &[PathBuf]) -> Result<Self> {
        let files = find_frames(inputs)?.frames.into_iter().map(|file| (file.name, file.path));
        let files: HashMap<String, PathBuf> = files.collect();
        let left = files.values().cloned().collect();
        Ok(Originals { files, left, folder: inputs.first().cloned().unwrap_or_default() })
    }

    /// Reads the scan with this name, or the file with this name according to `encode --all`, and marks it as
    /// found. An empty folder reads as no bytes.
    ///
    /// # Errors
    /// If there is no such scan, or if it cannot be read.
    pub fn take(&mut self, name: &str) -> Result<Vec<u8>> {
        let path = self.files.get(name).cloned().or_else(|| self.below(name)).ok_or_else(|| {
            let what = format!("holds no scan named {name:?}, which the stream does");
            Error::Input { path: self.folder.clone(), what }
        })?;
        self.left.remove(&path);
        if name.ends_with('/') {
            return Ok(Vec::new());
        }
        std::fs::read(&path).map_err(|e| Error::from(e).at(&path))
    }

    /// The file with this path below the folder, if there is one.
    fn below(&self, name: &str) -> Option<PathBuf> {
        let is_safe = is_safe_path(name.strip_suffix('/').unwrap_or(name));
        is_safe.then(|| self.folder.join(name)).filter(|path| path.exists())
    }

    /// The first of the scans that were never read, and how many there are.
    pub fn left_over(&self) -> Option<(&Path, usize)> {
        self.left.first().map(|first| (first.as_path(), self.left.len()))
    }
}

/// Opens a stream; errors contain its name.
///
/// # Errors
/// As [`Input::open`].
pub fn open(path: &Path) -> anyhow::Result<Input> {
    Input::open(path).map_err(|error| about(error, &name_of(path)))
}

/// The frames selected by `--frames` or `--time`.
#[derive(Clone, Copy, Default)]
pub struct ChosenFrames {
    /// All from the first to the last of them.
    pub range: FrameRange,
    /// If some of these have times that were not selected: those that were.
    pub times: Option<Times>,
}

impl ChosenFrames {
    /// Those selected by the arguments; without these, all. Tells how many are left out because they have no
    /// time.
    ///
    /// # Errors
    /// If there is no frame at that time, or if the times cannot be read.
    pub fn of(
        subcommand: &str,
        path: &Path,
        (frames, time): (Option<FrameRange>, Option<TimeRange>),
        limits: Limits,
        console: Console,
    ) -> anyhow::Result<Self> {
        let Some(time) = time else {
            return Ok(ChosenFrames { range: frames.unwrap_or_default(), times: None });
        };
        let Input::File(file) = open(path)? else {
            wrong_usage(subcommand, "--time needs a file that can be sought in; choose by --frames");
        };
        let reader = IndexedReader::open(BufReader::new(file), limits);
        let found = reader.and_then(|reader| time.frames(reader.index()));
        let found = found.map_err(|error| about(error, &name_of(path)))?;
        if found.untimed > 0 {
            let (name, frames) = (name_of(path), readable::count(found.untimed, "frame"));
            console.say(format_args!(
                "lidarpc: {name}: left out {frames} without a time; --frames chooses by number"
            ));
        }
        let times = (found.of_other_times > 0).then_some(found.times);
        Ok(ChosenFrames { range: found.frames, times })
    }

    /// Whether a frame of the range is one of them.
    pub fn contains(&self, stamp: &Stamp) -> bool {
        match (self.times, stamp.time) {
            (Some(times), Some(time)) => times.contains(time.nanoseconds),
            _ => true,
        }
    }
}

/// The inputs, with the streams in a folder and below it in place of the folder.
///
/// # Errors
/// If a folder cannot be read, or holds no stream.
pub fn with_folders_searched(inputs: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let files = inputs.iter().map(|input| match input.is_dir() {
        true => streams_below(input),
        false => Ok(vec![input.clone()]),
    });
    Ok(files.collect::<anyhow::Result<Vec<_>>>()?.concat())
}

/// The files in a folder and below it that are streams by their names, in natural order.
///
/// # Errors
/// If a folder cannot be read, or there is no stream.
pub fn streams_below(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let (mut open, mut streams) = (vec![folder.to_path_buf()], Vec::new());
    while let Some(folder) = open.pop() {
        let entries = fs::read_dir(&folder).with_context(|| folder.display().to_string())?;
        for entry in entries {
            let entry = entry.with_context(|| folder.display().to_string())?;
            let kind = entry.file_type().with_context(|| entry.path().display().to_string())?;
            let path = entry.path();
            if kind.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(STREAM_EXTENSION))
                && !is_pipe(&path)
            {
                // A file that is no stream is damaged, or empty: an error, not another file.
                streams.push(path);
            }
        }
    }
    if streams.is_empty() {
        let what = "holds no stream; give a file that `lidarpc encode` wrote, or a folder of such".to_owned();
        anyhow::bail!(Error::Input { path: folder.to_path_buf(), what });
    }
    streams.sort_by(|a, b| natural_cmp(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(streams)
}

/// Calls `work` on each file. If there are several, failures are reported and the other files are still
/// processed.
///
/// # Errors
/// That of the only file; of several, how many failed.
pub fn for_each_file(
    subcommand: &str,
    inputs: &[PathBuf],
    mut work: impl FnMut(&Path) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    check_stdin_once(subcommand, inputs);
    if let [input] = inputs {
        return work(input);
    }
    let mut failed = 0;
    for input in inputs {
        match work(input) {
            Ok(()) => {}
            Err(error) if is_closed_pipe(&error) => return Err(error),
            Err(error) => {
                say(&error);
                failed += 1;
            }
        }
    }
    anyhow::ensure!(failed == 0, "{failed} of {} files failed", inputs.len());
    Ok(())
}

/// Ends the program if stdin is named more than once.
pub fn check_stdin_once(subcommand: &str, inputs: &[PathBuf]) {
    if inputs.iter().filter(|path| is_dash(path)).count() > 1 {
        wrong_usage(subcommand, "stdin can be read only once; give `-` once");
    }
}
