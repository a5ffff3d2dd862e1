//! Reads what is intact of a damaged stream.

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;

use super::group::Group;
use super::header::{HEADER_LENGTH, StreamHeader};
use super::index::{GroupEntry, Index, read_end_payload};
use super::record::{END, GROUP, INDEX, RawRecord, SCANNER, read_record};
use super::scan::{FoundRecord, find_records};
use super::scanner::ScannerRecord;
use crate::ground::SKIPPABLE;
use crate::ground::error::{Error, Limits, Result};

/// Groups of the index among which one is looked for that is not where the index says. So many lost in a
/// row, and bytes as well, only cost the numbers of the frames after them.
const LOOK_AHEAD: usize = 1000;

/// A part of a damaged stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Salvaged {
    /// An intact scanner and its number, the first being 1.
    Scanner(u64, ScannerRecord),
    /// An intact group.
    Group {
        /// Number of its first frame in the sequence; of those that were found, if nothing tells how
        /// many were lost.
        first_frame: u64,
        /// Where its record is, in bytes from the start of the stream.
        bytes: Range<u64>,
        /// The frames.
        group: Group,
    },
    /// Bytes that are damaged, and what was lost with them.
    Lost(Lost),
}

/// What was lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// Where, in bytes from the start of the stream.
    pub bytes: Range<u64>,
    /// The numbers of the frames; `None` if nothing tells how many there were.
    pub frames: Option<Range<u64>>,
    /// Names of frames that were lost, as far as they can be read.
    pub names: Vec<String>,
    /// What is wrong.
    pub why: String,
}

/// Reads what is intact of a stream: all records whose checksum matches, wherever they are. The index tells
/// the frames' numbers, if it is intact.
pub struct SalvageReader<R> {
    input: R,
    limits: Limits,
    size: u64,
    records: Vec<FoundRecord>,
    /// The next of the records.
    next: usize,
    index: Option<Index>,
    /// The place in the index of the next group; those before were found, or are lost.
    next_entry: usize,
    /// The number of the last scanner found.
    last_scanner: u64,
    /// Where the last record ended.
    position: u64,
    next_frame: u64,
    /// Whether it is over.
    ended: bool,
}

impl<R: Read + Seek> SalvageReader<R> {
    /// Looks for the records. `is_scanner` tells whether a record is of a scanner.
    ///
    /// # Errors
    /// If the input fails, is no stream, or is of another version of the format.
    pub fn open(mut input: R, limits: Limits, is_scanner: impl Fn(&ScannerRecord) -> bool) -> Result<Self> {
        input.seek(SeekFrom::Start(0))?;
        let read = StreamHeader::read_from(&mut input);
        let start = if read.is_ok() { HEADER_LENGTH as u64 } else { 0 };
        let is_one = |raw: &RawRecord| match raw.kind {
            SCANNER => ScannerRecord::read_from(&raw.payload).is_ok_and(|record| is_scanner(&record)),
            GROUP => Group::read_from(&raw.payload, &limits).is_ok(),
            INDEX => Index::read_from(&raw.payload).is_ok(),
            END => read_end_payload(&raw.payload).is_ok(),
            _ => false,
        };
        let records = find_records(&mut input, start, &limits, is_one)?;
        match read {
            Err(Error::Corrupt { .. } | Error::BadMagic(_)) if !records.is_empty() => {}
            read => drop(read?),
        }
        let size = input.seek(SeekFrom::End(0))?;
        let mut reader = SalvageReader {
            input,
            limits,
            size,
            records,
            next: 0,
            index: None,
            next_entry: 0,
            last_scanner: 0,
            position: start,
            next_frame: 0,
            ended: false,
        };
        if let Some(found) = reader.records.iter().rfind(|record| record.kind == INDEX).copied() {
            reader.index = Index::read_from(&reader.read(found)?.payload).ok();
        }
        Ok(reader)
    }

    /// Whether an intact index tells the numbers of the frames.
    pub fn has_index(&self) -> bool {
        self.index.is_some()
    }

    /// The next part; `None` after the last.
    ///
    /// # Errors
    /// If the input fails.
    pub fn next_part(&mut self) -> Result<Option<Salvaged>> {
        while let Some(found) = self.records.get(self.next).copied() {
            let first_frame = self.first_frame(found);
            if let Some(lost) = self.lost_before(found.offset, first_frame)? {
                return Ok(Some(Salvaged::Lost(lost)));
            }
            self.next += 1;
            self.position = found.end();
            if let Some(part) = self.accept(found, first_frame)? {
                return Ok(Some(part));
            }
        }
        if self.ended {
            return Ok(None);
        }
        self.ended = true;
        let frames = self.index.as_ref().map_or(self.next_frame, Index::frame_count);
        if let Some(lost) = self.lost_before(self.size, frames)? {
            return Ok(Some(Salvaged::Lost(lost)));
        }
        if self.is_whole()? {
            return Ok(None);
        }
        let why = "the stream is cut short: its end is missing".to_owned();
        let frames = self.has_index().then_some(self.next_frame..self.next_frame);
        Ok(Some(Salvaged::Lost(Lost { bytes: self.size..self.size, frames, names: Vec::new(), why })))
    }

    /// Whether the last two records are the index and an end that points at it.
    fn is_whole(&mut self) -> Result<bool> {
        let [.., index, end] = self.records[..] else { return Ok(false) };
        if (index.kind, end.kind) != (INDEX, END) {
            return Ok(false);
        }
        let raw = self.read(end)?;
        Ok(read_end_payload(&raw.payload).is_ok_and(|offset| offset == index.offset))
    }

    /// The number of the first frame of a record that was found; of the next frame, if it has none.
    fn first_frame(&self, found: FoundRecord) -> u64 {
        let entry = self.entry_of(found).and_then(|place| Some(&self.index.as_ref()?.groups[place]));
        entry.map_or(self.next_frame, |entry: &GroupEntry| entry.first_frame)
    }

    /// A group's place in the index: where the index says, or, if bytes were lost or came in, the next of the
    /// same length.
    fn entry_of(&self, found: FoundRecord) -> Option<usize> {
        let groups = &self.index.as_ref().filter(|_| found.kind == GROUP)?.groups;
        let rest = groups.get(self.next_entry..)?;
        let at = rest.binary_search_by_key(&found.offset, |entry| entry.offset).ok();
        let at = at.filter(|at| rest[*at].length == found.length);
        let mut near = rest.iter().take(LOOK_AHEAD);
        let place = at.or_else(|| near.position(|entry| entry.length == found.length))?;
        Some(self.next_entry + place)
    }

    /// What is lost of the bytes before `offset` and the frames before `frame`, if anything is.
    fn lost_before(&mut self, offset: u64, frame: u64) -> Result<Option<Lost>> {
        self.skip_unknown(offset)?;
        // In bytes of several streams there may be more frames than the index counts.
        let (bytes, frames) = (self.position..offset, self.next_frame.min(frame)..frame);
        if bytes.is_empty() && frames.is_empty() {
            return Ok(None);
        }
        let names = self.names_in(bytes.clone())?;
        (self.position, self.next_frame) = (offset, frame);
        let frames = self.has_index().then_some(frames);
        let why = if bytes.is_empty() { "records are missing" } else { "checksums do not match" }.to_owned();
        Ok(Some(Lost { bytes, frames, names, why }))
    }

    /// Passes records that older programs may skip.
    fn skip_unknown(&mut self, offset: u64) -> Result<()> {
        while self.position < offset {
            self.input.seek(SeekFrom::Start(self.position))?;
            match read_record(&mut self.input.by_ref().take(offset - self.position), &self.limits) {
                Ok(raw) if raw.kind >= SKIPPABLE && raw.intact => self.position += raw.length,
                Err(Error::Io(error)) => return Err(error.into()),
                _ => break,
            }
        }
        Ok(())
    }

    /// The names of frames in damaged bytes, as far as their groups can be told.
    fn names_in(&mut self, bytes: Range<u64>) -> Result<Vec<String>> {
        let (mut names, mut position) = (Vec::new(), bytes.start);
        while position < bytes.end {
            self.input.seek(SeekFrom::Start(position))?;
            match read_record(&mut self.input.by_ref().take(bytes.end - position), &self.limits) {
                Ok(raw) => {
                    if raw.kind == GROUP {
                        names.extend(Group::names_in(&raw.payload));
                    }
                    position += raw.length;
                }
                Err(Error::Io(error)) => return Err(error.into()),
                Err(_) => break,
            }
        }
        Ok(names)
    }

    fn accept(&mut self, found: FoundRecord, first_frame: u64) -> Result<Option<Salvaged>> {
        match found.kind {
            SCANNER => {
                let number = self.number_of_scanner(found);
                self.last_scanner = number;
                let record = ScannerRecord::read_from(&self.read(found)?.payload)?;
                Ok(Some(Salvaged::Scanner(number, record)))
            }
            GROUP => Ok(Some(self.accept_group(found, first_frame)?)),
            _ => Ok(None),
        }
    }

    fn accept_group(&mut self, found: FoundRecord, first_frame: u64) -> Result<Salvaged> {
        if let Some(place) = self.entry_of(found) {
            self.next_entry = place + 1;
        }
        let (group, _) = Group::read_from(&self.read(found)?.payload, &self.limits)?;
        self.next_frame = first_frame + group.frames.len() as u64;
        Ok(Salvaged::Group { first_frame, bytes: found.offset..found.end(), group })
    }

    /// The number of a scanner: its place in the index, or one more than that of the last.
    fn number_of_scanner(&self, found: FoundRecord) -> u64 {
        let scanners = self.index.as_ref().map_or(&[][..], |index| &index.scanners);
        let place = scanners.iter().position(|entry| entry.offset == found.offset);
        place.map_or(self.last_scanner + 1, |place| place as u64 + 1)
    }

    fn read(&mut self, found: FoundRecord) -> Result<RawRecord> {
        self.input.seek(SeekFrom::Start(found.offset))?;
        read_record(&mut self.input, &self.limits)
    }
}
