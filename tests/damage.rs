//! Damaged streams: all damage is detected, and intact parts can be recovered.

use std::collections::BTreeSet;
use std::io::Cursor;
use std::ops::Range;

use crate::common::formats::{kitti, pcd_extra};
use crate::common::scans::{Random, compensated, random_points, scans, small};
use crate::common::streams::at_level;
use crate::common::{File, decode_files, encode_files, put_together, section_bytes, take_apart};
use lidarpc::internals::container::{
    Group, GroupEntry, Index, Lost, ScannerId, ScannerRecord, SectionKind, StreamReader,
};
use lidarpc::internals::edit::{Named, Recovered, recover, repair};
use lidarpc::internals::frame::IntensityFidelity;
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use lidarpc::internals::ground::error::{Limits, Result};
use lidarpc::internals::ground::varint::read_unsigned;
use lidarpc::internals::stream::{DecodeOptions, FrameInput, encode_live};
use rayon::prelude::*;

/// Small files without a scanner, two a group.
fn files() -> Vec<File> {
    let file = |n: u64| (format!("{n}.bin"), kitti(&random_points(2 + n as usize, n)));
    (0..7).map(file).collect()
}

fn stream_of(files: &[File]) -> Vec<u8> {
    encode_files(files, &EncoderConfig { gop: 2, threads: 1, ..EncoderConfig::default() })
}

/// Streams that together contain every kind of section.
fn streams_of_all_sections() -> Vec<Vec<u8>> {
    let frames = scans(&small(3, 2));
    let mut odd = frames[1].clone();
    odd.swap(40, 900);
    odd.splice(100..100, random_points(10, 1));
    let files: Vec<File> = vec![
        ("0.bin".into(), kitti(&frames[0])),
        ("1.bin".into(), kitti(&odd)),
        ("2.pcd".into(), pcd_extra(&frames[1])),
        ("3.txt".into(), b"no scan".repeat(20)),
        ("3.bin".into(), kitti(&compensated(&frames[0], [0.0, 0.001, 0.02], [-0.8, 0.0, 0.01]))),
    ];
    let paper = EncoderConfig {
        projection: ProjectionKind::Ideal { columns: 200, range_step_um: 10_000 },
        coder: Coder::Backend(lidarpc::internals::backend::LZMA),
        prediction: PredictionChoice::Always(lidarpc::internals::frame::Prediction::Intra),
        ..EncoderConfig::preset(Mode::Paper)
    };
    let bounded = EncoderConfig {
        intensity: IntensityFidelity::Rounded { step_millionths: 50_000 },
        ..EncoderConfig::preset(Mode::Bounded { max_error_um: 20_000 })
    };
    [EncoderConfig::default(), bounded, paper].map(|config| encode_files(&files, &config)).to_vec()
}

/// Reads a stream from front to back, as every decoder does.
fn check(stream: &[u8]) -> Result<Index> {
    let mut reader = StreamReader::open(stream, Limits::default())?;
    while reader.next_record()?.is_some() {}
    Ok(reader.index().clone())
}

#[test]
fn every_flipped_bit_and_every_cut_of_any_stream_is_seen() {
    let streams = streams_of_all_sections();
    let kinds: BTreeSet<SectionKind> = streams.iter().flat_map(|s| section_bytes(s).into_keys()).collect();
    // The sections that these small scans do not have are covered by the same checksums.
    let others = [
        SectionKind::Blanks,
        SectionKind::World,
        SectionKind::Echoes,
        SectionKind::Sorted,
        SectionKind::Stamped,
    ];
    let expected: BTreeSet<_> =
        SectionKind::all().iter().copied().filter(|kind| !others.contains(kind)).collect();
    assert_eq!(kinds, expected, "not all sections are tried");
    for stream in &streams {
        check(stream).unwrap();
        let mut damaged = stream.clone();
        for bit in 0..stream.len() * 8 {
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(check(&damaged).is_err(), "bit {bit} went unseen");
            damaged[bit / 8] ^= 1 << (bit % 8);
        }
        for length in 0..stream.len() {
            assert!(check(&stream[..length]).is_err(), "{length} of {} bytes pass", stream.len());
        }
    }
}

/// The recovered frames of a stream, by number, and the losses.
fn saved(stream: &[u8]) -> (Vec<(u64, File)>, Vec<Lost>) {
    let (mut frames, mut losses) = (Vec::new(), Vec::new());
    let options = DecodeOptions { threads: 1, ..DecodeOptions::default() };
    recover(Cursor::new(stream), &options, |part| {
        match part {
            Recovered::Frame(frame) => {
                let bytes = frame.to_bytes()?;
                frames.push((frame.number, (frame.header.name, bytes)));
            }
            Recovered::Lost(lost) => losses.push(lost),
        }
        Ok(())
    })
    .unwrap();
    (frames, losses)
}

/// The frames of the groups whose numbers `keep` accepts.
fn frames_of(files: &[File], index: &Index, keep: impl Fn(usize) -> bool) -> Vec<(u64, File)> {
    let kept = (0..files.len() as u64).filter(|&number| {
        let place = index.groups.iter().rposition(|group| group.first_frame <= number);
        place.is_some_and(&keep)
    });
    kept.map(|number| (number, files[number as usize].clone())).collect()
}

#[test]
fn of_a_whole_stream_nothing_is_lost() {
    let files = files();
    let stream = stream_of(&files);
    let all = frames_of(&files, &check(&stream).unwrap(), |_| true);
    assert_eq!(saved(&stream), (all, Vec::new()));
}

/// Number of frames of a group that end before this place in the stream.
fn frames_before(group: &GroupEntry, place: u64) -> usize {
    let sizes = group.frames.iter().map(|frame| frame.size);
    // The checksum comes last.
    let mut end = group.offset + group.length - 4 - sizes.clone().sum::<u64>();
    let ends = sizes.map(|size| {
        end += size;
        end
    });
    ends.take_while(|end| *end <= place).count()
}

#[test]
fn a_flipped_bit_costs_its_frame_and_those_after_it_in_its_group() {
    let files = files();
    let stream = stream_of(&files);
    let index = check(&stream).unwrap();
    let (mut seen, mut unseen) = (0, 0);
    for place in 0..stream.len() {
        let mut damaged = stream.clone();
        damaged[place] ^= 1 << (place % 8);
        let at = place as u64;
        let is_hit = |group: &&GroupEntry| (group.offset..group.offset + group.length).contains(&at);
        let hit = index.groups.iter().find(is_hit);
        let (frames, losses) = saved(&damaged);
        // Frames before the damage come back if the frame that it is in shows it.
        let kept = hit.map_or(0, |group| {
            let before = frames_before(group, at);
            let is_kept = before < group.frames.len() && frames.iter().any(|(n, _)| *n == group.first_frame);
            *(if is_kept { &mut seen } else { &mut unseen }) += usize::from(before > 0);
            if is_kept { before as u64 } else { 0 }
        });
        let lost_frames = hit.map_or(0..0, |group| group.first_frame + kept..group.end());
        let left = (0..).zip(&files).filter(|(number, _)| !lost_frames.contains(number));
        assert!(frames.iter().map(|(n, file)| (*n, file)).eq(left), "byte {place}");
        assert!((1..=2).contains(&losses.len()), "byte {place}: {losses:?}");
        assert!(losses.iter().any(|lost| lost.bytes.contains(&at) || lost.bytes.is_empty()), "{losses:?}");
        let lost: Vec<u64> = losses.iter().flat_map(|lost| lost.frames.clone().unwrap_or_default()).collect();
        assert_eq!(lost, lost_frames.collect::<Vec<_>>(), "byte {place}");
    }
    assert!(seen > 3 * unseen, "{seen} bytes are seen, {unseen} are not");
}

#[test]
fn of_a_cut_stream_all_whole_groups_are_saved() {
    let files = files();
    let stream = stream_of(&files);
    let index = check(&stream).unwrap();
    let end_of = |group: usize| (index.groups[group].offset + index.groups[group].length) as usize;
    for length in end_of(0)..stream.len() {
        let (frames, losses) = saved(&stream[..length]);
        assert_eq!(frames, frames_of(&files, &index, |group| end_of(group) <= length), "{length} bytes");
        assert_eq!(losses.len(), 1, "{length} bytes");
        assert_eq!(losses[0].bytes.end, length as u64);
    }
    assert!(recover(Cursor::new(&stream[..12]), &DecodeOptions::default(), |_| Ok(())).is_ok());
    assert!(recover(Cursor::new(b"no stream"), &DecodeOptions::default(), |_| Ok(())).is_err());
}

#[test]
fn of_a_live_stream_that_stops_anywhere_all_whole_groups_are_saved() {
    let scans = scans(&small(5, 9));
    let files: Vec<File> = (0..).zip(&scans).map(|(n, scan)| (format!("{n}.bin"), kitti(scan))).collect();
    let config = EncoderConfig { gop: 2, threads: 1, ..at_level(1) };
    let mut stream = Vec::new();
    let arriving = files.iter().map(|(name, bytes)| Ok(FrameInput::memory(name.clone(), bytes.clone())));
    encode_live(arriving, &config, &mut stream, &|| ()).unwrap();
    let index = check(&stream).unwrap();
    assert_eq!(index.scanners().len(), 1);
    let end_of = |group: usize| (index.groups[group].offset + index.groups[group].length) as usize;
    let near = (0..index.groups.len()).flat_map(|group| end_of(group) - 3..end_of(group) + 3);
    for length in near.chain((end_of(0)..stream.len()).step_by(97)) {
        let expected = frames_of(&files, &index, |group| end_of(group) <= length);
        assert!(saved(&stream[..length]).0 == expected, "{length} bytes");
    }
}

#[test]
fn bytes_that_came_in_or_are_missing_shift_nothing_but_bytes() {
    let files = files();
    let stream = stream_of(&files);
    let index = check(&stream).unwrap();
    let middle = (index.groups[1].offset + index.groups[1].length / 2) as usize;
    let rest = frames_of(&files, &index, |group| group != 1);
    for (from, to, new) in
        [(middle, middle, &[2u8, 0, 2, 200][..]), (middle, middle + 3, &[]), (middle - 9, middle + 9, &[1])]
    {
        let damaged = [&stream[..from], new, &stream[to..]].concat();
        let (frames, losses) = saved(&damaged);
        assert_eq!(frames, rest);
        assert_eq!(losses[0].frames, Some(2..4));
    }
    // A whole group, and the index: the frames after it are numbered by counting those that remain.
    let entry = &index.groups[1];
    let cut = [&stream[..entry.offset as usize], &stream[(entry.offset + entry.length) as usize..]].concat();
    assert_eq!(saved(&cut).0, rest, "the index tells of the missing group");
    let index_at = (index.groups[3].offset + index.groups[3].length) as usize - entry.length as usize;
    let (frames, losses) = saved(&cut[..index_at]);
    let numbered: Vec<_> = (0..).zip(rest.into_iter().map(|(_, file)| file)).collect();
    assert_eq!(frames, numbered);
    assert!(losses.iter().all(|lost| lost.frames.is_none()), "{losses:?}");
}

/// Two frames of a scanner in one group, and groups without a scanner.
fn scanned_and_others() -> (Vec<File>, Vec<u8>) {
    let frames = scans(&small(3, 2));
    let scanned: Vec<File> =
        (0..).zip(&frames).map(|(n, frame)| (format!("{n}.bin"), kitti(frame))).collect();
    let (models, mut groups) = take_apart(&encode_files(&scanned, &EncoderConfig::default()));
    assert_eq!(models.len(), 1);
    groups.extend(take_apart(&stream_of(&files())).1);
    ([scanned, files()].concat(), put_together(&models, &groups))
}

#[test]
fn one_copy_of_a_scanner_is_enough() {
    let (files, stream) = scanned_and_others();
    let index = check(&stream).unwrap();
    let [scanner] = index.scanners() else { panic!("{} scanners", index.scanners().len()) };
    let all: Vec<_> = (0..).zip(files).collect();
    let places = scanner.offsets.iter().map(|offset| *offset as usize + 9);
    assert_eq!(places.len(), 2);
    // And the stream header.
    for place in places.chain([3]) {
        let mut damaged = stream.clone();
        damaged[place] ^= 8;
        let (frames, losses) = saved(&damaged);
        assert!(frames == all, "byte {place}");
        assert_eq!(losses.len(), 1, "byte {place}: {losses:?}");
    }
}

#[test]
fn groups_without_any_copy_of_their_scanner_are_lost_and_no_others() {
    let (_, mut stream) = scanned_and_others();
    let index = check(&stream).unwrap();
    for offset in &index.scanners()[0].offsets {
        stream[*offset as usize + 9] ^= 8;
    }
    let (frames, losses) = saved(&stream);
    assert_eq!(frames, (2..).zip(files()).collect::<Vec<_>>());
    assert_eq!(losses.len(), 3, "{losses:?}");
    assert_eq!((&losses[0].frames, &losses[1].frames), (&Some(0..0), &Some(0..2)));
    assert_eq!(losses[1].names, ["0.bin", "1.bin"]);
    assert!(losses[1].why.contains("is lost"), "{}", losses[1].why);
}

#[test]
fn a_lost_group_before_a_copy_of_a_scanner_is_told_once() {
    let (_, stream) = scanned_and_others();
    let index = check(&stream).unwrap();
    let last = index.groups.last().unwrap();
    assert!(index.scanners()[0].offsets.last().is_some_and(|offset| *offset > last.offset));
    for place in [last.offset, last.offset + last.length - 12] {
        let mut damaged = stream.clone();
        damaged[place as usize] ^= 1;
        let losses = saved(&damaged).1;
        assert_eq!(losses.len(), 1, "{losses:?}");
        assert_eq!(losses[0].frames, Some(last.first_frame..last.end()));
    }
}

/// The start of each record of a stream, and its end.
fn record_starts(stream: &[u8]) -> Vec<usize> {
    // After the stream header.
    let mut starts = vec![12];
    while starts[starts.len() - 1] < stream.len() {
        let mut rest = &stream[starts[starts.len() - 1] + 1..];
        let payload = read_unsigned(&mut rest, "length").unwrap() as usize;
        starts.push(stream.len() - rest.len() + payload + 4);
    }
    assert_eq!(starts.last(), Some(&stream.len()));
    starts
}

#[test]
fn records_that_were_moved_cost_nothing_but_are_told() {
    let (files, stream) = scanned_and_others();
    let all: Vec<_> = (0..).zip(files.clone()).collect();
    let starts = record_starts(&stream);
    // Two copies of the scanner, five groups, the index, the end.
    assert_eq!(starts.len(), 9 + 1);
    for first in 0..9 {
        for second in first + 1..9 {
            let mut records: Vec<_> = starts.windows(2).map(|ends| &stream[ends[0]..ends[1]]).collect();
            records.swap(first, second);
            let moved = [&stream[..starts[0]], &records.concat()].concat();
            if moved == stream {
                continue;
            }
            assert!(check(&moved).is_err(), "{first} and {second}: unseen");
            let (frames, losses) = saved(&moved);
            assert!(frames == all, "{first} and {second}");
            let [Lost { bytes, frames, names, .. }] = &losses[..] else { panic!("{losses:?}") };
            assert!(bytes.is_empty() && names.is_empty(), "{losses:?}");
            assert_eq!(*frames, Some(9..9), "{first} and {second}");
            let mut repaired = Vec::new();
            let input = Named { path: "in.lpc".into(), stream: Cursor::new(&moved) };
            assert_eq!(repair(input, &Limits::default(), &mut repaired, |_| ()).unwrap(), 9);
            assert!(decode_files(&repaired).unwrap() == files, "{first} and {second}");
        }
    }
}

#[test]
fn a_group_that_is_lost_among_moved_ones_is_the_only_one_told() {
    let files = files();
    let stream = stream_of(&files);
    let index = check(&stream).unwrap();
    let starts = record_starts(&stream);
    // Four groups, the index, the end; the last group but one comes first, the second is missing or damaged.
    let [head, first, second, third, rest] = [
        0..starts[0],
        starts[0]..starts[1],
        starts[1]..starts[2],
        starts[2]..starts[3],
        starts[3]..stream.len(),
    ]
    .map(|range| &stream[range]);
    let damaged = [&second[..20], &[!second[20]], &second[21..]].concat();
    for second in [&[][..], &damaged] {
        let (frames, losses) = saved(&[head, third, second, first, rest].concat());
        assert_eq!(frames, frames_of(&files, &index, |group| group != 1));
        let lost: Vec<u64> = losses.iter().flat_map(|lost| lost.frames.clone().unwrap()).collect();
        assert_eq!(lost, [2, 3], "{losses:?}");
    }
}

#[test]
fn of_a_damaged_header_the_end_tells_the_version() {
    use lidarpc::internals::container::StreamHeader;
    let stream = stream_of(&files());
    let fields = [&b"\x89LPC"[..], &[1, 0, 0, 0]].concat();
    let place = stream.windows(8).rposition(|bytes| bytes == fields).unwrap();
    assert!(place > 12, "the end does not repeat the header");
    let mut other = stream[..place - 10].to_vec();
    let mut end = vec![4, 16];
    end.extend(&stream[place - 8..place]);
    let mut header = Vec::new();
    StreamHeader { version: 2, flags: 0 }.write_to(&mut header).unwrap();
    end.extend(&header[..8]);
    end.extend(crc32c::crc32c(&end).to_le_bytes());
    other.extend(end);
    other[5] ^= 1;
    let error = recover(Cursor::new(&other), &DecodeOptions::default(), |_| Ok(())).unwrap_err();
    assert!(error.to_string().contains("format version 2"), "{error}");
}

/// Everything that determines the recovered frames of a stream: the groups, their numbers and their scanners,
/// as copied by `repair`, which accepts the same groups as `--keep-going`.
fn kept(stream: &[u8]) -> (Vec<Group>, BTreeSet<ScannerId>, Vec<Lost>) {
    let (mut repaired, mut losses) = (Vec::new(), Vec::new());
    let input = Named { path: "in".into(), stream: Cursor::new(stream) };
    repair(input, &Limits::default(), &mut repaired, |lost| losses.push(lost)).unwrap();
    let (scanners, groups) = take_apart(&repaired);
    (groups, scanners.iter().map(ScannerRecord::id).collect(), losses)
}

/// A drive of `frames` frames, five a group, whose scanner can be fitted.
fn drive(frames: usize) -> Vec<u8> {
    let scans = scans(&small(5, frames));
    let files: Vec<File> = (0..).zip(&scans).map(|(n, scan)| (format!("{n:06}.bin"), kitti(scan))).collect();
    let stream = encode_files(&files, &EncoderConfig { gop: 5, ..at_level(1) });
    assert!(decode_files(&stream).unwrap() == files);
    stream
}

/// Compares the recovered parts of a damaged stream with the expected ones: all groups except those that were
/// hit, of these perhaps the frames before the damage, and at most one further frame number in doubt.
fn check_kept(stream: &[u8], damaged: &[u8], hit: Range<usize>, parts: &(Index, Vec<Group>, ScannerId)) {
    let (index, groups, scanner) = parts;
    let (kept, scanners, losses) = kept(damaged);
    let mut kept = kept.into_iter().peekable();
    let mut lost = Vec::new();
    for (entry, group) in index.groups.iter().zip(groups) {
        let is_hit = (entry.offset as usize) < hit.end && hit.start < (entry.offset + entry.length) as usize;
        let most = if is_hit { frames_before(entry, hit.start as u64) } else { group.frames.len() };
        let is_part = |of: &Group| (of.scanners == group.scanners) && group.frames.starts_with(&of.frames);
        let found = kept.next_if(is_part).map_or(0, |of| of.frames.len());
        assert!(
            found == most || is_hit && found == 0,
            "{hit:?} of {} bytes: {found} of {most}",
            stream.len()
        );
        lost.extend(entry.first_frame + found as u64..entry.end());
    }
    assert_eq!(kept.next(), None, "{hit:?}");
    assert_eq!(scanners, [*scanner].into(), "{hit:?}");
    let frames: Vec<u64> = losses.iter().flat_map(|lost| lost.frames.clone().unwrap_or_default()).collect();
    if losses.iter().all(|lost| lost.frames.is_some()) {
        assert_eq!(frames, lost, "{hit:?}");
    }
}

/// Damages a drive byte by byte and in bursts.
fn damage_drive(frames: usize, each_of_first: usize, others: usize, bursts: usize) {
    let stream = drive(frames);
    let index = check(&stream).unwrap();
    let (scanners, groups) = take_apart(&stream);
    let [scanner] = &scanners[..] else { panic!("{} scanners", scanners.len()) };
    let parts = (index, groups, scanner.id());
    println!("{} bytes, {} groups of {frames} frames", stream.len(), parts.1.len());
    let mut random = Random(1);
    let mut place = || random.below(stream.len() as u64) as usize;
    let places: Vec<usize> =
        (0..each_of_first.min(stream.len())).chain((0..others).map(|_| place())).collect();
    places.par_iter().for_each(|&place| {
        let mut damaged = stream.clone();
        // Always another byte; sometimes only one bit differs.
        damaged[place] ^= [1 << (place % 8), 0xff, (place % 255) as u8 + 1][place % 3];
        check_kept(&stream, &damaged, place..place + 1, &parts);
    });
    let starts: Vec<usize> = (0..bursts).map(|_| place()).collect();
    starts.par_iter().for_each(|&start| {
        let hit = start..stream.len().min(start + 4096);
        let mut damaged = stream.clone();
        let mut noise = Random(start as u64);
        damaged[hit.clone()].fill_with(|| noise.number() as u8);
        check_kept(&stream, &damaged, hit, &parts);
        let kept: usize = kept(&damaged).0.iter().map(|group| group.frames.len()).sum();
        assert_eq!(saved(&damaged).0.len(), kept);
    });
}

#[test]
fn no_byte_and_no_burst_costs_more_than_the_frames_from_there_to_the_end_of_the_group() {
    damage_drive(20, 1500, 200, 20);
}

/// The same on long streams: `cargo test --release --test all damage:: -- --ignored`, some minutes.
#[test]
#[ignore = "takes minutes"]
fn no_byte_of_a_long_stream_costs_more_than_the_frames_from_there_to_the_end_of_its_group() {
    damage_drive(200, 1 << 16, 2000, 100);
}

#[test]
fn names_of_lost_frames_are_told() {
    let stream = stream_of(&files());
    let index = check(&stream).unwrap();
    let mut damaged = stream.clone();
    let last_byte = index.groups[1].offset + index.groups[1].length - 1;
    damaged[last_byte as usize] ^= 1;
    assert_eq!(saved(&damaged).1[0].names, ["2.bin", "3.bin"]);
}

#[test]
fn a_repaired_stream_is_whole() {
    let files = files();
    let mut stream = stream_of(&files);
    let index = check(&stream).unwrap();
    stream[index.groups[2].offset as usize + 5] ^= 1;
    let (mut repaired, mut losses) = (Vec::new(), 0);
    let input = Named { path: "in.lpc".into(), stream: Cursor::new(&stream) };
    let frames = repair(input, &Limits::default(), &mut repaired, |_| losses += 1).unwrap();
    assert_eq!((frames, losses), (5, 1));
    let kept = frames_of(&files, &index, |group| group != 2).into_iter().map(|(_, file)| file);
    assert_eq!(decode_files(&repaired).unwrap(), kept.collect::<Vec<_>>());
}
