//! Scans as files of another format.

mod columns;
mod headers;

use self::columns::Column;
use super::Kind;
use super::records;
use crate::ground::error::{Error, Result};
use crate::scan::{Layout, Scalar, ScanFile, Wrapping};

/// A format that scans can be converted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// KITTI's: float32 x, y, z, intensity, without a header. Intensities are 0 if there are none.
    Bin,
    /// PCD 0.7, `binary`.
    Pcd,
    /// PLY 1.0, `binary_little_endian`.
    Ply,
}

impl FileFormat {
    /// The name of a frame in this format: the extension is another.
    pub fn file_name(self, name: &str) -> String {
        let stem = Kind::of(name).map_or(name, |(_, stem)| stem);
        match self {
            FileFormat::Bin => format!("{stem}.bin"),
            FileFormat::Pcd => format!("{stem}.pcd"),
            FileFormat::Ply => format!("{stem}.ply"),
        }
    }

    /// The columns of a scan as a file of this format has them; `None` if it cannot.
    fn columns(self, mut columns: Vec<Column>) -> Option<Vec<Column>> {
        match self {
            FileFormat::Bin => columns::of_kitti(columns),
            FileFormat::Pcd => Some(columns),
            FileFormat::Ply => {
                // There are no integers of 64 bits.
                columns.retain(|column| !matches!(column.scalar, Scalar::I64 | Scalar::U64));
                Some(columns)
            }
        }
    }

    fn header(self, columns: &[Column], points: usize) -> String {
        match self {
            FileFormat::Bin => String::new(),
            FileFormat::Pcd => headers::pcd(columns, points),
            FileFormat::Ply => headers::ply(columns, points),
        }
    }
}

/// The scan as a file of another format: `to_bytes` of what is returned is that file. Points keep their
/// order and every bit of their coordinates. x, y and z come first, then the intensity, then the other
/// fields that have a name, with their types. Bytes without a name, and those around the records, are
/// left out; of a file without a header only x, y, z, intensity and nuScenes' ring have a name. Numbers
/// of text are float32 if that gives their every digit back.
///
/// # Errors
/// [`Error::Input`], with the scan's name, if it holds no points, or, for [`FileFormat::Bin`], points
/// that are not float32.
pub fn convert(scan: &ScanFile, format: FileFormat) -> Result<ScanFile> {
    let refuse = |what: &str| Error::Input { path: scan.name.clone().into(), what: what.to_owned() };
    let columns = columns::of_scan(scan)
        .ok_or_else(|| refuse("holds no points that can be converted; decode it without --format"))?;
    let columns = format
        .columns(columns)
        .ok_or_else(|| refuse("has coordinates that are not float32; convert it to pcd or ply"))?;
    records::check(scan)?;
    let body = records::join(scan)?;
    let mut converted = Vec::new();
    for record in body.chunks_exact((scan.layout.stride as usize).max(1)) {
        columns.iter().for_each(|column| column.write(record, &mut converted));
    }
    let layout = layout_of(&columns);
    layout.validate()?;
    Ok(ScanFile {
        name: format.file_name(&scan.name),
        prefix: format.header(&columns, scan.records).into_bytes(),
        records: scan.records,
        cloud: records::split(&layout, &converted),
        suffix: Vec::new(),
        layout,
    })
}

/// The layout of records with these columns side by side.
fn layout_of(columns: &[Column]) -> Layout {
    let offset = |name: &str| {
        let at = columns.iter().position(|column| column.name == name && column.scalar == Scalar::F32)?;
        Some(columns[..at].iter().map(|column| column.scalar.size()).sum())
    };
    Layout {
        wrapping: Wrapping::Plain,
        stride: columns.iter().map(|column| column.scalar.size()).sum(),
        position: (|| Some([offset("x")?, offset("y")?, offset("z")?]))(),
        intensity: offset(columns::INTENSITY),
    }
}

#[cfg(test)]
mod tests;
