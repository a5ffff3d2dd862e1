//! A program that is killed at any moment leaves nothing incomplete under a final name, and its leftovers are
//! removed by the next run.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::common::in_package;
use assert_cmd::cargo::cargo_bin;
use tempfile::TempDir;

/// Runs the program in `folder`, and ends it after a while by a signal, if one is given.
fn run(folder: &Path, args: &[&str], end: Option<(Duration, &str)>) -> bool {
    let mut command = Command::new(cargo_bin!("lidarpc"));
    command.args(args).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    if let Some((after, signal)) = end {
        sleep(after);
        let id = child.id().to_string();
        // It may have ended by now, which is fine too.
        let _ = Command::new("kill").args([signal, &id]).stderr(Stdio::null()).status().unwrap();
    }
    child.wait().unwrap().success()
}

/// The files of a folder; hidden ones are temporary. None if there is no folder.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(folder).into_iter().flatten().map(Result::unwrap);
    let files = entries.filter(|entry| entry.path().is_file());
    files
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .filter(|(name, _)| !name.starts_with('.'))
        .collect()
}

fn hidden(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten().map(Result::unwrap);
    entries.filter(|entry| entry.file_name().to_string_lossy().starts_with('.')).count()
}

/// Kills encoding and decoding at this many moments each, evenly spaced over their duration.
fn kill_at(moments: u32) {
    let bench = TempDir::new().unwrap();
    let folder = bench.path();
    let drive = in_package("testdata/drive");
    let encode = ["encode", drive.to_str().unwrap(), "-o", "out/out.lpc", "--force", "--gop", "1"];
    let decode = ["decode", "whole.lpc", "-o", "back", "--force"];
    fs::create_dir(folder.join("out")).unwrap();
    let timed = |args: &[&str]| {
        let start = Instant::now();
        assert!(run(folder, args, None));
        start.elapsed()
    };
    let encoding = timed(&encode);
    fs::rename(folder.join("out/out.lpc"), folder.join("whole.lpc")).unwrap();
    let stream = fs::read(folder.join("whole.lpc")).unwrap();
    let decoding = timed(&decode);
    let scans = files(&drive);
    for moment in 0..moments {
        let signal = ["-TERM", "-KILL"][moment as usize % 2];
        let after = |whole: Duration| Some((whole * (moment + 1) / (moments + 1), signal));

        let done = run(folder, &encode, after(encoding));
        let left = files(&folder.join("out"));
        assert!(left.values().all(|bytes| *bytes == stream), "half a stream after {signal}");
        assert!(!done || left.len() == 1);
        assert!(signal == "-KILL" || hidden(&folder.join("out")) == 0, "left over after {signal}");
        fs::remove_file(folder.join("out/out.lpc")).ok();

        fs::remove_dir_all(folder.join("back")).ok();
        let done = run(folder, &decode, after(decoding));
        let left = files(&folder.join("back"));
        assert!(left.iter().all(|(name, bytes)| scans[name] == *bytes), "half a scan after {signal}");
        assert!(!done || left == scans);
        if moment + 1 == moments {
            assert!(run(folder, &encode, None) && run(folder, &decode, None));
            assert_eq!((hidden(&folder.join("out")), hidden(&folder.join("back"))), (0, 0), "left over");
        }
    }
}

/// Ends an encode with --resume by each signal, again and again as soon as another group is written, until it
/// is complete.
#[test]
fn what_is_interrupted_goes_on() {
    let bench = TempDir::new().unwrap();
    let folder = bench.path();
    let drive = in_package("testdata/drive");
    let encode = ["encode", drive.to_str().unwrap(), "-o", "out.lpc", "--gop", "1", "--threads", "1"];
    assert!(run(folder, &encode, None));
    let whole = fs::read(folder.join("out.lpc")).unwrap();
    let groups = || {
        let journal = fs::read(folder.join("out.lpc.partial.journal")).unwrap_or_default();
        journal.iter().filter(|byte| **byte == b'\n').count().saturating_sub(1)
    };
    for signal in ["-KILL", "-TERM", "-INT", "-HUP"] {
        fs::remove_file(folder.join("out.lpc")).unwrap();
        let mut is_done = false;
        while !is_done {
            let before = groups();
            let mut command = Command::new(cargo_bin!("lidarpc"));
            command.args(encode).args(["--resume", "--quiet"]).current_dir(folder);
            let mut child = command.spawn().unwrap();
            let mut ended = None;
            while ended.is_none() && groups() == before {
                sleep(Duration::from_millis(1));
                ended = child.try_wait().unwrap();
            }
            let id = child.id().to_string();
            let _ = Command::new("kill").args([signal, &id]).stderr(Stdio::null()).status().unwrap();
            child.wait().unwrap();
            is_done = folder.join("out.lpc").exists();
            if !is_done {
                let left: Vec<_> = files(folder).into_keys().collect();
                assert_eq!(left, ["out.lpc.partial", "out.lpc.partial.journal"], "after {signal}");
                assert!(groups() > before, "nothing new after {signal}");
            }
        }
        // It may have been ended after the stream was renamed.
        assert!(run(folder, &[&encode[..], &["--resume"]].concat(), None), "does not know what is done");
        assert!(!run(folder, &encode, None), "overwrites what is done");
        assert_eq!(files(folder).into_keys().collect::<Vec<_>>(), ["out.lpc"]);
        assert!(fs::read(folder.join("out.lpc")).unwrap() == whole, "another stream after {signal}");
        assert_eq!(hidden(folder), 0);
    }
}

#[test]
fn nothing_is_half_written_whenever_it_is_killed() {
    kill_at(6);
}

#[test]
#[ignore = "takes minutes"]
fn nothing_is_half_written_at_a_hundred_moments() {
    kill_at(100);
}
