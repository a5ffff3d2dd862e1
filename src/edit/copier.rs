//! Copies groups from streams into another stream, as they are.

use std::io::Write;
use std::path::PathBuf;

use crate::container::StreamWriter;
use crate::ground::error::Result;
use crate::stream::source::GroupJob;

/// A stream to read, and its name in errors.
#[derive(Clone, Debug)]
pub struct Named<T> {
    /// Its path, or a word for a stream without one.
    pub path: PathBuf,
    /// The stream.
    pub stream: T,
}

/// Writes groups of other streams, preceded by the scanners that they need.
pub struct GroupCopier<W> {
    writer: StreamWriter<W>,
}

impl<W: Write> GroupCopier<W> {
    /// Writes the stream header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    pub fn create(out: W) -> Result<Self> {
        Ok(GroupCopier { writer: StreamWriter::create(out)? })
    }

    /// Writes the next group.
    ///
    /// # Errors
    /// If the output fails.
    pub fn write(&mut self, job: &GroupJob) -> Result<()> {
        for scanner in job.scanners.iter().flatten() {
            self.writer.write_scanner(&scanner.record)?;
        }
        self.writer.write_group(&job.group)
    }

    /// Ends the stream; returns its size in bytes.
    ///
    /// # Errors
    /// If the output fails.
    pub fn finish(self) -> Result<u64> {
        Ok(self.writer.finish()?.1)
    }
}
