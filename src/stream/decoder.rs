//! A stream to a sequence of files.

use std::borrow::Borrow;
use std::collections::VecDeque;
use std::io::{Read, Seek};

use super::options::DecodeOptions;
use super::ordered::run_ordered;
use super::source::{GroupJob, IndexedGroups, StreamedGroups};
use crate::container::{CodedFrame, FrameHeader, IndexedReader, StreamReader};
use crate::files;
use crate::frame::group::{DecodedImage, DecodedScan, GroupDecoder};
use crate::frame::parameters::Source;
use crate::frame::settings::resolve_threads;
use crate::frame::steps::StepReport;
use crate::ground::error::{Error, Limits, Result};
use crate::scan::ScanFile;
use crate::scanner::Scanner;

/// One decoded file. Whether it is the file that was encoded shows when its bytes are asked for, or by
/// [`checked`](Self::checked).
#[derive(Clone, Debug)]
pub struct DecodedFrame {
    /// Its number in the sequence, the first being 0.
    pub number: u64,
    /// What the stream says of it. The name is as in the stream: check it before use as a path.
    pub header: FrameHeader,
    /// The file, taken apart.
    pub scan: ScanFile,
    /// What the file was before, if it is not given back exactly.
    pub source: Option<Source>,
    /// Whether it holds the points of the file before, and in their order.
    pub keeps_order: bool,
    /// The range image, if there is one and it was asked for.
    pub image: Option<DecodedImage>,
    /// What each step of decoding took.
    pub steps: StepReport,
}

impl DecodedFrame {
    /// Gives the file's bytes, piece by piece.
    ///
    /// # Errors
    /// If, as shows in the end, they are not those of the file that was encoded; those of `give`.
    pub fn write(&self, give: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        write_checked(&self.scan, &self.header, give)
            .map_err(|e| e.within_frame(self.number, &self.header.name))
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// If they are not those of the file that was encoded.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        files::collected(|give| self.write(give))
    }

    /// The frame, if it is the file that was encoded.
    ///
    /// # Errors
    /// If it is not.
    pub fn checked(self) -> Result<Self> {
        self.write(|_| Ok(())).map(|()| self)
    }
}

/// Decodes a stream front to back, as from a pipe. Groups are decoded in parallel: `work` is done on each
/// frame by the thread that has decoded it, as soon as it has, and what becomes of the frame is handed to `sink` in
/// order, on the calling thread. The whole stream is read and checked even if only some frames are asked
/// for. Returns how many frames the stream holds.
///
/// # Errors
/// If the input fails or is damaged anywhere, if a frame asks for more than the limits, if there are no such
/// frames, or if the work or the sink fails.
pub fn decode<T: Send>(
    input: impl Read + Send,
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    sink: impl FnMut(T) -> Result<()>,
) -> Result<u64> {
    let reader = StreamReader::open(input, options.limits)?;
    let mut jobs = StreamedGroups::new(reader, options.frames);
    decode_jobs(&mut jobs, options, work, sink)?;
    options.frames.check(jobs.index().scan_count())?;
    Ok(jobs.index().frame_count())
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
    options.frames.check(reader.index().scan_count())?;
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
pub(crate) fn decode_group<T>(
    job: GroupJob,
    options: &DecodeOptions,
    mut work: impl FnMut(DecodedFrame) -> Result<T>,
) -> Result<Vec<T>> {
    let range = &options.frames;
    let coder = GroupDecoder::new(job.models()?, &options.limits);
    let mut coder = coder.keeping_images(options.images);
    let mut results = Vec::new();
    for (number, frame) in (job.first_frame..).zip(&job.group.frames) {
        if range.is_past(number) {
            break;
        }
        let decoded = decode_frame(&mut coder, number, frame, options);
        if let Some(frame) = decoded.map_err(|e| e.within_frame(number, &frame.header.name))? {
            results.push(work(frame)?);
        }
    }
    Ok(results)
}

/// Decodes one frame; returns its file if it is asked for (those before it are needed for its sake).
fn decode_frame<S: Borrow<Scanner>>(
    coder: &mut GroupDecoder<S>,
    number: u64,
    frame: &CodedFrame,
    options: &DecodeOptions,
) -> Result<Option<DecodedFrame>> {
    let header = frame.header.clone();
    let mut steps = StepReport::default();
    let DecodedScan { scan, source, keeps_order, image, .. } =
        coder.decode_frame(&header, &frame.sections, &mut steps)?;
    if !options.frames.contains(number) {
        return Ok(None);
    }
    Ok(Some(DecodedFrame { number, header, scan, source, keeps_order, image, steps }))
}

/// A group that is decoded as far as it is asked for, and goes on from there.
pub(crate) struct PartlyDecodedGroup {
    /// Number of the next frame.
    next: u64,
    coder: GroupDecoder<Scanner>,
    /// Those that are not decoded yet.
    coded: VecDeque<CodedFrame>,
}

impl PartlyDecodedGroup {
    /// A group of which nothing is decoded yet.
    ///
    /// # Errors
    /// If a scanner of it is of a family that this program does not know.
    pub fn new(job: GroupJob, limits: &Limits, images: bool) -> Result<Self> {
        let scanners = job.models()?.into_iter().map(Option::<&Scanner>::cloned);
        let coder = GroupDecoder::new(scanners, limits).keeping_images(images);
        Ok(PartlyDecodedGroup { next: job.first_frame, coder, coded: job.group.frames.into() })
    }

    /// The next frame; `None` after the last. It is not [checked](DecodedFrame::checked).
    ///
    /// # Errors
    /// If the frame is damaged, or asks for more than the limits. The group is of no use then.
    pub fn decode_next(&mut self) -> Result<Option<DecodedFrame>> {
        let Some(frame) = self.coded.pop_front() else { return Ok(None) };
        let number = self.next;
        self.next += 1;
        let decoded = decode_frame(&mut self.coder, number, &frame, &DecodeOptions::default());
        decoded.map_err(|e| e.within_frame(number, &frame.header.name))
    }
}

/// Gives the bytes of a file, piece by piece; an error if in the end they are not those that the frame's header tells
/// of.
pub(crate) fn write_checked(
    scan: &ScanFile,
    header: &FrameHeader,
    mut give: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut size, mut crc) = (0, 0);
    files::write(scan, |piece| {
        size += piece.len() as u64;
        crc = crc32c::crc32c_append(crc, piece);
        give(piece)
    })?;
    if size != header.file_size {
        return Err(Error::corrupt(format!("{size} bytes, not {}", header.file_size)));
    }
    if crc != header.file_crc {
        return Err(Error::corrupt("the decoded file's checksum does not match"));
    }
    Ok(())
}
