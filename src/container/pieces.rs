//! Few and large reads of an input where each may be a request to a server.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

use super::wire::read_exact;
use crate::ground::error::Result;

/// Bytes that are read at once at the end of the input: the end record, the index and the last copies of the scanners of
/// a stream of some thousand frames.
const TAIL: u64 = 1 << 16;

/// An input that can be sought in, of which pieces are in memory.
#[derive(Clone)]
pub(super) struct Pieces<R> {
    input: R,
    size: u64,
    /// What it ends in. It stays.
    tail: Arc<Vec<u8>>,
    /// What was read ahead last, and where it begins.
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

    /// Bytes of the input.
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

    /// Reads these bytes, at once. Nothing is read if the input ends before.
    ///
    /// # Errors
    /// If the input fails.
    pub fn read_ahead(&mut self, start: u64, end: u64) -> Result<()> {
        if end > self.size || start >= end {
            return Ok(());
        }
        // Not more than one piece at a time.
        self.ahead = (0, Vec::new());
        self.ahead = (start, read_piece(&mut self.input, start, end)?);
        Ok(())
    }

    /// Lets go of what was read ahead, if it ends here.
    pub fn used_up_to(&mut self, end: u64) {
        if end >= self.ahead.0 + self.ahead.1.len() as u64 {
            self.ahead = (0, Vec::new());
        }
    }

    /// Reads from here on. What is read ahead must hold all that is wanted, if it holds the first byte.
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

/// These bytes, which the input has.
fn read_piece(input: &mut (impl Read + Seek), start: u64, end: u64) -> Result<Vec<u8>> {
    input.seek(SeekFrom::Start(start))?;
    let mut bytes = vec![0; (end - start) as usize];
    read_exact(input, &mut bytes, "the stream")?;
    Ok(bytes)
}
