//! Recordings with clouds as compressed messages: copied record by record, in both directions.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::io::{Cursor, Read, Seek, Write};
use std::sync::Arc;

use mcap::records::{Channel, MessageHeader, Record, SchemaHeader};

use super::contents::{TopicFilter, damaged_cloud};
use super::message::{self, Encoding};
use super::records::{Faults, Output, Records, numbers_in};
use crate::container::{FrameKind, Stamp, Time, TimeSource};
use crate::frame::settings::EncoderConfig;
use crate::frame::{IntensityFidelity, PositionFidelity};
use crate::ground::error::{Error, Limits, Result};
use crate::library::{Decoder, Settings};
use crate::stream::FrameInput;
use crate::stream::encoder::encode_known;
use crate::stream::ordered::run_ordered;
use crate::stream::scanner_choice::{DriveScanners, KeptScanners};

/// Keys of the channel metadata in a packed recording: for a channel of clouds, the number of the schema that
/// it had; for a channel of messages that are not clouds, the number of the channel to which they belong.
const SCHEMA_KEY: &str = "lidarpc.schema";
const CHANNEL_KEY: &str = "lidarpc.channel";

/// Numbers of what was copied.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct CopySummary {
    /// All messages.
    pub messages: u64,
    /// Clouds among them that were compressed, or compressed clouds that were decoded.
    pub clouds: u64,
    /// Messages in topics of clouds that lidarpc could not parse as clouds and copied unchanged.
    pub kept: u64,
    /// Bytes of the messages of compressed or decoded clouds, before that.
    pub cloud_bytes_before: u64,
    /// Bytes of the same messages after it.
    pub cloud_bytes_after: u64,
    /// Points of the clouds.
    pub points: u64,
    /// Attachments and metadata records.
    pub attachments: u64,
    /// The topics whose clouds were to be compressed.
    pub topics: BTreeSet<String>,
    /// What is wrong with the recording or its compressed clouds; this was left out.
    pub damage: Option<String>,
}

/// Copies a recording from its first byte on and compresses its clouds. `on_message` is called for each
/// message that is written. The input is scanned in advance, so that the schemas and channels that packing
/// adds get numbers that the recording uses nowhere.
///
/// # Errors
/// If the input is not a recording or is already packed, if the input or the output fails, or if the settings
/// are invalid or those of paper mode. Of a recording that is truncated or damaged, all that can be read is
/// copied: see [`CopySummary::damage`].
pub fn pack<W: Write + Seek>(
    mut input: impl Read + Seek + Send,
    out: W,
    settings: &Settings,
    filter: &TopicFilter,
    on_message: &(dyn Fn() + Sync),
) -> Result<CopySummary> {
    let config = &settings.config()?;
    if config.positions == PositionFidelity::Formula || config.intensity == IntensityFidelity::None {
        return Err(Error::InvalidSettings(
            "paper mode drops points and intensities, which messages keep".to_owned(),
        ));
    }
    let used = numbers_in(&mut input)?;
    let (schemas, channels) = (HashMap::new(), HashMap::new());
    let topics = BTreeSet::new();
    let mut packing = Packing { config, filter, schemas, channels, topics, used, next: u16::MAX };
    let copied = copy(input, out, config.threads, |record| packing.job(record), on_message)?;
    Ok(CopySummary { topics: packing.topics, ..copied })
}

/// Copies a packed recording and restores its clouds. Clouds that are damaged, or exceed the limits, are left
/// out: see [`CopySummary::damage`].
///
/// # Errors
/// If the input is not a recording, or if the input or the output fails.
pub fn unpack<W: Write + Seek>(
    input: impl Read + Send,
    out: W,
    threads: usize,
    limits: Limits,
    on_message: &(dyn Fn() + Sync),
) -> Result<CopySummary> {
    let mut unpacking = Unpacking { limits, ..Unpacking::default() };
    copy(input, out, threads, |record| unpacking.job(record), on_message)
}

/// How a record is processed.
enum Job {
    /// The records are written as they are.
    Copy(Vec<Record<'static>>),
    /// A cloud is compressed.
    Pack { header: MessageHeader, data: Vec<u8>, topic: Arc<PackedTopic> },
    /// A compressed cloud is decoded.
    Unpack { header: MessageHeader, data: Vec<u8>, encoding: Encoding, limits: Limits },
}

impl Job {
    fn one(record: Record<'static>) -> Self {
        Job::Copy(vec![record])
    }

    /// Executes the job, on any thread.
    fn done(self) -> Result<Done> {
        match self {
            Job::Copy(records) => Ok(Done { records, ..Done::default() }),
            Job::Pack { header, data, topic } => topic.pack(header, data),
            Job::Unpack { header, data, encoding, limits } => {
                Ok(unpack_message(header, data, encoding, limits))
            }
        }
    }
}

/// The result of a job.
#[derive(Default)]
struct Done {
    records: Vec<Record<'static>>,
    /// For a cloud: its points, and its bytes before and after.
    cloud: Option<(u64, [u64; 2])>,
    /// Whether it is a message of a topic of clouds that is not a cloud.
    is_kept: bool,
    /// Why a compressed cloud is left out.
    fault: Option<String>,
}

impl Done {
    fn cloud(header: MessageHeader, data: Vec<u8>, points: usize, before: usize) -> Self {
        let bytes = [before, data.len()].map(|bytes| bytes as u64);
        let record = Record::Message { header, data: data.into() };
        Done { records: vec![record], cloud: Some((points as u64, bytes)), ..Done::default() }
    }
}

/// Copies a recording, record by record, in parallel.
fn copy<W: Write + Seek>(
    input: impl Read + Send,
    out: W,
    threads: usize,
    mut job: impl FnMut(Record<'static>) -> Result<Job> + Send,
    on_message: &(dyn Fn() + Sync),
) -> Result<CopySummary> {
    let mut records = Records::open(input)?;
    let mut out = Output::create(out, records.header.clone())?;
    let mut copied = CopySummary::default();
    let mut faults = Faults::default();
    let jobs = std::iter::from_fn(|| Some(records.next()?.and_then(&mut job)));
    run_ordered(threads, jobs.fuse(), Job::done, |done| {
        if let Some((points, [before, after])) = done.cloud {
            copied.clouds += 1;
            copied.points += points;
            copied.cloud_bytes_before += before;
            copied.cloud_bytes_after += after;
        }
        copied.kept += u64::from(done.is_kept);
        if let Some(fault) = done.fault {
            faults.add(fault);
        }
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
    copied.damage = records.faults.and(faults).in_words();
    Ok(copied)
}

/// The state of packing a recording.
struct Packing<'a> {
    config: &'a EncoderConfig,
    filter: &'a TopicFilter,
    /// The names of the schemas.
    schemas: HashMap<u16, String>,
    /// All channels so far; for channels of clouds, what is needed to pack them.
    channels: HashMap<u16, Option<CloudChannel>>,
    /// The topics of the latter.
    topics: BTreeSet<String>,
    /// The numbers of all schemas and channels of the recording.
    used: HashSet<u16>,
    /// The highest number that an added schema or channel may get.
    next: u16,
}

/// A channel of clouds.
struct CloudChannel {
    encoding: Encoding,
    /// The channel for messages of the topic that are not clouds.
    others: Channel,
    scanners: KeptScanners,
    /// The settings for the last message.
    topic: Option<Arc<PackedTopic>>,
}

/// How the clouds of a channel are compressed.
struct PackedTopic {
    config: EncoderConfig,
    scanners: Arc<DriveScanners>,
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

    /// A channel; if its messages are clouds, with the schema of compressed clouds.
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
        self.topics.insert(channel.topic.clone());
        let mut others = Channel { id: self.unused()?, ..channel.clone() };
        others.metadata.insert(CHANNEL_KEY.to_owned(), channel.id.to_string());
        let schema_id = self.unused()?;
        let schema = schema(encoding, true, schema_id);
        let mut packed = Channel { schema_id, ..channel };
        packed.metadata.insert(SCHEMA_KEY.to_owned(), others.schema_id.to_string());
        let of_clouds = CloudChannel { encoding, others, scanners: KeptScanners::default(), topic: None };
        self.channels.insert(packed.id, Some(of_clouds));
        Ok(Job::Copy(vec![schema, Record::Channel(packed)]))
    }

    /// A number that no schema or channel uses.
    fn unused(&mut self) -> Result<u16> {
        // The format reserves the number 0 of schemas.
        let found = (1..=self.next).rev().find(|number| !self.used.contains(number));
        let found = found.ok_or_else(|| {
            Error::Usage(
                "the recording has no number left for the schemas and channels of packed clouds".to_owned(),
            )
        })?;
        self.next = found - 1;
        Ok(found)
    }
}

/// The schema of clouds or of compressed clouds, with this number.
fn schema(encoding: Encoding, is_compressed: bool, id: u16) -> Record<'static> {
    let (names, (kind, text)) = (encoding.schemas(), encoding.schema(is_compressed));
    let name = names[usize::from(is_compressed)];
    let header = SchemaHeader { id, name: name.to_owned(), encoding: kind.to_owned() };
    Record::Schema { header, data: text.into_bytes().into() }
}

impl CloudChannel {
    /// How its clouds are compressed: with the scanner of the first message to which one can be fitted.
    fn topic_of(&mut self, data: &[u8], config: &EncoderConfig) -> Result<Arc<PackedTopic>> {
        let frame = || message::scan(data, self.encoding).map(|(scan, _)| FrameInput::scan(scan));
        let scanners = self.scanners.for_next(frame, config)?;
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
            let records = vec![Record::Channel(self.others.clone()), message];
            return Ok(Done { records, is_kept: true, ..Done::default() });
        };
        let points = scan.records;
        let time = Time { source: TimeSource::Recording, nanoseconds: stamp };
        let stamp = Stamp { kind: FrameKind::Message, track: 0, time: Some(time) };
        let payload =
            encode_known(vec![FrameInput::scan(scan).stamped(stamp)], &self.scanners, &self.config)?;
        let packed = message::compress(&data, self.encoding, &payload)?;
        Ok(Done::cloud(header, packed, points, data.len()))
    }
}

/// The state of unpacking a recording.
#[derive(Default)]
struct Unpacking {
    /// Those of each cloud.
    limits: Limits,
    /// Schemas of compressed clouds, which are written only if a channel that was not packed refers to them.
    compressed: HashMap<u16, Record<'static>>,
    /// The names of all other schemas.
    schemas: HashMap<u16, String>,
    /// The channels of compressed clouds.
    packed: HashMap<u16, Encoding>,
    /// Channels for messages that are not clouds, and the channels of the topics to which they belong.
    others: HashMap<u16, u16>,
}

impl Unpacking {
    fn job(&mut self, record: Record<'static>) -> Result<Job> {
        match record {
            Record::Schema { header, data } => {
                let is_compressed = [Encoding::Cdr, Encoding::Ros1].into_iter().any(|encoding| {
                    let ([_, name], (_, text)) = (encoding.schemas(), encoding.schema(true));
                    header.name == name && *data == *text.as_bytes()
                });
                let (id, name) = (header.id, header.name.clone());
                let schema = Record::Schema { header, data };
                if is_compressed {
                    self.compressed.insert(id, schema);
                    return Ok(Job::Copy(Vec::new()));
                }
                self.schemas.insert(id, name);
                Ok(Job::one(schema))
            }
            Record::Channel(channel) => self.channel(channel),
            Record::Message { header, data } => {
                if let Some(&encoding) = self.packed.get(&header.channel_id) {
                    let (data, limits) = (data.into_owned(), self.limits);
                    return Ok(Job::Unpack { header, data, encoding, limits });
                }
                let channel_id = self.others.get(&header.channel_id).copied().unwrap_or(header.channel_id);
                Ok(Job::one(Record::Message { header: MessageHeader { channel_id, ..header }, data }))
            }
            other => Ok(Job::one(other)),
        }
    }

    /// A channel as it was before packing.
    fn channel(&mut self, mut channel: Channel) -> Result<Job> {
        let number = |text: String| {
            text.parse::<u16>().map_err(|_| Error::corrupt("a channel that was packed by another program"))
        };
        if let Some(of) = channel.metadata.remove(CHANNEL_KEY) {
            self.others.insert(channel.id, number(of)?);
            return Ok(Job::Copy(Vec::new()));
        }
        if let Some(of_clouds) = channel.metadata.remove(SCHEMA_KEY) {
            let of_clouds = number(of_clouds)?;
            let encoding = Encoding::of(&channel.message_encoding);
            let encoding =
                encoding.ok_or_else(|| Error::unsupported("a packed channel of another encoding"))?;
            self.packed.insert(channel.id, encoding);
            // Other programs drop schemas that no channel uses, and number schemas anew.
            if self.schemas.get(&of_clouds).is_some_and(|name| name == encoding.schemas()[0]) {
                channel.schema_id = of_clouds;
            } else {
                let schema = schema(encoding, false, channel.schema_id);
                return Ok(Job::Copy(vec![schema, Record::Channel(channel)]));
            }
        }
        let schema = self.compressed.remove(&channel.schema_id);
        Ok(Job::Copy(schema.into_iter().chain([Record::Channel(channel)]).collect()))
    }
}

fn unpack_message(header: MessageHeader, data: Vec<u8>, encoding: Encoding, limits: Limits) -> Done {
    match unpacked(&data, encoding, limits) {
        Ok(Some((message, points))) => Done::cloud(header, message, points, data.len()),
        Ok(None) => {
            let records = vec![Record::Message { header, data: data.into() }];
            Done { records, is_kept: true, ..Done::default() }
        }
        Err(error) => Done { fault: Some(damaged_cloud(&header, &error)), ..Done::default() },
    }
}

/// The message that a compressed message decodes to, and its number of points; `None` if it is not
/// compressed.
///
/// # Errors
/// If the payload is damaged or does not contain a message.
pub fn unpacked(message: &[u8], encoding: Encoding, limits: Limits) -> Result<Option<(Vec<u8>, usize)>> {
    let Some(payload) = message::payload(message, encoding) else { return Ok(None) };
    let scan = Decoder::open_with_limits(Cursor::new(payload), limits)?.scan(0)?;
    let bytes = scan.file_bytes()?.ok_or_else(|| Error::corrupt("a payload that is no message"))?;
    Ok(Some((bytes, scan.len())))
}
