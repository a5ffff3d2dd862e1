//! What is done to the fuzzer's bytes. The fuzzer's programs (`fuzz_targets`) and the test that replays what
//! they have found (`tests/fuzz.rs`) share it.

use lidarpc::internals::backend::{self, BACKENDS, Level};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::Prediction;
use lidarpc::internals::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice};
use lidarpc::internals::ground::error::Limits;
use lidarpc::internals::scanner::Hdl64;
use lidarpc::internals::stream::container::{IndexedReader, StreamReader};

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::formats::kitti;
use crate::common::scans::{scans, small};
use crate::common::streams::STREAMS;
use crate::common::{decode_within, put_together, round_trip};

/// Far less than the program's, for speed; as tight for what is claimed.
const LIMITS: Limits = Limits { points: 1 << 16, file_bytes: 1 << 22, record_bytes: 1 << 24 };

/// Takes any bytes, and panics if they show a fault.
pub type Target = fn(&[u8]);

/// All targets by name.
#[allow(dead_code)] // The fuzzer's programs call theirs directly.
pub const TARGETS: [(&str, Target); 6] = [
    ("container", container),
    ("sections", sections),
    ("backends", backends),
    ("readers", readers),
    ("sensor", sensor),
    ("round_trip", round_trip_of),
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

/// Any bytes as the payload of one section of a good stream, with its checksums made right.
pub fn sections(data: &[u8]) {
    let [stream, section, payload @ ..] = data else { return };
    let (models, mut groups) = STREAMS[usize::from(*stream) % STREAMS.len()].clone();
    let all = groups.iter_mut().flat_map(|group| &mut group.frames).flat_map(|frame| &mut frame.sections);
    let mut all: Vec<_> = all.collect();
    let place = usize::from(*section) % all.len();
    all[place].payload = payload.to_vec();
    let _ = decode_within(&put_together(&models, &groups), LIMITS);
}

/// Any bytes as what a back-end has compressed; and what it compresses comes back.
pub fn backends(data: &[u8]) {
    let [id, length, bytes @ ..] = data else { return };
    let backend = BACKENDS[usize::from(*id) % BACKENDS.len()];
    let _ = backend::decompress(backend, bytes, usize::from(*length) * 64);
    if let Ok(coded) = backend.compress(bytes, backend::Level::default()) {
        assert!(backend::decompress(backend, &coded, bytes.len()).unwrap() == bytes, "{}", backend.name());
    }
}

/// Any bytes as a file of each format: taken apart and put together, they are the same.
pub fn readers(data: &[u8]) {
    let [kind, bytes @ ..] = data else { return };
    let name = ["a.bin", "a.pcd.bin", "a.pcd", "a.ply", "a.txt"][usize::from(*kind) % 5];
    let scan = parse(name, bytes.to_vec());
    assert!(scan.to_bytes().unwrap() == bytes, "{name}");
}

/// Any bytes as a sensor model's record; what is one is written as the same bytes.
pub fn sensor(data: &[u8]) {
    let mut rest = data;
    if let Ok(model) = Hdl64::read_from(&mut rest) {
        let mut written = Vec::new();
        model.write_to(&mut written);
        assert_eq!(written, data[..data.len() - rest.len()]);
        if model.rows() > 0 {
            let point = model.point(0, 0, 1);
            let _ = model.invert(0, point);
        }
    }
}

/// Any bytes as a file behind a good scan, in one mode or another.
pub fn round_trip_of(data: &[u8]) {
    let [mode, kind, bytes @ ..] = data else { return };
    let good = ("0.bin".to_owned(), kitti(&scans(&small(1, 1))[0]));
    let name = ["1.bin", "1.pcd.bin", "1.pcd", "1.ply", "1.txt"][usize::from(*kind) % 5];
    let files = [good, (name.to_owned(), bytes.to_vec())];
    let level = Level::new(1 + mode / 4 % 9).unwrap_or_default();
    let default = EncoderConfig { threads: 1, ..EncoderConfig::preset(Mode::Exact) };
    let exact = EncoderConfig { level, ..default.clone() };
    // The context coder does not have all levels.
    let exact = if exact.check().is_ok() { exact } else { default };
    match mode % 4 {
        0 => drop(round_trip(&files, &exact)),
        1 => drop(round_trip(&files[1..], &exact)),
        2 => {
            let max_error_um = 1 << (mode / 4 % 20);
            keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
        }
        _ => {
            let coder = Coder::Backend(BACKENDS[usize::from(mode / 4) % BACKENDS.len()].id());
            let prediction = PredictionChoice::Always(Prediction::None);
            drop(round_trip(&files, &EncoderConfig { coder, prediction, ..exact }));
        }
    }
}
