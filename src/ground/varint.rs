//! Variable-length integers (LEB128): seven bits per byte, least significant first, with the top bit set in
//! all bytes but the last. Signed integers are zigzag coded first: 0, -1, 1, -2 become 0, 1, 2, 3. Also
//! floating-point numbers, in eight bytes. FORMAT.md 1.

use std::io::{ErrorKind, Read};
use std::ops::RangeInclusive;

use crate::ground::error::{Error, Result};

/// Largest number of bytes of a 64-bit integer.
pub const VARINT_MAX: usize = 10;

/// Appends an unsigned integer.
pub fn write_unsigned(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Reads an unsigned integer. `what` names the field in errors.
///
/// # Errors
/// If the input ends, if the integer does not fit into 64 bits, or if it is longer than necessary: each value
/// has exactly one encoding.
pub fn read_unsigned(input: &mut impl Read, what: &str) -> Result<u64> {
    let mut value = 0u64;
    for place in 0..VARINT_MAX {
        let mut byte = [0];
        input.read_exact(&mut byte).map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => Error::corrupt(format!("{what} is cut short")),
            _ => error.into(),
        })?;
        if place == VARINT_MAX - 1 && byte[0] > 1 {
            break;
        }
        value |= u64::from(byte[0] & 0x7f) << (7 * place);
        if byte[0] < 0x80 {
            if byte[0] == 0 && place > 0 {
                return Err(Error::corrupt(format!("{what} is spelled longer than it need be")));
            }
            return Ok(value);
        }
    }
    Err(Error::corrupt(format!("{what} does not fit 64 bits")))
}

/// Takes a number of 8 bytes, little-endian, off the front of `input`. `what` names the field in errors.
///
/// # Errors
/// If the input ends.
pub fn read_f64(input: &mut &[u8], what: &str) -> Result<f64> {
    let (first, rest) =
        input.split_first_chunk().ok_or_else(|| Error::corrupt(format!("{what} is cut short")))?;
    *input = rest;
    Ok(f64::from_le_bytes(*first))
}

/// Reads an unsigned integer in a range. `what` names the field in errors.
///
/// # Errors
/// As for [`read_unsigned`], and if the integer is out of range.
pub fn read_within(input: &mut impl Read, what: &str, range: RangeInclusive<u64>) -> Result<u64> {
    match read_unsigned(input, what)? {
        got if range.contains(&got) => Ok(got),
        got if got > *range.end() => {
            Err(Error::corrupt(format!("{what}: {got}, but at most {}", range.end())))
        }
        got => Err(Error::corrupt(format!("{what}: {got}, but at least {}", range.start()))),
    }
}

/// Converts a number of a stream to a length or an index. One that is too large for this machine becomes the
/// largest `usize`, which every check rejects.
pub fn saturated(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
}

/// Appends a signed integer.
pub fn write_signed(out: &mut Vec<u8>, value: i64) {
    write_unsigned(out, zigzag(value));
}

/// Reads a signed integer.
///
/// # Errors
/// As for [`read_unsigned`].
pub fn read_signed(input: &mut impl Read, what: &str) -> Result<i64> {
    read_unsigned(input, what).map(unzigzag)
}

/// Maps signed integers to unsigned ones, small magnitudes to small numbers.
pub fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

/// The inverse of [`zigzag`].
pub fn unzigzag(code: u64) -> i64 {
    (code >> 1) as i64 ^ -((code & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_come_back() {
        for value in [0, 1, -1, 63, -64, 64, 300, i64::MAX - 1, i64::MAX, i64::MIN] {
            let mut bytes = Vec::new();
            write_signed(&mut bytes, value);
            assert_eq!(read_signed(&mut &bytes[..], "n").unwrap(), value);
            assert!(read_signed(&mut &bytes[..bytes.len() - 1], "n").is_err(), "{value} cut short");
        }
    }

    #[test]
    fn an_integer_has_one_spelling_and_64_bits() {
        assert!(read_unsigned(&mut &[0x80, 0x00][..], "n").is_err());
        let mut too_big = [0xff; VARINT_MAX];
        too_big[VARINT_MAX - 1] = 0x02;
        assert!(read_unsigned(&mut &too_big[..], "n").is_err());
        assert!(read_unsigned(&mut &[0xff; VARINT_MAX + 1][..], "n").is_err());
    }
}
