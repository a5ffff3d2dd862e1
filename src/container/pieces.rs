//! Reads an input in few large pieces, since each read may be a request to a server.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

use super::wire::read_exact;
use crate::ground::error::Result;

/// Bytes that are read in one go at the end of the input: enough for the end record, the index and the last
/// copies of the scanners in a stream of some thousand frames.
const TAIL: u64 = 1 << 16;

/// A seekable input with some pieces in memory.
#[derive(Clone)]
pub(super) struct Pieces<R> {
    input: R,
    size: u64,
    /// The end of the input, kept in memory throughout.
    tail: Arc<Vec<u8>>,
    /// The piece last read ahead, with its offset.
    ahead: (u64, Vec<u8>),
}

impl<R: Read + Seek> Pieces<R> {
    /// Reads the end of the input.
    ///
    /// # Errors
    /// If the input fails.
    pub fn open(mut input: R) -> Result<Self> {
        let size = input.seek(SeekFrom::End(0))?;
        let tail = read_piece(&mut input, size.saturating_sub(TAIL), size)?;
        Ok(Pieces { input, size, tail: Arc::new(tail), ahead: (0, Vec::new()) })
    }

    /// Size of the input in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Whether all bytes from this one on are in memory.
    pub fn is_tail(&self, offset: u64) -> bool {
        (self.size - self.tail.len() as u64..self.size).contains(&offset)
    }

    /// Whether these bytes are in memory.
    pub fn holds(&self, start: u64, end: u64) -> bool {
        let (first, bytes) = &self.ahead;
        self.is_tail(start) || (*first <= start && end <= first + bytes.len() as u64)
    }

    /// Reads these bytes in one go. Nothing is read if the input is shorter.
    ///
    /// # Errors
    /// If the input fails.
    pub fn read_ahead(&mut self, start: u64, end: u64) -> Result<()> {
        if end > self.size || start >= end {
            return Ok(());
        }
        // Free the old buffer before the new one is allocated.
        self.ahead = (0, Vec::new());
        self.ahead = (start, read_piece(&mut self.input, start, end)?);
        Ok(())
    }

    /// Frees the piece that was read ahead, if it ends at `end`.
    pub fn used_up_to(&mut self, end: u64) {
        if end >= self.ahead.0 + self.ahead.1.len() as u64 {
            self.ahead = (0, Vec::new());
        }
    }

    /// A reader from `offset` on. If a piece in memory contains the first byte, it must contain all bytes
    /// that will be read.
    ///
    /// # Errors
    /// If the input cannot be sought in.
    pub fn reader_at(&mut self, offset: u64) -> Result<Box<dyn Read + '_>> {
        let of = |first: u64, bytes: &'_ [u8]| {
            usize::try_from(offset.checked_sub(first)?).ok().filter(|place| *place < bytes.len())
        };
        let (first, ahead) = &self.ahead;
        if let Some(place) = of(*first, ahead) {
            return Ok(Box::new(&ahead[place..]));
        }
        if let Some(place) = of(self.size - self.tail.len() as u64, &self.tail) {
            return Ok(Box::new(&self.tail[place..]));
        }
        self.input.seek(SeekFrom::Start(offset))?;
        Ok(Box::new(BufReader::with_capacity(TAIL as usize, &mut self.input)))
    }
}

/// Reads these bytes, which must be within the input.
fn read_piece(input: &mut (impl Read + Seek), start: u64, end: u64) -> Result<Vec<u8>> {
    input.seek(SeekFrom::Start(start))?;
    let mut bytes = vec![0; (end - start) as usize];
    read_exact(input, &mut bytes, "the stream")?;
    Ok(bytes)
}
