//! The headers of converted files, as the programs that read them expect them.
//!
//! Sources: "The PCD (Point Cloud Data) file format" (PCL documentation); G. Turk, "The PLY Polygon File
//! Format" (1994).

use super::columns::Column;
use crate::scan::ScalarType;

/// A PCD header of version 0.7: one row of points.
pub fn pcd(columns: &[Column], points: usize) -> String {
    let line = |keyword: &str, word: &dyn Fn(&Column) -> String| {
        let words: Vec<String> = columns.iter().map(word).collect();
        format!("{keyword} {}\n", words.join(" "))
    };
    let kind = |column: &Column| {
        match column.scalar {
            ScalarType::F32 | ScalarType::F64 => "F",
            ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => "I",
            ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => "U",
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
fn ply_type(scalar: ScalarType) -> &'static str {
    match scalar {
        ScalarType::I8 => "char",
        ScalarType::U8 => "uchar",
        ScalarType::I16 => "short",
        ScalarType::U16 => "ushort",
        ScalarType::I32 | ScalarType::I64 => "int",
        ScalarType::U32 | ScalarType::U64 => "uint",
        ScalarType::F32 => "float",
        ScalarType::F64 => "double",
    }
}
