//! Output that outlives an interruption: under a name of its own beside its target, with a journal, until it
//! is whole.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::edit::PartialFiles;
use crate::ground::error::{Error, Result};
use tempfile::TempPath;

use super::errors::about;
use super::output::{parent, place, replaceable, through_link};
use super::temporary;

/// What the name of the partial stream ends in, after that of the output.
const PARTIAL: &str = ".partial";

/// What the name of its journal ends in, after that of the stream.
const JOURNAL: &str = ".journal";

/// A stream that is written in as many runs as it takes.
pub struct PartialOutput {
    target: PathBuf,
    force: bool,
    /// Open, and locked against other runs, as long as this lives.
    stream: LockedFile,
    journal: PathBuf,
}

impl PartialOutput {
    /// Opens what an interrupted run has left, or makes it.
    ///
    /// # Errors
    /// If the output exists and `force` is not set, is no file, or cannot be written; if another run is
    /// writing it.
    pub fn open(path: &Path, force: bool) -> anyhow::Result<Self> {
        let target = match replaceable(path, force) {
            Ok(Some(target)) => target,
            Ok(None) => {
                let what = "is no regular file; choose another output, or encode without --resume".to_owned();
                return Err(Error::Input { path: path.to_path_buf(), what }.into());
            }
            Err(error) => {
                remove_stray_journal(path);
                return Err(about(error.into(), &path.display().to_string()));
            }
        };
        temporary::remove_leftovers(parent(&target));
        let (stream, journal) = names(&target);
        let stream = LockedFile::open(stream)?;
        Ok(PartialOutput { target, force, stream, journal })
    }

    /// The files to encode into.
    ///
    /// # Errors
    /// If they cannot be opened.
    pub fn files(&self) -> Result<PartialFiles> {
        let stream = self.stream.file.try_clone()?;
        Ok(PartialFiles { path: self.stream.path.clone(), stream, journal: self.journal.clone() })
    }

    /// The stream, to be read again.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn reopen(&self) -> Result<File> {
        Ok(File::open(&self.stream.path)?)
    }

    /// Makes sure that everything is on the disk, gives the stream its name, and removes the journal.
    ///
    /// # Errors
    /// If that fails, or if meanwhile there is a file of that name and `force` is not set. Then all stays as
    /// it is, for another try.
    pub fn finish(self) -> Result<()> {
        self.stream.file.sync_all()?;
        let mut stream = TempPath::try_from_path(&self.stream.path)?;
        stream.disable_cleanup(true);
        place(stream, &self.target, self.force)?;
        // The stream is complete. A journal without a partial stream means nothing to the next run.
        let _ = fs::remove_file(&self.journal);
        Ok(())
    }
}

/// What an interrupted run has left for this output, if there is anything.
pub fn left_for(output: &Path) -> Option<PathBuf> {
    Some(names(&through_link(output)).0).filter(|stream| stream.exists())
}

/// The output, and what an interrupted run leaves for it.
pub fn outputs(output: &Path) -> [PathBuf; 3] {
    let target = through_link(output);
    let (stream, journal) = names(&target);
    [target, stream, journal]
}

/// Removes the journal of an output that is complete: its run was ended when all else was done.
fn remove_stray_journal(output: &Path) {
    let (stream, journal) = names(&through_link(output));
    if output.is_file() && !stream.exists() {
        let _ = fs::remove_file(journal);
    }
}

/// The partial stream and the journal of this output.
fn names(target: &Path) -> (PathBuf, PathBuf) {
    let with_ending = |path: &Path, ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    let stream = with_ending(target, PARTIAL);
    let journal = with_ending(&stream, JOURNAL);
    (stream, journal)
}

/// An open file that no other run writes.
struct LockedFile {
    path: PathBuf,
    file: File,
}

impl LockedFile {
    fn open(mut path: PathBuf) -> anyhow::Result<Self> {
        loop {
            let file = File::options().read(true).write(true).create(true).truncate(false).open(&path);
            let file = file.map_err(|e| Error::from(e).at(&path))?;
            if !lock(&file) {
                let what =
                    "is being written by another run; wait for that, or choose another output".to_owned();
                return Err(Error::Input { path, what }.into());
            }
            let locked = LockedFile { path, file };
            if locked.has_its_name() {
                return Ok(locked);
            }
            // Another run has finished it before it was locked.
            path = locked.path;
        }
    }

    /// Whether the file of this name is still the one that is open.
    #[cfg(unix)]
    fn has_its_name(&self) -> bool {
        use std::os::unix::fs::MetadataExt;

        let [named, open] = [fs::metadata(&self.path), self.file.metadata()];
        named.is_ok_and(|named| open.is_ok_and(|open| (named.dev(), named.ino()) == (open.dev(), open.ino())))
    }

    #[cfg(not(unix))]
    fn has_its_name(&self) -> bool {
        self.path.exists()
    }
}

/// Locks a file; false if another run has. Where there are no locks, nobody has.
#[cfg(unix)]
fn lock(file: &File) -> bool {
    !matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock))
}

/// Elsewhere a lock would keep the program itself from reading the file again.
#[cfg(not(unix))]
fn lock(_: &File) -> bool {
    true
}
