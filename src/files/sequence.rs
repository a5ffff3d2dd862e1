//! The frames of an input: which files, under which names, and in which order.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use super::names::{FileNames, NameConflict, check_name, is_safe_path, natural_cmp};
use super::{EXTENSIONS, SNIFFED_BYTES, is_scan_by_name, starts_as_scan_of_folder, times};
use crate::ground::error::{Error, Limits, Result};

/// Where KITTI, KITTI-360 and Argoverse 2 store the scans of a drive, relative to its folder.
const DRIVE_FOLDERS: [&str; 4] = ["velodyne_points/data", "sensors/lidar", "velodyne", "data"];
/// The customary extension of streams.
pub const STREAM_EXTENSION: &str = "lpc";

/// The files of an input.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sequence {
    /// The scans, drive by drive, each in the natural order of their names. No two have the same name.
    pub frames: Vec<FoundFile>,
    /// The other files to be stored, in natural order; empty unless all files were requested.
    pub beside: Vec<FoundFile>,
    /// The contents of the given folders that are not stored, by kind and path.
    pub left_out: Vec<(LeftOutKind, PathBuf)>,
    /// Lists of times that do not match the scans of their folders.
    pub unmatched_lists: Vec<PathBuf>,
}

/// A file, and its name in a stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FoundFile {
    /// Its path on disk.
    pub path: PathBuf,
    /// Its own name; or, if the input has several folders of scans or all files were requested, its path
    /// below the input, with `/` on every system. The name of an empty folder that is stored ends in `/`.
    pub name: String,
    /// The folder of its drive below the input, as in `name`; empty if that is the input. For a scan this is
    /// the folder that contains it, without `velodyne_points/data` and the like.
    pub drive: String,
    /// The time at which it was taken, in nanoseconds since 1970, if known.
    pub time: Option<times::ScanTime>,
}

impl Sequence {
    /// The paths of the scans.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.frames.iter().map(|frame| frame.path.clone()).collect()
    }

    /// Appends the files of the next input.
    fn extend(&mut self, other: Sequence) {
        self.frames.extend(other.frames);
        self.beside.extend(other.beside);
        self.left_out.extend(other.left_out);
        self.unmatched_lists.extend(other.unmatched_lists);
    }
}

/// Contents of an input that are not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LeftOutKind {
    /// A file that is not recognised as a scan.
    File,
    /// A stream of this program.
    Stream,
    /// A file or folder whose name begins with a dot.
    Hidden,
    /// A symbolic link that is not followed.
    Link,
    /// A symbolic link to a scan. The scan is encoded in its place.
    FollowedLink,
    /// A named pipe, a socket or a device.
    Special,
    /// A file that would be stored, but is larger than decoders accept.
    TooLarge,
    /// A file that would be stored, but belongs to none of the drives, each of which becomes a stream.
    OutsideDrives,
    /// A file that would be stored, but whose name not every system can restore.
    OddName,
}

impl LeftOutKind {
    /// The name of one item of this kind.
    pub fn name(self) -> &'static str {
        self.names()[0]
    }

    /// The names of one item and of several.
    fn names(self) -> [&'static str; 2] {
        match self {
            LeftOutKind::File => ["file not known as a scan", "files not known as scans"],
            LeftOutKind::Stream => ["lidarpc stream", "lidarpc streams"],
            LeftOutKind::Hidden => ["hidden file or folder", "hidden files or folders"],
            LeftOutKind::Link => ["symbolic link", "symbolic links"],
            LeftOutKind::FollowedLink => [
                "symbolic link, stored as the scan it leads to",
                "symbolic links, stored as the scans they lead to",
            ],
            LeftOutKind::Special => ["named pipe, socket or device", "named pipes, sockets or devices"],
            LeftOutKind::TooLarge => ["file of more than 1 GiB", "files of more than 1 GiB"],
            LeftOutKind::OutsideDrives => ["file outside the drives", "files outside the drives"],
            LeftOutKind::OddName => [
                "file whose name not every system can restore",
                "files whose names not every system can restore",
            ],
        }
    }
}

/// Counts of what was left out, by kind. Only the first path of each kind is kept, as an archive may be
/// endless.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeftOut(pub BTreeMap<LeftOutKind, LeftOutPaths>);

/// Paths that were left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOutPaths {
    /// Their number.
    pub count: u64,
    /// Bytes of those that are files.
    pub bytes: u64,
    /// The first path.
    pub first: String,
}

impl LeftOut {
    /// Counts one more item, of `bytes` bytes.
    pub fn add(&mut self, kind: LeftOutKind, path: impl Into<String>, bytes: u64) {
        let paths =
            self.0.entry(kind).or_insert_with(|| LeftOutPaths { count: 0, bytes: 0, first: path.into() });
        paths.count += 1;
        paths.bytes += bytes;
    }

    /// Adds the counts of another input.
    pub fn extend(&mut self, other: LeftOut) {
        for (kind, LeftOutPaths { count, bytes, first }) in other.0 {
            let paths = self.0.entry(kind).or_insert(LeftOutPaths { count: 0, bytes: 0, first });
            paths.count += count;
            paths.bytes += bytes;
        }
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// One line, with counts and an example of each kind.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (kind, LeftOutPaths { count, bytes, first })) in self.0.iter().enumerate() {
            let [one, several] = kind.names();
            let (separator, name) =
                (if place == 0 { "" } else { ", " }, if *count == 1 { one } else { several });
            let size = if *bytes == 0 { String::new() } else { format!("{bytes} bytes, ") };
            let such_as = if *count == 1 { "" } else { "such as " };
            write!(f, "{separator}{count} {name} ({size}{such_as}{first})")?;
        }
        Ok(())
    }
}

/// Finds the frames of `inputs`: files, folders of scans, or trees of them. A text file in a folder counts as
/// a scan if it names its coordinates or looks like points. Hidden files are left out; links to scans are
/// followed, links to folders are not. A file that is named explicitly is accepted whatever its extension.
///
/// If a folder contains the scans of one folder only, itself or one below, these keep their own names, and
/// are put in one order with the scans of the other inputs. The scans of a tree with several such folders are
/// listed drive by drive, with their paths below the input as names.
///
/// # Errors
/// [`Error::Input`], with the path and what to do: nothing there, no scan in a folder, unreadable, two frames
/// with the same name, or a name that could not be restored (see
/// [`is_safe_path`](super::names::is_safe_path)).
pub fn find_frames(inputs: &[PathBuf]) -> Result<Sequence> {
    find(inputs, false)
}

/// As [`find_frames`], with every other file and empty folder in the folders among `inputs`, including hidden
/// ones; all names are paths below the input. Left out are links that do not lead to a scan, files whose
/// names not every system can restore, and files of more than 1 GiB, which decoders do not accept.
///
/// # Errors
/// As [`find_frames`].
pub fn find_all(inputs: &[PathBuf]) -> Result<Sequence> {
    find(inputs, true)
}

fn find(inputs: &[PathBuf], all: bool) -> Result<Sequence> {
    let mut found = Sequence::default();
    for input in inputs {
        let kind = fs::metadata(input).map_err(|error| unreadable(input, &error))?;
        if kind.is_dir() {
            found.extend(Tree::walk(input, all)?.into_sequence(input, all)?);
        } else if kind.is_file() {
            let name = frame_name(input)?.to_owned();
            let time = times::of_name(&name);
            found.frames.push(FoundFile { path: input.clone(), name, time, ..FoundFile::default() });
        } else {
            return Err(input_error(
                input,
                "is neither a file nor a folder; give files or a folder of scans",
            ));
        }
    }
    let files = found.frames.iter().chain(&found.beside);
    check_different(files)?;
    // A stable sort: drives stay in the order in which they were found.
    if found.frames.iter().all(|frame| frame.drive.is_empty()) {
        found.frames.sort_by(|a, b| natural_cmp(&a.name, &b.name));
    }
    found.left_out.sort();
    Ok(found)
}

/// The contents of a folder and of those below it.
#[derive(Default)]
struct Tree {
    /// The folders that hold scans, in natural order.
    folders: Vec<ScanFolder>,
    /// Files that are stored beside the scans, and empty folders.
    beside: Vec<PathBuf>,
    left_out: Vec<(LeftOutKind, PathBuf)>,
}

/// A folder that holds scans.
struct ScanFolder {
    path: PathBuf,
    /// The scans, in natural order.
    scans: Vec<PathBuf>,
}

impl Tree {
    /// Everything below `folder`.
    fn walk(folder: &Path, all: bool) -> Result<Self> {
        let mut tree = Tree::default();
        // Folders still to be listed, the next one last.
        let mut open = vec![folder.to_path_buf()];
        while let Some(folder) = open.pop() {
            let mut below = tree.list(&folder, all)?;
            below.sort_by(|a, b| natural_cmp(&lossy_name(b), &lossy_name(a)));
            open.extend(below);
        }
        Ok(tree)
    }

    /// Adds the contents of a folder except its subfolders, which are returned.
    fn list(&mut self, folder: &Path, all: bool) -> Result<Vec<PathBuf>> {
        let (mut scans, mut subfolders, mut is_empty) = (Vec::new(), Vec::new(), true);
        for entry in fs::read_dir(folder).map_err(|error| unreadable(folder, &error))? {
            is_empty = false;
            let entry = entry.map_err(|error| unreadable(folder, &error))?;
            let path = entry.path();
            let name = entry.file_name();
            let name = name.to_string_lossy();
            let is_link = entry.file_type().is_ok_and(|kind| kind.is_symlink());
            let is_hidden = name.starts_with('.');
            let is_scan =
                !is_hidden && is_scan_by_name(&name).unwrap_or_else(|| is_scan_inside(&path, &name));
            let left_out = if is_hidden && !all {
                LeftOutKind::Hidden
            } else if !is_scan && is_link {
                LeftOutKind::Link
            } else {
                // This follows links. Files without a scan's extension need not be readable.
                match fs::metadata(&path) {
                    Ok(kind) if kind.is_dir() && is_link => LeftOutKind::Link,
                    Ok(kind) if kind.is_dir() => {
                        subfolders.push(path);
                        continue;
                    }
                    Ok(kind) if is_scan && kind.is_file() => {
                        scans.push(path.clone());
                        match is_link {
                            true => LeftOutKind::FollowedLink,
                            false => continue,
                        }
                    }
                    Ok(kind) if !kind.is_file() => LeftOutKind::Special,
                    Err(error) if is_scan && is_link && error.kind() == ErrorKind::NotFound => {
                        let what =
                            "is a link to a file that does not exist; restore that file, or remove the link";
                        return Err(input_error(&path, what));
                    }
                    Err(error) if is_scan => return Err(unreadable(&path, &error)),
                    Ok(kind) if all && kind.len() > Limits::default().file_bytes => LeftOutKind::TooLarge,
                    _ if all => {
                        self.beside.push(path);
                        continue;
                    }
                    _ if has_extension(&name, STREAM_EXTENSION) => LeftOutKind::Stream,
                    _ => LeftOutKind::File,
                }
            };
            self.left_out.push((left_out, path));
        }
        if is_empty && all {
            self.beside.push(folder.to_path_buf());
        }
        if !scans.is_empty() {
            scans.sort_by(|a, b| natural_cmp(&lossy_name(a), &lossy_name(b)));
            self.folders.push(ScanFolder { path: folder.to_path_buf(), scans });
        }
        Ok(subfolders)
    }

    /// Converts the tree to files with their names in a stream.
    fn into_sequence(self, input: &Path, all: bool) -> Result<Sequence> {
        if self.folders.is_empty() {
            let mut others = self.beside.iter().chain(self.left_out.iter().map(|(_, path)| path));
            let advice = |path: &PathBuf| {
                let mcap =
                    has_extension(&lossy_name(path), "mcap").then_some("give this recording by itself");
                Some((path.clone(), advice_on_recording(path).or(mcap)?))
            };
            return Err(match others.find_map(advice) {
                Some((path, advice)) => input_error(&path, advice),
                None => input_error(input, format!("holds no scans; give a folder of {EXTENSIONS} files")),
            });
        }
        let has_paths = all || self.folders.len() > 1;
        let mut found = Sequence { left_out: self.left_out, ..Sequence::default() };
        for ScanFolder { path: folder, scans } in self.folders {
            let mut names = Vec::new();
            for scan in &scans {
                frame_name(scan)?;
                names.push(if has_paths { name_below(input, scan)? } else { frame_name(scan)?.to_owned() });
            }
            let drive = if has_paths { drive_of(&name_below(input, &folder)?) } else { String::new() };
            let times = times::of_folder(&folder, &scans);
            found.unmatched_lists.extend(times.unmatched);
            for ((path, name), time) in scans.into_iter().zip(names).zip(times.of_scans) {
                found.frames.push(FoundFile { path, name, drive: drive.clone(), time });
            }
        }
        for path in self.beside {
            let is_folder = path.is_dir();
            match name_below(input, &path) {
                Ok(name) if name.is_empty() => {}
                Ok(name) if is_safe_path(&name) => {
                    let name = if is_folder { format!("{name}/") } else { name };
                    found.beside.push(FoundFile { path, name, ..FoundFile::default() });
                }
                _ => found.left_out.push((LeftOutKind::OddName, path)),
            }
        }
        found.beside.sort_by(|a, b| natural_cmp(&a.name, &b.name));
        // Each file belongs to the drive that is nearest above it.
        let drives: BTreeSet<_> = found.frames.iter().map(|frame| frame.drive.clone()).collect();
        for file in &mut found.beside {
            let above = |drive: &&String| {
                drive.is_empty()
                    || file.name.strip_prefix(&drive[..]).is_some_and(|rest| rest.starts_with('/'))
            };
            file.drive =
                drives.iter().filter(above).max_by_key(|drive| drive.len()).cloned().unwrap_or_default();
        }
        Ok(found)
    }
}

/// Whether a file is a scan according to its first bytes. Unreadable files are not.
fn is_scan_inside(path: &Path, name: &str) -> bool {
    let is_file = fs::metadata(path).is_ok_and(|kind| kind.is_file());
    let mut start = Vec::new();
    let read = || fs::File::open(path).and_then(|file| file.take(SNIFFED_BYTES).read_to_end(&mut start));
    is_file && { read }().is_ok() && starts_as_scan_of_folder(name, &start)
}

/// The folder of the drive whose scans are in `folder`.
fn drive_of(folder: &str) -> String {
    let inside = DRIVE_FOLDERS.iter().find_map(|inside| match folder.strip_suffix(inside)? {
        "" => Some(""),
        drive => drive.strip_suffix('/'),
    });
    inside.unwrap_or(folder).to_owned()
}

/// What to do with a file whose name is that of a ROS recording in another format than MCAP; `None` for
/// others.
pub fn advice_on_recording(path: &Path) -> Option<&'static str> {
    let name = lossy_name(path);
    (has_extension(&name, "bag") || has_extension(&name, "db3"))
        .then_some("turn it into an .mcap by `rosbags-convert` (PyPI: rosbags), and encode that")
}

fn lossy_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn has_extension(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// An error if two files could not be written into one folder, because of their names.
fn check_different<'f>(files: impl Iterator<Item = &'f FoundFile>) -> Result<()> {
    let mut names = FileNames::<&Path>::default();
    for FoundFile { path, name, .. } in files {
        let is_same = |other: &Path| {
            fs::canonicalize(other).is_ok_and(|other| fs::canonicalize(path).is_ok_and(|path| path == other))
        };
        let what = match names.add(name, path) {
            Ok(()) => continue,
            Err(NameConflict::SameName(other)) if is_same(other) => "is given twice; give it once".to_owned(),
            Err(NameConflict::SameName(other)) => {
                format!(
                    "has the same name as {}; encode them apart, or the folder above both",
                    other.display()
                )
            }
            Err(NameConflict::FileAndFolder) => {
                "needs a file and a folder of one name; encode it apart".to_owned()
            }
        };
        return Err(input_error(path, what));
    }
    Ok(())
}

/// The name under which a frame is stored and restored.
///
/// # Errors
/// [`Error::Input`] if it is not UTF-8 or not every system can restore it.
fn frame_name(path: &Path) -> Result<&str> {
    let name = path.file_name().ok_or_else(|| input_error(path, "has no file name; give a file"))?;
    let name = name
        .to_str()
        .ok_or_else(|| input_error(path, "has a name that is not UTF-8 text; rename the file"))?;
    check_name(path, name).map(|()| name)
}

/// The path of a file below a folder, with `/` between its parts.
fn name_below(folder: &Path, path: &Path) -> Result<String> {
    let below = path.strip_prefix(folder).unwrap_or(path);
    let parts = below.components().map(|part| part.as_os_str().to_str());
    let parts: Option<Vec<_>> = parts.collect();
    parts
        .map(|parts| parts.join("/"))
        .ok_or_else(|| input_error(path, "has a name or a folder whose name is not UTF-8 text; rename it"))
}

fn input_error(path: &Path, what: impl Into<String>) -> Error {
    Error::Input { path: path.to_owned(), what: what.into() }
}

fn unreadable(path: &Path, error: &std::io::Error) -> Error {
    match error.kind() {
        ErrorKind::NotFound => input_error(path, "does not exist; check the path"),
        _ => input_error(path, format!("cannot be read: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{create_dir_all, write};

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

    fn names(files: &[FoundFile]) -> Vec<&str> {
        files.iter().map(|file| &file.name[..]).collect()
    }

    fn find(dir: &TempDir, inputs: &[&str]) -> Result<Sequence> {
        find_frames(&inputs.iter().map(|i| dir.path().join(i)).collect::<Vec<_>>())
    }

    /// The one-line error message, which must name the path.
    fn complaint(dir: &TempDir, inputs: &[&str], names: &str) -> String {
        let message = find(dir, inputs).unwrap_err().to_string();
        assert!(message.starts_with(dir.path().join(names).to_str().unwrap()), "{message}");
        assert!(!message.contains('\n'), "{message}");
        message
    }

    #[test]
    fn a_folder_gives_its_scans_in_natural_order() {
        let dir = folder(&["10.bin", "2.bin", "1.PCD", "3.ply", "x.txt", ".4.bin", "below/5.txt"]);
        let found = find(&dir, &[""]).unwrap();
        assert_eq!(names(&found.frames), ["1.PCD", "2.bin", "3.ply", "10.bin"]);
        let left_out = [
            (LeftOutKind::File, "below/5.txt"),
            (LeftOutKind::File, "x.txt"),
            (LeftOutKind::Hidden, ".4.bin"),
        ];
        assert_eq!(found.left_out, left_out.map(|(kind, name)| (kind, dir.path().join(name))));
    }

    #[test]
    fn a_drive_gives_the_scans_below_it() {
        for data in ["velodyne_points/data", "sensors/lidar", "velodyne", "data", "deep/er"] {
            let dir = folder(&[&format!("{data}/0.bin"), "oxts/data/0.txt", "timestamps.txt"]);
            let found = find(&dir, &[""]).unwrap();
            assert_eq!(found.frames[0].path, dir.path().join(data).join("0.bin"));
            assert_eq!((names(&found.frames), &found.frames[0].drive[..]), (vec!["0.bin"], ""));
            let mut left_out = LeftOut::default();
            found.left_out.into_iter().for_each(|(kind, _)| left_out.add(kind, "x", 3));
            assert_eq!(left_out.to_string(), "2 files not known as scans (6 bytes, such as x)", "{data}");
        }
        let dir = folder(&["velodyne_points/data/0.bin", "velodyne_points/timestamps.txt"]);
        assert_eq!(find(&dir, &["velodyne_points"]).unwrap().frames.len(), 1);
    }

    #[test]
    fn a_tree_gives_drive_after_drive_under_their_paths() {
        let files = [
            "b/velodyne/10.bin",
            "b/velodyne/9.bin",
            "a10/1.bin",
            "a9/1.bin",
            "a9/deep/velodyne_points/data/1.bin",
        ];
        let dir = folder(&files);
        let found = find(&dir, &[""]).unwrap();
        let drives: Vec<_> = found.frames.iter().map(|frame| (&frame.name[..], &frame.drive[..])).collect();
        let expected = [
            ("a9/1.bin", "a9"),
            ("a9/deep/velodyne_points/data/1.bin", "a9/deep"),
            ("a10/1.bin", "a10"),
            ("b/velodyne/9.bin", "b"),
            ("b/velodyne/10.bin", "b"),
        ];
        assert_eq!(drives, expected);
    }

    #[test]
    fn all_is_what_else_there_is() {
        let dir = folder(&["velodyne/0.bin", "velodyne/.1.bin", "image/0.png", "times.txt"]);
        create_dir_all(dir.path().join("image/none")).unwrap();
        let found = find_all(&[dir.path().to_path_buf()]).unwrap();
        assert_eq!(names(&found.frames), ["velodyne/0.bin"]);
        assert_eq!(names(&found.beside), ["image/0.png", "image/none/", "times.txt", "velodyne/.1.bin"]);
        assert_eq!(found.left_out, []);
        assert!(found.beside.iter().all(|file| file.drive.is_empty()));
    }

    #[test]
    fn files_are_taken_as_named_and_sorted() {
        let dir = folder(&["10.bin", "9.weird", "a/8.bin"]);
        let found = find(&dir, &["10.bin", "9.weird", "a"]).unwrap();
        assert_eq!(names(&found.frames), ["8.bin", "9.weird", "10.bin"]);
    }

    #[test]
    fn errors_name_the_path_and_say_what_to_do() {
        let dir = folder(&[
            "a/1.bin",
            "b/1.bin",
            "empty/readme.txt",
            "evil/nul.bin",
            "ros1/drive.bag",
            "ros2/drive_0.mcap",
        ]);
        assert!(complaint(&dir, &["missing"], "missing").contains("does not exist"));
        assert!(complaint(&dir, &["empty"], "empty").contains("holds no scans"));
        assert!(complaint(&dir, &["ros1"], "ros1/drive.bag").contains("rosbags-convert"));
        assert!(complaint(&dir, &["ros2"], "ros2/drive_0.mcap").contains("by itself"));
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
        assert!(complaint(&dir, &["links"], "links/2.bin").contains("a link to a file that does not exist"));
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
}
