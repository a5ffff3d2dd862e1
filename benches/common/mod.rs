//! The scans used in the benchmarks.

use std::fs;
use std::path::{Path, PathBuf};

use lidarpc::internals::files::parse;
use lidarpc::internals::scan::ScanFile;

/// Number of frames of each drive.
const FRAMES: usize = 4;

/// A drive's name and first scans.
pub type Drive = (String, Vec<ScanFile>);

/// The drive in `testdata`, and `../shared/data/kitti_city` if it is there.
pub fn drives() -> Vec<Drive> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folders = ["testdata/drive", "../shared/data/kitti_city"].map(|folder| package.join(folder));
    let drive = |folder: &PathBuf| {
        let mut paths: Vec<PathBuf> =
            fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let scan = |path: &PathBuf| Some(parse(&name(path)?, fs::read(path).ok()?));
        Some((name(folder)?, paths.iter().take(FRAMES).map(scan).collect::<Option<_>>()?))
    };
    folders.iter().filter_map(drive).collect()
}

/// Number of points in some scans.
pub fn points(scans: &[ScanFile]) -> u64 {
    scans.iter().map(|scan| scan.records as u64).sum()
}
