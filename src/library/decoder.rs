//! Decodes scans from a stream: by number, or in order.

use std::collections::VecDeque;
use std::io::{Read, Seek};
use std::iter::FusedIterator;
use std::ops::{Bound, Range, RangeBounds};
use std::sync::Arc;

use rayon::ThreadPool;

use super::scan::{RangeImage, Scan};
use crate::container::{FrameHeader, FrameKind, IndexedReader, Stamp, StreamReader};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::team::{on, pool_for_frames, resolve_threads};
use crate::stream::decoder::{DecodedFrame, PartlyDecodedGroup, decode_group};
use crate::stream::ordered::Workers;
use crate::stream::source::{GroupJob, IndexedGroups, StreamedGroups};
use crate::stream::{DecodeOptions, FrameRange};

/// Number of bytes of groups that are read in one request, if consecutive groups are wanted.
const AT_ONCE: u64 = 8 << 20;

/// Decodes the scans of a seekable stream, by means of its index.
///
/// It reads little, and in large pieces, so that each read may be a request to a server: the last 64 KiB,
/// with the index, and then each group in one request, or up to 8 MiB of consecutive groups. The beginning of
/// the stream is not read by itself, as the end repeats its contents.
pub struct Decoder<R> {
    groups: IndexedGroups<R>,
    limits: Limits,
    threads: usize,
    images: bool,
    /// The group of the scan last requested by number.
    kept: Option<KeptGroup>,
    /// Threads that decode the scans requested by number; created when first needed.
    pool: Option<Arc<ThreadPool>>,
}

/// A group, decoded up to the last requested scan.
struct KeptGroup {
    first_frame: u64,
    /// All are checked, also those that are decoded only because later ones depend on them: together they
    /// then take no more memory than the sizes of their files, which the group's reader has limited, allow.
    scans: Vec<Result<Scan>>,
    open: PartlyDecodedGroup,
}

/// The properties of a frame according to the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct FrameInfo {
    /// Its number, the first being 0.
    pub number: u64,
    /// The kind of input.
    pub kind: FrameKind,
    /// The track: which of several scanners it is from; the first is 0.
    pub track: u8,
    /// The time at which it was taken, in nanoseconds since 1970, if known.
    pub time: Option<i64>,
    /// Its coded size in bytes.
    pub coded_bytes: u64,
}

/// The properties of a frame that can be read without decoding it.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct FrameDetails {
    /// Its number, the first being 0.
    pub number: u64,
    /// Its name; empty if it has none. It may be any string: check it before use as a path.
    pub name: String,
    /// Number of points.
    pub points: u64,
    /// Size in bytes of the file, or of the points as records.
    pub bytes: u64,
}

impl<R: Read + Seek + Send> Decoder<R> {
    /// Reads the index of a stream.
    ///
    /// # Errors
    /// If the input fails, is not a stream, is damaged at its beginning or end, or has another version of the
    /// format.
    pub fn open(input: R) -> Result<Self> {
        Self::open_with_limits(input, Limits::default())
    }

    /// As [`open`](Self::open), with limits on allocations.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with_limits(input: R, limits: Limits) -> Result<Self> {
        let reader = IndexedReader::open_at_end(input, limits)?;
        let groups = IndexedGroups::new(reader, FrameRange::default()).reading_at_once(AT_ONCE);
        Ok(Decoder { groups, limits, threads: 1, images: false, kept: None, pool: None })
    }

    /// Whether scans come with their [range images](Scan::range_image). Default: no, as they take some time
    /// and memory.
    #[must_use]
    pub fn with_range_images(self, images: bool) -> Self {
        Decoder { images, kept: None, ..self }
    }

    /// Makes [`scans`](Self::scans) decode ahead on `threads` threads, and [`scan`](Self::scan) use two
    /// threads if this is more than one; 0 means one per processor. With 1, the default, the caller's thread
    /// decodes a group when its first scan is requested.
    #[must_use]
    pub fn with_threads(self, threads: usize) -> Self {
        Decoder { threads, pool: None, ..self }
    }

    /// Number of scans. Files beside the scans are not counted, and not decoded.
    pub fn len(&self) -> u64 {
        self.groups.index().scan_count()
    }

    /// Whether there are no scans.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The properties of each scan according to the index.
    pub fn frames(&self) -> impl Iterator<Item = FrameInfo> {
        let groups = self.groups.index().groups.iter().filter(|group| !group.is_beside());
        let frames = groups.flat_map(|group| (group.first_frame..).zip(&group.frames));
        frames.map(|(number, frame)| {
            let Stamp { kind, track, time } = frame.stamp;
            FrameInfo {
                number,
                kind,
                track,
                time: time.map(|time| time.nanoseconds),
                coded_bytes: frame.size,
            }
        })
    }

    /// The numbers of the frames in the same group as this one, which are cheap to decode after it; `None` if
    /// there is no such frame.
    pub fn group_of(&self, number: u64) -> Option<Range<u64>> {
        let groups = &self.groups.index().groups;
        let next = groups.partition_point(|group| group.first_frame <= number);
        let group = groups.get(next.checked_sub(1)?).filter(|group| !group.is_beside())?;
        let range = group.first_frame..group.end();
        range.contains(&number).then_some(range)
    }

    /// The first frame of each group, in order, and the number of frames.
    pub fn group_borders(&self) -> Vec<u64> {
        let next = |start: &u64| Some(self.group_of(*start)?.end);
        std::iter::successors(Some(0), next).collect()
    }

    /// The properties of these frames. Reads their groups, but decodes nothing.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are no such frames; if the input fails or is damaged there.
    pub fn details(&mut self, frames: impl RangeBounds<u64>) -> Result<Vec<FrameDetails>> {
        let range = self.seek(&frames)?;
        let mut details = Vec::new();
        for job in &mut self.groups {
            let GroupJob { first_frame, group, .. } = job?;
            let frames = (first_frame..).zip(group.frames);
            details.extend(frames.filter(|(number, _)| range.contains(*number)).map(|(number, frame)| {
                let FrameHeader { name, point_count: points, file_size: bytes, .. } = frame.header;
                FrameDetails { number, name, points, bytes }
            }));
        }
        Ok(details)
    }

    /// A description of each scanner, as printed by `lidarpc info`. Reads only the scanners.
    ///
    /// # Errors
    /// If the input fails or is damaged there.
    pub fn scanners(&mut self) -> Result<Vec<String>> {
        let scanners = self.groups.read_scanners()?;
        Ok(scanners.iter().map(|scanner| scanner.description()).collect())
    }

    /// The scan with this number, the first being 0. Only its group is read, and decoded up to this scan. The
    /// group is kept, and continued when another of its scans is requested. To get many scans in order,
    /// [`scans`](Self::scans) is faster, as it may use several threads.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is no such scan; if the input fails, is damaged there, or exceeds the
    /// limits.
    pub fn scan(&mut self, number: u64) -> Result<Scan> {
        let missing =
            || Error::Usage(format!("there is no frame {number}; the stream has {} frames", self.len()));
        let group = self.group_of(number).ok_or_else(missing)?;
        // After an error the group cannot be continued.
        let mut kept = match self.kept.take().filter(|kept| kept.first_frame == group.start) {
            Some(kept) => kept,
            None => self.open_group(group.start)?,
        };
        if self.pool.is_none() {
            self.pool = pool_for_frames(self.threads)?.map(Arc::new);
        }
        let scan = on(self.pool.as_deref(), || kept.scan(number))?;
        self.kept = Some(kept);
        Ok(scan)
    }

    /// The group that begins with this frame.
    fn open_group(&mut self, first_frame: u64) -> Result<KeptGroup> {
        self.groups.seek(FrameRange { start: first_frame, end: first_frame.checked_add(1) });
        let job = self.groups.next().unwrap_or_else(|| Err(lost_frames()))?;
        let open = PartlyDecodedGroup::new(job, &self.limits, self.images)?;
        Ok(KeptGroup { first_frame, scans: Vec::new(), open })
    }

    /// These scans in order. An error, or a range that is not in the stream, is the last item.
    pub fn scans(&mut self, frames: impl RangeBounds<u64>) -> Scans<'_> {
        let (range, options) = (self.seek(&frames), self.options());
        scans_of(range, &mut self.groups, options)
    }

    /// As [`scans`](Self::scans), for iterators that outlive the decoder. A clone of the decoder shares the
    /// index.
    pub fn into_scans<'r>(mut self, frames: impl RangeBounds<u64>) -> Scans<'r>
    where
        R: 'r,
    {
        let (range, options) = (self.seek(&frames), self.options());
        scans_of(range, self.groups, options)
    }

    fn options(&self) -> DecodeOptions {
        let Decoder { threads, limits, images, .. } = *self;
        DecodeOptions { threads, limits, images, frames: FrameRange::default() }
    }

    /// Seeks to the group of the first of these frames.
    fn seek(&mut self, frames: &impl RangeBounds<u64>) -> Result<FrameRange> {
        let start = match frames.start_bound() {
            Bound::Included(start) => *start,
            Bound::Excluded(before) => before.saturating_add(1),
            Bound::Unbounded => 0,
        };
        let end = match frames.end_bound() {
            Bound::Included(last) => last.saturating_add(1),
            Bound::Excluded(end) => *end,
            Bound::Unbounded => self.len(),
        };
        let len = self.len();
        if start > end || end > len {
            return Err(Error::Usage(format!(
                "there are no frames {start}..{end}; the stream has {len} frames"
            )));
        }
        let range = FrameRange { start, end: Some(end) };
        self.groups.seek(range);
        Ok(range)
    }
}

/// The scans in this range of the groups, or an error if the range is not in the stream.
fn scans_of<'r>(
    range: Result<FrameRange>,
    groups: impl Iterator<Item = Result<GroupJob>> + Send + 'r,
    options: DecodeOptions,
) -> Scans<'r> {
    match range {
        Ok(frames) => {
            let most = frames.end.map(|end| (end - frames.start) as usize);
            Scans { most, ..Scans::new(Box::new(groups), DecodeOptions { frames, ..options }) }
        }
        Err(error) => Scans { most: Some(1), ..Scans::new(Box::new(std::iter::once(Err(error))), options) },
    }
}

fn lost_frames() -> Error {
    Error::corrupt("a group without its frames")
}

impl KeptGroup {
    /// The scan with this number, which is in the group. After an error, the group is of no further use.
    fn scan(&mut self, number: u64) -> Result<Scan> {
        let place = (number - self.first_frame) as usize;
        while self.scans.len() <= place {
            let decoded = self.open.decode_next()?.ok_or_else(lost_frames)?;
            self.scans.push(decoded.checked().map(scan_of));
        }
        match &mut self.scans[place] {
            Ok(scan) => Ok(scan.clone()),
            damaged => std::mem::replace(damaged, Err(lost_frames())),
        }
    }
}

/// A decoded and checked frame as a scan of the public interface.
fn scan_of(frame: DecodedFrame) -> Scan {
    let image = frame.image.map(|image| RangeImage::new(&image, &frame.scan.cloud.positions));
    Scan::of_parts(frame.scan, frame.header.stamp).with_range_image(image)
}

impl<R: Clone> Clone for Decoder<R> {
    /// A decoder that reads independently from a clone of the input. It shares the index, but not the group
    /// of the scan last requested.
    fn clone(&self) -> Self {
        let groups = self.groups.clone();
        let Decoder { limits, threads, images, ref pool, .. } = *self;
        Decoder { groups, limits, threads, images, kept: None, pool: pool.clone() }
    }
}

impl<R> std::fmt::Debug for Decoder<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Decoder").field("threads", &self.threads).finish_non_exhaustive()
    }
}

/// Scans of a stream in order: from [`Decoder::scans`], or [from a pipe](Self::from_reader). After an error there
/// are no more.
pub struct Scans<'d> {
    groups: Box<dyn Iterator<Item = Result<GroupJob>> + Send + 'd>,
    options: DecodeOptions,
    /// None until the first scan is requested, and after an error.
    workers: Option<Workers<DecodedGroup>>,
    /// Decoded scans that were not requested yet.
    ready: VecDeque<Scan>,
    /// The error that follows these scans.
    error: Option<Error>,
    /// Whether all groups are read.
    ended: bool,
    /// The largest number of remaining items, including an error, if known.
    most: Option<usize>,
}

/// The scans of a group, up to an error.
struct DecodedGroup {
    scans: Vec<Scan>,
    error: Option<Error>,
}

impl<'d> Scans<'d> {
    /// The scans of a stream from front to back, as from a pipe. The stream is complete if the last item is not an
    /// error.
    ///
    /// # Errors
    /// If the input fails, is not a stream, or has another version of the format.
    pub fn from_reader(input: impl Read + Send + 'd) -> Result<Self> {
        Self::from_reader_with_limits(input, Limits::default())
    }

    /// As [`from_reader`](Self::from_reader), with limits on allocations.
    ///
    /// # Errors
    /// As [`from_reader`](Self::from_reader).
    pub fn from_reader_with_limits(input: impl Read + Send + 'd, limits: Limits) -> Result<Self> {
        let groups = StreamedGroups::new(StreamReader::open(input, limits)?, FrameRange::default());
        let options = DecodeOptions { threads: 1, limits, ..DecodeOptions::default() };
        Ok(Scans::new(Box::new(groups), options))
    }

    /// Makes the iterator decode ahead on `threads` threads; 0 means one per processor, 1, the default, the
    /// caller's thread only. To be called before the first item is taken.
    #[must_use]
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.options.threads = threads;
        self
    }

    /// Whether scans come with their [range images](Scan::range_image). Default: no.
    #[must_use]
    pub fn with_range_images(mut self, images: bool) -> Self {
        self.options.images = images;
        self
    }

    fn new(groups: Box<dyn Iterator<Item = Result<GroupJob>> + Send + 'd>, options: DecodeOptions) -> Self {
        Scans {
            groups,
            options,
            workers: None,
            ready: VecDeque::new(),
            error: None,
            ended: false,
            most: None,
        }
    }

    /// Reads groups for all threads, and takes the scans of the next decoded one; false if there is none.
    fn advance(&mut self) -> Result<bool> {
        let workers = match &mut self.workers {
            Some(workers) => workers,
            empty => empty.insert(Workers::new(self.options.threads)?),
        };
        // A single thread decodes only when scans are requested, so that no group has to wait.
        while !self.ended && !workers.is_full() {
            let Some(job) = self.groups.next() else {
                self.ended = true;
                break;
            };
            self.ended = job.is_err();
            let options = self.options.clone();
            workers.start(move || Ok(decode(job?, &options)));
            if resolve_threads(self.options.threads) == 1 {
                break;
            }
        }
        let Some(group) = workers.wait().transpose()? else { return Ok(false) };
        self.ready.extend(group.scans);
        group.error.map_or(Ok(true), Err)
    }
}

/// Decodes the requested scans of a group.
fn decode(job: GroupJob, options: &DecodeOptions) -> DecodedGroup {
    let mut scans = Vec::new();
    let error = decode_group(job, options, |frame| {
        let frame = frame.checked()?;
        if frame.header.stamp.kind != FrameKind::Beside {
            scans.push(scan_of(frame));
        }
        Ok(())
    });
    DecodedGroup { error: error.err(), scans }
}

impl Iterator for Scans<'_> {
    type Item = Result<Scan>;

    /// The upper limit is the number of requested scans; an error ends them sooner. For a pipe it is unknown.
    fn size_hint(&self) -> (usize, Option<usize>) {
        let least = self.ready.len() + usize::from(self.error.is_some());
        (least, self.most.map(|most| most.max(least)))
    }

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(scan) = self.ready.pop_front() {
                self.most = self.most.map(|most| most.saturating_sub(1));
                return Some(Ok(scan));
            }
            if self.workers.is_none() && self.ended {
                return None;
            }
            if let Some(error) = self.error.take() {
                self.workers = None;
                self.ended = true;
                self.most = Some(0);
                return Some(Err(error));
            }
            match self.advance() {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => self.error = Some(error),
            }
        }
    }
}

impl FusedIterator for Scans<'_> {}

impl std::fmt::Debug for Scans<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scans").finish_non_exhaustive()
    }
}
