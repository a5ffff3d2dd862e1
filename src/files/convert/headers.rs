//! The headers of converted files, as the programs that read them expect them.
//!
//! Sources: "The PCD (Point Cloud Data) file format" (PCL documentation); G. Turk, "The PLY Polygon File
//! Format" (1994).

use super::columns::Column;
use crate::scan::Scalar;

/// A PCD header of version 0.7: one row of points.
pub fn pcd(columns: &[Column], points: usize) -> String {
    let line = |keyword: &str, word: &dyn Fn(&Column) -> String| {
        let words: Vec<String> = columns.iter().map(word).collect();
        format!("{keyword} {}\n", words.join(" "))
    };
    let kind = |column: &Column| {
        match column.scalar {
            Scalar::F32 | Scalar::F64 => "F",
            Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => "I",
            Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => "U",
        }
        .to_owned()
    };
    [
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n".to_owned(),
        line("FIELDS", &|column| column.name.clone()),
        line("SIZE", &|column| column.scalar.size().to_string()),
        line("TYPE", &kind),
        line("COUNT", &|_| "1".to_owned()),
        format!("WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA binary\n"),
    ]
    .concat()
}

/// A PLY header with nothing but vertices. The types of the columns must be types of PLY.
pub fn ply(columns: &[Column], points: usize) -> String {
    let property = |column: &Column| format!("property {} {}\n", ply_type(column.scalar), column.name);
    let properties: String = columns.iter().map(property).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {points}\n{properties}end_header\n")
}

/// The names of the columns between commas.
pub fn csv(columns: &[Column]) -> String {
    let names: Vec<_> = columns.iter().map(|column| column.name.replace([',', ';', '"'], "_")).collect();
    names.join(",") + "\n"
}

/// The original type names of 1994, which all readers support.
fn ply_type(scalar: Scalar) -> &'static str {
    match scalar {
        Scalar::I8 => "char",
        Scalar::U8 => "uchar",
        Scalar::I16 => "short",
        Scalar::U16 => "ushort",
        Scalar::I32 | Scalar::I64 => "int",
        Scalar::U32 | Scalar::U64 => "uint",
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    }
}
