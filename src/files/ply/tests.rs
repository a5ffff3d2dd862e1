//! Tests of vertices in all encodings, and of the bytes around them.

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
