//! Scans as files of another format: the values of a record by name, regardless of the original format,
//! behind the headers that the programs that read them expect.
//!
//! Sources: "The PCD (Point Cloud Data) file format" (PCL documentation); G. Turk, "The PLY Polygon File
//! Format" (1994).

use std::collections::HashSet;

use byteorder::{ByteOrder, LittleEndian};

use super::field::{self, INTENSITY, POSITION, layout_of};
use super::{Kind, las, numpy, records};
use crate::ground::error::{Error, Result};
use crate::scan::{
    Axis, Column as TextColumn, Field, Layout, NumberRule, ScalarType, ScanFile, Separator, TextFormat,
    Wrapping,
};

/// A format that scans can be converted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// KITTI's: float32 x, y, z, intensity, without a header. Intensities are 0 if there are none.
    Bin,
    /// PCD 0.7, `binary`.
    Pcd,
    /// PLY 1.0, `binary_little_endian`.
    Ply,
    /// Text with a line of names, values between commas, each with the fewest digits that give it back.
    Csv,
    /// NumPy's `.npy`, an array of structures.
    Npy,
}

impl FileFormat {
    /// The name of a frame in this format, with the extension replaced.
    pub fn file_name(self, name: &str) -> String {
        let stem = Kind::of(name).map_or(name, |(_, stem)| stem);
        match self {
            FileFormat::Bin => format!("{stem}.bin"),
            FileFormat::Pcd => format!("{stem}.pcd"),
            FileFormat::Ply => format!("{stem}.ply"),
            FileFormat::Csv => format!("{stem}.csv"),
            FileFormat::Npy => format!("{stem}.npy"),
        }
    }

    /// The columns of a scan in a file of this format. The error says why it cannot hold their coordinates.
    fn columns(self, mut columns: Vec<Column>) -> std::result::Result<Vec<Column>, &'static str> {
        match self {
            FileFormat::Bin => {
                kitti_columns(columns).ok_or("has coordinates that are not float32; convert it to pcd or ply")
            }
            FileFormat::Pcd | FileFormat::Csv | FileFormat::Npy => Ok(columns),
            FileFormat::Ply => {
                let has_type = |column: &Column| !matches!(column.scalar, ScalarType::I64 | ScalarType::U64);
                if !columns.iter().take(POSITION.len()).all(has_type) {
                    return Err(
                        "has coordinates that are integers of 64 bits, which PLY does not know; convert it to pcd or csv",
                    );
                }
                columns.retain(has_type);
                Ok(columns)
            }
        }
    }

    fn header(self, columns: &[Column], points: usize) -> Vec<u8> {
        match self {
            FileFormat::Bin => Vec::new(),
            FileFormat::Pcd => pcd_header(columns, points).into_bytes(),
            FileFormat::Ply => ply_header(columns, points).into_bytes(),
            FileFormat::Csv => csv_header(columns).into_bytes(),
            FileFormat::Npy => {
                let fields: Vec<_> = columns.iter().map(|column| (&column.name[..], column.scalar)).collect();
                numpy::header(&fields, points)
            }
        }
    }

    fn wrapping(self, columns: &[Column]) -> Wrapping {
        match self {
            FileFormat::Csv => {
                let shortest =
                    |scalar| NumberRule::Shortest { double: scalar == ScalarType::F64, point_zero: false };
                let column = |scalar: ScalarType| TextColumn {
                    scalar,
                    rule: if scalar.is_float() { shortest(scalar) } else { NumberRule::Integer },
                };
                let columns = columns.iter().map(|c| column(c.scalar)).collect();
                Wrapping::Text(TextFormat { separator: Separator::Comma, columns, ..TextFormat::default() })
            }
            _ => Wrapping::Plain,
        }
    }
}

/// Whether a scan holds points that can be converted to some format.
pub fn is_convertible(scan: &ScanFile) -> bool {
    columns_of(scan).is_some()
}

/// The scan as a file of another format: `to_bytes` of the result gives its bytes. Points keep their order
/// and every bit of their coordinates, except for the payloads of NaN in text. x, y and z come first, then
/// the intensity, then the other named fields with their types; each value of a field with several values
/// becomes a field. Padding and the bytes around the records are left out. Numbers from text become float32
/// if that preserves all their digits.
///
/// # Errors
/// [`Error::Input`], with the scan's name, if it holds no points, or if they are not float32, for
/// [`FileFormat::Bin`].
pub fn convert(scan: &ScanFile, format: FileFormat) -> Result<ScanFile> {
    let refuse = |what: &str| Error::Input { path: scan.name.clone().into(), what: what.to_owned() };
    let columns = columns_of(scan)
        .ok_or_else(|| refuse("holds no points that can be converted; decode it in its own format"))?;
    let columns = format.columns(columns).map_err(refuse)?;
    records::check(scan)?;
    let body = records::join(scan)?;
    let mut converted = Vec::new();
    for record in body.chunks_exact(scan.layout.stride().max(1)) {
        columns.iter().for_each(|column| column.write(record, &mut converted));
    }
    let fields = columns.iter().map(Column::field).collect();
    let layout = layout_of(fields, format.wrapping(&columns)).unwrap_or_default();
    layout.validate()?;
    let (layout, cloud) = records::split(layout, &converted);
    Ok(ScanFile {
        name: format.file_name(&scan.name),
        prefix: format.header(&columns, scan.records),
        records: scan.records,
        cloud,
        suffix: Vec::new(),
        layout,
    })
}

/// One value of a converted record.
#[derive(Clone, Debug)]
struct Column {
    /// Its name.
    name: String,
    /// Its type.
    scalar: ScalarType,
    origin: Origin,
}

/// Where a value comes from.
#[derive(Clone, Copy, Debug)]
enum Origin {
    /// The bytes at this offset of the original record, unchanged.
    At(usize),
    /// The number of this type at this offset, rounded to float32.
    Number(usize, ScalarType),
    /// The coordinate of a LAS file, in double precision, of the steps that stand at this offset: as an
    /// integer, or as the float32 value along an axis.
    Steps { at: usize, along: Option<Axis>, scale: f64, offset: f64 },
    /// No original value; the result is 0.
    Nowhere,
}

impl Column {
    /// Its field in the converted file.
    fn field(&self) -> Field {
        Field::new(&field::name_of(&self.name), self.scalar)
    }

    /// Appends its value in a record of the original file.
    fn write(&self, record: &[u8], out: &mut Vec<u8>) {
        match self.origin {
            Origin::At(at) => out.extend_from_slice(&record[at..at + self.scalar.size() as usize]),
            Origin::Number(at, scalar) => {
                let number = number(scalar, &record[at..at + scalar.size() as usize]) as f32;
                out.extend_from_slice(&number.to_le_bytes());
            }
            Origin::Steps { at, along, scale, offset } => {
                let steps = match along {
                    Some(axis) => axis.steps(LittleEndian::read_f32(&record[at..]), [i32::MIN, i32::MAX]),
                    None => LittleEndian::read_i32(&record[at..]),
                };
                out.extend((f64::from(steps) * scale + offset).to_le_bytes());
            }
            Origin::Nowhere => out.extend(std::iter::repeat_n(0, self.scalar.size() as usize)),
        }
    }
}

/// The columns of a scan: x, y, z, the intensity if there is one, then the others in the order of the file.
/// Names are unique. `None` if x, y or z is missing.
fn columns_of(scan: &ScanFile) -> Option<Vec<Column>> {
    if scan.is_opaque() {
        return None;
    }
    let mut columns = of_fields(&scan.layout);
    if let Some(scales) = las::scales(&scan.prefix) {
        as_in_las(&mut columns, &scan.layout, scales);
    }
    in_order(columns)
}

/// Makes the coordinates of a LAS file those that its header gives, where they are not kept so.
fn as_in_las(columns: &mut [Column], layout: &Layout, scales: [[f64; 2]; 3]) {
    for (axis, [scale, offset]) in scales.into_iter().enumerate() {
        let along = if let Wrapping::Scaled(axes) = &layout.wrapping { Some(axes[axis]) } else { None };
        let name = if along.is_some() { POSITION[axis] } else { las::STEPS[axis] };
        // With this offset, float32 coordinates are those of the file.
        if along.is_some_and(|along| along.offset == offset) {
            continue;
        }
        if let Some(column) = columns.iter_mut().find(|column| column.name == name)
            && let Origin::At(at) = column.origin
        {
            let origin = Origin::Steps { at, along, scale, offset };
            *column = Column { name: POSITION[axis].to_owned(), scalar: ScalarType::F64, origin };
        }
    }
}

/// Selects the columns of KITTI's files from those of a scan; `None` if the coordinates are not float32.
fn kitti_columns(mut columns: Vec<Column>) -> Option<Vec<Column>> {
    let intensity = columns.iter().find(|column| column.name == INTENSITY).map(|column| column.as_float32());
    columns.truncate(POSITION.len());
    if columns.iter().any(|column| column.scalar != ScalarType::F32) {
        return None;
    }
    let missing = Column { name: INTENSITY.to_owned(), scalar: ScalarType::F32, origin: Origin::Nowhere };
    columns.push(intensity.unwrap_or(missing));
    Some(columns)
}

impl Column {
    fn as_float32(&self) -> Column {
        let origin = match self.origin {
            Origin::At(at) if self.scalar != ScalarType::F32 => Origin::Number(at, self.scalar),
            other => other,
        };
        Column { scalar: ScalarType::F32, origin, name: self.name.clone() }
    }
}

/// The named fields; one with several values becomes several columns.
fn of_fields(layout: &Layout) -> Vec<Column> {
    let is_known = |field: &Field| field.count == 1;
    let intensity = field::find_intensity(&layout.fields, is_known);
    let mut columns = Vec::new();
    let mut at = 0;
    for (place, field) in layout.fields.iter().enumerate() {
        let known = POSITION.into_iter().find(|name| field.name.eq_ignore_ascii_case(name));
        let name = if intensity == Some(place) { INTENSITY } else { known.unwrap_or(&field.name) };
        for value in 0..field.count {
            if !name.is_empty() {
                let name = if field.count == 1 { name.to_owned() } else { format!("{name}_{value}") };
                columns.push(Column { name, scalar: field.scalar, origin: Origin::At(at) });
            }
            at += field.scalar.size() as usize;
        }
    }
    columns
}

/// Puts coordinates first and the intensity next, and makes names unique. `None` if a coordinate is missing.
fn in_order(mut columns: Vec<Column>) -> Option<Vec<Column>> {
    let mut ordered = Vec::with_capacity(columns.len());
    for name in POSITION.into_iter().chain([INTENSITY]) {
        match columns.iter().position(|column| column.name == name) {
            Some(at) => ordered.push(columns.remove(at)),
            None if name == INTENSITY => {}
            None => return None,
        }
    }
    let mut names: HashSet<String> =
        columns.iter().chain(&ordered).map(|column| column.name.clone()).collect();
    let mut seen: HashSet<String> = ordered.iter().map(|column| column.name.clone()).collect();
    for mut column in columns {
        if !seen.insert(column.name.clone()) {
            let others = (2u32..).map(|number| format!("{}_{number}", column.name));
            let Some(free) = { others }.find(|name| names.insert(name.clone())) else { continue };
            column.name = free;
        }
        ordered.push(column);
    }
    Some(ordered)
}

/// The number in these little-endian bytes.
fn number(scalar: ScalarType, bytes: &[u8]) -> f64 {
    match scalar {
        ScalarType::F32 => LittleEndian::read_f32(bytes).into(),
        ScalarType::F64 => LittleEndian::read_f64(bytes),
        ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => {
            LittleEndian::read_uint(bytes, bytes.len()) as f64
        }
        ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => {
            LittleEndian::read_int(bytes, bytes.len()) as f64
        }
    }
}

/// A PCD header of version 0.7: one row of points.
fn pcd_header(columns: &[Column], points: usize) -> String {
    let line = |keyword: &str, word: &dyn Fn(&Column) -> String| {
        let words: Vec<String> = columns.iter().map(word).collect();
        format!("{keyword} {}\n", words.join(" "))
    };
    let kind = |column: &Column| {
        match column.scalar {
            ScalarType::F32 | ScalarType::F64 => "F",
            ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => "I",
            ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => "U",
        }
        .to_owned()
    };
    [
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n".to_owned(),
        line("FIELDS", &|column| column.name.clone()),
        line("SIZE", &|column| column.scalar.size().to_string()),
        line("TYPE", &kind),
        line("COUNT", &|_| "1".to_owned()),
        format!("WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary\n"),
    ]
    .concat()
}

/// A PLY header with nothing but vertices. The types of the columns must be types of PLY.
fn ply_header(columns: &[Column], points: usize) -> String {
    let property = |column: &Column| format!("property {} {}\n", ply_type(column.scalar), column.name);
    let properties: String = columns.iter().map(property).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {points}\n{properties}end_header\n")
}

/// The names of the columns between commas.
fn csv_header(columns: &[Column]) -> String {
    let names: Vec<_> = columns.iter().map(|column| column.name.replace([',', ';', '"'], "_")).collect();
    names.join(",") + "\n"
}

/// The original type names of 1994, which all readers support.
fn ply_type(scalar: ScalarType) -> &'static str {
    match scalar {
        ScalarType::I8 => "char",
        ScalarType::U8 => "uchar",
        ScalarType::I16 => "short",
        ScalarType::U16 => "ushort",
        ScalarType::I32 | ScalarType::I64 => "int",
        ScalarType::U32 | ScalarType::U64 => "uint",
        ScalarType::F32 => "float",
        ScalarType::F64 => "double",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::parse;
    use crate::files::tests::{floats, pcd};

    const FORMATS: [FileFormat; 4] = [FileFormat::Bin, FileFormat::Pcd, FileFormat::Ply, FileFormat::Npy];

    /// Converts a file, checks that it can be read back, and returns its text up to the body, and the body.
    fn converted(name: &str, bytes: Vec<u8>, format: FileFormat) -> (String, Vec<u8>, ScanFile) {
        let file = convert(&parse(name, bytes), format).unwrap();
        let bytes = file.to_bytes().unwrap();
        let read = parse(&file.name, bytes.clone());
        assert_eq!((read.records, &read.layout), (file.records, &file.layout));
        assert_eq!((&read.prefix, read.suffix.len()), (&file.prefix, 0));
        let body = bytes[file.prefix.len()..].to_vec();
        (String::from_utf8_lossy(&file.prefix).into_owned(), body, read)
    }

    /// Two KITTI points with bits that floating-point arithmetic would not preserve.
    fn kitti() -> Vec<u8> {
        let odd = f32::from_bits(0x7fa0_0001);
        floats(&[1.0, -0.0, odd, 0.5, 4.0, 5.0, 6.0, 0.25])
    }

    #[test]
    fn kitti_gets_the_headers_that_others_read() {
        let (header, body, _) = converted("7.bin", kitti(), FileFormat::Pcd);
        let expected = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\n\
        SIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\n\
        DATA binary\n";
        assert_eq!((&header[..], &body), (expected, &kitti()));
        let (header, body, _) = converted("7.bin", kitti(), FileFormat::Ply);
        let expected = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n\
        property float y\nproperty float z\nproperty float intensity\nend_header\n";
        assert_eq!((&header[..], &body), (expected, &kitti()));
    }

    #[test]
    fn kitti_comes_back_through_every_format() {
        for format in FORMATS {
            let there = convert(&parse("7.bin", kitti()), format).unwrap();
            let there = parse(&there.name, there.to_bytes().unwrap());
            let back = convert(&there, FileFormat::Bin).unwrap();
            assert_eq!((back.to_bytes().unwrap(), &back.name[..]), (kitti(), "7.bin"));
        }
    }

    #[test]
    fn text_has_the_fewest_digits() {
        let header = pcd("x y z i ring t,s", "4 4 4 1 2 8", "F F F U U F", "1 1 1 1 1 1", 2, "binary");
        let record = |x: f32, ring: u16, t: f64| {
            [floats(&[x, 0.1, -0.0]), vec![200], ring.to_le_bytes().to_vec(), t.to_le_bytes().to_vec()]
                .concat()
        };
        let file = [header, record(1e-7, 3, 0.1), record(f32::NAN, 65535, 1.3e9 + 0.25)].concat();
        let csv = convert(&parse("a.pcd", file), FileFormat::Csv).unwrap();
        assert_eq!(csv.name, "a.csv");
        let text = csv.to_bytes().unwrap();
        let expected =
            "x,y,z,intensity,ring,t_s\n1e-07,0.1,-0,200,3,0.1\nnan,0.1,-0,200,65535,1300000000.25\n";
        assert_eq!(String::from_utf8(text.clone()).unwrap(), expected);
        let read = parse("a.csv", text);
        assert_eq!((read.records, read.cloud.positions[0]), (2, [1e-7, 0.1, -0.0]));
        assert_eq!(read.cloud.channels[0].bytes, [3, 0, 255, 255]);
    }

    #[test]
    fn a_cut_off_record_is_left_out() {
        let (_, body, _) = converted("7.bin", [kitti(), vec![1; 7]].concat(), FileFormat::Bin);
        assert_eq!(body, kitti());
    }

    #[test]
    fn the_ring_of_nuscenes_is_a_field() {
        let points = floats(&[1.0, 2.0, 3.0, 40.0, 31.0]);
        let (header, body, scan) = converted("a.pcd.bin", points.clone(), FileFormat::Pcd);
        assert!(header.contains("FIELDS x y z intensity ring\n"), "{header}");
        assert_eq!((body, &scan.name[..]), (points.clone(), "a.pcd"));
        let (_, body, scan) = converted("a.pcd.bin", points, FileFormat::Bin);
        assert_eq!((body, &scan.name[..]), (floats(&[1.0, 2.0, 3.0, 40.0]), "a.bin"));
    }

    #[test]
    fn named_fields_keep_their_types_and_come_after_the_point() {
        let header =
            pcd("_ ring z y X i t n", "1 2 4 4 4 1 8 1", "U U F F F U U I", "3 1 1 1 1 1 1 2", 1, "binary");
        let fields: [&[u8]; 8] = [
            &[9, 9, 9],
            &[1, 2],
            &floats(&[3.0]),
            &floats(&[2.0]),
            &floats(&[1.0]),
            &[200],
            &[1, 2, 3, 4, 5, 6, 7, 8],
            &[0xfe, 0xff],
        ];
        let file = [header, fields.concat()].concat();
        let (header, body, _) = converted("a.pcd", file.clone(), FileFormat::Pcd);
        assert!(header.contains("FIELDS x y z intensity ring t n_0 n_1\nSIZE 4 4 4 1 2 8 1 1\n"), "{header}");
        assert!(header.contains("TYPE F F F U U U I I\nCOUNT 1 1 1 1 1 1 1 1\n"), "{header}");
        let point = floats(&[1.0, 2.0, 3.0]);
        assert_eq!(body, [&point[..], &[200, 1, 2, 1, 2, 3, 4, 5, 6, 7, 8, 0xfe, 0xff]].concat());
        let (header, body, _) = converted("a.pcd", file.clone(), FileFormat::Ply);
        assert!(
            header.contains("property uchar intensity\nproperty ushort ring\nproperty char n_0\n"),
            "{header}"
        );
        assert_eq!(body, [&point[..], &[200, 1, 2, 0xfe, 0xff]].concat(), "PLY has no integers of 64 bits");
        let (_, body, _) = converted("a.pcd", file, FileFormat::Bin);
        assert_eq!(body, [point, floats(&[200.0])].concat());
    }

    #[test]
    fn what_has_no_intensity_gets_zero_or_no_field() {
        let file = [pcd("x y z", "4 4 4", "F F F", "1 1 1", 1, "binary"), floats(&[1.0, 2.0, 3.0])].concat();
        let (_, body, _) = converted("a.pcd", file.clone(), FileFormat::Bin);
        assert_eq!(body, floats(&[1.0, 2.0, 3.0, 0.0]));
        let (header, body, _) = converted("a.pcd", file, FileFormat::Ply);
        assert!(header.ends_with("property float z\nend_header\n"), "{header}");
        assert_eq!(body, floats(&[1.0, 2.0, 3.0]));
    }

    #[test]
    fn coordinates_are_not_left_out() {
        let file = [pcd("x y z", "8 4 4", "I F F", "1 1 1", 1, "binary"), vec![1; 16]].concat();
        let (header, ..) = converted("a.pcd", file.clone(), FileFormat::Pcd);
        assert!(header.contains("SIZE 8 4 4\nTYPE I F F\n"), "{header}");
        let error = convert(&parse("a.pcd", file), FileFormat::Ply).unwrap_err().to_string();
        assert!(error.starts_with("a.pcd ") && error.contains("64 bits"), "{error}");
    }

    #[test]
    fn doubles_stay_doubles_and_are_not_kitti() {
        let values = [1.0f64, 2.5, 1e300].map(f64::to_le_bytes).concat();
        let file = [pcd("x y z", "8 8 8", "F F F", "1 1 1", 1, "binary"), values.clone()].concat();
        let (header, body, _) = converted("a.pcd", file.clone(), FileFormat::Ply);
        assert!(header.contains("property double x\n"), "{header}");
        assert_eq!(body, values);
        let error = convert(&parse("a.pcd", file), FileFormat::Bin).unwrap_err().to_string();
        assert!(error.starts_with("a.pcd ") && error.contains("float32"), "{error}");
    }

    #[test]
    fn a_file_without_points_is_one_with_another_header() {
        for format in FORMATS {
            assert_eq!(converted("0.bin", vec![], format).1, [0; 0]);
        }
    }

    #[test]
    fn what_holds_no_points_is_refused() {
        let features = [pcd("a b", "4 4", "F F", "1 1", 1, "binary"), floats(&[1.0, 2.0])].concat();
        for (name, bytes) in [("a.ply", b"ply\n".to_vec()), ("a.txt", kitti()), ("a.pcd", features)] {
            for format in FORMATS {
                let error = convert(&parse(name, bytes.clone()), format).unwrap_err().to_string();
                assert!(error.starts_with(name) && error.contains("its own format"), "{error}");
            }
        }
    }

    #[test]
    fn names_get_the_new_ending() {
        for (name, new) in
            [("1.bin", "1.ply"), ("1.PCD.bin", "1.ply"), ("a.b.PLY", "a.b.ply"), ("é", "é.ply")]
        {
            assert_eq!(FileFormat::Ply.file_name(name), new);
        }
    }

    #[test]
    fn numbers_of_text_are_converted_as_they_are_kept() {
        let header = pcd("x y z t _ v", "8 8 8 8 4 2", "F F F F F U", "1 1 1 1 1 2", 1, "ascii");
        let file = [&header[..], b"22.719 0.031 -1 1300000000.25 0 7 8\n"].concat();
        let (header, body, _) = converted("a.pcd", file.clone(), FileFormat::Ply);
        let names = "property float x\nproperty float y\nproperty float z\nproperty double t\n\
        property ushort v_0\nproperty ushort v_1\n";
        assert!(header.contains(names), "{header}");
        let time = 1_300_000_000.25f64.to_le_bytes().to_vec();
        assert_eq!(body, [floats(&[22.719, 0.031, -1.0]), time, vec![7, 0, 8, 0]].concat());
        assert_eq!(converted("a.pcd", file, FileFormat::Bin).1, floats(&[22.719, 0.031, -1.0, 0.0]));
    }
}
