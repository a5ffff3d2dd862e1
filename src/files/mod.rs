//! Files: scans in memory and back, and the frames of an input.
//!
//! [`parse`] takes any file, and [`write`](fn@write) returns the same bytes. A file of an unknown kind, or
//! one that could not be restored exactly, is kept as plain bytes. [`convert()`] converts a scan to another
//! file format.

#[cfg(feature = "cli")]
mod arrival;
mod arrow;
mod by_field;
mod convert;
mod field;
mod headerless;
mod las;
mod lz4;
mod lzf;
pub mod names;
mod number;
mod numpy;
mod pcd;
mod places;
mod ply;
mod records;
#[cfg(feature = "cli")]
pub mod sequence;
mod table;
#[cfg(feature = "cli")]
mod tar;
mod text_records;
#[cfg(feature = "cli")]
pub mod times;
mod widened;

#[cfg(feature = "cli")]
pub use arrival::{ArrivedFile, ArrivingFrames, MOST_NAME_BYTES};
pub use convert::{FileFormat, convert, is_convertible};
pub use field::MOST_FIELDS;
pub(crate) use field::{INTENSITY, POSITION};
pub use headerless::{HeaderlessLayout, is_nclt};
#[cfg(feature = "recordings")]
pub(crate) use records::parse_big_endian as big_endian_file;
pub(crate) use records::{are_intensities, plain_file};

use self::table::Table;
use self::text_records::TextWriter;
use crate::ground::error::Result;
use crate::scan::{Field, Layout, ScanFile, Wrapping};

/// The kind of a file according to the extension of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// `.bin`.
    Kitti,
    /// `.pcd.bin`.
    NuScenes,
    /// `.pcd`.
    Pcd,
    /// `.ply`.
    Ply,
    /// `.csv` or `.txt`: columns of numbers, if the file is a scan.
    Columns,
    /// `.xyz`.
    Xyz,
    /// `.npy`: an array, if the file is a scan.
    Numpy,
    /// `.las`.
    Las,
    /// `.feather` or `.arrow`: a table of numbers, if the file is a scan.
    Arrow,
}

/// The extensions of scans, for messages.
#[cfg(feature = "cli")]
pub const EXTENSIONS: &str = ".bin, .pcd, .ply, .las, .csv, .txt, .xyz, .npy or .feather";

impl Kind {
    /// Every kind with its extension; an extension that ends in another one comes first.
    const ALL: [(Kind, &str); 11] = [
        (Kind::NuScenes, ".pcd.bin"),
        (Kind::Kitti, ".bin"),
        (Kind::Pcd, ".pcd"),
        (Kind::Ply, ".ply"),
        (Kind::Columns, ".csv"),
        (Kind::Columns, ".txt"),
        (Kind::Xyz, ".xyz"),
        (Kind::Numpy, ".npy"),
        (Kind::Las, ".las"),
        (Kind::Arrow, ".feather"),
        (Kind::Arrow, ".arrow"),
    ];

    /// The kind, and the name without its extension, ignoring case; `None` for other names.
    pub(crate) fn of(name: &str) -> Option<(Kind, &str)> {
        Kind::ALL.into_iter().find_map(|(kind, extension)| {
            let (stem, end) = name.split_at_checked(name.len().checked_sub(extension.len())?)?;
            end.eq_ignore_ascii_case(extension).then_some((kind, stem))
        })
    }
}

/// Whether a file with this name and these first bytes is taken for a scan: files without a header always
/// are.
pub fn starts_as_scan(name: &str, start: &[u8]) -> bool {
    match Kind::of(name) {
        None => false,
        Some((Kind::Kitti | Kind::NuScenes, _)) => true,
        Some((Kind::Pcd, _)) => pcd::Header::parse(start).is_some(),
        Some((Kind::Ply, _)) => ply::Header::parse(start).is_some(),
        Some((Kind::Columns | Kind::Xyz, _)) => {
            Table::find(start).is_some() || table::starts_with_names(start)
        }
        Some((Kind::Numpy, _)) => numpy::Header::parse(start).is_some(),
        Some((Kind::Las, _)) => las::Header::parse(start).is_some(),
        Some((Kind::Arrow, _)) => arrow::Header::parse(start).is_some(),
    }
}

/// Number of bytes at the beginning of a file that are examined to decide whether it is a scan.
#[cfg(feature = "cli")]
pub const SNIFFED_BYTES: u64 = 64 << 10;

/// Whether a file with this name is taken for a scan among the others of a folder or archive; `None` if its
/// bytes decide, see [`starts_as_scan_of_folder`].
#[cfg(any(test, feature = "cli"))]
fn is_scan_by_name(name: &str) -> Option<bool> {
    match Kind::of(name) {
        None => Some(false),
        Some((Kind::Columns | Kind::Numpy | Kind::Arrow, _)) => None,
        Some(_) => Some(true),
    }
}

/// As [`starts_as_scan`], for a file in a folder, which was not named explicitly: many files of numbers are
/// not scans.
#[cfg(any(test, feature = "cli"))]
pub fn starts_as_scan_of_folder(name: &str, start: &[u8]) -> bool {
    is_scan_by_name(name).unwrap_or_else(|| match Kind::of(name) {
        Some((Kind::Numpy, _)) => {
            numpy::Header::parse(start).is_some_and(|header| header.looks_like_points())
        }
        Some((Kind::Arrow, _)) => {
            arrow::Header::parse(start).is_some_and(|header| header.looks_like_points())
        }
        _ => match Table::find(start) {
            Some(table) => table.names_coordinates() || table.looks_like_points(start),
            None => table::starts_with_names(start),
        },
    })
}

/// Splits a file into points and the bytes around them, by the extension of its name. Never fails: a file
/// that is not understood is [opaque](ScanFile::opaque). `write(parse(name, bytes))` is `bytes`, whatever
/// they are.
pub fn parse(name: &str, bytes: Vec<u8>) -> ScanFile {
    parse_with(name, bytes, None)
}

/// As [`parse`], given the fields of records in files without a header; `None`: those of KITTI and nuScenes.
pub fn parse_with(name: &str, bytes: Vec<u8>, headerless: Option<&HeaderlessLayout>) -> ScanFile {
    let parsed = Kind::of(name).and_then(|(kind, _)| match (kind, headerless) {
        (Kind::Kitti | Kind::NuScenes, Some(layout)) => layout.parse(&bytes),
        (Kind::Kitti, None) => headerless::parse_kitti(&bytes),
        (Kind::NuScenes, None) => HeaderlessLayout::nuscenes().parse(&bytes),
        (Kind::Pcd, _) => pcd::parse(&bytes),
        (Kind::Ply, _) => ply::parse(&bytes),
        (Kind::Columns | Kind::Xyz, _) => table::parse(&bytes),
        (Kind::Numpy, _) => numpy::parse(&bytes),
        (Kind::Las, _) => las::parse(&bytes),
        (Kind::Arrow, _) => arrow::parse(&bytes),
    });
    match parsed.filter(|file| is_plain(file) || comes_back_as(file, &bytes)) {
        Some(file) => ScanFile { name: name.to_owned(), ..file },
        None => ScanFile::opaque(name, bytes),
    }
}

/// As [`parse`], for a file that is to be compared with `like`: if both have the same header, or none, the
/// record layout of `like` is used. Where PCL's padding is, for one, may be guessed otherwise from other
/// values.
pub fn parse_like(like: &ScanFile, name: &str, bytes: Vec<u8>) -> ScanFile {
    if like.is_opaque() {
        return ScanFile::opaque(name, bytes);
    }
    // Without a header, the rest of the file is records.
    let count = match Kind::of(&like.name) {
        Some((Kind::Kitti | Kind::NuScenes, _)) => u64::MAX,
        _ => like.records as u64,
    };
    let same = (is_plain(like) && bytes.starts_with(&like.prefix))
        .then(|| records::plain_file(like.layout.clone(), &bytes, like.prefix.len(), count))
        .flatten();
    match same {
        Some(file) => ScanFile { name: name.to_owned(), ..file },
        None => parse(name, bytes),
    }
}

/// The scan that the file of a decoded scan holds, whose `bytes` are given, if writing may round its values,
/// as by the digits of text. `None` if the file holds them as they are.
pub fn rounded_by_file(scan: &ScanFile, bytes: Vec<u8>) -> Option<ScanFile> {
    match scan.layout.wrapping {
        Wrapping::Plain | Wrapping::BigEndian | Wrapping::PcdCompressed { .. } => None,
        Wrapping::Text(_)
        | Wrapping::Scaled(_)
        | Wrapping::Widened(_)
        | Wrapping::ByField(_)
        | Wrapping::Arrow { .. } => Some(parse_like(scan, &scan.name, bytes)),
    }
}

/// The layout of records with these fields side by side, one record after the other. The names and types of
/// the fields determine their roles. `None` if the records are empty or too long.
pub fn plain_layout(fields: Vec<Field>) -> Option<Layout> {
    field::layout_of(fields, Wrapping::Plain)
}

/// Plain records are restored by construction, since bytes are only moved.
fn is_plain(file: &ScanFile) -> bool {
    file.layout.wrapping == Wrapping::Plain
}

/// Compression and text are produced anew, so the result is compared with the file itself.
fn comes_back_as(file: &ScanFile, bytes: &[u8]) -> bool {
    file.to_bytes().is_ok_and(|written| written == bytes)
}

/// Passes the bytes of a file to `give`, piece by piece. A piece of text is small, even if the text of all
/// records would be many times their size.
///
/// # Errors
/// [`Error::Corrupt`](crate::ground::error::Error::Corrupt) if the points do not match the layout, which a
/// damaged stream can cause; and the errors of `give`. Some pieces may have been passed on by then.
pub fn write(file: &ScanFile, mut give: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
    records::check(file)?;
    if let Wrapping::Arrow { is_wide, widenings } = &file.layout.wrapping {
        give(&arrow::write(file, *is_wide, widenings)?)?;
        return give(&file.suffix);
    }
    give(&file.prefix)?;
    match &file.layout.wrapping {
        Wrapping::Arrow { .. } => {}
        Wrapping::Plain => records::give(file, |block| give(block))?,
        Wrapping::PcdCompressed { lzf } => {
            give(&pcd::write_compressed(&records::join(file)?, &file.layout, *lzf)?)?;
        }
        Wrapping::Text(format) => {
            let mut text = TextWriter::new(format);
            records::give(file, |block| give(text.lines(block)?))?;
        }
        Wrapping::Widened(fields) => {
            records::give(file, |block| give(&widened::write(block, &file.layout, fields)?))?;
        }
        Wrapping::ByField(fields) => give(&by_field::write(&records::join(file)?, &file.layout, fields)?)?,
        Wrapping::Scaled(axes) => records::give(file, |block| {
            las::to_steps(block, &file.layout, axes);
            give(block)
        })?,
        Wrapping::BigEndian => records::give(file, |block| {
            records::swap_bytes(block, &file.layout);
            give(block)
        })?,
    }
    give(&file.suffix)
}

/// A function that receives the next bytes of a file.
pub type Give<'a> = dyn FnMut(&[u8]) -> Result<()> + 'a;

/// All pieces that `write` produces, concatenated.
///
/// # Errors
/// Those of `write`.
pub fn collected(write: impl FnOnce(&mut Give<'_>) -> Result<()>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write(&mut |piece| {
        bytes.extend_from_slice(piece);
        Ok(())
    })?;
    Ok(bytes)
}

impl ScanFile {
    /// The bytes of the file.
    ///
    /// # Errors
    /// As [`write`](fn@write).
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        collected(|give| write(self, give))
    }
}

/// The header of a file, with everything before its points, changed to `points` points. Bytes that are not a
/// header, or a header without a number of points, are returned unchanged.
pub fn with_point_count(header: &[u8], points: usize) -> Vec<u8> {
    let in_place = las::with_point_count(header, points)
        .or_else(|| numpy::with_point_count(header, points))
        .or_else(|| arrow::with_point_count(header, points));
    in_place.unwrap_or_else(|| with_count_in_lines(header, points))
}

/// As [`with_point_count`], for PCD and PLY.
fn with_count_in_lines(header: &[u8], points: usize) -> Vec<u8> {
    let is_ply = header.starts_with(b"ply");
    let mut out = Vec::with_capacity(header.len());
    let mut is_over = false;
    for line in header.split_inclusive(|&byte| byte == b'\n') {
        let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).collect();
        is_over |= matches!(words[..], [b"end_header"] | [b"DATA", _]);
        let (count, number) = match words[..] {
            _ if is_over => {
                out.extend_from_slice(line);
                continue;
            }
            [b"element", b"vertex", number] if is_ply => (points, number),
            [b"WIDTH" | b"POINTS", number] if !is_ply => (points, number),
            // One row, because the remaining points of an organised cloud are no longer a table.
            [b"HEIGHT", number] if !is_ply => (1, number),
            _ => {
                out.extend_from_slice(line);
                continue;
            }
        };
        let start = number.as_ptr() as usize - line.as_ptr() as usize;
        out.extend_from_slice(&line[..start]);
        out.extend_from_slice(count.to_string().as_bytes());
        out.extend_from_slice(&line[start + number.len()..]);
    }
    out
}

#[cfg(test)]
mod tests;
