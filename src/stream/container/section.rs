//! Sections: the typed, separately checked parts that a frame is coded in.

use std::fmt;

use super::wire::{take, take_u32};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// What a section holds. The numbers are those of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum SectionKind {
    /// Layout of the file, and the bytes before and after the records.
    File = 1,
    /// Which columns of the range image are used.
    Columns = 2,
    /// Which cells of the range image hold a point.
    Occupancy = 3,
    /// Ranges.
    Range = 4,
    /// What rounding leaves between the model's coordinates and the file's.
    Correction = 5,
    /// Intensities.
    Intensity = 6,
    /// Where the points' order differs from the canonical one.
    Order = 7,
    /// Points that no model explains, as they come.
    Points = 8,
    /// Fields other than position and intensity.
    Channels = 9,
    /// How the frame is coded; left out if by the defaults.
    Parameters = 10,
    /// The contour map: which region each return belongs to.
    Contour = 11,
    /// The models of the regions.
    Regions = 12,
    /// What prediction leaves of the ranges, coded by a general-purpose back-end.
    Residual = 13,
    /// How the points were moved after they were measured; left out if they were not.
    Compensation = 14,
    /// The file as it is, through a general-purpose coder: then nothing else is there but parameters.
    Bytes = 15,
}

impl SectionKind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [SectionKind; 15] = [
        SectionKind::File,
        SectionKind::Columns,
        SectionKind::Occupancy,
        SectionKind::Range,
        SectionKind::Correction,
        SectionKind::Intensity,
        SectionKind::Order,
        SectionKind::Points,
        SectionKind::Channels,
        SectionKind::Parameters,
        SectionKind::Contour,
        SectionKind::Regions,
        SectionKind::Residual,
        SectionKind::Compensation,
        SectionKind::Bytes,
    ];

    /// The kind's name in reports: lower case, one word.
    pub fn name(self) -> &'static str {
        match self {
            SectionKind::File => "file",
            SectionKind::Columns => "columns",
            SectionKind::Occupancy => "occupancy",
            SectionKind::Range => "range",
            SectionKind::Correction => "correction",
            SectionKind::Intensity => "intensity",
            SectionKind::Order => "order",
            SectionKind::Points => "points",
            SectionKind::Channels => "channels",
            SectionKind::Parameters => "parameters",
            SectionKind::Contour => "contour",
            SectionKind::Regions => "regions",
            SectionKind::Residual => "residual",
            SectionKind::Compensation => "compensation",
            SectionKind::Bytes => "bytes",
        }
    }

    /// The kind with this number, if there is one.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == number)
    }
}

impl fmt::Display for SectionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One section of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// What the payload holds.
    pub kind: SectionKind,
    /// The coded bytes.
    pub payload: Vec<u8>,
}

impl Section {
    /// Appends kind, length, payload and the checksum over all three.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        let start = out.len();
        out.push(self.kind as u8);
        write_unsigned(out, self.payload.len() as u64);
        out.extend_from_slice(&self.payload);
        let crc = crc32c::crc32c(&out[start..]);
        out.extend_from_slice(&crc.to_le_bytes());
    }

    /// Takes a section off the front of `input`.
    ///
    /// # Errors
    /// If it is cut short, damaged, or of an unknown kind.
    pub fn read_from(input: &mut &[u8]) -> Result<Self> {
        let start = *input;
        let number = take(input, 1, "section kind")?[0];
        let name = SectionKind::from_number(number).map_or("unknown", SectionKind::name);
        let length = read_unsigned(input, &format!("length of section {number} ({name})"))?;
        let payload = take(input, length, &format!("section {number} ({name})"))?;
        let crc = crc32c::crc32c(&start[..start.len() - input.len()]);
        if crc != take_u32(input, &format!("checksum of section {number} ({name})"))? {
            return Err(Error::corrupt(format!("section {number} ({name}): checksum does not match")));
        }
        let kind = SectionKind::from_number(number)
            .ok_or_else(|| Error::unsupported(format!("section of unknown kind {number}")))?;
        Ok(Section { kind, payload: payload.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comes_back_and_leaves_what_follows() {
        for kind in SectionKind::ALL {
            let section = Section { kind, payload: vec![kind as u8; 200] };
            let mut bytes = Vec::new();
            section.write_to(&mut bytes);
            bytes.extend_from_slice(b"next");
            let mut input = &bytes[..];
            assert_eq!(Section::read_from(&mut input).unwrap(), section);
            assert_eq!(input, b"next");
        }
    }

    #[test]
    fn an_unknown_kind_is_named() {
        let mut bytes = vec![77, 1, 42];
        let crc = crc32c::crc32c(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
        let error = Section::read_from(&mut &bytes[..]).unwrap_err();
        assert!(matches!(error, Error::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("unknown kind 77"), "{error}");
    }
}
