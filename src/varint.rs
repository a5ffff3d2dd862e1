//! Integers of variable length: seven bits a byte, lowest first, the top bit set on all but the
//! last (LEB128). Signed ones are zigzag coded first: 0, -1, 1, -2 become 0, 1, 2, 3.

use crate::error::{Error, Result};

/// Appends an unsigned integer.
pub fn write_unsigned(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Takes an unsigned integer off the front of `bytes`.
///
/// # Errors
/// If the bytes end inside it, or it does not fit into 64 bits.
pub fn read_unsigned(bytes: &mut &[u8]) -> Result<u64> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first().ok_or_else(|| Error::corrupt("cut short inside a number"))?;
        *bytes = rest;
        if shift == 63 && byte > 1 {
            break;
        }
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(Error::corrupt("a number is longer than 64 bits"))
}

/// Appends a signed integer.
pub fn write_signed(out: &mut Vec<u8>, value: i64) {
    write_unsigned(out, zigzag(value));
}

/// Takes a signed integer off the front of `bytes`.
///
/// # Errors
/// As [`read_unsigned`].
pub fn read_signed(bytes: &mut &[u8]) -> Result<i64> {
    read_unsigned(bytes).map(unzigzag)
}

/// Signed to unsigned, small magnitudes first.
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
    fn numbers_come_back() {
        for value in [0, 1, -1, 63, -64, 64, 300, i64::MAX, i64::MIN] {
            let mut out = Vec::new();
            write_signed(&mut out, value);
            let mut rest = out.as_slice();
            assert_eq!(read_signed(&mut rest).unwrap(), value);
            assert!(rest.is_empty());
            assert!(read_signed(&mut &out[..out.len() - 1]).is_err());
        }
    }

    #[test]
    fn overlong_numbers_are_refused() {
        assert!(read_unsigned(&mut [0xff; 9].as_slice()).is_err());
        assert!(read_unsigned(&mut [&[0xff; 9][..], &[2]].concat().as_slice()).is_err());
    }
}
