//! Whole sequences: what comes back, from any number of threads, and that no damage goes unseen.

use std::io::Cursor;

use super::*;
use crate::frame::*;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::container::{Record, StreamReader};

/// Seven files: scans, an empty one, an odd one, and one that is no scan.
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
    let input =
        |(name, bytes): &(String, Vec<u8>)| FrameInput::Memory { name: name.clone(), bytes: bytes.clone() };
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
    let recoded = |change: &dyn Fn(&mut crate::stream::container::FrameHeader)| {
        let mut group = group.clone();
        change(&mut group.frames[0].header);
        let mut writer = crate::stream::container::StreamWriter::create(Vec::new(), reader.header()).unwrap();
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
    for name in ["", "..", "a/b.bin", "a\\b.bin"] {
        let files = [(name.to_owned(), vec![1, 2, 3])];
        let result = encode(&inputs(&files), &EncoderConfig::default(), Vec::new(), &|| ());
        assert!(matches!(result, Err(Error::Input { .. })), "{name:?}");
    }
}
