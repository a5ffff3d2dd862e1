//! The groups of a stream that hold the frames asked for, each with its sensor model: as they arrive,
//! or by the index.

use std::io::{Read, Seek};
use std::sync::Arc;

use super::options::FrameRange;
use crate::ground::error::{Error, Result};
use crate::scanner::SensorModel;
use crate::stream::container::{Group, IndexedReader, Record, StreamReader};

/// A group, with all that it takes to decode or to copy it.
pub struct GroupJob {
    /// Number of its first frame in the sequence.
    pub first_frame: u64,
    /// The sensor model, if the group has one.
    pub sensor: Option<Arc<StoredSensor>>,
    pub group: Group,
}

/// A sensor model, and the payload of its record.
pub struct StoredSensor {
    pub model: SensorModel,
    pub record: Vec<u8>,
}

impl StoredSensor {
    pub(crate) fn parse(record: Vec<u8>) -> Result<Arc<Self>> {
        let mut rest = &record[..];
        let model = SensorModel::read_from(&mut rest).map_err(|e| e.within("sensor model"))?;
        if !rest.is_empty() {
            return Err(Error::corrupt("sensor model: bytes left over"));
        }
        Ok(Arc::new(StoredSensor { model, record }))
    }
}

/// The groups of a stream as they arrive.
pub struct StreamedGroups<R> {
    reader: StreamReader<R>,
    /// The sensor models so far, in order.
    sensors: Vec<Arc<StoredSensor>>,
    range: FrameRange,
}

impl<R: Read> StreamedGroups<R> {
    /// From the first on.
    pub fn new(reader: StreamReader<R>, range: FrameRange) -> Self {
        StreamedGroups { reader, sensors: Vec::new(), range }
    }

    /// Frames in all groups so far, wanted or not; after the last group, those of the stream.
    pub fn frame_count(&self) -> u64 {
        self.reader.index().frame_count()
    }

    fn next_job(&mut self) -> Result<Option<GroupJob>> {
        while let Some(record) = self.reader.next_record()? {
            match record {
                Record::SensorModel(bytes) => self.sensors.push(StoredSensor::parse(bytes)?),
                Record::Group(group) => {
                    let first_frame = self.frame_count() - group.frames.len() as u64;
                    if self.range.overlaps(first_frame, group.frames.len() as u64) {
                        let sensor = sensor_place(&group).and_then(|place| self.sensors.get(place)).cloned();
                        return Ok(Some(GroupJob { first_frame, sensor, group }));
                    }
                }
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

/// The groups that hold the frames asked for, read where the index says.
pub struct IndexedGroups<R> {
    reader: IndexedReader<R>,
    /// The sensor models, once they were read.
    sensors: Vec<Option<Arc<StoredSensor>>>,
    range: FrameRange,
    /// The next group's place in the index.
    place: usize,
}

impl<R: Read + Seek> IndexedGroups<R> {
    /// From the first on.
    pub fn new(reader: IndexedReader<R>, range: FrameRange) -> Self {
        let mut sensors = Vec::new();
        sensors.resize(reader.index().sensor_models.len(), None);
        IndexedGroups { reader, sensors, range, place: 0 }
    }

    fn next_job(&mut self) -> Result<Option<GroupJob>> {
        while let Some(entry) = self.reader.index().groups.get(self.place) {
            let (first_frame, count) = (entry.first_frame, entry.frame_sizes.len() as u64);
            let place = self.place;
            self.place += 1;
            if self.range.overlaps(first_frame, count) {
                let group = self.reader.read_group(place)?;
                return Ok(Some(GroupJob { first_frame, sensor: self.sensor_of(&group)?, group }));
            }
        }
        Ok(None)
    }

    fn sensor_of(&mut self, group: &Group) -> Result<Option<Arc<StoredSensor>>> {
        let Some(slot) = sensor_place(group).and_then(|place| self.sensors.get_mut(place)) else {
            return Ok(None);
        };
        if slot.is_none() {
            *slot = Some(StoredSensor::parse(self.reader.read_sensor_model(group.sensor_model)?)?);
        }
        Ok(slot.clone())
    }
}

impl<R: Read + Seek> Iterator for IndexedGroups<R> {
    type Item = Result<GroupJob>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_job().transpose()
    }
}

/// Where a group's sensor model is among the stream's; `None` if it has none. The readers have
/// checked that there is such a model.
fn sensor_place(group: &Group) -> Option<usize> {
    usize::try_from(group.sensor_model).ok()?.checked_sub(1)
}
