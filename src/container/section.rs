//! Sections: the parts of a frame, each with a kind and a checksum. FORMAT.md 2.6.

use super::wire::{take, take_u32};
use crate::ground::SectionKind;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// One section of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    /// The kind: what the payload holds.
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
        let kind = SectionKind::from_number(number);
        let name = kind.map_or("unknown", SectionKind::name);
        let here = |error: Error| kind.into_iter().fold(error, Error::within_section);
        let length = read_unsigned(input, &format!("length of section {number} ({name})")).map_err(here)?;
        let payload = take(input, length, &format!("section {number} ({name})")).map_err(here)?;
        let crc = crc32c::crc32c(&start[..start.len() - input.len()]);
        if crc != take_u32(input, &format!("checksum of section {number} ({name})")).map_err(here)? {
            return Err(here(Error::corrupt(format!("section {number} ({name}): checksum does not match"))));
        }
        let kind = kind.ok_or_else(|| Error::unsupported(format!("section of unknown kind {number}")))?;
        Ok(Section { kind, payload: payload.to_vec() })
    }
}

/// Bytes of the payloads of sections.
pub fn payload_bytes<'s>(sections: impl IntoIterator<Item = &'s Section>) -> usize {
    sections.into_iter().map(|section| section.payload.len()).sum()
}

/// Bytes of the payloads of the sections of this kind.
pub fn payload_bytes_of(sections: &[Section], kind: SectionKind) -> usize {
    payload_bytes(sections.iter().filter(|section| section.kind == kind))
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
        assert_eq!([0, 21, 77, 127].map(SectionKind::from_number), [None; 4]);
        let mut bytes = vec![77, 1, 42];
        let crc = crc32c::crc32c(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
        let error = Section::read_from(&mut &bytes[..]).unwrap_err();
        assert!(matches!(error, Error::Unsupported { .. }), "{error}");
        assert!(error.to_string().contains("unknown kind 77"), "{error}");
    }
}
