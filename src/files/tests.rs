//! Tests that files of all kinds, supported or not, are restored.

use std::io::Write;
use std::path::Path;

use proptest::prelude::*;

use super::*;
use crate::ground::error::Error;
use crate::scan::{
    Axis, Channel, Column, Field, Layout, LzfDialect, NumberRule, PointCloud, ScalarType, Separator,
    TextFormat, Widening,
};

/// Little-endian bytes of float32 values.
pub(super) fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A PCD header as PCL writes it.
pub(super) fn pcd(fields: &str, sizes: &str, types: &str, counts: &str, points: u64, data: &str) -> Vec<u8> {
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\n\
         TYPE {types}\nCOUNT {counts}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {points}\nDATA {data}\n"
    )
    .into_bytes()
}

/// Bytes of a small generator, drawn from few values so that matches of all lengths occur.
pub(super) fn sample(length: usize, values: u32, run: u32) -> Vec<u8> {
    let mut state = 12345u32;
    let mut next = || {
        state = state.wrapping_mul(1664525).wrapping_add(1013904223);
        state >> 16
    };
    let mut bytes = Vec::new();
    while bytes.len() < length {
        if next() % run == 0 && bytes.len() > 300 {
            let offset = 1 + next() as usize % bytes.len().min(9000);
            let take = next() as usize % 400;
            let from = bytes.len() - offset;
            for i in 0..take {
                bytes.push(bytes[from + i]);
            }
        } else {
            bytes.push((next() % values) as u8);
        }
    }
    bytes.truncate(length);
    bytes
}

/// Parses a file and checks that the same bytes and the same name are restored, and the layout from its
/// serialised form.
pub(super) fn comes_back(name: &str, bytes: Vec<u8>) -> ScanFile {
    let file = parse(name, bytes.clone());
    assert_eq!(file.name, name);
    assert!(file.to_bytes().unwrap() == bytes, "{name} comes back changed");
    let mut layout = Vec::new();
    file.layout.write_to(&mut layout);
    assert_eq!(Layout::read_from(&mut &layout[..]).unwrap(), file.layout);
    file
}

#[test]
fn unknown_kinds_are_opaque() {
    for name in ["", "scan", "scan.txt", "scan.bin.gz", "bin"] {
        let file = comes_back(name, vec![1; 40]);
        assert!(file.is_opaque());
        assert_eq!((file.prefix.len(), file.records), (40, 0));
    }
}

#[test]
fn files_of_others_have_records_and_come_back() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/formats");
    let Ok(entries) = std::fs::read_dir(&folder) else {
        // Where the test harness does not hide it.
        let _ = writeln!(std::io::stderr(), "skipped: there is no {}", folder.display());
        return;
    };
    let mut kinds = Vec::new();
    for entry in entries {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        let file = comes_back(name, std::fs::read(&path).unwrap());
        assert!(file.records > 10_000, "{name} has {} records", file.records);
        assert!(file.layout.position.is_some() && file.layout.intensity.is_some(), "{name}");
        // Some versions of PCL leave the rest of a memory page after the points.
        assert!(file.suffix.len() < 4096, "{name} has {} bytes left over", file.suffix.len());
        kinds.push(name.split_once('.').map(|(_, kind)| kind.to_owned()).unwrap());
    }
    kinds.sort();
    assert_eq!(kinds, ["pcd", "pcd.bin", "ply"]);
}

/// A file that a damaged stream could have made.
fn forged(wrapping: Wrapping) -> ScanFile {
    let fields = ["x", "y", "z", "i"].map(|name| Field::new(name, ScalarType::F32)).to_vec();
    let layout = Layout { wrapping, fields, position: Some([0, 1, 2]), intensity: Some(3) };
    let cloud = PointCloud { positions: vec![[f32::NAN; 3]; 2], intensity: vec![1.0; 2], channels: vec![] };
    ScanFile { layout, records: 2, cloud, ..ScanFile::default() }
}

fn wrappings() -> [Wrapping; 9] {
    let column = Column { scalar: ScalarType::F32, rule: NumberRule::Fixed(40) };
    let decimal = Widening::Decimal(column.rule);
    let format = TextFormat { separator: Separator::Tab, columns: vec![column; 4], ..TextFormat::default() };
    [
        Wrapping::Plain,
        Wrapping::PcdCompressed { lzf: LzfDialect::Ultra16 },
        Wrapping::Text(format),
        Wrapping::BigEndian,
        Wrapping::Scaled([Axis { per_metre: 1000.0, offset: -1.0 }; 3]),
        Wrapping::Widened(vec![Widening::Exact, Widening::None, decimal, Widening::Exact]),
        Wrapping::Widened(vec![Widening::Steps(Axis { per_metre: 200.0, offset: -100.0 }); 4]),
        Wrapping::ByField(vec![decimal; 4]),
        Wrapping::Widened(vec![Widening::Half; 4]),
    ]
}

#[test]
fn files_with_the_same_header_are_compared_field_by_field() {
    let file = |name: &str, value: f32| {
        [pcd(name, "4 4 4 4", "F F F F", "1 1 1 1", 2, "binary"), floats(&[value; 8])].concat()
    };
    // As if padding had been guessed elsewhere.
    let mut like = parse("a.pcd", file("x y z i", 1.0));
    like.layout = plain_layout(vec![Field::new("x", ScalarType::F32), Field::padding(12)]).unwrap();
    let same = parse_like(&like, "b.pcd", file("x y z i", 2.0));
    assert_eq!((same.records, &same.layout, &same.name[..]), (2, &like.layout, "b.pcd"));
    let other = parse_like(&like, "b.pcd", file("x y z j", 2.0));
    assert_eq!(other.layout.position, Some([0, 1, 2]));
}

#[test]
fn clouds_that_do_not_fit_their_layout_are_refused() {
    for wrapping in wrappings() {
        assert!(forged(wrapping.clone()).to_bytes().is_ok());
        let damages: [fn(&mut ScanFile); 8] = [
            |f| f.records = 3,
            |f| f.records = usize::MAX,
            |f| f.cloud.positions.truncate(1),
            |f| f.cloud.intensity.push(0.0),
            |f| f.cloud.channels.push(Channel { field: Field::padding(1), bytes: vec![0; 2] }),
            |f| f.layout.fields.push(Field::padding(1)),
            |f| f.layout.intensity = None,
            |f| f.layout.position = Some([0, 1, 3]),
        ];
        for (number, damage) in damages.into_iter().enumerate() {
            let mut file = forged(wrapping.clone());
            damage(&mut file);
            assert!(matches!(file.to_bytes(), Err(Error::Corrupt { .. })), "{wrapping:?} {number}");
        }
    }
}

#[test]
fn a_file_without_records_may_not_count_any() {
    let file = ScanFile { records: usize::MAX, ..ScanFile::default() };
    assert!(file.to_bytes().is_err());
}

/// Names with extensions of all kinds.
fn any_name() -> impl Strategy<Value = String> {
    (
        "[a-z]{0,3}",
        prop::sample::select(vec![
            ".bin", ".pcd.bin", ".pcd", ".PCD", ".ply", ".txt", ".csv", ".npy", ".las", ".feather", "",
        ]),
    )
        .prop_map(|(stem, extension)| stem + extension)
}

/// A valid file of any kind, with few points, whose values make both short and long text.
fn any_good_file() -> impl Strategy<Value = (String, Vec<u8>)> {
    let value = prop_oneof![
        any::<f32>(),
        (-9999i32..9999).prop_map(|n| n as f32 / 1000.0),
        prop::sample::select(vec![0.0, -0.0, f32::NAN, f32::INFINITY, 1e-5, 1e7, 0.5]),
    ];
    (prop::collection::vec((value, any::<u16>()), 0..30), 0..13usize).prop_map(|(values, kind)| {
        let points = values.len() as u64;
        let header = |data| pcd("x y z ring", "4 4 4 2", "F F F U", "1 1 1 1", points, data);
        let x: Vec<f32> = values.iter().map(|v| v.0).collect();
        let rings: Vec<u8> = values.iter().flat_map(|v| v.1.to_le_bytes()).collect();
        match kind {
            0 => ("a.bin".into(), floats(&x)),
            12 => ("a.feather".into(), arrow::tests::file_of(&values)),
            1 => ("a.pcd.bin".into(), floats(&x)),
            2 => {
                let records = values
                    .iter()
                    .flat_map(|(x, ring)| [floats(&[*x; 3]), ring.to_le_bytes().to_vec()].concat());
                ("a.pcd".into(), header("binary").into_iter().chain(records).collect())
            }
            3 => {
                let planes = [floats(&x), floats(&x), floats(&x), rings].concat();
                let packed = lzf::compress(&planes, LzfDialect::Very16);
                let sizes = [packed.len() as u32, planes.len() as u32].map(u32::to_le_bytes).concat();
                ("a.pcd".into(), [header("binary_compressed"), sizes, packed].concat())
            }
            4 => {
                let lines = values.iter().map(|(x, r)| format!("{x:.3} {x:.8e} {x} {r}\n"));
                (
                    "a.pcd".into(),
                    header("ascii").into_iter().chain(lines.collect::<String>().into_bytes()).collect(),
                )
            }
            5 => {
                let lines = values.iter().map(|(x, r)| format!("{x:?} {x:.2} {} {r}\r\n", f64::from(*x)));
                (
                    "a.pcd".into(),
                    header("ascii").into_iter().chain(lines.collect::<String>().into_bytes()).collect(),
                )
            }
            9 => {
                let lines = values.iter().map(|(x, r)| format!("{x:.3},{x:.8e},{x},{r}\r\n"));
                ("a.csv".into(), format!("x,y,z,ring\r\n{}", lines.collect::<String>()).into_bytes())
            }
            10 => {
                let lines = values.iter().map(|(x, r)| format!("{x:.3}; {x:?}; {r}; {r};\n"));
                ("a.txt".into(), lines.collect::<String>().trim_end().as_bytes().to_vec())
            }
            11 => {
                let fields = ["x", "y", "z"].map(|name| (name, ScalarType::F32));
                let header = numpy::header(&fields, values.len() + 1);
                ("a.npy".into(), [header, floats(&x)].concat())
            }
            _ => {
                let encoding = ["binary_little_endian", "binary_big_endian", "ascii"][kind - 6];
                let header = format!(
                    "ply\nformat {encoding} 1.0\nelement vertex {points}\nproperty float x\n\
                     property float y\nproperty float z\nelement face 0\n\
                     property list uchar int vertex_indices\nend_header\n"
                );
                let records = x.iter().flat_map(|x| match kind {
                    6 => floats(&[*x; 3]),
                    7 => [*x; 3].iter().flat_map(|x| x.to_be_bytes()).collect(),
                    _ => format!("{x} {x:.3} {x:e}\n").into_bytes(),
                });
                ("a.ply".into(), header.into_bytes().into_iter().chain(records).collect())
            }
        }
    })
}

proptest! {
    #[test]
    fn any_bytes_come_back(name in any_name(), bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        comes_back(&name, bytes);
    }

    #[test]
    fn good_files_come_back((name, bytes) in any_good_file()) {
        let file = comes_back(&name, bytes);
        // Text is opaque if no rule fits; the others never are.
        let is_text = file.prefix.windows(6).any(|w| w == b" ascii") || [".csv", ".txt"].contains(&&file.name[1..]);
        prop_assert!(is_text || !file.is_opaque());
    }

    /// Changes, inserts and removes bytes anywhere, mostly in the header; replaces words by awkward ones;
    /// cuts off the end.
    #[test]
    fn damaged_files_come_back(
        (name, mut bytes) in any_good_file(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..5), 1..4),
    ) {
        let words = ["-1", "0", "18446744073709551615", "4294967296", "binary_compressed", "nan"];
        for (place, value, kind) in edits {
            if bytes.is_empty() {
                break;
            }
            let at = place.index(bytes.len());
            match kind {
                0 => bytes[at] = value,
                1 => bytes.insert(at, value),
                2 => drop(bytes.remove(at)),
                3 => bytes.truncate(at),
                _ => {
                    let word = words[usize::from(value) % words.len()];
                    let end = bytes[at..].iter().position(u8::is_ascii_whitespace).map_or(at, |n| at + n);
                    let start = bytes[..at].iter().rposition(u8::is_ascii_whitespace).map_or(0, |n| n + 1);
                    drop(bytes.splice(start..end, word.bytes()));
                }
            }
        }
        comes_back(&name, bytes);
    }

    /// Whatever layout and sizes a stream has, writing returns bytes or an error.
    #[test]
    fn any_layout_is_written_or_refused(
        layout in prop::collection::vec(0u8..10, 2..40),
        counts in (0usize..4, 0usize..4, 0usize..4, 0usize..9),
        fitting in any::<bool>(),
    ) {
        let Ok(layout) = Layout::read_from(&mut &layout[..]) else { return Ok(()) };
        let (records, positions, intensities, values) = match fitting {
            false => counts,
            true => {
                let n = if layout.stride() == 0 { 0 } else { counts.0 };
                let (p, i) = (layout.position.is_some(), layout.intensity.is_some());
                (n, n * usize::from(p), n * usize::from(i), n)
            }
        };
        let channel = |field: &Field| Channel { field: field.clone(), bytes: vec![0xa5; values * field.width()] };
        let channels = layout.channels().map(|(_, field)| channel(field)).collect();
        let cloud = PointCloud {
            positions: vec![[-1.5e-30, f32::NAN, 3.4e38]; positions],
            intensity: vec![f32::INFINITY; intensities],
            channels,
        };
        let file = ScanFile { layout, records, cloud, ..ScanFile::default() };
        // These fit their prefix, too, or are refused.
        let is_arrow = matches!(file.layout.wrapping, Wrapping::Arrow { .. });
        prop_assert!(file.to_bytes().is_ok() || !fitting || is_arrow);
    }
}

#[test]
fn counts_are_replaced_and_the_rest_stays() {
    let pcd = b"# .PCD\nFIELDS x\nWIDTH 100\nHEIGHT 2\r\nPOINTS  200\nDATA binary\n";
    let fewer = b"# .PCD\nFIELDS x\nWIDTH 7\nHEIGHT 1\r\nPOINTS  7\nDATA binary\n";
    assert_eq!(with_point_count(pcd, 7), fewer);
    let ply = b"ply\ncomment POINTS 3\nelement vertex 20\nelement face 3\nPOINTS 3\n";
    let fewer = b"ply\ncomment POINTS 3\nelement vertex 7\nelement face 3\nPOINTS 3\n";
    assert_eq!(with_point_count(ply, 7), fewer);
    assert_eq!(with_point_count(b"", 7), b"");
}
