//! Codes the end of a group as a group of its own. Frames of a group depend on those before them, so what
//! comes after a cut is coded again. This starts from the decoded [`FrameParts`], that is, from the integers of
//! its sections and not from the points that they stand for, so lossy frames lose nothing further. The output
//! of an image coder is written again as it is.

use crate::container::{CodedFrame, allowance, pay_for};
use crate::frame::parameters::Prediction;
use crate::frame::parts::FrameParts;
use crate::frame::sections::{Effort, SectionReader, SectionWriter};
use crate::frame::syntax::Models;
use crate::ground::error::{Error, Limits, Result};
use crate::scanner::Scanner;
use crate::stream::decoder::write_checked;
use crate::stream::source::GroupJob;

/// Decodes a group, and codes its frames from number `start` of the sequence on as a new group with the same
/// scanners. The headers of the frames stay as they are, and so do their parameters, except for those of a
/// frame that has lost its reference, and for bins: decoded ranges are coded as they are.
///
/// # Errors
/// If a scanner is of a family that this program does not know; if a frame does not decode, exceeds the
/// limits, or is not the file of which its header tells; or if a back-end's library fails.
pub(crate) fn recode_from(start: u64, job: &mut GroupJob, limits: &Limits) -> Result<()> {
    let frames = std::mem::take(&mut job.group.frames);
    let recoder = |scanner| Recoder { scanner, limits, old: Models::default(), new: Models::default() };
    let mut tracks: Vec<_> = job.models()?.into_iter().map(recoder).collect();
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

/// Decodes the frames of a track of a group with one set of models, and codes them with another.
struct Recoder<'a> {
    scanner: Option<&'a Scanner>,
    limits: &'a Limits,
    /// What the frames of the old group have taught.
    old: Models,
    /// What the frames of the new group have taught.
    new: Models,
}

impl Recoder<'_> {
    /// Decodes the next frame, and codes it if `wanted`; earlier frames are decoded only because others
    /// depend on them.
    fn recode(&mut self, coded: CodedFrame, wanted: bool) -> Result<Option<CodedFrame>> {
        let CodedFrame { header, sections } = coded;
        let mut frame = FrameParts::of_records(header.point_count as usize);
        let limits = self.limits.at_most(allowance(&sections));
        let mut reader = SectionReader::new(&sections, &limits);
        self.old.code_frame(&mut reader, self.scanner, &mut frame)?;
        reader.finish()?;
        if !wanted {
            return Ok(None);
        }
        let models = &mut self.new;
        if models.past().is_none() && frame.parameters.prediction == Prediction::Inter {
            // The frame that it was predicted from is not in the new group.
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
