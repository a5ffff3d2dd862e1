//! Operations on finished streams: groups are copied from one stream to another, which [`GroupCopier`] does
//! for all of them, and recoded only where necessary.

pub mod cat;
pub mod cut;
pub mod recover;
pub mod resume;

use std::io::Write;
use std::path::PathBuf;

pub use cat::{Joined, cat};
pub use cut::{Cut, cut, cut_indexed};
pub use recover::{Recovered, recover, repair};
pub use resume::{PartialFiles, confirm_complete, encode_resuming};

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
struct GroupCopier<W> {
    writer: StreamWriter<W>,
}

impl<W: Write> GroupCopier<W> {
    /// Writes the stream header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    fn create(out: W) -> Result<Self> {
        Ok(GroupCopier { writer: StreamWriter::create(out)? })
    }

    /// Writes the next group.
    ///
    /// # Errors
    /// If the output fails.
    fn write(&mut self, job: &GroupJob) -> Result<()> {
        for scanner in job.scanners.iter().flatten() {
            self.writer.write_scanner(&scanner.record)?;
        }
        self.writer.write_group(&job.group)
    }

    /// Ends the stream; returns its size in bytes.
    ///
    /// # Errors
    /// If the output fails.
    fn finish(self) -> Result<u64> {
        Ok(self.writer.finish()?.1)
    }
}
