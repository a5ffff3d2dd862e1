//! Extracts a range of a stream's frames as a new stream. Whole groups, and beginnings of groups, are copied
//! unchanged; frames after a cut inside their group are recoded as a new group, since they depend on those
//! before them.
//!
//! Recoding starts from the decoded `FrameParts`, that is, from the integers of a frame's sections rather
//! than from points, so that lossy frames lose nothing further. The output of an image coder is copied
//! unchanged.

use std::io::{Read, Seek, Write};
use std::path::Path;

use super::{GroupCopier, Named};
use crate::container::{CodedFrame, IndexedReader, StreamReader, pay_for};
use crate::frame::decoder::decode_parts;
use crate::frame::parameters::Prediction;
use crate::frame::sections::{Effort, SectionWriter};
use crate::frame::syntax::Models;
use crate::ground::error::{Error, Limits, Result};
use crate::scanner::Scanner;
use crate::stream::decoder::write_checked;
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

/// Decodes a group, and recodes its frames from number `start` of the sequence on as a new group with the
/// same scanners. The headers of the frames are not changed, nor are their parameters, except for those of a
/// frame that has lost its reference, and for bins: decoded ranges are coded as they are.
///
/// # Errors
/// If a scanner is of a family that this program does not know; if a frame cannot be decoded, exceeds the
/// limits, or contradicts its header; or if a back-end's library fails.
fn recode_from(start: u64, job: &mut GroupJob, limits: &Limits) -> Result<()> {
    let frames = std::mem::take(&mut job.group.frames);
    let recoder = |scanner| Recoder { scanner, limits, old: Models::default(), new: Models::default() };
    let mut tracks: Vec<_> = job.known_scanners()?.into_iter().map(recoder).collect();
    let mut recoded = Vec::new();
    for (number, frame) in (job.first_frame..).zip(frames) {
        let name = frame.header.name.clone();
        let track = tracks.get_mut(usize::from(frame.header.stamp.track));
        let recoder =
            track.ok_or_else(|| Error::corrupt("a frame of a track that the group does not have"))?;
        recoded.extend(recoder.recode(frame, number >= start).map_err(|e| e.within_frame(number, &name))?);
    }
    (job.group.frames, job.first_frame) = (recoded, start);
    Ok(())
}

/// Decodes the frames of a track with one set of models, and codes them with another.
struct Recoder<'a> {
    scanner: Option<&'a Scanner>,
    limits: &'a Limits,
    /// The models of the old group.
    old: Models,
    /// The models of the new group.
    new: Models,
}

impl Recoder<'_> {
    /// Decodes the next frame, and recodes it if `wanted`; earlier frames are decoded only because others
    /// depend on them.
    fn recode(&mut self, coded: CodedFrame, wanted: bool) -> Result<Option<CodedFrame>> {
        let CodedFrame { header, sections } = coded;
        let (mut frame, _) = decode_parts(&mut self.old, self.scanner, &header, &sections, self.limits)?;
        if !wanted {
            return Ok(None);
        }
        let models = &mut self.new;
        if models.past().is_none() && frame.parameters.prediction == Prediction::Inter {
            // Its reference is not in the new group.
            frame.predict_from_nothing();
            frame.leave_image();
        }
        frame.parameters.range_coder = frame.parameters.range_coder.of_decoded();
        let mut writer = SectionWriter::new(Effort::default());
        models.code_frame(&mut writer, self.scanner, &mut frame)?;
        let unfolded = frame.unfolded_bytes().max(header.file_size);
        write_checked(&frame.into_scan(&header.name)?, &header, |_| Ok(()))?;
        // Sections that this program does not know are kept.
        let unknown = sections.into_iter().filter(|section| section.kind.is_skippable());
        let mut sections: Vec<_> = writer.sections.into_iter().chain(unknown).collect();
        pay_for(&mut sections, unfolded);
        Ok(Some(CodedFrame { header, sections }))
    }
}
