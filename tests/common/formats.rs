//! Points as files.

/// KITTI `.bin`: x, y, z, intensity.
pub fn kitti(points: &[[f32; 4]]) -> Vec<u8> {
    points.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// NCLT `.bin`: coordinates in steps of 5 mm, of points up to 100 m away; intensity and laser.
pub fn nclt(points: &[[f32; 4]]) -> Vec<u8> {
    let record = |(n, [x, y, z, intensity]): (usize, &[f32; 4])| {
        let steps = [x, y, z].map(|v| ((v + 100.0) * 200.0).round() as u16);
        [steps.map(u16::to_le_bytes).as_flattened(), &[(intensity * 255.0) as u8, (n % 16) as u8]].concat()
    };
    points.iter().enumerate().flat_map(record).collect()
}

/// nuScenes `.pcd.bin`: x, y, z, intensity, ring.
pub fn nuscenes(points: &[[f32; 4]]) -> Vec<u8> {
    let record =
        |(n, p): (usize, &[f32; 4])| [kitti(&[*p]), ((n % 32) as f32).to_le_bytes().to_vec()].concat();
    points.iter().enumerate().flat_map(record).collect()
}

/// PCD with x, y and z only.
pub fn pcd_xyz(points: &[[f32; 4]]) -> Vec<u8> {
    pcd("x y z", "4 4 4", "F F F", points, |_, [x, y, z, _]| [x, y, z].map(f32::to_le_bytes).concat())
}

/// PCD with fields before, between and after the coordinates.
pub fn pcd_extra(points: &[[f32; 4]]) -> Vec<u8> {
    let fields = ("ring x y time z intensity flags", "2 4 4 8 4 4 1", "U F F F F F U");
    pcd(fields.0, fields.1, fields.2, points, |n, [x, y, z, i]| {
        let mut record = ((n / 500) as u16).to_le_bytes().to_vec();
        record.extend([x, y].map(f32::to_le_bytes).concat());
        record.extend((1.3e9 + n as f64 * 1e-5).to_le_bytes());
        record.extend([z, i].map(f32::to_le_bytes).concat());
        record.push((n % 7 == 0).into());
        record
    })
}

/// PCD with the structure of a ROS driver, and the header that PCL writes for it: padding with and without
/// COUNT.
pub fn pcd_ros(points: &[[f32; 4]]) -> Vec<u8> {
    let (count, fields) = (points.len(), "x y z _ intensity _ time ring return_type _");
    let mut bytes = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE 4 4 4 1 4 1 8 2 1 1\n\
         TYPE F F F U F U F U U U\nCOUNT 1 1 1 4 1 0 1 1 1 5\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\nDATA binary\n"
    )
    .into_bytes();
    for (n, [x, y, z, i]) in points.iter().enumerate() {
        let mut record = [0xc5; 40];
        for (at, value) in [(0, x), (4, y), (8, z), (16, i)] {
            record[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        record[24..32].copy_from_slice(&(1.6e9 + (n / 16) as f64 * 5.5e-5).to_le_bytes());
        record[32..34].copy_from_slice(&((n % 16) as u16).to_le_bytes());
        record[34] = u8::from(n % 11 == 0);
        bytes.extend(record);
    }
    bytes
}

/// PCD with a row and a time stamp for each point.
pub fn pcd_stamped(points: &[[f32; 4]], rows: &[u16], times: &[f64]) -> Vec<u8> {
    pcd("x y z intensity ring timestamp", "4 4 4 4 2 8", "F F F F U F", points, |n, point| {
        [&point.map(f32::to_le_bytes).concat()[..], &rows[n].to_le_bytes(), &times[n].to_le_bytes()].concat()
    })
}

/// PCD with any fields of one value each.
pub fn pcd(
    fields: &str,
    sizes: &str,
    types: &str,
    points: &[[f32; 4]],
    record: impl Fn(usize, [f32; 4]) -> Vec<u8>,
) -> Vec<u8> {
    let (count, ones) = (points.len(), vec!["1"; fields.split(' ').count()].join(" "));
    let mut bytes = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n\
         COUNT {ones}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    .into_bytes();
    bytes.extend(points.iter().enumerate().flat_map(|(n, point)| record(n, *point)));
    bytes
}

/// Columns without a header, filled up with spaces.
pub fn padded_columns(points: &[[f32; 4]]) -> Vec<u8> {
    let lines = points.iter().map(|[x, y, z, i]| format!("{x:9.3} {y:9.3} {z:8.3} {i:5.2}\n"));
    lines.collect::<String>().into_bytes()
}

/// PCD as text, with a field of a byte that is written as a character, as by old versions of PCL.
pub fn pcd_characters(points: &[[f32; 4]]) -> Vec<u8> {
    let binary = pcd("x y z tag", "4 4 4 1", "F F F U", points, |_, _| Vec::new());
    let mut bytes = String::from_utf8(binary).unwrap().replace("DATA binary", "DATA ascii").into_bytes();
    for [x, y, z, i] in points {
        bytes.extend_from_slice(format!("{x:.6} {y:.6} {z:.6} ").as_bytes());
        bytes.extend([(i * 255.0) as u8, b'\n']);
    }
    bytes
}

/// PCD as text, x, y, z and intensity.
pub fn pcd_text(points: &[[f32; 4]]) -> Vec<u8> {
    let count = points.len();
    let mut text = format!(
        "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {count}\n\
         HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n"
    );
    points.iter().for_each(|[x, y, z, i]| text += &format!("{x} {y} {z} {i}\n"));
    text.into_bytes()
}

/// Columns with their names, x, y, z, intensity and a ring.
pub fn csv(points: &[[f32; 4]]) -> Vec<u8> {
    let line = |(n, [x, y, z, i]): (usize, &[f32; 4])| format!("{x},{y},{z},{i},{}\n", n % 32);
    ["x,y,z,intensity,ring\n".to_owned()]
        .into_iter()
        .chain(points.iter().enumerate().map(line))
        .collect::<String>()
        .into_bytes()
}

/// Columns without names, with separators of two characters, and no end of the last line.
pub fn columns(points: &[[f32; 4]]) -> Vec<u8> {
    let lines: Vec<_> =
        points.iter().map(|[x, y, z, i]| format!("{x:.3}; {y:.3}; {z:.3}; {i:.2};")).collect();
    lines.join("\r\n").into_bytes()
}

/// NumPy's structured array: x, y, z, intensity and a ring.
pub fn npy(points: &[[f32; 4]]) -> Vec<u8> {
    let header = format!(
        "{{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'), ('ring', '|u1')], \
         'fortran_order': False, 'shape': ({},), }}\n",
        points.len()
    );
    let mut bytes =
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    bytes.extend(
        points.iter().enumerate().flat_map(|(n, point)| [kitti(&[*point]), vec![n as u8 % 32]].concat()),
    );
    bytes
}

/// NumPy's table of doubles, of which column_5 does not fit float32.
pub fn npy_doubles(points: &[[f32; 4]]) -> Vec<u8> {
    npy_table(points, "False", |values| values.as_flattened().to_vec())
}

/// A NumPy table in half precision: x, y, z, intensity, with the last bits cut off.
pub fn npy_halves(points: &[[f32; 4]]) -> Vec<u8> {
    let header = format!("{{'descr': '<f2', 'fortran_order': False, 'shape': ({}, 4), }}\n", points.len());
    let half = |value: &f32| {
        let bits = value.to_bits();
        let magnitude = (bits >> 13 & 0x3_ffff).saturating_sub(112 << 10);
        ((bits >> 31 << 15 | magnitude) as u16).to_le_bytes()
    };
    let body: Vec<u8> = points.as_flattened().iter().flat_map(half).collect();
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &body].concat()
}

/// The same, column by column, as pandas stores it, with coordinates that were read from text of eight
/// digits.
pub fn npy_by_column(points: &[[f32; 4]]) -> Vec<u8> {
    npy_table(points, "True", |values| {
        let digits = |value: f64| format!("{value:.7e}").parse().unwrap();
        let values: Vec<_> =
            values.iter().map(|&[x, y, z, i, t]| [digits(x), digits(y), digits(z), i, t]).collect();
        (0..5).flat_map(|column| values.iter().map(move |row| row[column])).collect()
    })
}

fn npy_table(points: &[[f32; 4]], order: &str, ordered: fn(&[[f64; 5]]) -> Vec<f64>) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': {order}, 'shape': ({}, 5), }}\n", points.len());
    let rows: Vec<_> = points
        .iter()
        .enumerate()
        .map(|(n, point)| {
            let [x, y, z, intensity] = point.map(f64::from);
            [x, y, z, intensity, 1.3e9 + n as f64 * 1e-5]
        })
        .collect();
    let body = ordered(&rows).into_iter().flat_map(f64::to_le_bytes).collect::<Vec<_>>();
    [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &body].concat()
}

/// LAS 1.2 of point format 1, steps of a millimetre, intensities as percent.
pub fn las(points: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = vec![0; 227];
    bytes[..4].copy_from_slice(b"LASF");
    bytes[24..26].copy_from_slice(&[1, 2]);
    bytes[94..96].copy_from_slice(&227u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&227u32.to_le_bytes());
    bytes[104..107].copy_from_slice(&[1, 28, 0]);
    bytes[107..111].copy_from_slice(&(points.len() as u32).to_le_bytes());
    for axis in [131, 139, 147] {
        bytes[axis..axis + 8].copy_from_slice(&0.001f64.to_le_bytes());
    }
    for (n, [x, y, z, i]) in points.iter().enumerate() {
        let steps = [x, y, z].map(|v| (f64::from(*v) * 1000.0).round() as i32);
        bytes.extend(steps.map(i32::to_le_bytes).concat());
        bytes.extend(((i * 100.0) as u16).to_le_bytes());
        bytes.extend([9, 0, 0, 0, 7, 0]);
        bytes.extend((1.3e9 + n as f64 * 1e-5).to_le_bytes());
    }
    bytes
}

/// Binary PLY, x, y, z and a colour.
pub fn ply(points: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nend_header\n",
        points.len()
    )
    .into_bytes();
    let record =
        |[x, y, z, i]: &[f32; 4]| [&[*x, *y, *z].map(f32::to_le_bytes).concat()[..], &[*i as u8]].concat();
    bytes.extend(points.iter().flat_map(record));
    bytes
}

/// Big-endian PLY: x, y, z and intensity.
pub fn ply_big_endian(points: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = ply_header("binary_big_endian", points.len());
    bytes.extend(points.as_flattened().iter().flat_map(|value| value.to_be_bytes()));
    bytes
}

/// PLY as text, x, y, z and intensity.
pub fn ply_text(points: &[[f32; 4]]) -> Vec<u8> {
    let mut bytes = ply_header("ascii", points.len());
    bytes.extend(points.iter().flat_map(|[x, y, z, i]| format!("{x} {y} {z} {i}\n").into_bytes()));
    bytes
}

fn ply_header(encoding: &str, points: usize) -> Vec<u8> {
    format!(
        "ply\nformat {encoding} 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n\
         property float z\nproperty float intensity\nend_header\n"
    )
    .into_bytes()
}

/// A PCD file of the records of Velodyne's ROS driver as PCL writes them: 32 bytes, with padding and the
/// ring.
pub fn pcd_velodyne(points: &[[f32; 4]]) -> Vec<u8> {
    let header = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z _ intensity ring _\n\
         SIZE 4 4 4 1 4 2 1\nTYPE F F F U F U U\nCOUNT 1 1 1 4 1 1 10\nWIDTH {0}\nHEIGHT 1\n\
         VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {0}\nDATA binary\n",
        points.len()
    );
    let mut bytes = header.into_bytes();
    for &[x, y, z, intensity] in points {
        [x, y, z].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([7, 0, 0, 9]);
        bytes.extend(intensity.to_le_bytes());
        // Rings are two degrees apart, the lowest 15 degrees below the horizon.
        let elevation = f64::from(z).atan2(f64::from(x).hypot(f64::from(y))).to_degrees();
        let ring = ((elevation + 15.0) / 2.0).round() as u16;
        bytes.extend(ring.to_le_bytes());
        bytes.extend([1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
    }
    bytes
}
