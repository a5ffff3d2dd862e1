//! Records, which follow the stream header: kind, length, payload, checksum. FORMAT.md 2.2. Also the few
//! kinds of fields that are not numbers: bytes preceded by their length, and checksums.

use std::io::{self, Read, Write};

use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Kinds of records.
pub(super) const SCANNER: u8 = 1;
pub(super) const GROUP: u8 = 2;
pub(super) const INDEX: u8 = 3;
pub(super) const END: u8 = 4;

/// Bytes of a record's checksum.
pub(super) const CHECKSUM_LENGTH: u64 = 4;

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
    Ok(WrittenRecord { length: (head.len() + payload.len()) as u64 + CHECKSUM_LENGTH, crc })
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
    Ok(RawRecord {
        kind,
        length: head(kind, length).len() as u64 + length + CHECKSUM_LENGTH,
        payload,
        crc,
        intact,
    })
}

/// Kind and length, which precede the payload.
fn head(kind: u8, length: u64) -> Vec<u8> {
    let mut head = vec![kind];
    write_unsigned(&mut head, length);
    head
}

/// Fills `bytes`; if the input ends early, it is damaged, which the error says of `what`.
pub(super) fn read_exact(input: &mut impl Read, bytes: &mut [u8], what: &str) -> Result<()> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => Error::corrupt(format!("{what} is cut short")),
        _ => error.into(),
    })
}

/// Reads `length` bytes. Memory grows with the bytes received, so that a wrong length costs little.
fn read_bytes(input: &mut impl Read, length: u64, what: &str) -> Result<Vec<u8>> {
    /// Bytes that are allocated at once. Most records fit, so that their bytes are not copied as the buffer
    /// grows.
    const AT_ONCE: u64 = 16 << 20;
    let mut bytes = Vec::with_capacity(length.min(AT_ONCE) as usize);
    let got = input.by_ref().take(length).read_to_end(&mut bytes)?;
    if got as u64 != length {
        return Err(Error::corrupt(format!("{what} is cut short")));
    }
    Ok(bytes)
}

/// Takes `length` bytes off the front of `input`.
pub(super) fn take<'a>(input: &mut &'a [u8], length: u64, what: &str) -> Result<&'a [u8]> {
    let cut = usize::try_from(length).ok().and_then(|length| input.split_at_checked(length));
    let (taken, rest) = cut.ok_or_else(|| Error::corrupt(format!("{what} is cut short")))?;
    *input = rest;
    Ok(taken)
}

/// Takes a little-endian 32-bit number off the front of `input`.
pub(super) fn take_u32(input: &mut &[u8], what: &str) -> Result<u32> {
    let mut bytes = [0; 4];
    read_exact(input, &mut bytes, what)?;
    Ok(u32::from_le_bytes(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lying_length_costs_little_memory() {
        assert!(read_bytes(&mut &[1, 2, 3][..], u64::MAX, "payload").is_err());
        assert!(take(&mut &[1, 2, 3][..], u64::MAX, "payload").is_err());
    }
}
