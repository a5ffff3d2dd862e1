//! The few kinds of fields that are not numbers: bytes preceded by their length, and checksums.

use std::io::{self, Read};

use crate::ground::error::{Error, Result};

/// Fills `bytes`; if the input ends early, it is damaged, which the error says of `what`.
pub(super) fn read_exact(input: &mut impl Read, bytes: &mut [u8], what: &str) -> Result<()> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => Error::corrupt(format!("{what} is cut short")),
        _ => error.into(),
    })
}

/// Reads `length` bytes. Memory grows with the bytes received, so that a wrong length costs little.
pub(super) fn read_bytes(input: &mut impl Read, length: u64, what: &str) -> Result<Vec<u8>> {
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
