//! The values of a record by name, regardless of the original format.

use std::collections::HashSet;

use byteorder::{ByteOrder, LittleEndian};

use crate::files::field::{self, INTENSITY, POSITION};
use crate::scan::{Field, Layout, ScalarType, ScanFile};

/// One value of a converted record.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// Its type.
    pub scalar: ScalarType,
    origin: Origin,
}

/// Where a value comes from.
#[derive(Clone, Copy, Debug)]
enum Origin {
    /// The bytes at this offset of the original record, unchanged.
    At(usize),
    /// The number of this type at this offset, rounded to float32.
    Number(usize, ScalarType),
    /// No original value; the result is 0.
    Nowhere,
}

impl Column {
    /// Its field in the converted file.
    pub fn field(&self) -> Field {
        Field::new(&field::name_of(&self.name), self.scalar)
    }

    /// Appends its value in a record of the original file.
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

/// The columns of a scan: x, y, z, the intensity if there is one, then the others in the order of the file.
/// Names are unique. `None` if x, y or z is missing.
pub fn of_scan(scan: &ScanFile) -> Option<Vec<Column>> {
    if scan.is_opaque() {
        return None;
    }
    in_order(of_fields(&scan.layout))
}

/// Selects the columns of KITTI's files from those of a scan; `None` if the coordinates are not float32.
pub fn of_kitti(mut columns: Vec<Column>) -> Option<Vec<Column>> {
    let intensity = columns.iter().find(|column| column.name == INTENSITY).map(|column| column.as_float32());
    columns.truncate(POSITION.len());
    if columns.iter().any(|column| column.scalar != ScalarType::F32) {
        return None;
    }
    let missing = Column { name: INTENSITY.to_owned(), scalar: ScalarType::F32, origin: Origin::Nowhere };
    columns.push(intensity.unwrap_or(missing));
    Some(columns)
}

impl Column {
    fn as_float32(&self) -> Column {
        let origin = match self.origin {
            Origin::At(at) if self.scalar != ScalarType::F32 => Origin::Number(at, self.scalar),
            other => other,
        };
        Column { scalar: ScalarType::F32, origin, name: self.name.clone() }
    }
}

/// The named fields; one with several values becomes several columns.
fn of_fields(layout: &Layout) -> Vec<Column> {
    let is_known = |field: &Field| field.count == 1;
    let intensity = field::find_intensity(&layout.fields, is_known);
    let mut columns = Vec::new();
    let mut at = 0;
    for (place, field) in layout.fields.iter().enumerate() {
        let known = POSITION.into_iter().find(|name| field.name.eq_ignore_ascii_case(name));
        let name = if intensity == Some(place) { INTENSITY } else { known.unwrap_or(&field.name) };
        for value in 0..field.count {
            if !name.is_empty() {
                let name = if field.count == 1 { name.to_owned() } else { format!("{name}_{value}") };
                columns.push(Column { name, scalar: field.scalar, origin: Origin::At(at) });
            }
            at += field.scalar.size() as usize;
        }
    }
    columns
}

/// Puts coordinates first and the intensity next, and makes names unique. `None` if a coordinate is missing.
fn in_order(mut columns: Vec<Column>) -> Option<Vec<Column>> {
    let mut ordered = Vec::with_capacity(columns.len());
    for name in POSITION.into_iter().chain([INTENSITY]) {
        match columns.iter().position(|column| column.name == name) {
            Some(at) => ordered.push(columns.remove(at)),
            None if name == INTENSITY => {}
            None => return None,
        }
    }
    let mut names: HashSet<String> =
        columns.iter().chain(&ordered).map(|column| column.name.clone()).collect();
    let mut seen: HashSet<String> = ordered.iter().map(|column| column.name.clone()).collect();
    for mut column in columns {
        if !seen.insert(column.name.clone()) {
            let others = (2u32..).map(|number| format!("{}_{number}", column.name));
            let Some(free) = { others }.find(|name| names.insert(name.clone())) else { continue };
            column.name = free;
        }
        ordered.push(column);
    }
    Some(ordered)
}

/// The number in these little-endian bytes.
fn number(scalar: ScalarType, bytes: &[u8]) -> f64 {
    match scalar {
        ScalarType::F32 => LittleEndian::read_f32(bytes).into(),
        ScalarType::F64 => LittleEndian::read_f64(bytes),
        ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => {
            LittleEndian::read_uint(bytes, bytes.len()) as f64
        }
        ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => {
            LittleEndian::read_int(bytes, bytes.len()) as f64
        }
    }
}
