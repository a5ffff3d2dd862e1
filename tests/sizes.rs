//! The sizes of streams, and the family of scanners that explains the scans, compared with a table,
//! `testdata/sizes.txt`. Intended changes are written to it by `cargo test --test all -- --ignored
//! write_sizes`.
//!
//! A line consists of name, level, family of the scanner or `-`, and bytes of the stream. Names that begin
//! with `real/` are the first file of a folder of real scans, which are not part of the package; without them
//! their lines are ignored.

use std::collections::BTreeMap;
use std::fs;

use crate::common::formats::{kitti, pcd_velodyne};
use crate::common::streams::at_level;
use crate::common::{File, encode_files, first_files, in_package, real_folders, take_apart};
use lidarpc::internals::scanner::Scanner;
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner, drive};

/// Names and files: the test data, simulated scans, and one file of each folder of real ones.
fn inputs() -> Vec<(String, Vec<File>)> {
    let vlp16 =
        SynthConfig { scanner: SynthScanner::Vlp16, frames: 2, thinning: 4, ..SynthConfig::default() };
    let named = |extension: &'static str, bytes: fn(&[[f32; 4]]) -> Vec<u8>| -> Vec<File> {
        drive(&vlp16)
            .enumerate()
            .map(|(n, frame)| (format!("{n}.{extension}"), bytes(&frame.points)))
            .collect()
    };
    let mut inputs = vec![
        ("drive".to_owned(), first_files(&in_package("testdata/drive"), 3)),
        ("vlp16-bin".to_owned(), named("bin", kitti)),
        ("vlp16-pcd".to_owned(), named("pcd", pcd_velodyne)),
    ];
    for folder in real_folders() {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        inputs.push((format!("real/{name}"), first_files(&folder, 1)));
    }
    inputs
}

/// Family and bytes of each input at each level.
fn measured() -> BTreeMap<(String, u8), (String, usize)> {
    let mut measured = BTreeMap::new();
    for (name, files) in inputs() {
        // All levels of what is at hand everywhere.
        let levels = if name == "drive" { &[1, 2, 3, 6, 7, 8, 9][..] } else { &[1, 6] };
        for &level in levels {
            let stream = encode_files(&files, &at_level(level));
            let family = take_apart(&stream).0.first().map_or_else(
                || "-".to_owned(),
                |record| {
                    let scanner = Scanner::from_record(record.family, &record.payload).unwrap();
                    scanner.map_or_else(|| record.family.to_string(), |scanner| scanner.name().to_owned())
                },
            );
            measured.insert((name.clone(), level), (family, stream.len()));
        }
    }
    measured
}

fn table() -> BTreeMap<(String, u8), (String, usize)> {
    let text = fs::read_to_string(in_package("testdata/sizes.txt")).unwrap();
    let entry = |line: &str| {
        let mut words = line.split_whitespace();
        let mut next = || words.next().unwrap_or_else(|| panic!("testdata/sizes.txt: {line:?}")).to_owned();
        ((next(), next().parse().unwrap()), (next(), next().parse().unwrap()))
    };
    text.lines().map(entry).collect()
}

#[test]
fn streams_are_as_small_as_the_table_says() {
    let table = table();
    let mut wrong = Vec::new();
    let measured = measured();
    for ((name, level), (family, bytes)) in &measured {
        let Some((expected_family, expected)) = table.get(&(name.clone(), *level)) else {
            let what =
                format!("{name} at level {level}: {family}, {bytes} bytes, of which the table says nothing");
            // Folders of real scans may be others than those of the table.
            if name.starts_with("real/") {
                println!("{what}")
            } else {
                wrong.push(what)
            }
            continue;
        };
        // The fit is not the same to the last bit on all platforms.
        let is_same = match cfg!(all(target_arch = "x86_64", target_os = "linux")) {
            true => bytes == expected,
            false => bytes.abs_diff(*expected) * 1000 <= *expected,
        };
        if !is_same || family != expected_family {
            wrong.push(format!("{name} {level}: {family} {bytes}, not {expected_family} {expected}"));
        }
    }
    let is_missing = |(name, _): &&(String, u8)| !name.starts_with("real/");
    let missing: Vec<_> =
        table.keys().filter(is_missing).filter(|key| !measured.contains_key(*key)).collect();
    assert!(wrong.is_empty() && missing.is_empty(), "{wrong:#?} {missing:?}");
}

#[test]
#[ignore = "writes the table anew"]
fn write_sizes() {
    let mut table = if in_package("testdata/sizes.txt").exists() { table() } else { BTreeMap::new() };
    table.extend(measured());
    let line = |((name, level), (family, bytes)): (&(String, u8), &(String, usize))| {
        format!("{name} {level} {family} {bytes}\n")
    };
    fs::write(in_package("testdata/sizes.txt"), table.iter().map(line).collect::<String>()).unwrap();
}
