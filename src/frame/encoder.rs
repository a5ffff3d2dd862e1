//! Encodes a group of pictures: frames coded one after the other with models that learn from each. Frames of
//! several scanners may alternate; those of each scanner are a track of the group, with its own models. Groups
//! are independent of each other.

use std::mem::take;

use super::bound::{Bound, file_rounding_um, smaller_errors, step_rounding_um};
use super::fidelity::{IntensityFidelity, PositionFidelity};
use super::levels::InterChoice;
use super::parameters::{Prediction, RangeCoder};
use super::parts::FrameParts;
use super::sections::{Effort, SectionWriter};
use super::settings::EncoderConfig;
use super::stages::{Stage, StageReport};
use super::syntax::Models;
use super::whole::WholeFile;
use crate::backend::Verdict;
use crate::container::{
    FrameHeader, FrameKind, Section, SectionKind, pay_for, payload_bytes, payload_bytes_of,
};
use crate::files::rounded_by_file;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use crate::inter;
use crate::inter::registration::{QuantisedPose, register};
use crate::scan::ScanFile;
use crate::scanner::Scanner;

/// Encodes the frames of one group.
pub struct GroupEncoder<'s> {
    tracks: Vec<TrackEncoder<'s>>,
    config: &'s EncoderConfig,
}

/// Encodes the frames of one track of a group.
struct TrackEncoder<'s> {
    config: &'s EncoderConfig,
    state: TrackState<'s>,
    /// What the last frame has shown of a general-purpose compressor.
    whole: Verdict,
    /// Whether bounded mode was smaller than exact mode for a frame of the group.
    bound_pays: bool,
    /// The error, in micrometres, with which the points are coded: the bound, or less where that is smaller.
    error_um: Option<u32>,
    /// The part of the bound, in micrometres, that the digits of text have needed so far.
    of_digits_um: u32,
}

/// What the frames of a track leave for the next.
#[derive(Clone, Default)]
struct TrackState<'s> {
    scanner: Option<&'s Scanner>,
    /// How well the scanner explains the last frame that was smaller without a range image, if there was one:
    /// others like that are coded without one, too.
    score_without_image: Option<f64>,
    /// In a box, as they are large and change hands.
    models: Box<Models>,
    /// The last motion of the scanner, from frame to frame.
    motion: QuantisedPose,
    /// Number of frames coded so far.
    frames: usize,
    /// Whether images are split into halves, once the first one has decided this.
    halves: Option<bool>,
}

/// A frame coded by [`GroupEncoder`].
pub struct EncodedFrame {
    /// The frame header.
    pub header: FrameHeader,
    /// The coded sections.
    pub sections: Vec<Section>,
    /// Time and size of each stage. If several predictions were tried, those of the chosen one.
    pub stages: StageReport,
}

/// A frame coded in one of several ways, and how its track goes on if that way is taken.
struct Candidate<'s> {
    encoded: EncodedFrame,
    /// The decoded file, unless it is the original.
    lossy: Option<LossyFile>,
    after: TrackState<'s>,
}

/// A file that differs from the original.
struct LossyFile {
    scan: ScanFile,
    bytes: Vec<u8>,
}

impl EncodedFrame {
    /// Bytes of the sections.
    fn size(&self) -> usize {
        payload_bytes(&self.sections)
    }

    fn channel_bytes(&self) -> usize {
        payload_bytes_of(&self.sections, SectionKind::Channels)
    }
}

impl Candidate<'_> {
    /// Whether it takes fewer bytes than another candidate, if there is one.
    fn is_smaller_than(&self, other: Option<&Self>) -> bool {
        other.is_none_or(|other| self.encoded.size() < other.encoded.size())
    }
}

impl<'s> GroupEncoder<'s> {
    /// A new group whose tracks have these scanners.
    pub fn new(scanners: &[Option<&'s Scanner>], config: &'s EncoderConfig) -> Self {
        let tracks = scanners.iter().map(|scanner| TrackEncoder::new(*scanner, config)).collect();
        GroupEncoder { tracks, config }
    }

    /// Encodes the next frame so that decoders accept it under [`Limits::default`](crate::Limits::default).
    /// `original` describes its file and names its track; a track that the group does not have yet has no
    /// scanner. In bounded mode, a frame is coded exactly if it would exceed the bound, such as text with too few
    /// digits for the decoded values, or if that is smaller: some channels follow from exact positions alone.
    ///
    /// # Errors
    /// If the scan exceeds those limits, or if a back-end's library fails.
    pub fn encode_frame(&mut self, scan: ScanFile, original: FrameHeader) -> Result<EncodedFrame> {
        let track = usize::from(original.stamp.track);
        let tracks = self.tracks.len().max(track + 1);
        self.tracks.resize_with(tracks, || TrackEncoder::new(None, self.config));
        self.tracks[track].encode_frame(scan, original)
    }
}

impl<'s> TrackEncoder<'s> {
    fn new(scanner: Option<&'s Scanner>, config: &'s EncoderConfig) -> Self {
        TrackEncoder {
            config,
            state: TrackState { scanner, ..TrackState::default() },
            whole: Verdict::Open,
            bound_pays: false,
            error_um: None,
            of_digits_um: 0,
        }
    }

    /// As [`GroupEncoder::encode_frame`].
    fn encode_frame(&mut self, scan: ScanFile, original: FrameHeader) -> Result<EncodedFrame> {
        if original.stamp.kind == FrameKind::Beside {
            return self.encode_beside(&scan, original);
        }
        let before = take(&mut self.state);
        let Candidate { encoded, after, .. } = match self.config.positions {
            PositionFidelity::Bounded { max_error_um, .. } => {
                self.encode_bounded(&before, &scan, &original, max_error_um)?
            }
            _ => self.encode_as(before, self.config, scan, original)?,
        };
        self.state = after;
        Ok(encoded)
    }

    /// Codes a frame as the one after `before` within the bound or, if that is smaller, exactly.
    fn encode_bounded(
        &mut self,
        before: &TrackState<'s>,
        scan: &ScanFile,
        original: &FrameHeader,
        max_error_um: u32,
    ) -> Result<Candidate<'s>> {
        let within = self.error_um.unwrap_or(max_error_um);
        let mut bounded = self.within_bound(before, scan, original, within)?;
        if let Some(bounded) = bounded.take_if(|_| self.bound_pays) {
            return Ok(bounded);
        }
        let (positions, intensity) = (PositionFidelity::Exact, IntensityFidelity::Exact);
        let config = EncoderConfig { positions, intensity, ..self.config.clone() };
        let exact = self.encode_as(before.clone(), &config, scan.clone(), original.clone())?;
        // The other fields of a record stay exact. If they follow from the position, they may take more bytes
        // with a larger error than the positions save.
        let channels_grow =
            bounded.as_ref().is_some_and(|b| b.encoded.channel_bytes() > exact.encoded.channel_bytes());
        if self.error_um.is_none() && channels_grow {
            for within in smaller_errors(max_error_um) {
                let smaller = self.within_bound(before, scan, original, within)?;
                if let Some(smaller) = smaller.filter(|smaller| smaller.is_smaller_than(bounded.as_ref())) {
                    (bounded, self.error_um) = (Some(smaller), Some(within));
                }
            }
        }
        // A scan without points tells nothing about others.
        if scan.records > 0 {
            self.error_um.get_or_insert(max_error_um);
        }
        let bounded = bounded.filter(|bounded| bounded.is_smaller_than(Some(&exact)));
        self.bound_pays = bounded.is_some();
        Ok(bounded.unwrap_or(exact))
    }

    /// Codes a frame as the one after `before` with at most this error; `None` if the decoded file would
    /// exceed it. If only the digits of its text are to blame, the points are coded with a smaller error.
    fn within_bound(
        &mut self,
        before: &TrackState<'s>,
        scan: &ScanFile,
        original: &FrameHeader,
        max_error_um: u32,
    ) -> Result<Option<Candidate<'s>>> {
        /// Number of times that a frame is coded at most.
        const ATTEMPTS: usize = 3;
        let PositionFidelity::Bounded { on_grid, .. } = self.config.positions else { return Ok(None) };
        let within = |max_error_um| PositionFidelity::Bounded { max_error_um, on_grid };
        let of_file = max_error_um.saturating_sub(file_rounding_um(scan));
        let Some(bound) = Bound::of(within(of_file), self.config.intensity) else { return Ok(None) };
        for _ in 0..ATTEMPTS {
            let of_points = of_file.saturating_sub(step_rounding_um(scan)).saturating_sub(self.of_digits_um);
            if of_points == 0 {
                break;
            }
            let config = EncoderConfig { positions: within(of_points), ..self.config.clone() };
            let mut candidate = self.encode_as(before.clone(), &config, scan.clone(), original.clone())?;
            let Some(decoded) = candidate.lossy.take() else { break };
            let Some(written) = rounded_by_file(&decoded.scan, decoded.bytes) else {
                return Ok(bound.holds(scan, &decoded.scan).then_some(candidate));
            };
            if bound.holds(scan, &written) {
                return Ok(Some(candidate));
            }
            let positions = [scan, &decoded.scan, &written].map(|scan| &scan.cloud.positions[..]);
            let displaced_um =
                (1e6 * bound.displaced_by(positions[0], positions[1], positions[2])).ceil() as u32;
            if displaced_um <= self.of_digits_um {
                break;
            }
            self.of_digits_um = displaced_um;
        }
        Ok(None)
    }

    /// Encodes a file that is not a scan, in every mode, as its bytes.
    fn encode_beside(&mut self, file: &ScanFile, original: FrameHeader) -> Result<EncodedFrame> {
        let stages = StageReport { frames: 1, original: original.file_size, ..StageReport::default() };
        let whole = WholeFile::of_any_file(file, self.config.compressors())?;
        encode_whole(&mut self.state.models, whole, 0, original, stages)
    }

    /// Codes a frame as the one after `state` with these settings, in the steps of the article.
    fn encode_as(
        &mut self,
        mut state: TrackState<'s>,
        config: &EncoderConfig,
        scan: ScanFile,
        original: FrameHeader,
    ) -> Result<Candidate<'s>> {
        let mut stages = StageReport { frames: 1, original: original.file_size, ..StageReport::default() };
        let name = scan.name.clone();
        let has_image = state.has_image(&scan);
        let mut frame = FrameParts::from_scan(scan, state.scanner, has_image, config, &mut stages)?;
        // All frames of a track are like its first, unless one was coded without an image.
        let may_do_without = has_image && (state.frames == 0 || state.score_without_image.is_some());
        let state_before = may_do_without.then(|| state.clone());
        let models_before = may_be_unexplained(&frame, config).then(|| (state.models.clone(), stages));
        frame.parameters.halved = state.halves(&frame, config);
        let fit = stages.timed(Stage::Registration, || state.estimate_motion(&frame, config));
        let best = state.best_attempt(frame, fit, config, stages)?;
        if let Some(before) = state_before
            && let Some(candidate) = self.without_image(before, &best, config, &name, &original)?
        {
            return Ok(candidate);
        }
        // Where a compressor wins, the models are tried again: other scans of the group may be theirs.
        if let Some((models, stages)) = models_before
            && let Some(whole) = self.as_whole_file(&best, config, &name, &original)?
        {
            state.models = models;
            let encoded = encode_whole(&mut state.models, whole, best.frame.records, original, stages)?;
            return Ok(Candidate { encoded, lossy: None, after: state });
        }
        state.models = best.models;
        let (encoded, lossy) = finished(best.frame, best.sections, best.stages, &name, original)?;
        Ok(Candidate { encoded, lossy, after: state })
    }

    /// A frame without a range image, as the one after `before`, if that is smaller: a scanner may know where the
    /// points are, but not the numbers of the file.
    fn without_image(
        &mut self,
        mut before: TrackState<'s>,
        best: &Attempt,
        config: &EncoderConfig,
        name: &str,
        original: &FrameHeader,
    ) -> Result<Option<Candidate<'s>>> {
        if !are_corrections_costly(&best.frame, &best.sections) {
            return Ok(None);
        }
        let scan = best.frame.clone().into_scan(name)?;
        before.score_without_image = before.score(&scan);
        let without = self.encode_as(before, config, scan, original.clone())?;
        Ok(Some(without).filter(|without| without.encoded.size() < best.size()))
    }

    /// The bytes of the frame's file by a general-purpose compressor, if the models do not suit it and that is
    /// smaller.
    fn as_whole_file(
        &mut self,
        best: &Attempt,
        config: &EncoderConfig,
        name: &str,
        original: &FrameHeader,
    ) -> Result<Option<WholeFile>> {
        if !is_unexplained(&best.frame, &best.sections, original.file_size) {
            return Ok(None);
        }
        let scan = best.frame.clone().into_scan(name)?;
        WholeFile::shorter(&scan, config.compressors(), best.size(), &mut self.whole)
    }
}

impl TrackState<'_> {
    /// How well the scanner explains a scan, if there is one.
    fn score(&self, scan: &ScanFile) -> Option<f64> {
        self.scanner.map(|scanner| scanner.score(&scanner.along_axes(&scan.cloud)))
    }

    /// Whether a scan has a range image.
    fn has_image(&self, scan: &ScanFile) -> bool {
        /// The scanner must explain a scan better than one without an image by so much.
        const BETTER: f64 = 0.25;
        let Some(without) = self.score_without_image else { return true };
        self.score(scan).is_some_and(|score| score > without + BETTER)
    }

    /// Whether the halves of a frame's image are coded separately. The first frame decides for all: they are
    /// if its image is large and the models adapt to each value.
    fn halves(&mut self, frame: &FrameParts, config: &EncoderConfig) -> bool {
        let RangeCoder::Context { modelling, .. } = frame.parameters.range_coder else { return false };
        let returns = frame.occupancy.cells().iter().filter(|filled| **filled).count();
        modelling.parts().is_adaptive()
            && returns > 0
            && *self.halves.get_or_insert(returns >= config.halved_from)
    }

    /// Estimates the motion of the scanner since the frame before, if the frame may be predicted from that
    /// (equation 8). Returns how much of that frame fits this one, from 0 to 1; `None` if it does not fit.
    fn estimate_motion(&mut self, frame: &FrameParts, config: &EncoderConfig) -> Option<f64> {
        /// The minimum share of returns with the same range as before if the scanner stands still.
        const STANDING_STILL: f64 = 0.5;
        let (scanner, past) = (self.scanner?, self.models.past()?);
        let choice = config.inter_choice(self.frames);
        let is_too_large = frame.image.steps.cells().len() > inter::MOST_CELLS;
        if frame.strays.count == frame.records || is_too_large || choice == InterChoice::Never {
            return None;
        }
        let surfaces = scanner.hdl64();
        if choice == InterChoice::StandingStill || surfaces.is_none() {
            let agreement = past.agreement(&frame.image.columns, &frame.image.steps, scanner);
            if agreement < STANDING_STILL {
                return None;
            }
            if surfaces.is_none() || frame.parameters.can_do_without_surfaces() {
                self.motion = QuantisedPose::default();
                return Some(agreement);
            }
        }
        let scanner = surfaces?;
        let surface = past.surface(scanner);
        let found = register(surface, &frame.image, scanner, &self.motion.pose(), &config.registration);
        let motion = found.and_then(|found| found.pose.quantise());
        self.motion = motion.unwrap_or_default();
        motion.and(found).map(|found| found.fit)
    }

    /// Codes the next frame with each prediction that is worth a try, and returns the best result. The models
    /// are left to it.
    fn best_attempt(
        &mut self,
        mut frame: FrameParts,
        fit: Option<f64>,
        config: &EncoderConfig,
        stages: StageReport,
    ) -> Result<Attempt> {
        frame.parameters.motion = self.motion;
        let has_regions =
            frame.in_image() > 0 && self.scanner.is_some_and(|scanner| scanner.hdl64().is_some());
        let mut predictions = config.predictions(fit, has_regions);
        let last = predictions.pop().unwrap_or_default();
        let mut best = None;
        for prediction in predictions {
            let attempt = self.attempt(frame.clone(), prediction, self.models.clone(), config, stages)?;
            best = Some(attempt.or_better(best));
        }
        let models = take(&mut self.models);
        self.frames += 1;
        Ok(self.attempt(frame, last, models, config, stages)?.or_better(best))
    }

    /// Codes a frame with this prediction, with models that continue from those of the group.
    fn attempt(
        &self,
        mut frame: FrameParts,
        prediction: Prediction,
        mut models: Box<Models>,
        config: &EncoderConfig,
        mut stages: StageReport,
    ) -> Result<Attempt> {
        let is_image = matches!(frame.parameters.range_coder, RangeCoder::Image(_));
        let original = is_image.then(|| frame.image.steps.clone());
        frame.predict(prediction, self.scanner, config, &mut stages);
        let mut writer = SectionWriter::new(config.effort());
        models.code_frame(&mut writer, self.scanner, &mut frame)?;
        stages.add(&writer.report);
        stages.count_sections(&writer.sections);
        let error = original.map_or(0.0, |ranges| squared_error(&ranges, &frame.image.steps));
        Ok(Attempt { models, frame, sections: writer.sections, error, stages })
    }
}

/// Encodes a frame as the bytes of its file, which do not change the models.
fn encode_whole(
    models: &mut Models,
    whole: WholeFile,
    records: usize,
    header: FrameHeader,
    mut stages: StageReport,
) -> Result<EncodedFrame> {
    let mut writer = SectionWriter::new(Effort::default());
    models.code_frame(&mut writer, None, &mut FrameParts::of_whole(whole, records))?;
    stages.add(&writer.report);
    pay_for(&mut writer.sections, header.file_size.max(records as u64));
    stages.count_sections(&writer.sections);
    Ok(EncodedFrame { header, sections: writer.sections, stages })
}

/// A coded frame with its header and padding, and the decoded file, unless it is the original.
fn finished(
    frame: FrameParts,
    mut sections: Vec<Section>,
    stages: StageReport,
    name: &str,
    original: FrameHeader,
) -> Result<(EncodedFrame, Option<LossyFile>)> {
    let unfolded = frame.unfolded_bytes();
    if frame.parameters.source.is_none() {
        pay_for(&mut sections, unfolded.max(original.file_size));
        return Ok((EncodedFrame { header: original, sections, stages }, None));
    }
    let scan = frame.into_scan(name)?;
    let bytes = scan.to_bytes()?;
    let header = FrameHeader { stamp: original.stamp, ..FrameHeader::of(name, &bytes, scan.records as u64) };
    pay_for(&mut sections, unfolded.max(header.file_size));
    Ok((EncodedFrame { header, sections, stages }, Some(LossyFile { scan, bytes })))
}

/// Whether the models may do worse than a general-purpose compressor, as many records are no returns of a
/// range image and all must be restored exactly.
fn may_be_unexplained(frame: &FrameParts, config: &EncoderConfig) -> bool {
    let is_exact =
        config.positions == PositionFidelity::Exact && config.intensity == IntensityFidelity::Exact;
    is_exact && frame.parameters.source.is_none() && 4 * frame.outside() >= frame.records
}

/// Whether that is likely, now that the frame is coded: many points are outside the image, or the positions
/// of blanks take many bytes.
fn is_unexplained(frame: &FrameParts, sections: &[Section], file_size: u64) -> bool {
    let blank_bytes = payload_bytes_of(sections, SectionKind::Blanks) as u64;
    4 * frame.strays.count >= frame.records || 16 * blank_bytes >= file_size
}

/// Whether the corrections of an exact frame take so many bits that its points may take fewer without a
/// scanner.
fn are_corrections_costly(frame: &FrameParts, sections: &[Section]) -> bool {
    /// Where a scanner's recipe is not known, but the grid is, corrections take fewer bits a return.
    const MOST_BITS: usize = 10;
    let bytes = payload_bytes_of(sections, SectionKind::Correction);
    frame.parameters.source.is_none() && 8 * bytes > MOST_BITS * frame.in_image()
}

/// A frame coded with one of several predictions.
struct Attempt {
    /// The models after coding it.
    models: Box<Models>,
    /// The frame as decoded.
    frame: FrameParts,
    sections: Vec<Section>,
    /// Squared error of the ranges, in steps, if the coder has a bit rate; otherwise 0.
    error: f64,
    stages: StageReport,
}

impl Attempt {
    /// The squared error, then the bytes of the sections.
    fn cost(&self) -> (f64, usize) {
        (self.error, self.size())
    }

    fn size(&self) -> usize {
        payload_bytes(&self.sections)
    }

    /// This attempt or an earlier one, which wins ties.
    fn or_better(self, earlier: Option<Attempt>) -> Attempt {
        match earlier {
            Some(earlier) if self.cost() >= earlier.cost() => earlier,
            _ => self,
        }
    }
}

/// The sum of the squared differences of two images, in steps.
fn squared_error(a: &Grid<u32>, b: &Grid<u32>) -> f64 {
    let differences = a.cells().iter().zip(b.cells()).map(|(a, b)| f64::from(a.abs_diff(*b)));
    differences.map(|difference| difference * difference).sum()
}
