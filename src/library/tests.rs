//! Tests of the public interface alone, and that its streams are those of the command line.

use std::fs;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::mem::take;
use std::sync::{Arc, Mutex};

use super::*;
use crate::container::FrameKind;
use crate::frame::EncoderConfig;
use crate::ground::error::{Error, Limits, Result};
use crate::scan::ScalarType;
use crate::stream::{FrameInput, encode_live};

/// Three scans of a simulated drive: file names and points.
fn drive() -> Vec<(String, Vec<u8>)> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/drive");
    let name = |number| format!("{number:010}.bin");
    (0..3).map(|number| (name(number), fs::read(format!("{folder}/{}", name(number))).unwrap())).collect()
}

fn xyzi(bytes: &[u8]) -> Vec<[f32; 4]> {
    let value = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
    bytes
        .as_chunks::<16>()
        .0
        .iter()
        .map(|point| {
            let (values, _) = point.as_chunks::<4>();
            std::array::from_fn(|field| value(&values[field]))
        })
        .collect()
}

fn encoded(scans: impl IntoIterator<Item = Scan>, settings: Settings) -> Vec<u8> {
    let mut stream = Vec::new();
    let mut encoder = Encoder::new(&mut stream, settings).unwrap();
    scans.into_iter().for_each(|scan| encoder.push(scan).unwrap());
    let summary = encoder.finish().unwrap();
    assert_eq!(summary.stream_bytes, stream.len() as u64);
    stream
}

fn decoded(stream: &[u8]) -> Vec<Scan> {
    Decoder::open(Cursor::new(stream)).unwrap().scans(..).collect::<Result<_>>().unwrap()
}

/// Two scans, as messages and as a group, each way.
fn two_threads_agree_with_one(level: u8) {
    let files: Vec<_> = drive().into_iter().take(2).collect();
    let scans = || files.iter().map(|(name, bytes)| Scan::from_file(name, bytes.clone()));
    let [one, two] = [1, 2].map(|threads| {
        let mut encoder =
            MessageEncoder::new(Settings::exact().with_level(level).with_threads(threads)).unwrap();
        scans().map(|scan| encoder.encode(scan).unwrap()).collect::<Vec<_>>()
    });
    assert!(one == two, "level {level}");
    let stream = encoded(scans(), Settings::exact().with_level(level).with_group_of_pictures(2));
    for threads in [1, 2] {
        let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap().with_threads(threads);
        let last = decoder.scan(1).unwrap();
        assert!(last.file_bytes().unwrap().unwrap() == files[1].1, "level {level}, {threads} threads");
    }
}

#[test]
fn two_threads_code_a_scan_as_one_does() {
    [1, 3, 6, 8].into_iter().for_each(two_threads_agree_with_one);
}

// By itself, because without optimisation it takes as long as all other tests.
#[test]
fn two_threads_code_a_scan_as_one_does_at_level_9() {
    two_threads_agree_with_one(9);
}

/// Scans of a few points each.
fn small_scans(count: u16) -> Vec<Scan> {
    let scan = |number: u16| {
        let positions: Vec<[f32; 3]> = (0..number).map(|point| [f32::from(point), -0.0, f32::NAN]).collect();
        let rings: Vec<u16> = (0..number).collect();
        Scan::from_positions(&positions).with_channel("ring", &rings).unwrap().with_time(i64::from(number))
    };
    (0..count).map(scan).collect()
}

fn bits(scan: &Scan) -> Vec<[u32; 3]> {
    scan.positions().iter().map(|position| position.map(f32::to_bits)).collect()
}

#[test]
fn a_scan_has_as_many_channels_as_a_record_has_fields() {
    let with_channels = |count: usize| {
        let scan = Scan::from_positions(&[[1.0, 2.0, 3.0]]);
        (0..count).try_fold(scan, |scan, number| scan.with_channel(&format!("c{number}"), &[number as u8]))
    };
    let mut encoder = Encoder::new(Vec::new(), Settings::exact()).unwrap();
    encoder.push(with_channels(253).unwrap()).unwrap();
    encoder.finish().unwrap();
    let refused = with_channels(254).unwrap_err().to_string();
    assert!(refused.contains("at most 253 channels"), "{refused}");
}

#[test]
fn a_refused_scan_does_not_harm_the_encoder() {
    let scan = || Scan::from_positions(&[[1.0, 2.0, 3.0]]);
    let mut stream = Vec::new();
    let mut encoder = Encoder::new(&mut stream, Settings::exact().with_group_of_pictures(2)).unwrap();
    encoder.push(scan()).unwrap();
    for (wrong, part) in [
        (scan().with_name("aux"), "aux"),
        (scan().with_name("a\nb"), "a control character"),
        (scan().with_name("../a"), "../a"),
        (scan().with_track(255), "256 tracks"),
        (Scan::from_file("", Vec::new()), "name"),
    ] {
        let refused = encoder.push(wrong).unwrap_err().to_string();
        assert!(refused.contains(part) && !refused.contains('\n'), "{part}: {refused}");
    }
    let large = Scan::from_positions(&vec![[0.0; 3]; Limits::default().points as usize + 1]);
    let refused = encoder.push(large).unwrap_err().to_string();
    assert!(refused.contains("16777217 points"), "{refused}");
    (0..2).for_each(|_| encoder.push(scan()).unwrap());
    encoder.finish().unwrap();
    assert_eq!(decoded(&stream).len(), 3);
}

#[test]
fn everything_may_be_sent_to_another_thread() {
    fn assert_send<T: Send>() {}
    assert_send::<Encoder<Vec<u8>>>();
    assert_send::<Decoder<fs::File>>();
    assert_send::<Scans<'static>>();
    assert_send::<Scan>();
    assert_send::<Error>();
}

#[test]
fn empty_and_partial_scans_before_others_do_not_hide_the_scanner() {
    const EMPTY: usize = 7;
    let scans = || drive().into_iter().map(|(name, bytes)| Scan::from_file(&name, bytes));
    let empty = || std::iter::repeat_n(Scan::from_positions(&[]), EMPTY);
    let size_of_stream = |scans: &mut dyn Iterator<Item = Scan>| {
        let mut stream = Vec::new();
        let settings = Settings::exact().with_group_of_pictures(3);
        let mut encoder = Encoder::new(&mut stream, settings).unwrap();
        scans.for_each(|scan| encoder.push(scan).unwrap());
        assert_eq!(encoder.finish().unwrap().scans as usize, decoded(&stream).len());
        stream.len()
    };
    let (usual, after_empty) = (size_of_stream(&mut scans()), size_of_stream(&mut empty().chain(scans())));
    assert!(after_empty < usual + usual / 5, "{after_empty} bytes, {usual} without empty scans");

    // A few points of a scan show the scanner, but badly.
    let (name, bytes) = drive().swap_remove(0);
    let part = |of: usize| Scan::from_file(&name, bytes[..bytes.len() / 16 / of * 16].to_vec());
    let last_message = |before: &mut dyn Iterator<Item = Scan>| {
        let mut encoder = MessageEncoder::new(Settings::exact()).unwrap();
        let messages = before.chain(scans()).map(|scan| encoder.encode(scan).unwrap());
        messages.last().unwrap().len()
    };
    let usual = last_message(&mut std::iter::empty());
    let parts = [8, 2].map(|of| last_message(&mut std::iter::once(part(of))));
    for after in std::iter::once(last_message(&mut empty())).chain(parts) {
        assert!(after < usual + usual / 20, "{after} bytes, {usual} without others before");
    }
}

#[test]
fn files_make_the_same_stream_as_by_the_command_line() {
    let files = drive();
    for threads in [1, 3] {
        let config = EncoderConfig { gop: 2, threads, ..EncoderConfig::default() };
        let mut expected = Vec::new();
        let inputs = files.iter().map(|(name, bytes)| Ok(FrameInput::memory(name.clone(), bytes.clone())));
        encode_live(inputs, &config, &mut expected, &|| ()).unwrap();
        let scans = files.iter().map(|(name, bytes)| Scan::from_file(name, bytes.clone()));
        let stream = encoded(scans, Settings::exact().with_group_of_pictures(2).with_threads(threads));
        assert!(stream == expected, "{threads} threads");
        for (scan, (name, bytes)) in decoded(&stream).into_iter().zip(&files) {
            assert_eq!((scan.name(), scan.kind()), (&name[..], FrameKind::File));
            assert_eq!(scan.file_bytes().unwrap().as_ref(), Some(bytes));
            assert_eq!(
                scan.channels().map(|channel| channel.name.to_owned()).collect::<Vec<_>>(),
                ["intensity"]
            );
        }
    }
}

#[test]
fn points_in_memory_take_what_a_file_takes_but_for_its_name() {
    let files = drive();
    let as_files =
        encoded(files.iter().map(|(name, bytes)| Scan::from_file(name, bytes.clone())), Settings::exact());
    let scans = || files.iter().map(|(_, bytes)| Scan::from_xyzi(&xyzi(bytes)));
    let as_points = encoded(scans(), Settings::exact());
    let names: usize = files.iter().map(|(name, _)| name.len()).sum();
    assert_eq!(as_points.len(), as_files.len() - names);
    for (found, scan) in decoded(&as_points).iter().zip(scans()) {
        assert!(
            found.kind() == FrameKind::Points
                && found.file_bytes().unwrap().is_none()
                && found.name().is_empty()
        );
        assert_eq!(bits(found), bits(&scan));
        let intensities = |scan: &Scan| scan.channel::<f32>("intensity").unwrap().to_vec();
        assert_eq!(intensities(found), intensities(&scan));
    }
}

#[test]
fn channels_of_every_type_come_back() {
    let scan = Scan::from_positions(&[[1.0, 2.0, 3.0]; 2])
        .with_channel("i8", &[i8::MIN, 1])
        .unwrap()
        .with_channel("u8", &[u8::MAX, 1])
        .unwrap()
        .with_channel("i16", &[i16::MIN, 1])
        .unwrap()
        .with_channel("intensity", &[u16::MAX, 1])
        .unwrap()
        .with_channel("i32", &[i32::MIN, 1])
        .unwrap()
        .with_channel("u32", &[u32::MAX, 1])
        .unwrap()
        .with_channel("i64", &[i64::MIN, 1])
        .unwrap()
        .with_channel("u64", &[u64::MAX, 1])
        .unwrap()
        .with_channel("f32", &[f32::MIN, -0.0])
        .unwrap()
        .with_channel("f64", &[f64::NAN, 1e300])
        .unwrap()
        .with_name("000001")
        .with_time(-5)
        .with_track(3);
    let found = &decoded(&encoded([scan.clone()], Settings::exact()))[0];
    assert_eq!((found.name(), found.time(), found.track(), found.len()), ("000001", Some(-5), 3, 2));
    assert_eq!(found.channels().collect::<Vec<_>>(), scan.channels().collect::<Vec<_>>());
    assert_eq!(found.channel::<i8>("i8").unwrap(), [i8::MIN, 1]);
    assert_eq!(found.channel::<u16>("intensity").unwrap(), [u16::MAX, 1]);
    assert_eq!(found.channel::<u64>("u64").unwrap(), [u64::MAX, 1]);
    let doubles = found.channel::<f64>("f64").unwrap();
    assert!(doubles[0].to_bits() == f64::NAN.to_bits() && doubles[1] == 1e300);
}

#[test]
fn intensities_of_every_type_come_back() {
    fn check<T: Scalar + PartialEq + std::fmt::Debug>(values: &[T]) {
        let scan = Scan::from_positions(&[[1.0; 3]; 2])
            .with_channel("ring", &[1u8, 2])
            .unwrap()
            .with_channel("reflectivity", values)
            .unwrap()
            .with_channel("time", &[0.5f64, 1.0])
            .unwrap();
        let found = &decoded(&encoded([scan], Settings::exact()))[0];
        assert_eq!(found.channel::<T>("reflectivity").unwrap(), values);
        let names: Vec<_> = found.channels().map(|channel| channel.name).collect();
        assert_eq!(names, ["ring", "reflectivity", "time"]);
        assert_eq!(found.channels().nth(1).unwrap().scalar, T::TYPE);
    }
    check(&[1u8, 255]);
    check(&[1u16, 511]);
    check(&[1u16, 512]);
    check(&[0.25f32, -0.0]);
    check(&[0.25f64, 1e-300]);
    check(&[1u32, 2]);
}

#[test]
fn of_fields_with_one_name_the_first_is_a_channel() {
    let header =
        "VERSION 0.7\nFIELDS x y z a a\nSIZE 4 4 4 1 2\nTYPE F F F U U\nCOUNT 1 1 1 1 1\nWIDTH 1\nHEIGHT 1\n";
    let file = [header.as_bytes(), b"POINTS 1\nDATA binary\n", &[0; 12], &[7, 1, 2]].concat();
    let scan = Scan::from_file("1.pcd", file.clone());
    let names: Vec<_> = scan.channels().map(|channel| (channel.name, channel.scalar.name())).collect();
    assert_eq!(names, [("a", "u8")]);
    assert_eq!(scan.channel::<u8>("a").unwrap(), [7]);
    assert_eq!(scan.file_bytes().unwrap().unwrap(), file);
}

#[test]
fn files_whose_coordinates_are_no_float32_take_channels_too() {
    let header =
        "VERSION 0.7\nFIELDS x y z a\nSIZE 8 8 8 1\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n";
    let values = [1.0 / 3.0, 0.1, -0.7];
    let record = [values.map(f64::to_le_bytes).as_flattened(), &[5]].concat();
    let file = [header.as_bytes(), b"POINTS 2\nDATA binary\n", &record, &record].concat();
    let without =
        "VERSION 0.7\nFIELDS a\nSIZE 1\nTYPE U\nCOUNT 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary\nab";
    for (file, names) in [(file, &["x", "y", "z", "a", "ring"][..]), (without.into(), &["a", "ring"])] {
        let scan = Scan::from_file("1.pcd", file).with_channel("ring", &[7u16, 9]).unwrap();
        assert!(scan.positions().is_empty());
        let decoded = decoded(&encoded([scan.clone()], Settings::exact()));
        assert_eq!(decoded[0].channels().map(|channel| channel.name).collect::<Vec<_>>(), names);
        assert_eq!(decoded[0].channel::<u16>("ring").unwrap(), [7, 9]);
        assert_eq!(decoded[0].channel::<u8>("a").unwrap(), scan.channel::<u8>("a").unwrap());
        if names.len() > 2 {
            assert_eq!(decoded[0].channel::<f64>("y").unwrap(), [values[1]; 2]);
        }
    }
}

#[test]
fn channels_that_do_not_fit_are_refused() {
    let scan = || Scan::from_xyzi(&[[0.0; 4]; 3]);
    let refusals = [
        scan().with_channel("ring", &[1u8]),
        scan().with_channel("x", &[1u8; 3]),
        scan().with_channel("intensity", &[1u8; 3]),
        scan().with_channel("", &[1u8; 3]),
        scan().with_channel("a b", &[1u8; 3]),
        scan().with_channel(&"a".repeat(65), &[1u8; 3]),
    ];
    for refusal in refusals {
        assert!(matches!(refusal, Err(Error::Usage(_))), "{refusal:?}");
    }
    let error = scan().channel::<u8>("intensity").unwrap_err().to_string();
    assert_eq!(error, "channel \"intensity\" holds f32, not u8");
    assert_eq!(scan().channel::<u8>("time").unwrap_err().to_string(), "the scan has no channel \"time\"");
    assert_eq!(scan().channels().next().unwrap().scalar, ScalarType::F32);
}

#[test]
fn scans_come_by_number_and_in_order() {
    let stream = encoded(small_scans(25), Settings::exact().with_group_of_pictures(4).with_threads(2));
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    assert_eq!(decoder.len(), 25);
    let times: Vec<_> = decoder.frames().map(|frame| frame.time).collect();
    assert_eq!(times, (0..25).map(Some).collect::<Vec<_>>());
    let details = decoder.details(3..=5).unwrap();
    assert_eq!(
        details.iter().map(|frame| (frame.number, frame.points)).collect::<Vec<_>>(),
        [(3, 3), (4, 4), (5, 5)]
    );
    for number in [24, 0, 7, 8] {
        let scan = decoder.scan(number).unwrap();
        assert_eq!((scan.time(), scan.len() as u64), (Some(number as i64), number));
    }
    for threads in [0, 1, 3] {
        let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap().with_threads(threads);
        for range in [0..25, 3..4, 7..21, 5..5, 25..25] {
            let scans = decoder.scans(range.clone());
            assert_eq!(scans.size_hint(), (0, Some((range.end - range.start) as usize)));
            let times: Vec<_> = scans.map(|scan| scan.unwrap().time().unwrap() as u64).collect();
            assert_eq!(times, range.collect::<Vec<_>>(), "{threads} threads");
        }
        let piped = Scans::from_reader(&stream[..]).unwrap().with_threads(threads);
        let lengths: Vec<_> = piped.map(|scan| scan.unwrap().len()).collect();
        assert_eq!(lengths, (0..25).collect::<Vec<_>>());
    }
    assert!(matches!(decoder.scan(25), Err(Error::Usage(_))));
    let beyond: Vec<_> = decoder.scans(20..26).collect();
    assert!(matches!(&beyond[..], [Err(Error::Usage(_))]));
}

#[test]
fn limits_hold_however_a_stream_is_read() {
    let scans = drive().into_iter().map(|(name, bytes)| Scan::from_file(&name, bytes));
    let stream = encoded(scans, Settings::exact());
    let limits = Limits { points: 10, ..Limits::default() };
    let mut decoder = Decoder::open_with_limits(Cursor::new(&stream), limits).unwrap();
    assert!(matches!(decoder.scan(0), Err(Error::LimitExceeded { .. })));
    let mut piped = Scans::from_reader_with_limits(&stream[..], limits).unwrap();
    assert!(matches!(piped.next(), Some(Err(Error::LimitExceeded { .. }))));
}

#[test]
fn a_stream_without_scans_is_a_stream() {
    let stream = encoded([], Settings::exact());
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    assert!(decoder.is_empty() && decoder.scans(..).next().is_none());
    assert!(Scans::from_reader(&stream[..]).unwrap().with_threads(2).next().is_none());
    assert!(decoder.scanners().unwrap().is_empty());
}

#[test]
fn scanners_are_told_in_words() {
    let scans = drive().into_iter().map(|(name, bytes)| Scan::from_file(&name, bytes));
    let stream = encoded(scans, Settings::exact().with_level(1));
    let scanners = Decoder::open(Cursor::new(&stream)).unwrap().scanners().unwrap();
    assert_eq!(scanners.len(), 1);
    assert!(scanners[0].starts_with("like Velodyne's HDL-64E, 64 lasers"), "{scanners:?}");
}

#[test]
fn a_bound_holds() {
    let points = xyzi(&drive()[0].1);
    let stream = encoded([Scan::from_xyzi(&points)], Settings::bounded(0.01).with_level(1));
    let decoded = decoded(&stream);
    assert_eq!(decoded[0].len(), points.len());
    for (found, point) in decoded[0].positions().iter().zip(&points) {
        let squares: f64 =
            found.iter().zip(point).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
        assert!(squares.sqrt() <= 0.01);
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    for wrong in [
        Settings::exact().with_level(0),
        Settings::exact().with_level(10),
        Settings::exact().with_group_of_pictures(0),
        Settings::exact().with_intensity_step(0.5),
        Settings::bounded(0.01).with_intensity_step(f64::NAN),
        Settings::bounded(0.01).with_intensity_step(0.0),
        Settings::bounded(0.01).with_intensity_step(1000.1),
        Settings::bounded(0.01).with_intensity_step(1e9),
        Settings::bounded(f64::NAN),
        Settings::bounded(-1.0),
        Settings::bounded(10.1),
    ] {
        assert!(Encoder::new(Vec::new(), wrong.clone()).is_err(), "{wrong:?}");
    }
}

#[test]
fn damage_is_an_error_after_the_scans_before_it() {
    let mut stream = encoded(small_scans(12), Settings::exact().with_group_of_pictures(4));
    let middle = stream.len() / 2;
    stream[middle] ^= 1;
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    let scans: Vec<_> = decoder.scans(..).collect();
    let (last, before) = scans.split_last().unwrap();
    assert!(before.len() >= 4 && before.iter().all(Result::is_ok));
    assert!(matches!(last, Err(Error::Corrupt { .. })), "{last:?}");
}

#[cfg(not(feature = "article"))]
#[test]
fn without_the_article_all_streams_decode_but_those_of_image_coders() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/golden");
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut kinds = [0; 2];
    for path in paths.filter(|path| path.extension().is_some_and(|extension| extension == "lpc")) {
        let is_image = path.to_string_lossy().contains("jpeg");
        let scans =
            Decoder::open(fs::File::open(&path).unwrap()).unwrap().scans(..).collect::<Result<Vec<_>>>();
        match scans {
            Ok(_) => assert!(!is_image, "{path:?}"),
            Err(error) => assert!(is_image && matches!(error, Error::NotBuilt { .. }), "{path:?}: {error}"),
        }
        kinds[usize::from(is_image)] += 1;
    }
    assert!(kinds.iter().all(|count| *count > 0), "{kinds:?}");
}

#[test]
fn errors_say_where_they_are() {
    let mut stream = encoded(small_scans(12), Settings::exact().with_group_of_pictures(4));
    // The last byte of the last frame in the second group: part of the checksum of its last section.
    let decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    let last: u64 = decoder.frames().skip(8).map(|frame| frame.coded_bytes).sum();
    drop(decoder);
    let error = (0..stream.len() - last as usize).rev().find_map(|place| {
        stream[place] ^= 1;
        let error = Decoder::open(Cursor::new(&stream)).and_then(|mut decoder| decoder.scan(7)).err();
        stream[place] ^= 1;
        error.filter(|error| error.location().is_some_and(|place| place.section.is_some()))
    });
    let error = error.unwrap();
    assert_eq!(error.location().unwrap().frame, Some(7), "{error}");
    assert!(error.to_string().starts_with("damaged stream: group 1: frame 3 of the group: "), "{error}");
}

/// An output that accepts a limited number of bytes.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn an_encoder_that_failed_stays_failed() {
    let mut encoder =
        Encoder::new(Full(60), Settings::exact().with_group_of_pictures(1).with_threads(1)).unwrap();
    let failures = small_scans(20).into_iter().filter_map(|scan| encoder.push(scan).err());
    let failures: Vec<Error> = failures.collect();
    assert!(matches!(failures[0], Error::Io(_)) && failures.len() > 1);
    assert!(failures[1..].iter().all(|error| matches!(error, Error::Usage(_))));
    assert!(encoder.finish().is_err());
}

#[test]
fn messages_stand_by_themselves_and_share_what_was_found() {
    use crate::container::{Record, StreamReader};

    let scanner_of = |stream: &[u8]| {
        let mut reader = StreamReader::open(stream, Limits::default()).unwrap();
        let mut scanners = Vec::new();
        while let Some(record) = reader.next_record().unwrap() {
            if let Record::Scanner(scanner) = record {
                scanners.push(scanner.id());
            }
        }
        scanners
    };
    let mut encoder = MessageEncoder::new(Settings::exact()).unwrap();
    let noise: Vec<_> = (0..40).map(|n| [n as f32, -1.5, 0.25]).collect();
    let without = encoder.encode(Scan::from_positions(&noise)).unwrap();
    assert_eq!(scanner_of(&without), [], "nothing was found");
    let mut first = None;
    for (number, (name, bytes)) in (0..).zip(drive()) {
        let stream = encoder.encode(Scan::from_file(&name, bytes.clone()).with_time(number)).unwrap();
        let scans = decoded(&stream);
        assert_eq!((scans.len(), scans[0].time(), scans[0].name()), (1, Some(number), &name[..]));
        assert_eq!(scans[0].file_bytes().unwrap().unwrap(), bytes);
        let scanners = scanner_of(&stream);
        assert_eq!(scanners.len(), 1);
        assert_eq!(*first.get_or_insert(scanners[0]), scanners[0]);
    }
    // Also for a scan that it fits less well.
    let other = encoder.encode(Scan::from_positions(&noise)).unwrap();
    assert_eq!(decoded(&other)[0].positions(), noise);
}

/// An input that records the offset and length of each read.
#[derive(Clone)]
struct Watched {
    input: Cursor<Arc<[u8]>>,
    reads: Arc<Mutex<Vec<(u64, usize)>>>,
}

impl Watched {
    fn new(stream: Vec<u8>) -> Self {
        Watched { input: Cursor::new(stream.into()), reads: Arc::default() }
    }

    /// The reads since the last call.
    fn reads(&self) -> Vec<(u64, usize)> {
        take(&mut *self.reads.lock().unwrap())
    }
}

impl Read for Watched {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let start = self.input.position();
        let mut stream = &self.input.get_ref()[start as usize..];
        let count = stream.read(buffer)?;
        self.input.set_position(start + count as u64);
        self.reads.lock().unwrap().push((start, count));
        Ok(count)
    }
}

impl Seek for Watched {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.input.seek(to)
    }
}

/// Scans whose coordinates are random: 24 KB each, which a stream cannot make much smaller.
fn noise(count: u64) -> Vec<Scan> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f32::from_bits((state >> 40) as u32 | 0x4000_0000)
    };
    let mut scan = || Scan::from_positions(&(0..2000).map(|_| [next(), next(), next()]).collect::<Vec<_>>());
    (0..count).map(|number| scan().with_time(number as i64)).collect()
}

#[test]
fn few_and_large_pieces_are_read() {
    let stream = encoded(noise(40), Settings::exact().with_group_of_pictures(5).with_level(1));
    let length = stream.len();
    let input = Watched::new(stream);
    let mut decoder = Decoder::open(input.clone()).unwrap();
    let tail = (length as u64 - (1 << 16), 1 << 16);
    assert_eq!(input.reads(), [tail], "the index");

    let group = |number| {
        let range = decoder.group_of(number).unwrap();
        let frames = decoder.frames().filter(|frame| range.contains(&frame.number));
        frames.map(|frame| frame.coded_bytes).sum::<u64>()
    };
    let (first, second) = (group(0), group(7));
    assert_eq!(decoder.scan(7).unwrap().time(), Some(7));
    let read = input.reads();
    assert!(read.len() == 1 && (second..second + 1000).contains(&(read[0].1 as u64)), "a group: {read:?}");
    for number in [5, 9, 6, 8, 7] {
        assert_eq!(decoder.scan(number).unwrap().time(), Some(number as i64));
    }
    assert_eq!(input.reads(), [], "the group is kept");

    let times: Vec<_> = decoder.scans(2..8).map(|scan| scan.unwrap().time().unwrap()).collect();
    assert_eq!(times, (2..8).collect::<Vec<_>>());
    let read = input.reads();
    let both = first + second;
    assert!(read.len() == 1 && (both..both + 3000).contains(&(read[0].1 as u64)), "two groups: {read:?}");
}

#[test]
fn what_is_no_stream_is_named_as_such_however_large_it_is() {
    for length in [0, 3, 1000, 100_000, 200_000] {
        let error = Decoder::open(Cursor::new(vec![b'x'; length])).unwrap_err();
        assert!(length < 4 || matches!(error, Error::BadMagic(_)), "{length}: {error}");
    }
    let mut newer = encoded(noise(10), Settings::exact().with_level(1));
    newer[4] = 9;
    let checksum = crc32c::crc32c(&newer[..8]).to_le_bytes();
    newer[8..12].copy_from_slice(&checksum);
    let length = newer.len();
    newer[length - 10..length - 4].fill(0);
    let error = Decoder::open(Cursor::new(newer)).unwrap_err();
    assert!(matches!(error, Error::UnsupportedVersion { found: 9, .. }), "{error}");
}

#[test]
fn scans_of_a_kept_group_are_those_of_any_other_way() {
    let scans = drive().into_iter().map(|(name, bytes)| Scan::from_file(&name, bytes));
    let stream = encoded(scans, Settings::exact().with_level(8));
    let expected: Vec<_> = decoded(&stream).iter().map(|scan| scan.file_bytes().unwrap()).collect();
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    for number in [1, 0, 2, 1] {
        assert_eq!(decoder.scan(number).unwrap().file_bytes().unwrap(), expected[number as usize]);
    }
    assert_eq!(
        (decoder.group_of(0), decoder.group_of(2), decoder.group_of(3)),
        (Some(0..3), Some(0..3), None)
    );
    let outlives = decoder.clone().into_scans(1..);
    drop(decoder);
    let found: Vec<_> = outlives.map(|scan| scan.unwrap().file_bytes().unwrap()).collect();
    assert_eq!(found, expected[1..]);
}

#[test]
fn damage_in_a_group_leaves_the_others_to_be_asked_for() {
    let mut stream = encoded(noise(12), Settings::exact().with_group_of_pictures(4).with_level(1));
    let middle = stream.len() / 2;
    stream[middle] ^= 1;
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap();
    for number in [0, 5, 4, 11, 5, 1] {
        assert_eq!(decoder.scan(number).is_ok(), !(4..8).contains(&number), "{number}");
    }
}

#[test]
fn range_images_hold_the_points() {
    let (name, bytes) = drive().swap_remove(0);
    let stream = encoded([Scan::from_file(&name, bytes)], Settings::exact());
    assert!(decoded(&stream)[0].range_image().is_none(), "nobody asked for it");
    let mut decoder = Decoder::open(Cursor::new(&stream)).unwrap().with_range_images(true);
    let scan = decoder.scan(0).unwrap();
    let image = scan.range_image().unwrap();
    assert_eq!((image.rows(), image.ranges().len()), (64, 64 * image.columns()));
    assert_eq!(image.points().len(), image.ranges().len());
    let returns = image.ranges().iter().zip(image.points()).filter(|(range, _)| **range > 0.0);
    let mut found = 0;
    for (range, point) in returns {
        let position = scan.positions()[point.unwrap() as usize].map(f64::from);
        let distance = position.iter().map(|metres| metres * metres).sum::<f64>().sqrt();
        // Lasers are up to a quarter of a metre away from the origin.
        assert!((distance - f64::from(*range)).abs() < 0.3, "{distance} {range}");
        found += 1;
    }
    assert!(found * 100 > scan.len() * 99, "{found} of {}", scan.len());
    let untouched =
        Decoder::open(Cursor::new(encoded(noise(1), Settings::exact()))).unwrap().with_range_images(true);
    assert!(untouched.into_scans(..).next().unwrap().unwrap().range_image().is_none());
}
