//! A group of pictures: frames coded one after the other by models that learn from each. Groups
//! know nothing of one another.

use std::mem::take;

use super::config::EncoderConfig;
use super::frame::Frame;
use super::parameters::{Prediction, Source};
use super::sections::{Effort, SectionReader, SectionWriter};
use super::steps::{Step, StepReport};
use super::syntax::Models;
use crate::bitstream::{FrameHeader, Section};
use crate::error::{Error, Limits, Result};
use crate::prediction::intra::IntraPrediction;
use crate::range_image::{RangeImage, Return};
use crate::registration::{Pose, QuantisedPose, register};
use crate::scan::ScanFile;
use crate::sensor::SensorModel;

/// Encodes the frames of one group.
pub struct GroupEncoder<'s> {
    sensor: Option<&'s SensorModel>,
    config: &'s EncoderConfig,
    models: Models,
    /// The last motion of the scanner, from frame to frame.
    motion: QuantisedPose,
    /// Frames coded so far.
    frames: usize,
}

/// A frame as [`GroupEncoder`] codes it.
pub struct EncodedFrame {
    /// What it decodes to.
    pub header: FrameHeader,
    /// The coded parts.
    pub sections: Vec<Section>,
    /// What each step took and left; where several predictions were tried, with the one that was taken.
    pub steps: StepReport,
}

impl<'s> GroupEncoder<'s> {
    /// A new group of scans by `sensor`.
    pub fn new(sensor: Option<&'s SensorModel>, config: &'s EncoderConfig) -> Self {
        GroupEncoder {
            sensor,
            config,
            models: Models::default(),
            motion: QuantisedPose::default(),
            frames: 0,
        }
    }

    /// Encodes the next frame, which decoders then take under [`Limits::default`]. `original` says
    /// what its file is.
    ///
    /// # Errors
    /// If the scan is over those limits, or a back-end's library fails.
    pub fn encode_frame(&mut self, scan: &ScanFile, original: FrameHeader) -> Result<EncodedFrame> {
        let mut steps = StepReport { frames: 1, original: original.file_size, ..StepReport::default() };
        let frame = Frame::from_scan(scan, self.sensor, self.config, &mut steps)?;
        let mut best: Option<Attempt> = None;
        let fit = steps.timed(Step::Registration, || self.estimate_motion(&frame));
        let mut predictions = self.config.predictions(fit).into_iter().peekable();
        while let Some(prediction) = predictions.next() {
            let models = match predictions.peek() {
                Some(_) => self.models.clone(),
                None => std::mem::take(&mut self.models),
            };
            let attempt = self.attempt(&frame, prediction, models, steps)?;
            if best.as_ref().is_none_or(|best| attempt.cost() < best.cost()) {
                best = Some(attempt);
            }
        }
        let Some(Attempt { models, sections, frame, returns, steps, .. }) = best else {
            return Err(Error::InvalidConfig("no prediction to choose from".to_owned()));
        };
        self.models = models;
        self.frames += 1;
        let header = if frame.parameters.source.is_some() {
            let decoded = frame.into_scan(&scan.name, &returns)?;
            FrameHeader::of(&scan.name, &decoded.to_bytes()?, decoded.records as u64)
        } else {
            original
        };
        Ok(EncodedFrame { header, sections, steps })
    }

    /// Finds how the scanner has moved since the frame before, if the frame may be predicted from that
    /// (equation 8). Gives how much of that frame fits this one, from 0 to 1; none if it does not.
    fn estimate_motion(&mut self, frame: &Frame) -> Option<f64> {
        let (sensor, past) = (self.sensor?, self.models.past()?);
        if frame.strays == frame.records || !self.config.allows_inter(self.frames) {
            return None;
        }
        let image = RangeImage { columns: frame.columns.clone(), steps: frame.steps.clone() };
        let surface = past.surface(sensor);
        let found = register(surface, &image, sensor, &self.motion.pose(), &self.config.registration);
        let motion = found.and_then(|found| found.pose.quantise());
        self.motion = motion.unwrap_or_default();
        motion.and(found).map(|found| found.fit)
    }

    /// Codes a frame with this prediction, by models that go on from those of the group.
    fn attempt(
        &self,
        frame: &Frame,
        prediction: Prediction,
        mut models: Models,
        mut steps: StepReport,
    ) -> Result<Attempt> {
        let ranges = &frame.steps;
        let mut frame = frame.clone();
        frame.parameters.motion = self.motion;
        frame.predict(prediction, self.sensor, self.config, &mut steps);
        let effort = Effort { level: self.config.level, image: self.config.image };
        let mut writer = SectionWriter::new(effort);
        let returns = models.code_frame(&mut writer, self.sensor, &mut frame, &mut steps)?;
        steps.count_sections(&writer.sections);
        let errors = ranges.cells().iter().zip(frame.steps.cells()).map(|(was, is)| was.abs_diff(*is));
        let error = errors.map(|error| f64::from(error) * f64::from(error)).sum();
        Ok(Attempt { models, sections: writer.sections, frame, returns, error, steps })
    }
}

/// A frame coded in one of several ways.
struct Attempt {
    /// What coding it has taught.
    models: Models,
    sections: Vec<Section>,
    /// As it decodes.
    frame: Frame,
    returns: Vec<Return>,
    /// Squared error of the ranges, in steps.
    error: f64,
    steps: StepReport,
}

impl Attempt {
    /// The error, of coders that may spend so many bits, and then the bytes of the sections.
    fn cost(&self) -> (f64, usize) {
        (self.error, self.sections.iter().map(|section| section.payload.len()).sum())
    }
}

/// A frame as [`GroupDecoder`] decodes it.
pub struct DecodedScan {
    /// The file.
    pub scan: ScanFile,
    /// What the file was before, if it is not given back exactly.
    pub source: Option<Source>,
    /// The range image, if there is one and it was asked for.
    pub image: Option<DecodedImage>,
}

/// The range image of a decoded frame.
#[derive(Clone, Debug)]
pub struct DecodedImage {
    /// Whose rows, ticks and steps these are.
    pub sensor: SensorModel,
    /// The ranges.
    pub image: RangeImage,
    /// The regions that they were predicted from; none if they were not.
    pub intra: IntraPrediction,
    /// How the scanner has moved since the frame before, if they were predicted from that.
    pub motion: Option<Pose>,
}

/// Decodes the frames of one group.
pub struct GroupDecoder<'s> {
    sensor: Option<&'s SensorModel>,
    limits: Limits,
    keeps_images: bool,
    models: Models,
}

impl<'s> GroupDecoder<'s> {
    /// A new group of scans by `sensor`.
    pub fn new(sensor: Option<&'s SensorModel>, limits: &Limits) -> Self {
        GroupDecoder { sensor, limits: *limits, keeps_images: false, models: Models::default() }
    }

    /// Makes it give back range images too.
    pub fn keeping_images(self, keeps_images: bool) -> Self {
        GroupDecoder { keeps_images, ..self }
    }

    /// Decodes the next frame; what each step took is added to `steps`.
    ///
    /// # Errors
    /// If the sections do not make a frame, or one over the limits.
    pub fn decode_frame(
        &mut self,
        header: &FrameHeader,
        sections: &[Section],
        steps: &mut StepReport,
    ) -> Result<DecodedScan> {
        let mut reader = SectionReader::new(sections, &self.limits);
        let mut frame = Frame { records: header.point_count as usize, ..Frame::default() };
        let returns = self.models.code_frame(&mut reader, self.sensor, &mut frame, steps)?;
        reader.finish()?;
        let source = frame.parameters.source;
        steps.frames += 1;
        steps.original += source.map_or(header.file_size, |source| source.file_size);
        steps.count_sections(sections);
        let image = self.sensor.filter(|_| self.keeps_images).map(|sensor| DecodedImage {
            sensor: sensor.clone(),
            image: RangeImage { columns: take(&mut frame.columns), steps: take(&mut frame.steps) },
            intra: take(&mut frame.intra),
            motion: (frame.parameters.prediction == Prediction::Inter)
                .then(|| frame.parameters.motion.pose()),
        });
        Ok(DecodedScan { scan: frame.into_scan(&header.name, &returns)?, source, image })
    }
}
