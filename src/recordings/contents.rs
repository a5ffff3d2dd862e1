//! The contents of a recording: its clouds as scans, its topics, and whether another recording has the same
//! messages.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Read;
use std::sync::{Mutex, PoisonError};

use mcap::records::{Channel, MessageHeader, Record};

use super::message::{self, Encoding};
use super::pack::unpacked;
use super::records::{Faults, Records};
use crate::container::{self, FrameKind, Stamp, StreamReader, Time, TimeSource};
use crate::files::names::is_safe_path;
use crate::frame::FrameParameters;
use crate::ground::error::{Error, Limits, Result};
use crate::ground::team::locked;
use crate::library::Scan;
use crate::stream::ordered::run_ordered;

/// A selection of topics with clouds.
#[derive(Clone, Debug, Default)]
pub struct TopicFilter {
    /// The selected topics; all if it is empty.
    pub topics: Vec<String>,
}

impl TopicFilter {
    pub(super) fn takes(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.iter().any(|wanted| wanted == topic)
    }
}

/// The clouds of a recording, compressed or not, one after another, each with its time. The name of each is
/// that of a folder for its topic, such as `front/points/`. If several channels have clouds, each is a track of
/// its own. What is damaged is left out: see [`damage`](Self::damage). If the input fails, its error is the
/// last item.
pub struct Clouds<'f, R> {
    records: Records<R>,
    filter: &'f TopicFilter,
    /// Those of each compressed cloud.
    limits: Limits,
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, CloudChannel>,
    /// The topics of these channels.
    pub topics: BTreeSet<String>,
    /// Number of messages on these channels so far that are no clouds with coordinates.
    pub left_out: u64,
}

/// A channel of clouds.
struct CloudChannel {
    encoding: Encoding,
    track: u8,
    /// The name of its clouds.
    folder: String,
}

impl<'f, R: Read> Clouds<'f, R> {
    /// Opens a recording. Compressed clouds that exceed the limits are left out.
    ///
    /// # Errors
    /// If the input is not a recording, or fails.
    pub fn open(input: R, filter: &'f TopicFilter, limits: Limits) -> Result<Self> {
        let records = Records::open(input)?;
        Ok(Clouds {
            records,
            filter,
            limits,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            topics: BTreeSet::new(),
            left_out: 0,
        })
    }

    /// What is wrong with the recording and its clouds, as far as it has been read.
    pub fn damage(&self) -> Option<String> {
        self.records.faults.clone().in_words()
    }

    /// Registers a channel if its messages are clouds.
    fn channel(&mut self, channel: &Channel) {
        let Some(encoding) = Encoding::of(&channel.message_encoding) else { return };
        let schema = self.schemas.get(&channel.schema_id);
        let is_of_clouds = schema.is_some_and(|name| encoding.schemas().contains(&name.as_str()));
        if is_of_clouds && self.filter.takes(&channel.topic) && !self.channels.contains_key(&channel.id) {
            let track = self.channels.len().min(usize::from(u8::MAX)) as u8;
            let folder = folder_of(&channel.topic);
            self.channels.insert(channel.id, CloudChannel { encoding, track, folder });
            self.topics.insert(channel.topic.clone());
        }
    }

    /// The cloud in a message; `None` if the message is not a cloud, or a damaged one.
    fn cloud(&mut self, header: &MessageHeader, data: &[u8]) -> Option<Scan> {
        let &CloudChannel { encoding, track, ref folder } = self.channels.get(&header.channel_id)?;
        let unpacked = match unpacked(data, encoding, self.limits) {
            Ok(unpacked) => unpacked,
            Err(error) => {
                self.records.faults.add(damaged_cloud(header, &error));
                return None;
            }
        };
        let message = unpacked.as_ref().map_or(data, |(message, _)| message);
        let taken = message::scan(message, encoding);
        let Some((mut scan, stamp)) = taken.and_then(|(scan, stamp)| Some((message::points(scan)?, stamp)))
        else {
            self.left_out += 1;
            return None;
        };
        scan.name.clone_from(folder);
        let time = Time { source: TimeSource::Recording, nanoseconds: stamp };
        Some(Scan::of_parts(scan, Stamp { kind: FrameKind::Points, track, time: Some(time) }))
    }
}

impl<R: Read> Iterator for Clouds<'_, R> {
    type Item = Result<Scan>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.records.next()? {
                Ok(Record::Schema { header, .. }) => drop(self.schemas.insert(header.id, header.name)),
                Ok(Record::Channel(channel)) => self.channel(&channel),
                Ok(Record::Message { header, data }) => {
                    if let Some(cloud) = self.cloud(&header, &data) {
                        return Some(Ok(cloud));
                    }
                }
                Ok(_) => {}
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The path of a folder for the clouds of a topic, with `_` for characters that not every file can have in its
/// name, and a `/` at the end.
fn folder_of(topic: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.' | '/');
    let topic: String = topic.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    let folder = topic.split('/').filter(|name| !name.is_empty()).collect::<Vec<_>>().join("/");
    format!("{}/", if is_safe_path(&folder) { &folder } else { "clouds" })
}

/// The fault of a compressed cloud that cannot be decoded.
pub(super) fn damaged_cloud(header: &MessageHeader, error: &Error) -> String {
    let MessageHeader { sequence, channel_id, .. } = header;
    format!("cloud {sequence} of channel {channel_id} is left out: {error}")
}

/// The contents of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Contents {
    /// Its channels, in the order of their first records.
    pub topics: Vec<Topic>,
    /// Number of attachments and metadata records.
    pub attachments: u64,
    /// What is wrong with the recording and its clouds.
    pub damage: Option<String>,
}

/// A channel of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Topic {
    /// Its topic.
    pub name: String,
    /// The name of its schema.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
    /// Bytes of these messages.
    pub bytes: u64,
    /// Number of messages that are compressed clouds.
    pub clouds: u64,
    /// Points of these clouds; 0 if they were not decoded.
    pub points: u64,
    /// Bytes of these clouds before compression; 0 if they were not decoded.
    pub cloud_bytes: u64,
    /// The number of these clouds by how accurately they are restored; empty if they were not decoded.
    pub fidelity: BTreeMap<String, u64>,
}

/// Lists the contents of a recording; with limits, every compressed cloud is decoded within them.
/// `on_message` is called for each message.
///
/// # Errors
/// If the input is not a recording, or fails.
pub fn examine(
    input: impl Read + Send,
    decoding: Option<Limits>,
    threads: usize,
    on_message: &(dyn Fn() + Sync),
) -> Result<Contents> {
    let mut records = Records::open(input)?;
    let (mut schemas, mut places) = (HashMap::new(), HashMap::new());
    let (topics, mut attachments) = (Mutex::new(Vec::<Topic>::new()), 0);
    let jobs = std::iter::from_fn(|| {
        loop {
            let record = match records.next()? {
                Ok(record) => record,
                Err(error) => return Some(Err(error)),
            };
            match record {
                Record::Schema { header, .. } => drop(schemas.insert(header.id, header.name)),
                Record::Channel(Channel { id, schema_id, topic: name, message_encoding, .. }) => {
                    let schema = schemas.get(&schema_id).cloned().unwrap_or_default();
                    places.entry(id).or_insert_with(|| {
                        let mut topics = locked(&topics);
                        topics.push(Topic { name, schema, ..Topic::default() });
                        (topics.len() - 1, Encoding::of(&message_encoding))
                    });
                }
                Record::Message { header, data } => {
                    let Some(&(place, encoding)) = places.get(&header.channel_id) else { continue };
                    return Some(Ok((place, encoding, header, data.into_owned())));
                }
                Record::Attachment { .. } | Record::Metadata(_) => attachments += 1,
                _ => {}
            }
        }
    });
    let work = |(place, encoding, header, data): (usize, Option<Encoding>, MessageHeader, Vec<u8>)| {
        let bytes = data.len() as u64;
        let is_compressed = encoding.is_some_and(|encoding| message::payload(&data, encoding).is_some());
        let counted = match (decoding, encoding.filter(|_| is_compressed)) {
            (Some(limits), Some(encoding)) => {
                measure(&data, encoding, limits).map_err(|error| damaged_cloud(&header, &error))
            }
            _ => Ok(None),
        };
        Ok((place, bytes, is_compressed, counted))
    };
    let mut faults = Faults::default();
    run_ordered(threads, jobs.fuse(), work, |(place, bytes, is_compressed, cloud)| {
        let topic = &mut locked(&topics)[place];
        topic.messages += 1;
        topic.bytes += bytes;
        topic.clouds += u64::from(is_compressed);
        match cloud {
            Ok(Some(Measured { points, bytes, fidelity })) => {
                topic.points += points as u64;
                topic.cloud_bytes += bytes as u64;
                *topic.fidelity.entry(fidelity).or_default() += 1;
            }
            Ok(None) => {}
            Err(fault) => faults.add(fault),
        }
        on_message();
        Ok(())
    })?;
    let topics = topics.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok(Contents { topics, attachments, damage: records.faults.and(faults).in_words() })
}

/// A compressed cloud that was decoded.
struct Measured {
    points: usize,
    /// Its bytes before compression.
    bytes: usize,
    /// How accurately it is restored, in words.
    fidelity: String,
}

/// Decodes a compressed cloud; `None` for a message that is not one.
///
/// # Errors
/// If it is damaged or exceeds the limits.
fn measure(message: &[u8], encoding: Encoding, limits: Limits) -> Result<Option<Measured>> {
    let Some((decoded, points)) = unpacked(message, encoding, limits)? else { return Ok(None) };
    let payload = message::payload(message, encoding).unwrap_or_default();
    let mut reader = StreamReader::open(payload, limits)?;
    let mut fidelity = String::new();
    while let Some(record) = reader.next_record()? {
        if let container::Record::Group(group) = record
            && let Some(frame) = group.frames.first()
        {
            fidelity = FrameParameters::of(frame)?.fidelity();
        }
    }
    Ok(Some(Measured { points, bytes: decoded.len(), fidelity }))
}

/// Compares the messages of two recordings in order: topic, sequence number, times and bytes. Returns their
/// number if all of them are the same.
///
/// # Errors
/// If one of them is not a recording, or an input fails.
pub fn same_messages(a: impl Read, b: impl Read) -> Result<Option<u64>> {
    let (mut a, mut b) = (messages(Records::open(a)?), messages(Records::open(b)?));
    let mut count = 0;
    loop {
        match (a.next().transpose()?, b.next().transpose()?) {
            (None, None) => return Ok(Some(count)),
            (Some(a), Some(b)) if a == b => count += 1,
            _ => return Ok(None),
        }
    }
}

/// A message with its topic.
type TopicMessage = (String, MessageHeader, Vec<u8>);

/// The messages of a recording.
fn messages<R: Read>(records: Records<R>) -> impl Iterator<Item = Result<TopicMessage>> {
    let mut topics = HashMap::new();
    records.filter_map(move |record| match record {
        Ok(Record::Channel(channel)) => {
            topics.insert(channel.id, channel.topic);
            None
        }
        Ok(Record::Message { header, data }) => {
            let topic = topics.get(&header.channel_id).cloned().unwrap_or_default();
            Some(Ok((topic, header, data.into_owned())))
        }
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    })
}
