//! The order of the points in the file, and the channels of their records. FORMAT.md 8.8 and 8.9.

use std::mem::take;

use crate::container::SectionKind;
use crate::frame::fidelity::PositionFidelity;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::{Error, Result};
use crate::models::{ChannelsModel, OrderModel};
use crate::scan::{Channel, Field};
use crate::scanner::Scanner;

/// The models of order and channels.
#[derive(Clone, Default)]
pub struct RecordModels {
    order: OrderModel,
    channels: ChannelsModel,
}

impl RecordModels {
    /// Codes how the order of the points differs from that of the range image.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code_order<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut FrameParts) -> Result<()> {
        let returns = frame.in_image();
        if returns == 0 || frame.parameters.positions == PositionFidelity::Formula {
            frame.order.stray_places = (returns as u64..frame.records as u64).collect();
            return Ok(());
        }
        sections.section(SectionKind::Order, true, |coder| {
            self.order.code(coder, &mut frame.order, returns, frame.strays.count)
        })
    }

    /// Codes the channels.
    ///
    /// # Errors
    /// If the section is damaged, or the channels exceed the limits.
    pub fn code_channels<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let bytes = frame.records.saturating_mul(frame.layout.channel_bytes());
        Error::check_limit("bytes of the frame", bytes as u64, sections.limits().file_bytes)?;
        frame.fit_channels();
        let (compressors, most_cells) = (sections.effort().compressors, sections.limits().points);
        sections.section(SectionKind::Channels, bytes > 0, |coder| {
            let mut context = frame.record_context(scanner)?;
            let cells = self.channels.code(coder, &mut frame.channels, &context, compressors, most_cells)?;
            frame.image_cells_of_channels = cells;
            if !S::ENCODES {
                frame.decoded_in_file_order =
                    Some((take(&mut context.positions), take(&mut context.intensity)));
            }
            Ok(())
        })
    }
}

impl FrameParts {
    /// Resizes the decoder's channels for their values.
    fn fit_channels(&mut self) {
        if self.channels.is_empty() {
            let sized = |field: &Field| Channel {
                field: field.clone(),
                bytes: vec![0; self.records.saturating_mul(field.width())],
            };
            self.channels = self.layout.channels().map(|(_, field)| sized(field)).collect();
        }
    }
}
