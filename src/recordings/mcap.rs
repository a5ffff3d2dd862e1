//! MCAP recordings: read record by record, written with chunks and indexes.

use std::collections::{HashMap, HashSet};
use std::io::{Cursor, Read, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, PoisonError};

use mcap::records::{Channel, Header, MessageHeader, Record, SchemaHeader, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Attachment, McapError, Summary, WriteOptions, Writer};

use super::message::{self, Encoding};
use crate::frame::settings::{EncoderConfig, resolve_threads};
use crate::ground::error::{Error, Limits, Result};
use crate::library::{Decoder, Scan, Settings};
use crate::stream::FrameInput;
use crate::stream::container::{Stamp, Time, TimeSource, Unit};
use crate::stream::encoder::encode_known;
use crate::stream::ordered::run_ordered;
use crate::stream::scanner_choice::{KeptScanners, Scanners};

/// The channels' metadata in which a packed recording keeps the number of the schema that a channel of clouds had, and the
/// number of the channel of which a channel holds what is no cloud.
const SCHEMA_KEY: &str = "lidarpc.schema";
const CHANNEL_KEY: &str = "lidarpc.channel";

/// Which topics of clouds are meant.
#[derive(Clone, Debug, Default)]
pub struct TopicFilter {
    /// These; all if it is empty.
    pub topics: Vec<String>,
}

impl TopicFilter {
    fn takes(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.iter().any(|wanted| wanted == topic)
    }
}

/// What was copied.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Copied {
    /// Messages in all.
    pub messages: u64,
    /// Of these, clouds that were compressed, or compressed ones that were decoded.
    pub clouds: u64,
    /// Messages of clouds' topics that are no cloud as lidarpc knows them, and were copied as they are.
    pub kept: u64,
    /// Bytes of these clouds' messages before and after.
    pub cloud_bytes: [u64; 2],
    /// Points of the clouds.
    pub points: u64,
    /// Attachments and records of metadata.
    pub attachments: u64,
    /// What is wrong with the recording from there on; it was taken as far as it is whole.
    pub cut_short: Option<String>,
}

/// Copies a recording from its first byte on, its clouds compressed. `on_message` is called for each message that is
/// written. The input is looked through before: what packing adds gets numbers that the recording uses nowhere.
///
/// # Errors
/// If the input is no recording, or is packed already, or the input or the output fails; those of the settings. A
/// recording that is cut short or damaged is taken up to there: see [`Copied::cut_short`].
pub fn pack<W: Write + Seek>(
    mut input: impl Read + Seek + Send,
    out: W,
    settings: &Settings,
    filter: &TopicFilter,
    on_message: &(dyn Fn() + Sync),
) -> Result<Copied> {
    let config = &settings.config()?;
    let used = numbers_in(&mut input)?;
    let (schemas, channels) = (HashMap::new(), HashMap::new());
    let mut packing = Packing { config, filter, schemas, channels, used, next: u16::MAX };
    copy(input, out, config.threads, |record| packing.job(record), on_message)
}

/// Copies a packed recording, its clouds as they were.
///
/// # Errors
/// As [`pack`]; also if a payload is damaged.
pub fn unpack<W: Write + Seek>(
    input: impl Read + Send,
    out: W,
    threads: usize,
    on_message: &(dyn Fn() + Sync),
) -> Result<Copied> {
    let mut unpacking = Unpacking::default();
    copy(input, out, threads, |record| unpacking.job(record), on_message)
}

/// What is done for a record.
enum Job {
    /// These are written as they are.
    Copy(Vec<Record<'static>>),
    /// A cloud is compressed.
    Pack { header: MessageHeader, data: Vec<u8>, topic: Arc<PackedTopic> },
    /// A compressed cloud is decoded.
    Unpack { header: MessageHeader, data: Vec<u8>, encoding: Encoding },
}

impl Job {
    fn one(record: Record<'static>) -> Self {
        Job::Copy(vec![record])
    }

    /// Does it, on any thread.
    fn done(self) -> Result<Done> {
        match self {
            Job::Copy(records) => Ok(Done { records, cloud: None, is_kept: false }),
            Job::Pack { header, data, topic } => topic.pack(header, data),
            Job::Unpack { header, data, encoding } => unpack_message(header, data, encoding),
        }
    }
}

/// What becomes of a record.
struct Done {
    records: Vec<Record<'static>>,
    /// Of a cloud: its points, and its bytes before and after.
    cloud: Option<(u64, [u64; 2])>,
    /// Whether it is a message of a topic of clouds that is none.
    is_kept: bool,
}

impl Done {
    fn cloud(header: MessageHeader, data: Vec<u8>, points: usize, before: usize) -> Self {
        let bytes = [before, data.len()].map(|bytes| bytes as u64);
        let record = Record::Message { header, data: data.into() };
        Done { records: vec![record], cloud: Some((points as u64, bytes)), is_kept: false }
    }
}

/// Copies a recording, record by record, in parallel.
fn copy<W: Write + Seek>(
    input: impl Read + Send,
    out: W,
    threads: usize,
    mut job: impl FnMut(Record<'static>) -> Result<Job> + Send,
    on_message: &(dyn Fn() + Sync),
) -> Result<Copied> {
    let mut records = Records::open(input)?;
    let mut out = Output::create(out, records.header.clone())?;
    let mut copied = Copied::default();
    let cut_short = Mutex::new(None);
    let jobs = std::iter::from_fn(|| match records.next()? {
        Ok(record) => Some(job(record)),
        Err(error) => {
            *cut_short.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
            None
        }
    });
    run_ordered(resolve_threads(threads), jobs.fuse(), Job::done, |done| {
        if let Some((points, [before, after])) = done.cloud {
            copied.clouds += 1;
            copied.points += points;
            copied.cloud_bytes[0] += before;
            copied.cloud_bytes[1] += after;
        }
        copied.kept += u64::from(done.is_kept);
        for record in done.records {
            if matches!(record, Record::Message { .. }) {
                copied.messages += 1;
                on_message();
            }
            copied.attachments +=
                u64::from(matches!(record, Record::Attachment { .. } | Record::Metadata(_)));
            out.write(record)?;
        }
        Ok(())
    })?;
    out.finish()?;
    copied.cut_short = cut_short.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(copied)
}

/// What packing knows of a recording.
struct Packing<'a> {
    config: &'a EncoderConfig,
    filter: &'a TopicFilter,
    /// The names of the schemas.
    schemas: HashMap<u16, String>,
    /// All channels that were seen; of those of clouds, what is needed to pack them.
    channels: HashMap<u16, Option<CloudChannel>>,
    /// The numbers of all schemas and channels of the recording.
    used: HashSet<u16>,
    /// The highest number that a schema or channel that is added may get.
    next: u16,
}

/// A channel of clouds.
struct CloudChannel {
    encoding: Encoding,
    /// The channel for messages of the topic that are no clouds.
    others: Channel,
    scanners: KeptScanners,
    /// That of the last message.
    topic: Option<Arc<PackedTopic>>,
}

/// How the clouds of a channel are compressed.
struct PackedTopic {
    config: EncoderConfig,
    scanners: Arc<Scanners>,
    encoding: Encoding,
    others: Channel,
}

impl Packing<'_> {
    fn job(&mut self, record: Record<'static>) -> Result<Job> {
        match record {
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, header.name.clone());
                Ok(Job::one(Record::Schema { header, data }))
            }
            Record::Channel(channel) => self.channel(channel),
            Record::Message { header, data } => match self.channels.get_mut(&header.channel_id) {
                Some(Some(channel)) => {
                    let topic = channel.topic_of(&data, self.config)?;
                    Ok(Job::Pack { header, data: data.into_owned(), topic })
                }
                _ => Ok(Job::one(Record::Message { header, data })),
            },
            other => Ok(Job::one(other)),
        }
    }

    /// A channel, with the schema of compressed clouds if its messages are clouds.
    fn channel(&mut self, channel: Channel) -> Result<Job> {
        if channel.metadata.contains_key(SCHEMA_KEY) {
            return Err(Error::Usage("the recording is packed already".to_owned()));
        }
        if self.channels.contains_key(&channel.id) {
            return Ok(Job::Copy(Vec::new()));
        }
        let encoding = Encoding::of(&channel.message_encoding).filter(|encoding| {
            let [of_clouds, _] = encoding.schemas();
            let is_of_clouds = self.schemas.get(&channel.schema_id).is_some_and(|name| name == of_clouds);
            is_of_clouds && self.filter.takes(&channel.topic)
        });
        let Some(encoding) = encoding else {
            self.channels.insert(channel.id, None);
            return Ok(Job::one(Record::Channel(channel)));
        };
        let mut others = Channel { id: self.unused()?, ..channel.clone() };
        others.metadata.insert(CHANNEL_KEY.to_owned(), channel.id.to_string());
        let schema_id = self.unused()?;
        let schema = compressed_schema(encoding, schema_id);
        let mut packed = Channel { schema_id, ..channel };
        packed.metadata.insert(SCHEMA_KEY.to_owned(), others.schema_id.to_string());
        let of_clouds = CloudChannel { encoding, others, scanners: KeptScanners::default(), topic: None };
        self.channels.insert(packed.id, Some(of_clouds));
        Ok(Job::Copy(vec![schema, Record::Channel(packed)]))
    }

    /// A number that no schema or channel has.
    fn unused(&mut self) -> Result<u16> {
        // The format has no number 0 for schemas.
        let found = (1..=self.next).rev().find(|number| !self.used.contains(number));
        let found =
            found.ok_or_else(|| Error::over_limit("topics of clouds", u16::MAX.into(), u16::MAX.into()))?;
        self.next = found - 1;
        Ok(found)
    }
}

/// The numbers of all schemas and channels of a recording, from wherever the input is; it is at its first byte then.
/// Of a recording that is damaged, those up to there.
fn numbers_in(input: &mut (impl Read + Seek)) -> Result<HashSet<u16>> {
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

/// What a recording lists at its end, if it does.
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
            // No place in a recording is before its first byte.
            Ok(SummaryReadEvent::SeekRequest(to)) => match input.seek(to) {
                Ok(place) => reader.notify_seeked(place),
                Err(_) => return Ok(None),
            },
            Err(_) => return Ok(None),
        }
    }
    Ok(reader.finish())
}

/// The schema of compressed clouds, with this number.
fn compressed_schema(encoding: Encoding, id: u16) -> Record<'static> {
    let ([_, name], (kind, text)) = (encoding.schemas(), encoding.compressed_schema());
    let header = SchemaHeader { id, name: name.to_owned(), encoding: kind.to_owned() };
    Record::Schema { header, data: text.into_bytes().into() }
}

impl CloudChannel {
    /// How its clouds are compressed: by the scanner that is found in the first message that shows one.
    fn topic_of(&mut self, data: &[u8], config: &EncoderConfig) -> Result<Arc<PackedTopic>> {
        let frame = message::scan(data, self.encoding).map(|(scan, _)| FrameInput::scan(scan));
        let scanners = self.scanners.for_next(frame.as_ref(), config)?;
        if let Some(topic) = self.topic.as_ref().filter(|topic| Arc::ptr_eq(&topic.scanners, &scanners)) {
            return Ok(Arc::clone(topic));
        }
        let (encoding, others) = (self.encoding, self.others.clone());
        let topic = Arc::new(PackedTopic { config: config.clone(), scanners, encoding, others });
        self.topic = Some(Arc::clone(&topic));
        Ok(topic)
    }
}

impl PackedTopic {
    fn pack(&self, header: MessageHeader, data: Vec<u8>) -> Result<Done> {
        let Some((scan, stamp)) = message::scan(&data, self.encoding) else {
            let header = MessageHeader { channel_id: self.others.id, ..header };
            let message = Record::Message { header, data: data.into() };
            return Ok(Done {
                records: vec![Record::Channel(self.others.clone()), message],
                cloud: None,
                is_kept: true,
            });
        };
        let points = scan.records;
        let time = Time { source: TimeSource::Recording, nanoseconds: stamp };
        let stamp = Stamp { unit: Unit::Message, stream: 0, time: Some(time) };
        let payload =
            encode_known(vec![FrameInput::scan(scan).stamped(stamp)], &self.scanners, &self.config)?;
        let packed = message::compress(&data, self.encoding, &payload)?;
        Ok(Done::cloud(header, packed, points, data.len()))
    }
}

/// What unpacking knows of a recording.
#[derive(Default)]
struct Unpacking {
    /// Schemas of compressed clouds, which are written only if a channel that was not packed refers to them.
    compressed: HashMap<u16, Record<'static>>,
    /// The channels of compressed clouds.
    packed: HashMap<u16, Encoding>,
    /// Channels for what is no cloud, and those whose topic it is.
    others: HashMap<u16, u16>,
}

impl Unpacking {
    fn job(&mut self, record: Record<'static>) -> Result<Job> {
        match record {
            Record::Schema { header, data } => {
                let is_compressed = [Encoding::Cdr, Encoding::Ros1].into_iter().any(|encoding| {
                    let ([_, name], (_, text)) = (encoding.schemas(), encoding.compressed_schema());
                    header.name == name && *data == *text.as_bytes()
                });
                let id = header.id;
                let schema = Record::Schema { header, data };
                if is_compressed {
                    self.compressed.insert(id, schema);
                    return Ok(Job::Copy(Vec::new()));
                }
                Ok(Job::one(schema))
            }
            Record::Channel(channel) => self.channel(channel),
            Record::Message { header, data } => {
                if let Some(&encoding) = self.packed.get(&header.channel_id) {
                    return Ok(Job::Unpack { header, data: data.into_owned(), encoding });
                }
                let channel_id = self.others.get(&header.channel_id).copied().unwrap_or(header.channel_id);
                Ok(Job::one(Record::Message { header: MessageHeader { channel_id, ..header }, data }))
            }
            other => Ok(Job::one(other)),
        }
    }

    /// A channel as it was before it was packed.
    fn channel(&mut self, mut channel: Channel) -> Result<Job> {
        let number = |text: String| {
            text.parse::<u16>().map_err(|_| Error::corrupt("a channel that was packed by another program"))
        };
        if let Some(of) = channel.metadata.remove(CHANNEL_KEY) {
            self.others.insert(channel.id, number(of)?);
            return Ok(Job::Copy(Vec::new()));
        }
        if let Some(schema) = channel.metadata.remove(SCHEMA_KEY) {
            channel.schema_id = number(schema)?;
            let encoding = Encoding::of(&channel.message_encoding);
            let encoding =
                encoding.ok_or_else(|| Error::unsupported("a packed channel of another encoding"))?;
            self.packed.insert(channel.id, encoding);
        }
        let schema = self.compressed.remove(&channel.schema_id);
        Ok(Job::Copy(schema.into_iter().chain([Record::Channel(channel)]).collect()))
    }
}

fn unpack_message(header: MessageHeader, data: Vec<u8>, encoding: Encoding) -> Result<Done> {
    let Some(payload) = message::payload(&data, encoding) else {
        let record = Record::Message { header, data: data.into() };
        return Ok(Done { records: vec![record], cloud: None, is_kept: true });
    };
    let scan = Decoder::open(Cursor::new(payload))?.scan(0)?;
    let bytes = scan.file_bytes()?.ok_or_else(|| Error::corrupt("a payload that is no message"))?;
    Ok(Done::cloud(header, bytes, scan.len(), data.len()))
}

/// The clouds of a recording, packed or not, one after the other, each with its time and, if there are several topics, as a
/// stream of its own.
pub struct Clouds<'f, R> {
    records: Records<R>,
    filter: &'f TopicFilter,
    schemas: HashMap<u16, String>,
    /// Channels of clouds, and the number of the stream of each.
    channels: HashMap<u16, (Encoding, u8)>,
    /// What is wrong with the recording; it was taken up to there.
    pub cut_short: Option<String>,
}

impl<'f, R: Read> Clouds<'f, R> {
    /// Begins to read a recording.
    ///
    /// # Errors
    /// If it is none, or the input fails.
    pub fn open(input: R, filter: &'f TopicFilter) -> Result<Self> {
        let records = Records::open(input)?;
        Ok(Clouds { records, filter, schemas: HashMap::new(), channels: HashMap::new(), cut_short: None })
    }

    /// Takes note of a channel if its messages are clouds.
    fn channel(&mut self, channel: &Channel) {
        let Some(encoding) = Encoding::of(&channel.message_encoding) else { return };
        let schema = self.schemas.get(&channel.schema_id);
        let is_of_clouds = schema.is_some_and(|name| encoding.schemas().contains(&name.as_str()));
        if is_of_clouds && self.filter.takes(&channel.topic) && !self.channels.contains_key(&channel.id) {
            let stream = self.channels.len().min(usize::from(u8::MAX)) as u8;
            self.channels.insert(channel.id, (encoding, stream));
        }
    }

    /// A cloud of a message; none if it is none.
    fn cloud(&self, header: &MessageHeader, data: &[u8]) -> Result<Option<Scan>> {
        let Some(&(encoding, stream)) = self.channels.get(&header.channel_id) else { return Ok(None) };
        let unpacked = match message::payload(data, encoding) {
            Some(payload) => Decoder::open(Cursor::new(payload))?.scan(0)?.file_bytes()?,
            None => None,
        };
        let taken = message::scan(unpacked.as_deref().unwrap_or(data), encoding);
        let Some((scan, stamp)) = taken.and_then(|(scan, stamp)| Some((message::points(scan)?, stamp)))
        else {
            return Ok(None);
        };
        let time = Time { source: TimeSource::Recording, nanoseconds: stamp };
        Ok(Some(Scan::of_parts(scan, Stamp { unit: Unit::Points, stream, time: Some(time) })))
    }
}

impl<R: Read> Iterator for Clouds<'_, R> {
    type Item = Result<Scan>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.records.next()? {
                Ok(Record::Schema { header, .. }) => {
                    self.schemas.insert(header.id, header.name);
                }
                Ok(Record::Channel(channel)) => self.channel(&channel),
                Ok(Record::Message { header, data }) => match self.cloud(&header, &data).transpose() {
                    Some(cloud) => return Some(cloud),
                    None => continue,
                },
                Ok(_) => {}
                Err(error) => {
                    self.cut_short = Some(error.to_string());
                    return None;
                }
            }
        }
    }
}

/// What a recording holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Its channels, in the order in which they first stand in it.
    pub topics: Vec<Topic>,
    /// Attachments and records of metadata.
    pub attachments: u64,
    /// What is wrong with the recording from there on.
    pub cut_short: Option<String>,
}

/// A channel of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// Its topic.
    pub name: String,
    /// The name of its schema.
    pub schema: String,
    /// Its messages.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Of these, compressed clouds.
    pub clouds: u64,
    /// Points of these; 0 if they were not decoded.
    pub points: u64,
    /// Bytes of these before they were compressed; 0 if they were not decoded.
    pub cloud_bytes: u64,
}

/// Lists what a recording holds, as far as it is whole; if `decodes`, every compressed cloud is decoded. `on_message` is
/// called for each message.
///
/// # Errors
/// If the input is no recording, or fails; if a payload is damaged.
pub fn examine(
    input: impl Read + Send,
    decodes: bool,
    threads: usize,
    on_message: &(dyn Fn() + Sync),
) -> Result<Contents> {
    let mut records = Records::open(input)?;
    let (mut schemas, mut places) = (HashMap::new(), HashMap::new());
    let (topics, rest) = (Mutex::new(Vec::<Topic>::new()), Mutex::new((0, None)));
    let locked = || topics.lock().unwrap_or_else(PoisonError::into_inner);
    let jobs = std::iter::from_fn(|| {
        loop {
            match records.next()? {
                Ok(Record::Schema { header, .. }) => drop(schemas.insert(header.id, header.name)),
                Ok(Record::Channel(Channel { id, schema_id, topic: name, message_encoding, .. })) => {
                    let schema = schemas.get(&schema_id).cloned().unwrap_or_default();
                    places.entry(id).or_insert_with(|| {
                        let mut topics = locked();
                        topics.push(Topic { name, schema, ..Topic::default() });
                        (topics.len() - 1, Encoding::of(&message_encoding))
                    });
                }
                Ok(Record::Message { header, data }) => {
                    let Some(&(place, encoding)) = places.get(&header.channel_id) else { continue };
                    return Some(Ok((place, encoding, header, data.into_owned())));
                }
                Ok(Record::Attachment { .. } | Record::Metadata(_)) => {
                    rest.lock().unwrap_or_else(PoisonError::into_inner).0 += 1;
                }
                Ok(_) => {}
                Err(error) => {
                    rest.lock().unwrap_or_else(PoisonError::into_inner).1 = Some(error.to_string());
                    return None;
                }
            }
        }
    });
    let work = |(place, encoding, header, data): (usize, Option<Encoding>, MessageHeader, Vec<u8>)| {
        let bytes = data.len() as u64;
        let is_compressed = encoding.is_some_and(|encoding| message::payload(&data, encoding).is_some());
        let cloud = match encoding.filter(|_| decodes && is_compressed) {
            Some(encoding) => unpack_message(header, data, encoding)?.cloud,
            None => None,
        };
        Ok((place, bytes, is_compressed, cloud))
    };
    run_ordered(resolve_threads(threads), jobs.fuse(), work, |(place, bytes, is_compressed, cloud)| {
        let topic = &mut locked()[place];
        topic.messages += 1;
        topic.bytes += bytes;
        topic.clouds += u64::from(is_compressed);
        if let Some((points, [_, before])) = cloud {
            topic.points += points;
            topic.cloud_bytes += before;
        }
        on_message();
        Ok(())
    })?;
    let topics = topics.into_inner().unwrap_or_else(PoisonError::into_inner);
    let (attachments, cut_short) = rest.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(Contents { topics, attachments, cut_short })
}

/// Compares two recordings: how many messages they hold, if these are the same, one after the other: topic, sequence number,
/// times and bytes. 0 if not.
///
/// # Errors
/// If one of them is no recording, or an input fails.
pub fn same_messages(a: impl Read, b: impl Read) -> Result<u64> {
    let (mut a, mut b) = (messages(Records::open(a)?), messages(Records::open(b)?));
    let mut count = 0;
    loop {
        match (a.next(), b.next()) {
            (None, None) => return Ok(count),
            (Some(a), Some(b)) if a == b => count += 1,
            _ => return Ok(0),
        }
    }
}

/// The messages of a recording as far as it is whole, each with its topic.
fn messages<R: Read>(records: Records<R>) -> impl Iterator<Item = (String, MessageHeader, Vec<u8>)> {
    let mut topics = HashMap::new();
    records.map_while(Result::ok).filter_map(move |record| match record {
        Record::Channel(channel) => {
            topics.insert(channel.id, channel.topic);
            None
        }
        Record::Message { header, data } => {
            let topic = topics.get(&header.channel_id).cloned().unwrap_or_default();
            Some((topic, header, data.into_owned()))
        }
        _ => None,
    })
}

/// The records of a recording up to the end of its data, out of their chunks.
struct Records<R> {
    input: R,
    reader: LinearReader,
    header: Header,
    has_ended: bool,
}

impl<R: Read> Records<R> {
    fn open(input: R) -> Result<Self> {
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
struct Output<W: Write + Seek> {
    writer: Writer<W>,
}

impl<W: Write + Seek> Output<W> {
    fn create(out: W, header: Header) -> Result<Self> {
        let options =
            WriteOptions::new().profile(header.profile).library(header.library).compression_threads(0);
        Ok(Output { writer: options.create(out).map_err(failed)? })
    }

    fn write(&mut self, record: Record<'static>) -> Result<()> {
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
            // The writer makes its own.
            _ => Ok(()),
        };
        written.map_err(failed)
    }

    fn finish(mut self) -> Result<()> {
        self.writer.finish().map(drop).map_err(failed)
    }
}

/// The first number of records that the format leaves to programs.
const FIRST_PRIVATE: u8 = 0x80;
