//! Recodes the end of a group as a new group. Frames of a group depend on those before them, so those after a
//! cut must be recoded. This starts from the decoded [`FrameParts`], that is, from the integers of its
//! sections rather than from points, so that lossy frames lose nothing further. The output of an image coder
//! is copied unchanged.

use crate::container::{CodedFrame, pay_for};
use crate::frame::decoder::decode_parts;
use crate::frame::parameters::Prediction;
use crate::frame::sections::{Effort, SectionWriter};
use crate::frame::syntax::Models;
use crate::ground::error::{Error, Limits, Result};
use crate::scanner::Scanner;
use crate::stream::decoder::write_checked;
use crate::stream::source::GroupJob;

/// Decodes a group, and recodes its frames from number `start` of the sequence on as a new group with the
/// same scanners. The headers of the frames are not changed, nor are their parameters, except for those of a
/// frame that has lost its reference, and for bins: decoded ranges are coded as they are.
///
/// # Errors
/// If a scanner is of a family that this program does not know; if a frame cannot be decoded, exceeds the
/// limits, or contradicts its header; or if a back-end's library fails.
pub(crate) fn recode_from(start: u64, job: &mut GroupJob, limits: &Limits) -> Result<()> {
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
