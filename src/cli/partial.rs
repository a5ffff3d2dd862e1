//! Output that survives an interruption: it is written beside its target under another name, with a journal,
//! until it is complete.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::edit::PartialFiles;
use crate::ground::error::{Error, Result};
use tempfile::TempPath;

use super::errors::about;
use super::output::{not_created, parent, rename_durably, replaceable, through_link};
use super::temporary;

/// The suffix that is added to the output's name for the partial stream.
const PARTIAL: &str = ".partial";

/// The suffix that is added to the partial stream's name for its journal.
const JOURNAL: &str = ".journal";

/// A stream that is written in one or more runs.
pub struct PartialOutput {
    target: PathBuf,
    force: bool,
    /// Open, and locked against other runs, while this exists.
    stream: LockedFile,
    journal: PathBuf,
}

impl PartialOutput {
    /// Opens the files that an interrupted run left, or creates them.
    ///
    /// # Errors
    /// If the output exists and `force` is not set, is not a file, or cannot be written; if another run is
    /// writing it.
    pub fn open(path: &Path, force: bool) -> anyhow::Result<Self> {
        let target = match replaceable(path, force) {
            Ok(Some(target)) => target,
            Ok(None) => {
                let what = "is no regular file; choose another output, or encode without --resume".to_owned();
                return Err(Error::Input { path: path.to_path_buf(), what }.into());
            }
            Err(error) => return Err(about(error.into(), &path.display().to_string())),
        };
        temporary::remove_leftovers(parent(&target));
        let (stream, journal) = names(&target);
        let stream = LockedFile::open(stream)?;
        Ok(PartialOutput { target, force, stream, journal })
    }

    /// The files for the encoder.
    ///
    /// # Errors
    /// If they cannot be opened.
    pub fn files(&self) -> Result<PartialFiles> {
        let stream = self.stream.file.try_clone()?;
        Ok(PartialFiles { path: self.stream.path.clone(), stream, journal: self.journal.clone() })
    }

    /// The stream, to be read back.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn reopen(&self) -> Result<File> {
        Ok(File::open(&self.stream.path)?)
    }

    /// Flushes everything to disk, renames the stream, and removes the journal.
    ///
    /// # Errors
    /// If this fails, or if there is now a file with that name and `force` is not set. All files are then
    /// kept for another attempt.
    pub fn finish(self) -> Result<()> {
        self.stream.file.sync_all()?;
        let mut stream = TempPath::try_from_path(&self.stream.path)?;
        stream.disable_cleanup(true);
        rename_durably(stream, &self.target, self.force)?;
        // The stream is complete. A journal without a partial stream is ignored by the next run.
        let _ = fs::remove_file(&self.journal);
        Ok(())
    }
}

/// The partial stream that an interrupted run left for this output, if there is one.
pub fn left_for(output: &Path) -> Option<PathBuf> {
    Some(names(&through_link(output)).0).filter(|stream| stream.exists())
}

/// The output, and the files that an interrupted run leaves for it.
pub fn outputs(output: &Path) -> [PathBuf; 3] {
    let target = through_link(output);
    let (stream, journal) = names(&target);
    [target, stream, journal]
}

/// The complete output, if an earlier run left it. Its journal is removed, in case that run ended just before
/// removing it.
///
/// # Errors
/// If it cannot be opened.
pub fn complete(output: &Path) -> Result<Option<File>> {
    if !output.is_file() {
        return Ok(None);
    }
    let (stream, journal) = names(&through_link(output));
    if !stream.exists() {
        let _ = fs::remove_file(journal);
    }
    Ok(Some(File::open(output)?))
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
            let file = file.map_err(|error| not_created(&path, parent(&path), error))?;
            if !lock(&file) {
                let what =
                    "is being written by another run; wait for that, or choose another output".to_owned();
                return Err(Error::Input { path, what }.into());
            }
            let locked = LockedFile { path, file };
            if locked.has_its_name() {
                return Ok(locked);
            }
            // Another run finished it before it was locked.
            path = locked.path;
        }
    }

    /// Whether the file with this name is still the one that is open.
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

/// Locks a file; false if another run has locked it. True on systems without locks.
#[cfg(unix)]
fn lock(file: &File) -> bool {
    !matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock))
}

/// On other systems a lock would keep the program itself from reading the file again.
#[cfg(not(unix))]
fn lock(_: &File) -> bool {
    true
}
