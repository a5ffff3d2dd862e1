//! A stream to a sequence of files.

use std::io::{Read, Seek};

use super::config::resolve_threads;
use super::group::{DecodedImage, DecodedScan, GroupDecoder};
use super::options::DecodeOptions;
use super::ordered::run_ordered;
use super::parameters::Source;
use super::source::{GroupJob, IndexedGroups, StreamedGroups};
use super::steps::StepReport;
use crate::bitstream::{Frame, FrameHeader, IndexedReader, StreamReader};
use crate::error::{Error, Result};
use crate::scan::ScanFile;

/// One decoded file, its size and checksum verified.
#[derive(Clone, Debug)]
pub struct DecodedFrame {
    /// Its number in the sequence, the first being 0.
    pub number: u64,
    /// What the stream says of it. The name is as in the stream: check it before use as a path.
    pub header: FrameHeader,
    /// The file's bytes.
    pub bytes: Vec<u8>,
    /// The same file taken apart, if that was asked for.
    pub scan: Option<ScanFile>,
    /// What the file was before, if it is not given back exactly.
    pub source: Option<Source>,
    /// Whether it holds the points of the file before, and in their order.
    pub in_order: bool,
    /// The range image, if there is one and it was asked for.
    pub image: Option<DecodedImage>,
    /// What each step of decoding took.
    pub steps: StepReport,
}

/// Decodes a stream front to back, as from a pipe. Groups are decoded in parallel: `work` is done on each
/// frame by the thread that has decoded it, as soon as it has, and what becomes of the frame is handed to `sink` in
/// order, on the calling thread. The whole stream is read and checked even if only some frames are asked
/// for. Returns how many frames the stream holds.
///
/// # Errors
/// If the input fails or is damaged anywhere, if a frame does not decode to what was encoded, if it
/// asks for more than the limits, if there are no such frames, or if the work or the sink fails.
pub fn decode<T: Send>(
    input: impl Read + Send,
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    sink: impl FnMut(T) -> Result<()>,
) -> Result<u64> {
    let reader = StreamReader::open(input, options.limits)?;
    let mut jobs = StreamedGroups::new(reader, options.frames);
    decode_jobs(&mut jobs, options, work, sink)?;
    let frame_count = jobs.frame_count();
    options.frames.check(frame_count)?;
    Ok(frame_count)
}

/// As [`decode`], but reads only the groups that hold the frames asked for. Returns how many frames
/// the stream holds.
///
/// # Errors
/// As [`decode`]; damage elsewhere in the stream goes unseen.
pub fn decode_indexed<T: Send>(
    input: impl Read + Seek + Send,
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    sink: impl FnMut(T) -> Result<()>,
) -> Result<u64> {
    let reader = IndexedReader::open(input, options.limits)?;
    let frame_count = reader.index().frame_count();
    options.frames.check(frame_count)?;
    decode_jobs(&mut IndexedGroups::new(reader, options.frames), options, work, sink)?;
    Ok(frame_count)
}

fn decode_jobs<T: Send>(
    jobs: &mut (impl Iterator<Item = Result<GroupJob>> + Send),
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    mut sink: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let work = |job| decode_group(job, options, &work);
    let deliver = |results: Vec<T>| results.into_iter().try_for_each(&mut sink);
    run_ordered(resolve_threads(options.threads), jobs, work, deliver)
}

/// Decodes the frames of a group up to the last that is asked for, and does `work` on each of these.
pub(super) fn decode_group<T>(
    job: GroupJob,
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T>,
) -> Result<Vec<T>> {
    let range = &options.frames;
    let sensor = job.sensor.as_deref().map(|sensor| &sensor.model);
    let coder = GroupDecoder::new(sensor, &options.limits);
    let mut coder = coder.keeping_images(options.images);
    let mut results = Vec::new();
    for (number, frame) in (job.first_frame..).zip(job.group.frames) {
        if range.is_past(number) {
            break;
        }
        let part = part_name(number, &frame.header.name);
        if let Some(frame) = decode_frame(&mut coder, number, frame, options).map_err(|e| e.within(&part))? {
            results.push(work(frame)?);
        }
    }
    Ok(results)
}

/// Decodes one frame; returns its file if it is asked for (those before it are needed for its sake).
fn decode_frame(
    coder: &mut GroupDecoder<'_>,
    number: u64,
    frame: Frame,
    options: &DecodeOptions,
) -> Result<Option<DecodedFrame>> {
    let header = frame.header;
    let mut steps = StepReport::default();
    let DecodedScan { scan, source, in_order, image } =
        coder.decode_frame(&header, &frame.sections, &mut steps)?;
    if !options.frames.contains(number) {
        return Ok(None);
    }
    let bytes = scan.to_bytes()?;
    check_file(&header, &bytes)?;
    let scan = options.scans.then_some(scan);
    Ok(Some(DecodedFrame { number, header, bytes, scan, source, in_order, image, steps }))
}

/// What errors call a frame.
pub(super) fn part_name(number: u64, name: &str) -> String {
    format!("frame {number} ({name:?})")
}

/// An error if these are not the bytes of the file that the frame's header tells of.
pub(super) fn check_file(header: &FrameHeader, bytes: &[u8]) -> Result<()> {
    if bytes.len() as u64 != header.file_size {
        return Err(Error::corrupt(format!("{} bytes, not {}", bytes.len(), header.file_size)));
    }
    if crc32c::crc32c(bytes) != header.file_crc {
        return Err(Error::corrupt("the decoded file's checksum does not match"));
    }
    Ok(())
}
