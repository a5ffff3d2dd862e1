//! Scanner records: what groups refer to for the scanners of their tracks. FORMAT.md 2.3.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt;

use super::record::{SCANNER, checksum};
use super::wire::take;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// What groups call a scanner: the checksum of its record. So a group names its scanners alike in every stream,
/// and any copy of the record will do. FORMAT.md 2.3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScannerId(pub u32);

impl fmt::Display for ScannerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08x}", self.0)
    }
}

impl ScannerId {
    /// Appends the scanner of a track, if it has one.
    pub(super) fn write_to(scanner: Option<ScannerId>, out: &mut Vec<u8>) {
        write_unsigned(out, scanner.map_or(0, |id| u64::from(id.0) + 1));
    }

    /// Takes the scanner of a track, if it has one, off the front of `input`.
    ///
    /// # Errors
    /// If it is cut short, or over 2^32.
    pub(super) fn read_from(input: &mut &[u8]) -> Result<Option<ScannerId>> {
        let Some(id) = read_unsigned(input, "scanner of a group")?.checked_sub(1) else { return Ok(None) };
        let id = u32::try_from(id).map_err(|_| Error::corrupt("a group of a scanner that none can be"))?;
        Ok(Some(ScannerId(id)))
    }
}

/// A scanner, as far as the container knows it: its family says how to read the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct ScannerRecord {
    /// The number of the family.
    pub family: u64,
    /// What the family has to say of the scanner.
    pub payload: Vec<u8>,
}

impl ScannerRecord {
    /// What groups call it.
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
    /// If it is not as long as it says.
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

/// The scanners of a stream, by what groups call them.
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

    /// The scanner that groups call so.
    pub fn get(&self, id: ScannerId) -> Option<&ScannerRecord> {
        self.0.get(&id)
    }
}
