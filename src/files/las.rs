//! LAS: records of fixed size after a header that gives the step size of their integer coordinates
//! (FORMAT.md 9).
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15". Compressed files (LAZ) are not read as records.

use byteorder::{ByteOrder, LittleEndian};

use super::field::layout_of;
use super::records::{Parts, plain_file};
use crate::ground::floats::round_ties_even;
use crate::scan::{Axis, Field, Layout, ScalarType, ScanFile, Wrapping};

const MAGIC: &[u8] = b"LASF";
/// Bytes of the header up to version 1.2; later headers are longer.
const LEAST_HEADER: usize = 227;
/// Bytes of the header of version 1.4, which has a 64-bit number of points.
const HEADER_1_4: usize = 375;
// Offsets of the header's fields.
const HEADER_SIZE: usize = 94;
const START: usize = 96;
const FORMAT: usize = 104;
const RECORD_SIZE: usize = 105;
const OLD_COUNT: usize = 107;
const SCALES: usize = 131;
const OFFSETS: usize = 155;
const COUNT: usize = 247;

/// The names of coordinates that are kept as the integers of the file.
pub(super) const STEPS: [&str; 3] = ["x_steps", "y_steps", "z_steps"];

/// The properties of the records according to the header.
pub(super) struct Header {
    /// The fields other than x, y and z, which come first.
    others: Vec<Field>,
    /// Metres per step, and the coordinate of step 0 in metres, for x, y and z.
    scales: [[f64; 2]; 3],
    records: u64,
    /// Offset of the first record.
    start: usize,
}

impl Header {
    /// Reads the header that `bytes` begin with; `None` if it is damaged or has an unknown format, or if the
    /// records are compressed.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        let header = bytes.get(..LEAST_HEADER).filter(|header| header.starts_with(MAGIC))?;
        let mut others = fields(header[FORMAT])?;
        let known = 12 + others.iter().map(Field::width).sum::<usize>();
        let size = usize::from(LittleEndian::read_u16(&header[RECORD_SIZE..]));
        match size.checked_sub(known)? {
            0 => {}
            // Fields defined by the file.
            more => others.push(Field::padding(more as u32)),
        }
        let number = |at: usize| LittleEndian::read_f64(&header[at..]);
        let scales = [0, 8, 16].map(|axis| [number(SCALES + axis), number(OFFSETS + axis)]);
        let new_count = match LittleEndian::read_u16(&header[HEADER_SIZE..]) as usize {
            HEADER_1_4.. => bytes.get(COUNT..COUNT + 8).map(LittleEndian::read_u64),
            _ => None,
        };
        let old_count = LittleEndian::read_u32(&header[OLD_COUNT..]).into();
        let records = new_count.filter(|count| *count > 0).unwrap_or(old_count);
        Some(Header { others, scales, records, start: LittleEndian::read_u32(&header[START..]) as usize })
    }

    /// How coordinates follow from the integers: with the header's offset, rounded to whole steps (many
    /// programs write the least coordinates, unrounded); or with offset 0, in case float32 is too coarse for
    /// the former, as on a map. Only for steps that are decimal fractions of a metre, since the models know
    /// such grids.
    fn axes(&self) -> Option<[[Axis; 3]; 2]> {
        let per_metre = |scale: f64| [1.0, 10.0, 1e2, 1e3, 1e4, 1e5].into_iter().find(|n| 1.0 / n == scale);
        let [x, y, z] = self.scales.map(|[scale, offset]| {
            let per_metre = per_metre(scale)?;
            let offset = round_ties_even(offset * per_metre) / per_metre;
            offset.is_finite().then_some([Axis { per_metre, offset }, Axis { per_metre, offset: 0.0 }])
        });
        let (x, y, z) = (x?, y?, z?);
        Some([0, 1].map(|way| [x[way], y[way], z[way]]))
    }
}

/// Metres per step, and the coordinate of step 0 in metres, for x, y and z, of a file that begins with these
/// bytes; `None` for other files.
pub(super) fn scales(header: &[u8]) -> Option<[[f64; 2]; 3]> {
    Some(Header::parse(header)?.scales)
}

/// Splits a file. `None` if its header is not supported.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let with = |names: [&str; 3], scalar: ScalarType| {
        let coordinates = names.map(|name| Field::new(name, scalar));
        layout_of([&coordinates[..], &header.others].concat(), Wrapping::Plain)
    };
    let scaled = header.axes().into_iter().flatten().find_map(|axes| {
        parse_scaled(with(["x", "y", "z"], ScalarType::F32)?, axes, bytes, header.start, header.records)
    });
    // The fallback: integers, which are not known as coordinates.
    let plain = || {
        let layout = with(STEPS, ScalarType::I32)?;
        plain_file(layout, bytes, header.start, header.records)
    };
    scaled.or_else(plain)
}

/// The header with another number of points. The numbers of points by return are not changed.
pub(super) fn with_point_count(header: &[u8], points: usize) -> Option<Vec<u8>> {
    Header::parse(header)?;
    let mut header = header.to_vec();
    if LittleEndian::read_u32(&header[OLD_COUNT..]) > 0 {
        LittleEndian::write_u32(&mut header[OLD_COUNT..], u32::try_from(points).unwrap_or(0));
    }
    if usize::from(LittleEndian::read_u16(&header[HEADER_SIZE..])) >= HEADER_1_4 && header.len() >= COUNT + 8
    {
        LittleEndian::write_u64(&mut header[COUNT..], points as u64);
    }
    Some(header)
}

/// The fields after the coordinates in a record of this format; `None` if it is unknown, as for compressed
/// records, which are marked by a bit of `format`.
fn fields(format: u8) -> Option<Vec<Field>> {
    use ScalarType::{F32, F64, I8, I16, U8, U16, U32, U64};
    let of = |fields: &[(&str, ScalarType)]| -> Vec<Field> {
        fields.iter().map(|(name, scalar)| Field::new(name, *scalar)).collect()
    };
    let (old, new) = (
        [("intensity", U16), ("returns", U8), ("classification", U8), ("scan_angle", I8), ("user_data", U8)],
        [("intensity", U16), ("returns", U8), ("flags", U8), ("classification", U8), ("user_data", U8)],
    );
    let (angle, source, time) = ([("scan_angle", I16)], [("point_source", U16)], [("gps_time", F64)]);
    let colour = [("red", U16), ("green", U16), ("blue", U16)];
    let infrared = [("infrared", U16)];
    let wave = [("wave_descriptor", U8), ("wave_start", U64), ("wave_size", U32)];
    let wave_of_return = [("wave_return", F32), ("wave_x", F32), ("wave_y", F32), ("wave_z", F32)];
    let mut parts: Vec<&[(&str, ScalarType)]> = match format {
        0..=5 => vec![&old, &source],
        6..=10 => vec![&new, &angle, &source, &time],
        _ => return None,
    };
    if matches!(format, 1 | 3 | 4 | 5) {
        parts.push(&time);
    }
    if matches!(format, 2 | 3 | 5 | 7 | 8 | 10) {
        parts.push(&colour);
    }
    if matches!(format, 8 | 10) {
        parts.push(&infrared);
    }
    if matches!(format, 4 | 5 | 9 | 10) {
        parts.extend([&wave[..], &wave_of_return]);
    }
    Some(parts.into_iter().flat_map(of).collect())
}

/// Splits a file whose records follow one another from byte `start` on, at most `count` of them. The layout
/// has float32 fields x, y and z in place of the integers. `None` if the layout is not valid, or if some
/// integer could not be restored from its float32 value.
fn parse_scaled(layout: Layout, axes: [Axis; 3], bytes: &[u8], start: usize, count: u64) -> Option<ScanFile> {
    let layout = Layout { wrapping: Wrapping::Scaled(axes), ..layout };
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), count)?;
    let mut metres = parts.body.to_vec();
    to_metres(&mut metres, &layout, &axes);
    let mut again = metres.clone();
    to_steps(&mut again, &layout, &axes);
    (again == parts.body).then(|| parts.file(layout, &metres))
}

fn to_metres(body: &mut [u8], layout: &Layout, axes: &[Axis; 3]) {
    each_coordinate(body, layout, axes, |axis, value| {
        LittleEndian::write_f32(value, axis.metres(LittleEndian::read_i32(value)));
    });
}

/// Converts the coordinates in whole records to the integers of the file.
pub(super) fn to_steps(body: &mut [u8], layout: &Layout, axes: &[Axis; 3]) {
    each_coordinate(body, layout, axes, |axis, value| {
        LittleEndian::write_i32(value, axis.steps(LittleEndian::read_f32(value), [i32::MIN, i32::MAX]));
    });
}

fn each_coordinate(body: &mut [u8], layout: &Layout, axes: &[Axis; 3], change: impl Fn(&Axis, &mut [u8])) {
    let Some(offsets) = layout.position_offsets() else { return };
    for record in body.chunks_exact_mut(layout.stride().max(1)) {
        for (at, axis) in offsets.into_iter().zip(axes) {
            change(axis, &mut record[at..at + 4]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::comes_back;
    use crate::files::{FileFormat, convert, starts_as_scan, with_point_count};
    use crate::scan::Layout;

    /// A file of version 1.2, or of version 1.4 for formats from 6 on.
    fn file(format: u8, scale: f64, offset: f64, records: &[Vec<u8>]) -> Vec<u8> {
        let is_new = format >= 6;
        let size = if is_new { HEADER_1_4 } else { LEAST_HEADER };
        let mut header = vec![0; size + 9];
        header[..4].copy_from_slice(MAGIC);
        header[24..26].copy_from_slice(&[1, if is_new { 4 } else { 2 }]);
        LittleEndian::write_u16(&mut header[HEADER_SIZE..], size as u16);
        LittleEndian::write_u32(&mut header[START..], size as u32 + 9);
        header[FORMAT] = format;
        LittleEndian::write_u16(&mut header[RECORD_SIZE..], records.first().map_or(20, Vec::len) as u16);
        match is_new {
            true => LittleEndian::write_u64(&mut header[COUNT..], records.len() as u64),
            false => LittleEndian::write_u32(&mut header[OLD_COUNT..], records.len() as u32),
        }
        for axis in [0, 8, 16] {
            LittleEndian::write_f64(&mut header[SCALES + axis..], scale);
            LittleEndian::write_f64(&mut header[OFFSETS + axis..], offset);
        }
        [header, records.concat()].concat()
    }

    /// A record that begins with these coordinates.
    fn record(steps: [i32; 3], size: usize) -> Vec<u8> {
        let mut record: Vec<u8> = steps.iter().flat_map(|steps| steps.to_le_bytes()).collect();
        record.extend((0..).map(|n: u8| n % 2 * 7).take(size - 12));
        record
    }

    #[test]
    fn coordinates_are_converted_with_the_offset_of_the_header() {
        let text = |scale: f64, offset: f64, steps: [i32; 3]| {
            let scan = comes_back("a.las", file(0, scale, offset, &[record(steps, 20)]));
            let converted = convert(&scan, FileFormat::Csv).unwrap().to_bytes().unwrap();
            let text = String::from_utf8(converted).unwrap();
            let (_, values) = text.split_once('\n').unwrap();
            values.split(',').take(3).collect::<Vec<_>>().join(" ")
        };
        // On a map, where float32 is too coarse; not a whole number of steps; steps that models do not know.
        assert_eq!(text(0.001, 4_500_000.0, [30, -1500, 0]), "4500000.03 4499998.5 4500000");
        assert_eq!(text(0.001, 0.0005, [1500, -2, 0]), "1.5005 -0.0015 0.0005");
        assert_eq!(text(0.25e-3, 10.0, [4, -2, 0]), "10.001 9.9995 10");
        assert_eq!(text(0.001, 0.0, [1500, -2, 0]), "1.5 -0.002 0");
    }

    #[test]
    fn records_of_every_format_have_their_size() {
        let sizes = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
        for (format, size) in (0..).zip(sizes) {
            for more in [0, 5] {
                let records = [record([1500, -2, 0], size + more), record([-1, 7, 9_000_000], size + more)];
                let scan = comes_back("a.las", file(format, 0.001, 0.0, &records));
                assert_eq!((scan.records, scan.layout.stride(), scan.suffix.len()), (2, size + more, 0));
                assert_eq!(scan.cloud.positions, [[1.5, -0.002, 0.0], [-0.001, 0.007, 9000.0]], "{format}");
                let padding = scan.layout.fields.iter().filter(|field| field.name.is_empty()).count();
                assert_eq!(padding, usize::from(more > 0));
            }
        }
        for format in [11, 0x80, 0xff] {
            assert!(comes_back("a.las", file(format, 0.001, 0.0, &[record([1; 3], 80)])).is_opaque());
        }
    }

    #[test]
    fn coordinates_are_metres_where_float32_holds_them() {
        let axes = |layout: &Layout| match layout.wrapping {
            Wrapping::Scaled(axes) => axes[0],
            ref other => panic!("{other:?}"),
        };
        let records = [record([123_456, -1, 7], 20)];
        let scan = comes_back("a.las", file(0, 0.01, -100.0, &records));
        assert_eq!(
            (axes(&scan.layout).offset, scan.cloud.positions),
            (-100.0, vec![[1134.56, -100.01, -99.93]])
        );
        // The least coordinate of a float32 cloud in millimetres, as laspy's users pass it.
        let scan = comes_back("a.las", file(0, 0.001, (-70.123f32).into(), &records));
        assert_eq!(scan.cloud.positions, [[53.333, -70.124, -70.116]]);
        // On a map, coordinates are relative to the map's corner.
        let scan = comes_back("a.las", file(0, 0.001, 500_000.0, &records));
        assert_eq!((axes(&scan.layout).offset, scan.cloud.positions), (0.0, vec![[123.456, -0.001, 0.007]]));
        // Coordinates too far away, or on another grid: integers.
        for (steps, scale, offset) in [
            (i32::MAX - 1, 0.001, 0.0),
            (1 << 25 | 1, 0.001, 0.0),
            (5, 0.005, 0.0),
            (5, 0.0, 0.0),
            (5, f64::NAN, 0.0),
            (5, 0.001, f64::INFINITY),
            (5, -0.001, 0.0),
            (5, 1e-9, 0.0),
        ] {
            let scan = comes_back("a.las", file(0, scale, offset, &[record([steps, 1, 0], 20)]));
            assert_eq!((scan.records, scan.layout.position), (1, None), "{steps} {scale} {offset}");
            assert_eq!(scan.cloud.channel("x_steps").unwrap().bytes, steps.to_le_bytes());
        }
    }

    #[test]
    fn odd_files_come_back() {
        let good = file(6, 0.001, 0.0, &[record([1, 2, 3], 30), record([4, 5, 6], 30)]);
        assert!(starts_as_scan("a.las", &good));
        for end in 0..good.len() {
            let scan = comes_back("a.las", good[..end].to_vec());
            assert_eq!(scan.records, end.saturating_sub(HEADER_1_4 + 9) / 30);
        }
        for (at, value) in [(RECORD_SIZE, 29), (RECORD_SIZE, 0), (START, 0xff), (COUNT + 7, 0xff), (0, b'M')]
        {
            let mut bytes = good.clone();
            bytes[at] = value;
            comes_back("a.las", bytes);
        }
        let mut huge = good.clone();
        huge[START..START + 4].fill(0xff);
        assert!(comes_back("a.las", huge).is_opaque());
        assert_eq!(comes_back("a.las", [good, vec![1; 50]].concat()).suffix, [1; 50]);
    }

    #[test]
    fn a_header_gets_another_number_of_points() {
        for format in [0, 6] {
            let whole = file(format, 0.001, 0.0, &vec![record([1, 2, 3], 30); 5]);
            let header = with_point_count(&whole[..whole.len() - 150], 3);
            let scan = comes_back("a.las", [&header[..], &whole[whole.len() - 150..]].concat());
            assert_eq!((scan.records, scan.suffix.len()), (3, 60));
        }
    }
}
