//! PLY in its three encodings: the scalar properties of the vertices are records; elements before and after
//! them are kept as they are.
//!
//! Source: G. Turk, "The PLY Polygon File Format" (1994), with the sized type names
//! (`float32`, `uint8`, ...) that later writers use.

mod header;

pub(super) use header::Header;

use self::header::{Encoding, skip};
use super::field::{Declared, layout_of};
use super::{big_endian, text_records, widened};
use crate::scan::{ScanFile, Wrapping};

/// The vertices as records, the header and the elements before them as `prefix`, the elements after them as
/// `suffix`. `None` if the header is damaged, if vertices have lists, or if text would not be restored
/// exactly.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    let header = Header::parse(bytes)?;
    let fields = header.fields.iter().filter_map(Declared::field).collect();
    let layout = layout_of(fields, Wrapping::Plain)?;
    let start = header.before.iter().try_fold(header.length, |start, element| {
        Some(start + skip(element, header.encoding, bytes.get(start..)?)?)
    })?;
    match header.encoding {
        Encoding::LittleEndian => widened::parse(layout, &[], bytes, start, header.vertices),
        Encoding::BigEndian => big_endian::parse(layout, bytes, start, header.vertices),
        Encoding::Ascii => text_records::parse(&header.fields, bytes, start, header.vertices),
    }
}

#[cfg(test)]
mod tests;
