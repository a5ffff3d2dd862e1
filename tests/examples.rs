//! The examples run, and are the same in the README and in the documentation.

use std::fs;
use std::path::Path;
use std::process::Command;

use assert_cmd::cargo::cargo_bin;
use tempfile::TempDir;

#[allow(dead_code)]
#[path = "../examples/encode_points.rs"]
mod encode_points;
#[allow(dead_code)]
#[path = "../examples/read_drive.rs"]
mod read_drive;

#[test]
fn what_one_example_writes_the_other_reads() {
    let folder = TempDir::new().unwrap();
    let stream = folder.path().join("drive.lpc");
    let summary = encode_points::encode(&stream).unwrap();
    assert_eq!((summary.scans, summary.points), (10, 57_600));
    let mut read = Vec::new();
    read_drive::read(&stream, &mut read).unwrap();
    let read = String::from_utf8(read).unwrap();
    assert!(read.starts_with("10 frames\n") && read.contains("channel ring: u8"), "{read}");
    assert_eq!(read.matches("5760 points").count(), 10, "{read}");
}

#[test]
fn points_in_memory_decode_to_files_that_name_their_channels() {
    let folder = TempDir::new().unwrap();
    let (stream, files) = (folder.path().join("drive.lpc"), folder.path().join("files"));
    encode_points::encode(&stream).unwrap();
    let mut decode = Command::new(cargo_bin!("lidarpc"));
    assert!(decode.arg("decode").arg(stream).arg("-o").arg(&files).status().unwrap().success());
    let file = String::from_utf8_lossy(&fs::read(files.join("000009.pcd")).unwrap()).into_owned();
    assert!(file.contains("FIELDS x y z intensity ring time\nSIZE 4 4 4 4 1 4\nTYPE F F F F U F"), "{file}");
}

/// The first block that `fence` begins, of a text whose lines all begin with `margin`.
fn block(text: &str, fence: &str, margin: &str) -> Vec<String> {
    let lines = text.lines().filter_map(|line| line.strip_prefix(margin));
    let lines = lines.map(|line| line.strip_prefix(' ').filter(|_| !margin.is_empty()).unwrap_or(line));
    let lines = lines.skip_while(|line| *line != fence).skip(1);
    lines.take_while(|line| *line != "```").map(str::to_owned).collect()
}

#[test]
fn the_example_of_the_readme_is_that_of_the_documentation() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |name: &str| fs::read_to_string(root.join(name)).unwrap();
    let readme = block(&read("README.md"), "```rust", "");
    assert!(readme.iter().any(|line| line.contains("Encoder::new")));
    assert_eq!(readme, block(&read("src/lib.rs"), "```no_run", "//!"));
}

/// The name of a heading in links: its letters and digits in lower case, with a hyphen for each space.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim();
    let kept = text.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c.to_ascii_lowercase() }).collect()
}

/// The targets of the links of a document, except external ones, code, and examples of links.
fn links(text: &str) -> Vec<&str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
    targets.filter(|target| !target.contains("://") && !target.contains(char::is_whitespace)).collect()
}

#[test]
fn every_link_of_the_documents_leads_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let documents = |folder: &Path| -> Vec<_> {
        let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect()
    };
    let documents: Vec<_> =
        ["", "docs", "python", "testdata"].iter().flat_map(|name| documents(&root.join(name))).collect();
    let mut checked = 0;
    for document in &documents {
        let text = fs::read_to_string(document).unwrap();
        for link in links(&text) {
            let (path, place) = link.split_once('#').unwrap_or((link, ""));
            let target =
                if path.is_empty() { document.clone() } else { document.parent().unwrap().join(path) };
            assert!(target.exists(), "{}: {link} leads nowhere", document.display());
            checked += 1;
            if place.is_empty() {
                continue;
            }
            let text = fs::read_to_string(&target).unwrap();
            let mut headings = text.lines().filter(|line| line.starts_with('#'));
            assert!(
                headings.any(|heading| anchor(heading) == place),
                "{}: {link}: no such heading",
                document.display()
            );
        }
    }
    assert!(documents.len() > 8 && checked > 100, "{} documents, {checked} links", documents.len());
}
