//! The index: the offsets of the records. Only seeking needs it; a stream can be decoded without it.
//! FORMAT.md 2.7 and 2.8.

use std::collections::HashMap;

use super::header::{FIELDS_LENGTH, StreamHeader};
use super::record::take_u32;
use super::scanner::ScannerId;
use super::stamp::{FrameKind, Stamp};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// The locations of a scanner's records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScannerEntry {
    /// The checksum of these records, by which groups refer to the scanner.
    pub id: ScannerId,
    /// Offsets of all copies of its record, at least one, in bytes from the start of the stream.
    pub offsets: Vec<u64>,
}

/// The location and contents of a group's record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupEntry {
    /// Offset of the record in bytes from the start of the stream.
    pub offset: u64,
    /// Bytes of the whole record.
    pub length: u64,
    /// Checksum of the record, which identifies the group wherever it is found.
    pub crc: u32,
    /// Number of its first frame in the sequence. Not stored: it is the number of frames in the groups
    /// before.
    pub first_frame: u64,
    /// Its frames, in order.
    pub frames: Vec<FrameEntry>,
}

/// A frame of a group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameEntry {
    /// Coded bytes, frame header and checksums included.
    pub size: u64,
    /// Kind, track and time, as in the frame's header.
    pub stamp: Stamp,
}

impl FrameEntry {
    /// Whether it is a file beside the scans.
    pub fn is_beside(&self) -> bool {
        self.stamp.kind == FrameKind::Beside
    }
}

impl GroupEntry {
    /// The number of the frame after its last.
    pub fn end(&self) -> u64 {
        self.first_frame + self.frames.len() as u64
    }

    /// Whether it holds files beside the scans.
    pub fn is_beside(&self) -> bool {
        self.frames.first().is_some_and(FrameEntry::is_beside)
    }
}

/// The locations of all records.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Index {
    scanners: Vec<ScannerEntry>,
    /// Index into `scanners` for each checksum.
    places: HashMap<ScannerId, usize>,
    /// The groups, in order.
    pub groups: Vec<GroupEntry>,
}

impl Index {
    /// Number of frames that are scans. They come before all files beside the scans.
    pub fn scan_count(&self) -> u64 {
        self.groups.iter().rfind(|group| !group.is_beside()).map_or(0, GroupEntry::end)
    }

    /// Number of frames in all groups.
    pub fn frame_count(&self) -> u64 {
        self.groups.last().map_or(0, GroupEntry::end)
    }

    /// The scanners, in the order of their first records.
    pub fn scanners(&self) -> &[ScannerEntry] {
        &self.scanners
    }

    /// The scanner with this checksum, if there is one.
    pub fn scanner(&self, id: ScannerId) -> Option<&ScannerEntry> {
        self.places.get(&id).map(|place| &self.scanners[*place])
    }

    /// Adds a scanner record that starts at `offset`.
    pub(super) fn push_scanner(&mut self, offset: u64, id: ScannerId) {
        let next = self.scanners.len();
        let place = *self.places.entry(id).or_insert(next);
        if place == next {
            self.scanners.push(ScannerEntry { id, offsets: Vec::new() });
        }
        self.scanners[place].offsets.push(offset);
    }

    /// Adds the group whose record starts at `offset`.
    ///
    /// # Errors
    /// If it holds scans although the group before it holds files beside the scans.
    pub(super) fn push_group(
        &mut self,
        offset: u64,
        length: u64,
        crc: u32,
        frames: Vec<FrameEntry>,
    ) -> Result<()> {
        let first_frame = self.frame_count();
        let group = GroupEntry { offset, length, crc, first_frame, frames };
        if self.groups.last().is_some_and(GroupEntry::is_beside) && !group.is_beside() {
            return Err(Error::corrupt("scans after the files beside them"));
        }
        self.groups.push(group);
        Ok(())
    }

    /// Removes the records from this offset on.
    pub fn truncate(&mut self, end: u64) {
        self.groups.retain(|group| group.offset < end);
        self.scanners.iter_mut().for_each(|entry| entry.offsets.retain(|offset| *offset < end));
        // Scanners are in the order of their first records, so those that remain are the first ones.
        self.scanners.retain(|entry| !entry.offsets.is_empty());
        let scanners = self.scanners.len();
        self.places.retain(|_, place| *place < scanners);
    }

    /// Appends the payload of an index record.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.scanners.len() as u64);
        for ScannerEntry { id, offsets } in &self.scanners {
            out.extend_from_slice(&id.0.to_le_bytes());
            write_unsigned(out, offsets.len() as u64);
            offsets.iter().for_each(|offset| write_unsigned(out, *offset));
        }
        write_unsigned(out, self.groups.len() as u64);
        for entry in &self.groups {
            write_unsigned(out, entry.offset);
            write_unsigned(out, entry.length);
            out.extend_from_slice(&entry.crc.to_le_bytes());
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
            let id = ScannerId(take_u32(input, "scanner's checksum")?);
            let copies = read_unsigned(input, "copies of a scanner")?;
            if copies == 0 || index.scanner(id).is_some() {
                return Err(Error::corrupt(format!("scanner {id} has no record, or is there twice")));
            }
            for _ in 0..copies {
                index.push_scanner(read_unsigned(input, "scanner's offset")?, id);
            }
        }
        for _ in 0..read_unsigned(input, "group count")? {
            let offset = read_unsigned(input, "group's offset")?;
            let length = read_unsigned(input, "group's length")?;
            let crc = take_u32(input, "group's checksum")?;
            let mut frames = Vec::new();
            let count = read_unsigned(input, "frame count")?;
            // A size is at least a byte, a stamp three. Checked before there is memory for all of them.
            if count > input.len() as u64 / 4 {
                return Err(Error::corrupt("index: more frames than it has bytes for"));
            }
            for _ in 0..count {
                let size = read_unsigned(input, "frame size")?;
                frames.push(FrameEntry { size, stamp: Stamp::default() });
            }
            for frame in &mut frames {
                frame.stamp = Stamp::read_from(input)?;
            }
            index.push_group(offset, length, crc, frames)?;
        }
        if !input.is_empty() {
            return Err(Error::corrupt("bytes left over"));
        }
        Ok(index)
    }
}

/// The end of a stream: the offset of the index, and a copy of the stream header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct End {
    /// Offset of the index record in bytes from the start of the stream.
    pub index_offset: u64,
    /// Copy of the stream header. Not checked.
    pub header: StreamHeader,
}

impl End {
    /// Bytes of the end record: kind, length, payload, checksum.
    pub const RECORD_LENGTH: u64 = 1 + 1 + 8 + FIELDS_LENGTH as u64 + 4;

    /// The payload of the end record.
    pub fn to_payload(self) -> Vec<u8> {
        [self.index_offset.to_le_bytes(), self.header.to_bytes()].concat()
    }

    /// Reads the payload of the end record.
    ///
    /// # Errors
    /// If it is not one.
    pub fn from_payload(payload: &[u8]) -> Result<Self> {
        let parts =
            payload.split_first_chunk().and_then(|(offset, rest)| Some((offset, rest.try_into().ok()?)));
        let end = parts.and_then(|(offset, header)| {
            Some(End { index_offset: u64::from_le_bytes(*offset), header: StreamHeader::from_bytes(header)? })
        });
        end.ok_or_else(|| {
            Error::corrupt("it is not as long as it should be, or does not hold the stream header")
        })
    }
}
