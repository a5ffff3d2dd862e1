//! Copies groups from streams into another stream, as they are.

use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use crate::ground::error::Result;
use crate::stream::container::{Group, ScannerRecord, StreamWriter};
use crate::stream::source::{GroupJob, StoredScanner};

/// A stream to read, and its name in errors.
#[derive(Clone, Debug)]
pub struct Named<T> {
    /// Its file, or a word for a stream without one.
    pub path: PathBuf,
    /// The stream.
    pub stream: T,
}

/// Writes groups of other streams, preceded by the scanners that they need, each written once.
pub struct GroupCopier<W> {
    writer: StreamWriter<W>,
    /// The numbers of the scanners written so far.
    numbers: HashMap<ScannerRecord, u64>,
}

impl<W: Write> GroupCopier<W> {
    /// Writes the stream header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    pub fn create(out: W) -> Result<Self> {
        Ok(GroupCopier { writer: StreamWriter::create(out)?, numbers: HashMap::new() })
    }

    /// Writes the next group.
    ///
    /// # Errors
    /// If the output fails.
    pub fn write(&mut self, job: GroupJob) -> Result<()> {
        let number = |scanner: &Option<Arc<StoredScanner>>| match scanner {
            Some(scanner) => self.number_of(&scanner.record),
            None => Ok(0),
        };
        let scanners = job.scanners.iter().map(number).collect::<Result<_>>()?;
        self.writer.write_group(&Group { scanners, ..job.group })
    }

    fn number_of(&mut self, record: &ScannerRecord) -> Result<u64> {
        if let Some(number) = self.numbers.get(record) {
            return Ok(*number);
        }
        let number = self.writer.write_scanner(record)?;
        self.numbers.insert(record.clone(), number);
        Ok(number)
    }

    /// Ends the stream; returns its size in bytes.
    ///
    /// # Errors
    /// If the output fails.
    pub fn finish(self) -> Result<u64> {
        Ok(self.writer.finish()?.1)
    }
}
