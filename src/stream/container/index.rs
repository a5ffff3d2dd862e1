//! The index: where the records are. Only seeking needs it; a stream decodes without.

use super::wire::take;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Bytes of the end record: kind, length, `index_offset`, `end_magic`, checksum.
pub(super) const END_LENGTH: u64 = 18;

/// The last bytes of the end record's payload.
const END_MAGIC: [u8; 4] = *b"LPC.";

/// Where a sensor model's record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorModelEntry {
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
    /// Coded bytes of each frame, frame header and checksums included.
    pub frame_sizes: Vec<u64>,
}

/// Where all records are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Index {
    /// The sensor models, in order; groups refer to them by number, 1 being the first.
    pub sensor_models: Vec<SensorModelEntry>,
    /// The groups, in order.
    pub groups: Vec<GroupEntry>,
}

impl Index {
    /// Frames in all groups.
    pub fn frame_count(&self) -> u64 {
        self.groups.last().map_or(0, |group| group.first_frame + group.frame_sizes.len() as u64)
    }

    /// Where the last of the records ends, in bytes from the start of the stream; `None` if there are none.
    pub(super) fn end(&self) -> Option<u64> {
        let models = self.sensor_models.iter().map(|entry| entry.offset + entry.length);
        models.chain(self.groups.iter().map(|entry| entry.offset + entry.length)).max()
    }

    /// Adds the sensor model whose record starts at `offset`.
    pub(super) fn push_sensor_model(&mut self, offset: u64, length: u64) {
        self.sensor_models.push(SensorModelEntry { offset, length });
    }

    /// Adds the group whose record starts at `offset`.
    pub(super) fn push_group(&mut self, offset: u64, length: u64, frame_sizes: Vec<u64>) {
        let first_frame = self.frame_count();
        self.groups.push(GroupEntry { offset, length, first_frame, frame_sizes });
    }

    /// Appends the payload of an index record.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.sensor_models.len() as u64);
        for entry in &self.sensor_models {
            write_unsigned(out, entry.offset);
            write_unsigned(out, entry.length);
        }
        write_unsigned(out, self.groups.len() as u64);
        for entry in &self.groups {
            write_unsigned(out, entry.offset);
            write_unsigned(out, entry.length);
            write_unsigned(out, entry.frame_sizes.len() as u64);
            for size in &entry.frame_sizes {
                write_unsigned(out, *size);
            }
        }
    }

    /// Reads the payload of an index record.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn read_from(mut input: &[u8]) -> Result<Self> {
        let input = &mut input;
        let mut index = Index::default();
        for _ in 0..read_unsigned(input, "sensor model count")? {
            let offset = read_unsigned(input, "sensor model's offset")?;
            index.push_sensor_model(offset, read_unsigned(input, "sensor model's length")?);
        }
        for _ in 0..read_unsigned(input, "group count")? {
            let offset = read_unsigned(input, "group's offset")?;
            let length = read_unsigned(input, "group's length")?;
            let mut frame_sizes = Vec::new();
            for _ in 0..read_unsigned(input, "frame count")? {
                frame_sizes.push(read_unsigned(input, "frame size")?);
            }
            index.push_group(offset, length, frame_sizes);
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
