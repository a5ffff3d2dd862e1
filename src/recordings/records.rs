//! The records of an MCAP recording: read one after another, and written with chunks and indexes.

use std::collections::HashSet;
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom, Write};
use std::ops::Range;

use mcap::records::{Channel, Header, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, McapError, WriteOptions, Writer};

use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::saturated;

/// The first number of records that the format leaves to applications.
const FIRST_PRIVATE: u8 = 0x80;

/// The records of a recording up to the end of its data, taken out of their chunks.
pub struct Records<R> {
    file: BufReader<R>,
    /// The chunk that is being read.
    chunk: Option<Chunk>,
    /// The header of the recording.
    pub header: Header,
    has_ended: bool,
}

impl<R: Read> Records<R> {
    /// Opens a recording.
    ///
    /// # Errors
    /// If the input is not a recording, or fails.
    pub fn open(input: R) -> Result<Self> {
        let mut file = BufReader::new(input);
        let mut magic = [0; mcap::MAGIC.len()];
        read_whole(&mut file, &mut magic)?;
        if magic != mcap::MAGIC {
            return Err(failed(McapError::BadMagic));
        }
        let header = Header { profile: String::new(), library: String::new() };
        let mut records = Records { file, chunk: None, header, has_ended: false };
        match records.next() {
            Some(Ok(Record::Header(header))) => Ok(Records { header, ..records }),
            Some(Err(error)) => Err(error),
            _ => Err(Error::Usage("no MCAP recording, or an empty one".to_owned())),
        }
    }

    /// The next record: of the current chunk, or if there is none, of the file.
    fn read(&mut self) -> Result<Option<Record<'static>>> {
        loop {
            if let Some(chunk) = &mut self.chunk {
                match chunk.next()? {
                    Some(record) => return Ok(Some(record)),
                    None => self.chunk = None,
                }
            }
            let (opcode, length, contents) = read_record(&mut self.file)?;
            match opcode {
                op::DATA_END => return Ok(None),
                op::MESSAGE_INDEX => {}
                // What is left of a chunk that is cut short contains whole records.
                op::CHUNK => self.chunk = Some(Chunk::new(length, contents)?),
                _ if (contents.len() as u64) < length => return Err(failed(McapError::UnexpectedEof)),
                _ => return parsed(opcode, &contents).map(Some),
            }
        }
    }
}

impl<R: Read> Iterator for Records<R> {
    type Item = Result<Record<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_ended {
            return None;
        }
        let record = self.read().transpose();
        self.has_ended = !matches!(record, Some(Ok(_)));
        record
    }
}

/// The records of a chunk.
struct Chunk {
    bytes: Cursor<Vec<u8>>,
    reader: LinearReader,
}

/// The length of a chunk's fields before its records, if these are not compressed.
const CHUNK_FIELDS: usize = 40;
/// Among these, the length of the name of the compression, and the length of the records.
const NAME_LENGTH: Range<usize> = 28..32;
const RECORDS_LENGTH: Range<usize> = 32..40;

impl Chunk {
    /// Reads a chunk. `length` is that of its record, of whose contents the end may be missing.
    ///
    /// Records that are not compressed are read as those of a file: the library's reader of such chunks (as of `mcap`
    /// 0.26) does not check that a record is no longer than what is left of its chunk.
    fn new(length: u64, contents: Vec<u8>) -> Result<Self> {
        check_lengths(op::CHUNK, &contents)?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(Limits::default().file_bytes as usize);
        Ok(match contents.split_first_chunk::<CHUNK_FIELDS>() {
            Some((fields, records)) if fields[NAME_LENGTH] == [0; 4] => {
                let length = u64::from_le_bytes(fields[RECORDS_LENGTH].try_into().expect("eight bytes"));
                let records = &records[..records.len().min(saturated(length))];
                Chunk {
                    bytes: Cursor::new(records.to_vec()),
                    reader: LinearReader::new_with_options(options),
                }
            }
            _ => {
                let bytes = [&[op::CHUNK], &length.to_le_bytes()[..], &contents].concat();
                let reader = LinearReader::new_with_options(options.with_emit_chunks(false));
                Chunk { bytes: Cursor::new(bytes), reader }
            }
        })
    }

    /// The next record.
    fn next(&mut self) -> Result<Option<Record<'static>>> {
        while let Some(event) = self.reader.next_event() {
            match event.map_err(failed)? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let read = self.bytes.read(self.reader.insert(wanted))?;
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { opcode: op::CHUNK | op::DATA_END, .. } => {
                    return Err(Error::Usage(
                        "the recording: a chunk or the end of the data within a chunk".to_owned(),
                    ));
                }
                LinearReadEvent::Record { opcode, data } => return parsed(opcode, data).map(Some),
            }
        }
        Ok(None)
    }
}

/// Reads the opcode of a record, its length, and as much of its contents as there is.
fn read_record(input: &mut impl Read) -> Result<(u8, u64, Vec<u8>)> {
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
    Ok((opcode, length, contents))
}

/// A record from its contents.
fn parsed(opcode: u8, contents: &[u8]) -> Result<Record<'static>> {
    check_lengths(opcode, contents)?;
    mcap::parse_record(opcode, contents).map(Record::into_owned).map_err(failed)
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

/// Checks that no field of a record is longer than what is left of it: the library (as of `mcap` 0.26) allocates
/// memory for texts before it reads them, and expects that attachments end in a checksum.
fn check_lengths(opcode: u8, contents: &[u8]) -> Result<()> {
    use Field::{Data, Fixed, Text, Texts};
    let fields: &[Field] = match opcode {
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
    let too_short = || {
        Error::Usage(format!("the recording: a field of a record of kind {opcode} is longer than the record"))
    };
    let mut rest = contents;
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
        other => Error::Usage(format!("the recording: {other}")),
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

/// The numbers of all schemas and channels of a recording, wherever the input is positioned; afterwards it is at its
/// first byte. If the recording is damaged, the numbers up to the fault.
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
    let numbers = records.map_while(Result::ok).filter_map(|record| match record {
        Record::Schema { header, .. } => Some(header.id),
        Record::Channel(channel) => Some(channel.id),
        _ => None,
    });
    let numbers = numbers.collect();
    input.seek(SeekFrom::Start(0))?;
    Ok(numbers)
}

/// The numbers of all schemas and channels, if the summary at the end of a recording lists all that its statistics
/// count.
///
/// # Errors
/// If the input fails.
fn numbers_of_summary(input: &mut (impl Read + Seek)) -> Result<Option<HashSet<u16>>> {
    let Some(summary) = summary(input)? else { return Ok(None) };
    let (mut schemas, mut channels, mut expected) = (HashSet::new(), HashSet::new(), None);
    let mut rest = &summary[..];
    while !rest.is_empty() {
        let record = read_record(&mut rest).and_then(|(opcode, _, contents)| parsed(opcode, &contents));
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
    let Ok(Record::Footer(fields)) = parsed(op::FOOTER, &footer[9..FOOTER]) else { return Ok(None) };
    let length = end.checked_sub(fields.summary_start);
    let Some(length) = length.filter(|length| *length <= Limits::default().file_bytes) else {
        return Ok(None);
    };
    input.seek(SeekFrom::Start(fields.summary_start))?;
    let mut summary = Vec::new();
    input.take(length).read_to_end(&mut summary)?;
    // The checksum is of the summary and of the footer up to itself; 0 stands for none.
    let mut crc = flate2::Crc::new();
    crc.update(&summary);
    crc.update(&footer[..FOOTER - 4]);
    let is_intact = fields.summary_start > 0 && [0, crc.sum()].contains(&fields.summary_crc);
    Ok(is_intact.then_some(summary))
}
