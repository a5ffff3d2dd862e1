//! Sections: the typed, separately checked parts that a frame is coded in.

use std::fmt;

use super::record::SKIPPABLE;
use super::wire::{take, take_u32};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// What a section holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SectionKind {
    /// Layout of the file, and the bytes before and after the records.
    File,
    /// Which columns of the range image are used.
    Columns,
    /// Which cells of the range image hold a point.
    Occupancy,
    /// Ranges.
    Range,
    /// What rounding leaves between the model's coordinates and the file's.
    Correction,
    /// Intensities.
    Intensity,
    /// Where the points' order differs from the canonical one.
    Order,
    /// Points that no model explains, as they come.
    Points,
    /// Fields other than position and intensity.
    Channels,
    /// How the frame is coded; the first of all.
    Parameters,
    /// The contour map: which region each return belongs to.
    Contour,
    /// The models of the regions.
    Regions,
    /// What prediction leaves of the ranges, coded by a general-purpose back-end.
    Residual,
    /// How the points were moved after they were measured; left out if they were not.
    Compensation,
    /// The file as it is, through a general-purpose coder: then nothing else is there but parameters.
    Bytes,
    /// Something that this program does not know, of this number, but may leave aside.
    Skippable(u8),
}

impl SectionKind {
    /// All kinds that this program knows, in the order of their numbers, the first of which is 1.
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
            SectionKind::Skippable(_) => "skippable",
        }
    }

    /// The number in the stream.
    pub fn number(self) -> u8 {
        match self {
            SectionKind::Skippable(number) => number,
            known => 1 + Self::ALL.iter().take_while(|kind| **kind != known).count() as u8,
        }
    }

    /// The kind with this number, if there is one.
    pub fn from_number(number: u8) -> Option<Self> {
        match number {
            SKIPPABLE.. => Some(SectionKind::Skippable(number)),
            _ => Self::ALL.get(usize::from(number).checked_sub(1)?).copied(),
        }
    }

    /// Whether a decoder leaves the section aside.
    pub fn is_skippable(self) -> bool {
        matches!(self, SectionKind::Skippable(_))
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
        out.push(self.kind.number());
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
        for kind in SectionKind::ALL.into_iter().chain([128, 255].map(SectionKind::Skippable)) {
            let section = Section { kind, payload: vec![kind.number(); 200] };
            let mut bytes = Vec::new();
            section.write_to(&mut bytes);
            bytes.extend_from_slice(b"next");
            let mut input = &bytes[..];
            assert_eq!(SectionKind::from_number(bytes[0]), Some(kind));
            assert_eq!(Section::read_from(&mut input).unwrap(), section);
            assert_eq!(input, b"next");
        }
    }

    #[test]
    fn an_unknown_kind_is_named() {
        assert_eq!([0, 16, 77, 127].map(SectionKind::from_number), [None; 4]);
        let mut bytes = vec![77, 1, 42];
        let crc = crc32c::crc32c(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
        let error = Section::read_from(&mut &bytes[..]).unwrap_err();
        assert!(matches!(error, Error::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("unknown kind 77"), "{error}");
    }
}
