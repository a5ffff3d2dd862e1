//! A group of pictures: frames coded one after the other by models that learn from each. Groups
//! know nothing of one another.

use super::frame::Frame;
use super::syntax::{Models, SectionReader, SectionWriter};
use crate::bitstream::{FrameHeader, Section};
use crate::error::{Limits, Result};
use crate::scan::ScanFile;
use crate::sensor::SensorModel;

/// Encodes the frames of one group.
pub struct GroupEncoder<'s> {
    sensor: Option<&'s SensorModel>,
    models: Models,
}

impl<'s> GroupEncoder<'s> {
    /// A new group of scans by `sensor`.
    pub fn new(sensor: Option<&'s SensorModel>) -> Self {
        GroupEncoder { sensor, models: Models::default() }
    }

    /// Encodes the next frame, which decoders then take under [`Limits::default`].
    ///
    /// # Errors
    /// If the scan is over those limits.
    pub fn encode_frame(&mut self, scan: &ScanFile) -> Result<Vec<Section>> {
        let mut frame = Frame::from_scan(scan, self.sensor);
        let mut writer = SectionWriter::new();
        self.models.code_frame(&mut writer, self.sensor, &mut frame)?;
        Ok(writer.sections)
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

    /// Decodes the next frame.
    ///
    /// # Errors
    /// If the sections do not make a frame, or one over the limits.
    pub fn decode_frame(&mut self, header: &FrameHeader, sections: &[Section]) -> Result<ScanFile> {
        let mut reader = SectionReader::new(sections, &self.limits);
        let mut frame = Frame { records: header.point_count as usize, ..Frame::default() };
        let returns = self.models.code_frame(&mut reader, self.sensor, &mut frame)?;
        reader.finish()?;
        frame.into_scan(&header.name, &returns)
    }
}
