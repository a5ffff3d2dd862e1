//! Records, which follow the stream header: kind, length, payload, checksum. FORMAT.md 2.2.

use std::io::{Read, Write};

use super::wire::{read_bytes, read_exact};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Kinds of records.
pub(super) const SCANNER: u8 = 1;
pub(super) const GROUP: u8 = 2;
pub(super) const INDEX: u8 = 3;
pub(super) const END: u8 = 4;

/// A record as read. A wrong checksum is left to the caller, which can report it best.
pub(super) struct RawRecord {
    pub kind: u8,
    pub payload: Vec<u8>,
    /// Bytes of the whole record.
    pub length: u64,
    /// The checksum stored in the record.
    pub crc: u32,
    /// Whether that is correct for the record's bytes.
    pub intact: bool,
}

/// A record that was written.
pub(super) struct WrittenRecord {
    /// Bytes of the whole record.
    pub length: u64,
    pub crc: u32,
}

/// Writes a record.
pub(super) fn write_record(out: &mut impl Write, kind: u8, payload: &[u8]) -> Result<WrittenRecord> {
    let head = head(kind, payload.len() as u64);
    let crc = checksum(kind, payload);
    out.write_all(&head)?;
    out.write_all(payload)?;
    out.write_all(&crc.to_le_bytes())?;
    Ok(WrittenRecord { length: (head.len() + payload.len() + 4) as u64, crc })
}

/// The checksum of a record.
pub(super) fn checksum(kind: u8, payload: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(&head(kind, payload.len() as u64)), payload)
}

/// Reads the next record, whatever its kind.
pub(super) fn read_record(input: &mut impl Read, limits: &Limits) -> Result<RawRecord> {
    let mut kind = [0];
    read_exact(input, &mut kind, "the stream")?;
    let length = read_unsigned(input, "record length")?;
    let length = Error::check_limit("bytes of a record", length, limits.record_bytes)?;
    let payload = read_bytes(input, length, "record")?;
    let mut crc = [0; 4];
    read_exact(input, &mut crc, "record checksum")?;
    let (kind, crc) = (kind[0], u32::from_le_bytes(crc));
    let intact = checksum(kind, &payload) == crc;
    Ok(RawRecord { kind, length: head(kind, length).len() as u64 + length + 4, payload, crc, intact })
}

/// Kind and length, which precede the payload.
fn head(kind: u8, length: u64) -> Vec<u8> {
    let mut head = vec![kind];
    write_unsigned(&mut head, length);
    head
}
