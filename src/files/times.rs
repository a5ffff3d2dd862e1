//! The times at which scans were taken: from lists beside them, and from their names.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// A time, and its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanTime {
    /// Nanoseconds since 1970.
    pub nanoseconds: i64,
    /// Whether it is from a list beside the scans rather than from the scan's name.
    pub is_listed: bool,
}

/// Names of the lists of KITTI (dates) and of its odometry data set (seconds since the first scan), in the
/// folder of the scans or beside it.
const LISTS: [&str; 2] = ["timestamps.txt", "times.txt"];

/// The largest list that is read, in bytes: a million lines and more.
const LIST_BYTES: u64 = 64 << 20;

/// The times of the scans of a folder.
#[derive(Debug, Default)]
pub struct FolderTimes {
    /// The time of each scan, if it is known.
    pub of_scans: Vec<Option<ScanTime>>,
    /// A list that does not match the scans, if none does.
    pub unmatched: Option<PathBuf>,
}

/// The times of the scans of a folder: from a list, which has a line for each; otherwise from their names.
///
/// If the names are numbers below the number of lines, each scan has the line with its number, the first
/// being 0: KITTI's drives lack scans that their lists have. Otherwise there must be exactly one line for
/// each scan, in order.
pub fn of_folder(folder: &Path, scans: &[PathBuf]) -> FolderTimes {
    let names: Vec<_> =
        scans.iter().map(|scan| scan.file_name().unwrap_or_default().to_string_lossy()).collect();
    let lists = LISTS.iter().flat_map(|name| {
        let beside = folder.parent().map(|above| above.join(name));
        beside.into_iter().chain([folder.join(name)])
    });
    let mut unmatched = None;
    for path in lists.filter(|path| path.is_file()) {
        let list = read(&path).unwrap_or_default();
        if let Some(places) = places(&names, list.len()) {
            let at = |place: usize| ScanTime { nanoseconds: list[place], is_listed: true };
            return FolderTimes {
                of_scans: places.into_iter().map(|p| Some(at(p))).collect(),
                unmatched: None,
            };
        }
        unmatched.get_or_insert(path);
    }
    FolderTimes { of_scans: names.iter().map(|name| of_name(name)).collect(), unmatched }
}

/// The line number of each scan in a list of `lines` lines; none if the list does not match the scans.
fn places(names: &[impl AsRef<str>], lines: usize) -> Option<Vec<usize>> {
    let number = |name: &str| name.split('.').next().and_then(|stem| stem.parse::<usize>().ok());
    let numbers: Option<Vec<_>> = names.iter().map(|name| number(name.as_ref())).collect();
    match numbers {
        Some(numbers) if numbers.iter().all(|number| *number < lines) => Some(numbers),
        _ => (names.len() == lines).then(|| (0..lines).collect()),
    }
}

/// The times of a list, in nanoseconds since 1970; none if the list is missing, or if any line is not a time.
fn read(path: &Path) -> Option<Vec<i64>> {
    let size = fs::metadata(path).ok().filter(fs::Metadata::is_file)?.len();
    let text = (size <= LIST_BYTES).then(|| fs::read_to_string(path).ok())??;
    text.lines().map(|line| of_line(line.trim())).collect()
}

/// The time in a line: a date, taken as UTC, or a number of seconds since the first scan.
fn of_line(line: &str) -> Option<i64> {
    match line.parse::<f64>() {
        Ok(seconds) => (seconds.abs() < 9e9).then_some((seconds * 1e9).round() as i64),
        Err(_) => {
            let date = humantime::parse_rfc3339_weak(line).ok()?;
            date.duration_since(UNIX_EPOCH).ok()?.as_nanos().try_into().ok()
        }
    }
}

/// The time of a scan, if its name contains exactly one number that is nanoseconds (19 digits) or
/// microseconds (16 digits) in a year from 2001 to 2099, or nanoseconds of Argoverse's clock (18 digits),
/// which begin in 1980.
pub fn of_name(name: &str) -> Option<ScanTime> {
    let runs = name.split(|letter: char| !letter.is_ascii_digit());
    let times = runs.filter_map(|digits| {
        let number: i64 = digits.parse().ok()?;
        let nanoseconds = match digits.len() {
            18 | 19 => number,
            16 => number * 1000,
            _ => return None,
        };
        (315_532_800_000_000_000..4_102_444_800_000_000_000).contains(&nanoseconds).then_some(nanoseconds)
    });
    match &times.collect::<Vec<_>>()[..] {
        [nanoseconds] => Some(ScanTime { nanoseconds: *nanoseconds, is_listed: false }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_dates_or_seconds() {
        assert_eq!(of_line("2011-09-26 13:02:25.594360375"), Some(1_317_042_145_594_360_375));
        assert_eq!(of_line("1.037359e-01"), Some(103_735_900));
        assert_eq!(of_line("1317042145.5"), Some(1_317_042_145_500_000_000));
        for odd in ["", "x", "inf", "2011-13-26 13:02:25", "1e300"] {
            assert_eq!(of_line(odd), None, "{odd}");
        }
    }

    #[test]
    fn names_hold_nanoseconds_or_microseconds() {
        let time = |name| of_name(name).map(|found| found.nanoseconds);
        assert_eq!(time("1566246592875153456.bin"), Some(1_566_246_592_875_153_456));
        assert_eq!(time("n015__LIDAR_TOP__1532402927647951.pcd.bin"), Some(1_532_402_927_647_951_000));
        assert_eq!(time("PC_315966265259836000.ply"), Some(315_966_265_259_836_000));
        for odd in [
            "0000000000.bin",
            "000000000000000001.bin",
            "123456789012345678.bin",
            "0000000000000000001.bin",
            "9999999999999999999.bin",
            "a.bin",
            "12345678901234567890.bin",
        ] {
            assert_eq!(time(odd), None, "{odd}");
        }
        assert_eq!(time("1566246592875153456_1566246592875153457.bin"), None, "which one?");
    }

    #[test]
    fn scans_have_lines_by_number_or_in_order() {
        assert_eq!(places(&["000.bin", "002.bin"], 3), Some(vec![0, 2]));
        assert_eq!(places(&["7.bin", "9.bin"], 2), Some(vec![0, 1]));
        assert_eq!(places(&["a.pcd.bin", "b.pcd.bin"], 2), Some(vec![0, 1]));
        assert_eq!(places(&["7.bin", "9.bin"], 3), None);
        assert_eq!(places(&["a.bin"], 2), None);
    }
}
