//! PLY in its three encodings: the scalar properties of the vertices are records; elements before and after
//! them are kept as they are.
//!
//! Source: G. Turk, "The PLY Polygon File Format" (1994), with the sized type names
//! (`float32`, `uint8`, ...) that later writers use.

use byteorder::{BigEndian, ByteOrder, LittleEndian};

use super::field::{Declared, layout_of, next_line};
use super::{records, text_records, widened};
use crate::scan::{ScalarType, ScanFile, Wrapping};

/// The vertices as records, the header and the elements before them as `prefix`, the elements after them as
/// `suffix`. `None` if the header is damaged, if vertices have lists, or if text would not be restored
/// exactly.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let fields = header.fields.iter().filter_map(Declared::field).collect();
    let layout = layout_of(fields, Wrapping::Plain)?;
    let start = header.before.iter().try_fold(header.length, |start, element| {
        Some(start + skip(element, header.encoding, bytes.get(start..)?)?)
    })?;
    match header.encoding {
        Encoding::LittleEndian => widened::parse(layout, &[], bytes, start, header.vertices),
        Encoding::BigEndian => records::parse_big_endian(layout, bytes, start, header.vertices),
        Encoding::Ascii => text_records::parse(&header.fields, bytes, start, header.vertices),
    }
}

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
fn skip(element: &Element, encoding: Encoding, body: &[u8]) -> Option<usize> {
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

#[cfg(test)]
mod tests {
    use crate::files::tests::{comes_back, floats};
    use crate::scan::{NumberRule, Wrapping};

    const HEADER: &str = "ply\nformat binary_little_endian 1.0\ncomment by hand\nelement vertex 2\n\
    property float x\nproperty float32 y\nproperty float z\nproperty uchar ring\n\
    property float scalar_Intensity\nelement face 1\nproperty list uchar int vertex_indices\n\
    end_header\n";

    fn file(header: &str, body: &[u8]) -> Vec<u8> {
        [header.as_bytes(), body].concat()
    }

    #[test]
    fn vertices_are_records_and_faces_stay() {
        let mut body = [floats(&[1.0, 2.0, 3.0]), vec![7], floats(&[0.5])].concat();
        body.extend([floats(&[4.0, 5.0, 6.0]), vec![8], floats(&[0.25])].concat());
        body.extend([3, 0, 0, 0, 0]);
        let scan = comes_back("a.ply", file(HEADER, &body));
        assert_eq!(scan.records, 2);
        assert_eq!(scan.prefix, HEADER.as_bytes());
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(scan.cloud.intensity, [0.5, 0.25]);
        assert_eq!(scan.cloud.channels[0].bytes, [7, 8]);
        assert_eq!(scan.suffix, [3, 0, 0, 0, 0]);
    }

    #[test]
    fn a_cut_file_keeps_its_whole_records() {
        let scan = comes_back("a.ply", file(HEADER, &[1; 20]));
        assert_eq!((scan.records, scan.suffix.len()), (1, 3));
    }

    #[test]
    fn windows_line_ends_are_part_of_the_header() {
        let scan = comes_back("a.PLY", file(&HEADER.replace('\n', "\r\n"), &[1; 34]));
        assert_eq!(scan.records, 2);
    }

    #[test]
    fn absurd_counts_take_what_is_there() {
        let header = HEADER.replace("vertex 2", "vertex 18446744073709551615");
        assert_eq!(comes_back("a.ply", file(&header, &[1; 40])).records, 2);
    }

    #[test]
    fn other_kinds_are_opaque() {
        for (from, to) in [
            ("binary_little_endian", "binary_middle_endian"),
            ("format binary_little_endian 1.0\n", ""),
            ("vertex 2", "vertex -2"),
            ("element vertex 2", "element point 2"),
            ("property float x", "property list uchar float x"),
            ("end_header\n", "end_header"),
            ("ply\n", "plx\n"),
        ] {
            let scan = comes_back("a.ply", file(&HEADER.replacen(from, to, 1), &[1; 40]));
            assert!(scan.is_opaque(), "{to}");
        }
    }

    /// Big-endian bytes of float32 values.
    fn big(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_be_bytes()).collect()
    }

    #[test]
    fn big_endian_values_are_turned_around() {
        let header = HEADER.replace("little", "big");
        let mut body = [big(&[1.0, 2.0, 3.0]), vec![7], big(&[0.5])].concat();
        body.extend([big(&[4.0, 5.0, f32::from_bits(0x7fa0_0001)]), vec![8], big(&[0.25])].concat());
        body.extend([3, 0, 0, 0, 0]);
        let scan = comes_back("a.ply", file(&header, &body));
        assert_eq!(scan.cloud.positions[0], [1.0, 2.0, 3.0]);
        assert_eq!(scan.cloud.positions[1][2].to_bits(), 0x7fa0_0001);
        assert_eq!(
            (&scan.cloud.intensity[..], &scan.cloud.channels[0].bytes[..]),
            (&[0.5, 0.25][..], &[7, 8][..])
        );
        assert_eq!(scan.suffix, [3, 0, 0, 0, 0]);
        let scan = comes_back("a.ply", file(&header, &body[..20]));
        assert_eq!((scan.records, scan.suffix.len()), (1, 3));
    }

    #[test]
    fn text_is_values() {
        let header = HEADER.replace("binary_little_endian", "ascii");
        // With MeshLab's line ends.
        let body = "1 -0.25 3.5 7 0.5 \n4 5 6.125 8 0.25 \n3 0 1 1 \n";
        let scan = comes_back("a.ply", file(&header, body.as_bytes()));
        assert_eq!(scan.cloud.positions, [[1.0, -0.25, 3.5], [4.0, 5.0, 6.125]]);
        assert_eq!(
            (&scan.cloud.intensity[..], &scan.cloud.channels[0].bytes[..]),
            (&[0.5, 0.25][..], &[7, 8][..])
        );
        assert_eq!(scan.suffix, b"3 0 1 1 \n");
        let Wrapping::Text(format) = &scan.layout.wrapping else { panic!("{:?}", scan.layout) };
        assert_eq!(format.columns[3].rule, NumberRule::Integer);
        let body = "1.50 2.00 3.25 7 0.5\r\n4.00 5.00 6.00 8 0.25\r\n";
        assert_eq!(comes_back("a.ply", file(&header.replace('\n', "\r\n"), body.as_bytes())).records, 2);
        let odd = "1.5 2 3 7 0.5\n1.50 2 3 7 0.5\n";
        assert!(comes_back("a.ply", file(&header, odd.as_bytes())).is_opaque(), "no rule writes both");
    }

    /// A header with elements before the vertices.
    fn late_vertices(encoding: &str) -> String {
        format!(
            "ply\nformat {encoding} 1.0\nelement camera 1\nproperty float view\nproperty uchar kind\n\
         element range 2\nproperty list ushort short at\nproperty char flag\nelement nothing 0\n\
         element vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        )
    }

    #[test]
    fn elements_before_the_vertices_are_part_of_the_prefix() {
        let little: &[&[u8]] =
            &[&floats(&[9.0]), &[1], &[2, 0, 1, 1, 2, 2, 5], &[0, 0, 6], &floats(&[1.0, 2.0, 3.0]), b"end"];
        let big_endian: &[&[u8]] =
            &[&big(&[9.0]), &[1], &[0, 2, 1, 1, 2, 2, 5], &[0, 0, 6], &big(&[1.0, 2.0, 3.0]), b"end"];
        let text: &[&[u8]] = &[b"9 1\n", b"2 257 514 5\n", b"0 6\n", b"1 2 3\n", b"end"];
        for (encoding, body) in
            [("binary_little_endian", little), ("binary_big_endian", big_endian), ("ascii", text)]
        {
            let header = late_vertices(encoding);
            let scan = comes_back("a.ply", file(&header, &body.concat()));
            assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0]], "{encoding}");
            assert_eq!(scan.suffix, b"end");
            let vertices = body[body.len() - 2].len() + 3;
            assert_eq!(scan.prefix.len(), header.len() + body.concat().len() - vertices);
        }
    }

    #[test]
    fn elements_that_do_not_end_are_opaque() {
        let header = late_vertices("binary_little_endian");
        for (from, to) in [
            ("camera 1", "camera 18446744073709551615"),
            ("nothing 0", "nothing 1"),
            ("property float view\nproperty uchar kind\n", ""),
            ("list ushort", "list float"),
            ("list ushort short", "list ushort text"),
            ("element range 2", "element range -2"),
        ] {
            let header = header.replacen(from, to, 1);
            assert!(comes_back("a.ply", file(&header, &[0; 64])).is_opaque(), "{to}");
        }
        // A list longer than the file.
        let body = [&[0; 5][..], &[255, 255], &[0; 60]].concat();
        assert!(comes_back("a.ply", file(&header, &body)).is_opaque());
    }
}
