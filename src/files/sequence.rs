//! The frames of an input: which files, and in which order.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::Kind;
use crate::ground::error::{Error, Result};

/// Where KITTI and KITTI-360 drives keep their scans, relative to the folders above.
const DRIVE_FOLDERS: [&str; 3] = ["velodyne_points/data", "velodyne", "data"];
/// The longest file name, in bytes, that common file systems allow.
const MAX_NAME: usize = 255;

/// The frames of an input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sequence {
    /// The scans, in the natural order of their names. No two have the same name.
    pub frames: Vec<PathBuf>,
    /// Files of the given folders that are not scans. Hidden files and folders are not listed.
    pub left_out: Vec<PathBuf>,
}

/// Finds the frames of `inputs`: files, folders of scans (`.bin`, `.pcd`, `.ply`; neither subfolders nor
/// hidden files), or KITTI drives (folders above `velodyne_points/data` or `velodyne`). A file that is named
/// explicitly is taken whatever its extension. Frames are sorted in the natural order of their names,
/// wherever they come from.
///
/// # Errors
/// [`Error::Input`], with the path and what to do: nothing there, no scan in a folder, unreadable, two frames
/// with the same name, or a name that could not be restored (see [`is_safe_name`]).
pub fn find_frames(inputs: &[PathBuf]) -> Result<Sequence> {
    let mut found = Sequence::default();
    for input in inputs {
        let kind = fs::metadata(input).map_err(|error| unreadable(input, &error))?;
        if kind.is_dir() {
            let folder = scan_folder(input)?;
            found.frames.extend(folder.frames);
            found.left_out.extend(folder.left_out);
        } else if kind.is_file() {
            found.frames.push(input.clone());
        } else {
            return Err(input_error(
                input,
                "is neither a file nor a folder; give files or a folder of scans",
            ));
        }
    }
    found.frames = in_natural_order(found.frames)?;
    found.left_out.sort();
    Ok(found)
}

/// Lists `folder`, or, if it is a drive, the folder inside that holds the scans.
fn scan_folder(folder: &Path) -> Result<Sequence> {
    let direct = list(folder)?;
    if !direct.frames.is_empty() {
        return Ok(direct);
    }
    let mut drives = Vec::new();
    for below in DRIVE_FOLDERS.map(|name| folder.join(name)) {
        if below.is_dir() {
            let listed = list(&below)?;
            if !listed.frames.is_empty() {
                drives.push((below, listed));
            }
        }
    }
    match &drives[..] {
        [] => Err(input_error(folder, "holds no scans; give a folder of .bin, .pcd or .ply files")),
        [_] => Ok(drives.swap_remove(0).1),
        [(one, _), (other, _), ..] => {
            let what = format!("has scans in {} and in {}; give one of them", one.display(), other.display());
            Err(input_error(folder, what))
        }
    }
}

/// The files of a folder, without hidden ones.
fn list(folder: &Path) -> Result<Sequence> {
    let mut found = Sequence::default();
    for entry in fs::read_dir(folder).map_err(|error| unreadable(folder, &error))? {
        let entry = entry.map_err(|error| unreadable(folder, &error))?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with('.') {
            continue;
        }
        let path = entry.path();
        let is_scan = Kind::of(&name).is_some();
        // Follows links. A file without a scan's extension need not be readable.
        match fs::metadata(&path) {
            Ok(kind) if kind.is_dir() => {}
            Ok(kind) if is_scan && kind.is_file() => found.frames.push(path),
            Err(error) if is_scan => return Err(unreadable(&path, &error)),
            _ => found.left_out.push(path),
        }
    }
    Ok(found)
}

/// Sorts frames by name, and checks that the names can be restored.
fn in_natural_order(frames: Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    let mut named = Vec::with_capacity(frames.len());
    let mut seen: HashMap<String, PathBuf> = HashMap::with_capacity(frames.len());
    for path in frames {
        let name = frame_name(&path)?.to_owned();
        if let Some(first) = seen.insert(name.clone(), path.clone()) {
            let what = format!("has the same name as {}; encode them apart", first.display());
            return Err(input_error(&path, what));
        }
        named.push((name, path));
    }
    named.sort_by(|(a, _), (b, _)| natural_cmp(a, b));
    Ok(named.into_iter().map(|(_, path)| path).collect())
}

/// The name under which a frame is stored and restored.
///
/// # Errors
/// [`Error::Input`] if it is not UTF-8 or not [safe](is_safe_name).
pub fn frame_name(path: &Path) -> Result<&str> {
    let name = path.file_name().ok_or_else(|| input_error(path, "has no file name; give a file"))?;
    let name = name
        .to_str()
        .ok_or_else(|| input_error(path, "has a name that is not UTF-8 text; rename the file"))?;
    match is_safe_name(name) {
        true => Ok(name),
        false => Err(input_error(path, "has a name that not every system can restore; rename the file")),
    }
}

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

/// True if a name from a stream can be created as a file in any folder, without leaving the folder and
/// without having a special meaning there: no separators, no control characters, not `.` or `..`, none of
/// Windows' device names (`NUL`, `COM1.bin`) or drives (`C:x`), no dot or space at its end, and 1 to 255
/// bytes.
pub fn is_safe_name(name: &str) -> bool {
    let has_drive = matches!(name.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    (1..=MAX_NAME).contains(&name.len())
        && !name.contains(|c: char| c == '/' || c == '\\' || c.is_control())
        && !name.ends_with(['.', ' '])
        && !has_drive
        && !is_windows_device(name)
}

/// Windows looks at what is before the first dot, ignoring case and trailing spaces.
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

fn input_error(path: &Path, what: impl Into<String>) -> Error {
    Error::Input { path: path.to_owned(), what: what.into() }
}

fn unreadable(path: &Path, error: &std::io::Error) -> Error {
    match error.kind() {
        std::io::ErrorKind::NotFound => input_error(path, "does not exist; check the path"),
        _ => input_error(path, format!("cannot be read: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{create_dir_all, write};

    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;

    /// A folder with these files in it.
    fn folder(files: &[&str]) -> TempDir {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            let path = dir.path().join(file);
            create_dir_all(path.parent().unwrap()).unwrap();
            write(path, b"").unwrap();
        }
        dir
    }

    fn names(paths: &[PathBuf]) -> Vec<&str> {
        paths.iter().map(|p| p.file_name().unwrap().to_str().unwrap()).collect()
    }

    fn find(dir: &TempDir, inputs: &[&str]) -> Result<Sequence> {
        find_frames(&inputs.iter().map(|i| dir.path().join(i)).collect::<Vec<_>>())
    }

    /// The one-line error, which must name the path.
    fn complaint(dir: &TempDir, inputs: &[&str], names: &str) -> String {
        let message = find(dir, inputs).unwrap_err().to_string();
        assert!(message.starts_with(dir.path().join(names).to_str().unwrap()), "{message}");
        assert!(!message.contains('\n'), "{message}");
        message
    }

    #[test]
    fn a_folder_gives_its_scans_in_natural_order() {
        let dir = folder(&["10.bin", "2.bin", "1.PCD", "3.ply", "x.txt", ".4.bin", "below/5.bin"]);
        let found = find(&dir, &[""]).unwrap();
        assert_eq!(names(&found.frames), ["1.PCD", "2.bin", "3.ply", "10.bin"]);
        assert_eq!(names(&found.left_out), ["x.txt"]);
    }

    #[test]
    fn a_drive_gives_the_scans_below_it() {
        for data in ["velodyne_points/data", "velodyne", "data"] {
            let dir = folder(&[&format!("{data}/0.bin"), "oxts/data/0.txt", "timestamps.txt"]);
            let found = find(&dir, &[""]).unwrap();
            assert_eq!(found.frames, [dir.path().join(data).join("0.bin")]);
            assert!(found.left_out.is_empty());
        }
        let dir = folder(&["velodyne_points/data/0.bin", "velodyne_points/timestamps.txt"]);
        assert_eq!(find(&dir, &["velodyne_points"]).unwrap().frames.len(), 1);
        let two = folder(&["velodyne_points/data/0.bin", "velodyne/0.bin"]);
        assert!(complaint(&two, &[""], "").contains("give one of them"));
    }

    #[test]
    fn files_are_taken_as_named_and_sorted() {
        let dir = folder(&["10.bin", "9.weird", "a/8.bin"]);
        let found = find(&dir, &["10.bin", "9.weird", "a"]).unwrap();
        assert_eq!(names(&found.frames), ["8.bin", "9.weird", "10.bin"]);
    }

    #[test]
    fn errors_name_the_path_and_say_what_to_do() {
        let dir = folder(&["a/1.bin", "b/1.bin", "empty/readme.txt", "evil/nul.bin"]);
        assert!(complaint(&dir, &["missing"], "missing").contains("does not exist"));
        assert!(complaint(&dir, &["empty"], "empty").contains("holds no scans"));
        assert!(complaint(&dir, &["a", "b"], "b/1.bin").contains("same name"));
        assert!(complaint(&dir, &["a/1.bin", "a"], "a/1.bin").contains("same name"));
        assert!(complaint(&dir, &["evil"], "evil/nul.bin").contains("rename"));
    }

    #[cfg(unix)]
    #[test]
    fn links_and_names_of_other_encodings_are_reported() {
        use std::os::unix::ffi::OsStrExt;

        let dir = folder(&["links/1.bin", "latin/1.bin"]);
        std::os::unix::fs::symlink("nowhere", dir.path().join("links/2.bin")).unwrap();
        assert!(complaint(&dir, &["links"], "links/2.bin").contains("does not exist"));
        let name = std::ffi::OsStr::from_bytes(b"caf\xe9.bin");
        write(dir.path().join("latin").join(name), b"").unwrap();
        assert!(find(&dir, &["latin"]).unwrap_err().to_string().contains("UTF-8"));
        assert!(complaint(&dir, &["/dev/null"], "/dev/null").contains("neither"));
    }

    #[test]
    fn a_control_character_does_not_reach_the_terminal() {
        let message = input_error(Path::new("a\n\u{1b}[2Jb"), "is odd").to_string();
        assert!(!message.contains(char::is_control), "{message:?}");
    }

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
            assert!(!is_safe_name(name), "{name:?}");
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
            assert!(is_safe_name(name), "{name:?}");
        }
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
