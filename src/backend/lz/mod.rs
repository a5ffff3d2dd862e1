//! Code shared by LZ5 and Lizard: frames, their checksum, and the search for matches.

pub mod frame;
pub mod parser;

mod matches;
mod xxh32;

use crate::ground::error::{Error, Result};

/// Appends `length` bytes from `offset` bytes back, up to `most` bytes in all.
pub fn copy_match(out: &mut Vec<u8>, offset: usize, length: usize, most: usize) -> Result<()> {
    let start = out.len().checked_sub(offset).filter(|start| *start < out.len());
    let start = start.ok_or_else(|| Error::corrupt("a match from before the data"))?;
    check_room(out, length, most)?;
    if offset >= length {
        out.extend_from_within(start..start + length);
    } else {
        (start..start + length).for_each(|at| out.push(out[at]));
    }
    Ok(())
}

/// Appends literals, up to `most` bytes in all.
pub fn copy_literals(out: &mut Vec<u8>, literals: &[u8], most: usize) -> Result<()> {
    check_room(out, literals.len(), most)?;
    out.extend_from_slice(literals);
    Ok(())
}

fn check_room(out: &[u8], length: usize, most: usize) -> Result<()> {
    if length > most.saturating_sub(out.len()) {
        return Err(Error::corrupt(format!("more than {most} bytes")));
    }
    Ok(())
}

/// Takes `count` bytes off the front.
pub fn take<'a>(input: &mut &'a [u8], count: usize) -> Result<&'a [u8]> {
    let taken = input.split_off(..count);
    taken.ok_or_else(|| Error::corrupt("cut short"))
}

/// Takes a little-endian number of `bytes` bytes, at most 4, off the front.
pub fn take_number(input: &mut &[u8], bytes: usize) -> Result<usize> {
    let number = take(input, bytes)?.iter().rev().fold(0u32, |number, byte| number << 8 | u32::from(*byte));
    Ok(number as usize)
}
