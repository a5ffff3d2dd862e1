//! The few shapes that all fields have: LEB128 numbers, and bytes after their length.

use std::io::{self, Read};

use crate::error::{Error, Result};

/// The most bytes that a 64-bit LEB128 number takes.
pub(super) const VARINT_MAX: usize = 10;

/// Appends `value` as LEB128: seven bits a byte, lowest first, the top bit set on all but the last.
pub(super) fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Reads a LEB128 number. `what` names the field in errors.
///
/// # Errors
/// If the input ends, the number does not fit 64 bits, or is longer than it need be: one value has
/// one spelling.
pub(super) fn read_varint(input: &mut impl Read, what: &str) -> Result<u64> {
    let mut value = 0u64;
    for place in 0..VARINT_MAX {
        let mut byte = [0];
        read_exact(input, &mut byte, what)?;
        let bits = u64::from(byte[0] & 0x7f);
        if place == VARINT_MAX - 1 && byte[0] > 1 {
            break;
        }
        value |= bits << (7 * place);
        if byte[0] < 0x80 {
            if byte[0] == 0 && place > 0 {
                return Err(Error::corrupt(format!("{what} is spelled longer than it need be")));
            }
            return Ok(value);
        }
    }
    Err(Error::corrupt(format!("{what} does not fit 64 bits")))
}

/// Reads exactly as many bytes as `bytes` holds; an early end is damage, named by `what`.
pub(super) fn read_exact(input: &mut impl Read, bytes: &mut [u8], what: &str) -> Result<()> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => Error::corrupt(format!("{what} is cut short")),
        _ => error.into(),
    })
}

/// Reads `length` bytes. Memory grows with what arrives, so that a lying length costs nothing.
pub(super) fn read_bytes(input: &mut impl Read, length: u64, what: &str) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
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
    fn varints_come_back() {
        for value in [0, 1, 127, 128, 300, u64::from(u32::MAX), u64::MAX - 1, u64::MAX] {
            let mut bytes = Vec::new();
            put_varint(&mut bytes, value);
            assert_eq!(read_varint(&mut &bytes[..], "n").unwrap(), value);
            assert!(read_varint(&mut &bytes[..bytes.len() - 1], "n").is_err(), "{value} cut short");
        }
    }

    #[test]
    fn a_varint_has_one_spelling_and_64_bits() {
        assert!(read_varint(&mut &[0x80, 0x00][..], "n").is_err());
        let mut too_big = [0xff; 10];
        too_big[9] = 0x02;
        assert!(read_varint(&mut &too_big[..], "n").is_err());
        assert!(read_varint(&mut &[0xff; 11][..], "n").is_err());
    }

    #[test]
    fn a_lying_length_costs_no_memory() {
        assert!(read_bytes(&mut &[1, 2, 3][..], u64::MAX, "payload").is_err());
        assert!(take(&mut &[1, 2, 3][..], u64::MAX, "payload").is_err());
    }
}
