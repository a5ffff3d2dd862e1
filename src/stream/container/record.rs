//! Records: what the stream is made of after its header. Kind, length, payload, checksum.

use std::io::{Read, Write};

use super::group::limited;
use super::wire::{read_bytes, read_exact};
use crate::ground::error::{Limits, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Kinds of records.
pub(super) const SCANNER: u8 = 1;
pub(super) const GROUP: u8 = 2;
pub(super) const INDEX: u8 = 3;
pub(super) const END: u8 = 4;

/// A record as read, its checksum computed but not yet judged: the reader knows best what to say.
pub(super) struct RawRecord {
    pub kind: u8,
    pub payload: Vec<u8>,
    /// Bytes of the whole record.
    pub length: u64,
    /// Whether the checksum matches.
    pub intact: bool,
}

/// Writes a record; returns its whole length in bytes.
pub(super) fn write_record(out: &mut impl Write, kind: u8, payload: &[u8]) -> Result<u64> {
    let head = head(kind, payload.len() as u64);
    let crc = crc32c::crc32c_append(crc32c::crc32c(&head), payload);
    out.write_all(&head)?;
    out.write_all(payload)?;
    out.write_all(&crc.to_le_bytes())?;
    Ok((head.len() + payload.len() + 4) as u64)
}

/// Reads the next record, whatever its kind.
pub(super) fn read_record(input: &mut impl Read, limits: &Limits) -> Result<RawRecord> {
    let mut kind = [0];
    read_exact(input, &mut kind, "the stream")?;
    let length = read_unsigned(input, "record length")?;
    let length = limited(length, "bytes of a record", limits.record_bytes)?;
    let payload = read_bytes(input, length, "record")?;
    let mut crc = [0; 4];
    read_exact(input, &mut crc, "record checksum")?;
    let head = head(kind[0], length);
    let computed = crc32c::crc32c_append(crc32c::crc32c(&head), &payload);
    Ok(RawRecord {
        kind: kind[0],
        length: head.len() as u64 + length + 4,
        payload,
        intact: computed == u32::from_le_bytes(crc),
    })
}

/// Kind and length as they stand before the payload.
fn head(kind: u8, length: u64) -> Vec<u8> {
    let mut head = vec![kind];
    write_unsigned(&mut head, length);
    head
}
