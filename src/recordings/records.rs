//! The records of an MCAP recording: read one after another, and written with chunks and indexes.

use std::collections::HashSet;
use std::io::{Read, Seek, SeekFrom, Write};

use mcap::records::{Channel, Header, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Attachment, McapError, Summary, WriteOptions, Writer};

use crate::ground::error::{Error, Limits, Result};

/// The first number of records that the format leaves to applications.
const FIRST_PRIVATE: u8 = 0x80;

/// The records of a recording up to the end of its data, taken out of their chunks.
pub struct Records<R> {
    input: R,
    reader: LinearReader,
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
        let options =
            LinearReaderOptions::default().with_record_length_limit(Limits::default().file_bytes as usize);
        let reader = LinearReader::new_with_options(options);
        let header = Header { profile: String::new(), library: String::new() };
        let mut records = Records { input, reader, header, has_ended: false };
        match records.next() {
            Some(Ok(Record::Header(header))) => Ok(Records { header, ..records }),
            Some(Err(error)) => Err(error),
            _ => Err(Error::Usage("no MCAP recording, or an empty one".to_owned())),
        }
    }
}

impl<R: Read> Iterator for Records<R> {
    type Item = Result<Record<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.has_ended {
            let event = match self.reader.next_event() {
                Some(Ok(event)) => event,
                Some(Err(error)) => {
                    self.has_ended = true;
                    return Some(Err(failed(error)));
                }
                None => break,
            };
            match event {
                LinearReadEvent::ReadRequest(wanted) => match self.input.read(self.reader.insert(wanted)) {
                    Ok(read) => self.reader.notify_read(read),
                    Err(error) => {
                        self.has_ended = true;
                        return Some(Err(error.into()));
                    }
                },
                LinearReadEvent::Record { opcode: op::DATA_END, .. } => self.has_ended = true,
                LinearReadEvent::Record { opcode: op::MESSAGE_INDEX, .. } => {}
                LinearReadEvent::Record { data, opcode } => {
                    let record = mcap::parse_record(opcode, data).map(Record::into_owned);
                    self.has_ended = record.is_err();
                    return Some(record.map_err(failed));
                }
            }
        }
        None
    }
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
    let summary = summary(input)?;
    input.seek(SeekFrom::Start(0))?;
    let listed = summary.filter(|summary| {
        summary.stats.as_ref().is_some_and(|stats| {
            usize::from(stats.schema_count) == summary.schemas.len()
                && stats.channel_count as usize == summary.channels.len()
        })
    });
    if let Some(summary) = listed {
        return Ok(summary.schemas.into_keys().chain(summary.channels.into_keys()).collect());
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

/// The summary at the end of a recording, if it has one.
///
/// # Errors
/// If the input fails.
fn summary(input: &mut (impl Read + Seek)) -> Result<Option<Summary>> {
    let options = SummaryReaderOptions::default()
        .with_file_size(input.seek(SeekFrom::End(0))?)
        .with_record_length_limit(Limits::default().file_bytes as usize);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(wanted)) => {
                let read = input.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
            // A summary that refers to a position before the first byte is invalid.
            Ok(SummaryReadEvent::SeekRequest(to)) => match input.seek(to) {
                Ok(place) => reader.notify_seeked(place),
                Err(_) => return Ok(None),
            },
            Err(_) => return Ok(None),
        }
    }
    Ok(reader.finish())
}
