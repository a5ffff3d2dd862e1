//! The findings of fuzzing, and its seeds, as ordinary tests.
//!
//! `fuzz/run.sh` runs the fuzzer; its findings go to `fuzz/regressions/TARGET/`, and a small part of its
//! corpus to `fuzz/kept/TARGET.bin` (`fuzz/keep.sh`). This replays both.

mod common;
#[path = "../fuzz/targets.rs"]
mod targets;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use common::formats::{
    columns, csv, kitti, las, npy, npy_by_column, npy_doubles, nuscenes, padded_columns, pcd_characters,
    pcd_extra, pcd_text, pcd_xyz, ply,
};
use common::messages::cloud;
use common::scans::{scans, small};
use common::streams::{KNOWN, STREAMS};
use common::{first_files, in_package, put_together, skip};
use lidarpc::internals::backend::{BACKENDS, Backend, Level};
use lidarpc::internals::container::ScannerRecord;
use lidarpc::internals::files::parse;
use lidarpc::internals::scanner::Scanner;
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner};
use mcap::records::MessageHeader;
use targets::{INTERRUPTED, TARGETS};

/// The fuzzer's seeds, so that it need not find the formats by chance.
fn seeds(target: &str) -> Vec<Vec<u8>> {
    let points = &scans(&small(6, 1))[0][..60];
    let files = [
        (0, kitti(points)),
        (1, nuscenes(points)),
        (2, pcd_xyz(points)),
        (2, pcd_extra(points)),
        (2, pcd_text(points)),
        (2, pcd_characters(points)),
        (3, ply(points)),
        (4, csv(points)),
        (4, columns(points)),
        (4, padded_columns(points)),
        (5, npy(points)),
        (5, npy_doubles(points)),
        (5, npy_by_column(points)),
        (6, las(points)),
        (7, b"text".to_vec()),
        (8, fs::read(in_package("testdata/vectors/pyarrow.lz4.feather")).unwrap()),
    ];
    match target {
        "container" | "salvage" => {
            STREAMS.iter().map(|(models, groups)| put_together(models, groups)).collect()
        }
        "sections" => {
            let numbered = |(number, parts): (usize, &common::streams::Parts)| {
                let frames = parts.1.iter().flat_map(|group| &group.frames);
                let sections = frames.flat_map(|frame| &frame.sections).enumerate();
                let seed = |(place, section): (usize, &lidarpc::internals::container::Section)| {
                    [&[number as u8, place as u8], &section.payload[..]].concat()
                };
                sections.map(seed).collect::<Vec<_>>()
            };
            STREAMS.iter().enumerate().flat_map(numbered).collect()
        }
        "parts" => {
            let streams = 0..STREAMS.len() as u8;
            let seed = |n: u8| vec![n, n + 1, n % 12, 1, n, 0, 3 * n + 1, (n + 5) % 12, 0, n / 2, 1, 255 - n];
            streams.map(seed).collect()
        }
        "backends" => {
            let text: Vec<u8> = (0..640u32).map(|n| (n * n / 7) as u8 & 15).collect();
            let seed = |number: usize, length: usize, coded: Vec<u8>| {
                [&[number as u8][..], &(length as u16).to_le_bytes(), &coded].concat()
            };
            let coded = |(number, backend): (usize, &&dyn Backend)| {
                seed(number, text.len(), backend.compress(&text, Level::default()).unwrap())
            };
            // Including features that only the reference programs write, such as Lizard's Huffman coding.
            let of_others = VECTORS.iter().map(|(name, file)| {
                let number = BACKENDS.iter().position(|backend| backend.name() == *name).unwrap();
                seed(number, 12_000, fs::read(in_package("testdata/vectors").join(file)).unwrap())
            });
            BACKENDS.iter().enumerate().map(coded).chain(of_others).collect()
        }
        "readers" | "conversion" => files.map(|(kind, bytes)| [vec![kind], bytes].concat()).to_vec(),
        "arrival" => {
            let framed = files.iter().map(|(_, bytes)| {
                let name = format!("a.bin {}\n", bytes.len());
                [name.as_bytes(), bytes, b"b.bin 0\n"].concat()
            });
            framed.chain([tar::Header::new_gnu(), tar::Header::new_ustar()].map(archive)).collect()
        }
        "recordings" => {
            let message = |kind: u8| cloud(&points.to_vec(), kind == 0, false);
            let messages = [0, 1].map(|kind| [vec![kind], message(kind)].concat());
            let whole = [None, Some(mcap::Compression::Lz4)].map(|compression| {
                let options = mcap::WriteOptions::new().compression(compression);
                let mut out = options.create(std::io::Cursor::new(Vec::new())).unwrap();
                let schema = out.add_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"").unwrap();
                let channel = out.add_channel(schema, "/points", "cdr", &Default::default()).unwrap();
                let header = MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
                out.write_to_known_channel(&header, &message(0)).unwrap();
                out.finish().unwrap();
                [vec![2], out.into_inner().into_inner()].concat()
            });
            messages.into_iter().chain(whole).collect()
        }
        "journal" => {
            let (stream, journal) = &*INTERRUPTED;
            let cut = |bytes: &[u8]| bytes[..bytes.len() * 2 / 3].to_vec();
            [(0, journal.clone()), (0, cut(journal)), (1, stream.clone()), (1, cut(stream))]
                .map(|(which, bytes)| [vec![which], bytes].concat())
                .to_vec()
        }
        "scanner" => {
            let vlp16 = SynthConfig { scanner: SynthScanner::Vlp16, thinning: 4, ..small(1, 1) };
            let vlp16 = Scanner::fit(&[parse("0.bin", kitti(&scans(&vlp16)[0]))]).unwrap();
            let fitted = ScannerRecord { family: vlp16.family_number(), payload: vlp16.to_payload() };
            let records = STREAMS.iter().flat_map(|(scanners, _)| scanners).chain([&fitted]);
            let seed = |record: &ScannerRecord| [&[record.family as u8], &record.payload[..]].concat();
            records.map(seed).collect::<BTreeSet<_>>().into_iter().collect()
        }
        "differential" => {
            let known = 0..KNOWN.len() as u8;
            // Each change once, at different positions and with different values.
            let seed = |n: u8| {
                let changes = (0..13).filter(|change| (change + n).is_multiple_of(4));
                let changes = changes.flat_map(|change| {
                    [change, n, n.wrapping_mul(37), n % 2, change.wrapping_mul(91), 64 + change]
                });
                [n, n].into_iter().chain(changes).collect()
            };
            known.map(seed).collect()
        }
        "round_trip" => {
            let with = |(known, mode): (u8, u8)| {
                files.iter().map(move |(kind, bytes)| [&[mode, known, *kind], &bytes[..]].concat())
            };
            let modes = [0, 4, 8, 12, 16, 20, 24, 1, 2, 40, 54, 3, 7, 39];
            (0..).zip(modes).flat_map(with).collect()
        }
        _ => {
            let with =
                |mode: u8| files.iter().map(move |(kind, bytes)| [&[mode, *kind], &bytes[..]].concat());
            [0, 1, 2, 40, 54, 3, 7, 39].into_iter().flat_map(with).collect()
        }
    }
}

/// The reference programs' output for 12,000 bytes, in each of their variants: `testdata/vectors`.
const VECTORS: [(&str, &str); 9] = [
    ("lz5", "residuals.level1.lz5"),
    ("lz5", "residuals.level9.lz5"),
    ("lz5", "residuals.level15.lz5"),
    ("lizard", "residuals.level10.liz"),
    ("lizard", "residuals.level19.liz"),
    ("lizard", "residuals.level20.liz"),
    ("lizard", "residuals.level29.liz"),
    ("lizard", "residuals.level30.liz"),
    ("lizard", "residuals.level45.liz"),
];

/// An archive with a long name, a folder and a link.
fn archive(mut header: tar::Header) -> Vec<u8> {
    let mut archive = tar::Builder::new(Vec::new());
    for (name, kind) in [
        ("drive", tar::EntryType::Directory),
        ("drive/1.bin", tar::EntryType::Regular),
        (&format!("{}/2.bin", "n".repeat(150)), tar::EntryType::Regular),
        ("drive/3.bin", tar::EntryType::Symlink),
    ] {
        let bytes = if kind.is_file() { vec![7; 600] } else { Vec::new() };
        header.set_entry_type(kind);
        header.set_size(bytes.len() as u64);
        archive.append_data(&mut header, name, &bytes[..]).unwrap();
    }
    archive.into_inner().unwrap()
}

#[test]
fn everything_that_fuzzing_found_is_mended() {
    for folder in fs::read_dir(in_package("fuzz/regressions")).unwrap() {
        let folder = folder.unwrap().path();
        let is_named = |(target, _): &&(&str, _)| folder.ends_with(target);
        let (_, run) = TARGETS.iter().find(is_named).unwrap_or_else(|| panic!("{folder:?} is no target's"));
        let found = first_files(&folder, usize::MAX);
        assert!(!found.is_empty(), "{folder:?} is empty");
        for (name, bytes) in &found {
            println!("{}: {name}", folder.display());
            run(bytes);
        }
    }
}

/// The file of the inputs kept for a target: each after its length, a u32.
fn kept_file(target: &str) -> PathBuf {
    in_package("fuzz/kept").join(target).with_extension("bin")
}

/// The inputs of the fuzzing corpus that are kept for a target.
fn kept(target: &str) -> Vec<Vec<u8>> {
    let bytes = fs::read(kept_file(target)).unwrap_or_default();
    let (mut rest, mut inputs) = (&bytes[..], Vec::new());
    while let Some((length, after)) = rest.split_first_chunk() {
        let (input, after) = after.split_at(u32::from_le_bytes(*length) as usize);
        inputs.push(input.to_vec());
        rest = after;
    }
    assert!(rest.is_empty(), "{target}: the file of what is kept is cut short");
    inputs
}

#[test]
fn every_target_takes_what_is_kept_of_fuzzing() {
    for (target, run) in TARGETS {
        let inputs = kept(target);
        println!("{target}: {} inputs", inputs.len());
        assert!(!inputs.is_empty(), "{target}: nothing is kept");
        inputs.iter().for_each(|input| run(input));
    }
}

/// Keeps a part of the corpus named by LIDARPC_CORPUS, which `fuzz/keep.sh` has minimised: as many inputs as
/// fit, of all sizes up to a limit.
#[test]
#[ignore = "writes fuzz/kept"]
fn keep() {
    /// Largest size in bytes of an input, and of all inputs of a target.
    const MOST: usize = 4096;
    const MOST_IN_ALL: usize = 24 << 10;
    let corpus = std::env::var_os("LIDARPC_CORPUS").expect("LIDARPC_CORPUS names a corpus");
    for (target, _) in TARGETS {
        // Such that all targets together take seconds, in a test build.
        let most = match target {
            "differential" => 8,
            "sequence" => 24,
            "round_trip" => 100,
            _ => 400,
        };
        let inputs = first_files(&Path::new(&corpus).join(target), usize::MAX);
        let mut inputs: Vec<Vec<u8>> = inputs.into_iter().map(|(_, bytes)| bytes).collect();
        let gathered = inputs.len();
        inputs.retain(|input| !input.is_empty() && input.len() <= MOST);
        inputs.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
        let some = |count: usize| -> Vec<u8> {
            let places = (0..count).map(|n| n * inputs.len() / count);
            let framed = places
                .map(|place| [&(inputs[place].len() as u32).to_le_bytes(), &inputs[place][..]].concat());
            framed.flatten().collect()
        };
        let counts = (0..=inputs.len().min(most)).rev().map(|count| (count, some(count)));
        let (count, bytes) = counts.into_iter().find(|(_, bytes)| bytes.len() <= MOST_IN_ALL).unwrap();
        fs::create_dir_all(kept_file(target).parent().unwrap()).unwrap();
        fs::write(kept_file(target), &bytes).unwrap();
        println!("{target}: {count} of {gathered} inputs, {} bytes", bytes.len());
    }
}

/// The fuzzer's corpus, in the folder named by LIDARPC_CORPUS: `fuzz/coverage.sh CORPUS`.
#[test]
fn every_target_takes_what_the_fuzzer_has_gathered() {
    let Some(corpus) = std::env::var_os("LIDARPC_CORPUS").filter(|corpus| !corpus.is_empty()) else {
        skip("LIDARPC_CORPUS names no corpus");
        return;
    };
    for (target, run) in TARGETS {
        let folder = Path::new(&corpus).join(target);
        let inputs = if folder.is_dir() { first_files(&folder, usize::MAX) } else { Vec::new() };
        println!("{target}: {} inputs", inputs.len());
        inputs.iter().for_each(|(_, bytes)| run(bytes));
    }
}

#[test]
fn every_target_takes_what_it_starts_from() {
    for (target, run) in TARGETS {
        let seeds = seeds(target);
        assert!(seeds.len() > 1, "{target}");
        seeds.iter().take(40).for_each(|seed| run(seed));
        // Slightly changed, as by the fuzzer.
        for (n, seed) in seeds.iter().enumerate().take(20) {
            let mut changed = seed.clone();
            let place = n * 37 % changed.len().max(1);
            if let Some(byte) = changed.get_mut(place) {
                *byte ^= 1 << (n % 8);
            }
            run(&changed);
        }
    }
}

/// Executions a second of each target with its seeds, slightly changed: `cargo test --release --test fuzz --
/// --ignored rates --nocapture`.
#[test]
#[ignore = "measures"]
fn rates() {
    for (target, run) in TARGETS {
        let seeds = seeds(target);
        // One-time initialisations are done before.
        run(&seeds[0]);
        let (start, mut runs) = (Instant::now(), 0);
        while runs < 20 || start.elapsed() < Duration::from_secs(5) {
            let mut seed = seeds[runs % seeds.len()].clone();
            let place = runs * 7919 % seed.len().max(1);
            if let Some(byte) = seed.get_mut(place) {
                *byte ^= 1 << (runs % 8);
            }
            run(&seed);
            runs += 1;
        }
        println!("{target}: {:.1} executions a second", runs as f64 / start.elapsed().as_secs_f64());
    }
}

#[test]
#[ignore = "writes fuzz/corpus"]
fn write_seeds() {
    for (target, _) in TARGETS {
        let folder = in_package("fuzz/corpus").join(target);
        fs::create_dir_all(&folder).unwrap();
        for (name, inputs) in [("seed", seeds(target)), ("kept", kept(target))] {
            for (number, input) in inputs.iter().enumerate() {
                fs::write(Path::new(&folder).join(format!("{name}-{number:03}")), input).unwrap();
            }
        }
    }
}
