//! The index: where the records are. Only seeking needs it; a stream decodes without.

use super::stamp::Stamp;
use super::wire::take;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Bytes of the end record: kind, length, `index_offset`, `end_magic`, checksum.
pub(super) const END_LENGTH: u64 = 18;

/// The last bytes of the end record's payload.
const END_MAGIC: [u8; 4] = *b"LPC.";

/// Where a scanner's record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScannerEntry {
    /// Offset of the record from the start of the stream, in bytes.
    pub offset: u64,
    /// Bytes of the whole record.
    pub length: u64,
}

/// Where a group's record is, and what it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupEntry {
    /// Offset of the record from the start of the stream, in bytes.
    pub offset: u64,
    /// Bytes of the whole record.
    pub length: u64,
    /// Number of its first frame in the sequence. Not stored: it is the sum of the counts before.
    pub first_frame: u64,
    /// Its frames, in order.
    pub frames: Vec<FrameEntry>,
}

/// A frame of a group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameEntry {
    /// Coded bytes, frame header and checksums included.
    pub size: u64,
    /// What it is, whose, and of when: as in the frame's header.
    pub stamp: Stamp,
}

/// Where all records are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Index {
    /// The scanners, in order; groups refer to them by number, 1 being the first.
    pub scanners: Vec<ScannerEntry>,
    /// The groups, in order.
    pub groups: Vec<GroupEntry>,
}

impl Index {
    /// Frames in all groups.
    pub fn frame_count(&self) -> u64 {
        self.groups.last().map_or(0, |group| group.first_frame + group.frames.len() as u64)
    }

    /// Where the last of the records ends, in bytes from the start of the stream; `None` if there are none.
    pub(super) fn end(&self) -> Option<u64> {
        let scanners = self.scanners.iter().map(|entry| entry.offset + entry.length);
        scanners.chain(self.groups.iter().map(|entry| entry.offset + entry.length)).max()
    }

    /// Adds the scanner whose record starts at `offset`.
    pub(super) fn push_scanner(&mut self, offset: u64, length: u64) {
        self.scanners.push(ScannerEntry { offset, length });
    }

    /// Adds the group whose record starts at `offset`.
    pub(super) fn push_group(&mut self, offset: u64, length: u64, frames: Vec<FrameEntry>) {
        let first_frame = self.frame_count();
        self.groups.push(GroupEntry { offset, length, first_frame, frames });
    }

    /// Appends the payload of an index record.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.scanners.len() as u64);
        for entry in &self.scanners {
            write_unsigned(out, entry.offset);
            write_unsigned(out, entry.length);
        }
        write_unsigned(out, self.groups.len() as u64);
        for entry in &self.groups {
            write_unsigned(out, entry.offset);
            write_unsigned(out, entry.length);
            write_unsigned(out, entry.frames.len() as u64);
            entry.frames.iter().for_each(|frame| write_unsigned(out, frame.size));
            entry.frames.iter().for_each(|frame| frame.stamp.write_to(out));
        }
    }

    /// Reads the payload of an index record.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn read_from(mut input: &[u8]) -> Result<Self> {
        let input = &mut input;
        let mut index = Index::default();
        for _ in 0..read_unsigned(input, "scanner count")? {
            let offset = read_unsigned(input, "scanner's offset")?;
            index.push_scanner(offset, read_unsigned(input, "scanner's length")?);
        }
        for _ in 0..read_unsigned(input, "group count")? {
            let offset = read_unsigned(input, "group's offset")?;
            let length = read_unsigned(input, "group's length")?;
            let mut frames = Vec::new();
            for _ in 0..read_unsigned(input, "frame count")? {
                let size = read_unsigned(input, "frame size")?;
                frames.push(FrameEntry { size, stamp: Stamp::default() });
            }
            for frame in &mut frames {
                frame.stamp = Stamp::read_from(input)?;
            }
            index.push_group(offset, length, frames);
        }
        if !input.is_empty() {
            return Err(Error::corrupt("bytes left over"));
        }
        Ok(index)
    }
}

/// The payload of the end record.
pub(super) fn end_payload(index_offset: u64) -> Vec<u8> {
    [&index_offset.to_le_bytes()[..], &END_MAGIC].concat()
}

/// Reads the payload of the end record: where the index record starts.
pub(super) fn read_end_payload(mut payload: &[u8]) -> Result<u64> {
    let index_offset = take(&mut payload, 8, "index offset")?;
    if payload != END_MAGIC {
        return Err(Error::corrupt("it is not as long as it should be, or does not close with its mark"));
    }
    Ok(index_offset.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte)))
}
