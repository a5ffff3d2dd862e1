//! The container: a stream header, then records, each with a length and a checksum; the last two are the
//! index and the end. It only arranges bytes and knows no algorithm.
//!
//! FORMAT.md describes the same fields under the same names. Every length is checked against
//! [`Limits`](crate::ground::error::Limits) and against the available bytes before memory is allocated.

pub mod group;
pub mod header;
pub mod index;
pub mod reader;
pub mod salvage;
pub mod scanner;
pub mod stamp;
pub mod writer;

mod record;
mod search;

pub use group::{
    CodedFrame, FrameHeader, Group, Section, TRACKS_MAX, allowance, pay_for, payload_bytes, payload_bytes_of,
};
pub use header::{MAGIC, StreamHeader, VERSION};
pub use index::{FrameEntry, GroupEntry, Index, ScannerEntry};
pub use reader::{IndexedReader, Record, StreamReader};
pub use salvage::{Lost, SalvageReader, Salvaged};
pub use scanner::{ScannerId, ScannerRecord};
pub use stamp::{FrameKind, Stamp, Time, TimeSource};
pub use writer::StreamWriter;

pub use crate::ground::SectionKind;

#[cfg(test)]
mod tests;
