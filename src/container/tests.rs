//! Tests of whole streams: what is written is read back, and all damage is detected.

use std::io::Cursor;

use super::index::End;
use super::record::write_record;
use super::*;
use crate::ground::error::{Error, Limits, Result};

/// A stamp for a frame: the kind of input and the time vary with `number`.
fn stamp(number: u8) -> Stamp {
    let time = |source| Some(Time { source, nanoseconds: -1_000_000_007 * i64::from(number) });
    match number {
        0 => Stamp::default(),
        1 => Stamp { kind: FrameKind::Message, track: 2, time: time(TimeSource::Recording) },
        _ => Stamp { kind: FrameKind::Points, track: 0, time: time(TimeSource::List) },
    }
}

fn frame(number: u8, sections: usize) -> CodedFrame {
    let header = FrameHeader {
        name: format!("{number:010}.bin"),
        stamp: stamp(number),
        file_size: 1000 + u64::from(number),
        file_crc: 0x1234_5678,
        point_count: 62,
    };
    let kinds = SectionKind::ALL.into_iter().take(sections);
    CodedFrame { header, sections: kinds.map(|kind| Section { kind, payload: vec![number; 5] }).collect() }
}

/// Two scanners, three groups of two, one and no frames.
fn sample_groups() -> [Group; 3] {
    let [first, second] = [1, 2].map(|number| Some(scanner(number).id()));
    [
        Group { scanners: vec![first, None, first], frames: vec![frame(0, 3), frame(1, 0)] },
        Group { scanners: vec![second], frames: vec![frame(2, 9)] },
        Group { scanners: vec![None], frames: vec![] },
    ]
}

/// A scanner of one of two families, one of which has an empty payload.
fn scanner(number: u64) -> ScannerRecord {
    ScannerRecord { family: number * 100, payload: [&b""[..], b"first"][number as usize % 2].to_vec() }
}

fn sample_stream() -> Vec<u8> {
    let mut writer = StreamWriter::create(Vec::new()).unwrap();
    let groups = sample_groups();
    assert_eq!(writer.write_scanner(&scanner(1)).unwrap(), scanner(1).id());
    writer.write_group(&groups[0]).unwrap();
    writer.write_scanner(&scanner(2)).unwrap();
    writer.write_scanner(&scanner(1)).unwrap();
    writer.write_group(&groups[1]).unwrap();
    writer.write_group(&groups[2]).unwrap();
    let (bytes, length) = writer.finish().unwrap();
    assert_eq!(bytes.len() as u64, length);
    bytes
}

fn read_all(bytes: &[u8]) -> Result<(Vec<Record>, Index)> {
    let mut reader = StreamReader::open(bytes, Limits::default())?;
    let mut records = Vec::new();
    while let Some(record) = reader.next_record()? {
        records.push(record);
    }
    assert_eq!(reader.position(), bytes.len() as u64);
    Ok((records, reader.index().clone()))
}

#[test]
fn a_stream_comes_back_front_to_back() {
    let (records, index) = read_all(&sample_stream()).unwrap();
    let [a, b, c] = sample_groups().map(Record::Group);
    let [first, second] = [1, 2].map(|number| Record::Scanner(scanner(number)));
    assert_eq!(records, [first, a, second, b, c]);
    let stamps = index.groups.iter().flat_map(|group| &group.frames).map(|frame| frame.stamp);
    assert_eq!(stamps.collect::<Vec<_>>(), [0, 1, 2].map(stamp));
    assert_eq!(index.groups.iter().map(|group| group.first_frame).collect::<Vec<_>>(), [0, 2, 3]);
    assert_eq!(index.frame_count(), 3);
}

#[test]
fn a_stream_comes_back_through_its_index() {
    let bytes = sample_stream();
    let mut reader = IndexedReader::open(Cursor::new(&bytes), Limits::default()).unwrap();
    assert_eq!(*reader.index(), read_all(&bytes).unwrap().1);
    for (place, group) in sample_groups().iter().enumerate().rev() {
        assert_eq!(reader.read_group(place).unwrap(), *group);
    }
    for (place, number) in [1, 2].into_iter().enumerate() {
        let id = scanner(number).id();
        assert_eq!(reader.read_scanner(id).unwrap(), scanner(number));
        let entry = reader.index().scanner(id).unwrap();
        assert_eq!((entry.id, entry.offsets.len()), (id, 2), "not at the end as well");
        assert_eq!(*entry, reader.index().scanners()[place]);
    }
    assert!(reader.read_scanner(scanner(3).id()).is_err());
    assert!(reader.read_group(3).is_err());
}

#[test]
fn every_flipped_bit_is_an_error() {
    let bytes = sample_stream();
    for bit in 0..bytes.len() * 8 {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(read_all(&damaged).is_err(), "bit {bit} of byte {} went unseen", bit / 8);
    }
}

#[test]
fn every_cut_is_an_error() {
    let bytes = sample_stream();
    for length in 0..bytes.len() {
        assert!(read_all(&bytes[..length]).is_err(), "{length} of {} bytes pass", bytes.len());
        assert!(IndexedReader::open(Cursor::new(&bytes[..length]), Limits::default()).is_err());
    }
}

#[test]
fn bytes_after_the_end_are_an_error() {
    let bytes = [&sample_stream()[..], &[0]].concat();
    assert!(read_all(&bytes).unwrap_err().to_string().contains("bytes after it"));
}

#[test]
fn damage_is_named_down_to_the_section() {
    let mut bytes = sample_stream();
    let second = bytes.windows(5).rposition(|window| window == [2; 5]).unwrap();
    bytes[second] ^= 1;
    let error = read_all(&bytes).unwrap_err().to_string();
    for part in ["group 1", "frame 0", "0000000002.bin", "section 9 (channels)"] {
        assert!(error.contains(part), "{part:?} is missing in: {error}");
    }
}

#[test]
fn an_unknown_record_is_named_or_skipped() {
    let bytes = sample_stream();
    let with_record = |kind| {
        let mut stream = bytes[..header::HEADER_LENGTH].to_vec();
        write_record(&mut stream, kind, b"new").unwrap();
        stream
    };
    let error = read_all(&with_record(9)).unwrap_err();
    assert!(matches!(error, Error::Unsupported { .. }), "{error}");
    assert!(error.to_string().contains("unknown kind 9"), "{error}");

    let mut reader = StreamReader::open(Cursor::new(with_record(0x89)), Limits::default()).unwrap();
    let error = reader.next_record().unwrap_err().to_string();
    let after = header::HEADER_LENGTH + 2 + 3 + 4;
    assert!(error.contains(&format!("record at byte {after}: the stream is cut short")), "{error}");
}

#[test]
fn a_reference_to_a_missing_scanner_is_an_error() {
    let mut writer = StreamWriter::create(Vec::new()).unwrap();
    writer.write_group(&sample_groups()[0]).unwrap();
    let (bytes, _) = writer.finish().unwrap();
    assert!(read_all(&bytes).unwrap_err().to_string().contains("is missing"));
    let mut reader = IndexedReader::open(Cursor::new(&bytes), Limits::default()).unwrap();
    assert!(reader.read_group(0).is_err());
}

#[test]
fn limits_hold() {
    let bytes = sample_stream();
    let low = [
        Limits { record_bytes: 20, ..Limits::default() },
        Limits { file_bytes: 1000, ..Limits::default() },
        Limits { file_bytes: 1999, ..Limits::default() },
        Limits { points: 61, ..Limits::default() },
    ];
    for limits in low {
        let mut reader = StreamReader::open(&bytes[..], limits).unwrap();
        let error = loop {
            match reader.next_record() {
                Ok(record) => assert!(record.is_some(), "{limits:?} were not kept"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error, Error::LimitExceeded { .. }), "{error}");
    }
}

/// Forged payloads with correct checksums: each is an error, or the encoding of exactly one value.
#[test]
fn every_payload_is_an_error_or_is_written_the_same() {
    fn check<T>(payload: &[u8], read: impl Fn(&[u8]) -> Result<T>, write: impl Fn(&T, &mut Vec<u8>)) {
        for place in 0..payload.len() {
            for value in [0, 1, 2, 0x7f, 0x80, 0x81, 0xff] {
                let mut forged = payload.to_vec();
                forged[place] = value;
                for length in [place + 1, forged.len()] {
                    if let Ok(meaning) = read(&forged[..length]) {
                        let mut written = Vec::new();
                        write(&meaning, &mut written);
                        assert_eq!(written, forged[..length]);
                    }
                }
            }
        }
    }
    for group in sample_groups() {
        let mut payload = Vec::new();
        group.write_to(&mut payload);
        let read = |bytes: &[u8]| Ok(Group::read_from(bytes, &Limits::default())?.0);
        check(&payload, read, |group, out| drop(group.write_to(out)));
    }
    let (_, index) = read_all(&sample_stream()).unwrap();
    let mut payload = Vec::new();
    index.write_to(&mut payload);
    check(&payload, Index::read_from, Index::write_to);
    check(&end_at(5), End::from_payload, |end, out| out.extend(end.to_payload()));
}

/// `groups` groups of one frame, whose only section has `length` bytes, all with a scanner of 100 bytes.
fn long_stream(groups: u8, length: usize) -> (Vec<u8>, Index) {
    let scanner = ScannerRecord { family: 1, payload: vec![7; 100] };
    let mut writer = StreamWriter::create(Vec::new()).unwrap();
    let id = writer.write_scanner(&scanner).unwrap();
    for number in 0..groups {
        let mut frame = frame(number, 0);
        frame.header.stamp = Stamp::default();
        let noise = (0..length as u32)
            .map(|place| ((place + u32::from(number)).wrapping_mul(2_654_435_761) >> 24) as u8);
        frame.sections = vec![Section { kind: SectionKind::Range, payload: noise.collect() }];
        writer.write_group(&Group { scanners: vec![Some(id)], frames: vec![frame] }).unwrap();
    }
    let (stream, _) = writer.finish().unwrap();
    let index = read_all(&stream).unwrap().1;
    (stream, index)
}

/// The numbers of the first frames of the groups that are salvaged from a damaged stream along with their
/// scanners.
fn saved(stream: &[u8]) -> Vec<u64> {
    let mut reader = SalvageReader::open(Cursor::new(stream), Limits::default()).unwrap();
    let mut saved = Vec::new();
    while let Some(part) = reader.next_part().unwrap() {
        if let Salvaged::Group { first_frame, group, .. } = part
            && group.scanners.iter().flatten().all(|id| reader.scanner(*id).is_some())
        {
            saved.push(first_frame);
        }
    }
    saved
}

#[test]
fn any_copy_of_a_scanner_serves_a_reader_that_seeks() {
    let mut bytes = sample_stream();
    let id = scanner(1).id();
    let offsets = read_all(&bytes).unwrap().1.scanner(id).unwrap().offsets.clone();
    for offset in offsets.into_iter().rev() {
        let mut reader = IndexedReader::open(Cursor::new(&bytes), Limits::default()).unwrap();
        assert_eq!(reader.read_scanner(id).unwrap(), scanner(1));
        bytes[offset as usize + 3] ^= 1;
    }
    let mut reader = IndexedReader::open(Cursor::new(&bytes), Limits::default()).unwrap();
    assert!(reader.read_scanner(id).unwrap_err().to_string().contains("checksum does not match"));
}

#[test]
fn a_stream_of_one_group_holds_its_scanner_once() {
    let (_, index) = long_stream(1, 1000);
    assert_eq!(index.scanners()[0].offsets.len(), 1);
    let (_, index) = long_stream(2, 1000);
    assert_eq!(index.scanners()[0].offsets.len(), 2);
}

#[test]
fn scanners_are_repeated_now_and_then_and_take_little() {
    let (stream, index) = long_stream(100, 100_000);
    let [entry] = index.scanners() else { panic!("{} scanners", index.scanners().len()) };
    assert!(entry.offsets.windows(2).all(|pair| pair[1] - pair[0] < 600_000), "{:?}", entry.offsets);
    assert!(entry.offsets.len() * 110 < stream.len() / 3000, "{:?}", entry.offsets);
}

#[test]
fn a_lost_megabyte_costs_the_groups_that_were_in_it() {
    let (stream, index) = long_stream(40, 100_000);
    for start in (0..stream.len()).step_by(97_003) {
        let lost = start..stream.len().min(start + (1 << 20));
        let mut zeroed = stream.clone();
        zeroed[lost.clone()].fill(0);
        let expected = |is_numbered: bool| -> Vec<u64> {
            let hit = |group: &&GroupEntry| {
                let range = group.offset as usize..(group.offset + group.length) as usize;
                range.end <= lost.start || lost.end <= range.start
            };
            let left = index.groups.iter().filter(hit).map(|group| group.first_frame);
            if is_numbered { left.collect() } else { (0..).zip(left).map(|(number, _)| number).collect() }
        };
        assert_eq!(saved(&zeroed), expected(true), "{lost:?} is zero");
        let cut = [&stream[..lost.start], &stream[lost.end..]].concat();
        assert_eq!(saved(&cut), expected(true), "{lost:?} is missing");
    }
}

/// The payload of an end record.
fn end_at(index_offset: u64) -> Vec<u8> {
    End { index_offset, header: StreamHeader::default() }.to_payload()
}

#[test]
fn an_index_that_points_beyond_the_end_is_an_error() {
    let mut stream = sample_stream();
    stream.truncate(stream.len() - End::RECORD_LENGTH as usize);
    for offset in [stream.len() as u64 + End::RECORD_LENGTH, u64::MAX] {
        let mut forged = stream.clone();
        write_record(&mut forged, record::END, &end_at(offset)).unwrap();
        let error = IndexedReader::open(Cursor::new(&forged), Limits::default()).err().unwrap();
        assert!(error.to_string().contains("beyond the end"), "{error}");
        assert!(read_all(&forged).is_err());
    }
}

/// Streams with correct checksums whose records contradict each other.
#[test]
fn records_that_contradict_each_other_are_an_error() {
    let whole = sample_stream();
    let (_, index) = read_all(&whole).unwrap();
    let mut index_payload = Vec::new();
    index.write_to(&mut index_payload);
    let end_offset = whole.len() - End::RECORD_LENGTH as usize;
    let index_offset = end_offset - index_payload.len() - 6;
    assert_eq!(whole[index_offset], record::INDEX);
    let with = |tail: &[(u8, &[u8])]| {
        let mut stream = whole[..index_offset].to_vec();
        for (kind, payload) in tail {
            write_record(&mut stream, *kind, payload).unwrap();
        }
        read_all(&stream).map_err(|error| error.to_string())
    };
    let end = end_at(index_offset as u64);
    let the_index = (record::INDEX, &index_payload[..]);
    let the_end = (record::END, &end[..]);
    assert!(with(&[the_index, the_end]).is_ok());
    assert!(with(&[the_index, (0x89, b"new"), the_end]).is_ok(), "what may be skipped is not");

    let mut other = index.clone();
    other.groups[1].frames[0].size += 1;
    let mut other_payload = Vec::new();
    other.write_to(&mut other_payload);
    let other_header = StreamHeader { version: 2, flags: 0 };
    let other_header = End { index_offset: index_offset as u64, header: other_header };
    for (tail, complaint) in [
        (&[(record::INDEX, &other_payload[..]), the_end][..], "agree"),
        (&[the_end], "point at the index"),
        (&[the_index, (record::SCANNER, b"late"), the_end], "after the index"),
        (&[the_index, the_index, the_end], "after the index"),
        (&[the_index, (record::END, &end_at(12))], "point at the index"),
        (&[the_index, (record::END, &other_header.to_payload())], "agree with the stream header"),
        (&[the_index, (record::END, b"short")], "as long as it should be"),
    ] {
        let error = with(tail).unwrap_err();
        assert!(error.contains(complaint), "{complaint:?} is missing in: {error}");
    }
}
