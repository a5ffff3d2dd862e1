//! Scans as files of another format.

mod columns;
mod headers;

use self::columns::Column;
use super::Kind;
use super::field::{POSITION, layout_of};
use super::{numpy, records};
use crate::ground::error::{Error, Result};
use crate::scan::{Column as TextColumn, NumberRule, ScalarType, ScanFile, Separator, TextFormat, Wrapping};

/// A format that scans can be converted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// KITTI's: float32 x, y, z, intensity, without a header. Intensities are 0 if there are none.
    Bin,
    /// PCD 0.7, `binary`.
    Pcd,
    /// PLY 1.0, `binary_little_endian`.
    Ply,
    /// Text with a line of names, values between commas, each with the fewest digits that give it back.
    Csv,
    /// NumPy's `.npy`, an array of structures.
    Npy,
}

impl FileFormat {
    /// The name of a frame in this format, with the extension replaced.
    pub fn file_name(self, name: &str) -> String {
        let stem = Kind::of(name).map_or(name, |(_, stem)| stem);
        match self {
            FileFormat::Bin => format!("{stem}.bin"),
            FileFormat::Pcd => format!("{stem}.pcd"),
            FileFormat::Ply => format!("{stem}.ply"),
            FileFormat::Csv => format!("{stem}.csv"),
            FileFormat::Npy => format!("{stem}.npy"),
        }
    }

    /// The columns of a scan in a file of this format. The error says why it cannot hold their coordinates.
    fn columns(self, mut columns: Vec<Column>) -> std::result::Result<Vec<Column>, &'static str> {
        match self {
            FileFormat::Bin => columns::of_kitti(columns)
                .ok_or("has coordinates that are not float32; convert it to pcd or ply"),
            FileFormat::Pcd | FileFormat::Csv | FileFormat::Npy => Ok(columns),
            FileFormat::Ply => {
                let has_type = |column: &Column| !matches!(column.scalar, ScalarType::I64 | ScalarType::U64);
                if !columns.iter().take(POSITION.len()).all(has_type) {
                    return Err(
                        "has coordinates that are integers of 64 bits, which PLY does not know; convert it to pcd or csv",
                    );
                }
                columns.retain(has_type);
                Ok(columns)
            }
        }
    }

    fn header(self, columns: &[Column], points: usize) -> Vec<u8> {
        match self {
            FileFormat::Bin => Vec::new(),
            FileFormat::Pcd => headers::pcd(columns, points).into_bytes(),
            FileFormat::Ply => headers::ply(columns, points).into_bytes(),
            FileFormat::Csv => headers::csv(columns).into_bytes(),
            FileFormat::Npy => {
                let fields: Vec<_> = columns.iter().map(|column| (&column.name[..], column.scalar)).collect();
                numpy::header(&fields, points)
            }
        }
    }

    fn wrapping(self, columns: &[Column]) -> Wrapping {
        match self {
            FileFormat::Csv => {
                let shortest =
                    |scalar| NumberRule::Shortest { double: scalar == ScalarType::F64, point_zero: false };
                let column = |scalar: ScalarType| TextColumn {
                    scalar,
                    rule: if scalar.is_float() { shortest(scalar) } else { NumberRule::Integer },
                };
                let columns = columns.iter().map(|c| column(c.scalar)).collect();
                Wrapping::Text(TextFormat { separator: Separator::Comma, columns, ..TextFormat::default() })
            }
            _ => Wrapping::Plain,
        }
    }
}

/// Whether a scan holds points that can be converted to some format.
pub fn is_convertible(scan: &ScanFile) -> bool {
    columns::of_scan(scan).is_some()
}

/// The scan as a file of another format: `to_bytes` of the result gives its bytes. Points keep their order
/// and every bit of their coordinates, except for the payloads of NaN in text. x, y and z come first, then
/// the intensity, then the other named fields with their types; each value of a field with several values
/// becomes a field. Padding and the bytes around the records are left out. Numbers from text become float32
/// if that preserves all their digits.
///
/// # Errors
/// [`Error::Input`], with the scan's name, if it holds no points, or if they are not float32, for
/// [`FileFormat::Bin`].
pub fn convert(scan: &ScanFile, format: FileFormat) -> Result<ScanFile> {
    let refuse = |what: &str| Error::Input { path: scan.name.clone().into(), what: what.to_owned() };
    let columns = columns::of_scan(scan)
        .ok_or_else(|| refuse("holds no points that can be converted; decode it in its own format"))?;
    let columns = format.columns(columns).map_err(refuse)?;
    records::check(scan)?;
    let body = records::join(scan)?;
    let mut converted = Vec::new();
    for record in body.chunks_exact(scan.layout.stride().max(1)) {
        columns.iter().for_each(|column| column.write(record, &mut converted));
    }
    let fields = columns.iter().map(Column::field).collect();
    let layout = layout_of(fields, format.wrapping(&columns)).unwrap_or_default();
    layout.validate()?;
    let (layout, cloud) = records::split(layout, &converted);
    Ok(ScanFile {
        name: format.file_name(&scan.name),
        prefix: format.header(&columns, scan.records),
        records: scan.records,
        cloud,
        suffix: Vec::new(),
        layout,
    })
}

#[cfg(test)]
mod tests;
