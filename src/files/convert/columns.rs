//! The values of a record by name, wherever they come from.

use std::collections::HashSet;

use byteorder::{ByteOrder, LittleEndian};

use crate::files::field::{self, Field};
use crate::files::{HeaderlessLayout, Kind, pcd, ply};
use crate::scan::{Layout, Scalar, ScanFile, Wrapping};

/// What the intensity is called in converted files.
pub const INTENSITY: &str = "intensity";
/// The coordinates.
const POSITION: [&str; 3] = ["x", "y", "z"];

/// One value of a converted record.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// Its type.
    pub scalar: Scalar,
    origin: Origin,
}

/// Where a value comes from.
#[derive(Clone, Copy, Debug)]
enum Origin {
    /// The bytes from here on in the original record, as they are.
    At(usize),
    /// The number of this type from there on, as the nearest float32.
    Number(usize, Scalar),
    /// Nowhere: it is 0.
    Nowhere,
}

impl Column {
    /// Appends the value that it has in a record of the original file.
    pub fn write(&self, record: &[u8], out: &mut Vec<u8>) {
        match self.origin {
            Origin::At(at) => out.extend_from_slice(&record[at..at + self.scalar.size() as usize]),
            Origin::Number(at, scalar) => {
                let number = number(scalar, &record[at..at + scalar.size() as usize]) as f32;
                out.extend_from_slice(&number.to_le_bytes());
            }
            Origin::Nowhere => out.extend(std::iter::repeat_n(0, self.scalar.size() as usize)),
        }
    }
}

/// The columns of a scan: x, y, z, the intensity if there is one, then the others in the order of the
/// file, each name once. `None` if there is no x, y and z.
pub fn of_scan(scan: &ScanFile) -> Option<Vec<Column>> {
    if scan.is_opaque() {
        return None;
    }
    let (kind, _) = Kind::of(&scan.name)?;
    let columns = match kind {
        Kind::Kitti | Kind::NuScenes => of_headerless(scan, kind),
        Kind::Pcd => of_fields(&pcd::Header::parse(&scan.prefix)?.fields, &scan.layout)?,
        Kind::Ply => of_fields(&ply::Header::parse(&scan.prefix)?.fields, &scan.layout)?,
    };
    in_order(columns)
}

/// The columns of KITTI's files, of those of a scan; `None` if coordinates are not float32.
pub fn of_kitti(mut columns: Vec<Column>) -> Option<Vec<Column>> {
    let intensity = columns.iter().find(|column| column.name == INTENSITY).map(|column| column.as_float32());
    columns.truncate(POSITION.len());
    if columns.iter().any(|column| column.scalar != Scalar::F32) {
        return None;
    }
    let missing = Column { name: INTENSITY.to_owned(), scalar: Scalar::F32, origin: Origin::Nowhere };
    columns.push(intensity.unwrap_or(missing));
    Some(columns)
}

impl Column {
    fn as_float32(&self) -> Column {
        let origin = match self.origin {
            Origin::At(at) if self.scalar != Scalar::F32 => Origin::Number(at, self.scalar),
            other => other,
        };
        Column { scalar: Scalar::F32, origin, name: self.name.clone() }
    }
}

/// Files without a header: what their layout knows, and nuScenes' ring.
fn of_headerless(scan: &ScanFile, kind: Kind) -> Vec<Column> {
    let float32 = |name: &str, at: u32| Column {
        name: name.to_owned(),
        scalar: Scalar::F32,
        origin: Origin::At(at as usize),
    };
    let position = scan.layout.position.into_iter().flat_map(|offsets| POSITION.into_iter().zip(offsets));
    let mut columns: Vec<Column> = position.map(|(name, at)| float32(name, at)).collect();
    columns.extend(scan.layout.intensity.map(|at| float32(INTENSITY, at)));
    let nuscenes = HeaderlessLayout::nuscenes();
    if kind == Kind::NuScenes && nuscenes.layout().as_ref() == Some(&scan.layout) {
        columns.extend(nuscenes.offset('r').map(|at| float32("ring", at)));
    }
    columns
}

/// The fields that a header declares; one of several values is as many columns. `None` if they do not
/// fill a record, as in a damaged stream.
fn of_fields(fields: &[Field], layout: &Layout) -> Option<Vec<Column>> {
    // What text is kept as need not be what its header says.
    let text = match &layout.wrapping {
        Wrapping::Text(format) => Some(&format.columns[..]),
        _ => None,
    };
    let fits = match text {
        Some(columns) => {
            let values: u64 = fields.iter().map(|field| u64::from(field.count())).sum();
            values == columns.len() as u64 && fields.iter().all(|field| field.scalar.is_some())
        }
        None => fields.iter().map(|field| u64::from(field.width)).sum::<u64>() == u64::from(layout.stride),
    };
    if !fits {
        return None;
    }
    let mut stored = text.unwrap_or_default().iter().map(|column| column.scalar);
    let intensity = field::find_intensity(fields, |field| field.scalar.is_some());
    let mut columns = Vec::new();
    let mut at = 0;
    for (place, field) in fields.iter().enumerate() {
        let known = POSITION.into_iter().find(|name| field.name.eq_ignore_ascii_case(name));
        let name = if intensity == Some(place) { INTENSITY } else { known.unwrap_or(field.name) };
        let Some(declared) = field.scalar else {
            at += field.width as usize;
            continue;
        };
        for value in 0..field.count() {
            let scalar = stored.next().unwrap_or(declared);
            // PCL calls padding "_".
            if name != "_" {
                let name = if field.count() == 1 { name.to_owned() } else { format!("{name}_{value}") };
                columns.push(Column { name, scalar, origin: Origin::At(at) });
            }
            at += scalar.size() as usize;
        }
    }
    Some(columns)
}

/// Coordinates first, intensity next, and each name once. `None` if a coordinate is missing.
fn in_order(columns: Vec<Column>) -> Option<Vec<Column>> {
    let find = |name: &str| columns.iter().find(|column| column.name == name).cloned();
    let mut ordered = POSITION.into_iter().map(find).collect::<Option<Vec<Column>>>()?;
    ordered.extend(find(INTENSITY));
    let mut names: HashSet<String> = ordered.iter().map(|column| column.name.clone()).collect();
    ordered.extend(columns.into_iter().filter(|column| names.insert(column.name.clone())));
    Some(ordered)
}

/// The number that these little-endian bytes are.
fn number(scalar: Scalar, bytes: &[u8]) -> f64 {
    match scalar {
        Scalar::F32 => LittleEndian::read_f32(bytes).into(),
        Scalar::F64 => LittleEndian::read_f64(bytes),
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => {
            LittleEndian::read_uint(bytes, bytes.len()) as f64
        }
        Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => {
            LittleEndian::read_int(bytes, bytes.len()) as f64
        }
    }
}
