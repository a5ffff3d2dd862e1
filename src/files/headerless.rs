//! Records without a header: KITTI's `.bin`, nuScenes' `.pcd.bin`, and records whose fields the user
//! specifies; the `.bin` of the Oxford Radar RobotCar data set, which holds KITTI's fields one after the
//! other; and those of NCLT, with 16-bit integers.
//!
//! Sources: A. Geiger et al., "Vision meets Robotics: The KITTI Dataset" (raw data development kit); nuScenes
//! devkit, `LidarPointCloud.from_file`; robotcar-dataset-sdk, `load_velodyne_binary`; N. Carlevaris-Bianco et
//! al., "University of Michigan North Campus long-term vision and lidar dataset".

use std::fmt;
use std::str::FromStr;

use byteorder::{ByteOrder, LittleEndian};

use super::by_field;
use super::field::{find, layout_of};
use super::records::plain_file;
use super::widened;
use crate::ground::error::{Error, Result};
use crate::scan::{Axis, Field, Layout, MAX_NAME, MAX_STRIDE, ScalarType, ScanFile, Wrapping};

/// The largest number of fields in a record; scanners' records have 3 to about 20.
const MOST_FIELDS: usize = 64;
/// The fields with a one-letter name.
const LETTERS: [(char, &str); 7] =
    [('x', "x"), ('y', "y"), ('z', "z"), ('i', "intensity"), ('r', "ring"), ('t', "time"), ('_', "")];

/// The fields of a file without a header: little-endian values, side by side.
///
/// Either a letter for each float32: `x`, `y`, `z` (metres), `i` intensity, `r` ring, `t` time, `_` a value
/// of no known meaning; or a list of fields such as `x,y,z,intensity,ring:u16,time:f64,_:u8*4`: a name or a
/// letter, a type unless it is `f32`, and the number of values unless it is one. x, y and z are required;
/// only `_` may appear more than once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeaderlessLayout {
    /// The text that the user gave.
    text: String,
    fields: Vec<Field>,
}

impl HeaderlessLayout {
    /// KITTI: x, y, z, intensity.
    pub fn kitti() -> Self {
        Self::of_letters("xyzi")
    }

    /// nuScenes: x, y, z, intensity, ring.
    pub fn nuscenes() -> Self {
        Self::of_letters("xyzir")
    }

    /// The layout of these letters; unknown letters are ignored.
    fn of_letters(letters: &str) -> Self {
        let name = |letter: char| LETTERS.iter().find(|(known, _)| *known == letter).map(|(_, name)| name);
        let fields = letters.chars().filter_map(name).map(|name| Field::new(name, ScalarType::F32)).collect();
        HeaderlessLayout { text: letters.to_owned(), fields }
    }

    /// Splits a file; incomplete records at the end are `suffix`.
    pub(super) fn parse(&self, bytes: &[u8]) -> Option<ScanFile> {
        plain_file(self.layout()?, bytes, 0, u64::MAX)
    }

    /// The layout of the records; never `None` for a layout that was read from text.
    pub(crate) fn layout(&self) -> Option<Layout> {
        layout_of(self.fields.clone(), Wrapping::Plain)
    }
}

impl FromStr for HeaderlessLayout {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |what: String| Error::InvalidSettings(format!("'{text}' {what}"));
        let is_list = text.contains([',', ':', '*']);
        let layout = if is_list {
            let fields = text.split(',').map(field).collect::<std::result::Result<_, _>>().map_err(wrong)?;
            HeaderlessLayout { text: text.to_owned(), fields }
        } else {
            let unknown = text.chars().find(|letter| LETTERS.iter().all(|(known, _)| known != letter));
            if let Some(letter) = unknown {
                return Err(wrong(format!(
                    "has the letter '{letter}'; known are x, y, z, i, r, t and _, or give a list such as \
                     x,y,z,intensity,ring:u16"
                )));
            }
            Self::of_letters(text)
        };
        let fields = &layout.fields;
        let is_twice =
            |(at, field): (usize, &Field)| !field.name.is_empty() && find(fields, &field.name) != Some(at);
        if let Some((_, field)) = fields.iter().enumerate().find(|&pair| is_twice(pair)) {
            return Err(wrong(format!("has {} twice", field.name)));
        }
        if !["x", "y", "z"].iter().all(|name| find(fields, name).is_some()) {
            return Err(wrong("needs x, y and z".to_owned()));
        }
        if fields.len() > MOST_FIELDS {
            return Err(wrong(format!("has more than {MOST_FIELDS} fields")));
        }
        match layout.layout() {
            Some(_) => Ok(layout),
            None => Err(wrong(format!("makes records of more than {MAX_STRIDE} bytes"))),
        }
    }
}

/// Splits a file with KITTI's fields, record by record or field by field, or one of the NCLT data set.
pub(super) fn parse_kitti(bytes: &[u8]) -> Option<ScanFile> {
    if is_nclt(bytes) {
        let others = ["intensity", "ring"].map(|name| Field::new(name, ScalarType::U8));
        return widened::parse_steps(NCLT, &others, bytes);
    }
    let layout = HeaderlessLayout::kitti();
    match is_by_field(bytes) {
        true => by_field::parse(layout.layout()?, &[], bytes, 0, (bytes.len() / KITTI_RECORD) as u64),
        false => layout.parse(bytes),
    }
}

/// The coordinates of the NCLT data set: 16-bit integers in steps of 5 mm.
const NCLT: Axis = Axis { per_metre: 200.0, offset: -100.0 };

/// Whether a file holds records of the NCLT data set: x, y and z as 16-bit integers, then intensity and
/// laser, a byte each. Nothing says so but the values: the coordinates are up to 100 m, and an HDL-32E has 32
/// lasers. In a file of float32, the last byte of a value is as small only for numbers near 0.
pub fn is_nclt(bytes: &[u8]) -> bool {
    const RECORD: usize = 8;
    const FEWEST: usize = 100;
    const LASERS: u8 = 32;
    /// The largest coordinate, 100 m.
    const MOST: u16 = 40_000;
    let records = bytes.chunks_exact(RECORD);
    let coordinates = |record: &[u8]| [0, 2, 4].map(|at| LittleEndian::read_u16(&record[at..]));
    let is_near =
        |record: &[u8]| record[7] < LASERS && coordinates(record).iter().all(|&steps| steps <= MOST);
    let lasers = || records.clone().fold(0u32, |all, record| all | 1 << (record[7] % LASERS));
    // Of other files, a few records show it.
    records.len() >= FEWEST
        && bytes.len().is_multiple_of(RECORD)
        && records.clone().all(is_near)
        && lasers().count_ones() >= 8
}

/// Bytes of a record with KITTI's fields.
const KITTI_RECORD: usize = 16;

/// Whether a file with KITTI's fields holds all values of one, then all of the next. Nothing says so but the
/// intensities, which are never negative: if those of records are, and the last quarter of the file is not.
fn is_by_field(bytes: &[u8]) -> bool {
    const FEWEST: usize = 100;
    const SAMPLE: usize = 1000;
    /// Of coordinates, far more are negative.
    const LEAST_NEGATIVE: f64 = 0.05;
    let records = bytes.len() / KITTI_RECORD;
    if records < FEWEST || !bytes.len().is_multiple_of(KITTI_RECORD) {
        return false;
    }
    let sample = || (0..records).step_by((records / SAMPLE).max(1));
    let value = |number: usize| LittleEndian::read_f32(&bytes[4 * number..]);
    let is_intensity = |value: f32| value >= 0.0 && value.is_finite();
    let negative = sample().filter(|record| value(4 * record + 3) < 0.0).count();
    negative as f64 > LEAST_NEGATIVE * sample().count() as f64
        && sample().all(|record| is_intensity(value(3 * records + record)))
}

/// A field of a list: `name`, `name:type` or `name:type*count`. The error says what is wrong.
fn field(text: &str) -> std::result::Result<Field, String> {
    let (name, kind) = text.split_once(':').unwrap_or((text, "f32"));
    let (kind, count) = kind.split_once('*').unwrap_or((kind, "1"));
    let scalar = ScalarType::from_name(kind).ok_or_else(|| {
        format!("has the type '{kind}'; known are i8, u8, i16, u16, i32, u32, i64, u64, f32, f64")
    })?;
    let count = count.parse().ok().filter(|count| (1..=MAX_STRIDE).contains(count));
    let count = count.ok_or_else(|| format!("has '{text}', which is no number of values"))?;
    let letter = LETTERS.iter().find(|(letter, _)| name.chars().eq([*letter]));
    let name = letter.map_or(name, |(_, name)| name);
    let is_plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "_.-".contains(c));
    if !is_plain || name.len() > MAX_NAME || (name.is_empty() && letter.is_none()) {
        return Err(format!("has the name '{name}'; names are letters, digits, _, . and -"));
    }
    Ok(Field { name: name.to_owned(), scalar, count })
}

impl fmt::Display for HeaderlessLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::{comes_back, floats};

    #[test]
    fn kitti_records_are_four_values() {
        let scan =
            comes_back("0.bin", [floats(&[1.0, 2.0, 3.0, 0.5, -0.0, 5.0, 6.0, 0.25]), vec![9; 15]].concat());
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0], [-0.0, 5.0, 6.0]]);
        assert!(scan.cloud.positions[1][0].is_sign_negative());
        assert_eq!(scan.cloud.intensity, [0.5, 0.25]);
        assert_eq!(scan.suffix, [9; 15]);
    }

    #[test]
    fn kitti_fields_may_follow_one_another() {
        let coordinate = |i: u16, by: f32| f32::from(i % 37) * by - 3.0;
        let points = || (0..500u16).map(|i| [coordinate(i, 0.5), coordinate(i, 0.25), coordinate(i, 0.1)]);
        let intensities: Vec<f32> = (0..500u16).map(|i| f32::from(i % 256)).collect();
        let axis = |axis: usize| points().map(|point| point[axis]).collect::<Vec<_>>();
        let by_field = [axis(0), axis(1), axis(2), intensities.clone()].concat();
        let scan = comes_back("0.bin", floats(&by_field));
        assert!(matches!(scan.layout.wrapping, Wrapping::ByField(_)));
        assert_eq!(scan.cloud.positions, points().collect::<Vec<_>>());
        assert_eq!(scan.cloud.intensity, intensities);
        // Record by record, with negative intensities, or with more bytes, it is as ever.
        let records = points().zip(&intensities).flat_map(|([x, y, z], i)| [x, y, z, *i]);
        let records: Vec<f32> = records.collect();
        let odd = [by_field[..1500].to_vec(), axis(0)].concat();
        for bytes in [floats(&records), floats(&odd), [floats(&by_field), vec![7]].concat()] {
            assert_eq!(comes_back("0.bin", bytes).layout.wrapping, Wrapping::Plain);
        }
    }

    #[test]
    fn nclt_records_are_16_bit_integers() {
        let record = |n: u16| {
            let steps = [n.wrapping_mul(7919) % 40_001, 40_000 - n % 40_001, n % 40_001];
            [steps.map(u16::to_le_bytes).as_flattened(), &[n as u8, n as u8 % 32]].concat()
        };
        let file: Vec<u8> = (0..40_001).flat_map(record).collect();
        let scan = comes_back("0.bin", file.clone());
        assert_eq!((scan.records, scan.cloud.positions[0]), (40_001, [-100.0, 100.0, -100.0]));
        assert_eq!(scan.cloud.positions[1], [-60.405, 99.995, -99.995]);
        assert_eq!((scan.cloud.intensity[3], scan.cloud.channel("ring").unwrap().bytes[33]), (3.0, 1));
        assert_eq!(scan.layout.axes(), Some([NCLT; 3]));
        // Other records are KITTI's, as ever.
        let far = [u16::MAX.to_le_bytes().to_vec(), vec![0; 5], vec![3]].concat();
        let high = [vec![0; 7], vec![32]].concat();
        for odd in [vec![0; 800], [&file[..8000], &far].concat(), [&file[..8000], &high].concat()] {
            assert_eq!(comes_back("0.bin", odd).layout.wrapping, Wrapping::Plain);
        }
        assert_eq!(comes_back("0.bin", file[..8001].to_vec()).layout.wrapping, Wrapping::Plain);
    }

    #[test]
    fn nuscenes_records_have_a_ring_too() {
        let scan = comes_back("0.pcd.bin", [floats(&[1.0, 2.0, 3.0, 40.0, 31.0]), vec![9]].concat());
        assert_eq!((scan.records, scan.cloud.intensity[0]), (1, 40.0));
        assert_eq!(scan.cloud.channel("ring").unwrap().bytes, floats(&[31.0]));
        assert_eq!(scan.suffix, [9]);
    }

    #[test]
    fn every_bit_of_nan_is_kept() {
        let payloads = [0x7f80_0001u32, 0xffc1_2345, 0x7fc0_0000, 0x8000_0000];
        let scan = comes_back("0.bin", payloads.iter().flat_map(|p| p.to_le_bytes()).collect());
        assert_eq!(scan.records, 1);
    }

    #[test]
    fn an_empty_file_has_no_records() {
        let scan = comes_back("0.bin", vec![]);
        assert_eq!((scan.records, scan.is_opaque()), (0, false));
    }

    #[test]
    fn letters_say_where_the_values_are() {
        let layout: HeaderlessLayout = "_tzyxir".parse().unwrap();
        let bytes = [floats(&[9.0, 8.0, 3.0, 2.0, 1.0, 0.5, 7.0]), vec![1; 5]].concat();
        let scan = layout.parse(&bytes).unwrap();
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(scan.cloud.intensity, [0.5]);
        let others: Vec<_> =
            scan.cloud.channels.iter().map(|c| (&c.field.name[..], c.bytes.clone())).collect();
        let expected =
            [("", 9.0), ("time", 8.0), ("ring", 7.0)].map(|(name, value)| (name, floats(&[value])));
        assert_eq!(others, expected);
        assert_eq!(scan.to_bytes().unwrap(), bytes);
        assert_eq!(layout.to_string(), "_tzyxir");
        let without = "xyz".parse::<HeaderlessLayout>().unwrap().parse(&floats(&[1.0; 6])).unwrap();
        assert_eq!((without.records, without.layout.intensity), (2, None));
    }

    #[test]
    fn lists_name_typed_fields() {
        let layout: HeaderlessLayout = "x,y,z,i:u8,ring:u16,time:f64,_:u8*4".parse().unwrap();
        let layout = layout.layout().unwrap();
        assert_eq!(
            layout.fields[3..6],
            [
                Field::new("intensity", ScalarType::U8),
                Field::new("ring", ScalarType::U16),
                Field::new("time", ScalarType::F64)
            ]
        );
        assert_eq!((layout.fields[6].clone(), layout.stride()), (Field::padding(4), 27));
        assert_eq!((layout.position, layout.intensity), (Some([0, 1, 2]), Some(3)));
        let integers = "x:u16,y:u16,z:u16,intensity:u8,ring:u8".parse::<HeaderlessLayout>().unwrap();
        assert_eq!(integers.layout().unwrap().position, None);
        assert_eq!(
            "x,y,z,r".parse::<HeaderlessLayout>().unwrap().fields,
            "xyzr".parse::<HeaderlessLayout>().unwrap().fields
        );
    }

    #[test]
    fn layouts_of_no_sense_are_refused() {
        let long = format!("xyz{}", "_".repeat(62));
        for wrong in [
            "",
            "xy",
            "xyi",
            "xyzz",
            "xyzii",
            "xyzI",
            "x y z",
            "xyz\u{e9}",
            &long,
            ",",
            "x,y",
            "x,y,z,",
            "x,y,z,x",
            "x,y,z,:u8",
            "x,y,z,a:u9",
            "x,y,z,a:u8*0",
            "x,y,z,a:u8*",
            "x,y,z,a b",
            "x,y,z,_:u8*65536",
            "x,y,z,_:f64*65537",
            "x,y,z,intensity,i",
        ] {
            assert!(wrong.parse::<HeaderlessLayout>().is_err(), "{wrong:?}");
        }
        assert!(long[1..].parse::<HeaderlessLayout>().is_err());
        assert!(long[..64].parse::<HeaderlessLayout>().is_ok());
    }
}
