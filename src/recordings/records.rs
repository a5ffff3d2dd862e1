//! The records of an MCAP recording: read one after another, and written with chunks and indexes.

use std::collections::{HashMap, HashSet};
use std::fmt::Display;
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom, Write};
use std::ops::Range;

use byteorder::{ByteOrder, LittleEndian};
use crc32fast::Hasher;
use mcap::records::{Channel, Footer, Header, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, McapError, WriteOptions, Writer};

use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::saturated;

/// The first number of records that the format leaves to applications.
const FIRST_PRIVATE: u8 = 0x80;

/// The faults of a recording that were found while it was read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The first one, in words.
    first: Option<String>,
    /// Number of those after it.
    others: u64,
}

impl Faults {
    /// Adds a fault.
    pub fn add(&mut self, fault: impl Display) {
        match self.first {
            None => self.first = Some(fault.to_string()),
            Some(_) => self.others += 1,
        }
    }

    /// These faults and others.
    pub fn and(mut self, others: Faults) -> Self {
        if let Some(first) = others.first {
            self.add(first);
            self.others += others.others;
        }
        self
    }

    /// All of them in words, if there are any.
    pub fn in_words(self) -> Option<String> {
        let first = self.first?;
        Some(match self.others {
            0 => first,
            1 => format!("{first}; and another fault"),
            others => format!("{first}; and {others} other faults"),
        })
    }
}

/// The records of a recording up to the end of its data, taken out of their chunks. Damaged records, or those
/// that refer to others which do not exist, are left out, and reading goes on behind them: see
/// [`faults`](Self::faults). If the input fails, its error is the last item.
pub struct Records<R> {
    file: Summed<BufReader<R>>,
    /// The chunk that is being read.
    chunk: Option<Chunk>,
    /// The header of the recording.
    pub header: Header,
    /// The schemas and channels so far, by their numbers.
    schemas: HashMap<u16, (SchemaHeader, Vec<u8>)>,
    channels: HashMap<u16, Channel>,
    /// Number of messages so far.
    messages: u64,
    has_ended: bool,
    /// What is wrong with the recording, as far as it has been read: all of it once there are no more
    /// records.
    pub faults: Faults,
}

impl<R: Read> Records<R> {
    /// Opens a recording.
    ///
    /// # Errors
    /// If the input is not a recording, or fails.
    pub fn open(input: R) -> Result<Self> {
        let mut file = Summed { input: BufReader::new(input), sum: Hasher::new() };
        let mut magic = [0; mcap::MAGIC.len()];
        read_whole(&mut file, &mut magic)?;
        if magic != mcap::MAGIC {
            return Err(failed(McapError::BadMagic));
        }
        let Record::Header(header) = parsed(&read_record(&mut file)?)? else {
            return Err(Error::DamagedInput("no MCAP recording, as it begins without a header".to_owned()));
        };
        let (schemas, channels) = (HashMap::new(), HashMap::new());
        let faults = Faults::default();
        Ok(Records { file, chunk: None, header, schemas, channels, messages: 0, has_ended: false, faults })
    }

    /// The next record that can be read: of the current chunk, or if there is none, of the file.
    ///
    /// # Errors
    /// If the recording cannot be read on.
    fn read(&mut self) -> Result<Option<Record<'static>>> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.next() {
                    Some(Ok(record)) => return Ok(Some(record)),
                    Some(Err(fault)) => self.faults.add(fault),
                    None => self.chunk = None,
                }
                continue;
            }
            let sum = self.file.sum.clone().finalize();
            let record = read_record(&mut self.file)?;
            let read = match record.opcode {
                op::MESSAGE_INDEX => continue,
                op::DATA_END => return self.end(&record, sum).map(|()| None),
                // What is left of a chunk that is cut short contains whole records.
                op::CHUNK => Chunk::new(&record).map(|chunk| self.chunk = Some(chunk)).map(|()| None),
                _ => parsed(&record).map(Some),
            };
            match read {
                Ok(Some(record)) => return Ok(Some(record)),
                Ok(None) => {}
                Err(fault) => self.faults.add(fault),
            }
        }
    }

    /// Reads from the end of the data to that of the file. `sum` is the checksum of all before.
    ///
    /// # Errors
    /// If the recording does not end as it should.
    fn end(&mut self, data_end: &RawRecord, sum: u32) -> Result<()> {
        match parsed(data_end)? {
            Record::DataEnd(end) if ![0, sum].contains(&end.data_section_crc) => {
                self.faults.add("the checksum of its data is wrong");
            }
            _ => {}
        }
        self.file.sum = Hasher::new();
        loop {
            let summary = self.file.sum.clone();
            let record = read_record(&mut self.file)?;
            match record.opcode {
                op::FOOTER => {
                    let Record::Footer(footer) = parsed(&record)? else { continue };
                    if !record.confirms(summary, &footer) {
                        self.faults.add("the checksum of its summary is wrong");
                    }
                    break;
                }
                op::STATISTICS => self.check_count(&record)?,
                op::MESSAGE | op::CHUNK | op::ATTACHMENT | op::METADATA | FIRST_PRIVATE.. => {
                    return Err(Error::DamagedInput(
                        "records after the end of its data are left out".to_owned(),
                    ));
                }
                _ => {}
            }
        }
        let mut magic = [0; mcap::MAGIC.len()];
        read_whole(&mut self.file, &mut magic)?;
        if magic != mcap::MAGIC || self.file.read(&mut [0])? > 0 {
            return Err(Error::DamagedInput("bytes after its end are left out".to_owned()));
        }
        Ok(())
    }

    /// Checks that no message is missing, of which nothing else tells in a recording without checksums.
    ///
    /// # Errors
    /// If the record is damaged.
    fn check_count(&mut self, statistics: &RawRecord) -> Result<()> {
        let Record::Statistics(counts) = parsed(statistics)? else { return Ok(()) };
        let (all, read) = (counts.message_count, self.messages);
        if read < all && self.faults == Faults::default() {
            self.faults.add(format!("of {all} messages that its statistics count, {read} are there"));
        }
        Ok(())
    }

    /// Checks that what a record refers to exists, and that it is the only one of its number.
    fn check(&mut self, record: &Record) -> std::result::Result<(), String> {
        match record {
            Record::Schema { header: SchemaHeader { id: 0, .. }, .. } => {
                Err("a schema has the number 0".to_owned())
            }
            Record::Schema { header, data } => {
                let (known, text) =
                    self.schemas.entry(header.id).or_insert_with(|| (header.clone(), data.to_vec()));
                let is_same = known == header && text[..] == data[..];
                is_same.then_some(()).ok_or_else(|| format!("there are two schemas of number {}", header.id))
            }
            Record::Channel(Channel { id, schema_id, .. })
                if *schema_id != 0 && !self.schemas.contains_key(schema_id) =>
            {
                Err(format!("channel {id} has schema {schema_id}, which does not exist"))
            }
            Record::Channel(channel) => {
                let known = self.channels.entry(channel.id).or_insert_with(|| channel.clone());
                let is_same = known == channel;
                is_same
                    .then_some(())
                    .ok_or_else(|| format!("there are two channels of number {}", channel.id))
            }
            Record::Message { header, .. } if !self.channels.contains_key(&header.channel_id) => {
                Err(format!("a message has channel {}, which does not exist", header.channel_id))
            }
            Record::Unknown { opcode, .. } if *opcode < FIRST_PRIVATE => {
                Err(format!("a record is of kind {opcode}, which the format does not define"))
            }
            _ => Ok(()),
        }
    }
}

impl<R: Read> Iterator for Records<R> {
    type Item = Result<Record<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.has_ended {
            match self.read() {
                Ok(Some(record)) => match self.check(&record) {
                    Ok(()) => {
                        self.messages += u64::from(matches!(record, Record::Message { .. }));
                        return Some(Ok(record));
                    }
                    Err(fault) => self.faults.add(fault),
                },
                Ok(None) => self.has_ended = true,
                Err(error) => {
                    self.has_ended = true;
                    match error {
                        Error::Io(_) => return Some(Err(error)),
                        fault => self.faults.add(fault),
                    }
                }
            }
        }
        None
    }
}

/// An input with the checksum of what has been read of it.
struct Summed<R> {
    input: R,
    sum: Hasher,
}

impl<R: Read> Read for Summed<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let read = self.input.read(out)?;
        self.sum.update(&out[..read]);
        Ok(read)
    }
}

/// The records of a chunk.
struct Chunk {
    bytes: Cursor<Vec<u8>>,
    reader: LinearReader,
    /// What is wrong with the chunk as a whole.
    fault: Option<Error>,
    has_ended: bool,
}

/// The length of a chunk's fields before its records, if these are not compressed.
const CHUNK_FIELDS: usize = 40;
/// Among these, the length of the records before compression, their checksum, the length of the name of the
/// compression, and the length of the records.
const WHOLE_LENGTH: Range<usize> = 16..24;
const CHECKSUM: Range<usize> = 24..28;
const NAME_LENGTH: Range<usize> = 28..32;
const RECORDS_LENGTH: Range<usize> = 32..40;

impl Chunk {
    /// Reads a chunk, of which the end may be missing.
    ///
    /// Records that are not compressed are read as those of a file: the library's reader of such chunks (as
    /// of `mcap` 0.26) does not check that a record is no longer than what is left of its chunk.
    fn new(record: &RawRecord) -> Result<Self> {
        check_lengths(record)?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(Limits::default().file_bytes as usize);
        Ok(match record.contents.split_first_chunk::<CHUNK_FIELDS>() {
            Some((fields, records)) if fields[NAME_LENGTH] == [0; 4] => {
                let number =
                    |range: Range<usize>| LittleEndian::read_uint(&fields[range.clone()], range.len());
                let length = number(RECORDS_LENGTH);
                let is_whole = number(WHOLE_LENGTH) == length && length <= records.len() as u64;
                let records = &records[..records.len().min(saturated(length))];
                let (saved, calculated) = (number(CHECKSUM) as u32, crc32fast::hash(records));
                let fault = match is_whole {
                    false => Some(Error::DamagedInput("the length of a chunk is wrong".to_owned())),
                    true if [0, calculated].contains(&saved) => None,
                    true => Some(failed(McapError::BadChunkCrc { saved, calculated })),
                };
                let reader = LinearReader::new_with_options(options);
                Chunk { bytes: Cursor::new(records.to_vec()), reader, fault, has_ended: false }
            }
            _ => {
                let options = options.with_emit_chunks(false).with_validate_chunk_crcs(true);
                let reader = LinearReader::new_with_options(options);
                Chunk { bytes: Cursor::new(record.bytes()), reader, fault: None, has_ended: false }
            }
        })
    }

    /// The next event of the reader, filled with bytes as it asks for them.
    fn event(&mut self) -> Option<Result<Record<'static>>> {
        while let Some(event) = self.reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let read = self.bytes.read(self.reader.insert(wanted)).unwrap_or(0);
                    self.reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { opcode: op::CHUNK | op::DATA_END, .. }) => {
                    let fault = "a chunk or the end of the data within a chunk";
                    return Some(Err(Error::DamagedInput(fault.to_owned())));
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    return Some(parsed(&RawRecord::of(opcode, data.to_vec())));
                }
                Err(error) => {
                    self.has_ended = true;
                    return Some(Err(failed(error)));
                }
            }
        }
        None
    }
}

impl Iterator for Chunk {
    type Item = Result<Record<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(fault) = self.fault.take() {
            return Some(Err(fault));
        }
        if self.has_ended { None } else { self.event() }
    }
}

/// A record as it is stored.
struct RawRecord {
    opcode: u8,
    /// The length that it says it has.
    length: u64,
    /// As much of its contents as there is.
    contents: Vec<u8>,
}

impl RawRecord {
    fn of(opcode: u8, contents: Vec<u8>) -> Self {
        RawRecord { opcode, length: contents.len() as u64, contents }
    }

    fn bytes(&self) -> Vec<u8> {
        [&[self.opcode], &self.length.to_le_bytes()[..], &self.contents].concat()
    }

    /// Whether this record, a footer, has the checksum of the summary before it and of itself up to there, or
    /// none.
    fn confirms(&self, mut summary: Hasher, footer: &Footer) -> bool {
        /// The kind, the length and two positions.
        const COVERED: usize = 1 + 8 + 2 * 8;
        summary.update(self.bytes().get(..COVERED).unwrap_or_default());
        [0, summary.finalize()].contains(&footer.summary_crc)
    }
}

/// Reads the next record. Only that of a chunk may be cut short.
fn read_record(input: &mut impl Read) -> Result<RawRecord> {
    let mut opcode = [0];
    let mut length = [0; 8];
    read_whole(input, &mut opcode)?;
    read_whole(input, &mut length)?;
    let ([opcode], length) = (opcode, u64::from_le_bytes(length));
    if length > Limits::default().file_bytes {
        return Err(failed(McapError::RecordTooLarge { opcode, len: length }));
    }
    let mut contents = Vec::new();
    input.by_ref().take(length).read_to_end(&mut contents)?;
    if opcode != op::CHUNK && (contents.len() as u64) < length {
        return Err(failed(McapError::UnexpectedEof));
    }
    Ok(RawRecord { opcode, length, contents })
}

/// A record from its contents.
fn parsed(record: &RawRecord) -> Result<Record<'static>> {
    check_lengths(record)?;
    mcap::parse_record(record.opcode, &record.contents).map(Record::into_owned).map_err(failed)
}

/// A field of a record.
enum Field {
    /// Bytes of known number.
    Fixed(usize),
    /// Bytes after their number in 32 bits.
    Text,
    /// Bytes after their number in 64 bits.
    Data,
    /// Pairs of texts, after the number of their bytes in 32 bits.
    Texts,
}

/// Checks that no field of a record is longer than what is left of it: the library (as of `mcap` 0.26)
/// allocates memory for texts before it reads them, and expects that attachments end in a checksum.
fn check_lengths(record: &RawRecord) -> Result<()> {
    use Field::{Data, Fixed, Text, Texts};
    let RawRecord { opcode, contents, .. } = record;
    let fields: &[Field] = match *opcode {
        op::HEADER => &[Text, Text],
        op::SCHEMA => &[Fixed(2), Text, Text, Text],
        op::CHANNEL => &[Fixed(4), Text, Text, Texts],
        op::CHUNK => &[Fixed(28), Text, Fixed(8)],
        op::CHUNK_INDEX => &[Fixed(32), Text, Fixed(8), Text, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Text, Text, Data, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Text, Text],
        op::METADATA => &[Text, Texts],
        op::METADATA_INDEX => &[Fixed(16), Text],
        _ => &[],
    };
    let too_short =
        || Error::DamagedInput(format!("a field of a record of kind {opcode} is longer than the record"));
    let mut rest = &contents[..];
    for field in fields {
        let length = match field {
            Fixed(length) => Some(*length),
            Text | Texts => take_number::<4>(&mut rest),
            Data => take_number::<8>(&mut rest),
        };
        let (of_field, after) =
            length.and_then(|length| rest.split_at_checked(length)).ok_or_else(too_short)?;
        if let Texts = field {
            let mut texts = of_field;
            while !texts.is_empty() {
                let length = take_number::<4>(&mut texts);
                texts = length.and_then(|length| texts.get(length..)).ok_or_else(too_short)?;
            }
        }
        rest = after;
    }
    Ok(())
}

/// Takes a number of `N` bytes from the start of the input.
fn take_number<const N: usize>(input: &mut &[u8]) -> Option<usize> {
    let (number, rest) = input.split_first_chunk::<N>()?;
    *input = rest;
    let mut bytes = [0; 8];
    bytes[..N].copy_from_slice(number);
    Some(saturated(u64::from_le_bytes(bytes)))
}

/// Fills `bytes` from the input.
fn read_whole(input: &mut impl Read, bytes: &mut [u8]) -> Result<()> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => failed(McapError::UnexpectedEof),
        _ => error.into(),
    })
}

/// The error of a recording that cannot be read or written.
fn failed(error: McapError) -> Error {
    match error {
        McapError::Io(error) => error.into(),
        other => Error::DamagedInput(other.to_string()),
    }
}

/// A recording that is being written.
pub struct Output<W: Write + Seek> {
    writer: Writer<W>,
}

impl<W: Write + Seek> Output<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// If the output fails, as for the functions below.
    pub fn create(out: W, header: Header) -> Result<Self> {
        let options =
            WriteOptions::new().profile(header.profile).library(header.library).compression_threads(0);
        Ok(Output { writer: options.create(out).map_err(failed)? })
    }

    /// Writes a record, except for those that the writer generates itself.
    pub fn write(&mut self, record: Record<'static>) -> Result<()> {
        let out = &mut self.writer;
        let written = match record {
            Record::Schema { header: SchemaHeader { id, name, encoding }, data } => {
                out.add_schema_with_id(id, &name, &encoding, &data).map(drop)
            }
            Record::Channel(Channel { id, schema_id, topic, message_encoding, metadata }) => {
                out.add_channel_with_id(id, schema_id, &topic, &message_encoding, &metadata).map(drop)
            }
            Record::Message { header, data } => out.write_to_known_channel(&header, &data),
            Record::Attachment { header, data, .. } => out.attach(&Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            }),
            Record::Metadata(metadata) => out.write_metadata(&metadata),
            Record::Unknown { opcode, data } if opcode >= FIRST_PRIVATE => {
                out.write_private_record(opcode, &data, Default::default())
            }
            // The writer generates these itself.
            _ => Ok(()),
        };
        written.map_err(failed)
    }

    /// Writes the summary.
    pub fn finish(mut self) -> Result<()> {
        self.writer.finish().map(drop).map_err(failed)
    }
}

/// The numbers of all schemas and channels of a recording, wherever the input is positioned; afterwards it is
/// at its first byte. If the recording is damaged, those of the records that can be read.
///
/// # Errors
/// If the input is not a recording, or fails.
pub fn numbers_in(input: &mut (impl Read + Seek)) -> Result<HashSet<u16>> {
    let listed = numbers_of_summary(input)?;
    input.seek(SeekFrom::Start(0))?;
    if let Some(numbers) = listed {
        return Ok(numbers);
    }
    let records = Records::open(&mut *input)?;
    let numbers = records.filter_map(|record| match record {
        Ok(Record::Schema { header, .. }) => Some(Ok(header.id)),
        Ok(Record::Channel(channel)) => Some(Ok(channel.id)),
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    });
    let numbers = numbers.collect::<Result<_>>()?;
    input.seek(SeekFrom::Start(0))?;
    Ok(numbers)
}

/// The numbers of all schemas and channels, if the summary at the end of a recording lists all that its
/// statistics count.
///
/// # Errors
/// If the input fails.
fn numbers_of_summary(input: &mut (impl Read + Seek)) -> Result<Option<HashSet<u16>>> {
    let Some(summary) = summary(input)? else { return Ok(None) };
    let (mut schemas, mut channels, mut expected) = (HashSet::new(), HashSet::new(), None);
    let mut rest = &summary[..];
    while !rest.is_empty() {
        let record = read_record(&mut rest).and_then(|record| parsed(&record));
        match record {
            Ok(Record::Schema { header, .. }) => drop(schemas.insert(header.id)),
            Ok(Record::Channel(channel)) => drop(channels.insert(channel.id)),
            Ok(Record::Statistics(counts)) => {
                expected = Some((usize::from(counts.schema_count), counts.channel_count as usize));
            }
            Ok(_) => {}
            Err(_) => return Ok(None),
        }
    }
    let is_complete = expected == Some((schemas.len(), channels.len()));
    Ok(is_complete.then(|| schemas.into_iter().chain(channels).collect()))
}

/// The records of the summary at the end of a recording, if it has one that is intact.
///
/// # Errors
/// If the input fails.
fn summary(input: &mut (impl Read + Seek)) -> Result<Option<Vec<u8>>> {
    /// Bytes of the footer's record: its kind, its length and three numbers.
    const FOOTER: usize = 1 + 8 + 20;
    const END: usize = FOOTER + mcap::MAGIC.len();
    let Some(end) = input.seek(SeekFrom::End(0))?.checked_sub(END as u64) else { return Ok(None) };
    input.seek(SeekFrom::Start(end))?;
    let mut footer = [0; END];
    input.read_exact(&mut footer)?;
    if footer[0] != op::FOOTER || footer[FOOTER..] != *mcap::MAGIC {
        return Ok(None);
    }
    let record = RawRecord::of(op::FOOTER, footer[9..FOOTER].to_vec());
    let Ok(Record::Footer(fields)) = parsed(&record) else { return Ok(None) };
    let length = end.checked_sub(fields.summary_start);
    let Some(length) = length.filter(|length| *length <= Limits::default().file_bytes) else {
        return Ok(None);
    };
    input.seek(SeekFrom::Start(fields.summary_start))?;
    let mut summary = Vec::new();
    input.take(length).read_to_end(&mut summary)?;
    let mut sum = Hasher::new();
    sum.update(&summary);
    let is_intact = fields.summary_start > 0 && record.confirms(sum, &fields);
    Ok(is_intact.then_some(summary))
}
