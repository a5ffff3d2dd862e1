//! NumPy arrays, `.npy`: structured arrays, whose fields are those of the records, or tables of numbers: one
//! row per record or, in few rows, one column per record, as nuScenes' devkit keeps points.
//!
//! Source: NumPy, `numpy.lib.format`, versions 1 to 3.

use super::field::{Declared, FEWEST_COLUMNS, layout_of, names_coordinates, usual_names};
use super::{by_field, field, records, widened};
use crate::scan::{Field, ScalarType, ScanFile, Wrapping};

const MAGIC: &[u8] = b"\x93NUMPY";
/// Arrays of points do not have longer headers.
const MOST_HEADER: usize = 1 << 20;

/// Numbers of fields, and of records, of tables that look like points.
const MAY_BE_FIELDS: std::ops::RangeInclusive<u64> = FEWEST_COLUMNS as u64..=11;
const MANY: u64 = 100;

/// The properties of the records according to the header.
pub(super) struct Header {
    /// Half-precision numbers are of type `u16` here.
    fields: Vec<Field>,
    halves: Vec<bool>,
    /// Number of records, which may be wrong: the body decides.
    records: u64,
    is_big_endian: bool,
    /// Whether the records are stored field by field.
    is_by_field: bool,
    /// Whether the records are the columns of a table.
    has_columns: bool,
    /// Whether the file itself names the fields.
    is_named: bool,
    /// Bytes of the header.
    length: usize,
}

impl Header {
    /// Reads the header that `bytes` begin with; `None` if it is damaged, or if the array has no records that
    /// this program supports: of objects, of two byte orders, or a table of fewer than three columns.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        let (version, rest) = bytes.strip_prefix(MAGIC)?.split_first_chunk::<2>()?;
        let (start, size) = match version {
            [1, _] => (2, usize::from(u16::from_le_bytes(*rest.first_chunk()?))),
            [2 | 3, _] => (4, usize::try_from(u32::from_le_bytes(*rest.first_chunk()?)).ok()?),
            _ => return None,
        };
        let length = MAGIC.len() + version.len() + start + size;
        let text = rest.get(start..start + size).filter(|text| text.len() <= MOST_HEADER)?;
        let mut text = std::str::from_utf8(text).ok()?;
        let Literal::Dictionary(entries) = Literal::read(&mut text, 0)? else { return None };
        let entry = |name: &str| entries.iter().find(|(key, _)| *key == name).map(|(_, value)| value);
        let shape = entry("shape")?.numbers()?;
        let is_column_major = shape.len() > 1 && !matches!(entry("fortran_order")?, Literal::Word("False"));
        let mut orders = Orders::default();
        let has_columns =
            matches!(shape[..], [fields, records] if MAY_BE_FIELDS.contains(&fields) && records >= MANY);
        let (kinds, shape, is_named) = match entry("descr")? {
            Literal::Text(kind) => {
                let (fields, records) = match has_columns {
                    true => shape.split_first(),
                    false => shape.split_last().filter(|(_, rows)| !rows.is_empty()),
                }?;
                let fields = usize::try_from(*fields).ok().filter(|fields| *fields >= FEWEST_COLUMNS)?;
                let kind = orders.kind(kind)?;
                let names = usual_names(fields);
                let field = |name: &String| Some((kind.field(name, 1)?, kind.is_half));
                (names.iter().map(field).collect::<Option<Vec<_>>>()?, records, false)
            }
            Literal::Sequence(parts) => {
                let fields = parts.iter().map(|part| orders.field(part)).collect::<Option<_>>()?;
                (fields, &shape[..], true)
            }
            _ => return None,
        };
        let records = shape.iter().try_fold(1u64, |product, count| product.checked_mul(*count))?;
        let is_big_endian = orders.is_big_endian()?;
        // Structures are whole in either order; their own order is that of the file.
        let is_by_field = !is_named && is_column_major != has_columns;
        let (fields, halves) = kinds.into_iter().unzip();
        Some(Header { fields, halves, records, is_big_endian, is_by_field, has_columns, is_named, length })
    }

    /// Whether an array in a folder, which was not named explicitly, looks like points: it names coordinates,
    /// or has many rows of a few floating-point numbers.
    pub(super) fn looks_like_points(&self) -> bool {
        match self.is_named {
            true => names_coordinates(self.fields.iter().map(|field| &field.name[..])),
            false => {
                self.records >= MANY
                    && MAY_BE_FIELDS.contains(&(self.fields.len() as u64))
                    && self
                        .fields
                        .iter()
                        .zip(&self.halves)
                        .all(|(f, is_half)| f.scalar.is_float() || *is_half)
            }
        }
    }
}

/// Splits a file. `None` if its header is not supported.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let layout = layout_of(header.fields, Wrapping::Plain)?;
    match (header.is_by_field, header.is_big_endian) {
        (false, false) => widened::parse(layout, &header.halves, bytes, header.length, header.records),
        (false, true) => records::parse_big_endian(layout, bytes, header.length, header.records),
        (true, false) => by_field::parse(layout, &header.halves, bytes, header.length, header.records),
        (true, true) => None,
    }
}

/// The header with another number of points, of the same length; `None` if it is not valid or has no room.
pub(super) fn with_point_count(header: &[u8], points: usize) -> Option<Vec<u8>> {
    let known = Header::parse(header)?;
    let text = header.get(..known.length)?;
    let find = |what: &[u8], from: usize| {
        Some(from + text.get(from..)?.windows(what.len()).position(|part| part == what)?)
    };
    let start = find(b"(", find(b"'shape':", 0)?)?;
    let end = find(b")", start)? + 1;
    let shape = match known.is_named {
        true => format!("({points},)"),
        false if known.has_columns => format!("({}, {points})", known.fields.len()),
        false => format!("({points}, {})", known.fields.len()),
    };
    let padding = (end - start).checked_sub(shape.len())?;
    let line_end = known.length - 1;
    let spaces = vec![b' '; padding];
    Some([&text[..start], shape.as_bytes(), &text[end..line_end], &spaces, &text[line_end..]].concat())
}

/// The header of a structured array with these fields, of one value each.
pub(super) fn header(fields: &[(&str, ScalarType)], records: usize) -> Vec<u8> {
    let kind = |scalar: ScalarType| match scalar {
        ScalarType::U8 => "|u1".to_owned(),
        ScalarType::I8 => "|i1".to_owned(),
        // `u16` becomes `<u2`.
        other => format!("<{}{}", &other.name()[..1], other.size()),
    };
    let fields = fields
        .iter()
        .map(|(name, scalar)| format!("('{}', '{}'), ", name.replace(['\'', '\\'], "_"), kind(*scalar)));
    let text = format!(
        "{{'descr': [{}], 'fortran_order': False, 'shape': ({records},), }}",
        fields.collect::<String>().trim_end_matches(", ")
    );
    // The data begin at a multiple of 64.
    let before = |lengths: usize| MAGIC.len() + 2 + lengths;
    let padded = |lengths: usize| (before(lengths) + text.len() + 1).next_multiple_of(64) - before(lengths);
    let mut out = MAGIC.to_vec();
    let size = match u16::try_from(padded(2)) {
        Ok(size) if text.is_ascii() => {
            out.extend([1, 0]);
            out.extend(size.to_le_bytes());
            usize::from(size)
        }
        _ => {
            // Version 2 is the first that allows longer headers, version 3 the first that allows other
            // characters.
            out.extend([if text.is_ascii() { 2 } else { 3 }, 0]);
            out.extend((padded(4) as u32).to_le_bytes());
            padded(4)
        }
    };
    let end = out.len() + size - 1;
    out.extend(text.into_bytes());
    out.resize(end, b' ');
    out.push(b'\n');
    out
}

/// The type of a value.
#[derive(Clone, Copy)]
struct Kind {
    scalar: Option<ScalarType>,
    width: u32,
    is_half: bool,
}

impl Kind {
    fn field(self, name: &str, count: u32) -> Option<Field> {
        Declared { name, scalar: self.scalar, width: self.width.checked_mul(count)? }.field()
    }
}

/// The byte orders of the values of several bytes.
#[derive(Default)]
struct Orders {
    little: bool,
    big: bool,
}

impl Orders {
    /// `None` if both byte orders occur.
    fn is_big_endian(&self) -> Option<bool> {
        (!(self.little && self.big)).then_some(self.big)
    }

    /// A type such as `<f4`. `None` if its values are stored elsewhere, or if it is unknown.
    fn kind(&mut self, text: &str) -> Option<Kind> {
        let mut letters = text.chars();
        let order = letters.next()?;
        let letter = letters.next()?;
        // Dates have a unit after the size.
        let digits = letters.as_str().split('[').next()?;
        let size: u32 = digits.parse().ok()?;
        let integers = |of_size: [ScalarType; 4]| of_size.into_iter().find(|scalar| scalar.size() == size);
        let scalar = match letter {
            'f' if size == 2 => Some(ScalarType::U16),
            'f' if size == 4 => Some(ScalarType::F32),
            'f' if size == 8 => Some(ScalarType::F64),
            'i' => Some(integers([ScalarType::I8, ScalarType::I16, ScalarType::I32, ScalarType::I64])?),
            'u' => Some(integers([ScalarType::U8, ScalarType::U16, ScalarType::U32, ScalarType::U64])?),
            'b' if size == 1 => Some(ScalarType::U8),
            'm' | 'M' if size == 8 => Some(ScalarType::I64),
            // Bytes without a known meaning.
            'f' | 'c' | 'S' | 'a' | 'V' => None,
            // Characters of four bytes each.
            'U' => return Some(Kind { scalar: None, width: size.checked_mul(4)?, is_half: false }),
            _ => return None,
        };
        match (order, scalar.filter(|scalar| scalar.size() > 1)) {
            (_, None) => {}
            ('<', _) => self.little = true,
            ('>', _) => self.big = true,
            _ => return None,
        }
        Some(Kind { scalar, width: size, is_half: letter == 'f' && size == 2 })
    }

    /// A field of a structure: its name, its type, and the shape of its values if it has several; and whether
    /// these are half-precision numbers.
    fn field(&mut self, part: &Literal) -> Option<(Field, bool)> {
        let Literal::Sequence(parts) = part else { return None };
        let (name, kind, shape) = match &parts[..] {
            [name, Literal::Text(kind)] => (name, kind, Vec::new()),
            [name, Literal::Text(kind), shape] => (name, kind, shape.numbers()?),
            _ => return None,
        };
        let name = match name {
            Literal::Text(name) => *name,
            // A name with a title before it.
            Literal::Sequence(names) => match names[..] {
                [_, Literal::Text(name)] => name,
                _ => return None,
            },
            _ => return None,
        };
        let count = shape.iter().try_fold(1u64, |product, count| product.checked_mul(*count))?;
        let kind = self.kind(kind)?;
        Some((kind.field(&field::with_underscores(name), u32::try_from(count).ok()?)?, kind.is_half))
    }
}

/// A Python literal, as far as headers contain them.
#[derive(Debug)]
enum Literal<'a> {
    /// A string without escapes.
    Text(&'a str),
    Number(u64),
    /// `True`, `False` or `None`.
    Word(&'a str),
    /// A tuple or a list.
    Sequence(Vec<Literal<'a>>),
    Dictionary(Vec<(&'a str, Literal<'a>)>),
}

impl<'a> Literal<'a> {
    /// Takes a literal off the front of `rest`; `depth` is the number of literals around it.
    fn read(rest: &mut &'a str, depth: u8) -> Option<Self> {
        /// A field's title is in a tuple, which is in the field's tuple, which is in the list of fields,
        /// which is in the dictionary.
        const MOST_DEPTH: u8 = 4;
        *rest = rest.trim_start();
        let first = rest.chars().next().filter(|_| depth <= MOST_DEPTH)?;
        let close = match first {
            '(' => ')',
            '[' => ']',
            '{' => '}',
            '\'' | '"' => {
                let (text, after) = rest[1..].split_once(first)?;
                *rest = after;
                return Some(Literal::Text(text)).filter(|_| !text.contains('\\'));
            }
            _ => {
                let end = rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(rest.len());
                let (word, after) = rest.split_at(end);
                *rest = after;
                return match word {
                    "True" | "False" | "None" => Some(Literal::Word(word)),
                    // Python 2 marked long integers.
                    _ => word.strip_suffix('L').unwrap_or(word).parse().ok().map(Literal::Number),
                };
            }
        };
        *rest = &rest[1..];
        let (mut items, mut entries) = (Vec::new(), Vec::new());
        loop {
            *rest = rest.trim_start();
            if let Some(after) = rest.strip_prefix(close) {
                *rest = after;
                return Some(if first == '{' {
                    Literal::Dictionary(entries)
                } else {
                    Literal::Sequence(items)
                });
            }
            let item = Literal::read(rest, depth + 1)?;
            *rest = rest.trim_start();
            match item {
                Literal::Text(key) if first == '{' => {
                    *rest = rest.strip_prefix(':')?;
                    entries.push((key, Literal::read(rest, depth + 1)?));
                    *rest = rest.trim_start();
                }
                _ if first == '{' => return None,
                item => items.push(item),
            }
            match rest.strip_prefix(',') {
                Some(after) => *rest = after,
                None if rest.starts_with(close) => {}
                None => return None,
            }
        }
    }

    /// The numbers of a sequence, or the number itself.
    fn numbers(&self) -> Option<Vec<u64>> {
        match self {
            Literal::Number(number) => Some(vec![*number]),
            Literal::Sequence(items) => items.iter().map(|item| Some(*item.numbers()?.first()?)).collect(),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::{comes_back, floats};
    use crate::files::{starts_as_scan, starts_as_scan_of_folder};
    use crate::scan::Widening;

    /// An array of version 1.
    fn array(descr: &str, order: &str, shape: &str, body: &[u8]) -> Vec<u8> {
        let text = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
        [MAGIC, &[1, 0], &(text.len() as u16).to_le_bytes(), text.as_bytes(), body].concat()
    }

    #[test]
    fn half_precision_is_widened() {
        let halves = [0x3c00u16, 0xc000, 0x4200, 0x3800, 0x7e01, 0x8000, 0x0001, 0xfbff];
        let body: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        let scan = comes_back("a.npy", array("'<f2'", "False", "(2, 4)", &body));
        assert_eq!(scan.layout.wrapping, Wrapping::Widened(vec![Widening::Half; 4]));
        assert_eq!((scan.cloud.positions[0], scan.cloud.intensity[0]), ([1.0, -2.0, 3.0], 0.5));
        let by_column = comes_back("a.npy", array("'<f2'", "True", "(2, 4)", &body));
        assert_eq!(by_column.cloud.positions[1][0], -2.0);
        let fields = "[('x', '<f2'), ('y', '<f2'), ('z', '<f2'), ('ring', '<u2')]";
        let scan = comes_back("a.npy", array(fields, "False", "(2,)", &body));
        assert_eq!(scan.cloud.channel("ring").unwrap().bytes, [0x00, 0x38, 0xff, 0xfb]);
        assert_eq!(scan.cloud.positions[1][2], 2f32.powi(-24));
        let big: Vec<u8> = halves.iter().flat_map(|half| half.to_be_bytes()).collect();
        let scan = comes_back("a.npy", array("'>f2'", "False", "(2, 4)", &big));
        assert_eq!((scan.layout.wrapping, scan.layout.position), (Wrapping::BigEndian, None));
        let many = array("'<f2'", "False", "(100, 4)", &[0; 800]);
        assert!(starts_as_scan_of_folder("a.npy", &many));
    }

    #[test]
    fn tables_are_records_of_floats() {
        let body = floats(&[1.0, 2.0, 3.0, 0.5, 9.0, -1.0, -0.0, f32::NAN, 0.25, 8.0]);
        let scan = comes_back("a.npy", array("'<f4'", "False", "(2, 5)", &body));
        assert_eq!(
            (scan.records, scan.layout.position, scan.layout.intensity),
            (2, Some([0, 1, 2]), Some(3))
        );
        assert_eq!(scan.layout.fields[4].name, "column_5");
        // An organised array, cut short; and one followed by further bytes.
        let scan = comes_back("a.npy", array("'<f4'", "False", "(64L, 1024, 5)", &body));
        assert_eq!((scan.records, scan.suffix.len()), (2, 0));
        let scan = comes_back("a.npy", array("'<f4'", "False", "(1, 5)", &body));
        assert_eq!((scan.records, scan.suffix.len()), (1, 20));
        let big: Vec<u8> = body.chunks(4).flat_map(|value| value.iter().rev()).copied().collect();
        let scan = comes_back("a.npy", array("'>f4'", "False", "(2, 5)", &big));
        assert_eq!((scan.layout.wrapping, scan.cloud.positions[0]), (Wrapping::BigEndian, [1.0, 2.0, 3.0]));
        let scan = comes_back("a.npy", array("'<f8'", "False", "(1, 3)", &[1; 24]));
        assert_eq!((scan.records, scan.layout.fields[0].scalar), (1, ScalarType::F64));
        let mut second = array("'<f4'", "False", "(2, 5)", &body);
        second[6] = 2;
        second.splice(10..10, [0, 0]);
        assert_eq!(comes_back("a.npy", second).records, 2);
    }

    #[test]
    fn records_may_be_the_columns_of_a_table() {
        let rows: Vec<[f32; 120]> =
            (0u8..4).map(|row| std::array::from_fn(|n| f32::from(row) + n as f32)).collect();
        let body = floats(rows.as_flattened());
        let scan = comes_back("a.npy", array("'<f4'", "False", "(4, 120)", &body));
        assert_eq!((scan.records, scan.cloud.positions[119]), (120, [119.0, 120.0, 121.0]));
        assert!(starts_as_scan_of_folder("a.npy", &array("'<f4'", "False", "(4, 120)", &body)));
        let header = with_point_count(&array("'<f4'", "False", "(4, 120)", &[]), 110).unwrap();
        let scan = comes_back("a.npy", [&header[..], &body[..4 * 4 * 110]].concat());
        assert_eq!((scan.records, scan.suffix.len()), (110, 0));
        let scan = comes_back("a.npy", array("'<f4'", "True", "(4, 120)", &body));
        assert_eq!((scan.records, scan.cloud.positions[1]), (120, [4.0, 5.0, 6.0]));
        // An image, or matrices.
        assert!(comes_back("a.npy", array("'|u1'", "False", "(12, 1024)", &[0; 12 * 1024])).is_opaque());
        assert_eq!(comes_back("a.npy", array("'<f4'", "False", "(12, 40)", &body)).layout.fields.len(), 40);
    }

    #[test]
    fn tables_may_be_stored_column_by_column() {
        let columns = [[1.0, 9.0], [2.0, -1.0], [3.0, -0.0], [0.5, 0.25]];
        let body = floats(columns.as_flattened());
        let scan = comes_back("a.npy", array("'<f4'", "True", "(2, 4)", &[&body[..], b"more"].concat()));
        assert_eq!((scan.records, &scan.suffix[..]), (2, &b"more"[..]));
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0], [9.0, -1.0, -0.0]]);
        assert_eq!(scan.cloud.intensity, [0.5, 0.25]);
        let scan = comes_back("a.npy", array("'<f4'", "True", "(1, 2, 4)", &body));
        assert_eq!(scan.cloud.positions[1], [9.0, -1.0, -0.0]);
        // As pandas writes its tables: doubles, of which all but the time are float32.
        let doubles = columns.as_flattened().iter().map(|&value| f64::from(value)).chain([0.1, 0.2]);
        let body: Vec<u8> = doubles.flat_map(f64::to_le_bytes).collect();
        let scan = comes_back("a.npy", array("'<f8'", "True", "(2, 5)", &body));
        assert_eq!(
            scan.layout.wrapping,
            Wrapping::ByField([vec![Widening::Exact; 4], vec![Widening::None]].concat())
        );
        assert_eq!(scan.cloud.positions[1], [9.0, -1.0, -0.0]);
        assert_eq!(scan.cloud.channels[0].bytes, [0.1_f64, 0.2].map(f64::to_le_bytes).concat());
        // Structures are stored as wholes.
        let scan = comes_back("a.npy", array("[('x', '<f4'), ('y', '<f4')]", "True", "(2, 2)", &body[..32]));
        assert_eq!((scan.records, scan.layout.wrapping), (4, Wrapping::Plain));
    }

    #[test]
    fn structures_have_their_fields() {
        let descr = "[('x', '<f4'), ('y', '<f4'), (('height', 'z'), '<f4'), ('laser id', '|u1'), ('', '|V3'), ('t', '<M8[ns]'), \
                     (\"n\", '<i2', (2,)), ('name', '<U2'), ('half', '<f2'), ('ok', '|b1')]";
        let body = vec![3; 2 * (12 + 1 + 3 + 8 + 4 + 8 + 2 + 1)];
        let scan = comes_back("a.npy", array(descr, "False", "(2,)", &body));
        let fields: Vec<_> = scan.layout.fields.iter().map(|f| (&f.name[..], f.scalar, f.count)).collect();
        let expected = [
            ("x", ScalarType::F32, 1),
            ("y", ScalarType::F32, 1),
            ("z", ScalarType::F32, 1),
            ("laser_id", ScalarType::U8, 1),
            ("", ScalarType::U8, 3),
            ("t", ScalarType::I64, 1),
            ("n", ScalarType::I16, 2),
            ("", ScalarType::U8, 8),
            ("half", ScalarType::F32, 1),
            ("ok", ScalarType::U8, 1),
        ];
        assert_eq!(fields, expected);
        assert_eq!((scan.records, scan.layout.position), (2, Some([0, 1, 2])));
        // An array without records, and one with a single record.
        assert_eq!(comes_back("a.npy", array("[('x', '<f4')]", "True", "(0,)", b"")).records, 0);
        assert_eq!(comes_back("a.npy", array("[('x', '<f4')]", "False", "()", &[0; 8])).records, 1);
    }

    #[test]
    fn other_arrays_are_opaque() {
        let deep = "(".repeat(60_000);
        for (descr, order, shape) in [
            ("'>f4'", "True", "(2, 5)"),
            ("'<f4'", "True", "(3, 5)"),
            ("'<f4'", "False", "(10,)"),
            ("'<f4'", "False", "(5, 2)"),
            ("'<f4'", "False", "()"),
            ("'<f4'", "False", "(2, 65536)"),
            ("'<f4'", "False", "(4294967296, 4294967296, 4294967296, 5)"),
            ("'|O'", "False", "(2, 5)"),
            ("'<f3'", "False", "(2, -5)"),
            ("'=f4'", "False", "(2, 5)"),
            ("[('x', '<f4'), ('y', '>f4')]", "False", "(2,)"),
            ("[('x', [('y', '<f4')])]", "False", "(2,)"),
            ("[('x', '<f4', (4294967296,))]", "False", "(2,)"),
            ("[('x', '|V70000')]", "False", "(2,)"),
            ("[]", "False", "(2,)"),
            ("'<f4", "False", "(2, 5)"),
            (&deep, "False", "(2, 5)"),
        ] {
            let bytes = array(descr, order, shape, &[1; 40]);
            assert!(comes_back("a.npy", bytes.clone()).is_opaque(), "{descr} {order} {shape}");
        }
        let good = array("'<f4'", "False", "(2, 5)", &[1; 40]);
        for end in 0..good.len() - 40 {
            assert!(comes_back("a.npy", good[..end].to_vec()).is_opaque(), "cut at {end}");
        }
        assert_eq!(comes_back("a.npy", good[..good.len() - 40].to_vec()).records, 0);
    }

    #[test]
    fn a_folder_gives_arrays_that_look_like_points() {
        for (descr, shape, is_taken) in [
            ("'<f4'", "(100, 4)", true),
            ("'<f8'", "(32, 1024, 3)", true),
            ("'<f4'", "(99, 4)", false),
            ("'<f4'", "(100, 12)", false),
            ("'<u4'", "(100, 4)", false),
            ("[('x', '<f4'), ('y', '<f4'), ('z', '<f4')]", "(1,)", true),
            ("[('x', '<f4'), ('y', '<f4'), ('w', '<f4')]", "(1000,)", false),
        ] {
            let bytes = array(descr, "False", shape, b"");
            assert!(starts_as_scan("a.npy", &bytes));
            assert_eq!(starts_as_scan_of_folder("a.npy", &bytes), is_taken, "{descr} {shape}");
        }
    }

    #[test]
    fn a_header_gets_another_number_of_points() {
        for (descr, shape) in
            [("'<f4'", "(4, 3, 5)"), ("'<f4'", "(12, 5)"), ("[('x', '<f4', (5,))]", "(12L,)")]
        {
            let header = crate::files::with_point_count(&array(descr, "False", shape, b""), 7);
            let scan = comes_back("a.npy", [header, vec![1; 240]].concat());
            assert_eq!((scan.records, scan.suffix.len()), (7, 100), "{descr} {shape}");
        }
        let header = crate::files::with_point_count(&array("'<f4'", "True", "(4, 3, 5)", b""), 2);
        let body: Vec<f32> = (0..10).map(|value| value as f32).collect();
        let scan = comes_back("a.npy", [header, floats(&body)].concat());
        assert_eq!(scan.cloud.positions, [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]]);
    }

    #[test]
    fn a_header_says_what_it_is_made_of() {
        let fields = [("x", ScalarType::F32), ("ring", ScalarType::U8), ("t", ScalarType::I64)];
        let bytes = header(&fields, 3);
        assert!(
            bytes.starts_with(
                b"\x93NUMPY\x01\x00v\x00{'descr': [('x', '<f4'), ('ring', '|u1'), ('t', '<i8')], "
            )
        );
        assert_eq!((bytes.len(), bytes.last()), (128, Some(&b'\n')));
        let read = Header::parse(&bytes).unwrap();
        let fields = fields.map(|(name, scalar)| Field::new(name, scalar));
        assert_eq!((&read.fields[..], read.records, read.length), (&fields[..], 3, 128));
        let many: Vec<_> = (0..4000).map(|_| ("reflectivity", ScalarType::U16)).collect();
        let bytes = header(&many, 3);
        assert_eq!((bytes[6], bytes.len() % 64), (2, 0));
        assert_eq!(Header::parse(&bytes).unwrap().fields.len(), 4000);
    }
}
