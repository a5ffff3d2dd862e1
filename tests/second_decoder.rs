//! The second decoder, written in Python from FORMAT.md, decodes the golden streams to the same files.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use crate::common::skip;

/// The streams of two identical scans of firings of which it decodes both. Of others it decodes the first:
/// for the second one it does the same again.
const DECODED_TWICE: [&str; 2] = ["exact-firings-echoes", "exact-firings-off-axis"];
/// The exit status by which it reports that a stream needs an unsupported feature.
const NOT_HERE: i32 = 3;
/// Parts of the names of such streams.
const BACK_ENDS: [&str; 5] = ["brotli", "ppmd", "lz5", "lizard", "jpeg2000"];

#[test]
fn golden_streams_decode_to_the_same_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = Command::new("python3").arg("--version").output();
    if !python.is_ok_and(|python| python.status.success()) {
        skip("there is no python3, so the second decoder was not run");
        return;
    }
    let entries = fs::read_dir(root.join("testdata/golden")).unwrap();
    let mut streams: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    streams.retain(|path| path.extension().is_some_and(|extension| extension == "lpc"));
    streams.sort();
    assert!(streams.len() > 20);
    let is_there = |name: &str| streams.iter().any(|stream| stream.file_stem() == Some(name.as_ref()));
    assert!(DECODED_TWICE.iter().all(|name| is_there(name)));
    let next = AtomicUsize::new(0);
    let check_some = || {
        while let Some(stream) = streams.get(next.fetch_add(1, Ordering::Relaxed)) {
            check(root, stream);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(check_some);
        }
    });
}

fn check(root: &Path, stream: &Path) {
    let name = stream.file_stem().unwrap().to_str().unwrap();
    let mut command = Command::new("python3");
    command.arg(root.join("tests/second_decoder")).arg("--list").arg(stream);
    let list = fs::read_to_string(stream.with_extension("txt")).unwrap();
    let mut contents = list.lines().map(|line| line.split_once(' ').unwrap().1);
    let first = contents.next();
    let is_repeated = list.lines().count() == 2 && contents.next() == first;
    let one_suffices = is_repeated && name.starts_with("exact-firings-") && !DECODED_TWICE.contains(&name);
    if one_suffices {
        command.args(["--first", "1"]);
    }
    let output = command.output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    if BACK_ENDS.iter().any(|back_end| name.contains(back_end)) {
        assert_eq!(output.status.code(), Some(NOT_HERE), "{name}: {error}");
        return;
    }
    assert!(output.status.success(), "{name}: {error}");
    // Each line: name, size, checksum; then the number of points, which the lists of the golden streams do
    // not have.
    let decoded = String::from_utf8(output.stdout).unwrap();
    let decoded: Vec<&str> = decoded.lines().map(|line| line.rsplit_once(' ').unwrap().0).collect();
    let listed = list.lines().take(if one_suffices { 1 } else { usize::MAX });
    assert_eq!(decoded, listed.collect::<Vec<_>>(), "{name}");
}
