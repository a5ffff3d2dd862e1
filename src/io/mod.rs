//! Files: scans in memory and back, and the frames of an input.
//!
//! [`parse`] takes any file, and [`write`](fn@write) gives the same bytes back. A file of an unknown kind,
//! or one that could not be given back exactly, is kept as it is.

mod field;
mod kitti_bin;
mod lzf;
mod number;
mod pcd;
mod pcd_ascii;
mod pcd_compressed;
mod ply;
mod point_count;
mod records;
pub mod sequence;

pub use point_count::with_point_count;

use crate::error::Result;
use crate::scan::{ScanFile, Wrapping};

/// Takes a file apart into points and the bytes around them, by the extension of its name.
/// Never fails: what it does not understand is [opaque](ScanFile::opaque).
/// `write(parse(name, bytes))` is `bytes`, whatever they are.
pub fn parse(name: &str, bytes: Vec<u8>) -> ScanFile {
    let lower = name.to_ascii_lowercase();
    let parsed = if lower.ends_with(".pcd.bin") {
        kitti_bin::parse_nuscenes(&bytes)
    } else if lower.ends_with(".bin") {
        kitti_bin::parse_kitti(&bytes)
    } else if lower.ends_with(".pcd") {
        pcd::parse(&bytes)
    } else if lower.ends_with(".ply") {
        ply::parse(&bytes)
    } else {
        None
    };
    match parsed.filter(|file| is_plain(file) || comes_back_as(file, &bytes)) {
        Some(file) => ScanFile { name: name.to_owned(), ..file },
        None => ScanFile::opaque(name, bytes),
    }
}

/// Plain records come back by construction: all that is done is to move bytes.
fn is_plain(file: &ScanFile) -> bool {
    file.layout.wrapping == Wrapping::Plain
}

/// Compression and text are written anew, so the promise is checked on the file itself.
fn comes_back_as(file: &ScanFile, bytes: &[u8]) -> bool {
    file.to_bytes().is_ok_and(|written| written == bytes)
}

/// Appends the bytes of a file.
///
/// # Errors
/// [`Error::Corrupt`](crate::error::Error::Corrupt) if the points do not match the layout, as a damaged
/// stream can have it. `out` may have grown then.
pub fn write(file: &ScanFile, out: &mut Vec<u8>) -> Result<()> {
    records::check(file)?;
    out.extend_from_slice(&file.prefix);
    match &file.layout.wrapping {
        Wrapping::Plain => records::join(file, out),
        Wrapping::PcdCompressed { fields, lzf } => {
            let mut body = Vec::new();
            records::join(file, &mut body);
            pcd_compressed::write(&body, fields, *lzf, out)?;
        }
        Wrapping::PcdAscii(format) => {
            let mut body = Vec::new();
            records::join(file, &mut body);
            pcd_ascii::write(&body, format, out)?;
        }
    }
    out.extend_from_slice(&file.suffix);
    Ok(())
}

impl ScanFile {
    /// The bytes of the file.
    ///
    /// # Errors
    /// As [`write`](fn@write).
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        write(self, &mut out)?;
        Ok(out)
    }
}

#[cfg(test)]
mod tests;
