//! Scanner records, to which groups refer for the scanners of their tracks. FORMAT.md 2.3.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt;

use super::record::{SCANNER, checksum, take};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// How groups refer to a scanner: by the checksum of its record. It is the same in every stream, and any
/// copy of the record serves. FORMAT.md 2.3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScannerId(pub u32);

impl fmt::Display for ScannerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08x}", self.0)
    }
}

impl ScannerId {
    /// Appends the reference to a track's scanner, or 0 if it has none.
    pub(super) fn write_to(scanner: Option<ScannerId>, out: &mut Vec<u8>) {
        write_unsigned(out, scanner.map_or(0, |id| u64::from(id.0) + 1));
    }

    /// Takes the reference to a track's scanner off the front of `input`; `None` if it has none.
    ///
    /// # Errors
    /// If it is cut short or above 2^32.
    pub(super) fn read_from(input: &mut &[u8]) -> Result<Option<ScannerId>> {
        let Some(id) = read_unsigned(input, "scanner of a group")?.checked_sub(1) else { return Ok(None) };
        let id = u32::try_from(id)
            .map_err(|_| Error::corrupt("a scanner of a group: its checksum is above 2^32 - 1"))?;
        Ok(Some(ScannerId(id)))
    }
}

/// A scanner as the container sees it; only its family can read the payload.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct ScannerRecord {
    /// The number of the family.
    pub family: u64,
    /// The constants of the scanner, in the family's own syntax.
    pub payload: Vec<u8>,
}

impl ScannerRecord {
    /// The reference that groups use.
    pub fn id(&self) -> ScannerId {
        ScannerId(checksum(SCANNER, &self.to_payload()))
    }

    /// The payload of its record in the stream.
    pub(super) fn to_payload(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        self.write_to(&mut payload);
        payload
    }

    /// Appends family, length and payload: the payload of the record in the stream.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.family);
        write_unsigned(out, self.payload.len() as u64);
        out.extend_from_slice(&self.payload);
    }

    /// Reads the payload of a scanner record of the stream.
    ///
    /// # Errors
    /// If its length field is wrong.
    pub fn read_from(mut input: &[u8]) -> Result<Self> {
        let input = &mut input;
        let family = read_unsigned(input, "scanner's family")?;
        let length = read_unsigned(input, "scanner's length")?;
        let payload = take(input, length, "scanner")?.to_vec();
        if !input.is_empty() {
            return Err(Error::corrupt(format!("{} bytes left over after the scanner", input.len())));
        }
        Ok(ScannerRecord { family, payload })
    }
}

/// The scanners of a stream by their checksums.
#[derive(Default)]
pub(super) struct ScannerRecords(HashMap<ScannerId, ScannerRecord>);

impl ScannerRecords {
    /// Adds a scanner; returns whether it is new.
    ///
    /// # Errors
    /// If another one has the same checksum.
    pub fn add(&mut self, record: ScannerRecord) -> Result<bool> {
        match self.0.entry(record.id()) {
            Entry::Vacant(free) => drop(free.insert(record)),
            Entry::Occupied(known) if *known.get() == record => return Ok(false),
            Entry::Occupied(known) => {
                return Err(Error::corrupt(format!("two scanners have the checksum {}", known.key())));
            }
        }
        Ok(true)
    }

    /// The scanner with this checksum.
    pub fn get(&self, id: ScannerId) -> Option<&ScannerRecord> {
        self.0.get(&id)
    }
}
