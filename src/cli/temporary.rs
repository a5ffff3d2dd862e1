//! Temporary files and folders, in the folder of their target, locked while their program runs. The lock
//! distinguishes leftovers of a killed program from files in use; leftovers are removed by the next run that
//! writes into the same folder.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use tempfile::{Builder, NamedTempFile, TempDir};

/// The beginning and the end of their names; the part in between is random.
const PREFIX: &str = ".lidarpc-";
const SUFFIX: &str = ".tmp";

/// A temporary file with the usual permissions of a new file.
pub fn file(folder: &Path) -> io::Result<NamedTempFile> {
    remove_leftovers(folder);
    loop {
        let mut builder = builder();
        as_new_files(&mut builder);
        let file = builder.tempfile_in(folder)?;
        lock(file.as_file());
        // Another run may have removed it as a leftover before it was locked.
        if file.path().exists() {
            return Ok(file);
        }
    }
}

/// A temporary folder, and the file that keeps it locked.
pub fn folder(folder: &Path) -> io::Result<(TempDir, Option<File>)> {
    remove_leftovers(folder);
    loop {
        let made = builder().tempdir_in(folder)?;
        let handle = File::open(made.path()).ok().inspect(lock);
        if made.path().exists() {
            return Ok((made, handle));
        }
    }
}

fn builder() -> Builder<'static, 'static> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    builder
}

/// Sets the usual permissions of a new file, where temporary ones get fewer.
#[cfg(unix)]
fn as_new_files(builder: &mut Builder) {
    use std::os::unix::fs::PermissionsExt;
    builder.permissions(fs::Permissions::from_mode(0o666));
}

#[cfg(not(unix))]
fn as_new_files(_: &mut Builder) {}

/// On systems without locks, nothing is ever treated as a leftover.
#[cfg(unix)]
fn lock(file: &File) {
    let _ = file.lock();
}

/// On other systems a lock would keep the program itself from reading the file again.
#[cfg(not(unix))]
fn lock(_: &File) {}

/// Removes leftovers of killed programs. A failure to do so is ignored.
pub fn remove_leftovers(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let is_ours = name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX));
        if is_ours {
            remove_if_left(&entry.path());
        }
    }
}

#[cfg(unix)]
fn remove_if_left(path: &Path) {
    let is_folder = match fs::symlink_metadata(path) {
        Ok(about) if about.is_dir() => true,
        Ok(about) if about.is_file() => false,
        _ => return,
    };
    // The lock is kept until the path is removed.
    let Ok(handle) = File::open(path) else { return };
    if handle.try_lock().is_ok() {
        let _ = if is_folder { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    }
}

#[cfg(not(unix))]
fn remove_if_left(_: &Path) {}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_use_stays_and_what_was_left_goes() {
        let place = tempfile::tempdir().unwrap();
        let used = (file(place.path()).unwrap(), folder(place.path()).unwrap());
        fs::write(place.path().join(".lidarpc-abc.tmp"), b"left").unwrap();
        fs::create_dir(place.path().join(".lidarpc-def.tmp")).unwrap();
        fs::write(place.path().join(".lidarpc-def.tmp/1.bin"), b"left").unwrap();
        fs::write(place.path().join(".lidarpc.toml"), b"somebody's").unwrap();
        let new = file(place.path()).unwrap();
        let mut left: Vec<_> =
            fs::read_dir(place.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        let mut expected = vec![
            used.0.path().to_path_buf(),
            used.1.0.path().to_path_buf(),
            new.path().to_path_buf(),
            place.path().join(".lidarpc.toml"),
        ];
        left.sort();
        expected.sort();
        assert_eq!(left, expected);
    }
}
