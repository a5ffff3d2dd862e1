//! Writes a stream from front to back. FORMAT.md 2.

use std::io::Write;

use super::group::Group;
use super::header::{HEADER_LENGTH, StreamHeader};
use super::index::{End, Index};
use super::record::{END, GROUP, INDEX, SCANNER, write_record};
use super::scanner::{ScannerId, ScannerRecord, ScannerRecords};
use crate::ground::error::{Error, Result};

/// Distance between copies of a scanner's record, as a multiple of its size: before a group that uses it, the
/// record is repeated if this many times its bytes were written since the last copy. It is repeated once more
/// at the end of a stream of several groups. So damage costs only the groups that it hits, and the copies
/// take a 4,000th of the stream.
const COPY_DISTANCE: u64 = 4000;

/// Writes a stream from front to back, keeping only the index in memory.
pub struct StreamWriter<W> {
    out: W,
    /// Number of bytes written.
    position: u64,
    index: Index,
    scanners: ScannerRecords,
}

impl<W: Write> StreamWriter<W> {
    /// Creates a stream and writes its header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    pub fn create(mut out: W) -> Result<Self> {
        StreamHeader::default().write_to(&mut out)?;
        Ok(StreamWriter {
            out,
            position: HEADER_LENGTH as u64,
            index: Index::default(),
            scanners: ScannerRecords::default(),
        })
    }

    /// Continues a stream of which `out` has `position` bytes, with the records in `index` and these
    /// scanners.
    ///
    /// # Errors
    /// If two scanners have the same checksum.
    pub fn resume(out: W, index: Index, position: u64, scanners: &[ScannerRecord]) -> Result<Self> {
        let mut writer = StreamWriter { out, position, index, scanners: ScannerRecords::default() };
        scanners.iter().try_for_each(|scanner| writer.scanners.add(scanner.clone()).map(drop))?;
        Ok(writer)
    }

    /// Bytes written so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Writes a scanner unless the stream already has it; returns the reference for groups.
    ///
    /// # Errors
    /// If the output fails, or (once in 2^32 times) if another scanner of the stream has the same checksum.
    pub fn write_scanner(&mut self, scanner: &ScannerRecord) -> Result<ScannerId> {
        let id = scanner.id();
        if self.scanners.add(scanner.clone()).map_err(|_| {
            let what = "two scanners have the same checksum and cannot be in one stream; keep them apart";
            Error::Usage(what.to_owned())
        })? {
            self.write_copy(id)?;
        }
        Ok(id)
    }

    /// Writes the record of a scanner that was written before.
    fn write_copy(&mut self, id: ScannerId) -> Result<()> {
        let Some(scanner) = self.scanners.get(id) else { return Ok(()) };
        let written = write_record(&mut self.out, SCANNER, &scanner.to_payload())?;
        self.index.push_scanner(self.position, id);
        self.position += written.length;
        Ok(())
    }

    /// Whether the last copy of this scanner is far back.
    fn is_far_behind(&self, id: ScannerId) -> bool {
        let (Some(scanner), Some(entry)) = (self.scanners.get(id), self.index.scanner(id)) else {
            return false;
        };
        let last = entry.offsets.last().copied().unwrap_or_default();
        self.position - last >= COPY_DISTANCE * scanner.to_payload().len() as u64
    }

    /// Writes the sequence's next group and flushes it, for readers that follow the growing output. Its
    /// scanners must have been written before; those whose last copies are far back are written again.
    ///
    /// # Errors
    /// If the output fails.
    pub fn write_group(&mut self, group: &Group) -> Result<()> {
        for id in group.scanners.iter().flatten() {
            if self.is_far_behind(*id) {
                self.write_copy(*id)?;
            }
        }
        let mut payload = Vec::new();
        let frames = group.write_to(&mut payload);
        let written = write_record(&mut self.out, GROUP, &payload)?;
        self.out.flush()?;
        let what = "its files beside the scans would come before other scans; give it last, or cut them off";
        self.index
            .push_group(self.position, written.length, written.crc, frames)
            .map_err(|_| Error::Usage(what.to_owned()))?;
        self.position += written.length;
        Ok(())
    }

    /// Writes the scanners again, the index and the end, and flushes; returns the output and the number of
    /// bytes written.
    ///
    /// # Errors
    /// If the output fails.
    pub fn finish(mut self) -> Result<(W, u64)> {
        // In a stream of one group, copies would save no more than they cost.
        if self.index.groups.len() > 1 {
            let scanners: Vec<_> = self.index.scanners().iter().map(|entry| entry.id).collect();
            scanners.into_iter().try_for_each(|id| self.write_copy(id))?;
        }
        let mut payload = Vec::new();
        self.index.write_to(&mut payload);
        let index = write_record(&mut self.out, INDEX, &payload)?;
        let end = End { index_offset: self.position, header: StreamHeader::default() };
        let end = write_record(&mut self.out, END, &end.to_payload())?;
        self.out.flush()?;
        Ok((self.out, self.position + index.length + end.length))
    }
}
