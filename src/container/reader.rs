//! Reads a stream: from front to back, or group by group through its index; then in few large pieces, since
//! each read may be a request to a server. FORMAT.md 2.

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::Arc;

use super::group::Group;
use super::header::{HEADER_LENGTH, StreamHeader};
use super::index::{End, Index};
use super::record::{END, GROUP, INDEX, RawRecord, SCANNER, read_exact, read_record};
use super::scanner::{ScannerId, ScannerRecord, ScannerRecords};
use crate::ground::SKIPPABLE;
use crate::ground::error::{Error, Limits, Result};

/// Largest gap between groups that are read in one go: another request would cost more than the gap's bytes.
const LARGEST_GAP: u64 = 1 << 16;

/// A record of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Record {
    /// A scanner that did not occur before.
    Scanner(ScannerRecord),
    /// The sequence's next group.
    Group(Group),
}

/// Reads a stream from front to back, as from a pipe. If reading reaches `None`, the stream is complete:
/// every byte was covered by a checksum, and the index agrees with the records.
pub struct StreamReader<R> {
    input: R,
    limits: Limits,
    header: StreamHeader,
    /// Number of bytes read.
    position: u64,
    /// The records read so far, to be compared with the stream's own index.
    seen: Index,
    scanners: ScannerRecords,
    /// Offset of the index record, once it was read.
    index_offset: Option<u64>,
    ended: bool,
}

impl<R: Read> StreamReader<R> {
    /// Reads the stream header.
    ///
    /// # Errors
    /// If the input fails, is no stream, is damaged, or is of another version of the format.
    pub fn open(mut input: R, limits: Limits) -> Result<Self> {
        let header = StreamHeader::read_from(&mut input)?;
        let position = HEADER_LENGTH as u64;
        Ok(StreamReader {
            input,
            limits,
            header,
            position,
            seen: Index::default(),
            scanners: ScannerRecords::default(),
            index_offset: None,
            ended: false,
        })
    }

    /// The stream header.
    pub fn header(&self) -> &StreamHeader {
        &self.header
    }

    /// Bytes read so far; after the last record, the size of the stream.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The locations of the records read so far.
    pub fn index(&self) -> &Index {
        &self.seen
    }

    /// The scanner with this checksum, if it was read.
    pub fn scanner(&self, id: ScannerId) -> Option<&ScannerRecord> {
        self.scanners.get(id)
    }

    /// The next scanner or group, or `None` after the last.
    ///
    /// # Errors
    /// If the input fails, is damaged or cut short, exceeds the limits, or holds something that only a newer
    /// program knows. After an error nothing more can be read.
    pub fn next_record(&mut self) -> Result<Option<Record>> {
        while !self.ended {
            let offset = self.position;
            let raw = read_record(&mut self.input, &self.limits)
                .map_err(|e| e.within(format!("record at byte {offset}")))?;
            self.position += raw.length;
            let part = format!("{} at byte {offset}", describe(raw.kind, &self.seen));
            if let Some(record) = self.accept(raw, offset).map_err(|e| e.within(part))? {
                return Ok(Some(record));
            }
        }
        Ok(None)
    }

    fn accept(&mut self, raw: RawRecord, offset: u64) -> Result<Option<Record>> {
        let first_frame = self.seen.frame_count();
        check_intact(&raw, &self.limits).map_err(|e| e.counted_from(first_frame))?;
        if self.index_offset.is_some() && matches!(raw.kind, SCANNER | GROUP | INDEX) {
            return Err(Error::corrupt("it comes after the index"));
        }
        match raw.kind {
            SCANNER => {
                let scanner = ScannerRecord::read_from(&raw.payload)?;
                self.seen.push_scanner(offset, ScannerId(raw.crc));
                if self.scanners.add(scanner.clone())? {
                    return Ok(Some(Record::Scanner(scanner)));
                }
            }
            GROUP => {
                let group = Group::read_from(&raw.payload, &self.limits);
                let (group, frames) = group.map_err(|e| e.counted_from(first_frame))?;
                check_reference(&group, &self.seen)?;
                self.seen.push_group(offset, raw.length, raw.crc, frames)?;
                return Ok(Some(Record::Group(group)));
            }
            INDEX => {
                if Index::read_from(&raw.payload)? != self.seen {
                    return Err(Error::corrupt("it does not agree with the records before it"));
                }
                self.index_offset = Some(offset);
            }
            END => self.accept_end(&raw)?,
            SKIPPABLE.. => {}
            kind => return Err(Error::unsupported(format!("record of unknown kind {kind}"))),
        }
        Ok(None)
    }

    fn accept_end(&mut self, raw: &RawRecord) -> Result<()> {
        let end = End::from_payload(&raw.payload)?;
        if self.index_offset != Some(end.index_offset) {
            return Err(Error::corrupt("it does not point at the index"));
        }
        check_header(&end, &self.header)?;
        if self.input.by_ref().take(1).read_to_end(&mut Vec::new())? != 0 {
            return Err(Error::corrupt("there are bytes after it"));
        }
        self.ended = true;
        Ok(())
    }
}

/// Reads single records of a seekable stream through its index: the end of the stream in one request, then
/// each group in one request.
#[derive(Clone)]
pub struct IndexedReader<R> {
    input: Pieces<R>,
    limits: Limits,
    index: Arc<Index>,
}

impl<R: Read + Seek> IndexedReader<R> {
    /// Reads the stream header, the end record and the index.
    ///
    /// # Errors
    /// As [`StreamReader::open`]; also if the end or the index is missing or damaged.
    pub fn open(input: R, limits: Limits) -> Result<Self> {
        let mut input = Pieces::open(input)?;
        let header = StreamHeader::read_from(&mut input.reader_at(0)?)?;
        IndexedReader::of_header(input, limits, header)
    }

    /// As [`open`](Self::open), but starts with the last 64 KiB, and reads the stream header only if it is
    /// among them: the end record repeats it, and this saves a request.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_at_end(input: R, limits: Limits) -> Result<Self> {
        let mut input = Pieces::open(input)?;
        if input.size() == 0 || input.is_tail(0) {
            let header = StreamHeader::read_from(&mut input.reader_at(0)?)?;
            return IndexedReader::of_header(input, limits, header);
        }
        let mut reader = IndexedReader { input, limits, index: Arc::default() };
        let index = reader.read_index(None);
        // An input without an end record may be no stream at all, or one of another version: report that
        // instead.
        let index = index.or_else(|error| {
            StreamHeader::read_from(&mut reader.input.reader_at(0)?)?;
            Err(error)
        });
        reader.index = Arc::new(index?);
        Ok(reader)
    }

    fn of_header(input: Pieces<R>, limits: Limits, header: StreamHeader) -> Result<Self> {
        let mut reader = IndexedReader { input, limits, index: Arc::default() };
        reader.index = Arc::new(reader.read_index(Some(header))?);
        Ok(reader)
    }

    /// Reads the end record and the index.
    fn read_index(&mut self, header: Option<StreamHeader>) -> Result<Index> {
        let cut_short = || Error::corrupt("it is cut short");
        let end_offset = self.input.size().checked_sub(End::RECORD_LENGTH).ok_or_else(cut_short)?;
        let end = self
            .record_at(end_offset, END)
            .and_then(|raw| End::from_payload(&raw.payload))
            .and_then(|end| match header {
                Some(header) => check_header(&end, &header).map(|()| end),
                None => end.header.check().map(|()| end),
            })
            .map_err(|e| e.within("end of the stream"))?;
        self.record_at(end.index_offset, INDEX)
            .and_then(|raw| Index::read_from(&raw.payload))
            .map_err(|e| e.within("index"))
    }

    /// The locations of all records.
    pub fn index(&self) -> &Index {
        &self.index
    }

    /// The scanner with this checksum, from the last intact copy of its record.
    ///
    /// # Errors
    /// If it is not in the index, or all copies are damaged.
    pub fn read_scanner(&mut self, id: ScannerId) -> Result<ScannerRecord> {
        let offsets = self.index.scanner(id).map_or_else(Vec::new, |entry| entry.offsets.clone());
        let mut read = Err(Error::corrupt("it is not in the index"));
        for offset in offsets.into_iter().rev() {
            read = self.record_at(offset, SCANNER).and_then(|raw| match ScannerId(raw.crc) == id {
                true => ScannerRecord::read_from(&raw.payload),
                false => Err(Error::corrupt("it is not what the index says")),
            });
            if read.is_ok() {
                break;
            }
        }
        read.map_err(|e| e.within(format!("scanner {id}")))
    }

    /// Reads consecutive groups of those with these indices in one go, up to `most` bytes in all, unless the
    /// first is already in memory. [`read_group`](Self::read_group) then takes them from memory.
    ///
    /// # Errors
    /// If the input fails.
    pub fn read_ahead(&mut self, places: Range<usize>, most: u64) -> Result<()> {
        let groups = self.index.groups.get(places).unwrap_or(&[]);
        let Some(first) = groups.first() else { return Ok(()) };
        let (start, mut end) = (first.offset, first.offset);
        for group in groups {
            let gap = group.offset.checked_sub(end);
            let reach = group.offset.checked_add(group.length);
            // Small gaps are allowed because copies of scanner records lie between groups.
            let (Some(0..=LARGEST_GAP), Some(reach)) = (gap, reach) else { break };
            if reach - start > most {
                break;
            }
            end = reach;
        }
        if end > start && !self.input.holds(start, start + first.length) {
            self.input.read_ahead(start, end)?;
        }
        Ok(())
    }

    /// The group with this index, the first being 0.
    ///
    /// # Errors
    /// If there is no such group, or if its record is damaged or contradicts the index.
    pub fn read_group(&mut self, place: usize) -> Result<Group> {
        self.try_read_group(place).map_err(|e| e.within(format!("group {place}")))
    }

    fn try_read_group(&mut self, place: usize) -> Result<Group> {
        let index = Arc::clone(&self.index);
        let entry = index.groups.get(place).ok_or_else(|| Error::corrupt("it is not in the index"))?;
        let counted = |e: Error| e.counted_from(entry.first_frame);
        // A longer one is rejected before memory is allocated for it.
        if let Some(end) = entry.offset.checked_add(entry.length)
            && entry.length <= self.limits.record_bytes
            && !self.input.holds(entry.offset, end)
        {
            self.input.read_ahead(entry.offset, end)?;
        }
        let raw = self.record_at(entry.offset, GROUP).map_err(counted)?;
        let (group, frames) = Group::read_from(&raw.payload, &self.limits).map_err(counted)?;
        if (raw.length, raw.crc, &frames) != (entry.length, entry.crc, &entry.frames) {
            return Err(Error::corrupt("it does not agree with the index"));
        }
        check_reference(&group, &self.index)?;
        self.input.used_up_to(entry.offset + entry.length);
        Ok(group)
    }

    /// Reads the record at `offset`, which must be intact and of this kind.
    fn record_at(&mut self, offset: u64, kind: u8) -> Result<RawRecord> {
        if offset >= self.input.size() {
            return Err(Error::corrupt(format!("byte {offset} is beyond the end")));
        }
        let raw = read_record(&mut self.input.reader_at(offset)?, &self.limits)?;
        if raw.kind != kind {
            return Err(Error::corrupt(format!("there is no {} record at byte {offset}", kind_name(kind))));
        }
        check_intact(&raw, &self.limits)?;
        Ok(raw)
    }
}

/// An error if the record's checksum does not match; for a group it names the damaged section.
fn check_intact(raw: &RawRecord, limits: &Limits) -> Result<()> {
    if raw.intact {
        return Ok(());
    }
    if raw.kind == GROUP
        && let Err(error @ Error::Corrupt { .. }) = Group::read_from(&raw.payload, limits)
    {
        return Err(error);
    }
    Err(Error::corrupt("checksum does not match"))
}

/// An error if the group refers to a scanner that is not in the stream.
fn check_reference(group: &Group, index: &Index) -> Result<()> {
    match group.scanners.iter().flatten().find(|id| index.scanner(**id).is_none()) {
        Some(id) => Err(Error::corrupt(format!("its scanner {id} is missing"))),
        None => Ok(()),
    }
}

/// An error if the end record does not repeat the stream header.
fn check_header(end: &End, header: &StreamHeader) -> Result<()> {
    if end.header != *header {
        return Err(Error::corrupt("it does not agree with the stream header"));
    }
    Ok(())
}

fn kind_name(kind: u8) -> &'static str {
    match kind {
        SCANNER => "scanner",
        GROUP => "group",
        INDEX => "index",
        END => "end",
        _ => "unknown",
    }
}

/// The name, in errors, of the record that follows those in `seen`.
fn describe(kind: u8, seen: &Index) -> String {
    match kind {
        SCANNER => "scanner".to_owned(),
        GROUP => format!("group {}", seen.groups.len()),
        INDEX => "index".to_owned(),
        END => "end record".to_owned(),
        _ => "record".to_owned(),
    }
}

/// Bytes that are read in one go at the end of the input: enough for the end record, the index and the last
/// copies of the scanners in a stream of some thousand frames.
const TAIL: u64 = 1 << 16;

/// A seekable input with some pieces in memory.
#[derive(Clone)]
struct Pieces<R> {
    input: R,
    size: u64,
    /// The end of the input, kept in memory throughout.
    tail: Arc<Vec<u8>>,
    /// The piece last read ahead, with its offset.
    ahead: (u64, Vec<u8>),
}

impl<R: Read + Seek> Pieces<R> {
    /// Reads the end of the input.
    ///
    /// # Errors
    /// If the input fails.
    fn open(mut input: R) -> Result<Self> {
        let size = input.seek(SeekFrom::End(0))?;
        let tail = read_piece(&mut input, size.saturating_sub(TAIL), size)?;
        Ok(Pieces { input, size, tail: Arc::new(tail), ahead: (0, Vec::new()) })
    }

    /// Size of the input in bytes.
    fn size(&self) -> u64 {
        self.size
    }

    /// Whether all bytes from this one on are in memory.
    fn is_tail(&self, offset: u64) -> bool {
        (self.size - self.tail.len() as u64..self.size).contains(&offset)
    }

    /// Whether these bytes are in memory.
    fn holds(&self, start: u64, end: u64) -> bool {
        let (first, bytes) = &self.ahead;
        self.is_tail(start) || (*first <= start && end <= first + bytes.len() as u64)
    }

    /// Reads these bytes in one go. Nothing is read if the input is shorter.
    ///
    /// # Errors
    /// If the input fails.
    fn read_ahead(&mut self, start: u64, end: u64) -> Result<()> {
        if end > self.size || start >= end {
            return Ok(());
        }
        // Free the old buffer before the new one is allocated.
        self.ahead = (0, Vec::new());
        self.ahead = (start, read_piece(&mut self.input, start, end)?);
        Ok(())
    }

    /// Frees the piece that was read ahead, if it ends at `end`.
    fn used_up_to(&mut self, end: u64) {
        if end >= self.ahead.0 + self.ahead.1.len() as u64 {
            self.ahead = (0, Vec::new());
        }
    }

    /// A reader from `offset` on. If a piece in memory contains the first byte, it must contain all bytes
    /// that will be read.
    ///
    /// # Errors
    /// If the input cannot be sought in.
    fn reader_at(&mut self, offset: u64) -> Result<Box<dyn Read + '_>> {
        let of = |first: u64, bytes: &'_ [u8]| {
            usize::try_from(offset.checked_sub(first)?).ok().filter(|place| *place < bytes.len())
        };
        let (first, ahead) = &self.ahead;
        if let Some(place) = of(*first, ahead) {
            return Ok(Box::new(&ahead[place..]));
        }
        if let Some(place) = of(self.size - self.tail.len() as u64, &self.tail) {
            return Ok(Box::new(&self.tail[place..]));
        }
        self.input.seek(SeekFrom::Start(offset))?;
        Ok(Box::new(BufReader::with_capacity(TAIL as usize, &mut self.input)))
    }
}

/// Reads these bytes, which must be within the input.
fn read_piece(input: &mut (impl Read + Seek), start: u64, end: u64) -> Result<Vec<u8>> {
    input.seek(SeekFrom::Start(start))?;
    let mut bytes = vec![0; (end - start) as usize];
    read_exact(input, &mut bytes, "the stream")?;
    Ok(bytes)
}
