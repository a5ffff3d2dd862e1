//! Reads the intact parts of a damaged stream.

use std::collections::{HashMap, VecDeque};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;

use super::group::Group;
use super::header::{HEADER_LENGTH, StreamHeader};
use super::index::{End, Index};
use super::record::{CHECKSUM_LENGTH, END, GROUP, INDEX, RawRecord, SCANNER, read_record};
use super::scanner::{ScannerId, ScannerRecord, ScannerRecords};
use super::search::{FoundRecord, find_records};
use crate::ground::SKIPPABLE;
use crate::ground::error::{Error, Limits, Result};

/// A part of a damaged stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Salvaged {
    /// An intact group, or the frames of a damaged one that come before the damage.
    Group {
        /// Number of its first frame in the sequence; counted among the frames found, if the number of lost
        /// frames is unknown.
        first_frame: u64,
        /// The bytes of its record, as far as it is intact, counted from the start of the stream.
        bytes: Range<u64>,
        /// The frames.
        group: Group,
    },
    /// Damaged bytes, and what was lost with them.
    Lost(Lost),
}

/// A damaged part of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// The damaged bytes, counted from the start of the stream.
    pub bytes: Range<u64>,
    /// The numbers of the lost frames; `None` if it is unknown how many there were.
    pub frames: Option<Range<u64>>,
    /// Names of lost frames, as far as they can be read.
    pub names: Vec<String>,
    /// What is wrong.
    pub why: String,
}

/// Reads the intact parts of a stream: all records whose checksum matches, wherever they are, and of groups
/// whose checksum does not match, but which are where the index says, the frames before the damage. One
/// intact copy of a scanner is enough, before or after the groups that use it. The numbers of the frames come
/// from the index, if it is intact; so does the order of the groups. Records in another order than the index
/// lists are reported as a loss of zero frames, because a sequential decoder rejects them.
pub struct SalvageReader<R> {
    input: R,
    limits: Limits,
    size: u64,
    records: Vec<FoundRecord>,
    /// Index of the next record in the list.
    next: usize,
    scanners: ScannerRecords,
    index: Option<Index>,
    /// By the offset of each record that is a group: the group that is returned in its turn, and the place of
    /// that in the stream's index, if it has one.
    groups: HashMap<u64, (FoundRecord, Option<usize>)>,
    /// The places in the index of the groups that were not found, by offset, without those that were searched
    /// for frames.
    missing: VecDeque<usize>,
    /// The end of the last of these that was.
    searched: u64,
    /// The damaged group whose first frames were the last part: where it starts, and how many they are.
    begun: Option<(u64, usize)>,
    /// The locations of the records so far, to be compared with the stream's own index.
    seen: Index,
    /// Offset of the first group that comes before its scanner, or after groups that it must precede.
    misplaced: Option<u64>,
    /// Whether there was a loss.
    has_lost: bool,
    /// Offset at which the last record ended.
    position: u64,
    next_frame: u64,
    /// Whether the last part was returned.
    ended: bool,
}

impl<R: Read + Seek> SalvageReader<R> {
    /// Searches the stream for records, and reads those that the groups need.
    ///
    /// # Errors
    /// If the input fails, is not a stream, or has another version of the format.
    pub fn open(mut input: R, limits: Limits) -> Result<Self> {
        input.seek(SeekFrom::Start(0))?;
        let header = StreamHeader::read_from(&mut input);
        let start = if header.is_ok() { HEADER_LENGTH as u64 } else { 0 };
        let is_one = |raw: &RawRecord| match raw.kind {
            SCANNER => ScannerRecord::read_from(&raw.payload).is_ok(),
            GROUP => Group::read_from(&raw.payload, &limits).is_ok(),
            INDEX => Index::read_from(&raw.payload).is_ok(),
            END => End::from_payload(&raw.payload).is_ok(),
            _ => false,
        };
        let records = find_records(&mut input, start, &limits, is_one)?;
        let size = input.seek(SeekFrom::End(0))?;
        let mut reader = SalvageReader {
            input,
            limits,
            size,
            records,
            next: 0,
            scanners: ScannerRecords::default(),
            index: None,
            groups: HashMap::new(),
            missing: VecDeque::new(),
            searched: 0,
            begun: None,
            seen: Index::default(),
            misplaced: None,
            has_lost: false,
            position: start,
            next_frame: 0,
            ended: false,
        };
        match header {
            Err(Error::Corrupt { .. } | Error::BadMagic(_)) if !reader.records.is_empty() => {
                reader.check_version()?;
            }
            header => drop(header?),
        }
        reader.read_index()?;
        reader.read_scanners()?;
        Ok(reader)
    }

    /// An error if the end record says that the stream has another version. If that is lost as well, the
    /// records are read as if they were of this version: frames that do not decode to the encoded files are
    /// rejected anyway.
    fn check_version(&mut self) -> Result<()> {
        let Some(end) = self.records.iter().rfind(|record| record.kind == END).copied() else {
            return Ok(());
        };
        End::from_payload(&self.read(end)?.payload)?.header.check()
    }

    fn read_index(&mut self) -> Result<()> {
        if let Some(found) = self.records.iter().rfind(|record| record.kind == INDEX).copied() {
            self.index = Some(Index::read_from(&self.read(found)?.payload)?);
        }
        // The places of groups in the index that were not found yet, by checksum, the last first.
        let mut places: HashMap<u32, Vec<usize>> = HashMap::new();
        let entries = self.index.as_ref().map_or(&[][..], |index| &index.groups);
        for (place, group) in entries.iter().enumerate().rev() {
            places.entry(group.crc).or_default().push(place);
        }
        let groups = self.records.iter().filter(|record| record.kind == GROUP);
        let mut found: Vec<_> =
            groups.map(|group| (*group, places.get_mut(&group.crc).and_then(Vec::pop))).collect();
        let mut missing: Vec<usize> = places.into_values().flatten().collect();
        missing.sort_unstable_by_key(|place| (entries[*place].offset, *place));
        self.missing = missing.into();
        // Groups that swapped their positions swap back; those that the index does not know keep theirs.
        let mut ordered: Vec<_> = found.iter().filter(|(_, place)| place.is_some()).copied().collect();
        ordered.sort_by_key(|(_, place)| *place);
        let turns: Vec<u64> = found.iter().map(|(group, _)| group.offset).collect();
        let known = found.iter_mut().filter(|(_, place)| place.is_some());
        known.zip(ordered).for_each(|(turn, group)| *turn = group);
        self.groups = turns.into_iter().zip(found).collect();
        Ok(())
    }

    fn read_scanners(&mut self) -> Result<()> {
        for place in 0..self.records.len() {
            let found = self.records[place];
            if found.kind == SCANNER && self.scanners.get(ScannerId(found.crc)).is_none() {
                let scanner = ScannerRecord::read_from(&self.read(found)?.payload)?;
                self.scanners.add(scanner)?;
            }
        }
        Ok(())
    }

    /// The scanner with this checksum, if a copy of it is intact.
    pub fn scanner(&self, id: ScannerId) -> Option<&ScannerRecord> {
        self.scanners.get(id)
    }

    /// The index that gives the numbers of the frames, if it is intact.
    pub fn index(&self) -> Option<&Index> {
        self.index.as_ref()
    }

    /// The next part; `None` after the last.
    ///
    /// # Errors
    /// If the input fails.
    pub fn next_part(&mut self) -> Result<Option<Salvaged>> {
        while let Some(found) = self.records.get(self.next).copied() {
            let (group, place) = self.groups.get(&found.offset).copied().unwrap_or((found, None));
            let first_frame = match (&self.index, place) {
                (Some(index), Some(place)) => index.groups[place].first_frame,
                _ => self.next_frame,
            };
            if let Some(part) = self.part_before(found.offset, first_frame)? {
                return Ok(Some(part));
            }
            self.next += 1;
            self.position = found.end();
            match found.kind {
                GROUP => return self.read_group(group, first_frame).map(Some),
                SCANNER => self.seen.push_scanner(found.offset, ScannerId(found.crc)),
                _ => {}
            }
        }
        if self.ended {
            return Ok(None);
        }
        let frames = self.index.as_ref().map_or(self.next_frame, Index::frame_count);
        if let Some(part) = self.part_before(self.size, frames)? {
            self.ended = self.position == self.size;
            return Ok(Some(part));
        }
        self.ended = true;
        let Some((offset, why)) = self.fault_of_order()? else { return Ok(None) };
        let frames = self.index.is_some().then_some(self.next_frame..self.next_frame);
        let lost = Lost { bytes: offset..offset, frames, names: Vec::new(), why: why.to_owned() };
        Ok(Some(Salvaged::Lost(lost)))
    }

    /// The next part in the bytes before `offset`, where no record is intact, and the frames before `frame`.
    /// Before a record that is no group, which does not tell the number of a frame, there may be more.
    fn part_before(&mut self, offset: u64, mut frame: u64) -> Result<Option<Salvaged>> {
        while let (Some(index), Some(&place)) = (&self.index, self.missing.front()) {
            let entry = &index.groups[place];
            let (start, first_frame, end_frame) = (entry.offset, entry.first_frame, entry.end());
            if start >= offset {
                break;
            }
            // In an index that is right, groups do not overlap.
            let is_next = start >= self.position.max(self.searched);
            let end = start.saturating_add(entry.length);
            if is_next && let Some((group, left)) = self.prefix_of(place)? {
                if let Some(lost) = self.lost_before(start, first_frame)? {
                    return Ok(Some(lost));
                }
                let (bytes, frames) = (start..end - CHECKSUM_LENGTH - left, group.frames.len());
                self.begun = Some((start, frames));
                (self.position, self.next_frame) = (bytes.end, first_frame + frames as u64);
                return Ok(Some(Salvaged::Group { first_frame, bytes, group }));
            }
            let is_here = start >= self.position || self.begun.is_some_and(|(begun, _)| begun == start);
            if is_here && first_frame <= frame {
                frame = frame.max(end_frame);
            }
            self.missing.pop_front();
            self.searched = self.searched.max(end);
        }
        self.lost_before(offset, frame)
    }

    /// The frames before the damage of the group that the index has in this place, and the number of bytes
    /// after them.
    fn prefix_of(&mut self, place: usize) -> Result<Option<(Group, u64)>> {
        let Some(entry) = self.index.as_ref().map(|index| &index.groups[place]) else { return Ok(None) };
        self.input.seek(SeekFrom::Start(entry.offset))?;
        match read_record(&mut self.input.by_ref().take(entry.length), &self.limits) {
            Ok(raw) if (raw.kind, raw.length) == (GROUP, entry.length) => {
                Ok(Group::read_prefix(&raw.payload, &entry.frames, &self.limits))
            }
            Err(Error::Io(error)) => Err(error.into()),
            _ => Ok(None),
        }
    }

    fn read_group(&mut self, found: FoundRecord, first_frame: u64) -> Result<Salvaged> {
        let (group, frames) = Group::read_from(&self.read(found)?.payload, &self.limits)?;
        self.next_frame = first_frame + group.frames.len() as u64;
        let has_scanners = group.scanners.iter().flatten().all(|id| self.seen.scanner(*id).is_some());
        let is_in_order = self.seen.push_group(found.offset, found.length, found.crc, frames).is_ok();
        if !has_scanners || !is_in_order {
            self.misplaced.get_or_insert(found.offset);
        }
        Ok(Salvaged::Group { first_frame, bytes: found.offset..found.end(), group })
    }

    /// What is wrong with the order of the records, and where, although no byte of them is damaged. After a
    /// loss, that the records do not agree with the index says nothing new.
    fn fault_of_order(&mut self) -> Result<Option<(u64, &'static str)>> {
        let end = match self.records[..] {
            [.., index, end] if (index.kind, end.kind) == (INDEX, END) => Some((index, end)),
            _ => None,
        };
        let points_at_index = |(index, end): (FoundRecord, FoundRecord)| {
            let end = End::from_payload(&self.read(end)?.payload)?;
            Ok::<_, Error>((end.index_offset == index.offset).then_some(index))
        };
        let Some(index) = end.map(points_at_index).transpose()?.flatten() else {
            return Ok(Some((
                self.size,
                "the stream does not end in its index and end: it is cut short, or records were moved",
            )));
        };
        if self.has_lost {
            return Ok(None);
        }
        if let Some(offset) = self.misplaced {
            return Ok(Some((offset, "a group comes before its scanner, or after files beside the scans")));
        }
        let has_other_ends =
            self.records.iter().filter(|record| matches!(record.kind, INDEX | END)).count() > 2;
        if has_other_ends || self.index.as_ref() != Some(&self.seen) {
            return Ok(Some((index.offset, "the index does not agree with the records before it")));
        }
        Ok(None)
    }

    /// The loss in the bytes before `offset` and the frames before `frame`, if there is any.
    fn lost_before(&mut self, offset: u64, frame: u64) -> Result<Option<Salvaged>> {
        self.skip_unknown(offset)?;
        // If the bytes come from several streams, there may be more frames than the index counts.
        let (bytes, frames) = (self.position..offset, self.next_frame.min(frame)..frame);
        if bytes.is_empty() && frames.is_empty() {
            return Ok(None);
        }
        let (start, known) = self.begun.take().unwrap_or((bytes.start, 0));
        let names = self.names_in(start..offset)?.into_iter().skip(known).collect();
        (self.position, self.next_frame) = (offset, frame);
        let frames = self.index.is_some().then_some(frames);
        let why = self.fault_of(&bytes)?;
        self.has_lost = true;
        Ok(Some(Salvaged::Lost(Lost { bytes, frames, names, why })))
    }

    /// What is wrong with bytes that are lost: damage or, if they are whole, that they hold more than is allowed.
    fn fault_of(&mut self, bytes: &Range<u64>) -> Result<String> {
        if bytes.is_empty() {
            return Ok("records are missing".to_owned());
        }
        self.input.seek(SeekFrom::Start(bytes.start))?;
        let length = bytes.end - bytes.start;
        let raw = read_record(&mut self.input.by_ref().take(length), &self.limits);
        let error = match raw {
            Ok(raw) if raw.intact && raw.kind == GROUP => Group::read_from(&raw.payload, &self.limits).err(),
            // A length that the bytes do not have is damaged.
            Err(Error::LimitExceeded { got, .. }) if got > length => None,
            other => other.err(),
        };
        match error {
            Some(error @ Error::LimitExceeded { .. }) => Ok(error.to_string()),
            Some(Error::Io(error)) => Err(error.into()),
            _ => Ok("checksums do not match".to_owned()),
        }
    }

    /// Skips records that older programs may skip.
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

    /// The names of frames in damaged bytes, as far as groups can be recognised in them.
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

    fn read(&mut self, found: FoundRecord) -> Result<RawRecord> {
        self.input.seek(SeekFrom::Start(found.offset))?;
        read_record(&mut self.input, &self.limits)
    }
}
