//! The fuzz targets. They are shared by the fuzzer's programs (`fuzz_targets`) and the test that replays
//! their findings (`tests/fuzz.rs`).

use std::fs::{self, File};
use std::io::Cursor;
use std::sync::LazyLock;

use lidarpc::Settings;
use lidarpc::internals::backend::{self, BACKENDS};
use lidarpc::internals::container::{IndexedReader, Section, StreamReader};
use lidarpc::internals::edit::{Named, PartialFiles, encode_resuming, recover, repair};
use lidarpc::internals::files::{ArrivingFrames, FileFormat, convert, parse};
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, PredictionChoice};
use lidarpc::internals::frame::{PositionFidelity, Prediction};
use lidarpc::internals::ground::error::{Limits, Result};
use lidarpc::internals::scan::{Channel, Number, PointCloud, ScalarType};
use lidarpc::internals::scanner::{REACH, Return, Scanner};
use lidarpc::internals::stream::{DecodeOptions, FrameInput};
use lidarpc::recordings::internals::{Encoding, compress, payload, scan, unpacked};
use lidarpc::recordings::{Clouds, TopicFilter, examine, pack, same_messages, unpack};
use tempfile::TempDir;

use crate::common::bound::{bounded, check_bound, keeps_the_bound};
use crate::common::formats::kitti;
use crate::common::odd::{Change, Format};
use crate::common::scans::{Points, random_points, scans, small};
use crate::common::streams::{KNOWN, Known, STREAMS, at_level, halved};
use crate::common::{File as ScanFile, comes_back, decode_files, decode_within, put_together, round_trip};

/// Far below the program's limits, for speed; values in streams are checked against them just as strictly.
const LIMITS: Limits = Limits { points: 1 << 16, file_bytes: 1 << 22, record_bytes: 1 << 24 };

/// Takes any bytes, and panics if they reveal a fault.
pub type Target = fn(&[u8]);

/// All targets by name.
#[allow(dead_code)] // The fuzzer's programs call theirs directly.
pub const TARGETS: [(&str, Target); 14] = [
    ("container", container),
    ("sections", sections),
    ("parts", parts),
    ("backends", backends),
    ("readers", readers),
    ("conversion", conversion),
    ("arrival", arrival),
    ("salvage", salvage),
    ("journal", journal),
    ("scanner", scanner),
    ("round_trip", round_trip_of),
    ("differential", differential),
    ("sequence", sequence),
    ("recordings", recordings),
];

/// Any bytes as a stream: read by records, by the index, and decoded.
pub fn container(data: &[u8]) {
    if let Ok(mut reader) = StreamReader::open(data, LIMITS) {
        while let Ok(Some(_)) = reader.next_record() {}
    }
    if let Ok(mut reader) = IndexedReader::open(std::io::Cursor::new(data), LIMITS) {
        for place in 0..reader.index().groups.len().min(100) {
            let _ = reader.read_group(place);
        }
    }
    let _ = decode_within(data, LIMITS);
}

/// Any bytes as the payload of one section of a valid stream, with corrected checksums.
pub fn sections(data: &[u8]) {
    let [stream, section, payload @ ..] = data else { return };
    let (models, mut groups) = STREAMS[usize::from(*stream) % STREAMS.len()].clone();
    let all = groups.iter_mut().flat_map(|group| &mut group.frames).flat_map(|frame| &mut frame.sections);
    let mut all: Vec<_> = all.collect();
    let place = usize::from(*section) % all.len();
    all[place].payload = payload.to_vec();
    let _ = decode_within(&put_together(&models, &groups), LIMITS);
}

/// Any bytes as changes to the parts of a valid stream, five bytes each: frames and sections are truncated,
/// joined, exchanged with those of another stream, removed, repeated and changed, and all checksums
/// corrected, so that the changes reach the coders.
pub fn parts(data: &[u8]) {
    let [stream, other, changes @ ..] = data else { return };
    let pick = |number: &u8| &STREAMS[usize::from(*number) % STREAMS.len()];
    let (models, mut groups) = pick(stream).clone();
    let others: Vec<&Section> =
        pick(other).1.iter().flat_map(|group| &group.frames).flat_map(|frame| &frame.sections).collect();
    for change in changes.chunks_exact(5).take(16) {
        let [what, frame, section, place, value] = [0, 1, 2, 3, 4].map(|n| usize::from(change[n]));
        let Some(group) = groups.first_mut().filter(|group| !group.frames.is_empty()) else { return };
        let count = group.frames.len();
        let frame = frame % count;
        if what % 12 == 0 {
            group.frames.swap(frame, place % count);
            continue;
        }
        let sections = &mut group.frames[frame].sections;
        if sections.is_empty() {
            continue;
        }
        let (length, section) = (sections.len(), section % sections.len());
        let foreign = others[(place * 256 + value) % others.len()];
        let payload = &mut sections[section].payload;
        let at = (place * 16 + value / 16).min(payload.len());
        match what % 12 {
            1 => sections.swap(section, place % length),
            2 => drop(sections.remove(section)),
            3 => sections.insert(section, foreign.clone()),
            4 => sections[section] = foreign.clone(),
            5 => payload.clone_from(&foreign.payload),
            6 => payload.truncate(at),
            7 => payload.extend_from_slice(&foreign.payload),
            8 => payload.splice(..at, foreign.payload.iter().copied()).for_each(drop),
            9 => payload[at..].fill(value as u8),
            10 => group.frames[frame].header.point_count ^= 1 << (value % 20),
            _ => {
                let length = payload.len();
                if let Some(byte) = payload.get_mut(place % length.max(1)) {
                    *byte ^= (value as u8).max(1);
                }
            }
        }
    }
    let _ = decode_within(&put_together(&models, &groups), LIMITS);
}

/// Any bytes as the output of a back-end, for a length in two bytes; also, data that it compresses must be
/// restored.
pub fn backends(data: &[u8]) {
    let [id, low, high, bytes @ ..] = data else { return };
    let backend = BACKENDS[usize::from(*id) % BACKENDS.len()];
    let _ = backend::decompress(backend, bytes, u16::from_le_bytes([*low, *high]).into());
    if let Ok(coded) = backend.compress(bytes, backend::Level::default()) {
        assert!(backend::decompress(backend, &coded, bytes.len()).unwrap() == bytes, "{}", backend.name());
    }
}

/// Any bytes as a file of each format: parsed and written again, they are the same.
pub fn readers(data: &[u8]) {
    let [kind, bytes @ ..] = data else { return };
    let name = NAMES[usize::from(*kind) % NAMES.len()];
    let scan = parse(name, bytes.to_vec());
    assert!(scan.to_bytes().unwrap() == bytes, "{name}");
}

/// Any bytes as a file, converted to each format: the result is a file of that format with the same points.
pub fn conversion(data: &[u8]) {
    let [kind, bytes @ ..] = data else { return };
    let name = NAMES[usize::from(*kind) % NAMES.len()];
    let scan = parse(name, bytes.to_vec());
    for format in [FileFormat::Bin, FileFormat::Pcd, FileFormat::Ply, FileFormat::Npy, FileFormat::Csv] {
        let Ok(converted) = convert(&scan, format) else { continue };
        let again = parse(&converted.name, converted.to_bytes().unwrap());
        assert_eq!((again.records, &again.name), (scan.records, &format.file_name(name)), "{format:?}");
        // Text has no payloads of NaN, and no types.
        if format == FileFormat::Csv {
            continue;
        }
        assert!(coordinates(&again.cloud) == coordinates(&converted.cloud), "{format:?}");
    }
}

/// The bits of x, y and z. A reader takes doubles as float32 if these preserve every bit, which an original
/// of the other byte order stored as doubles. So all are compared as doubles, except NaN, which has different
/// bits in float32.
fn coordinates(cloud: &PointCloud) -> Vec<u64> {
    let bits = |number| match number {
        Number::Integer(value) => value as u64,
        Number::Float(value) if value.is_nan() => f64::NAN.to_bits(),
        Number::Float(value) => value.to_bits(),
    };
    let of_axis = |axis: usize| {
        cloud.positions.iter().map(move |point| (ScalarType::F32, point[axis].to_le_bytes().to_vec()))
    };
    let of_channel = |name| {
        let channels = cloud.channels.iter().filter(move |channel| channel.field.name == name);
        channels.flat_map(|Channel { field, bytes }| {
            bytes.chunks(field.scalar.size() as usize).map(|value| (field.scalar, value.to_vec()))
        })
    };
    let values = (0..3).flat_map(of_axis).chain(["x", "y", "z"].into_iter().flat_map(of_channel));
    values.map(|(scalar, value)| bits(scalar.number(&value).unwrap())).collect()
}

/// Any bytes as the input from a pipe: no frame has more bytes than arrived, and no two have the same name.
pub fn arrival(data: &[u8]) {
    let mut frames: Vec<_> = ArrivingFrames::new(data).map_while(Result::ok).collect();
    assert!(frames.iter().map(|frame| frame.bytes.len()).sum::<usize>() <= data.len());
    let count = frames.len();
    frames.sort_by(|a, b| a.name.cmp(&b.name));
    frames.dedup_by(|a, b| a.name == b.name);
    assert_eq!(frames.len(), count);
}

/// Any bytes as a damaged stream: the salvaged parts make an intact stream.
pub fn salvage(data: &[u8]) {
    let options = DecodeOptions { threads: 1, limits: LIMITS, ..DecodeOptions::default() };
    let _ = recover(Cursor::new(data), &options, |_| Ok(()));
    let mut repaired = Vec::new();
    let input = Named { path: "damaged".into(), stream: Cursor::new(data) };
    if let Ok(frames) = repair(input, &LIMITS, &mut repaired, |_| ()) {
        let reader = IndexedReader::open(Cursor::new(&repaired), LIMITS).unwrap();
        assert_eq!(
            reader.index().groups.iter().map(|group| group.frames.len()).sum::<usize>() as u64,
            frames
        );
        let mut records = StreamReader::open(&repaired[..], LIMITS).unwrap();
        while records.next_record().unwrap().is_some() {}
    }
}

/// An encode of three frames in three groups that was interrupted at its end: the stream and its journal.
pub static INTERRUPTED: LazyLock<(Vec<u8>, Vec<u8>)> = LazyLock::new(|| resume(b"", b"").1);

/// Any bytes as the journal, or as the stream, of an interrupted encode: it continues to the only possible
/// stream, or leaves both files unchanged.
pub fn journal(data: &[u8]) {
    let [which, bytes @ ..] = data else { return };
    let (stream, journal) = &*INTERRUPTED;
    let (old_stream, old_journal) = if which % 2 == 0 { (&stream[..], bytes) } else { (bytes, &journal[..]) };
    let (result, (new_stream, new_journal)) = resume(old_stream, old_journal);
    match result {
        Ok(()) => assert!(new_stream == *stream && new_journal == *journal, "another stream"),
        Err(_) => assert!(new_stream == old_stream && new_journal == old_journal, "something was changed"),
    }
}

/// Continues an interrupted encode; returns the resulting stream and journal.
fn resume(stream: &[u8], journal: &[u8]) -> (Result<()>, (Vec<u8>, Vec<u8>)) {
    let folder = TempDir::new().unwrap();
    let [stream_path, journal_path] = ["stream", "journal"].map(|name| folder.path().join(name));
    fs::write(&stream_path, stream).unwrap();
    fs::write(&journal_path, journal).unwrap();
    let input = |n: u64| FrameInput::memory(format!("{n}.bin"), kitti(&random_points(5, n)));
    let config = EncoderConfig { gop: 1, threads: 1, ..EncoderConfig::default() };
    let file = File::options().read(true).write(true).open(&stream_path).unwrap();
    let partial = PartialFiles { path: "partial".into(), stream: file, journal: journal_path.clone() };
    let result = encode_resuming(&[1, 2, 3].map(input), &config, partial, &|| ()).map(drop);
    (result, (fs::read(stream_path).unwrap(), fs::read(journal_path).unwrap()))
}

/// Any bytes as the payload of a scanner's record, of any family. A valid one is written as the same bytes,
/// and the scanner inverts the points that it computes.
pub fn scanner(data: &[u8]) {
    let [family, payload @ ..] = data else { return };
    let Ok(Some(scanner)) = Scanner::from_record(u64::from(*family), payload) else { return };
    assert_eq!((scanner.family_number(), &scanner.to_payload()[..]), (u64::from(*family), payload));
    let last = scanner.rows().saturating_sub(1) as u32;
    let returns = [(0, 1), (0, 5000), (last, 1), (last, 5000)];
    let returns = returns.map(|(row, steps)| Return { row, column: 0, tick: 0, steps, echo: 0 });
    let mut positions = scanner.positions(&returns, 0.0, true);
    positions.extend([[f32::NAN; 3], [f32::MAX; 3], [0.0; 3]]);
    let cloud = PointCloud { positions, ..PointCloud::default() };
    let projection = scanner.project(&cloud, REACH);
    let found = scanner.file_order(&projection.image);
    assert_eq!(found.len() + projection.strays.len(), cloud.positions.len());
}

/// Any bytes as a file after a scan of a known scanner, in one mode or another.
pub fn round_trip_of(data: &[u8]) {
    let [mode, known, kind, bytes @ ..] = data else { return };
    let known = &KNOWN[usize::from(*known) % KNOWN.len()];
    let good = ("0.bin".to_owned(), kitti(&known.frames[0]));
    let files = [good, (NAMES[usize::from(*kind) % NAMES.len()].to_owned(), bytes.to_vec())];
    let by_level = at_level(LEVELS[usize::from(mode / 4) % LEVELS.len()]);
    let config = match mode % 4 {
        0 | 1 if usize::from(*kind) / NAMES.len() % 2 == 1 => halved(by_level),
        0 | 1 => by_level,
        2 => bounded(1 << (mode / 4 % 20)),
        _ => by_back_end(usize::from(mode / 4)),
    };
    // In one of four modes, no other file precedes it.
    comes_back_from(known, &files[usize::from(mode % 4 == 1)..], &config);
}

/// Any bytes as changes to a scan, which is coded after another: at every level, within a bound, and by a
/// back-end. The restored file is the same each time.
pub fn differential(data: &[u8]) {
    let [known, format, changes @ ..] = data else { return };
    let known = &KNOWN[usize::from(*known) % KNOWN.len()];
    let [first, .., last] = &known.frames[..] else { panic!("a scanner has scans") };
    let mut points = last.clone();
    changes.as_chunks().0.iter().take(12).for_each(|bytes| change(*bytes).apply(&mut points));
    let format = Format::ALL[usize::from(*format) % Format::ALL.len()];
    let file = |number, points: &Points| (format!("{number}.{}", format.extension()), format.write(points));
    let files = [file(0, first), file(1, &points)];
    LEVELS.into_iter().for_each(|level| comes_back_from(known, &files, &at_level(level)));
    [6, 8, 9].into_iter().for_each(|level| comes_back_from(known, &files, &halved(at_level(level))));
    comes_back_from(known, &files, &bounded(1 << (changes.len() % 20)));
    comes_back_from(known, &files, &by_back_end(changes.len()));
}

/// The context coder's levels that differ.
const LEVELS: [u8; 7] = [1, 2, 3, 6, 7, 8, 9];

/// Names of files of each format, and of none.
const NAMES: [&str; 9] =
    ["1.bin", "1.pcd.bin", "1.pcd", "1.ply", "1.csv", "1.npy", "1.las", "1.jpg", "1.feather"];

/// Exact mode with one of the back-ends.
fn by_back_end(number: usize) -> EncoderConfig {
    EncoderConfig {
        coder: Coder::Backend(BACKENDS[number % BACKENDS.len()].id()),
        prediction: PredictionChoice::Always(Prediction::None),
        ..EncoderConfig::default()
    }
}

/// Encodes files of a scanner, decodes them, and checks that the mode's guarantee is kept.
fn comes_back_from(known: &Known, files: &[ScanFile], config: &EncoderConfig) {
    let stream = known.encode(files, config);
    match config.positions {
        PositionFidelity::Bounded { max_error_um, .. } => {
            check_bound(files, &decode_files(&stream).expect("decodes"), config, max_error_um);
        }
        // Streams of one group.
        _ => comes_back(&stream, files, 1),
    }
}

/// A change to a scan, from six bytes.
fn change([what, axis, at, at_high, value, value_high]: [u8; 6]) -> Change {
    let at = usize::from(u16::from_le_bytes([at, at_high]));
    let value = u16::from_le_bytes([value, value_high]);
    let (axis, length, small) =
        (usize::from(axis % 3), usize::from(value % 200), i32::from(value as i16 % 8));
    match what % 13 {
        0 => Change::Shuffle(value.into()),
        1 => Change::Reverse,
        2 => Change::SwapRows(at, value.into()),
        3 => Change::Swap(at, value.into()),
        4 => Change::Keep(at, length),
        5 => Change::Delete(at, length),
        6 => Change::Duplicate(at, length),
        // The upper half of a number: its sign, its exponent, and the upper bits of its significand.
        7 => Change::Coordinate(at, axis, f32::from_bits(u32::from(value) << 16)),
        8 => Change::Ulps(at, axis, small),
        9 => Change::Millimetres(at, axis, small),
        10 => Change::Intensity(at, f32::from_bits(u32::from(value) << 16)),
        11 => Change::AllIntensities(f32::from(value) / 100.0),
        _ => Change::OneCell(at),
    }
}

/// Any bytes as a file after a scan whose scanner must be fitted first, in one mode or another.
pub fn sequence(data: &[u8]) {
    let [mode, kind, bytes @ ..] = data else { return };
    let good = ("0.bin".to_owned(), kitti(&scans(&small(1, 1))[0]));
    let files = [good, (NAMES[usize::from(*kind) % NAMES.len()].to_owned(), bytes.to_vec())];
    let one = |config: EncoderConfig| EncoderConfig { threads: 1, ..config };
    let exact = one(at_level(LEVELS[usize::from(mode / 4) % LEVELS.len()]));
    match mode % 4 {
        0 => drop(round_trip(&files, &exact)),
        1 => drop(round_trip(&files[1..], &exact)),
        2 => {
            let max_error_um = 1 << (mode / 4 % 20);
            keeps_the_bound(&files, &one(bounded(max_error_um)), max_error_um);
        }
        _ => drop(round_trip(&files, &one(by_back_end(usize::from(mode / 4))))),
    }
}

/// Any bytes as a message with a cloud, in each encoding: parsed and written again, it is the same, and so is
/// the payload of its compressed message. Or any bytes as a recording: it is read in each way and, packed and
/// unpacked, has the same messages.
pub fn recordings(data: &[u8]) {
    let [kind, bytes @ ..] = data else { return };
    let encoding = match kind % 3 {
        0 => Encoding::Cdr,
        1 => Encoding::Ros1,
        _ => return recording(bytes),
    };
    if let Some((cloud, _)) = scan(bytes, encoding) {
        assert!(cloud.to_bytes().unwrap() == bytes);
        let compressed = compress(bytes, encoding, b"compressed").unwrap();
        assert!(payload(&compressed, encoding) == Some(b"compressed"));
    }
    let _ = unpacked(bytes, encoding, Limits::default());
}

fn recording(bytes: &[u8]) {
    let filter = TopicFilter::default();
    if let Ok(clouds) = Clouds::open(bytes, &filter, Limits::default()) {
        clouds.take(100).for_each(drop);
    }
    let _ = examine(bytes, Some(Limits::default()), 1, &|| ());
    let (mut packed, mut again) = (Cursor::new(Vec::new()), Cursor::new(Vec::new()));
    let settings = Settings::exact().with_level(1).with_threads(1);
    let Ok(copied) = pack(Cursor::new(bytes), &mut packed, &settings, &filter, &|| ()) else { return };
    unpack(&packed.get_ref()[..], &mut again, 1, Limits::default(), &|| ()).unwrap();
    assert!(same_messages(bytes, &again.get_ref()[..]).unwrap() == Some(copied.messages));
}
