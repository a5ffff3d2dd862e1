//! Output that exists only when complete: it is written under a temporary name in the same folder, then
//! renamed.

use std::collections::{BTreeSet, HashSet};
use std::fs::{self, File};
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use crate::container::FrameHeader;
use crate::files::Give;
use crate::files::names::is_safe_path;
use crate::ground::error::{Error, Result};
use crate::ground::team::locked;
use serde::Serialize;
use tempfile::{NamedTempFile, TempDir, TempPath};

use super::args::wrong_usage;
use super::errors::about;
use super::input::is_dash;
use super::signals::RemoveOnSignal;
use super::temporary;

/// One file to write.
pub enum FileOutput {
    /// Under a temporary name until it is complete.
    Temporary { file: NamedTempFile, target: PathBuf, force: bool, _remove: RemoveOnSignal },
    /// Stdout, or a path that cannot be replaced, such as a device or a named pipe.
    Direct(Box<dyn Write>),
}

impl FileOutput {
    /// Opens the output; `-` is stdout.
    ///
    /// # Errors
    /// If it exists and `force` is not set, or if it cannot be written.
    pub fn create(path: &Path, force: bool) -> anyhow::Result<Self> {
        if is_dash(path) {
            return Ok(FileOutput::Direct(Box::new(io::stdout().lock())));
        }
        Self::create_file(path, force).map_err(|error| about(error, &path.display().to_string()))
    }

    /// As [`create`](Self::create), for binary data: rejects a terminal.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn binary(path: &Path, force: bool) -> anyhow::Result<Self> {
        if is_dash(path) && io::stdout().is_terminal() {
            anyhow::bail!(
                "stdout: is a terminal, which cannot show a file of this kind; redirect it, or give -o FILE"
            );
        }
        Self::create(path, force)
    }

    fn create_file(path: &Path, force: bool) -> Result<Self> {
        let Some(target) = replaceable(path, force)? else {
            return Ok(FileOutput::Direct(Box::new(File::create(path)?)));
        };
        let folder = parent(&target);
        let file = temporary::file(folder).map_err(|error| not_created(folder, folder, error))?;
        let _remove = RemoveOnSignal::new(file.path());
        Ok(FileOutput::Temporary { file, target, force, _remove })
    }

    /// The writer. It is buffered; flush it before [`FileOutput::finish`].
    pub fn writer(&mut self) -> BufWriter<&mut dyn Write> {
        match self {
            FileOutput::Temporary { file, .. } => BufWriter::new(file.as_file_mut()),
            FileOutput::Direct(out) => BufWriter::new(out),
        }
    }

    /// Writes the output with `write`, and flushes it.
    ///
    /// # Errors
    /// Those of `write`, or if flushing fails.
    pub fn write<T>(&mut self, write: impl FnOnce(&mut BufWriter<&mut dyn Write>) -> Result<T>) -> Result<T> {
        let mut writer = self.writer();
        let written = write(&mut writer)?;
        writer.flush()?;
        Ok(written)
    }

    /// The output so far, to be read back; `None` if it went to a pipe.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn reopen(&self) -> Result<Option<File>> {
        match self {
            FileOutput::Temporary { file, .. } => Ok(Some(file.reopen()?)),
            FileOutput::Direct(_) => Ok(None),
        }
    }

    /// Flushes everything to disk, and renames the file.
    ///
    /// # Errors
    /// If this fails, or if there is now a file with that name and `force` is not set.
    pub fn finish(self) -> Result<()> {
        let FileOutput::Temporary { file, target, force, _remove } = self else { return Ok(()) };
        file.as_file().sync_all()?;
        Ok(rename_durably(file.into_temp_path(), &target, force)?)
    }
}

/// Ensures that no input is overwritten.
///
/// # Errors
/// If the output is one of the inputs.
pub fn keep_inputs(output: &Path, inputs: &[PathBuf]) -> Result<()> {
    // A path that does not exist, or is not a file, is not an input.
    let Ok(target) = fs::canonicalize(output) else { return Ok(()) };
    let is_target = |input: &PathBuf| fs::canonicalize(input).is_ok_and(|input| input == target);
    if !is_dash(output) && target.is_file() && inputs.iter().any(is_target) {
        let what = "is an input as well, which would be overwritten; choose another output".to_owned();
        return Err(Error::Input { path: output.to_path_buf(), what });
    }
    Ok(())
}

/// Ends the program if a machine-readable report would be mixed with the output.
pub fn check_json(subcommand: &str, json: bool, output: &Path) {
    if json && is_dash(output) {
        wrong_usage(subcommand, "--json writes to stdout, which takes the output");
    }
}

/// Writes a machine-readable report to stdout.
///
/// # Errors
/// If this fails.
pub fn print_json(report: &impl Serialize) -> anyhow::Result<()> {
    let mut out = BufWriter::new(io::stdout().lock());
    serde_json::to_writer_pretty(&mut out, report).map_err(io::Error::from)?;
    writeln!(out)?;
    Ok(out.flush()?)
}

/// The names of a stream's frames, which are those of the files to which it is decoded.
#[derive(Default)]
pub struct FrameNames(HashSet<String>);

impl FrameNames {
    /// Adds the name of a frame.
    ///
    /// # Errors
    /// If no file can have it: it is not a [safe path](is_safe_path), or another frame has it.
    pub fn check(&mut self, number: u64, header: &FrameHeader) -> Result<()> {
        let name = &header.name;
        // The name of an empty folder ends in a slash; no folder has bytes.
        let folder = name.strip_suffix('/').filter(|_| header.file_size == 0);
        let fault = if !header.names_file() {
            return Ok(());
        } else if !is_safe_path(folder.unwrap_or(name)) {
            "which is not safe for a file"
        } else if !self.0.insert(name.to_owned()) {
            "which another frame has"
        } else {
            return Ok(());
        };
        let advice = "`decode --keep-going` leaves it out";
        Err(Error::Usage(format!("frame {number} has the name {name:?}, {fault}; {advice}")))
    }
}

/// The file to which the path [leads](through_link), whether it exists or not. `None` if it cannot be
/// replaced because it is a device or a named pipe.
///
/// # Errors
/// If it is a folder, or exists and `force` is not set.
pub fn replaceable(path: &Path, force: bool) -> io::Result<Option<PathBuf>> {
    match fs::metadata(path) {
        Ok(about) if about.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(about) if !about.is_file() => return Ok(None),
        Ok(_) if !force => return Err(io::ErrorKind::AlreadyExists.into()),
        _ => {}
    }
    Ok(Some(through_link(path)))
}

/// The path, or its target if it is a link, so that the link is kept and its target replaced.
pub fn through_link(path: &Path) -> PathBuf {
    let target = path.is_symlink().then(|| fs::canonicalize(path).ok()).flatten();
    target.unwrap_or_else(|| path.to_path_buf())
}

/// Renames a file, and ensures that this is on disk.
///
/// # Errors
/// If this fails, or if there is a file with that name and `force` is not set.
pub fn rename_durably(file: TempPath, target: &Path, force: bool) -> io::Result<()> {
    let placed = if force { file.persist(target) } else { file.persist_noclobber(target) };
    placed.map_err(|e| e.error)?;
    sync_folder(parent(target));
    Ok(())
}

/// Bytes per write. For larger writes Linux uses larger pages, which are seldom available: copying then takes
/// it ten times as long.
const WRITE_BYTES: usize = 64 << 10;

/// A folder to write scans into. All of them are renamed at the end, or none, unless the system refuses to
/// rename one after others.
pub struct FolderOutput {
    folder: PathBuf,
    /// Ends before the folder is removed.
    syncer: Syncer,
    /// Inside `folder`, so that renaming stays within one file system.
    temporary: TempDir,
    _lock: Option<File>,
    /// The scans' names.
    names: Mutex<Vec<String>>,
    force: bool,
    /// Files that must not be overwritten.
    inputs: Vec<PathBuf>,
    _remove: RemoveOnSignal,
    /// Folders created for this, which are removed again unless it is finished. The last field, so as to be
    /// dropped last.
    made: MadeFolders,
}

impl FolderOutput {
    /// Creates the folder if it is missing.
    ///
    /// # Errors
    /// If it cannot be created, or nothing can be written there.
    pub fn create(folder: &Path, force: bool) -> anyhow::Result<Self> {
        Self::try_create(folder, force).map_err(|error| about(error, &folder.display().to_string()))
    }

    fn try_create(folder: &Path, force: bool) -> Result<Self> {
        let made = MadeFolders::make(folder)?;
        let (temporary, _lock) = temporary::folder(folder)?;
        let _remove = RemoveOnSignal::new(temporary.path());
        Ok(FolderOutput {
            folder: folder.to_path_buf(),
            syncer: Syncer::start()?,
            temporary,
            _lock,
            names: Mutex::default(),
            force,
            inputs: Vec::new(),
            _remove,
            made,
        })
    }

    /// The same output, in which no scan may overwrite one of these files.
    pub fn keeping(mut self, inputs: &[PathBuf]) -> Self {
        self.inputs = inputs.to_vec();
        self
    }

    /// Writes one scan, whose bytes `write` passes on piece by piece, under a temporary name; from any
    /// thread. Returns the number of bytes.
    ///
    /// # Errors
    /// If the name is not a [safe path](is_safe_path), occurs twice, or is that of an existing file and
    /// `force` is not set; if writing fails; and the errors of `write`.
    pub fn write(&self, name: &str, write: impl FnOnce(&mut Give<'_>) -> Result<()>) -> Result<u64> {
        let refuse = |what: String| Err(Error::Input { path: self.folder.clone(), what });
        // The name of an empty folder ends in a slash.
        let folder = name.strip_suffix('/');
        if !is_safe_path(folder.unwrap_or(name)) {
            return refuse(format!("cannot safely take a file named {name:?}, as the stream asks"));
        }
        let (temporary, target) = (self.temporary.path().join(name), self.folder.join(name));
        if folder.is_some() {
            fs::create_dir_all(&temporary).map_err(|e| Error::from(e).at(&target))?;
            locked(&self.names).push(name.to_owned());
            return write(&mut |piece| match piece {
                [] => Ok(()),
                _ => {
                    refuse(format!("cannot safely take a folder of bytes named {name:?}, as the stream asks"))
                        .map(drop)
                }
            })
            .map(|()| 0);
        }
        may_write(&target, self.force)?;
        keep_inputs(&target, &self.inputs)?;
        if name.contains('/') {
            fs::create_dir_all(parent(&temporary)).map_err(|e| Error::from(e).at(&target))?;
        }
        let mut file = match File::create_new(&temporary) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {
                return refuse(format!("cannot take two files named {name:?}, as the stream asks"));
            }
            file => file.map_err(|e| Error::from(e).at(&target))?,
        };
        let mut size = 0;
        write(&mut |piece| {
            let written = piece.chunks(WRITE_BYTES).try_for_each(|chunk| file.write_all(chunk));
            written.map_err(|e| Error::from(e).at(&target))?;
            size += piece.len() as u64;
            Ok(())
        })?;
        drop(file);
        self.syncer.add(Written { temporary, target });
        locked(&self.names).push(name.to_owned());
        Ok(size)
    }

    /// Ensures that all scans are on disk, and renames them.
    ///
    /// # Errors
    /// If this fails, or if there is now a file with a scan's name and `force` is not set.
    pub fn finish(mut self) -> Result<()> {
        let names = std::mem::take(self.names.get_mut().unwrap_or_else(PoisonError::into_inner));
        self.syncer.finish()?;
        let mut folders = BTreeSet::from([self.folder.clone()]);
        for name in &names {
            let target = self.folder.join(name);
            let is_folder = name.ends_with('/');
            let above = if is_folder { target.as_path() } else { parent(&target) };
            if !folders.contains(above) {
                self.made.add(above)?;
                folders.insert(above.to_path_buf());
            }
            if !is_folder {
                may_write(&target, self.force)?;
            }
        }
        // From here on only the system can refuse.
        for name in names.iter().filter(|name| !name.ends_with('/')) {
            let target = self.folder.join(name);
            let temporary = TempPath::try_from_path(self.temporary.path().join(name))?;
            let placed = match self.force {
                true => temporary.persist(&target),
                false => temporary.persist_noclobber(&target),
            };
            placed.map_err(|e| Error::from(e.error).at(&target))?;
        }
        folders.iter().for_each(|folder| sync_folder(folder));
        self.made.keep();
        Ok(())
    }
}

/// A scan that is written under a temporary name.
struct Written {
    temporary: PathBuf,
    target: PathBuf,
}

impl Written {
    /// Ensures that it is on disk.
    fn sync(&self) -> Result<()> {
        // On Windows, flushing a file needs write access.
        let file = File::options().read(true).write(cfg!(windows)).open(&self.temporary);
        file.and_then(|file| file.sync_all()).map_err(|e| Error::from(e).at(&self.target))
    }
}

/// A thread that ensures that scans are on disk while others are still being decoded.
struct Syncer {
    /// None once no more scans are added.
    queue: Option<Sender<Written>>,
    /// Set when scans that wait are to be returned.
    stop: Arc<AtomicBool>,
    /// Returns the scans that it has left. None once it has ended.
    thread: Option<thread::JoinHandle<Result<Vec<Written>>>>,
}

impl Syncer {
    fn start() -> io::Result<Self> {
        let (queue, waiting) = mpsc::channel::<Written>();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let sync = move || {
            let mut left = Vec::new();
            for scan in waiting {
                match stopped.load(Ordering::Relaxed) {
                    true => left.push(scan),
                    false => scan.sync()?,
                }
            }
            Ok(left)
        };
        let thread = thread::Builder::new().spawn(sync)?;
        Ok(Syncer { queue: Some(queue), stop, thread: Some(thread) })
    }

    /// Adds a scan, from any thread.
    fn add(&self, scan: Written) {
        // If the thread is gone, it has had an error, which is returned at the end.
        let _ = self.queue.as_ref().map(|queue| queue.send(scan));
    }

    /// Ensures that all scans are on disk. Those that wait are synced in parallel, as file systems then write
    /// their journals once for all: 5,000 small files take half a second, instead of seven one after the
    /// other.
    fn finish(&mut self) -> Result<()> {
        const AT_A_TIME: usize = 16;
        let left = self.end()?;
        let sync = |scans: &[Written]| scans.iter().try_for_each(Written::sync);
        thread::scope(|scope| {
            let chunks = left.chunks(left.len().div_ceil(AT_A_TIME).max(1));
            let threads: Vec<_> = chunks.map(|scans| scope.spawn(move || sync(scans))).collect();
            threads.into_iter().try_for_each(|thread| thread.join().unwrap_or_else(|_| Err(died())))
        })
    }

    /// Waits until the thread has ended, and returns the scans that it has left.
    fn end(&mut self) -> Result<Vec<Written>> {
        self.stop.store(true, Ordering::Relaxed);
        self.queue = None;
        match self.thread.take() {
            Some(thread) => thread.join().unwrap_or_else(|_| Err(died())),
            None => Ok(Vec::new()),
        }
    }
}

fn died() -> Error {
    Error::Internal("a thread that syncs files died".to_owned())
}

impl Drop for Syncer {
    fn drop(&mut self) {
        // After an error elsewhere, nothing need be on disk.
        let _ = self.end();
    }
}

/// Created folders, which are removed again if they are empty, unless kept.
struct MadeFolders(Vec<PathBuf>);

impl MadeFolders {
    /// Creates `folder` and missing parent folders.
    fn make(folder: &Path) -> Result<Self> {
        let mut made = MadeFolders(Vec::new());
        made.add(folder)?;
        Ok(made)
    }

    /// Creates `folder` and missing parent folders.
    fn add(&mut self, folder: &Path) -> Result<()> {
        let missing = folder.ancestors().take_while(|folder| !folder.as_os_str().is_empty());
        let missing = missing.take_while(|folder| fs::symlink_metadata(folder).is_err());
        // The deepest first, which is the order in which they can be removed.
        self.0.splice(..0, missing.map(Path::to_path_buf));
        must_be_folders(folder)?;
        create_folders(folder)
    }

    fn keep(&mut self) {
        self.0.clear();
    }
}

impl Drop for MadeFolders {
    fn drop(&mut self) {
        for folder in &self.0 {
            // If it is no longer empty, it stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// Creates a folder and missing parent folders.
///
/// # Errors
/// Naming the folder, or the one that does not take it.
pub fn create_folders(folder: &Path) -> Result<()> {
    let within = folder.ancestors().find(|above| above.is_dir()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(|error| not_created(folder, within, error))
}

/// The error that `path` cannot be created. A folder in which nothing can be created, as /proc, may say that
/// it does not exist; the error is then about that folder.
pub fn not_created(path: &Path, within: &Path, error: io::Error) -> Error {
    if error.kind() == io::ErrorKind::NotFound && within.is_dir() {
        let what = format!("takes no new files or folders ({error}); choose another folder");
        return Error::Input { path: within.to_path_buf(), what };
    }
    Error::from(error).at(path)
}

/// The name of an output in messages.
pub fn name_of_output(path: &Path) -> String {
    if is_dash(path) { "stdout".to_owned() } else { path.display().to_string() }
}

/// An error while an output is written: about that output, unless the error itself names a file.
pub fn about_output(error: anyhow::Error, path: &Path) -> anyhow::Error {
    if error.is::<io::Error>() { error.context(name_of_output(path)) } else { error }
}

/// An error if a scan must not be written here: over a folder, over an existing path without `force`, or
/// below a file.
fn may_write(target: &Path, force: bool) -> Result<()> {
    let refused = |kind: io::ErrorKind| Err(Error::from(io::Error::from(kind)).at(target));
    if target.is_dir() {
        return refused(io::ErrorKind::IsADirectory);
    }
    // A dangling link exists as well.
    match fs::symlink_metadata(target) {
        Ok(_) if !force => refused(io::ErrorKind::AlreadyExists),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => must_be_folders(parent(target)),
        _ => Ok(()),
    }
}

/// An error if this path, or one above it, is something else than a folder.
fn must_be_folders(folder: &Path) -> Result<()> {
    let is_other = |path: &&Path| fs::metadata(path).is_ok_and(|about| !about.is_dir());
    folder.ancestors().find(is_other).map_or(Ok(()), |path| {
        let what = "is no folder, but one is needed there; move it away, or choose another output".to_owned();
        Err(Error::Input { path: path.to_path_buf(), what })
    })
}

/// The folder that contains a file.
pub fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Ensures that renames in the folder are on disk. Not every file system supports this; the data itself is
/// safe by then.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}
