//! Groups: frames that are coded together, independently of all others. FORMAT.md 2.4 and 2.5. Sections: the
//! parts of a frame, each with a kind and a checksum. FORMAT.md 2.6.

use super::index::FrameEntry;
use super::record::{take, take_u32};
use super::scanner::ScannerId;
use super::stamp::{FrameKind, Stamp};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};
use crate::ground::{SKIPPABLE, SectionKind};

/// The longest name of a frame, in bytes: the usual limit of paths.
pub(super) const NAME_MAX: u64 = 4095;

/// The largest number of tracks in a group.
pub const TRACKS_MAX: u64 = 255;

/// Properties of the decoded file, readable without decoding the frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameHeader {
    /// The file's name, possibly a path with `/` as separator. It comes from the stream: check it before use
    /// as a path.
    pub name: String,
    /// Kind, track and time.
    pub stamp: Stamp,
    /// Bytes of the decoded file.
    pub file_size: u64,
    /// CRC32C of the decoded file's bytes.
    pub file_crc: u32,
    /// Points (records) in the file.
    pub point_count: u64,
}

impl FrameHeader {
    /// The header for a file with these bytes.
    pub fn of(name: &str, bytes: &[u8], point_count: u64) -> Self {
        FrameHeader {
            name: name.to_owned(),
            stamp: Stamp::default(),
            file_size: bytes.len() as u64,
            file_crc: crc32c::crc32c(bytes),
            point_count,
        }
    }

    /// Whether the name is that of a file. Messages have none; points in memory need none, or have that of a folder
    /// for all of their source.
    pub fn names_file(&self) -> bool {
        let names_folder = self.stamp.kind == FrameKind::Points && self.name.ends_with('/');
        !self.name.is_empty() && !names_folder
    }

    /// Appends the header.
    fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.name.len() as u64);
        out.extend_from_slice(self.name.as_bytes());
        self.stamp.write_to(out);
        write_unsigned(out, self.file_size);
        out.extend_from_slice(&self.file_crc.to_le_bytes());
        write_unsigned(out, self.point_count);
    }

    /// Takes a header off the front of `input`. Its values are not checked against any limits.
    fn read_from(input: &mut &[u8]) -> Result<Self> {
        let name_length = read_unsigned(input, "frame name's length")?;
        if name_length > NAME_MAX {
            return Err(Error::corrupt(format!("frame name of {name_length} bytes")));
        }
        let name = take(input, name_length, "frame name")?;
        let name = str::from_utf8(name).map_err(|_| Error::corrupt("frame name is not UTF-8"))?;
        Ok(FrameHeader {
            name: name.to_owned(),
            stamp: Stamp::read_from(input)?,
            file_size: read_unsigned(input, "file size")?,
            file_crc: take_u32(input, "file checksum")?,
            point_count: read_unsigned(input, "point count")?,
        })
    }
}

/// One coded frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CodedFrame {
    /// The frame header.
    pub header: FrameHeader,
    /// The coded sections.
    pub sections: Vec<Section>,
}

impl CodedFrame {
    /// Appends the frame header and the sections.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        self.header.write_to(out);
        write_unsigned(out, self.sections.len() as u64);
        for section in &self.sections {
            section.write_to(out);
        }
    }

    /// Takes a frame off the front of `input`.
    ///
    /// # Errors
    /// If it is damaged, asks for more than `limits` allow, or holds an unknown section.
    pub fn read_from(input: &mut &[u8], limits: &Limits) -> Result<Self> {
        let header = FrameHeader::read_from(input)?;
        Error::check_limit("file size in bytes", header.file_size, limits.file_bytes)?;
        Error::check_limit("points in a frame", header.point_count, limits.points)?;
        let section_count = read_unsigned(input, "section count")?;
        let mut sections = Vec::new();
        for _ in 0..section_count {
            let section = Section::read_from(input);
            sections.push(section.map_err(|e| e.within(format!("{:?}", header.name)))?);
        }
        let allowed = allowance(&sections);
        if header.file_size > allowed || header.point_count > allowed {
            let FrameHeader { name, file_size, point_count, .. } = &header;
            let what = format!(
                "{name:?}: {file_size} bytes, {point_count} points of so short a frame, which may have {allowed}"
            );
            return Err(Error::corrupt(what));
        }
        Ok(CodedFrame { header, sections })
    }
}

/// Decoded bytes that every frame is allowed, however short it is.
const FREE: u64 = 1 << 16;

/// Decoded bytes that are allowed for each byte of the sections.
const UNFOLDED_BYTES: u64 = 1024;

/// The kind of sections whose only purpose is to make a frame long enough for its file.
const PADDING: SectionKind = SectionKind::Skippable(SKIPPABLE);

/// The largest decoded size, in bytes, of a frame with these sections; also the limit for its records and for
/// the cells of its range image. It bounds the time and memory that a short stream can demand. FORMAT.md 2.5.
pub fn allowance(sections: &[Section]) -> u64 {
    let bytes = payload_bytes(sections) as u64;
    FREE.saturating_add(bytes.saturating_mul(UNFOLDED_BYTES))
}

/// Pads the sections of a frame until they are allowed to decode to `unfolded` bytes. Only extremely
/// repetitive files need it.
pub fn pay_for(sections: &mut Vec<Section>, unfolded: u64) {
    let missing = unfolded.saturating_sub(allowance(sections)).div_ceil(UNFOLDED_BYTES);
    if missing > 0 {
        sections.push(Section { kind: PADDING, payload: vec![0; missing as usize] });
    }
}

/// Frames that are coded together. State is shared among the frames of a track only. A group does not store
/// its position in the sequence, and refers to scanners by checksum, so that groups can be cut and joined
/// without being re-encoded.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Group {
    /// The scanner of each of the 1 to 255 tracks, if the track has one.
    pub scanners: Vec<Option<ScannerId>>,
    /// The frames of all tracks, in order.
    pub frames: Vec<CodedFrame>,
}

impl Group {
    /// Appends the group; returns the index entries of its frames.
    pub fn write_to(&self, out: &mut Vec<u8>) -> Vec<FrameEntry> {
        write_unsigned(out, self.scanners.len() as u64);
        self.scanners.iter().for_each(|scanner| ScannerId::write_to(*scanner, out));
        write_unsigned(out, self.frames.len() as u64);
        let mut entries = Vec::with_capacity(self.frames.len());
        for frame in &self.frames {
            let start = out.len();
            frame.write_to(out);
            entries.push(FrameEntry { size: (out.len() - start) as u64, stamp: frame.header.stamp });
        }
        entries
    }

    /// Whether the group holds files beside the scans.
    pub fn is_beside(&self) -> bool {
        self.frames.first().is_some_and(|frame| frame.header.stamp.kind == FrameKind::Beside)
    }

    /// The names of the frames in the payload of a damaged group record, as far as they can be read. They
    /// may be wrong.
    pub fn names_in(mut payload: &[u8]) -> Vec<String> {
        let input = &mut payload;
        let mut names = Vec::new();
        let count = read_scanners(input).and_then(|_| read_unsigned(input, "frame count"));
        for _ in 0..count.unwrap_or_default() {
            match skim_frame(input) {
                Ok(name) => names.push(name),
                Err(_) => break,
            }
        }
        names
    }

    /// Reads the payload of a group record; also returns the entries that the index must have for its frames.
    ///
    /// # Errors
    /// As [`CodedFrame::read_from`]; also if a frame names a track that the group does not have, if bytes are
    /// left over, or if the files of the group together exceed `limits.file_bytes` (all may be in memory at
    /// once).
    pub fn read_from(mut input: &[u8], limits: &Limits) -> Result<(Self, Vec<FrameEntry>)> {
        let input = &mut input;
        let mut group = Group { scanners: read_scanners(input)?, frames: Vec::new() };
        let frame_count = read_unsigned(input, "frame count")?;
        let (mut entries, mut file_bytes) = (Vec::new(), 0);
        for number in 0..frame_count {
            let entry = group.read_frame(input, limits, &mut file_bytes);
            entries.push(entry.map_err(|e| e.within_frame_of_group(number))?);
        }
        if !input.is_empty() {
            return Err(Error::corrupt(format!("{} bytes left over after the last frame", input.len())));
        }
        Ok((group, entries))
    }

    /// Reads the next frame, and returns the entry that the index must have for it. `file_bytes`: those of
    /// all files so far.
    fn read_frame(&mut self, input: &mut &[u8], limits: &Limits, file_bytes: &mut u64) -> Result<FrameEntry> {
        let before = input.len();
        let frame = CodedFrame::read_from(input, limits)?;
        let stamp = frame.header.stamp;
        if usize::from(stamp.track) >= self.scanners.len() {
            return Err(Error::corrupt(format!("track {} of {}", stamp.track, self.scanners.len())));
        }
        let is_beside = stamp.kind == FrameKind::Beside;
        if !self.frames.is_empty() && self.is_beside() != is_beside {
            return Err(Error::corrupt("a file beside the scans, in a group with scans"));
        }
        *file_bytes = file_bytes.saturating_add(frame.header.file_size);
        Error::check_limit("bytes of a group's files", *file_bytes, limits.file_bytes)?;
        self.frames.push(frame);
        Ok(FrameEntry { size: (before - input.len()) as u64, stamp })
    }

    /// Reads the frames before the first one that is damaged, from the payload of a damaged group record
    /// whose frames are known from the index; also returns the number of bytes that are left. A prefix of a
    /// group is a group, too. `None` if there are no such frames, or if no frame shows the damage: then a
    /// name may be wrong.
    pub(super) fn read_prefix(
        payload: &[u8],
        entries: &[FrameEntry],
        limits: &Limits,
    ) -> Option<(Self, u64)> {
        let input = &mut &*payload;
        let mut group = Group { scanners: read_scanners(input).ok()?, frames: Vec::new() };
        let frame_count = read_unsigned(input, "frame count").ok()?;
        let (mut left, mut file_bytes) = (input.len(), 0);
        for entry in entries {
            let before = group.frames.len();
            if group.read_frame(input, limits, &mut file_bytes).ok() != Some(*entry) {
                group.frames.truncate(before);
                break;
            }
            left = input.len();
        }
        let is_part = (1..entries.len()).contains(&group.frames.len());
        (is_part && frame_count == entries.len() as u64).then_some((group, left as u64))
    }
}

/// Takes the scanners of a group's tracks off the front of `input`.
fn read_scanners(input: &mut &[u8]) -> Result<Vec<Option<ScannerId>>> {
    match read_unsigned(input, "scanner count")? {
        count @ 1..=TRACKS_MAX => (0..count).map(|_| ScannerId::read_from(input)).collect(),
        count => Err(Error::corrupt(format!("a group of {count} tracks"))),
    }
}

/// Takes a frame off the front of `input` without verifying its checksums; returns its name.
fn skim_frame(input: &mut &[u8]) -> Result<String> {
    let header = FrameHeader::read_from(input)?;
    for _ in 0..read_unsigned(input, "section count")? {
        take(input, 1, "section kind")?;
        let length = read_unsigned(input, "section length")?;
        take(input, length, "section")?;
        take_u32(input, "section checksum")?;
    }
    Ok(header.name)
}

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
