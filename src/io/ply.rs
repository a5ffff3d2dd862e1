//! PLY, binary little-endian, whose first element is `vertex` with scalar properties only.
//!
//! Source: G. Turk, "The PLY Polygon File Format" (1994), with the sized type names
//! (`float32`, `uint8`, ...) that later writers use.

use super::field::{Field, layout_of, next_line};
use super::records::plain_file;
use crate::scan::{Scalar, ScanFile, Wrapping};

/// What a header says.
pub(super) struct Header<'a> {
    /// The scalar properties of the vertices.
    pub fields: Vec<Field<'a>>,
    /// Number of vertices. It may be anything: the body decides.
    vertices: u64,
    /// Bytes of the header, the line end after `end_header` included.
    length: usize,
}

/// The vertices as records, the header as `prefix`, the other elements as `suffix`.
/// `None` for text, big-endian and damaged files.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let layout = layout_of(&header.fields, Wrapping::Plain)?;
    plain_file(layout, bytes, header.length, header.vertices)
}

impl<'a> Header<'a> {
    /// Reads the header that `bytes` begin with; `None` if it is damaged or of a file of another kind.
    pub(super) fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut rest = bytes;
        if next_line(&mut rest)? != "ply" {
            return None;
        }
        let mut little_endian = false;
        let mut elements = 0;
        let mut vertices = None;
        let mut fields = Vec::new();
        loop {
            let line = next_line(&mut rest)?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words[..] {
                ["comment" | "obj_info", ..] => {}
                ["format", "binary_little_endian", _] => little_endian = true,
                ["element", name, count] => {
                    elements += 1;
                    if elements == 1 && name == "vertex" {
                        vertices = Some(count.parse().ok()?);
                    }
                }
                // Only the first element's properties matter; the others stay in the suffix.
                ["property", ..] if elements > 1 => {}
                ["property", kind, name] => fields.push(field(kind, name)?),
                ["end_header"] => break,
                _ => return None,
            }
        }
        let length = bytes.len() - rest.len();
        little_endian.then_some(Header { fields, vertices: vertices?, length })
    }
}

fn field<'a>(kind: &str, name: &'a str) -> Option<Field<'a>> {
    let scalar = match kind {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    };
    Some(Field { name, scalar: Some(scalar), width: scalar.size() })
}

#[cfg(test)]
mod tests {
    use crate::io::tests::{comes_back, floats};

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
        assert_eq!(scan.cloud.extra, [7, 8]);
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
            ("binary_little_endian", "binary_big_endian"),
            ("binary_little_endian", "ascii"),
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
}
