//! The layout of the file, and the bytes around the records. FORMAT.md 8.1.

use crate::container::SectionKind;
use crate::entropy::{BitCoder, IntegerModel};
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::saturated;
use crate::models::ByteModel;
use crate::scan::Layout;

/// The models of file layouts and of the bytes around the records.
#[derive(Clone, Default)]
pub struct FileModels {
    /// The layout of the last frame.
    layout: Option<Layout>,
    sizes: IntegerModel,
    zeros: IntegerModel,
    bytes: ByteModel,
}

impl FileModels {
    /// Codes the section.
    ///
    /// # Errors
    /// If the frame's points differ from its header, or exceed the limits.
    pub fn code<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut FrameParts) -> Result<()> {
        let limits = *sections.limits();
        sections.section(SectionKind::File, true, |coder| self.code_file(coder, frame, &limits))
    }

    /// The layout of the file, and the bytes around the records.
    fn code_file<C: BitCoder>(
        &mut self,
        coder: &mut C,
        frame: &mut FrameParts,
        limits: &Limits,
    ) -> Result<()> {
        self.code_layout(coder, &mut frame.layout, limits)?;
        self.code_bytes(coder, &mut frame.prefix, limits)?;
        self.code_bytes(coder, &mut frame.suffix, limits)?;
        let records = self.sizes.code(coder, frame.records as u64);
        if records != frame.records as u64 {
            return Err(Error::corrupt(format!(
                "{records} points, not {} as the frame's header says",
                frame.records
            )));
        }
        frame.strays.count = saturated(self.sizes.code(coder, frame.strays.count as u64));
        Error::check_limit("points of the frame", frame.records as u64, limits.points)?;
        let record_bytes = frame.records.saturating_mul(frame.layout.stride());
        Error::check_limit("bytes of the frame's records", record_bytes as u64, limits.file_bytes)?;
        if frame.strays.count > frame.records {
            return Err(Error::corrupt("more strays than points"));
        }
        if frame.layout.position.is_none() && frame.strays.count < frame.records {
            return Err(Error::corrupt("returns without positions"));
        }
        Ok(())
    }

    /// The layout; empty if it equals that of the frame before.
    fn code_layout<C: BitCoder>(
        &mut self,
        coder: &mut C,
        layout: &mut Layout,
        limits: &Limits,
    ) -> Result<()> {
        let mut bytes = Vec::new();
        if C::ENCODES && self.layout.as_ref() != Some(layout) {
            layout.write_to(&mut bytes);
        }
        self.code_bytes(coder, &mut bytes, limits)?;
        if bytes.is_empty() {
            let before = self.layout.as_ref();
            layout.clone_from(before.ok_or_else(|| Error::corrupt("record layout: there is none before"))?);
            return Ok(());
        }
        let mut rest = bytes.as_slice();
        *layout = Layout::read_from(&mut rest)?;
        if !rest.is_empty() {
            return Err(Error::corrupt("record layout: bytes left over"));
        }
        self.layout = Some(layout.clone());
        Ok(())
    }

    /// A string of bytes. Zeros at its end, with which some programs fill up a page, are only counted.
    fn code_bytes<C: BitCoder>(&mut self, coder: &mut C, bytes: &mut Vec<u8>, limits: &Limits) -> Result<()> {
        let length = saturated(self.sizes.code(coder, bytes.len() as u64));
        Error::check_limit("bytes of the frame", length as u64, limits.file_bytes)?;
        bytes.resize(length, 0);
        if length == 0 {
            return Ok(());
        }
        let zeros = bytes.iter().rev().take_while(|&&byte| byte == 0).count();
        let zeros = self.zeros.code(coder, zeros as u64);
        let others = usize::try_from(zeros).ok().and_then(|zeros| length.checked_sub(zeros));
        let others = others.ok_or_else(|| Error::corrupt("more zeros than bytes"))?;
        if others as u64 > coder.most_bits() / 8 {
            return Err(Error::corrupt("more bytes than the section can hold"));
        }
        self.bytes.code(coder, 1, &mut bytes[..others]);
        Ok(())
    }
}
