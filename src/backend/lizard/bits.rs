//! Bits read from the end of a stream to its beginning, as Huff0 and FSE write them: the highest set bit of
//! the last byte marks the end.

use crate::ground::error::{Error, Result};

/// Reads bits in reverse.
pub struct BackwardBits<'a> {
    bytes: &'a [u8],
    /// Number of bits that are left.
    left: usize,
}

impl<'a> BackwardBits<'a> {
    /// # Errors
    /// If there is no end mark.
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let last = bytes.last().filter(|last| **last > 0).ok_or_else(|| Error::corrupt("no end mark"))?;
        Ok(BackwardBits { bytes, left: bytes.len() * 8 - 1 - last.leading_zeros() as usize })
    }

    /// Number of bits that are left.
    pub fn left(&self) -> usize {
        self.left
    }

    /// The next `count` bits, at most 16, the first of them highest; as if zeros followed the last bit.
    pub fn peek(&self, count: usize) -> usize {
        let start = self.left.saturating_sub(count);
        let missing = count - (self.left - start);
        let byte = start / 8;
        let window = (0..4).fold(0u32, |window, i| {
            window | u32::from(self.bytes.get(byte + i).copied().unwrap_or(0)) << (8 * i)
        });
        let bits = (window >> (start % 8)) as usize & ((1 << (count - missing)) - 1);
        bits << missing
    }

    /// Skips bits.
    ///
    /// # Errors
    /// If there are not that many.
    pub fn skip(&mut self, count: usize) -> Result<()> {
        self.left = self.left.checked_sub(count).ok_or_else(|| Error::corrupt("bits run out"))?;
        Ok(())
    }

    /// Takes bits; see [`peek`](Self::peek).
    ///
    /// # Errors
    /// If there are not that many.
    pub fn take(&mut self, count: usize) -> Result<usize> {
        let bits = self.peek(count);
        self.skip(count)?;
        Ok(bits)
    }
}
