//! The fields of a file's records and how they are wrapped, and the serialised form of both.
//! FORMAT.md 8.1.

use super::scalar::ScalarType;
use super::text_format::{NumberRule, TextFormat};
use crate::ground::error::{Error, Result};
use crate::ground::floats::round_ties_even;
use crate::ground::varint::{read_unsigned, write_unsigned};

/// The longest record, in bytes. Scanners' records have 12 to about 50 bytes, those of point features a few
/// thousand.
pub const MAX_STRIDE: u32 = 1 << 16;
/// The longest name of a field, in bytes.
pub const MAX_NAME: usize = 64;

/// One field of a record: one or more values of one type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name, without white space; empty for padding.
    pub name: String,
    /// The type of its values.
    pub scalar: ScalarType,
    /// Number of values, at least 1.
    pub count: u32,
}

impl Field {
    /// A field of one value.
    pub fn new(name: &str, scalar: ScalarType) -> Self {
        Field { name: name.to_owned(), scalar, count: 1 }
    }

    /// Padding: this many bytes of no known meaning.
    pub fn padding(bytes: u32) -> Self {
        Field { name: String::new(), scalar: ScalarType::U8, count: bytes }
    }

    /// Number of bytes that it takes in a record.
    pub fn width(&self) -> usize {
        self.scalar.size() as usize * self.count as usize
    }

    /// Whether a field may have this name.
    pub fn is_name(name: &str) -> bool {
        name.len() <= MAX_NAME && !name.contains(|c: char| c.is_whitespace() || c.is_control())
    }
}

/// The fields of a file's records, and how the records are wrapped into the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// How the records are stored in the file.
    pub wrapping: Wrapping,
    /// The fields, one after the other without gaps; empty if the file holds no records.
    pub fields: Vec<Field>,
    /// Which fields are x, y and z: single float32 values, in metres.
    pub position: Option<[u32; 3]>,
    /// Which field is the intensity: a single value of type float32, u8 or u16.
    pub intensity: Option<u32>,
}

/// How the records are stored in the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Wrapping {
    /// One after the other (KITTI `.bin`, binary PCD, binary little-endian PLY).
    #[default]
    Plain,
    /// Field by field (all x, then all y, ...), compressed with LZF, after two u32 with the compressed and
    /// the uncompressed size (PCD `binary_compressed`).
    PcdCompressed {
        /// The LZF compressor that wrote it.
        lzf: LzfDialect,
    },
    /// As text, one record a line (ascii PCD and PLY, `.csv`, `.txt`, `.xyz`).
    Text(TextFormat),
    /// One after the other, each value big-endian (binary big-endian PLY).
    BigEndian,
    /// One after the other, with 32-bit integers in place of x, y and z (LAS).
    Scaled([Axis; 3]),
    /// One after the other, with doubles or integers in place of the float32 values of some fields; for each
    /// field, how.
    Widened(Vec<Widening>),
    /// Field by field (`.npy` in column-major order), with doubles in place of the float32 values of some
    /// fields, as in `Widened`.
    ByField(Vec<Widening>),
    /// Field by field in batches (Arrow), with other numbers in place of the float32 values of some fields,
    /// as in `Widened`.
    Arrow {
        /// Whether the fields begin at multiples of 64 bytes, rather than of 8.
        is_wide: bool,
        /// For each field, how its values are stored.
        widenings: Vec<Widening>,
    },
}

/// How the values of a field are stored in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Widening {
    /// As in the record.
    None,
    /// A float32 as the double equal to it.
    Exact,
    /// A float32 as the double nearest to its text by this rule: the file was made from text, or from numbers
    /// of few digits.
    Decimal(NumberRule),
    /// A float32 as the nearest 16-bit integer of this axis.
    Steps(Axis),
    /// A float32 as the nearest half-precision number.
    Half,
}

/// How a coordinate is computed from an integer: `integer / per_metre + offset`, in double precision, then
/// rounded to float32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Steps per metre; a positive number.
    pub per_metre: f64,
    /// The coordinate that corresponds to 0, in metres; a finite number.
    pub offset: f64,
}

/// Reflexive for valid axes, which hold no NaN.
impl Eq for Axis {}

impl Axis {
    /// The coordinate of an integer, in metres.
    pub fn metres(&self, integer: i32) -> f32 {
        (f64::from(integer) / self.per_metre + self.offset) as f32
    }

    /// The integer whose coordinate is nearest, from `least` to `most`; 0 for NaN.
    pub fn steps(&self, metres: f32, [least, most]: [i32; 2]) -> i32 {
        let steps = (f64::from(metres) - self.offset) * self.per_metre;
        // The conversion of NaN gives 0.
        round_ties_even(steps.clamp(least.into(), most.into())) as i32
    }

    fn write_to(&self, out: &mut Vec<u8>) {
        out.extend(self.per_metre.to_le_bytes());
        out.extend(self.offset.to_le_bytes());
    }

    fn is_valid(&self) -> bool {
        self.per_metre.is_finite() && self.per_metre > 0.0 && self.offset.is_finite()
    }
}

/// The LZF compressors that write PCD files. They share a format but find different matches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LzfDialect {
    /// 2^13 hash slots, the "ultra fast" hash (today's PCL).
    Ultra13,
    /// 2^16 hash slots, the "ultra fast" hash (older PCL).
    Ultra16,
    /// 2^16 hash slots, the "very fast" hash (plain liblzf; Open3D).
    Very16,
}

impl LzfDialect {
    /// Every dialect, at the index of its number in the serialised form; the likeliest first.
    pub const ALL: [LzfDialect; 3] = [LzfDialect::Ultra13, LzfDialect::Ultra16, LzfDialect::Very16];
}

/// What is wrong with an axis that is not valid.
const INVALID_AXIS: &str = "a scale that is not positive, or an offset that is not finite";

// The first byte of a serialised layout.
const PLAIN: u8 = 0;
const PCD_COMPRESSED: u8 = 1;
const TEXT: u8 = 2;
const BIG_ENDIAN: u8 = 3;
const SCALED: u8 = 4;
const WIDENED: u8 = 5;
const BY_FIELD: u8 = 6;
const ARROW: u8 = 7;

impl Layout {
    /// Number of bytes in a record; 0 if the file holds no records.
    pub fn stride(&self) -> usize {
        self.fields.iter().map(Field::width).sum()
    }

    /// Byte offsets of x, y and z in a record. Meaningful only for a valid layout.
    pub fn position_offsets(&self) -> Option<[usize; 3]> {
        self.position.map(|fields| fields.map(|field| self.offset(field)))
    }

    /// Byte offset and type of the intensity. Meaningful only for a valid layout.
    pub fn intensity_offset(&self) -> Option<(usize, ScalarType)> {
        let field = self.intensity?;
        Some((self.offset(field), self.fields.get(field as usize)?.scalar))
    }

    fn offset(&self, field: u32) -> usize {
        self.fields.iter().take(field as usize).map(Field::width).sum()
    }

    /// The fields that are neither position nor intensity, with their byte offsets.
    pub fn channels(&self) -> impl Iterator<Item = (usize, &Field)> {
        let mut offset = 0;
        (0..).zip(&self.fields).filter_map(move |(number, field)| {
            let at = offset;
            offset += field.width();
            let has_role = self.intensity == Some(number)
                || self.position.is_some_and(|position| position.contains(&number));
            (!has_role).then_some((at, field))
        })
    }

    /// Number of bytes in a record that belong to [`channels`](Self::channels).
    pub fn channel_bytes(&self) -> usize {
        self.channels().map(|(_, field)| field.width()).sum()
    }

    /// Checks that records are not too long, that the fields suit their roles, and that the wrapping
    /// describes a record with these fields.
    ///
    /// # Errors
    /// [`Error::Corrupt`] if not.
    pub fn validate(&self) -> Result<()> {
        let check = |ok: bool, what: &str| match ok {
            true => Ok(()),
            false => Err(Error::corrupt(format!("record layout: {what}"))),
        };
        let mut stride = 0u64;
        for field in &self.fields {
            check(field.count > 0, "a field without values")?;
            check(Field::is_name(&field.name), "no name for a field")?;
            stride += u64::from(field.scalar.size()) * u64::from(field.count);
            check(stride <= MAX_STRIDE.into(), "records too long")?;
        }
        let roles: Vec<u32> = self.position.into_iter().flatten().chain(self.intensity).collect();
        let is_twice = (1..roles.len()).any(|at| roles[..at].contains(&roles[at]));
        check(!is_twice, "a field has two roles")?;
        let suits = |role: u32, types: &[ScalarType]| {
            let field = self.fields.get(role as usize);
            field.is_some_and(|field| field.count == 1 && types.contains(&field.scalar))
        };
        let positions_suit = self.position.into_iter().flatten().all(|role| suits(role, &[ScalarType::F32]));
        check(positions_suit, "a coordinate of another type")?;
        let intensity_suits = self.intensity.is_none_or(|role| suits(role, &INTENSITY_TYPES));
        check(intensity_suits, "an intensity of another type")?;
        match &self.wrapping {
            Wrapping::Plain => Ok(()),
            Wrapping::PcdCompressed { .. } | Wrapping::BigEndian => check(stride > 0, "no fields"),
            Wrapping::Scaled(axes) => {
                check(self.position.is_some(), "no coordinates to scale")?;
                check(axes.iter().all(Axis::is_valid), INVALID_AXIS)
            }
            Wrapping::Widened(widened)
            | Wrapping::ByField(widened)
            | Wrapping::Arrow { widenings: widened, .. } => {
                let is_by_record = matches!(self.wrapping, Wrapping::Widened(_));
                let suit = |(field, widening): (&Field, &Widening)| match widening {
                    Widening::None => true,
                    Widening::Exact | Widening::Half => field.scalar == ScalarType::F32,
                    Widening::Decimal(rule) => field.scalar == ScalarType::F32 && rule.suits(ScalarType::F32),
                    Widening::Steps(_) => field.scalar == ScalarType::F32 && is_by_record,
                };
                let is_valid = |widening: &Widening| match widening {
                    Widening::Steps(axis) => axis.is_valid(),
                    Widening::None | Widening::Exact | Widening::Decimal(_) | Widening::Half => true,
                };
                check(widened.iter().all(is_valid), INVALID_AXIS)?;
                check(widened.len() == self.fields.len(), "another number of widened fields")?;
                check(stride > 0, "no fields")?;
                check(self.fields.iter().zip(widened).all(suit), "a widened field of another type")
            }
            Wrapping::Text(format) => {
                let of_fields = self
                    .fields
                    .iter()
                    .flat_map(|field| std::iter::repeat_n(field.scalar, field.count as usize));
                let fits = format.columns.iter().map(|column| column.scalar).eq(of_fields) && stride > 0;
                check(fits, "columns do not fill the record")?;
                format.validate()
            }
        }
    }

    /// The axes of the coordinates, if the file has integers in place of all three.
    pub fn axes(&self) -> Option<[Axis; 3]> {
        let [x, y, z] = self.position?.map(|field| match &self.wrapping {
            Wrapping::Widened(widened) => match widened.get(field as usize) {
                Some(Widening::Steps(axis)) => Some(*axis),
                _ => None,
            },
            _ => None,
        });
        match self.wrapping {
            Wrapping::Scaled(axes) => Some(axes),
            _ => Some([x?, y?, z?]),
        }
    }

    /// Appends the serialised layout: wrapping, fields, roles, the wrapping's parameters.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        out.push(match self.wrapping {
            Wrapping::Plain => PLAIN,
            Wrapping::PcdCompressed { .. } => PCD_COMPRESSED,
            Wrapping::Text(_) => TEXT,
            Wrapping::BigEndian => BIG_ENDIAN,
            Wrapping::Scaled(_) => SCALED,
            Wrapping::Widened(_) => WIDENED,
            Wrapping::ByField(_) => BY_FIELD,
            Wrapping::Arrow { .. } => ARROW,
        });
        write_unsigned(out, self.fields.len() as u64);
        for field in &self.fields {
            write_unsigned(out, field.name.len() as u64);
            out.extend_from_slice(field.name.as_bytes());
            out.push(field.scalar as u8);
            write_unsigned(out, u64::from(field.count));
        }
        let position = self.position.map_or([None; 3], |position| position.map(Some));
        for role in position.into_iter().chain([self.intensity]) {
            write_unsigned(out, role.map_or(0, |field| u64::from(field) + 1));
        }
        match &self.wrapping {
            Wrapping::Plain | Wrapping::BigEndian => {}
            Wrapping::PcdCompressed { lzf } => out.push(*lzf as u8),
            Wrapping::Text(format) => format.write_to(out),
            Wrapping::Widened(widenings) | Wrapping::ByField(widenings) => write_widenings(widenings, out),
            Wrapping::Arrow { is_wide, widenings } => {
                out.push((*is_wide).into());
                write_widenings(widenings, out);
            }
            Wrapping::Scaled(axes) => {
                axes.iter().for_each(|axis| axis.write_to(out));
            }
        }
    }

    /// Takes a serialised layout off the front of `input`.
    ///
    /// # Errors
    /// [`Error::Corrupt`] if it is cut short or not [valid](Self::validate).
    pub fn read_from(input: &mut &[u8]) -> Result<Layout> {
        let wrapping = read_byte(input)?;
        let count = read_number(input)?;
        // Not allocated up front: the list grows with the input, as each field takes at least three bytes.
        let mut fields = Vec::new();
        for _ in 0..count {
            fields.push(read_field(input)?);
        }
        let [x, y, z, intensity] =
            [read_number(input)?, read_number(input)?, read_number(input)?, read_number(input)?]
                .map(|number| number.checked_sub(1));
        let position = match (x, y, z) {
            (Some(x), Some(y), Some(z)) => Some([x, y, z]),
            (None, None, None) => None,
            _ => return Err(Error::corrupt("record layout: a coordinate is missing")),
        };
        let wrapping = match wrapping {
            PLAIN => Wrapping::Plain,
            PCD_COMPRESSED => Wrapping::PcdCompressed { lzf: read_dialect(input)? },
            BIG_ENDIAN => Wrapping::BigEndian,
            TEXT => {
                let values = fields.iter().map(|field: &Field| u64::from(field.count)).sum();
                Wrapping::Text(TextFormat::read_from(input, values)?)
            }
            SCALED => Wrapping::Scaled([read_axis(input)?, read_axis(input)?, read_axis(input)?]),
            WIDENED => Wrapping::Widened(read_widenings(input, fields.len())?),
            BY_FIELD => Wrapping::ByField(read_widenings(input, fields.len())?),
            ARROW => Wrapping::Arrow {
                is_wide: match read_byte(input)? {
                    0 => false,
                    1 => true,
                    _ => return Err(Error::corrupt("record layout: unknown alignment")),
                },
                widenings: read_widenings(input, fields.len())?,
            },
            _ => return Err(Error::corrupt("record layout: unknown wrapping")),
        };
        let layout = Layout { wrapping, fields, position, intensity };
        layout.validate()?;
        Ok(layout)
    }
}

/// The types that an intensity may have: those whose values float32 represents exactly.
pub const INTENSITY_TYPES: [ScalarType; 3] = [ScalarType::F32, ScalarType::U8, ScalarType::U16];

fn read_field(input: &mut &[u8]) -> Result<Field> {
    let length = read_number(input)? as usize;
    let name = input.split_off(..length).ok_or_else(|| Error::corrupt("record layout: cut short"))?;
    let name = std::str::from_utf8(name).map_err(|_| Error::corrupt("record layout: no name for a field"))?;
    let scalar = ScalarType::from_number(read_byte(input)?)
        .ok_or_else(|| Error::corrupt("record layout: unknown type"))?;
    Ok(Field { name: name.to_owned(), scalar, count: read_number(input)? })
}

fn read_dialect(input: &mut &[u8]) -> Result<LzfDialect> {
    let dialect = LzfDialect::ALL.get(usize::from(read_byte(input)?));
    dialect.copied().ok_or_else(|| Error::corrupt("record layout: unknown LZF dialect"))
}

fn write_widenings(widenings: &[Widening], out: &mut Vec<u8>) {
    for widening in widenings {
        match widening {
            Widening::None => out.push(0),
            Widening::Exact => out.push(1),
            Widening::Decimal(rule) => {
                let (rule, parameter) = rule.to_bytes();
                out.extend([2, rule, parameter]);
            }
            Widening::Steps(axis) => {
                out.push(3);
                axis.write_to(out);
            }
            Widening::Half => out.push(4),
        }
    }
}

fn read_widenings(input: &mut &[u8], count: usize) -> Result<Vec<Widening>> {
    let widening = |_| match read_byte(input)? {
        0 => Ok(Widening::None),
        1 => Ok(Widening::Exact),
        2 => NumberRule::from_bytes(read_byte(input)?, read_byte(input)?)
            .map(Widening::Decimal)
            .ok_or_else(|| Error::corrupt("record layout: unknown number rule")),
        3 => read_axis(input).map(Widening::Steps),
        4 => Ok(Widening::Half),
        _ => Err(Error::corrupt("record layout: unknown widening")),
    };
    (0..count).map(widening).collect()
}

fn read_axis(input: &mut &[u8]) -> Result<Axis> {
    let mut number = || {
        let bytes = input.split_off(..8).and_then(|bytes| bytes.try_into().ok());
        bytes.map(f64::from_le_bytes).ok_or_else(|| Error::corrupt("record layout: cut short"))
    };
    Ok(Axis { per_metre: number()?, offset: number()? })
}

fn read_byte(input: &mut &[u8]) -> Result<u8> {
    let (&byte, rest) = input.split_first().ok_or_else(|| Error::corrupt("record layout: cut short"))?;
    *input = rest;
    Ok(byte)
}

fn read_number(input: &mut &[u8]) -> Result<u32> {
    let number = read_unsigned(input, "record layout")?;
    u32::try_from(number).map_err(|_| Error::corrupt("record layout: number too large"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Column, NumberRule, Printf, Separator};
    use super::*;

    fn kitti() -> Layout {
        Layout {
            wrapping: Wrapping::Plain,
            fields: ["x", "y", "z", "intensity"].map(|name| Field::new(name, ScalarType::F32)).to_vec(),
            position: Some([0, 1, 2]),
            intensity: Some(3),
        }
    }

    /// KITTI's layout with these fields appended.
    fn with(fields: &[Field]) -> Layout {
        Layout { fields: [&kitti().fields, fields].concat(), ..kitti() }
    }

    fn text(columns: Vec<Column>) -> Wrapping {
        let separator = Separator::Semicolon;
        let format = TextFormat { crlf: true, separator, trailing_separator: true, ..TextFormat::default() };
        let printf = Printf { ties_away: true, long_exponent: true };
        let widths = (0..columns.len() as u8).collect();
        Wrapping::Text(TextFormat { space_after: true, open_end: true, printf, columns, widths, ..format })
    }

    fn scaled(per_metre: f64, offset: f64) -> Wrapping {
        Wrapping::Scaled([Axis { per_metre, offset }; 3])
    }

    fn round_trip(layout: &Layout) -> usize {
        let mut bytes = Vec::new();
        layout.write_to(&mut bytes);
        let mut input = &bytes[..];
        assert_eq!(&Layout::read_from(&mut input).unwrap(), layout);
        assert!(input.is_empty());
        for cut in 0..bytes.len() {
            assert!(Layout::read_from(&mut &bytes[..cut]).is_err(), "cut at {cut}");
        }
        bytes.len()
    }

    #[test]
    fn layouts_come_back() {
        assert_eq!(round_trip(&Layout::default()), 6);
        assert_eq!(round_trip(&kitti()), 2 + 3 * 4 + 12 + 4);
        let wrapping = Wrapping::PcdCompressed { lzf: LzfDialect::Very16 };
        round_trip(&Layout { wrapping, ..with(&[Field::padding(296)]) });
        let fields = [Field::new("time", ScalarType::F64), Field::new("class\u{e9}", ScalarType::U8)];
        round_trip(&Layout { wrapping: Wrapping::BigEndian, ..with(&fields) });
        let axes = [1e3, 1e2, 0.5].map(|per_metre| Axis { per_metre, offset: -per_metre });
        round_trip(&Layout { wrapping: Wrapping::Scaled(axes), ..kitti() });
        let decimal = Widening::Decimal(NumberRule::Significant(8));
        let widenings = vec![Widening::Exact, decimal, decimal, Widening::None];
        round_trip(&Layout { wrapping: Wrapping::Widened(widenings.clone()), ..kitti() });
        round_trip(&Layout { wrapping: Wrapping::ByField(widenings), ..kitti() });
        let shortest = NumberRule::Shortest { double: true, point_zero: false };
        let columns = vec![
            Column { scalar: ScalarType::F32, rule: NumberRule::Significant(8) },
            Column { scalar: ScalarType::F64, rule: shortest },
            Column { scalar: ScalarType::I16, rule: NumberRule::Integer },
            Column { scalar: ScalarType::I16, rule: NumberRule::Integer },
        ];
        let fields = vec![
            Field::new("i", ScalarType::F32),
            Field::new("t", ScalarType::F64),
            Field { count: 2, ..Field::new("", ScalarType::I16) },
        ];
        round_trip(&Layout { wrapping: text(columns), fields, position: None, intensity: Some(0) });
    }

    #[test]
    fn channels_are_what_has_no_role() {
        assert_eq!((kitti().stride(), kitti().channel_bytes()), (16, 0));
        let fields = [
            Field::padding(4),
            Field::new("z", ScalarType::F32),
            Field::new("y", ScalarType::F32),
            Field::new("x", ScalarType::F32),
            Field { count: 2, ..Field::new("normal", ScalarType::F64) },
            Field::new("i", ScalarType::U16),
            Field::new("ring", ScalarType::U8),
        ];
        let layout = Layout {
            fields: fields.to_vec(),
            position: Some([3, 2, 1]),
            intensity: Some(5),
            ..Layout::default()
        };
        layout.validate().unwrap();
        let channels: Vec<_> = layout.channels().collect();
        assert_eq!(channels, [(0, &fields[0]), (16, &fields[4]), (34, &fields[6])]);
        assert_eq!((layout.stride(), layout.channel_bytes()), (35, 21));
        assert_eq!(layout.position_offsets(), Some([12, 8, 4]));
        assert_eq!(layout.intensity_offset(), Some((32, ScalarType::U16)));
    }

    #[test]
    fn impossible_layouts_are_refused() {
        let integers = Column { scalar: ScalarType::F32, rule: NumberRule::Integer };
        let digits = Column { scalar: ScalarType::F32, rule: NumberRule::Fixed(41) };
        let bad = [
            with(&[Field::padding(MAX_STRIDE)]),
            with(&[Field { count: u32::MAX, ..Field::new("a", ScalarType::F64) }]),
            with(&[Field::padding(0)]),
            with(&[Field::new("a b", ScalarType::U8)]),
            with(&[Field::new(&"a".repeat(MAX_NAME + 1), ScalarType::U8)]),
            Layout { position: Some([0, 1, 4]), ..kitti() },
            Layout { position: Some([2, 1, 2]), ..kitti() },
            Layout { intensity: Some(0), ..kitti() },
            Layout { intensity: Some(u32::MAX - 1), ..kitti() },
            Layout { intensity: Some(4), ..with(&[Field::new("i", ScalarType::F64)]) },
            Layout { position: Some([0, 1, 4]), ..with(&[Field::new("z", ScalarType::F64)]) },
            Layout { fields: vec![], ..kitti() },
            Layout { wrapping: text(vec![]), ..Layout::default() },
            Layout { wrapping: Wrapping::BigEndian, ..Layout::default() },
            Layout { wrapping: scaled(1e3, 0.0), position: None, ..kitti() },
            Layout { wrapping: Wrapping::Widened(vec![Widening::Exact; 3]), ..kitti() },
            Layout {
                wrapping: Wrapping::ByField(vec![Widening::Decimal(NumberRule::Integer); 4]),
                ..kitti()
            },
            Layout { wrapping: Wrapping::Widened(vec![]), ..Layout::default() },
            Layout {
                wrapping: Wrapping::Widened(vec![Widening::Exact; 5]),
                ..with(&[Field::new("t", ScalarType::F64)])
            },
            Layout { wrapping: scaled(0.0, 0.0), ..kitti() },
            Layout { wrapping: scaled(-1.0, 0.0), ..kitti() },
            Layout { wrapping: scaled(f64::NAN, 0.0), ..kitti() },
            Layout { wrapping: scaled(f64::INFINITY, 0.0), ..kitti() },
            Layout { wrapping: scaled(1.0, f64::NEG_INFINITY), ..kitti() },
            Layout { wrapping: text(vec![integers; 3]), ..kitti() },
            Layout { wrapping: text(vec![integers; 4]), ..kitti() },
            Layout { wrapping: text(vec![digits; 4]), ..kitti() },
        ];
        for layout in bad {
            let mut bytes = Vec::new();
            layout.write_to(&mut bytes);
            assert!(layout.validate().is_err(), "{layout:?}");
            assert!(Layout::read_from(&mut &bytes[..]).is_err(), "{layout:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_give_a_valid_layout_or_an_error(bytes in prop::collection::vec(0u8..12, 0..40)) {
            let mut input = &bytes[..];
            if let Ok(layout) = Layout::read_from(&mut input) {
                prop_assert!(layout.validate().is_ok());
                let mut again = Vec::new();
                layout.write_to(&mut again);
                prop_assert_eq!(&Layout::read_from(&mut &again[..]).unwrap(), &layout);
                prop_assert!(layout.channel_bytes() <= layout.stride());
            }
        }
    }
}
