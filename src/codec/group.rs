//! Codes the frames of a group. (Stand-in: each file through LZMA.)

use std::io::{Read, Write};

use lzma_rust2::{LzmaOptions, LzmaReader, LzmaWriter};

use super::config::EncoderConfig;
use crate::bitstream::{Section, SectionKind};
use crate::error::{Error, Limits, Result};
use crate::io::parse;
use crate::scan::ScanFile;
use crate::sensor::SensorModel;

/// Encodes the frames of a group, in order.
pub struct GroupEncoder {
    options: LzmaOptions,
}

impl GroupEncoder {
    /// An encoder at the start of a group.
    pub fn new(config: &EncoderConfig, _sensor: Option<&SensorModel>) -> Self {
        let mut options = LzmaOptions::with_preset(u32::from(config.level));
        options.dict_size = 1 << 18;
        GroupEncoder { options }
    }

    /// Encodes the next frame.
    pub fn encode_frame(&mut self, scan: &ScanFile) -> Vec<Section> {
        let coded = || -> Result<Vec<u8>> {
            let bytes = scan.to_bytes()?;
            let mut writer = LzmaWriter::new_use_header(Vec::new(), &self.options, Some(bytes.len() as u64))?;
            writer.write_all(&bytes)?;
            Ok(writer.finish()?)
        };
        vec![Section { kind: SectionKind::Points, payload: coded().unwrap_or_default() }]
    }
}

/// Decodes the frames of a group, in order.
pub struct GroupDecoder {
    limits: Limits,
}

impl GroupDecoder {
    /// A decoder at the start of a group.
    pub fn new(_sensor: Option<&SensorModel>, limits: &Limits) -> Self {
        GroupDecoder { limits: *limits }
    }

    /// Decodes the next frame.
    ///
    /// # Errors
    /// If the sections are damaged.
    pub fn decode_frame(&mut self, name: &str, sections: &[Section]) -> Result<ScanFile> {
        let [section] = sections else {
            return Err(Error::corrupt(format!("{} sections", sections.len())));
        };
        let mut bytes = Vec::new();
        LzmaReader::new_mem_limit(&section.payload[..], 1 << 16, None)
            .map_err(|e| Error::corrupt(e.to_string()))?
            .take(self.limits.file_bytes)
            .read_to_end(&mut bytes)
            .map_err(|e| Error::corrupt(e.to_string()))?;
        Ok(parse(name, bytes))
    }
}
