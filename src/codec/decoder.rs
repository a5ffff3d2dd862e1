//! A stream to a sequence of files.

use std::io::{Read, Seek};
use std::sync::Arc;

use super::config::resolve_threads;
use super::group::{DecodedImage, DecodedScan, GroupDecoder};
use super::options::{DecodeOptions, FrameRange};
use super::ordered::run_ordered;
use super::parameters::Source;
use super::steps::StepReport;
use crate::bitstream::{Frame, FrameHeader, Group, IndexedReader, Record, StreamReader};
use crate::error::{Error, Result};
use crate::sensor::SensorModel;

/// One decoded file, its size and checksum verified.
#[derive(Clone, Debug)]
pub struct DecodedFrame {
    /// Its number in the sequence, the first being 0.
    pub number: u64,
    /// What the stream says of it. The name is as in the stream: check it before use as a path.
    pub header: FrameHeader,
    /// The file's bytes.
    pub bytes: Vec<u8>,
    /// What the file was before, if it is not given back exactly.
    pub source: Option<Source>,
    /// The range image, if there is one and it was asked for.
    pub image: Option<DecodedImage>,
    /// What each step of decoding took.
    pub steps: StepReport,
}

/// Decodes a stream front to back, as from a pipe, and hands the frames to `sink` in order. Groups
/// are decoded in parallel. The whole stream is read and checked even if only some frames are asked
/// for. Returns how many frames the stream holds.
///
/// # Errors
/// If the input fails or is damaged anywhere, if a frame does not decode to what was encoded, if it
/// asks for more than the limits, if there are no such frames, or if the sink fails.
pub fn decode(
    input: impl Read,
    options: &DecodeOptions,
    sink: impl FnMut(DecodedFrame) -> Result<()>,
) -> Result<u64> {
    let reader = StreamReader::open(input, options.limits)?;
    let mut jobs = StreamedGroups { reader, sensors: Vec::new(), range: options.frames };
    decode_jobs(&mut jobs, options, sink)?;
    let frame_count = jobs.reader.index().frame_count();
    options.frames.check(frame_count)?;
    Ok(frame_count)
}

/// As [`decode`], but reads only the groups that hold the frames asked for. Returns how many frames
/// the stream holds.
///
/// # Errors
/// As [`decode`]; damage elsewhere in the stream goes unseen.
pub fn decode_indexed(
    input: impl Read + Seek,
    options: &DecodeOptions,
    sink: impl FnMut(DecodedFrame) -> Result<()>,
) -> Result<u64> {
    let reader = IndexedReader::open(input, options.limits)?;
    let frame_count = reader.index().frame_count();
    options.frames.check(frame_count)?;
    let mut sensors = Vec::new();
    sensors.resize(reader.index().sensor_models.len(), None);
    decode_jobs(&mut IndexedGroups { reader, sensors, range: options.frames, place: 0 }, options, sink)?;
    Ok(frame_count)
}

/// A group to decode, with all that it takes.
struct GroupJob {
    first_frame: u64,
    sensor: Option<Arc<SensorModel>>,
    group: Group,
}

fn decode_jobs(
    jobs: &mut impl Iterator<Item = Result<GroupJob>>,
    options: &DecodeOptions,
    mut sink: impl FnMut(DecodedFrame) -> Result<()>,
) -> Result<()> {
    let work = |job| decode_group(job, options);
    let deliver = |frames: Vec<DecodedFrame>| frames.into_iter().try_for_each(&mut sink);
    run_ordered(resolve_threads(options.threads), jobs, work, deliver)
}

/// Decodes the frames of a group up to the last that is asked for.
fn decode_group(job: GroupJob, options: &DecodeOptions) -> Result<Vec<DecodedFrame>> {
    let range = &options.frames;
    let coder = GroupDecoder::new(job.sensor.as_deref(), &options.limits);
    let mut coder = coder.keeping_images(options.images);
    let mut decoded = Vec::new();
    for (number, frame) in (job.first_frame..).zip(job.group.frames) {
        if range.is_past(number) {
            break;
        }
        let part = format!("frame {number} ({:?})", frame.header.name);
        if let Some(frame) =
            decode_frame(&mut coder, number, frame, range.contains(number)).map_err(|e| e.within(&part))?
        {
            decoded.push(frame);
        }
    }
    Ok(decoded)
}

/// Decodes one frame; returns its file if `wanted` (the frames before it are needed for their sake).
fn decode_frame(
    coder: &mut GroupDecoder<'_>,
    number: u64,
    frame: Frame,
    wanted: bool,
) -> Result<Option<DecodedFrame>> {
    let header = frame.header;
    let mut steps = StepReport::default();
    let DecodedScan { scan, source, image } = coder.decode_frame(&header, &frame.sections, &mut steps)?;
    if !wanted {
        return Ok(None);
    }
    let bytes = scan.to_bytes()?;
    if bytes.len() as u64 != header.file_size {
        return Err(Error::corrupt(format!("{} bytes, not {}", bytes.len(), header.file_size)));
    }
    if crc32c::crc32c(&bytes) != header.file_crc {
        return Err(Error::corrupt("the decoded file's checksum does not match"));
    }
    Ok(Some(DecodedFrame { number, header, bytes, source, image, steps }))
}

fn parse_sensor_model(bytes: &[u8]) -> Result<Arc<SensorModel>> {
    let mut rest = bytes;
    let model = SensorModel::read_from(&mut rest).map_err(|e| e.within("sensor model"))?;
    if !rest.is_empty() {
        return Err(Error::corrupt("sensor model: bytes left over"));
    }
    Ok(Arc::new(model))
}

/// The groups of a stream as they arrive.
struct StreamedGroups<R> {
    reader: StreamReader<R>,
    /// The sensor models so far, in order.
    sensors: Vec<Arc<SensorModel>>,
    range: FrameRange,
}

impl<R: Read> StreamedGroups<R> {
    fn next_job(&mut self) -> Result<Option<GroupJob>> {
        while let Some(record) = self.reader.next_record()? {
            match record {
                Record::SensorModel(bytes) => self.sensors.push(parse_sensor_model(&bytes)?),
                Record::Group(group) => {
                    let first_frame = self.reader.index().frame_count() - group.frames.len() as u64;
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
struct IndexedGroups<R> {
    reader: IndexedReader<R>,
    /// The sensor models, once they were read.
    sensors: Vec<Option<Arc<SensorModel>>>,
    range: FrameRange,
    /// The next group's place in the index.
    place: usize,
}

impl<R: Read + Seek> IndexedGroups<R> {
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

    fn sensor_of(&mut self, group: &Group) -> Result<Option<Arc<SensorModel>>> {
        let Some(slot) = sensor_place(group).and_then(|place| self.sensors.get_mut(place)) else {
            return Ok(None);
        };
        if slot.is_none() {
            *slot = Some(parse_sensor_model(&self.reader.read_sensor_model(group.sensor_model)?)?);
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
