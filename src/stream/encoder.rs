//! Encodes a sequence of files as a stream.

use std::borrow::Cow;
use std::io::Write;
use std::mem;
use std::sync::Arc;

use rayon::ThreadPool;

use super::input::{FrameInput, ReadFrame};
use super::ordered::run_ordered;
use super::scanner_choice::{DriveScanners, KeptScanners, choose_scanners, records_of};
use super::statistics::{EncodeStatistics, FrameStatistics};
use crate::container::{CodedFrame, FrameHeader, Group, Index, ScannerRecord, StreamWriter};
use crate::frame::encoder::GroupEncoder;
use crate::frame::settings::EncoderConfig;
use crate::frame::stages::StageReport;
use crate::ground::error::{Error, Limits, Result};
use crate::ground::team::{on, pool_for_frames};
use crate::scan::ScanFile;

/// A group is closed early when its files reach this many bytes in total: decoders hold a whole group in
/// memory.
const GROUP_FILE_BYTES: u64 = 256 << 20;

/// Encodes a sequence. Groups are encoded in parallel; the stream does not depend on the number of threads.
/// `on_frame` is called, from any thread, as each frame is done.
///
/// # Errors
/// If a file cannot be read or exceeds the limits that every decoder has ([`Limits::default`]), if a name
/// cannot be restored, if the output fails, or if the settings are out of range.
pub fn encode<W: Write>(
    frames: &[FrameInput],
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<EncodeStatistics> {
    config.check()?;
    encode_groups(&choose_scanners(frames, config)?, groups_of(frames, config), config, out, on_frame)
}

/// As [`encode`], for frames that arrive over time: each group is written as soon as it is coded, without
/// waiting for the frame after it. Scanners are fitted to the first group that has scans of some size, for which
/// others before it wait; tracks that begin later are coded without a scanner. A few groups are in memory at a
/// time.
///
/// # Errors
/// As [`encode`]; also the first error of `frames`.
pub fn encode_live<W: Write>(
    frames: impl Iterator<Item = Result<FrameInput>> + Send,
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<EncodeStatistics> {
    config.check()?;
    let mut frames = frames.fuse();
    let mut groups = std::iter::from_fn(|| {
        let group: Result<Vec<_>> = frames.by_ref().take(config.gop).collect();
        group.map(|group| (!group.is_empty()).then_some(Cow::Owned(group))).transpose()
    });
    let mut first: Vec<Cow<'_, [FrameInput]>> = Vec::new();
    while first.len() < MOST_WAITING && !first.last().is_some_and(|group| may_show_scanner(group)) {
        let Some(group) = groups.next().transpose()? else { break };
        first.push(group);
    }
    let scanners = choose_scanners(first.last().map_or(&[], |group| group), config)?;
    encode_groups(&scanners, first.into_iter().map(Ok).chain(groups), config, out, on_frame)
}

/// Largest number of groups that wait for one with scans of some size.
pub(crate) const MOST_WAITING: usize = 10;

/// Whether one of the frames may show its scanner. Recordings often begin with empty scans.
pub(crate) fn may_show_scanner(frames: &[FrameInput]) -> bool {
    /// In bytes: about a hundred points.
    const SOME: u64 = 1600;
    frames.iter().any(|frame| frame.size().is_ok_and(|size| size >= SOME))
}

/// A stream with one group of frames, whose scanners are known.
///
/// # Errors
/// As [`encode`].
pub fn encode_known(
    frames: Vec<FrameInput>,
    scanners: &DriveScanners,
    config: &EncoderConfig,
) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let scanners = std::slice::from_ref(scanners);
    let mut stream = OpenStream::begin(&mut bytes, &records_of(scanners))?;
    stream.write(&SequenceCoder::new(scanners, config, &|| ()).encode_frames(frames)?)?;
    stream.finish()?;
    Ok(bytes)
}

/// Encodes groups of frames.
fn encode_groups<'f, W: Write>(
    scanners: &[DriveScanners],
    groups: impl Iterator<Item = Result<Cow<'f, [FrameInput]>>> + Send,
    config: &EncoderConfig,
    out: W,
    on_frame: &(dyn Fn() + Sync),
) -> Result<EncodeStatistics> {
    let mut stream = OpenStream::begin(out, &records_of(scanners))?;
    let coder = SequenceCoder::new(scanners, config, on_frame);
    coder.run(groups, |groups| stream.write(&groups))?;
    stream.finish()
}

/// The frames that are coded together.
pub(crate) fn groups_of<'f>(
    frames: &'f [FrameInput],
    config: &EncoderConfig,
) -> impl Iterator<Item = Result<Cow<'f, [FrameInput]>>> + Send + use<'f> {
    let gop = config.gop;
    let drives = frames.chunk_by(|one, next| one.drive() == next.drive());
    drives.flat_map(move |drive| drive.chunks(gop)).map(|group| Ok(Cow::Borrowed(group)))
}

/// The state shared by all groups of a sequence.
pub(crate) struct SequenceCoder<'a> {
    /// Scanners, by drive number.
    scanners: &'a [DriveScanners],
    config: &'a EncoderConfig,
    on_frame: &'a (dyn Fn() + Sync),
}

impl<'a> SequenceCoder<'a> {
    /// A coder for groups of drives with these scanners.
    pub fn new(
        scanners: &'a [DriveScanners],
        config: &'a EncoderConfig,
        on_frame: &'a (dyn Fn() + Sync),
    ) -> Self {
        SequenceCoder { scanners, config, on_frame }
    }

    /// Encodes frames in parallel, and passes the result of each item of `groups` to `write`, in order.
    ///
    /// # Errors
    /// As [`encode`].
    pub fn run<'f>(
        &self,
        groups: impl Iterator<Item = Result<Cow<'f, [FrameInput]>>> + Send,
        write: impl FnMut(Vec<EncodedGroup>) -> Result<()>,
    ) -> Result<()> {
        let work = |group: Cow<'_, [FrameInput]>| self.encode_frames(group.into_owned());
        run_ordered(self.config.threads, groups, work, write)
    }

    /// Encodes frames of one drive as one group, or as several if they are very large.
    ///
    /// # Errors
    /// As [`encode`].
    pub fn encode_frames(&self, inputs: Vec<FrameInput>) -> Result<Vec<EncodedGroup>> {
        let mut groups = Vec::new();
        let drive = inputs.first().map_or(0, FrameInput::drive);
        let mut open = GroupInProgress::new(self, drive)?;
        for input in inputs {
            let path = input.path();
            let frame = input.into_frame(self.config.headerless.as_ref())?;
            if !open.has_room_for(&frame) {
                groups.push(mem::replace(&mut open, GroupInProgress::new(self, drive)?).encoded);
            }
            open.encode_frame(frame).map_err(|e| e.at(path))?;
            (self.on_frame)();
        }
        groups.push(open.encoded);
        Ok(groups)
    }
}

/// A coded group, and properties of its files.
pub(crate) struct EncodedGroup {
    pub group: Group,
    /// Time and size of each stage, by frame.
    pub stages: Vec<StageReport>,
    /// The headers of the original files, as they were before a track was chosen.
    pub originals: Vec<FrameHeader>,
    /// Total bytes of the original files.
    file_bytes: u64,
}

/// A group that is being encoded.
struct GroupInProgress<'s> {
    scanners: &'s DriveScanners,
    config: &'s EncoderConfig,
    coder: GroupEncoder<'s>,
    encoded: EncodedGroup,
}

impl<'s> GroupInProgress<'s> {
    /// # Errors
    /// If no scanners were chosen for the drive.
    fn new(sequence: &SequenceCoder<'s>, drive: usize) -> Result<Self> {
        let scanners = sequence.scanners.get(drive);
        let scanners = scanners.ok_or_else(|| Error::Internal(format!("no scanners for drive {drive}")))?;
        let group = Group { scanners: scanners.ids.clone(), frames: Vec::new() };
        let of_tracks: Vec<_> = scanners.scanners.iter().map(Option::as_ref).collect();
        Ok(GroupInProgress {
            scanners,
            config: sequence.config,
            coder: GroupEncoder::new(&of_tracks, sequence.config),
            encoded: EncodedGroup { group, stages: Vec::new(), originals: Vec::new(), file_bytes: 0 },
        })
    }

    fn has_room_for(&self, frame: &ReadFrame) -> bool {
        let group_bytes = self.encoded.file_bytes;
        self.encoded.group.frames.is_empty() || group_bytes + frame.header.file_size <= GROUP_FILE_BYTES
    }

    fn encode_frame(&mut self, frame: ReadFrame) -> Result<()> {
        let ReadFrame { header: original, scan } = frame;
        let scan = within_limits(scan)?;
        let mut header = FrameHeader { point_count: scan.records as u64, ..original.clone() };
        header.stamp.track = self.scanners.track_of(original.stamp.track, &scan, self.config);
        let tracks = usize::from(header.stamp.track) + 1;
        let scanners = &mut self.encoded.group.scanners;
        scanners.resize(scanners.len().max(tracks), None);
        self.encoded.file_bytes += original.file_size;
        self.encoded.originals.push(original);
        let frame = self.coder.encode_frame(scan, header)?;
        self.encoded.stages.push(frame.stages);
        self.encoded.group.frames.push(CodedFrame { header: frame.header, sections: frame.sections });
        Ok(())
    }
}

/// A scan that decoders accept under their limits: a file with too many points, or whose records, as numbers
/// or decompressed, take too many bytes, is coded as plain bytes.
fn within_limits(scan: ScanFile) -> Result<ScanFile> {
    let limits = Limits::default();
    let bytes = scan.records.saturating_mul(scan.layout.stride());
    if scan.records as u64 <= limits.points && bytes as u64 <= limits.file_bytes {
        return Ok(scan);
    }
    let bytes = scan.to_bytes()?;
    Ok(ScanFile::opaque(scan.name, bytes))
}

/// Encodes frames one by one, each to a stream of its own. The scanner is fitted to the first frames, and kept
/// once it explains the next one.
#[derive(Clone)]
pub(crate) struct MessageCoder {
    config: Arc<EncoderConfig>,
    scanners: KeptScanners,
    pool: Option<Arc<ThreadPool>>,
}

impl MessageCoder {
    /// # Errors
    /// If the threads cannot be started.
    pub fn new(config: EncoderConfig) -> Result<Self> {
        let pool = pool_for_frames(config.threads)?.map(Arc::new);
        Ok(MessageCoder { config: Arc::new(config), scanners: KeptScanners::default(), pool })
    }

    pub fn config(&self) -> &EncoderConfig {
        &self.config
    }

    /// A stream with this frame alone.
    ///
    /// # Errors
    /// As [`encode`].
    pub fn encode(&mut self, frame: FrameInput) -> Result<Vec<u8>> {
        let scanners = self.scanners.for_next(|| Some(frame.clone()), &self.config)?;
        on(self.pool.as_deref(), || encode_known(vec![frame], &scanners, &self.config))
    }
}

/// A stream to which groups are written.
pub(crate) struct OpenStream<W> {
    writer: StreamWriter<W>,
    encoded: EncodeStatistics,
}

impl<W: Write> OpenStream<W> {
    /// Writes the stream header and the scanners.
    ///
    /// # Errors
    /// This and all other functions: if the output fails.
    pub fn begin(out: W, scanners: &[ScannerRecord]) -> Result<Self> {
        let mut writer = StreamWriter::create(out)?;
        for scanner in scanners {
            writer.write_scanner(scanner)?;
        }
        Ok(OpenStream { writer, encoded: EncodeStatistics::default() })
    }

    /// Continues a stream that already has these contents, `position` bytes long, with these scanners.
    pub fn resume(
        out: W,
        (index, position): (Index, u64),
        scanners: &[ScannerRecord],
        encoded: EncodeStatistics,
    ) -> Result<Self> {
        Ok(OpenStream { writer: StreamWriter::resume(out, index, position, scanners)?, encoded })
    }

    /// Bytes written so far.
    pub fn position(&self) -> u64 {
        self.writer.position()
    }

    /// Writes the next groups.
    pub fn write(&mut self, groups: &[EncodedGroup]) -> Result<()> {
        for EncodedGroup { group, stages, .. } in groups {
            self.writer.write_group(group)?;
            for (frame, stages) in group.frames.iter().zip(stages) {
                let number = self.encoded.frames.len() as u64;
                let statistics = FrameStatistics::of(frame, *stages);
                self.encoded.add(statistics.map_err(|e| e.within_frame(number, &frame.header.name))?);
            }
        }
        Ok(())
    }

    /// Writes the index and the end.
    pub fn finish(mut self) -> Result<EncodeStatistics> {
        (_, self.encoded.stream_bytes) = self.writer.finish()?;
        Ok(self.encoded)
    }
}
