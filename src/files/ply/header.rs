//! The header of a PLY file.

use byteorder::{BigEndian, ByteOrder, LittleEndian};

use crate::files::field::{Declared, next_line};
use crate::scan::ScalarType;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The contents of a header.
pub struct Header<'a> {
    /// How values are written.
    pub encoding: Encoding,
    /// The elements before the vertices.
    pub before: Vec<Element>,
    /// The scalar properties of the vertices.
    pub fields: Vec<Declared<'a>>,
    /// Number of vertices. It may be wrong: the number of records follows from the body.
    pub vertices: u64,
    /// Bytes of the header, including the line end after `end_header`.
    pub length: usize,
}

/// An element other than the vertices.
#[derive(Debug, Default)]
pub struct Element {
    count: u64,
    properties: Vec<Property>,
}

/// A property of an element.
#[derive(Clone, Copy, Debug)]
enum Property {
    Scalar(ScalarType),
    /// A list: its length, of the first type, then that many values of the second.
    List(ScalarType, ScalarType),
}

/// The part of the header that is being read.
enum Place {
    /// Before the vertices; the sizes of these elements are needed.
    Before,
    Vertices,
    /// After the vertices; these elements are part of the suffix, whatever they are.
    After,
}

impl<'a> Header<'a> {
    /// Reads the header at the start of `bytes`; `None` if it is damaged, has no vertices, or has vertices
    /// with lists.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut rest = bytes;
        if next_line(&mut rest)? != "ply" {
            return None;
        }
        let (mut encoding, mut vertices, mut place) = (None, None, Place::Before);
        let (mut before, mut fields): (Vec<Element>, _) = (Vec::new(), Vec::new());
        loop {
            let line = next_line(&mut rest)?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match (&place, &words[..]) {
                (_, ["comment" | "obj_info", ..]) => {}
                (_, ["format", name, _]) => encoding = Some(Encoding::of(name)?),
                (_, ["end_header"]) => break,
                (Place::Before, ["element", "vertex", count]) => {
                    vertices = Some(count.parse().ok()?);
                    place = Place::Vertices;
                }
                (Place::Before, ["element", _, count]) => {
                    before.push(Element { count: count.parse().ok()?, properties: Vec::new() });
                }
                (Place::Before, ["property", kind @ .., _]) => {
                    before.last_mut()?.properties.push(Property::of(kind)?);
                }
                (Place::Vertices, ["property", kind, name]) => {
                    let scalar = scalar(kind)?;
                    fields.push(Declared { name, scalar: Some(scalar), width: scalar.size() });
                }
                (_, ["element", _, _]) => place = Place::After,
                (Place::After, ["property", ..]) => {}
                _ => return None,
            }
        }
        let length = bytes.len() - rest.len();
        Some(Header { encoding: encoding?, before, fields, vertices: vertices?, length })
    }
}

impl Encoding {
    fn of(name: &str) -> Option<Self> {
        match name {
            "ascii" => Some(Encoding::Ascii),
            "binary_little_endian" => Some(Encoding::LittleEndian),
            "binary_big_endian" => Some(Encoding::BigEndian),
            _ => None,
        }
    }

    /// A whole number in binary; `None` if the value is not whole, or negative.
    fn number(self, scalar: ScalarType, bytes: &[u8]) -> Option<usize> {
        let width = bytes.len();
        let number = match (self, scalar) {
            (_, ScalarType::F32 | ScalarType::F64) => return None,
            (Encoding::BigEndian, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64) => {
                BigEndian::read_int(bytes, width).try_into().ok()?
            }
            (_, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64) => {
                LittleEndian::read_int(bytes, width).try_into().ok()?
            }
            (Encoding::BigEndian, _) => BigEndian::read_uint(bytes, width),
            (_, _) => LittleEndian::read_uint(bytes, width),
        };
        usize::try_from(number).ok()
    }
}

impl Property {
    /// The property, given the words between `property` and its name.
    fn of(kind: &[&str]) -> Option<Self> {
        match kind {
            [kind] => Some(Property::Scalar(scalar(kind)?)),
            ["list", count, item] => Some(Property::List(scalar(count)?, scalar(item)?)),
            _ => None,
        }
    }

    /// Number of bytes that the property takes at the front of `bytes`.
    fn size(self, encoding: Encoding, bytes: &[u8]) -> Option<usize> {
        match self {
            Property::Scalar(scalar) => Some(scalar.size() as usize),
            Property::List(count, item) => {
                let width = count.size() as usize;
                let items = encoding.number(count, bytes.get(..width)?)?;
                items.checked_mul(item.size() as usize)?.checked_add(width)
            }
        }
    }
}

/// Number of bytes that all instances of an element take at the front of `body`; `None` if the body is
/// shorter.
pub fn skip(element: &Element, encoding: Encoding, body: &[u8]) -> Option<usize> {
    let mut rest = body;
    // Each instance takes at least one byte, so there cannot be more instances than bytes.
    if element.properties.is_empty() || element.count > body.len() as u64 {
        return (element.count == 0).then_some(0);
    }
    for _ in 0..element.count {
        if encoding == Encoding::Ascii {
            next_line(&mut rest)?;
            continue;
        }
        for property in &element.properties {
            rest = rest.get(property.size(encoding, rest)?..)?;
        }
    }
    Some(body.len() - rest.len())
}

fn scalar(kind: &str) -> Option<ScalarType> {
    Some(match kind {
        "char" | "int8" => ScalarType::I8,
        "uchar" | "uint8" => ScalarType::U8,
        "short" | "int16" => ScalarType::I16,
        "ushort" | "uint16" => ScalarType::U16,
        "int" | "int32" => ScalarType::I32,
        "uint" | "uint32" => ScalarType::U32,
        "float" | "float32" => ScalarType::F32,
        "double" | "float64" => ScalarType::F64,
        _ => return None,
    })
}
