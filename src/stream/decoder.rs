//! Decodes a stream to a sequence of files.

use std::borrow::Borrow;
use std::collections::VecDeque;
use std::io::{Read, Seek};

use super::options::DecodeOptions;
use super::ordered::run_ordered;
use super::source::{GroupJob, IndexedGroups, StreamedGroups};
use crate::container::{CodedFrame, FrameHeader, IndexedReader, StreamReader};
use crate::files;
use crate::frame::decoder::{DecodedImage, DecodedScan, GroupDecoder};
use crate::frame::parameters::OriginalFile;
use crate::frame::stages::StageReport;
use crate::ground::error::{Error, Limits, Result};
use crate::scan::ScanFile;
use crate::scanner::Scanner;

/// One decoded file. Whether it equals the encoded file is checked when its bytes are written, or by
/// [`checked`](Self::checked).
#[derive(Clone, Debug)]
pub struct DecodedFrame {
    /// Its number in the sequence, the first being 0.
    pub number: u64,
    /// The frame header. The name is as in the stream: check it before use as a path.
    pub header: FrameHeader,
    /// The file, split into points and the bytes around them.
    pub scan: ScanFile,
    /// Properties of the original file, if it is not restored exactly.
    pub source: Option<OriginalFile>,
    /// Whether it has the points of the original file in the same order.
    pub keeps_order: bool,
    /// The range image, if there is one and it was requested.
    pub image: Option<DecodedImage>,
    /// The time of each stage of decoding.
    pub stages: StageReport,
}

impl DecodedFrame {
    /// Passes the file's bytes to `give`, piece by piece.
    ///
    /// # Errors
    /// If they are not those of the encoded file, which is known only at the end; and those of `give`.
    pub fn write(&self, give: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        write_checked(&self.scan, &self.header, give)
            .map_err(|e| e.within_frame(self.number, &self.header.name))
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// If they are not those of the encoded file.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        files::collected(|give| self.write(give))
    }

    /// The frame, if its bytes are those of the encoded file.
    ///
    /// # Errors
    /// If they are not.
    pub fn checked(self) -> Result<Self> {
        self.write(|_| Ok(())).map(|()| self)
    }
}

/// Decodes a stream from front to back, as from a pipe. Groups are decoded in parallel: the thread that has
/// decoded a frame calls `work` on it at once, and the results are passed to `sink` in order, on the calling
/// thread. The whole stream is read and checked even if only some frames are requested. Returns the number of
/// files beside the scans that are left out because only some frames are.
///
/// # Errors
/// If the input fails or is damaged anywhere, if a frame exceeds the limits, if there are no such frames, or
/// if the work or the sink fails.
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
    Ok(options.frames.left_out(jobs.index()))
}

/// As [`decode`], but reads only the groups that hold the requested frames.
///
/// # Errors
/// As [`decode`]; damage elsewhere in the stream is not detected.
pub fn decode_indexed<T: Send>(
    input: impl Read + Seek + Send,
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    sink: impl FnMut(T) -> Result<()>,
) -> Result<u64> {
    let reader = IndexedReader::open(input, options.limits)?;
    let left_out = options.frames.left_out(reader.index());
    options.frames.check(reader.index().scan_count())?;
    decode_jobs(&mut IndexedGroups::new(reader, options.frames), options, work, sink)?;
    Ok(left_out)
}

fn decode_jobs<T: Send>(
    jobs: &mut (impl Iterator<Item = Result<GroupJob>> + Send),
    options: &DecodeOptions,
    work: impl Fn(DecodedFrame) -> Result<T> + Sync,
    mut sink: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let work = |job| decode_group(job, options, &work);
    let deliver = |results: Vec<T>| results.into_iter().try_for_each(&mut sink);
    run_ordered(options.threads, jobs, work, deliver)
}

/// Decodes the frames of a group up to the last requested one, and calls `work` on each requested one.
pub(crate) fn decode_group<T>(
    job: GroupJob,
    options: &DecodeOptions,
    mut work: impl FnMut(DecodedFrame) -> Result<T>,
) -> Result<Vec<T>> {
    let range = &options.frames;
    let coder = GroupDecoder::new(job.known_scanners()?, &options.limits);
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

/// Decodes one frame; returns its file if it is requested (earlier frames are decoded because others depend
/// on them).
fn decode_frame<S: Borrow<Scanner>>(
    coder: &mut GroupDecoder<S>,
    number: u64,
    frame: &CodedFrame,
    options: &DecodeOptions,
) -> Result<Option<DecodedFrame>> {
    let header = frame.header.clone();
    let mut stages = StageReport::default();
    let DecodedScan { scan, source, keeps_order, image, .. } =
        coder.decode_frame(&header, &frame.sections, &mut stages)?;
    if !options.frames.contains(number) {
        return Ok(None);
    }
    Ok(Some(DecodedFrame { number, header, scan, source, keeps_order, image, stages }))
}

/// A group that is decoded as far as requested, and can be continued.
pub(crate) struct PartlyDecodedGroup {
    /// Number of the next frame.
    next: u64,
    coder: GroupDecoder<Scanner>,
    /// The frames that are not decoded yet.
    coded: VecDeque<CodedFrame>,
}

impl PartlyDecodedGroup {
    /// A group of which nothing is decoded yet.
    ///
    /// # Errors
    /// If one of its scanners is of a family that this program does not know.
    pub fn new(job: GroupJob, limits: &Limits, images: bool) -> Result<Self> {
        let scanners = job.known_scanners()?.into_iter().map(Option::<&Scanner>::cloned);
        let coder = GroupDecoder::new(scanners, limits).keeping_images(images);
        Ok(PartlyDecodedGroup { next: job.first_frame, coder, coded: job.group.frames.into() })
    }

    /// The next frame; `None` after the last. It is not [checked](DecodedFrame::checked).
    ///
    /// # Errors
    /// If the frame is damaged or exceeds the limits. The group cannot be continued then.
    pub fn decode_next(&mut self) -> Result<Option<DecodedFrame>> {
        let Some(frame) = self.coded.pop_front() else { return Ok(None) };
        let number = self.next;
        self.next += 1;
        let decoded = decode_frame(&mut self.coder, number, &frame, &DecodeOptions::default());
        decoded.map_err(|e| e.within_frame(number, &frame.header.name))
    }
}

/// Passes the bytes of a file to `give`, piece by piece, no more than the frame's header says; an error if in
/// the end their size or checksum differs from the header's.
pub(crate) fn write_checked(
    scan: &ScanFile,
    header: &FrameHeader,
    mut give: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut size, mut crc) = (0, 0);
    files::write(scan, |piece| {
        size += piece.len() as u64;
        if size > header.file_size {
            return Err(Error::corrupt(format!("a file of more than {} bytes", header.file_size)));
        }
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
