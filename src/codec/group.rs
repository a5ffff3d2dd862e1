//! A group of pictures: frames coded one after the other by models that learn from each. Groups
//! know nothing of one another.

use super::config::EncoderConfig;
use super::frame::Frame;
use super::parameters::Source;
use super::sections::{SectionReader, SectionWriter};
use super::steps::StepReport;
use super::syntax::Models;
use crate::bitstream::{FrameHeader, Section};
use crate::error::{Limits, Result};
use crate::scan::ScanFile;
use crate::sensor::SensorModel;

/// Encodes the frames of one group.
pub struct GroupEncoder<'s> {
    sensor: Option<&'s SensorModel>,
    config: &'s EncoderConfig,
    models: Models,
}

/// A frame as [`GroupEncoder`] codes it.
pub struct EncodedFrame {
    /// What it decodes to.
    pub header: FrameHeader,
    /// The coded parts.
    pub sections: Vec<Section>,
    /// What each step took and left.
    pub steps: StepReport,
}

impl<'s> GroupEncoder<'s> {
    /// A new group of scans by `sensor`.
    pub fn new(sensor: Option<&'s SensorModel>, config: &'s EncoderConfig) -> Self {
        GroupEncoder { sensor, config, models: Models::default() }
    }

    /// Encodes the next frame, which decoders then take under [`Limits::default`]. `original` says
    /// what its file is.
    ///
    /// # Errors
    /// If the scan is over those limits, or a back-end's library fails.
    pub fn encode_frame(&mut self, scan: &ScanFile, original: FrameHeader) -> Result<EncodedFrame> {
        let mut steps = StepReport { frames: 1, original: original.file_size, ..StepReport::default() };
        let mut frame = Frame::from_scan(scan, self.sensor, self.config, &mut steps)?;
        let mut writer = SectionWriter::new(self.config.level);
        let returns = self.models.code_frame(&mut writer, self.sensor, &mut frame, &mut steps)?;
        steps.count_sections(&writer.sections);
        let header = if frame.parameters.source.is_some() {
            let decoded = frame.into_scan(&scan.name, &returns)?;
            FrameHeader::of(&scan.name, &decoded.to_bytes()?, decoded.records as u64)
        } else {
            original
        };
        Ok(EncodedFrame { header, sections: writer.sections, steps })
    }
}

/// Decodes the frames of one group.
pub struct GroupDecoder<'s> {
    sensor: Option<&'s SensorModel>,
    limits: Limits,
    models: Models,
}

impl<'s> GroupDecoder<'s> {
    /// A new group of scans by `sensor`.
    pub fn new(sensor: Option<&'s SensorModel>, limits: &Limits) -> Self {
        GroupDecoder { sensor, limits: *limits, models: Models::default() }
    }

    /// Decodes the next frame; also says what its file was before, if it is not given back exactly.
    /// What each step took is added to `steps`.
    ///
    /// # Errors
    /// If the sections do not make a frame, or one over the limits.
    pub fn decode_frame(
        &mut self,
        header: &FrameHeader,
        sections: &[Section],
        steps: &mut StepReport,
    ) -> Result<(ScanFile, Option<Source>)> {
        let mut reader = SectionReader::new(sections, &self.limits);
        let mut frame = Frame { records: header.point_count as usize, ..Frame::default() };
        let returns = self.models.code_frame(&mut reader, self.sensor, &mut frame, steps)?;
        reader.finish()?;
        let source = frame.parameters.source;
        steps.frames += 1;
        steps.original += source.map_or(header.file_size, |source| source.file_size);
        steps.count_sections(sections);
        Ok((frame.into_scan(&header.name, &returns)?, source))
    }
}
