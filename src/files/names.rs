//! Names of files: their order, and which names can be restored on every system.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::path::Path;

use crate::ground::error::{Error, Result};

/// The longest file name, in bytes, that common file systems allow.
const MAX_NAME: usize = 255;
/// The longest path of a file in a stream, in bytes: the usual limit of systems.
const MAX_PATH: usize = 4095;

/// Compares names as people sort them: runs of digits by their value, everything else by its bytes (`2.bin`
/// before `10.bin`). Names that differ are never equal: `1.bin` comes before `01.bin`.
pub fn natural_cmp(a: &str, b: &str) -> Ordering {
    natural_key(a).cmp(natural_key(b)).then_with(|| a.len().cmp(&b.len())).then_with(|| a.cmp(b))
}

/// A name as comparable pieces: a byte, or a number as its rank among the bytes, its number of digits, and
/// its digits without leading zeros.
fn natural_key(name: &str) -> impl Iterator<Item = (u8, usize, &[u8])> {
    let mut rest = name.as_bytes();
    std::iter::from_fn(move || {
        let (&first, after) = rest.split_first()?;
        if !first.is_ascii_digit() {
            rest = after;
            return Some((first, 0, &[][..]));
        }
        let end = rest.iter().position(|b| !b.is_ascii_digit()).unwrap_or(rest.len());
        let (number, after) = rest.split_at(end);
        rest = after;
        let zeros = number.iter().take_while(|&&b| b == b'0').count();
        Some((b'0', end - zeros, &number[zeros..]))
    })
}

/// True if a path from a stream can be created below any folder without leaving it, and means no device or
/// drive on any system. (Windows cannot have some other names, such as `13:02.bin`.) It is one or several
/// names with `/` between them, of 4,095 bytes at most together. Each name has 1 to 255 bytes; it is not `.`
/// or `..`, nor one of Windows' device names (`NUL`, `COM1.bin`) or drives (`C:x`); and it has no backslash,
/// no control characters, and no dot or space at its end.
pub fn is_safe_path(path: &str) -> bool {
    fault_of_path(path).is_none()
}

/// The reason why a path is not [safe](is_safe_path).
fn fault_of_path(path: &str) -> Option<&'static str> {
    match path.len() <= MAX_PATH {
        true => path.split('/').find_map(fault_of_name),
        false => Some("is longer than 4,095 bytes with its folders"),
    }
}

/// The reason why a name must not be part of a [safe path](is_safe_path).
fn fault_of_name(name: &str) -> Option<&'static str> {
    let has_drive = matches!(name.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    let faults = [
        (name.is_empty(), "is empty"),
        (matches!(name, "." | ".."), "has `.` or `..` in place of a folder"),
        (name.len() > MAX_NAME, "is longer than 255 bytes"),
        (name.contains(['/', '\\']), "holds a slash or backslash"),
        (name.contains(char::is_control), "holds a control character"),
        (name.ends_with('.'), "ends in a dot"),
        (name.ends_with(' '), "ends in a space"),
        (has_drive, "begins as a drive of Windows does"),
        (is_windows_device(name), "is that of a device on Windows"),
    ];
    faults.into_iter().find_map(|(is_so, fault)| is_so.then_some(fault))
}

/// Checks that every system can restore a file with this name or path in a stream.
///
/// # Errors
/// [`Error::Input`], about the file at `path`, if not.
pub(crate) fn check_name(path: &Path, name: &str) -> Result<()> {
    match fault_of_path(name) {
        None => Ok(()),
        Some(fault) => {
            let what = format!("has a name that not every system can restore: it {fault}; rename the file");
            Err(Error::Input { path: path.to_owned(), what })
        }
    }
}

/// The names of files that are to be written below one folder, each with something to know it by.
#[derive(Debug)]
pub struct FileNames<T> {
    files: HashMap<String, T>,
    /// The folders that contain them.
    folders: HashSet<String>,
}

/// Why a file cannot lie beside the others.
#[derive(Debug, PartialEq, Eq)]
pub enum NameConflict<T> {
    /// This one has its name.
    SameName(T),
    /// Its name is that of the folder of another file, or the other way round.
    FileAndFolder,
}

impl<T> Default for FileNames<T> {
    fn default() -> Self {
        FileNames { files: HashMap::new(), folders: HashSet::new() }
    }
}

impl<T: Copy> FileNames<T> {
    /// Adds a name.
    ///
    /// # Errors
    /// If the file cannot be written beside those before.
    pub fn add(&mut self, name: &str, file: T) -> Result<(), NameConflict<T>> {
        if let Some(other) = self.files.get(name) {
            return Err(NameConflict::SameName(*other));
        }
        let folders = name.match_indices('/').map(|(end, _)| &name[..end]);
        if self.folders.contains(name) || folders.clone().any(|folder| self.files.contains_key(folder)) {
            return Err(NameConflict::FileAndFolder);
        }
        for folder in folders {
            if !self.folders.contains(folder) {
                self.folders.insert(folder.to_owned());
            }
        }
        self.files.insert(name.to_owned(), file);
        Ok(())
    }
}

/// Windows considers the part before the first dot, ignoring case and trailing spaces.
fn is_windows_device(name: &str) -> bool {
    let stem = name.split(['.', ':']).next().unwrap_or(name).trim_end_matches(' ').to_ascii_uppercase();
    let is_port = |port: &str| {
        let number = stem.strip_prefix(port).map(|n| n.chars().collect::<Vec<_>>());
        // Windows accepts the superscript digits too.
        matches!(number.as_deref(), Some(['0'..='9' | '\u{b9}' | '\u{b2}' | '\u{b3}']))
    };
    matches!(&stem[..], "CON" | "PRN" | "AUX" | "NUL" | "CONIN$" | "CONOUT$")
        || is_port("COM")
        || is_port("LPT")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn natural_order_of_examples() {
        let sorted = [
            "",
            "-1",
            "0.bin",
            "1.bin",
            "01.bin",
            "001.bin",
            "1a.bin",
            "2.bin",
            "10.bin",
            "A.bin",
            "a.bin",
            "a1.bin",
            "a1b1",
            "a1b02",
            "a1b2c",
            "a1b10",
            "a99999999999999999999999",
            "b",
            "\u{e9}",
        ];
        for pair in sorted.windows(2) {
            assert_eq!(natural_cmp(pair[0], pair[1]), Ordering::Less, "{pair:?}");
            assert_eq!(natural_cmp(pair[1], pair[0]), Ordering::Greater, "{pair:?}");
        }
    }

    #[test]
    fn unsafe_names_are_refused() {
        let long = "x".repeat(256);
        for name in [
            "",
            ".",
            "..",
            "/",
            "a/b",
            "a\\b",
            "../a",
            "C:",
            "c:a.bin",
            "a.bin.",
            "a.bin ",
            "a\0",
            "a\nb",
            "a\u{7f}",
            "a\u{85}",
            "NUL",
            "nul.bin",
            "Con.tar.gz",
            "com1",
            "LPT9.bin",
            "COM\u{b9}.bin",
            "aux .bin",
            "CONIN$",
            &long,
        ] {
            assert!(fault_of_name(name).is_some(), "{name:?}");
        }
        for name in [
            "0000000000.bin",
            "a b.pcd",
            ".hidden",
            "..a",
            "a..b",
            "nully.bin",
            "COM10.bin",
            "n015__LIDAR_TOP__1.pcd.bin",
            "2011-09-26 13:02:25.bin",
            "caf\u{e9}.bin",
            &long[1..],
        ] {
            assert!(fault_of_name(name).is_none(), "{name:?}");
        }
    }

    #[test]
    fn unsafe_paths_are_refused() {
        let (deep, too_deep) = ("x/".repeat(2047) + "x", "x/".repeat(2047) + "xx");
        for path in [
            "",
            "/",
            "/etc/passwd",
            "a/",
            "a//b",
            "../a",
            "a/../b",
            "a/./b",
            "c:/a",
            "a/nul/b",
            "a\\b/c",
            &too_deep,
        ] {
            assert!(!is_safe_path(path), "{path:?}");
        }
        for path in ["a.bin", "2011_09_26/drive_1/velodyne_points/data/0.bin", "a/.hidden/b", &deep] {
            assert!(is_safe_path(path), "{path:?}");
        }
    }

    #[test]
    fn names_that_exclude_each_other_are_found() {
        let mut names = FileNames::default();
        for (number, name) in ["a/1.bin", "a/2.bin", "b/c/1.bin", "b/1.bin", "1.bin"].into_iter().enumerate()
        {
            assert_eq!(names.add(name, number), Ok(()), "{name}");
        }
        assert_eq!(names.add("a/2.bin", 9), Err(NameConflict::SameName(1)));
        for name in ["a", "b/c", "1.bin/x", "b/c/1.bin/x/y"] {
            assert_eq!(names.add(name, 9), Err(NameConflict::FileAndFolder), "{name}");
        }
        assert_eq!(names.add("c", 9), Ok(()));
    }

    proptest! {
        #[test]
        fn natural_order_is_total(names in prop::collection::vec("[0-2a./é-]{0,6}", 3)) {
            let [a, b, c] = [&names[0], &names[1], &names[2]];
            prop_assert_eq!(natural_cmp(a, b), natural_cmp(b, a).reverse());
            prop_assert_eq!(natural_cmp(a, b) == Ordering::Equal, a == b);
            if natural_cmp(a, b).is_le() && natural_cmp(b, c).is_le() {
                prop_assert!(natural_cmp(a, c).is_le());
            }
        }
    }
}
