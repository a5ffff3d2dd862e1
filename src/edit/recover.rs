//! Recovers the intact parts of a damaged stream: as frames, or as groups of a new stream.

use std::collections::HashSet;
use std::io::{Read, Seek, Write};
use std::ops::Range;

use super::{GroupCopier, Named};
use crate::container::{FrameHeader, Group, Lost, SalvageReader, Salvaged};
use crate::ground::error::{Error, Limits, Result};
use crate::stream::decoder::{DecodedFrame, decode_group};
use crate::stream::options::{DecodeOptions, FrameRange};
use crate::stream::ordered::run_ordered;
use crate::stream::source::{GroupJob, UsedScanners, missing};

/// The fate of a part of a damaged stream.
#[derive(Clone, Debug)]
pub enum Recovered {
    /// A frame that was decoded and equals the encoded file.
    Frame(Box<DecodedFrame>),
    /// A part that is lost.
    Lost(Lost),
}

/// Decodes all intact groups of a damaged stream and, of damaged ones that the index knows, the frames before
/// the damage; passes frames and losses to `sink`, in order. A group is lost if its record is missing, or if
/// every copy of a scanner that it needs is damaged or missing. Frames keep their numbers if the index is
/// intact; otherwise the recovered frames are numbered consecutively. An undamaged stream is recovered
/// completely. Returns the number of intact files beside the scans that are left out because only some frames
/// are requested.
///
/// # Errors
/// If the input fails, contains no record at all or has another version of the format, if its index tells
/// that there are no such frames, or if the sink fails.
pub fn recover(
    input: impl Read + Seek + Send,
    options: &DecodeOptions,
    mut sink: impl FnMut(Recovered) -> Result<()>,
) -> Result<u64> {
    let mut groups = RecoveredGroups::open(input, &options.limits, options.frames)?;
    let work = |part| {
        Ok(match part {
            Part::Lost(lost) => vec![Recovered::Lost(lost)],
            Part::Group(bytes, job) => {
                let lost = lost_group(bytes, job.first_frame, &job.group, String::new());
                match decode_group(job, options, DecodedFrame::checked) {
                    Ok(frames) => frames.into_iter().map(|f| Recovered::Frame(Box::new(f))).collect(),
                    Err(error) => vec![Recovered::Lost(Lost { why: error.to_string(), ..lost })],
                }
            }
        })
    };
    let deliver = |parts: Vec<Recovered>| parts.into_iter().try_for_each(&mut sink);
    run_ordered(options.threads, &mut groups, work, deliver)?;
    if let Some(index) = groups.reader.index() {
        // There may be more scans than the index counts, if the bytes come from several streams.
        options.frames.check(groups.scans.max(index.scan_count()))?;
    }
    Ok(groups.left_out)
}

/// Copies all groups that [`recover`] finds intact, and the intact parts of others, to a new stream without
/// decoding them; returns the number of frames. Losses are passed to `on_lost`. Files beside the scans come
/// last, wherever they are.
///
/// # Errors
/// Naming the input: if it fails, contains no record at all or has another version of the format. Without a
/// name: if the output fails.
pub fn repair(
    input: Named<impl Read + Seek>,
    limits: &Limits,
    out: impl Write,
    mut on_lost: impl FnMut(Lost),
) -> Result<u64> {
    let Named { path, mut stream } = input;
    let mut copier = GroupCopier::create(out)?;
    let (mut frames, mut has_beside) = (0, false);
    for is_beside in [false, true] {
        if is_beside && !has_beside {
            break;
        }
        let groups = RecoveredGroups::open(&mut stream, limits, FrameRange::default());
        for part in groups.map_err(|e| e.at(&path))? {
            match part.map_err(|e| e.at(&path))? {
                Part::Group(_, job) if job.group.is_beside() == is_beside => {
                    frames += job.group.frames.len() as u64;
                    copier.write(&job)?;
                }
                Part::Group(..) => has_beside = true,
                // Told when they were first found.
                Part::Lost(lost) if !is_beside => on_lost(lost),
                Part::Lost(_) => {}
            }
        }
    }
    copier.finish()?;
    Ok(frames)
}

/// A part of a damaged stream.
enum Part {
    /// A group, its location in the stream, and everything needed to decode it.
    Group(Range<u64>, GroupJob),
    Lost(Lost),
}

/// The parts of a damaged stream that hold the requested frames. Of a group that occurs twice, as where a
/// stream was appended to itself, the first copy.
struct RecoveredGroups<R> {
    reader: SalvageReader<R>,
    scanners: UsedScanners,
    range: FrameRange,
    /// The files of each group so far: their names, sizes and checksums. Those without a name may repeat.
    known: HashSet<Vec<(String, u64, u32)>>,
    /// The number of the frame after the last scan so far.
    scans: u64,
    /// Number of files beside the scans so far that are left out because only some frames are requested.
    left_out: u64,
}

impl<R: Read + Seek> RecoveredGroups<R> {
    fn open(input: R, limits: &Limits, range: FrameRange) -> Result<Self> {
        let reader = SalvageReader::open(input, *limits).map_err(|error| match error {
            Error::Corrupt { what, .. } => Error::DamagedInput(format!("{what}; nothing of it can be saved")),
            other => other,
        })?;
        let (scanners, known) = (UsedScanners::default(), HashSet::new());
        Ok(RecoveredGroups { reader, scanners, range, known, scans: 0, left_out: 0 })
    }

    /// Whether a group is a copy of an earlier one; if not, it counts as earlier from now on.
    fn is_copy(&mut self, group: &Group) -> bool {
        let files = || group.frames.iter().map(|frame| &frame.header);
        let contents = files().map(|file| (file.name.clone(), file.file_size, file.file_crc)).collect();
        files().any(FrameHeader::names_file) && !self.known.insert(contents)
    }

    fn next_part(&mut self) -> Result<Option<Part>> {
        while let Some(part) = self.reader.next_part()? {
            let part = match part {
                Salvaged::Lost(lost) => Part::Lost(lost),
                Salvaged::Group { group, .. } if self.is_copy(&group) => continue,
                Salvaged::Group { first_frame, bytes, group } => {
                    let read = |id| self.reader.scanner(id).cloned().ok_or_else(|| missing(id));
                    match self.scanners.of_group(&group, read) {
                        Ok(scanners) => Part::Group(bytes, GroupJob { first_frame, scanners, group }),
                        Err(why) => Part::Lost(lost_group(bytes, first_frame, &group, why.to_string())),
                    }
                }
            };
            let frames = match &part {
                Part::Group(_, job) => {
                    let (count, is_beside) = (job.group.frames.len() as u64, job.group.is_beside());
                    match is_beside {
                        true if !self.range.is_all() => self.left_out += count,
                        true => {}
                        false => self.scans = self.scans.max(job.first_frame + count),
                    }
                    Some((job.first_frame, count, is_beside))
                }
                Part::Lost(lost) => lost.frames.as_ref().map(|frames| {
                    let is_beside =
                        self.reader.index().is_some_and(|index| frames.start >= index.scan_count());
                    (frames.start, frames.end - frames.start, is_beside)
                }),
            };
            let is_wanted = |(first, count, is_beside)| self.range.wants(first, count, is_beside);
            if self.range.is_all() || frames.is_none_or(is_wanted) {
                return Ok(Some(part));
            }
        }
        Ok(None)
    }
}

impl<R: Read + Seek> Iterator for RecoveredGroups<R> {
    type Item = Result<Part>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_part().transpose()
    }
}

/// The loss of a whole group.
fn lost_group(bytes: Range<u64>, first_frame: u64, group: &Group, why: String) -> Lost {
    let frames = Some(first_frame..first_frame + group.frames.len() as u64);
    let names = group.frames.iter().map(|frame| frame.header.name.clone()).collect();
    Lost { bytes, frames, names, why }
}
