//! What a recording holds: its clouds as scans, its topics, and whether another holds the same.

use std::collections::HashMap;
use std::io::Read;
use std::sync::{Mutex, PoisonError};

use mcap::records::{Channel, MessageHeader, Record};

use super::message::{self, Encoding};
use super::pack::unpacked;
use super::records::Records;
use crate::container::{Stamp, Time, TimeSource, Unit};
use crate::frame::settings::resolve_threads;
use crate::ground::error::Result;
use crate::library::Scan;
use crate::stream::ordered::run_ordered;

/// Which topics of clouds are meant.
#[derive(Clone, Debug, Default)]
pub struct TopicFilter {
    /// These; all if it is empty.
    pub topics: Vec<String>,
}

impl TopicFilter {
    pub(super) fn takes(&self, topic: &str) -> bool {
        self.topics.is_empty() || self.topics.iter().any(|wanted| wanted == topic)
    }
}

/// The clouds of a recording, packed or not, one after the other, each with its time and, if there are several topics, as a
/// track of its own.
pub struct Clouds<'f, R> {
    records: Records<R>,
    filter: &'f TopicFilter,
    schemas: HashMap<u16, String>,
    /// Channels of clouds, and the number of the track of each.
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
            let track = self.channels.len().min(usize::from(u8::MAX)) as u8;
            self.channels.insert(channel.id, (encoding, track));
        }
    }

    /// A cloud of a message; none if it is none.
    fn cloud(&self, header: &MessageHeader, data: &[u8]) -> Result<Option<Scan>> {
        let Some(&(encoding, track)) = self.channels.get(&header.channel_id) else { return Ok(None) };
        let unpacked = unpacked(data, encoding)?;
        let message = unpacked.as_ref().map_or(data, |(message, _)| message);
        let taken = message::scan(message, encoding);
        let Some((scan, stamp)) = taken.and_then(|(scan, stamp)| Some((message::points(scan)?, stamp)))
        else {
            return Ok(None);
        };
        let time = Time { source: TimeSource::Recording, nanoseconds: stamp };
        Ok(Some(Scan::of_parts(scan, Stamp { unit: Unit::Points, track, time: Some(time) })))
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
                    return Some(Ok((place, encoding, data.into_owned())));
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
    let work = |(place, encoding, data): (usize, Option<Encoding>, Vec<u8>)| {
        let bytes = data.len() as u64;
        let is_compressed = encoding.is_some_and(|encoding| message::payload(&data, encoding).is_some());
        let cloud = match encoding.filter(|_| decodes && is_compressed) {
            Some(encoding) => unpacked(&data, encoding)?.map(|(message, points)| (points, message.len())),
            None => None,
        };
        Ok((place, bytes, is_compressed, cloud))
    };
    run_ordered(resolve_threads(threads), jobs.fuse(), work, |(place, bytes, is_compressed, cloud)| {
        let topic = &mut locked()[place];
        topic.messages += 1;
        topic.bytes += bytes;
        topic.clouds += u64::from(is_compressed);
        if let Some((points, before)) = cloud {
            topic.points += points as u64;
            topic.cloud_bytes += before as u64;
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
