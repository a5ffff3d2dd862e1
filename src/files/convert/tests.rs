//! Tests of the contents of converted files.

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
        [floats(&[x, 0.1, -0.0]), vec![200], ring.to_le_bytes().to_vec(), t.to_le_bytes().to_vec()].concat()
    };
    let file = [header, record(1e-7, 3, 0.1), record(f32::NAN, 65535, 1.3e9 + 0.25)].concat();
    let csv = convert(&parse("a.pcd", file), FileFormat::Csv).unwrap();
    assert_eq!(csv.name, "a.csv");
    let text = csv.to_bytes().unwrap();
    let expected = "x,y,z,intensity,ring,t_s\n1e-07,0.1,-0,200,3,0.1\nnan,0.1,-0,200,65535,1300000000.25\n";
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
    for (name, new) in [("1.bin", "1.ply"), ("1.PCD.bin", "1.ply"), ("a.b.PLY", "a.b.ply"), ("é", "é.ply")]
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
