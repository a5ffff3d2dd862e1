//! PCD, the point cloud files of the Point Cloud Library: the header, dispatch by encoding of the data, and
//! compressed bodies.
//!
//! Source: "The PCD (Point Cloud Data) file format" (PCL documentation) and PCL's `pcd_io.cpp`.
//!
//! The body of a `binary_compressed` PCD is u32 compressed size, u32 uncompressed size, and the records field
//! by field (all x, then all y, ...), compressed with LZF. FORMAT.md 9.

use byteorder::{ByteOrder, LittleEndian};

use super::field::{Declared, layout_of, next_line};
use super::{by_field, lzf, places, records, text_records, widened};
use crate::ground::error::{Error, Result};
use crate::scan::{Layout, LzfDialect, ScalarType, ScanFile, Wrapping};

/// The encodings of the data.
#[derive(Clone, Copy)]
enum Data {
    Ascii,
    Binary,
    Compressed,
}

/// The contents of a header.
pub(super) struct Header<'a> {
    /// The fields; one entry for all values of a field with COUNT above 1.
    pub fields: Vec<Declared<'a>>,
    /// Number of points, which may be wrong: the body decides.
    points: u64,
    data: Data,
    /// Bytes of the header, including the line end after `DATA`.
    length: usize,
}

/// The points as records, the header as `prefix`, the remaining bytes as `suffix`. `None` if the header is
/// damaged or the body cannot be restored exactly.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let Header { fields, points, data, length } = header;
    let as_declared = || fields.iter().filter_map(Declared::field).collect();
    match data {
        Data::Binary => {
            let found = places::find(&fields, bytes.get(length..)?, points).unwrap_or_else(as_declared);
            widened::parse(layout_of(found, Wrapping::Plain)?, &[], bytes, length, points)
        }
        Data::Compressed => parse_compressed(layout_of(as_declared(), Wrapping::Plain)?, bytes, length),
        Data::Ascii => text_records::parse(&fields, bytes, length, points),
    }
}

impl<'a> Header<'a> {
    /// Reads the header that `bytes` begin with; `None` if it is damaged.
    pub(super) fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut rest = bytes;
        let (mut names, mut sizes, mut types, mut counts) = (vec![], vec![], vec![], vec![]);
        let (mut width, mut height, mut points) = (None, None, None);
        let data = loop {
            let line = next_line(&mut rest)?;
            let mut words = line.split_ascii_whitespace();
            let Some(keyword) = words.next() else { continue };
            let words: Vec<&str> = words.collect();
            match (keyword, &words[..]) {
                ("VERSION" | "VIEWPOINT", _) => {}
                // The oldest files say COLUMNS.
                ("FIELDS" | "COLUMNS", _) => names = words,
                ("SIZE", _) => sizes = words,
                ("TYPE", _) => types = words,
                ("COUNT", _) => counts = words,
                ("WIDTH", [n]) => width = Some(n.parse::<u64>().ok()?),
                ("HEIGHT", [n]) => height = Some(n.parse::<u64>().ok()?),
                ("POINTS", [n]) => points = Some(n.parse::<u64>().ok()?),
                ("DATA", ["ascii"]) => break Data::Ascii,
                ("DATA", ["binary"]) => break Data::Binary,
                ("DATA", ["binary_compressed"]) => break Data::Compressed,
                _ if keyword.starts_with('#') => {}
                _ => return None,
            }
        };
        if counts.is_empty() {
            counts = vec!["1"; names.len()];
        }
        if sizes.len() != names.len() || types.len() != names.len() || counts.len() != names.len() {
            return None;
        }
        let declarations = names.into_iter().zip(sizes).zip(types).zip(counts);
        let fields = declarations.map(|(((name, size), kind), count)| field(name, size, kind, count));
        Some(Header {
            fields: fields.collect::<Option<_>>()?,
            points: points.or_else(|| width?.checked_mul(height?))?,
            data,
            length: bytes.len() - rest.len(),
        })
    }
}

fn field<'a>(name: &'a str, size: &str, kind: &str, count: &str) -> Option<Declared<'a>> {
    let size = size.parse().ok().filter(|s| matches!(s, 1 | 2 | 4 | 8))?;
    let count: u32 = count.parse().ok()?;
    let scalar = match (kind, size) {
        ("I", 1) => Some(ScalarType::I8),
        ("I", 2) => Some(ScalarType::I16),
        ("I", 4) => Some(ScalarType::I32),
        ("I", 8) => Some(ScalarType::I64),
        ("U", 1) => Some(ScalarType::U8),
        ("U", 2) => Some(ScalarType::U16),
        ("U", 4) => Some(ScalarType::U32),
        ("U", 8) => Some(ScalarType::U64),
        ("F", 4) => Some(ScalarType::F32),
        ("F", 8) => Some(ScalarType::F64),
        // Half precision; in a binary body it is treated as two bytes without a known meaning.
        ("F", _) => None,
        _ => return None,
    };
    Some(Declared { name, scalar, width: count.checked_mul(size)? })
}

/// Bytes before the compressed data: the two sizes.
const SIZES: usize = 8;

/// Splits a file whose body starts at byte `start`. `None` if the body is damaged, or if none of the known
/// compressors would write it.
fn parse_compressed(layout: Layout, bytes: &[u8], start: usize) -> Option<ScanFile> {
    let (sizes, rest) = bytes.get(start..)?.split_at_checked(SIZES)?;
    let packed_size = LittleEndian::read_u32(sizes) as usize;
    let size = LittleEndian::read_u32(&sizes[4..]) as usize;
    let (packed, suffix) = rest.split_at_checked(packed_size)?;
    let planes = lzf::decompress(packed, size)?;
    let stride = layout.stride();
    if planes.len() % stride != 0 {
        return None;
    }
    let lzf = LzfDialect::ALL.into_iter().find(|&dialect| lzf::compress(&planes, dialect) == packed)?;
    let body = by_field::to_records(&planes, &layout.fields);
    let (layout, cloud) = records::split(layout, &body);
    Some(ScanFile {
        name: String::new(),
        layout: Layout { wrapping: Wrapping::PcdCompressed { lzf }, ..layout },
        prefix: bytes[..start].to_vec(),
        records: planes.len() / stride,
        cloud,
        suffix: suffix.to_vec(),
    })
}

/// The body with these records.
///
/// # Errors
/// [`Error::Corrupt`] if the records take more than the 4 GiB that the format allows.
pub(super) fn write_compressed(body: &[u8], layout: &Layout, dialect: LzfDialect) -> Result<Vec<u8>> {
    let too_long = |_| Error::corrupt("records too long for a compressed PCD file");
    let size = u32::try_from(body.len()).map_err(too_long)?;
    let packed = lzf::compress(&by_field::from_records(body, &layout.fields), dialect);
    let packed_size = u32::try_from(packed.len()).map_err(too_long)?;
    Ok([&packed_size.to_le_bytes()[..], &size.to_le_bytes(), &packed].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::{comes_back, floats, pcd};

    #[test]
    fn binary_fields_go_where_they_belong() {
        let header = pcd("_ x y z i label", "1 4 4 4 4 2", "U F F F F U", "4 1 1 1 1 1", 2, "binary");
        let record = [vec![1, 2, 3, 4], floats(&[1.0, 2.0, 3.0, 0.5]), vec![5, 6]].concat();
        let scan = comes_back("a.pcd", [header.clone(), record.clone(), record, vec![9; 30]].concat());
        assert_eq!(scan.prefix, header);
        assert_eq!(scan.layout.position_offsets(), Some([4, 8, 12]));
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0]; 2]);
        assert_eq!(scan.cloud.intensity, [0.5; 2]);
        let [padding, label] = &scan.cloud.channels[..] else { panic!("{:?}", scan.layout) };
        assert_eq!((&padding.field.name[..], &padding.bytes[..]), ("", &[1, 2, 3, 4, 1, 2, 3, 4][..]));
        assert_eq!((&label.field.name[..], &label.bytes[..]), ("label", &[5, 6, 5, 6][..]));
        assert_eq!(scan.suffix, [9; 30], "bytes after the last point");
    }

    #[test]
    fn a_cut_body_keeps_its_whole_records() {
        let header = pcd("x y z", "4 4 4", "F F F", "1 1 1", u64::MAX, "binary");
        let scan = comes_back("a.pcd", [header, vec![1; 40]].concat());
        assert_eq!((scan.records, scan.suffix.len()), (3, 4));
    }

    #[test]
    fn double_positions_are_channels() {
        let header = pcd("x y z intensity", "8 8 8 4", "F F F F", "1 1 1 1", 1, "binary");
        let scan = comes_back("a.pcd", [header, vec![1; 28]].concat());
        assert_eq!((scan.records, scan.layout.position, scan.layout.intensity), (1, None, Some(3)));
        assert_eq!(scan.cloud.channel("y").map(|y| y.field.scalar), Some(ScalarType::F64));
    }

    #[test]
    fn count_and_points_may_be_missing() {
        let text = String::from_utf8(pcd("x y z", "4 4 4", "F F F", "1 1 1", 2, "binary")).unwrap();
        let text = text.replace("COUNT 1 1 1\n", "").replace("POINTS 2\n", "");
        let scan = comes_back("a.pcd", [text.as_bytes(), &[1; 30]].concat());
        assert_eq!((scan.records, scan.suffix.len()), (2, 6));
    }

    #[test]
    fn records_without_bytes_are_opaque() {
        let header = pcd("x y z", "4 4 4", "F F F", "0 0 0", 161, "binary");
        assert!(comes_back("a.pcd", [header, vec![1; 200]].concat()).is_opaque());
    }

    #[test]
    fn damaged_headers_are_opaque() {
        let good = pcd("x y z", "4 4 4", "F F F", "1 1 1", 2, "binary");
        let good = String::from_utf8(good).unwrap();
        for (from, to) in [
            ("FIELDS", "FIELD"),
            ("SIZE 4 4 4", "SIZE 4 4"),
            ("SIZE 4 4 4", "SIZE 4 4 3"),
            ("SIZE 4 4 4", "SIZE 4 4 -4"),
            ("TYPE F", "TYPE X"),
            ("COUNT 1", "COUNT 4294967295"),
            ("COUNT 1", "COUNT 16383"),
            ("POINTS 2", "POINTS 99999999999999999999"),
            ("DATA binary", "DATA bin"),
            ("DATA binary\n", "DATA binary"),
            ("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n", ""),
        ] {
            let broken = good.replacen(from, to, 1);
            assert_ne!(broken, good);
            let scan = comes_back("a.pcd", [broken.as_bytes(), &[1; 24]].concat());
            assert!(scan.is_opaque(), "{to}");
        }
    }

    /// 200 points whose y is constant, so that there is something to compress.
    fn planes() -> Vec<u8> {
        let x: Vec<f32> = (0..200).map(|i| i as f32 * 0.25).collect();
        [floats(&x), floats(&[1.5; 200]), floats(&x), (0..200).collect()].concat()
    }

    fn file(packed: &[u8], size: usize) -> Vec<u8> {
        let header = pcd("x y z ring", "4 4 4 1", "F F F U", "1 1 1 1", 200, "binary_compressed");
        let sizes = [(packed.len() as u32).to_le_bytes(), (size as u32).to_le_bytes()].concat();
        [header, sizes, packed.to_vec()].concat()
    }

    #[test]
    fn fields_are_gathered_into_records() {
        for dialect in LzfDialect::ALL {
            let mut bytes = file(&lzf::compress(&planes(), dialect), 2600);
            bytes.extend(b"more");
            let scan = comes_back("a.pcd", bytes);
            assert_eq!(scan.records, 200);
            assert_eq!(scan.cloud.positions[3], [0.75, 1.5, 0.75]);
            assert_eq!(scan.cloud.channels[0].bytes[199], 199);
            assert_eq!(scan.suffix, b"more");
        }
    }

    #[test]
    fn bytes_of_another_compressor_are_opaque() {
        let stored: Vec<u8> = planes().chunks(10).flat_map(|c| [&[9], c].concat()).collect();
        assert_eq!(lzf::decompress(&stored, 2600).unwrap(), planes());
        assert!(comes_back("a.pcd", file(&stored, 2600)).is_opaque());
    }

    #[test]
    fn damaged_sizes_are_opaque() {
        let packed = lzf::compress(&planes(), LzfDialect::Ultra13);
        for size in [0, 2599, 2601, u32::MAX as usize] {
            assert!(comes_back("a.pcd", file(&packed, size)).is_opaque(), "{size}");
        }
        let whole = file(&packed, 2600);
        assert!(comes_back("a.pcd", whole[..whole.len() - 1].to_vec()).is_opaque());
    }

    #[test]
    fn no_points_are_no_records() {
        let scan = comes_back("a.pcd", file(&[], 0));
        assert_eq!((scan.records, scan.is_opaque()), (0, false));
    }
}
