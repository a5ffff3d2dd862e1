//! Distinguishes the groups of a stream from others of the same length.

use crate::container::{CodedFrame, Group};

/// A checksum over the checksums of everything in the groups. A CRC over the bytes of the stream would be
/// useless: each section ends in its own CRC-32C, and a CRC over such bytes depends on their length alone.
pub fn fingerprint<'g>(groups: impl IntoIterator<Item = &'g Group>) -> u32 {
    let mut parts = Vec::new();
    for group in groups {
        let names = group.scanners.iter().map(|scanner| scanner.map_or(0, |id| u64::from(id.0) + 1));
        parts.extend(names.flat_map(u64::to_le_bytes));
        for CodedFrame { header, sections } in &group.frames {
            CodedFrame { header: header.clone(), sections: Vec::new() }.write_to(&mut parts);
            for section in sections {
                parts.push(section.kind.number());
                parts.extend(crc32c::crc32c(&section.payload).to_le_bytes());
            }
        }
    }
    crc32c::crc32c(&parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::{FrameHeader, ScannerId, Section, SectionKind};

    #[test]
    fn groups_of_the_same_length_differ() {
        let scanner = Some(ScannerId(7));
        let group = |name: &str, byte, kind, scanner| {
            let sections = vec![Section { kind, payload: vec![byte; 9] }];
            Group {
                scanners: vec![scanner],
                frames: vec![CodedFrame { header: FrameHeader::of(name, b"", 0), sections }],
            }
        };
        let groups = [
            group("1", 1, SectionKind::Range, scanner),
            group("2", 1, SectionKind::Range, scanner),
            group("1", 2, SectionKind::Range, scanner),
            group("1", 1, SectionKind::Strays, scanner),
            group("1", 1, SectionKind::Range, None),
        ];
        for (place, one) in groups.iter().enumerate() {
            let same = groups.iter().filter(|other| fingerprint([*other]) == fingerprint([one])).count();
            assert_eq!(same, 1, "{place}");
        }
    }
}
