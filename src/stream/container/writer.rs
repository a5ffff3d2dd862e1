//! Writes a stream, front to back.

use std::io::Write;

use super::group::Group;
use super::header::{HEADER_LENGTH, StreamHeader};
use super::index::{Index, end_payload};
use super::record::{END, GROUP, INDEX, SCANNER, write_record};
use super::scanner::ScannerRecord;
use crate::ground::error::Result;

/// Writes a stream, front to back, keeping only the index in memory.
pub struct StreamWriter<W> {
    out: W,
    /// Bytes written.
    position: u64,
    index: Index,
}

impl<W: Write> StreamWriter<W> {
    /// Writes the stream header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    pub fn create(mut out: W) -> Result<Self> {
        StreamHeader::default().write_to(&mut out)?;
        Ok(StreamWriter { out, position: HEADER_LENGTH as u64, index: Index::default() })
    }

    /// Goes on with a stream that `out` has got as far as the records of `index` go, the last of them included.
    pub fn resume(out: W, index: Index) -> Self {
        StreamWriter { out, position: index.end().unwrap_or(HEADER_LENGTH as u64), index }
    }

    /// Bytes written so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Writes a scanner; returns the number by which groups refer to it (1 is the first).
    ///
    /// # Errors
    /// If the output fails.
    pub fn write_scanner(&mut self, scanner: &ScannerRecord) -> Result<u64> {
        let mut payload = Vec::new();
        scanner.write_to(&mut payload);
        let length = write_record(&mut self.out, SCANNER, &payload)?;
        self.index.push_scanner(self.position, length);
        self.position += length;
        Ok(self.index.scanners.len() as u64)
    }

    /// Writes the sequence's next group, down to whoever reads the output as it grows.
    ///
    /// # Errors
    /// If the output fails.
    pub fn write_group(&mut self, group: &Group) -> Result<()> {
        let mut payload = Vec::new();
        let frames = group.write_to(&mut payload);
        let length = write_record(&mut self.out, GROUP, &payload)?;
        self.out.flush()?;
        self.index.push_group(self.position, length, frames);
        self.position += length;
        Ok(())
    }

    /// Writes the index and the end, and flushes; returns the output and how many bytes it got.
    ///
    /// # Errors
    /// If the output fails.
    pub fn finish(mut self) -> Result<(W, u64)> {
        let mut payload = Vec::new();
        self.index.write_to(&mut payload);
        let index_length = write_record(&mut self.out, INDEX, &payload)?;
        let end_length = write_record(&mut self.out, END, &end_payload(self.position))?;
        self.out.flush()?;
        Ok((self.out, self.position + index_length + end_length))
    }
}
