//! Streams with correct checksums and wrong contents: the result is an error or a scan, never a panic, an
//! endless loop, or more memory than the limits allow.

use crate::common::formats::{kitti, pcd_text};
use crate::common::scans::Random;
use crate::common::streams::{Parts, STREAMS, at_level};
use crate::common::{cases, decode_files, decode_within, encode_files, put_together, take_apart};
use lidarpc::internals::container::{CodedFrame, Group, ScannerRecord, Section, SectionKind};
use lidarpc::internals::entropy::{ArithmeticEncoder, BitCoder, IntegerModel};
use lidarpc::internals::frame::parameters::RangeCoder;
use lidarpc::internals::frame::{FrameParameters, Modelling};
use lidarpc::internals::ground::error::Limits;
use lidarpc::internals::ground::varint::write_unsigned;
use lidarpc::internals::models::ByteModel;
use lidarpc::internals::scan::{Field, Layout, ScalarType, Wrapping};
use lidarpc::internals::scanner::hdl64::{BeamConstants, Hdl64, Hdl64ColumnModel};
use lidarpc::internals::scanner::{CoordinateGrid, Return, Scanner};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// Damage to a stream's parts. Indices are taken modulo the number of items.
#[derive(Clone, Debug)]
enum Damage {
    Bit { section: usize, bit: usize },
    Byte { section: usize, place: usize, value: u8 },
    Cut { section: usize, length: usize },
    Empty { section: usize },
    Fill { section: usize, from: usize, value: u8 },
    Insert { section: usize, place: usize, bytes: Vec<u8> },
    Payload { section: usize, bytes: Vec<u8> },
    Remove { section: usize },
    Exchange { section: usize, other: usize },
    Kind { section: usize, kind: SectionKind },
    Model { place: usize, value: u8 },
    NoModel,
}

impl Damage {
    fn apply(&self, (models, groups): &mut Parts) {
        let mut places = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            for (f, frame) in group.frames.iter().enumerate() {
                places.extend((0..frame.sections.len()).map(|s| (g, f, s)));
            }
        }
        let place = |section: usize| places[section % places.len()];
        let mut change = |section: usize, change: &mut dyn FnMut(&mut Vec<u8>)| {
            let (g, f, s) = place(section);
            let payload = &mut groups[g].frames[f].sections[s].payload;
            if !payload.is_empty() {
                change(payload);
            }
        };
        match self {
            Damage::Bit { section, bit } => change(*section, &mut |payload| {
                let bit = bit % (payload.len() * 8);
                payload[bit / 8] ^= 1 << (bit % 8);
            }),
            Damage::Byte { section, place, value } => change(*section, &mut |payload| {
                let length = payload.len();
                payload[place % length] = *value;
            }),
            Damage::Cut { section, length } => change(*section, &mut |p| p.truncate(length % p.len())),
            Damage::Empty { section } => change(*section, &mut Vec::clear),
            Damage::Fill { section, from, value } => change(*section, &mut |payload| {
                let from = from % payload.len();
                payload[from..].fill(*value);
            }),
            Damage::Insert { section, place, bytes } => change(*section, &mut |payload| {
                let place = place % payload.len();
                payload.splice(place..place, bytes.iter().copied());
            }),
            Damage::Payload { section, bytes } => change(*section, &mut |payload| payload.clone_from(bytes)),
            Damage::Remove { section } => {
                let (g, f, s) = place(*section);
                groups[g].frames[f].sections.remove(s);
            }
            Damage::Exchange { section, other } => {
                let ((g, f, s), (h, e, t)) = (place(*section), place(*other));
                let payload = groups[g].frames[f].sections[s].payload.clone();
                let other = std::mem::replace(&mut groups[h].frames[e].sections[t].payload, payload);
                groups[g].frames[f].sections[s].payload = other;
            }
            Damage::Kind { section, kind } => {
                let (g, f, s) = place(*section);
                groups[g].frames[f].sections[s].kind = *kind;
            }
            Damage::Model { place, value } => {
                if let Some(model) = models.first_mut() {
                    let (length, before) = (model.payload.len(), model.id());
                    model.payload[place % length] = *value;
                    let after = Some(model.id());
                    let scanners = groups.iter_mut().flat_map(|group| &mut group.scanners);
                    scanners.filter(|id| **id == Some(before)).for_each(|id| *id = after);
                }
            }
            Damage::NoModel => groups.iter_mut().for_each(|group| group.scanners.fill(None)),
        }
    }
}

fn damage() -> impl Strategy<Value = Damage> {
    // The first positions matter most, as everything after them depends on them.
    let place = || prop_oneof![0usize..12, any::<usize>()];
    let section = any::<usize>;
    let byte = || prop_oneof![Just(0u8), Just(255), any::<u8>()];
    let bytes = || prop::collection::vec(byte(), 0..40);
    prop_oneof![
        4 => (section(), place()).prop_map(|(section, bit)| Damage::Bit { section, bit }),
        4 => (section(), place(), byte()).prop_map(|(section, place, value)| Damage::Byte { section, place, value }),
        2 => (section(), place()).prop_map(|(section, length)| Damage::Cut { section, length }),
        1 => section().prop_map(|section| Damage::Empty { section }),
        3 => (section(), place(), byte()).prop_map(|(section, from, value)| Damage::Fill { section, from, value }),
        1 => (section(), place(), bytes()).prop_map(|(section, place, bytes)| Damage::Insert { section, place, bytes }),
        3 => (section(), bytes()).prop_map(|(section, bytes)| Damage::Payload { section, bytes }),
        1 => section().prop_map(|section| Damage::Remove { section }),
        1 => (section(), section()).prop_map(|(section, other)| Damage::Exchange { section, other }),
        1 => (section(), prop::sample::select(SectionKind::all()))
            .prop_map(|(section, kind)| Damage::Kind { section, kind }),
        3 => (place(), byte()).prop_map(|(place, value)| Damage::Model { place, value }),
        1 => Just(Damage::NoModel),
    ]
}

/// Small limits, so that forged counts do not make the tests slow.
fn tight() -> Limits {
    Limits { points: 20_000, file_bytes: 1 << 20, record_bytes: 1 << 20 }
}

proptest! {
    #![proptest_config(cases(150))]

    #[test]
    fn damaged_parts_are_an_error_or_a_result(
        stream in any::<prop::sample::Index>(),
        damages in prop::collection::vec(damage(), 1..4)
    ) {
        let mut parts = stream.get(&STREAMS).clone();
        damages.iter().for_each(|damage| damage.apply(&mut parts));
        let _ = decode_within(&put_together(&parts.0, &parts.1), tight());
    }

    #[test]
    fn any_scanner_record_is_an_error_or_one_meaning(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
        let mut input = &bytes[..];
        if let Ok(model) = Hdl64::read_from(&mut input) {
            check_model(&model);
        }
    }

    #[test]
    fn any_numbers_make_a_scanner_model_or_an_error(
        head in (0u64..3, wild(), wild(), 0u64..4),
        constants in prop::collection::vec(wild(), 24)
    ) {
        let numbers = [head.0, head.1, head.2, head.3].into_iter().chain(constants);
        let mut bytes = Vec::new();
        numbers.for_each(|number| write_unsigned(&mut bytes, number));
        if let Ok(model) = Hdl64::read_from(&mut &bytes[..]) {
            check_model(&model);
        }
    }
}

/// Numbers of any length.
fn wild() -> impl Strategy<Value = u64> {
    prop_oneof![
        prop::sample::select(vec![0, 1, u64::MAX, u64::MAX - 1, 1 << 35, (1 << 35) - 1, 360_000, 4000]),
        (any::<u64>(), 0u32..64).prop_map(|(number, shift)| number >> shift),
    ]
}

/// An accepted model's formula returns a value everywhere.
fn check_model(model: &Hdl64) {
    let mut written = Vec::new();
    model.write_to(&mut written);
    assert_eq!(Hdl64::read_from(&mut &written[..]).unwrap(), *model);
    for row in 0..model.rows().min(3) {
        for column in [0, model.ticks / 2, model.ticks - 1] {
            let tick = model.tick_of_column(row, column);
            assert!(tick < model.ticks);
            assert_eq!(model.column_tick(row, i64::from(tick)), column);
            for steps in [1, 2, 1000, 65535] {
                let _ = model.point(row, tick, steps);
                let found = Return { row: row as u32, tick, steps, ..Return::default() };
                model.fill_azimuths(row, &[found; 9], &mut [0.0; 9]);
                let _ = model.position_at(row, tick, model.metres(steps));
            }
        }
        let _ = model.invert(row, [1.0, -2.0, 0.5]);
    }
}

#[test]
fn scanner_records_with_impossible_numbers_are_refused() {
    let good: [i64; 10] = [0, 4000, 2000, 1, 1, 2, 3, 4, 5, 6];
    let record = |numbers: &[i64]| {
        let mut bytes = Vec::new();
        for (place, &number) in numbers.iter().enumerate() {
            match place {
                0..4 => write_unsigned(&mut bytes, number as u64),
                _ => lidarpc::internals::ground::varint::write_signed(&mut bytes, number),
            }
        }
        Hdl64::read_from(&mut &bytes[..])
    };
    assert!(record(&good).is_ok());
    let bad = [(0, 2), (1, 0), (1, 360_001), (1, -1), (2, 1_000_001), (3, 0), (3, 2), (3, -1)];
    let extreme = (4..10).flat_map(|place| [(place, i64::MIN), (place, i64::MAX), (place, -(1 << 35))]);
    for (place, number) in bad.into_iter().chain(extreme) {
        let mut numbers = good;
        numbers[place] = number;
        assert!(record(&numbers).is_err(), "{number} at {place}");
    }
}

// ---- forged frames ----

/// The payload of a File section that claims counts.
fn file_section(layout: &Layout, records: u64, strays: u64) -> Section {
    let mut coder = ArithmeticEncoder::default();
    let (mut sizes, mut model) = (IntegerModel::default(), ByteModel::default());
    let mut bytes = Vec::new();
    layout.write_to(&mut bytes);
    sizes.code(&mut coder, bytes.len() as u64);
    let others = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    IntegerModel::default().code(&mut coder, (bytes.len() - others) as u64);
    model.code(&mut coder, 1, &mut bytes[..others]);
    for number in [0, 0, records, strays] {
        sizes.code(&mut coder, number);
    }
    Section { kind: SectionKind::File, payload: coder.finish() }
}

/// A stream of one frame with these sections after its parameters, whose header claims `records` records.
fn forged(model: Option<&Hdl64>, records: u64, sections: Vec<Section>) -> Vec<u8> {
    forged_as(Modelling::Mixed, model, records, sections)
}

fn forged_as(
    modelling: Modelling,
    model: Option<&Hdl64>,
    records: u64,
    mut sections: Vec<Section>,
) -> Vec<u8> {
    let range_coder = RangeCoder::Context { modelling, range_bits: 16, bin: 1, between: false };
    let parameters = FrameParameters { range_coder, ..FrameParameters::default() };
    sections.insert(0, Section { kind: SectionKind::Parameters, payload: parameters.to_payload() });
    let mut group = STREAMS[0].1[0].clone();
    group.frames.truncate(1);
    group.frames[0].sections = sections;
    group.frames[0].header.point_count = records;
    let payload = |model: &Hdl64| Scanner::from(model.clone()).to_payload();
    let record = model.map(|model| ScannerRecord { family: 1, payload: payload(model) });
    group.scanners = vec![record.as_ref().map(ScannerRecord::id)];
    put_together(record.as_slice(), &[group])
}

fn kitti_layout() -> Layout {
    let fields = ["x", "y", "z", "i"].map(|name| Field::new(name, ScalarType::F32)).to_vec();
    Layout { wrapping: Wrapping::Plain, fields, position: Some([0, 1, 2]), intensity: Some(3) }
}

fn sections(kinds: &[SectionKind], payload: &[u8]) -> Vec<Section> {
    kinds.iter().map(|&kind| Section { kind, payload: payload.to_vec() }).collect()
}

/// A scanner with many beams and ticks.
fn model(rows: usize, ticks: u32) -> Hdl64 {
    Hdl64::new(CoordinateGrid::Millimetre, ticks, 2000, vec![BeamConstants::default(); rows])
}

const IMAGE: [SectionKind; 6] = [
    SectionKind::Columns,
    SectionKind::Occupancy,
    SectionKind::Intensity,
    SectionKind::Range,
    SectionKind::Correction,
    SectionKind::Order,
];

#[test]
fn forged_counts_are_an_error() {
    let most = Limits::default().points;
    for (records, strays) in [
        (most + 1, 0),
        (u64::MAX >> 1, u64::MAX >> 1),
        (1 << 40, 5),
        (5, 6),
        (0, 1),
        (3, 3),
        (3, 0),
        (0, 0),
        (most, 0),
    ] {
        for payload in [&[][..], &[0xff; 9]] {
            let frame =
                [vec![file_section(&kitti_layout(), records, strays)], sections(&IMAGE, payload)].concat();
            for scanner in [None, Some(&model(2, 40))] {
                assert!(
                    decode_files(&forged(scanner, records, frame.clone())).is_err(),
                    "{records} {strays}"
                );
            }
        }
    }
}

/// A section that claims to be a whole file.
#[test]
fn forged_files_are_an_error() {
    let mut layout = Vec::new();
    kitti_layout().write_to(&mut layout);
    let whole = |layout: &[u8], prefix: u64, length: u64, payload: &[u8]| {
        let mut bytes = vec![lidarpc::internals::backend::ZSTD];
        write_unsigned(&mut bytes, layout.len() as u64);
        bytes.extend(layout);
        write_unsigned(&mut bytes, prefix);
        write_unsigned(&mut bytes, length);
        bytes.extend(payload);
        vec![Section { kind: SectionKind::Bytes, payload: bytes }]
    };
    let content = lidarpc::internals::backend::compress_quickly(&[7; 64]).unwrap();
    for (layout, prefix, length, payload, records) in [
        (&layout[..], 0, u64::MAX, &content[..], 4),
        (&layout, 0, 1 << 31, &content, 4),
        (&layout, 0, 65, &content, 4),
        (&layout, 0, 63, &content, 4),
        (&layout, 0, 64, &content, 5),
        (&layout, 1, 64, &content, 4),
        (&layout, u64::MAX, 64, &content, 4),
        (&layout, 0, 64, &[], 4),
        (&layout[1..], 0, 64, &content, 4),
        (&[0], 0, 64, &content, 4),
    ] {
        let forged = forged(None, records, whole(layout, prefix, length, payload));
        assert!(decode_files(&forged).is_err(), "{prefix} {length} {records}");
    }
    // The sections after it are out of place.
    let mut frame = whole(&layout, 0, 64, &content);
    frame.push(file_section(&kitti_layout(), 4, 4));
    assert!(decode_files(&forged(None, 4, frame)).is_err());
}

/// A prefix that claims more zeros at its end than it has bytes, or more bytes than are allowed.
#[test]
fn zeros_without_room_are_an_error() {
    for (length, zeros, known) in [
        (3, 4, "more zeros than bytes"),
        (1 << 40, 1 << 40, "bytes of the frame"),
        (4, 4, "record layout is cut short"),
    ] {
        let mut coder = ArithmeticEncoder::default();
        let (mut sizes, mut of_zeros) = (IntegerModel::default(), IntegerModel::default());
        sizes.code(&mut coder, length);
        of_zeros.code(&mut coder, zeros);
        let section = Section { kind: SectionKind::File, payload: coder.finish() };
        let error = decode_files(&forged(None, 4, vec![section])).unwrap_err().to_string();
        assert!(error.contains(known), "{length} {zeros}: {error}");
    }
}

/// A record that takes no bytes could be claimed any number of times.
#[test]
fn records_without_bytes_are_an_error() {
    for layout in [Layout::default(), Layout { fields: vec![Field::padding(8)], ..Layout::default() }] {
        for records in [1, 1 << 24] {
            let frame = vec![file_section(&layout, records, records)];
            assert!(decode_files(&forged(None, records, frame)).is_err(), "{layout:?} {records}");
        }
    }
}

/// Every tick of the finest scanner as a column, with the largest number of beams, would be an image of 370
/// million cells.
#[test]
fn an_image_larger_than_any_scan_is_an_error() {
    let scanner = model(1024, 360_000);
    let mut columns = ArithmeticEncoder::default();
    Hdl64ColumnModel::default().code(&mut columns, scanner.ticks, &mut (0..scanner.ticks).collect());
    let mut frame = vec![file_section(&kitti_layout(), 1000, 0)];
    frame.push(Section { kind: SectionKind::Columns, payload: columns.finish() });
    frame.extend(sections(&IMAGE[1..], &[]));
    let error = decode_files(&forged(Some(&scanner), 1000, frame)).unwrap_err().to_string();
    assert!(error.contains("cells of the range image"), "{error}");
}

/// A few bytes never cause much work, however many points they claim to hold.
#[test]
fn strays_of_bytes_that_are_made_up_are_an_error_in_time() {
    for payload in [&[][..], &[0xff; 3], &[0x55; 40]] {
        let most = 60_000 / 16;
        let mut frame = vec![file_section(&kitti_layout(), most, most)];
        frame.extend(sections(&[SectionKind::Strays, SectionKind::Intensity], payload));
        let error = decode_files(&forged(None, most, frame)).unwrap_err().to_string();
        let is_known = error.contains("strays section ends too early") || error.contains("compressed bytes");
        assert!(is_known, "{error}");
    }
}

/// Random bytes as the sections of an image and its points: with 60 points, as the frame's header says,
/// decoders of every level go as far as their bytes allow.
#[test]
fn random_sections_behind_a_good_file_section() {
    let mut random = Random(9);
    let good = file_section(&kitti_layout(), 60, 7);
    let scanner = model(5, 40);
    let mut errors = BTreeSet::new();
    for round in 0..40 {
        let mut payload: Vec<u8> = (0..30).map(|_| random.number() as u8).collect();
        // The coder reads low bytes as ones: all columns and cells at first, then fewer and fewer.
        payload[0] = (round * 6) as u8;
        let mut frame = vec![good.clone()];
        for &kind in &[&IMAGE[..2], &[SectionKind::Strays], &IMAGE[2..]].concat() {
            frame.push(Section { kind, payload: payload.clone() });
        }
        for modelling in [Modelling::Mixed, Modelling::Deep, Modelling::Light, Modelling::Packed] {
            let error = decode_files(&forged_as(modelling, Some(&scanner), 60, frame.clone())).unwrap_err();
            errors.insert(error.to_string());
        }
    }
    for place in [
        "strays section",
        "the range image",
        "echoes section",
        "token frequencies",
        "tokens:",
        "compressed bytes",
    ] {
        assert!(errors.iter().any(|error| error.contains(place)), "{place} is not reached: {errors:#?}");
    }
}

// ---- streams that would decode to far more than their bytes ----

/// Extremely repetitive files: points at the origin as they are and as text, and no points at all.
fn repeated(points: usize) -> [(String, Vec<u8>); 4] {
    let origin = vec![[0.0; 4]; points];
    let header = format!(
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\nHEIGHT 1\n\
         VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary_compressed\n"
    );
    // LZF of zeros, as compressed by PCL (FORMAT.md 9): two literals, then matches of the byte before.
    let mut packed = vec![1, 0, 0];
    let mut left = 12 * points - 2;
    while left > 2 {
        let most = (left - 2).min(264);
        let length = if most <= 16 { most.max(3) } else { most.max(19) };
        match length - 2 {
            code @ 7.. => packed.extend([7 << 5, (code - 7) as u8, 0]),
            code => packed.extend([(code << 5) as u8, 0]),
        }
        left -= length;
    }
    match left {
        0 => {}
        _ => packed.extend([&[left as u8 - 1][..], &vec![0; left]].concat()),
    }
    let sizes = [packed.len() as u32, 12 * points as u32].map(u32::to_le_bytes).concat();
    [
        ("0.bin".to_owned(), kitti(&origin)),
        ("1.pcd".to_owned(), pcd_text(&origin)),
        ("2.pcd".to_owned(), [header.into_bytes(), sizes, packed].concat()),
        ("3.txt".to_owned(), vec![b'7'; 16 * points]),
    ]
}

/// The number of bytes that a frame may decode to.
fn unfolds(frame: &CodedFrame) -> u64 {
    let bytes: usize = frame.sections.iter().map(|section| section.payload.len()).sum();
    65_536 + 1024 * bytes as u64
}

#[test]
fn files_of_one_thing_repeated_come_back_and_are_paid_for() {
    let mut padded = Vec::new();
    for file in repeated(100_000) {
        let name = file.0.clone();
        let stream = encode_files(std::slice::from_ref(&file), &at_level(1));
        assert!(decode_files(&stream).unwrap() == [file], "{name}");
        let (models, mut groups) = take_apart(&stream);
        let frame = &mut groups[0].frames[0];
        assert!(frame.header.file_size.max(frame.header.point_count) <= unfolds(frame), "{name}");
        // Without its padding it would exceed the limit.
        let sections = frame.sections.len();
        frame.sections.retain(|section| !section.kind.is_skippable());
        if frame.sections.len() < sections {
            let error = decode_files(&put_together(&models, &groups)).map(drop).unwrap_err().to_string();
            assert!(error.contains("so short a frame"), "{name}: {error}");
            padded.push(name);
        }
    }
    assert!(padded.contains(&"0.bin".to_owned()) && padded.contains(&"1.pcd".to_owned()), "{padded:?}");
}

#[test]
fn text_of_a_gigabyte_in_a_few_bytes_is_an_error() {
    let (_, mut groups) = take_apart(&encode_files(&repeated(3)[1..2], &at_level(1)));
    let header = &mut groups[0].frames[0].header;
    (header.file_size, header.point_count) = (1 << 30, 1 << 24);
    let error = decode_files(&put_together(&[], &groups)).unwrap_err().to_string();
    assert!(error.contains("so short a frame"), "{error}");
}

/// They are read, but their tables are not computed: those of 2,000 scanners would take 17 GB.
#[test]
fn scanners_that_no_frame_uses_cost_nothing() {
    let scanner = |number: usize| {
        let constants = BeamConstants { elevation: number as i64, ..BeamConstants::default() };
        let model = Hdl64::new(CoordinateGrid::Millimetre, 360_000, 2000, vec![constants]);
        ScannerRecord { family: 1, payload: Scanner::from(model).to_payload() }
    };
    let scanners: Vec<_> = (0..2000).map(scanner).collect();
    assert_eq!(decode_files(&put_together(&scanners, &[])).unwrap(), []);
    // A group for each, whose frame has no range image.
    let files = [("0.txt".to_owned(), b"no scan".to_vec())];
    let (_, groups) = take_apart(&encode_files(&files, &at_level(1)));
    let group = |scanner: &ScannerRecord| Group { scanners: vec![Some(scanner.id())], ..groups[0].clone() };
    let groups: Vec<_> = scanners.iter().map(group).collect();
    assert_eq!(decode_files(&put_together(&scanners, &groups)).unwrap().len(), scanners.len());
}

#[test]
fn plain_bits_are_as_many_as_the_format_allows() {
    // The largest number that the length prefix can express.
    let mut coder = ArithmeticEncoder::default();
    coder.code_plain(u64::MAX, 64);
    let payload = coder.finish();
    for kind in IMAGE {
        let mut parts = STREAMS[0].clone();
        for section in parts.1.iter_mut().flat_map(|g| &mut g.frames).flat_map(|f| &mut f.sections) {
            if section.kind == kind {
                section.payload.clone_from(&payload);
            }
        }
        assert!(decode_files(&put_together(&parts.0, &parts.1)).is_err(), "{kind}");
    }
}
