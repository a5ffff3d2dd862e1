//! Code shared by the tests of whole streams: the round trip, scans for it, and their files.

#![allow(dead_code, missing_docs)] // Each test file takes the part that it needs.

pub mod bound;
pub mod firings;
pub mod formats;
pub mod messages;
pub mod odd;
pub mod scans;
pub mod streams;
pub mod sweeps;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::{fs, io};

use lidarpc::internals::container::{Group, Record, ScannerRecord, SectionKind, StreamReader, StreamWriter};
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::ground::error::{Limits, Result};
use lidarpc::internals::stream::{DecodeOptions, DecodedFrame, FrameInput, decode, decode_indexed, encode};
use proptest::test_runner::{Config, FileFailurePersistence};

/// A file's name and bytes.
pub type File = (String, Vec<u8>);

/// Above this size in bytes, decoding by the index, which uses the same code, is not tested.
const SMALL: usize = 1 << 20;

/// Encodes files, decodes them from front to back and by the index, and compares the result with the input,
/// byte for byte. Returns the stream.
pub fn round_trip(files: &[File], config: &EncoderConfig) -> Vec<u8> {
    let stream = encode_files(files, config);
    comes_back(&stream, files, 0);
    stream
}

/// Decodes a stream from front to back, and by the index on `threads` threads (0: one per processor), and
/// compares the result with the input.
pub fn comes_back(stream: &[u8], files: &[File], threads: usize) {
    assert_same(&decode_files(stream).expect("decodes"), files);
    if files.iter().map(|(_, bytes)| bytes.len()).sum::<usize>() < SMALL {
        let mut decoded = Vec::new();
        let options = DecodeOptions { threads, ..DecodeOptions::default() };
        decode_indexed(Cursor::new(stream), &options, Ok, |frame| keep(&mut decoded, frame))
            .expect("decodes through the index");
        assert_same(&decoded, files);
    }
}

/// Encodes files to a stream.
pub fn encode_files(files: &[File], config: &EncoderConfig) -> Vec<u8> {
    let input = |(name, bytes): &File| FrameInput::memory(name.clone(), bytes.clone());
    let inputs: Vec<_> = files.iter().map(input).collect();
    let mut stream = Vec::new();
    let encoded = encode(&inputs, config, &mut stream, &|| ()).expect("encodes");
    assert_eq!(encoded.stream_bytes, stream.len() as u64);
    stream
}

/// Decodes a stream from front to back, on this thread.
pub fn decode_files(stream: &[u8]) -> Result<Vec<File>> {
    decode_within(stream, Limits::default())
}

/// As [`decode_files`], with limits.
pub fn decode_within(stream: &[u8], limits: Limits) -> Result<Vec<File>> {
    let mut files = Vec::new();
    let options = DecodeOptions { threads: 1, limits, ..DecodeOptions::default() };
    decode(stream, &options, Ok, |frame| keep(&mut files, frame))?;
    Ok(files)
}

fn keep(files: &mut Vec<File>, frame: DecodedFrame) -> Result<()> {
    let bytes = frame.to_bytes()?;
    files.push((frame.header.name, bytes));
    Ok(())
}

fn assert_same(decoded: &[File], files: &[File]) {
    assert_eq!(decoded.len(), files.len(), "number of files");
    for ((name, bytes), (expected_name, expected)) in decoded.iter().zip(files) {
        assert_eq!(name, expected_name);
        let differ = bytes.iter().zip(expected).position(|(a, b)| a != b);
        assert!(
            bytes == expected,
            "{name}: {} of {} bytes, differ at {differ:?}",
            bytes.len(),
            expected.len()
        );
    }
}

/// A stream's scanners and groups, to be changed and written again with correct checksums.
pub fn take_apart(stream: &[u8]) -> (Vec<ScannerRecord>, Vec<Group>) {
    let mut reader = StreamReader::open(stream, Limits::default()).unwrap();
    let (mut scanners, mut groups) = (Vec::new(), Vec::new());
    while let Some(record) = reader.next_record().unwrap() {
        match record {
            Record::Scanner(scanner) => scanners.push(scanner),
            Record::Group(group) => groups.push(group),
        }
    }
    (scanners, groups)
}

/// The inverse of [`take_apart`].
pub fn put_together(scanners: &[ScannerRecord], groups: &[Group]) -> Vec<u8> {
    let mut writer = StreamWriter::create(Vec::new()).unwrap();
    for scanner in scanners {
        writer.write_scanner(scanner).unwrap();
    }
    groups.iter().for_each(|group| writer.write_group(group).unwrap());
    writer.finish().unwrap().0
}

/// Bytes of each kind of section in a stream.
pub fn section_bytes(stream: &[u8]) -> BTreeMap<SectionKind, usize> {
    let mut bytes = BTreeMap::new();
    for section in take_apart(stream).1.iter().flat_map(|group| &group.frames).flat_map(|f| &f.sections) {
        *bytes.entry(section.kind).or_default() += section.payload.len();
    }
    bytes
}

/// Settings for property tests: `cases`, unless PROPTEST_CASES says otherwise.
pub fn cases(cases: u32) -> Config {
    let default = Config::default();
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { default.cases } else { cases };
    let failure_persistence = Some(Box::new(FileFailurePersistence::WithSource("regressions")) as _);
    Config { cases, failure_persistence, ..default }
}

/// A path inside the package.
pub fn in_package(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The folders of real scans, which are not part of the package: those in the folder named by LIDARPC_DATA,
/// or in `../shared/data`. If it is missing, prints so and returns none.
pub fn real_folders() -> Vec<PathBuf> {
    let root = std::env::var_os("LIDARPC_DATA").map_or_else(|| in_package("../shared/data"), PathBuf::from);
    let entries = fs::read_dir(&root).map(|entries| entries.flatten().map(|e| e.path()).collect());
    let mut folders: Vec<PathBuf> = entries.unwrap_or_default();
    folders.retain(|path| path.is_dir());
    // A folder of folders counts as one.
    let subfolders = |folder: &PathBuf| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        entries.filter(|path| path.is_dir()).collect()
    };
    let (with, mut folders): (Vec<_>, Vec<_>) =
        folders.into_iter().partition(|folder| !subfolders(folder).is_empty());
    folders.extend(with.iter().flat_map(subfolders));
    folders.sort();
    if folders.is_empty() {
        skip(format!("no real scans in {}", root.display()));
    }
    folders
}

/// Says on stderr, where the test harness does not hide it, that a part of a test is left out.
pub fn skip(why: impl Display) {
    let _ = writeln!(io::stderr(), "skipped: {why}");
}

/// The first files of a folder, by name.
pub fn first_files(folder: &Path, count: usize) -> Vec<File> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).collect();
    paths.sort();
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    paths.iter().take(count).map(|path| (name(path), fs::read(path).unwrap())).collect()
}
