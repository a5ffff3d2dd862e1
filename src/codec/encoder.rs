//! A sequence of files to a stream.

use std::borrow::Cow;
use std::io::Write;
use std::mem;

use super::config::{EncoderConfig, ProjectionKind, resolve_threads};
use super::group::GroupEncoder;
use super::input::FrameInput;
use super::ordered::run_ordered;
use super::steps::StepReport;
use crate::bitstream::{Frame, FrameHeader, Group, StreamHeader, StreamWriter};
use crate::compensation;
use crate::error::{Limits, Result};
use crate::io::{HeaderlessLayout, parse_with};
use crate::scan::ScanFile;
use crate::sensor::{self, SensorModel};

/// Frames that the sensor model is fitted to.
const SAMPLE_FRAMES: usize = 6;

/// Larger files than this, in bytes, are left out of the sample, which is in memory all at once.
const SAMPLE_FILE_BYTES: u64 = 64 << 20;

/// A group is closed early when its files reach this many bytes together: decoders hold a whole
/// group in memory.
const GROUP_FILE_BYTES: u64 = 256 << 20;

/// What was encoded.
#[derive(Clone, Debug, Default)]
pub struct Encoded {
    /// Name, size, checksum and points of each file as it decodes, in order.
    pub frames: Vec<FrameHeader>,
    /// What each step took and left; where several predictions were tried, with the one that was taken.
    pub steps: StepReport,
    /// The same, frame by frame.
    pub frame_steps: Vec<StepReport>,
    /// Points of all original files.
    pub points: u64,
    /// Bytes of the stream.
    pub stream_bytes: u64,
}

impl Encoded {
    /// Bytes of all original files.
    pub fn file_bytes(&self) -> u64 {
        self.steps.original
    }
}

/// Encodes a sequence. Groups are encoded in parallel; the stream's bytes do not depend on how many
/// at a time. `on_frame` is called, from any thread, as each frame is done.
///
/// # Errors
/// If a file cannot be read or is over the limits that every decoder keeps ([`Limits::default`]), if
/// a name cannot be given back, if the output fails, or if the settings are out of range.
pub fn encode<W: Write>(
    frames: &[FrameInput],
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<Encoded> {
    config.check()?;
    let groups = frames.chunks(config.gop).map(|group| Ok(Cow::Borrowed(group)));
    encode_groups(choose_sensor(frames, config)?, groups, config, out, on_frame)
}

/// As [`encode`], of frames that are yet to come: each group is written as soon as it is coded, which does
/// not wait for the frame after it. The sensor model is fitted to the first group. A few groups are in
/// memory at a time.
///
/// # Errors
/// As [`encode`]; also the first error of `frames`.
pub fn encode_live<W: Write>(
    frames: impl Iterator<Item = Result<FrameInput>> + Send,
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<Encoded> {
    config.check()?;
    let mut frames = frames.fuse();
    let mut groups = std::iter::from_fn(|| {
        let group: Result<Vec<_>> = frames.by_ref().take(config.gop).collect();
        group.map(|group| (!group.is_empty()).then_some(Cow::Owned(group))).transpose()
    });
    let first: Option<Cow<'_, [FrameInput]>> = groups.next().transpose()?;
    let sensor = choose_sensor(first.as_deref().unwrap_or_default(), config)?;
    encode_groups(sensor, first.map(Ok).into_iter().chain(groups), config, out, on_frame)
}

/// The sensor model of a sequence that these frames are of.
fn choose_sensor(frames: &[FrameInput], config: &EncoderConfig) -> Result<Option<SensorModel>> {
    Ok(match config.projection {
        ProjectionKind::Calibrated { range_step_um } => {
            let fitted = sensor::fit(&sample(frames, config)?);
            fitted.map(|sensor| range_step_um.into_iter().fold(sensor, SensorModel::with_range_step))
        }
        ProjectionKind::Ideal { columns, range_step_um } => Some(sensor::ideal(columns, range_step_um)),
    })
}

/// Encodes groups of frames.
fn encode_groups<'f, W: Write>(
    sensor: Option<SensorModel>,
    groups: impl Iterator<Item = Result<Cow<'f, [FrameInput]>>> + Send,
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<Encoded> {
    let mut writer = StreamWriter::create(out, &StreamHeader::default())?;
    let sensor_number = write_sensor_model(&mut writer, sensor.as_ref())?;
    let coder = SequenceCoder { sensor: sensor.as_ref(), sensor_number, config, on_frame };

    let mut encoded = Encoded::default();
    let write = |groups: Vec<EncodedGroup>| {
        for EncodedGroup { group, steps, points, .. } in groups {
            writer.write_group(&group)?;
            steps.iter().for_each(|frame| encoded.steps.add(frame));
            encoded.frame_steps.extend(steps);
            encoded.points += points;
            encoded.frames.extend(group.frames.into_iter().map(|frame| frame.header));
        }
        Ok(())
    };
    let work = |group: Cow<'_, [FrameInput]>| coder.encode_frames(&group);
    run_ordered(resolve_threads(config.threads), groups, work, write)?;
    (_, encoded.stream_bytes) = writer.finish()?;
    Ok(encoded)
}

/// The frames that the sensor model is fitted to, spread over the sequence.
fn sample(frames: &[FrameInput], config: &EncoderConfig) -> Result<Vec<ScanFile>> {
    let mut sample = Vec::new();
    for frame in sample_places(frames.len()).map(|place| &frames[place]) {
        if frame.size()? <= SAMPLE_FILE_BYTES {
            let mut scan = parse_with(frame.name()?, frame.read()?, config.headerless.as_ref());
            let undone = config.undoes_compensation().then(|| compensation::undo(&scan.cloud.positions));
            if let Some((positions, _)) = undone.flatten() {
                scan.cloud.positions = positions;
            }
            sample.push(scan);
        }
    }
    Ok(sample)
}

/// Where the sample is taken: the first frame, the last, and others evenly between.
fn sample_places(frames: usize) -> impl Iterator<Item = usize> {
    let count = SAMPLE_FRAMES.min(frames);
    (0..count).map(move |i| i * (frames - 1) / (count - 1).max(1))
}

/// Writes the sensor model, if there is one; returns its number, 0 if there is none.
fn write_sensor_model<W: Write>(writer: &mut StreamWriter<W>, sensor: Option<&SensorModel>) -> Result<u64> {
    let Some(sensor) = sensor else { return Ok(0) };
    let mut bytes = Vec::new();
    sensor.write_to(&mut bytes);
    writer.write_sensor_model(&bytes)
}

/// What all groups of a sequence share.
struct SequenceCoder<'a> {
    sensor: Option<&'a SensorModel>,
    sensor_number: u64,
    config: &'a EncoderConfig,
    on_frame: &'a (dyn Fn() + Sync),
}

impl SequenceCoder<'_> {
    /// Encodes frames as one group; as more if they are very large.
    fn encode_frames(&self, inputs: &[FrameInput]) -> Result<Vec<EncodedGroup>> {
        let mut groups = Vec::new();
        let mut open = OpenGroup::new(self);
        for input in inputs {
            let bytes = input.read()?;
            if !open.has_room_for(&bytes) {
                groups.push(mem::replace(&mut open, OpenGroup::new(self)).encoded);
            }
            open.encode_frame(input.name()?, bytes).map_err(|e| e.at(input.path()))?;
            (self.on_frame)();
        }
        groups.push(open.encoded);
        Ok(groups)
    }
}

/// A group, and what became of its files.
struct EncodedGroup {
    group: Group,
    /// Of each frame.
    steps: Vec<StepReport>,
    /// Bytes of the original files.
    file_bytes: u64,
    /// Points of the original files.
    points: u64,
}

/// A group that is being encoded.
struct OpenGroup<'s> {
    headerless: Option<&'s HeaderlessLayout>,
    coder: GroupEncoder<'s>,
    encoded: EncodedGroup,
}

impl<'s> OpenGroup<'s> {
    fn new(sequence: &SequenceCoder<'s>) -> Self {
        let group = Group { sensor_model: sequence.sensor_number, frames: Vec::new() };
        OpenGroup {
            headerless: sequence.config.headerless.as_ref(),
            coder: GroupEncoder::new(sequence.sensor, sequence.config),
            encoded: EncodedGroup { group, steps: Vec::new(), file_bytes: 0, points: 0 },
        }
    }

    fn has_room_for(&self, bytes: &[u8]) -> bool {
        let group_bytes = self.encoded.file_bytes;
        self.encoded.group.frames.is_empty() || group_bytes + bytes.len() as u64 <= GROUP_FILE_BYTES
    }

    fn encode_frame(&mut self, name: &str, bytes: Vec<u8>) -> Result<()> {
        let mut original = FrameHeader::of(name, &bytes, 0);
        let scan = within_limits(parse_with(name, bytes, self.headerless))?;
        original.point_count = scan.records as u64;
        self.encoded.file_bytes += original.file_size;
        self.encoded.points += original.point_count;
        let frame = self.coder.encode_frame(&scan, original)?;
        self.encoded.steps.push(frame.steps);
        self.encoded.group.frames.push(Frame { header: frame.header, sections: frame.sections });
        Ok(())
    }
}

/// A scan that decoders take under their limits: one of too many points, or whose text or compressed
/// records unfold to too many bytes, is coded as the bytes of its file.
fn within_limits(scan: ScanFile) -> Result<ScanFile> {
    let limits = Limits::default();
    if scan.records as u64 <= limits.points && scan.cloud.extra.len() as u64 <= limits.file_bytes {
        return Ok(scan);
    }
    let bytes = scan.to_bytes()?;
    Ok(ScanFile::opaque(scan.name, bytes))
}

#[cfg(test)]
mod tests {
    use super::{SAMPLE_FRAMES, sample_places};

    #[test]
    fn the_sample_is_spread_over_the_sequence() {
        let places = |frames| sample_places(frames).collect::<Vec<_>>();
        assert_eq!(places(0), [0; 0]);
        assert_eq!(places(1), [0]);
        assert_eq!(places(3), [0, 1, 2]);
        assert_eq!(places(SAMPLE_FRAMES), (0..SAMPLE_FRAMES).collect::<Vec<_>>());
        let spread: Vec<_> = (0..SAMPLE_FRAMES).map(|i| 10 * i).collect();
        assert_eq!(places(10 * SAMPLE_FRAMES - 9), spread);
    }
}
