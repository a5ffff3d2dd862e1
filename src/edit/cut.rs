//! Extracts a range of a stream's frames as a new stream. Whole groups, and beginnings of groups, are copied
//! unchanged; frames after a cut inside their group are recoded.

use std::io::{Read, Seek, Write};
use std::path::Path;

use super::copier::{GroupCopier, Named};
use super::recode::recode_from;
use crate::container::{IndexedReader, StreamReader};
use crate::ground::error::{Limits, Result};
use crate::stream::options::FrameRange;
use crate::stream::source::{GroupJob, IndexedGroups, StreamedGroups};

/// The result of a cut.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cut {
    /// Frames that were copied unchanged.
    pub copied: u64,
    /// Frames that were recoded.
    pub recoded: u64,
    /// Files beside the scans, which a range of frames leaves out.
    pub files_left_out: u64,
    /// Bytes of the new stream.
    pub stream_bytes: u64,
}

/// Extracts a range of frames from a stream that is read from front to back, as from a pipe; all of it is
/// read and checked. The frames decode to the same files as before. Frames that must be recoded use back-ends
/// at their default effort.
///
/// # Errors
/// Naming the input: if it fails or is damaged anywhere, exceeds the limits, or does not contain these
/// frames, or if a frame that must be recoded does not decode to the encoded file. Without a name: if the
/// output fails. The output is not a complete stream then.
pub fn cut(input: Named<impl Read>, frames: FrameRange, limits: &Limits, out: impl Write) -> Result<Cut> {
    let Named { path, stream } = input;
    let reader = StreamReader::open(stream, *limits).map_err(|e| e.at(&path))?;
    let mut cutter = Cutter::create(out, frames, limits)?;
    let mut groups = StreamedGroups::new(reader, frames);
    cutter.write_groups(&mut groups, &path)?;
    frames.check(groups.index().scan_count()).map_err(|e| e.at(&path))?;
    cutter.done.files_left_out = frames.left_out(groups.index());
    cutter.finish()
}

/// As [`cut`], but reads only the groups that hold the requested frames.
///
/// # Errors
/// As [`cut`]; damage elsewhere in the stream is not detected.
pub fn cut_indexed(
    input: Named<impl Read + Seek>,
    frames: FrameRange,
    limits: &Limits,
    out: impl Write,
) -> Result<Cut> {
    let Named { path, stream } = input;
    let reader = IndexedReader::open(stream, *limits).map_err(|e| e.at(&path))?;
    frames.check(reader.index().scan_count()).map_err(|e| e.at(&path))?;
    let mut cutter = Cutter::create(out, frames, limits)?;
    cutter.done.files_left_out = frames.left_out(reader.index());
    cutter.write_groups(&mut IndexedGroups::new(reader, frames), &path)?;
    cutter.finish()
}

/// Writes the groups of a range of frames.
struct Cutter<'l, W> {
    copier: GroupCopier<W>,
    frames: FrameRange,
    limits: &'l Limits,
    done: Cut,
}

impl<'l, W: Write> Cutter<'l, W> {
    fn create(out: W, frames: FrameRange, limits: &'l Limits) -> Result<Self> {
        let copier = GroupCopier::create(out)?;
        Ok(Cutter { copier, frames, limits, done: Cut::default() })
    }

    fn write_groups(
        &mut self,
        groups: &mut impl Iterator<Item = Result<GroupJob>>,
        path: &Path,
    ) -> Result<()> {
        for group in groups {
            let group = group.and_then(|group| self.cut_group(group)).map_err(|e| e.at(path))?;
            self.copier.write(&group)?;
        }
        Ok(())
    }

    /// Removes the frames that are not wanted. At the end of a group they are simply dropped, as no frame
    /// depends on a later one.
    fn cut_group(&mut self, mut job: GroupJob) -> Result<GroupJob> {
        if let Some(end) = self.frames.end {
            let wanted = end.saturating_sub(job.first_frame);
            job.group.frames.truncate(usize::try_from(wanted).unwrap_or(usize::MAX));
        }
        if job.first_frame < self.frames.start {
            recode_from(self.frames.start, &mut job, self.limits)?;
            self.done.recoded += job.group.frames.len() as u64;
        } else {
            self.done.copied += job.group.frames.len() as u64;
        }
        Ok(job)
    }

    fn finish(self) -> Result<Cut> {
        Ok(Cut { stream_bytes: self.copier.finish()?, ..self.done })
    }
}
