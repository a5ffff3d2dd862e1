//! The frames of an input: which files, and in which order.

use std::cmp::Ordering;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use super::Kind;
use crate::ground::error::{Error, Result};

/// Where KITTI and KITTI-360 drives keep their scans, relative to the folders above.
const DRIVE_FOLDERS: [&str; 3] = ["velodyne_points/data", "velodyne", "data"];
/// What names of streams end in, by custom.
const STREAM_EXTENSION: &str = "lpc";
/// The longest file name, in bytes, that common file systems allow.
const MAX_NAME: usize = 255;

/// The frames of an input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sequence {
    /// The scans, in the natural order of their names. No two have the same name.
    pub frames: Vec<PathBuf>,
    /// What the given folders hold besides, by kind and path. What is in subfolders is not listed.
    pub left_out: Vec<(LeftOutKind, PathBuf)>,
}

/// What an input holds that decoding does not give back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LeftOutKind {
    /// A file that is not known as a scan.
    File,
    /// A stream of this program.
    Stream,
    /// A file or folder whose name begins with a dot.
    Hidden,
    /// A folder below the one that holds the scans, or beside it.
    Subfolder,
    /// A symbolic link that is not followed.
    Link,
    /// A symbolic link to a scan, which is encoded in its place.
    FollowedLink,
    /// A named pipe, a socket or a device.
    Special,
}

impl LeftOutKind {
    /// What one of them is called.
    pub fn name(self) -> &'static str {
        self.names()[0]
    }

    /// What one of them is called, and several.
    fn names(self) -> [&'static str; 2] {
        match self {
            LeftOutKind::File => ["file not known as a scan", "files not known as scans"],
            LeftOutKind::Stream => ["lidarpc stream", "lidarpc streams"],
            LeftOutKind::Hidden => ["hidden file or folder", "hidden files or folders"],
            LeftOutKind::Subfolder => ["subfolder", "subfolders"],
            LeftOutKind::Link => ["symbolic link", "symbolic links"],
            LeftOutKind::FollowedLink => [
                "symbolic link, stored as the scan it leads to",
                "symbolic links, stored as the scans they lead to",
            ],
            LeftOutKind::Special => ["named pipe, socket or device", "named pipes, sockets or devices"],
        }
    }
}

/// How much was left out, by kind. Only the first path of each is kept, as an endless archive may hold any number.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeftOut(pub BTreeMap<LeftOutKind, LeftOutPaths>);

/// Paths that were left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOutPaths {
    /// Their number.
    pub count: u64,
    /// The first.
    pub first: String,
}

impl LeftOut {
    /// Counts one more.
    pub fn add(&mut self, kind: LeftOutKind, path: impl Into<String>) {
        let paths = self.0.entry(kind).or_insert_with(|| LeftOutPaths { count: 0, first: path.into() });
        paths.count += 1;
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// In one line, with counts and an example of each kind.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (kind, LeftOutPaths { count, first })) in self.0.iter().enumerate() {
            let [one, several] = kind.names();
            let (separator, name) =
                (if place == 0 { "" } else { ", " }, if *count == 1 { one } else { several });
            let such_as = if *count == 1 { "" } else { "such as " };
            write!(f, "{separator}{count} {name} ({such_as}{first})")?;
        }
        Ok(())
    }
}

/// Finds the frames of `inputs`: files, folders of scans (`.bin`, `.pcd`, `.ply`; neither subfolders nor
/// hidden files; links are followed), or KITTI drives (folders above `velodyne_points/data` or `velodyne`). A file that
/// is named explicitly is taken whatever its extension. Frames are sorted in the natural order of their names,
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
        [_] => {
            let (below, mut found) = drives.swap_remove(0);
            // What stands beside the way to the scans.
            for above in below.ancestors().skip(1).take_while(|above| above.starts_with(folder)) {
                found
                    .left_out
                    .extend(list(above)?.left_out.into_iter().filter(|(_, path)| !below.starts_with(path)));
            }
            Ok(found)
        }
        [(one, _), (other, _), ..] => {
            let what = format!("has scans in {} and in {}; give one of them", one.display(), other.display());
            Err(input_error(folder, what))
        }
    }
}

/// What a folder holds, without what is in its subfolders.
fn list(folder: &Path) -> Result<Sequence> {
    let mut found = Sequence::default();
    for entry in fs::read_dir(folder).map_err(|error| unreadable(folder, &error))? {
        let entry = entry.map_err(|error| unreadable(folder, &error))?;
        let path = entry.path();
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let is_link = entry.file_type().is_ok_and(|kind| kind.is_symlink());
        let is_scan = Kind::of(&name).is_some();
        let left_out = if name.starts_with('.') {
            LeftOutKind::Hidden
        } else if !is_scan && is_link {
            LeftOutKind::Link
        } else {
            // Follows links. A file without a scan's extension need not be readable.
            match fs::metadata(&path) {
                Ok(kind) if kind.is_dir() => LeftOutKind::Subfolder,
                Ok(kind) if is_scan && kind.is_file() => {
                    found.frames.push(path.clone());
                    match is_link {
                        true => LeftOutKind::FollowedLink,
                        false => continue,
                    }
                }
                Ok(kind) if !kind.is_file() => LeftOutKind::Special,
                Err(error) if is_scan => return Err(unreadable(&path, &error)),
                _ if has_extension(&name, STREAM_EXTENSION) => LeftOutKind::Stream,
                _ => LeftOutKind::File,
            }
        };
        found.left_out.push((left_out, path));
    }
    Ok(found)
}

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// Sorts frames by name, and checks that the names can be restored.
fn in_natural_order(frames: Vec<PathBuf>) -> Result<Vec<PathBuf>> {
    let mut named = Vec::with_capacity(frames.len());
    let mut seen: HashMap<String, PathBuf> = HashMap::with_capacity(frames.len());
    for path in frames {
        let name = frame_name(&path)?.to_owned();
        if let Some(first) = seen.insert(name.clone(), path.clone()) {
            let is_twice = fs::canonicalize(&first)
                .ok()
                .is_some_and(|one| fs::canonicalize(&path).is_ok_and(|p| p == one));
            let what = match is_twice {
                true => "is given twice; give it once".to_owned(),
                false => format!("has the same name as {}; encode them apart", first.display()),
            };
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
    check_name(path, name).map(|()| name)
}

/// An error about a file whose name not every system can restore.
pub(crate) fn check_name(path: &Path, name: &str) -> Result<()> {
    match fault_of_name(name) {
        None => Ok(()),
        Some(fault) => {
            let what = format!("has a name that not every system can restore: it {fault}; rename the file");
            Err(input_error(path, what))
        }
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
    fault_of_name(name).is_none()
}

/// What keeps a name from being [safe](is_safe_name).
fn fault_of_name(name: &str) -> Option<&'static str> {
    let has_drive = matches!(name.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    let faults = [
        (name.is_empty(), "is empty"),
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
        let left_out = [
            (LeftOutKind::File, "x.txt"),
            (LeftOutKind::Hidden, ".4.bin"),
            (LeftOutKind::Subfolder, "below"),
        ];
        assert_eq!(found.left_out, left_out.map(|(kind, name)| (kind, dir.path().join(name))));
    }

    #[test]
    fn a_drive_gives_the_scans_below_it() {
        for data in ["velodyne_points/data", "velodyne", "data"] {
            let dir = folder(&[&format!("{data}/0.bin"), "oxts/data/0.txt", "timestamps.txt"]);
            let found = find(&dir, &[""]).unwrap();
            assert_eq!(found.frames, [dir.path().join(data).join("0.bin")]);
            let mut left_out = LeftOut::default();
            found.left_out.into_iter().for_each(|(kind, _)| left_out.add(kind, ""));
            assert_eq!(left_out.to_string(), "1 file not known as a scan (), 1 subfolder ()", "{data}");
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
        assert!(complaint(&dir, &["a/1.bin", "a"], "a/1.bin").contains("given twice"));
        assert!(complaint(&dir, &["evil"], "evil/nul.bin").contains("that of a device on Windows; rename"));
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
