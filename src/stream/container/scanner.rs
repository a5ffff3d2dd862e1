//! Scanner records: what groups refer to for the scanners of their streams.

use super::wire::take;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// A scanner, as far as the container knows it: its family says how to read the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct ScannerRecord {
    /// The number of the family.
    pub family: u64,
    /// What the family has to say of the scanner.
    pub payload: Vec<u8>,
}

impl ScannerRecord {
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
