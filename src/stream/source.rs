//! The groups of a stream that hold the requested frames, each with its scanners: as they arrive, or by the
//! index.

use std::io::{Read, Seek};
use std::sync::Arc;

use super::options::FrameRange;
use crate::container::{
    Group, GroupEntry, Index, IndexedReader, Record, ScannerId, ScannerRecord, StreamReader,
};
use crate::ground::error::{Error, Result};
use crate::scanner::Scanner;

/// A group, with everything needed to decode or copy it.
pub struct GroupJob {
    /// Number of its first frame in the sequence.
    pub first_frame: u64,
    /// The scanner of each track of the group, if it has one.
    pub scanners: Vec<Option<Arc<StoredScanner>>>,
    pub group: Group,
}

impl GroupJob {
    /// The scanner of each track, if it has one.
    ///
    /// # Errors
    /// If one is of a family that this program does not know.
    pub fn known_scanners(&self) -> Result<Vec<Option<&Scanner>>> {
        let stored = self.scanners.iter();
        stored.map(|stored| stored.as_deref().map(StoredScanner::known).transpose()).collect()
    }
}

/// A scanner, and its record.
pub struct StoredScanner {
    /// None if the family is unknown. Groups with such a scanner can still be copied.
    scanner: Option<Scanner>,
    pub record: ScannerRecord,
}

impl StoredScanner {
    pub(crate) fn parse(record: ScannerRecord) -> Result<Arc<Self>> {
        let scanner =
            Scanner::from_record(record.family, &record.payload).map_err(|e| e.within("scanner"))?;
        Ok(Arc::new(StoredScanner { scanner, record }))
    }

    /// A description of the scanner, in words.
    pub fn description(&self) -> String {
        let unknown = || format!("of family {}", self.record.family);
        self.scanner.as_ref().map_or_else(unknown, ToString::to_string)
    }

    fn known(&self) -> Result<&Scanner> {
        let unknown = || Error::unsupported(format!("a scanner of unknown family {}", self.record.family));
        self.scanner.as_ref().ok_or_else(unknown)
    }
}

/// The record of a scanner.
pub(crate) fn record_of(scanner: &Scanner) -> ScannerRecord {
    ScannerRecord { family: scanner.family_number(), payload: scanner.to_payload() }
}

/// The error about a group whose scanner is missing.
pub(crate) fn missing(scanner: ScannerId) -> Error {
    Error::corrupt(format!("scanner {scanner} is lost"))
}

/// Number of scanners that are kept between groups. If a stream alternates between more, they are read
/// repeatedly.
const KEPT_SCANNERS: usize = 16;

/// The scanners of a stream that the latest groups used, the most recent first.
#[derive(Clone, Default)]
pub(crate) struct UsedScanners(Vec<(ScannerId, Arc<StoredScanner>)>);

impl UsedScanners {
    /// The scanners of a group's tracks; `read` reads those that are not kept.
    pub fn of_group(
        &mut self,
        group: &Group,
        mut read: impl FnMut(ScannerId) -> Result<ScannerRecord>,
    ) -> Result<Vec<Option<Arc<StoredScanner>>>> {
        let mut scanner = |id: ScannerId| -> Result<_> {
            let scanner = match self.0.iter().position(|(known, _)| *known == id) {
                Some(place) => self.0.remove(place).1,
                None => StoredScanner::parse(read(id)?)?,
            };
            self.0.insert(0, (id, Arc::clone(&scanner)));
            self.0.truncate(KEPT_SCANNERS);
            Ok(scanner)
        };
        group.scanners.iter().map(|id| id.map(&mut scanner).transpose()).collect()
    }
}

/// The groups of a stream as they arrive.
pub struct StreamedGroups<R> {
    reader: StreamReader<R>,
    scanners: UsedScanners,
    range: FrameRange,
}

impl<R: Read> StreamedGroups<R> {
    /// Starts with the first group.
    pub fn new(reader: StreamReader<R>, range: FrameRange) -> Self {
        StreamedGroups { reader, scanners: UsedScanners::default(), range }
    }

    /// The locations of all records so far, wanted or not; after the last group, of the whole stream.
    pub fn index(&self) -> &Index {
        self.reader.index()
    }

    fn next_job(&mut self) -> Result<Option<GroupJob>> {
        while let Some(record) = self.reader.next_record()? {
            let Record::Group(group) = record else { continue };
            let first_frame = self.index().frame_count() - group.frames.len() as u64;
            if self.range.wants(first_frame, group.frames.len() as u64, group.is_beside()) {
                let read = |id| self.reader.scanner(id).cloned().ok_or_else(|| missing(id));
                let scanners = self.scanners.of_group(&group, read)?;
                return Ok(Some(GroupJob { first_frame, scanners, group }));
            }
        }
        Ok(None)
    }
}

impl<R: Read> Iterator for StreamedGroups<R> {
    type Item = Result<GroupJob>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_job().transpose()
    }
}

/// The groups that hold the requested frames, read by means of the index.
#[derive(Clone)]
pub struct IndexedGroups<R> {
    reader: IndexedReader<R>,
    scanners: UsedScanners,
    range: FrameRange,
    /// Number of bytes of consecutive groups that are read in one request.
    at_once: u64,
    /// Index of the next group.
    place: usize,
}

impl<R: Read + Seek> IndexedGroups<R> {
    /// Starts with the first group.
    pub fn new(reader: IndexedReader<R>, range: FrameRange) -> Self {
        IndexedGroups { reader, scanners: UsedScanners::default(), range, at_once: 0, place: 0 }
    }

    /// Reads consecutive groups in one request, up to this many bytes.
    pub fn reading_at_once(self, bytes: u64) -> Self {
        IndexedGroups { at_once: bytes, ..self }
    }

    /// The locations of all records.
    pub fn index(&self) -> &Index {
        self.reader.index()
    }

    /// The scanners, in the order of their first records.
    ///
    /// # Errors
    /// If the input fails, or a record is damaged.
    pub fn read_scanners(&mut self) -> Result<Vec<Arc<StoredScanner>>> {
        let ids: Vec<_> = self.index().scanners().iter().map(|entry| entry.id).collect();
        ids.into_iter().map(|id| StoredScanner::parse(self.reader.read_scanner(id)?)).collect()
    }

    /// Continues with the groups that hold these frames, wherever they are.
    pub fn seek(&mut self, range: FrameRange) {
        let is_before = |group: &GroupEntry| group.first_frame + group.frames.len() as u64 <= range.start;
        self.place = self.index().groups.partition_point(is_before);
        self.range = range;
    }

    fn next_job(&mut self) -> Result<Option<GroupJob>> {
        while let Some(entry) = self.reader.index().groups.get(self.place) {
            let (first_frame, count) = (entry.first_frame, entry.frames.len() as u64);
            let place = self.place;
            self.place += 1;
            if self.range.wants(first_frame, count, entry.is_beside()) {
                if self.at_once > 0 {
                    let is_before_end = |group: &GroupEntry| !self.range.is_past(group.first_frame);
                    let end = self.index().groups.partition_point(is_before_end);
                    self.reader.read_ahead(place..end, self.at_once)?;
                }
                let group = self.reader.read_group(place)?;
                let scanners = self.scanners.of_group(&group, |id| self.reader.read_scanner(id))?;
                return Ok(Some(GroupJob { first_frame, scanners, group }));
            }
        }
        Ok(None)
    }
}

impl<R: Read + Seek> Iterator for IndexedGroups<R> {
    type Item = Result<GroupJob>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_job().transpose()
    }
}
