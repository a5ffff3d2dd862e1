//! LZ5 and Lizard decode the output of the reference programs.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::skip;
use lidarpc::internals::backend::{by_name, decompress};

/// Residuals as of a range image: mostly small, some large, zigzag, 16 bits little-endian.
fn residuals() -> Vec<u8> {
    let mut state = 2026u32;
    let mut next = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) % below
    };
    let value = |i: u32, a: u32, b: u32| match i % 97 {
        0 => a * 50,
        1..12 => 0,
        _ => (a % 16) * (b % 16) / 16,
    };
    (0..6000).flat_map(|i| (value(i, next(1000), next(1000)) as u16).to_le_bytes()).collect()
}

fn decodes(file: &Path, original: &[u8]) {
    let name = match file.extension().and_then(|extension| extension.to_str()) {
        Some("lz5") => "lz5",
        _ => "lizard",
    };
    let decoded = decompress(by_name(name).unwrap(), &fs::read(file).unwrap(), original.len());
    assert!(decoded.unwrap() == original, "{}", file.display());
}

/// The files of a folder with these extensions.
fn coded_files(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|e| e == "lz5" || e == "liz")).collect()
}

#[test]
fn files_of_the_reference_programs_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/vectors");
    let files = coded_files(&folder);
    assert_eq!(files.len(), 9);
    files.iter().for_each(|file| decodes(file, &residuals()));
}

#[test]
fn files_beside_the_project_are_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/vectors");
    let Ok(original) = fs::read(folder.join("residual_u16le.bin")) else {
        skip(format!("there is no {}", folder.display()));
        return;
    };
    let files = coded_files(&folder);
    assert!(!files.is_empty());
    files.iter().for_each(|file| decodes(file, &original));
}
