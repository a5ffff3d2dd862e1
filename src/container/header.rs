//! The stream header: the first bytes of every stream. FORMAT.md 2.1.

use std::io::{Read, Write};

use byteorder::{ByteOrder, LittleEndian};

use super::record::read_exact;
use crate::ground::error::{Error, Result};

/// The first four bytes of every stream. The first is not ASCII, so that streams are not taken for text.
pub const MAGIC: [u8; 4] = *b"\x89LPC";

/// The version of the format that this program reads and writes; it reads no other.
pub const VERSION: u16 = 1;

/// Bytes of the stream header. Its layout stays the same in all later versions.
pub const HEADER_LENGTH: usize = FIELDS_LENGTH + 4;

/// Bytes of the stream header before its checksum.
pub(super) const FIELDS_LENGTH: usize = 8;

/// Flag bits that this version knows: none so far.
const KNOWN_FLAGS: u16 = 0;

/// The contents of the stream header: what a reader must know before the first record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamHeader {
    /// Version of the format.
    pub version: u16,
    /// Features that a reader must support in order to read the stream, one bit each.
    pub flags: u16,
}

impl Default for StreamHeader {
    fn default() -> Self {
        StreamHeader { version: VERSION, flags: 0 }
    }
}

impl StreamHeader {
    /// Writes the header with its checksum.
    ///
    /// # Errors
    /// If `out` fails.
    pub fn write_to(&self, out: &mut impl Write) -> Result<()> {
        let fields = self.to_bytes();
        out.write_all(&fields)?;
        out.write_all(&crc32c::crc32c(&fields).to_le_bytes())?;
        Ok(())
    }

    /// The header without its checksum, as repeated in the end record.
    pub(super) fn to_bytes(self) -> [u8; FIELDS_LENGTH] {
        let mut bytes = [0; FIELDS_LENGTH];
        bytes[..4].copy_from_slice(&MAGIC);
        LittleEndian::write_u16(&mut bytes[4..6], self.version);
        LittleEndian::write_u16(&mut bytes[6..8], self.flags);
        bytes
    }

    /// The header in these bytes; `None` if the magic number is wrong.
    pub(super) fn from_bytes(bytes: &[u8; FIELDS_LENGTH]) -> Option<Self> {
        let (version, flags) = (LittleEndian::read_u16(&bytes[4..6]), LittleEndian::read_u16(&bytes[6..8]));
        bytes.starts_with(&MAGIC).then_some(StreamHeader { version, flags })
    }

    /// Reads a header and checks that this program can read the stream.
    ///
    /// # Errors
    /// If the input is not a lidarpc stream, is damaged, or has another version of the format.
    pub fn read_from(input: &mut impl Read) -> Result<Self> {
        let (mut fields, mut crc) = ([0; FIELDS_LENGTH], [0; 4]);
        read_exact(input, &mut fields[..4], "stream header")?;
        if fields[..4] != MAGIC {
            return Err(Error::BadMagic([fields[0], fields[1], fields[2], fields[3]]));
        }
        read_exact(input, &mut fields[4..], "stream header")?;
        read_exact(input, &mut crc, "stream header")?;
        let header = Self::from_bytes(&fields).filter(|_| crc32c::crc32c(&fields).to_le_bytes() == crc);
        let header = header.ok_or_else(|| Error::corrupt("stream header: checksum does not match"))?;
        header.check()?;
        Ok(header)
    }

    /// An error if this program cannot read a stream with this header.
    pub(super) fn check(&self) -> Result<()> {
        if self.version != VERSION {
            return Err(Error::UnsupportedVersion { found: self.version, known: VERSION });
        }
        let unknown = self.flags & !KNOWN_FLAGS;
        if unknown != 0 {
            return Err(Error::unsupported(format!("stream header: unknown flags {unknown:#06x}")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes_of(header: StreamHeader) -> Vec<u8> {
        let mut bytes = Vec::new();
        header.write_to(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn the_checksum_is_the_one_that_format_md_names() {
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
    }

    #[test]
    fn comes_back() {
        let bytes = bytes_of(StreamHeader::default());
        assert_eq!(bytes.len(), HEADER_LENGTH);
        assert_eq!(StreamHeader::read_from(&mut &bytes[..]).unwrap(), StreamHeader::default());
    }

    #[test]
    fn streams_of_other_versions_are_named_as_such() {
        for version in [0, 2, 5, u16::MAX] {
            let other = bytes_of(StreamHeader { version, flags: 0 });
            let error = StreamHeader::read_from(&mut &other[..]).unwrap_err().to_string();
            assert_eq!(error, format!("format version {version} is not one that this program reads (1)"));
        }
        let flagged = bytes_of(StreamHeader { version: 1, flags: 0x8000 });
        let error = StreamHeader::read_from(&mut &flagged[..]).unwrap_err();
        assert!(error.to_string().contains("unknown flags 0x8000"), "{error}");
    }

    #[test]
    fn other_files_are_named_as_such() {
        let error = StreamHeader::read_from(&mut &b"PK\x03\x04 and so on"[..]).unwrap_err();
        assert!(matches!(error, Error::BadMagic(_)), "{error}");
    }
}
