//! Tests of whole sequences: they are restored with any number of threads, and all damage is detected.

use std::io::Cursor;

use super::*;
use crate::container::{
    FrameHeader, FrameKind, Group, Record, ScannerId, ScannerRecord, Section, SectionKind, Stamp,
    StreamReader, StreamWriter, Time, TimeSource,
};
use crate::edit::{Named, cat, cut};
use crate::frame::*;
use crate::ground::error::{Error, Limits, Result};
use crate::scan::{
    Channel, Column, Field, Layout, NumberRule, PointCloud, ScalarType, ScanFile, TextFormat, Wrapping,
};
use crate::study::synth::{SynthConfig, drive};

#[test]
fn no_more_of_a_file_is_written_than_its_header_says() {
    const RECORDS: usize = 1 << 22;
    let field = Field::new("v", ScalarType::F64);
    let columns = vec![Column { scalar: ScalarType::F64, rule: NumberRule::Fixed(40) }];
    let wrapping = Wrapping::Text(TextFormat { columns, ..TextFormat::default() });
    // Each value takes 350 characters: 1.5 GB in all.
    let bytes = 1e308f64.to_le_bytes().repeat(RECORDS);
    let scan = ScanFile {
        layout: Layout { wrapping, fields: vec![field.clone()], ..Layout::default() },
        records: RECORDS,
        cloud: PointCloud { channels: vec![Channel { field, bytes }], ..PointCloud::default() },
        ..ScanFile::default()
    };
    let header = FrameHeader { file_size: 10 << 20, ..FrameHeader::default() };
    let (mut written, mut longest) = (0, 0);
    let error = super::decoder::write_checked(&scan, &header, |piece| {
        (written, longest) = (written + piece.len() as u64, longest.max(piece.len()));
        Ok(())
    });
    let error = error.unwrap_err().to_string();
    assert!(error.contains("more than 10485760 bytes"), "{error}");
    assert!(written <= header.file_size && longest < 4 << 20, "{written} {longest}");
}

/// Seven files: scans, an empty one, an unusual one, and one that is not a scan.
fn sample_files() -> Vec<(String, Vec<u8>)> {
    let record = |n: usize| {
        let values = [n as f32 * 0.25, 1.0 / (n as f32 - 3.0), -0.0, f32::NAN];
        values.map(f32::to_le_bytes).concat()
    };
    let scan = |points: usize| (0..points).flat_map(record).collect::<Vec<u8>>();
    let files = [scan(5), Vec::new(), scan(1), vec![7; 17], scan(9), b"no scan at all".to_vec(), scan(2)];
    files.into_iter().enumerate().map(|(n, bytes)| (format!("{n}.bin"), bytes)).collect()
}

fn inputs(files: &[(String, Vec<u8>)]) -> Vec<FrameInput> {
    let input = |(name, bytes): &(String, Vec<u8>)| FrameInput::memory(name.clone(), bytes.clone());
    files.iter().map(input).collect()
}

fn encode_files(files: &[(String, Vec<u8>)], gop: usize, threads: usize) -> Vec<u8> {
    let mut stream = Vec::new();
    let config = EncoderConfig { gop, threads, ..EncoderConfig::default() };
    let encoded = encode(&inputs(files), &config, &mut stream, &|| ()).unwrap();
    assert_eq!(encoded.stream_bytes, stream.len() as u64);
    assert_eq!(encoded.frames.len(), files.len());
    stream
}

fn options(frames: &str, threads: usize) -> DecodeOptions {
    DecodeOptions { threads, frames: frames.parse().unwrap(), ..DecodeOptions::default() }
}

fn decode_all(stream: &[u8]) -> Result<Vec<(String, Vec<u8>)>> {
    let mut files = Vec::new();
    decode(stream, &options("..", 2), Ok, |frame| {
        let bytes = frame.to_bytes()?;
        files.push((frame.header.name, bytes));
        Ok(())
    })?;
    Ok(files)
}

#[test]
fn files_come_back_in_order() {
    let files = sample_files();
    for gop in [1, 2, 3, 100] {
        assert_eq!(decode_all(&encode_files(&files, gop, 2)).unwrap(), files, "gop {gop}");
    }
    assert_eq!(decode_all(&encode_files(&[], 3, 2)).unwrap(), []);
}

#[test]
fn the_stream_does_not_depend_on_threads() {
    let files = sample_files();
    let one = encode_files(&files, 2, 1);
    for threads in [0, 2, 5] {
        assert_eq!(encode_files(&files, 2, threads), one, "{threads} threads");
    }
}

#[test]
fn groups_are_as_long_as_asked() {
    let stream = encode_files(&sample_files(), 3, 2);
    let mut reader = StreamReader::open(&stream[..], Limits::default()).unwrap();
    let mut lengths = Vec::new();
    while let Some(record) = reader.next_record().unwrap() {
        if let Record::Group(group) = record {
            lengths.push(group.frames.len());
        }
    }
    assert_eq!(lengths, [3, 3, 1]);
}

#[test]
fn a_range_gives_the_same_frames_from_a_pipe_and_through_the_index() {
    let files = sample_files();
    let stream = encode_files(&files, 3, 2);
    for (range, expected) in [("4", 4..5), ("2..4", 2..4), ("5..", 5..7), ("..=0", 0..1), ("..", 0..7)] {
        let expected: Vec<_> = expected.map(|number| (number as u64, files[number].clone())).collect();
        let (mut piped, mut indexed) = (Vec::new(), Vec::new());
        let keep = |list: &mut Vec<_>, frame: DecodedFrame| {
            let bytes = frame.to_bytes()?;
            list.push((frame.number, (frame.header.name, bytes)));
            Ok(())
        };
        decode(&stream[..], &options(range, 2), Ok, |frame| keep(&mut piped, frame)).unwrap();
        let input = Cursor::new(&stream);
        decode_indexed(input, &options(range, 2), Ok, |frame| keep(&mut indexed, frame)).unwrap();
        assert_eq!(piped, expected, "{range} from a pipe");
        assert_eq!(indexed, expected, "{range} through the index");
    }
    for range in ["7", "5..8", "9.."] {
        assert!(
            decode(&stream[..], &options(range, 2), DecodedFrame::checked, |_| Ok(())).is_err(),
            "{range}"
        );
        assert!(
            decode_indexed(Cursor::new(&stream), &options(range, 2), DecodedFrame::checked, |_| Ok(()))
                .is_err(),
            "{range}"
        );
    }
}

#[test]
fn only_the_groups_asked_for_are_read() {
    let files = sample_files();
    let mut stream = encode_files(&files, 1, 1);
    let index = {
        let mut reader = StreamReader::open(&stream[..], Limits::default()).unwrap();
        while reader.next_record().unwrap().is_some() {}
        reader.index().clone()
    };
    let damaged = &index.groups[2];
    stream[(damaged.offset + damaged.length / 2) as usize] ^= 1;
    let read = |range: &str| {
        decode_indexed(Cursor::new(&stream), &options(range, 1), DecodedFrame::checked, |_| Ok(()))
    };
    assert!(read("3..").is_ok());
    assert!(read("2..").is_err());
    assert!(decode_all(&stream).is_err());
}

#[test]
fn every_flipped_bit_and_every_cut_is_an_error() {
    let stream = encode_files(&sample_files()[..4], 2, 1);
    for bit in 0..stream.len() * 8 {
        let mut damaged = stream.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(
            decode(&damaged[..], &options("..", 1), DecodedFrame::checked, |_| Ok(())).is_err(),
            "bit {bit}"
        );
    }
    for length in 0..stream.len() {
        assert!(
            decode(&stream[..length], &options("..", 1), DecodedFrame::checked, |_| Ok(())).is_err(),
            "length {length}"
        );
    }
}

#[test]
fn a_frame_that_decodes_to_something_else_is_an_error() {
    let stream = encode_files(&sample_files()[..1], 1, 1);
    let mut reader = StreamReader::open(&stream[..], Limits::default()).unwrap();
    let Some(Record::Group(group)) = reader.next_record().unwrap() else { panic!("no group") };
    let recoded = |change: &dyn Fn(&mut crate::container::FrameHeader)| {
        let mut group = group.clone();
        change(&mut group.frames[0].header);
        let mut writer = StreamWriter::create(Vec::new()).unwrap();
        writer.write_group(&group).unwrap();
        decode_all(&writer.finish().unwrap().0)
    };
    assert!(recoded(&|_| ()).is_ok());
    assert!(recoded(&|header| header.file_crc ^= 1).unwrap_err().to_string().contains("checksum"));
    assert!(recoded(&|header| header.file_size -= 1).unwrap_err().to_string().contains("bytes"));
    assert!(recoded(&|header| header.point_count += 1).unwrap_err().to_string().contains("points"));
}

#[test]
fn names_that_no_decoder_would_write_are_refused() {
    for name in ["", "..", "a/../b.bin", "a\\b.bin"] {
        let files = [(name.to_owned(), vec![1, 2, 3])];
        let result = encode(&inputs(&files), &EncoderConfig::default(), Vec::new(), &|| ());
        assert!(matches!(result, Err(Error::Input { .. })), "{name:?}");
    }
}

/// The frames of a scanner that stands still, as messages on one track of a recording.
fn messages(track: u8, config: SynthConfig) -> Vec<FrameInput> {
    let still = SynthConfig { frames: 4, speed: 0.0, yaw_rate: 0.0, noise: 0.004, ..config };
    let message = |(number, frame): (i64, crate::study::synth::SynthFrame)| {
        let nanoseconds = -100_000_000 * number - i64::from(track);
        let time = Some(Time { source: TimeSource::Recording, nanoseconds });
        let name = format!("{track}-{number}.bin");
        FrameInput::memory(name, frame.to_bin()).stamped(Stamp { kind: FrameKind::Message, track, time })
    };
    (0..).zip(drive(&still)).map(message).collect()
}

fn encoded(inputs: &[FrameInput]) -> Vec<u8> {
    let mut stream = Vec::new();
    encode(inputs, &EncoderConfig::default(), &mut stream, &|| ()).unwrap();
    stream
}

/// The records of a stream.
fn records(stream: &[u8]) -> (Vec<ScannerRecord>, Vec<Group>) {
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

/// The references to these scanners.
fn ids(scanners: &[ScannerRecord]) -> Vec<Option<ScannerId>> {
    scanners.iter().map(|scanner| Some(scanner.id())).collect()
}

fn written(scanners: &[ScannerRecord], groups: &[Group]) -> Vec<u8> {
    let mut writer = StreamWriter::create(Vec::new()).unwrap();
    for scanner in scanners {
        writer.write_scanner(scanner).unwrap();
    }
    groups.iter().for_each(|group| writer.write_group(group).unwrap());
    writer.finish().unwrap().0
}

/// Compares decoded frames with the encoded ones: bytes, name and stamp.
fn assert_decodes_to(stream: &[u8], inputs: &[FrameInput]) {
    let mut inputs = inputs.iter();
    decode(stream, &options("..", 2), Ok, |frame| {
        let input = inputs.next().unwrap();
        assert_eq!((&*frame.header.name, frame.header.stamp), (input.name()?, input.stamp()));
        assert!(frame.to_bytes()? == input.read()?, "{}", frame.header.name);
        Ok(())
    })
    .unwrap();
    assert_eq!(inputs.len(), 0, "frames are missing");
}

#[test]
fn two_scanners_that_take_turns_cost_what_they_cost_alone() {
    let one = messages(0, SynthConfig { beams: 8, seed: 1, ..SynthConfig::default() });
    let other = messages(1, SynthConfig { beams: 4, seed: 2, ..SynthConfig::default() });
    let turns: Vec<_> = one.iter().zip(&other).flat_map(|(a, b)| [a.clone(), b.clone()]).collect();
    let both = encoded(&turns);
    assert_decodes_to(&both, &turns);
    let other_alone: Vec<_> =
        other.iter().map(|input| input.clone().stamped(Stamp { track: 0, ..input.stamp() })).collect();
    let alone = [encoded(&one), encoded(&other_alone)];
    let [first, second] = [records(&alone[0]), records(&alone[1])];

    // The same scanners, and exactly the sections that each track has when encoded alone: P frames refer to
    // their own track.
    let (scanners, groups) = records(&both);
    assert_eq!(scanners, [first.0, second.0].concat());
    assert_eq!(groups.len(), 1);
    assert_eq!(groups[0].scanners, ids(&scanners));
    let sections = |groups: &[Group], track: u8| -> Vec<_> {
        let frames = groups.iter().flat_map(|group| &group.frames);
        let frames = frames.filter(|frame| frame.header.stamp.track == track);
        frames.map(|frame| frame.sections.clone()).collect()
    };
    assert!(sections(&groups, 0) == sections(&first.1, 0) && sections(&groups, 1) == sections(&second.1, 0));
    let prediction = |frame| FrameParameters::of(frame).unwrap().prediction;
    let predictions: Vec<_> = groups[0].frames.iter().map(prediction).collect();
    assert_eq!(predictions[..2], [Prediction::None; 2]);
    assert_eq!(predictions[2..], [Prediction::Inter; 6]);
    assert!(both.len() < alone[0].len() + alone[1].len());
}

#[test]
fn tracks_that_take_turns_are_cut_inside_a_group() {
    let one = messages(0, SynthConfig { beams: 8, seed: 1, ..SynthConfig::default() });
    let other = messages(1, SynthConfig { beams: 4, seed: 2, ..SynthConfig::default() });
    let turns: Vec<_> = one.iter().zip(&other).flat_map(|(a, b)| [a.clone(), b.clone()]).collect();
    let stream = encoded(&turns);
    for start in [1, 4, 7] {
        let range = FrameRange { start, end: None };
        let mut part = Vec::new();
        let input = Named { path: "in.lpc".into(), stream: &stream[..] };
        cut(input, range, &Limits::default(), &mut part).unwrap();
        assert_decodes_to(&part, &turns[start as usize..]);
    }
}

#[test]
fn tracks_that_begin_late_in_a_live_sequence_have_no_scanner() {
    let one = messages(0, SynthConfig { beams: 8, seed: 1, ..SynthConfig::default() });
    let late = messages(2, SynthConfig { beams: 8, seed: 2, ..SynthConfig::default() });
    let inputs = [&one[..], &late[..2]].concat();
    let (mut stream, config) = (Vec::new(), EncoderConfig { gop: 4, ..EncoderConfig::default() });
    encode_live(inputs.iter().cloned().map(Ok), &config, &mut stream, &|| ()).unwrap();
    assert_decodes_to(&stream, &inputs);
    let (scanners, groups) = records(&stream);
    let first = scanners[0].id();
    let used = groups.iter().map(|group| &group.scanners[..]).collect::<Vec<_>>();
    assert_eq!(used, [&[Some(first)][..], &[Some(first), None, None]]);

    let last = Stamp { track: 255, ..Stamp::default() };
    let result = encode(&[one[0].clone().stamped(last)], &config, Vec::new(), &|| ());
    assert!(result.is_err(), "no group has 256 tracks");
}

#[test]
fn a_scanner_of_an_unknown_family_only_matters_to_its_groups() {
    let inputs = messages(0, SynthConfig { beams: 8, seed: 1, ..SynthConfig::default() });
    let (mut scanners, mut groups) = records(&encoded(&inputs));
    scanners.insert(0, ScannerRecord { family: 99, payload: vec![1, 2, 3] });
    let stream = written(&scanners, &groups);
    assert_decodes_to(&stream, &inputs);

    groups.push(Group { scanners: ids(&scanners[..1]), ..groups[0].clone() });
    groups[1].frames.iter_mut().for_each(|frame| frame.header.name.insert(0, 'x'));
    let stream = written(&scanners, &groups);
    let error = decode_all(&stream).unwrap_err();
    assert!(error.to_string().contains("unknown family 99"), "{error}");
    assert!(matches!(error, Error::Unsupported { .. }), "{error}");
    let read = |range| decode_indexed(Cursor::new(&stream), &options(range, 1), Ok, |_| Ok(()));
    assert!(read("..4").is_ok() && read("4..").is_err());

    // Groups can still be copied.
    let input = StreamReader::open(&stream[..], Limits::default());
    let mut copy = Vec::new();
    cat([input.map(|stream| Named { path: "in.lpc".into(), stream })], &mut copy).unwrap();
    let copied = records(&copy);
    assert_eq!(copied.0, [scanners[1].clone(), scanners[0].clone()]);
    assert!(copied.1 == groups);
}

#[test]
fn sections_that_may_be_skipped_are_and_parameters_come_first() {
    let inputs = messages(0, SynthConfig { beams: 8, seed: 1, ..SynthConfig::default() });
    let (scanners, groups) = records(&encoded(&inputs));
    let sections = groups[0].frames[1].sections.len();
    let unknown = Section { kind: SectionKind::Skippable(0x93), payload: b"unknown".to_vec() };
    for place in 0..=sections {
        let mut changed = groups.clone();
        changed[0].frames[1].sections.insert(place, unknown.clone());
        let stream = written(&scanners, &changed);
        assert_decodes_to(&stream, &inputs);
        assert!(records(&stream).1 == changed, "it is not there any more");
        let mut part = Vec::new();
        let input = Named { path: "in.lpc".into(), stream: &stream[..] };
        cut(input, FrameRange { start: 1, end: None }, &Limits::default(), &mut part).unwrap();
        assert_decodes_to(&part, &inputs[1..]);
        assert_eq!(records(&part).1[0].frames[0].sections.last(), Some(&unknown));
    }

    let first = &groups[0].frames[0];
    assert_eq!(first.sections[0].kind, SectionKind::Parameters);
    for sections in [first.sections[1..].to_vec(), [&first.sections[1..], &first.sections[..1]].concat()] {
        let mut changed = groups.clone();
        changed[0].frames[0].sections = sections;
        assert!(FrameParameters::of(&changed[0].frames[0]).is_err());
        let error = decode_all(&written(&scanners, &changed)).unwrap_err().to_string();
        assert!(error.contains("parameters: the section is missing"), "{error}");
    }
}
