//! The residuals of ranges, coded by an image coder (article, VI-C). The encoder continues with the ranges
//! that the decoder will have.

use super::frame::Frame;
use super::parameters::RangeCoder;
use super::sections::SectionCoder;
use super::steps::{Step, StepReport};
use crate::article::image_coding::{self, ImageCodec};
use crate::article::prediction::Predictor;
use crate::ground::error::Result;
use crate::scanner::Scanner;
use crate::stream::container::SectionKind;

/// Codes the range of each return; `side` bytes of the prediction have been written already.
///
/// # Errors
/// If the section is damaged, or if the size of the image is impossible in the format.
pub fn code_ranges<S: SectionCoder>(
    sections: &mut S,
    predictor: &Predictor,
    (codec, side): (ImageCodec, usize),
    (frame, scanner): (&mut Frame, &Scanner),
    report: &mut StepReport,
) -> Result<()> {
    let returns = frame.records - frame.strays;
    report.predicted += 4 * returns as u64;
    if S::ENCODES && frame.coded_image.is_empty() {
        let residuals =
            report.timed(Step::Prediction, || predictor.differences(&frame.occupancy, &frame.image.steps));
        let config = sections.effort().image;
        let most_bytes = config.rate.bytes(returns).map(|bytes| bytes.saturating_sub(side));
        frame.coded_image = report.timed(Step::Coding, || {
            image_coding::encode(codec, residuals, &frame.occupancy, config.passes, most_bytes)
        })?;
    }
    sections.payload(SectionKind::Residual, &mut frame.coded_image);
    let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
    let residuals =
        report.timed(Step::Coding, || image_coding::decode(codec, &frame.coded_image, rows, columns))?;
    let most = scanner.most_steps();
    frame.image.steps =
        report.timed(Step::Prediction, || predictor.restore_within(&frame.occupancy, &residuals, most));
    Ok(())
}

impl Frame {
    /// Codes the ranges, as they were decoded, by context from now on, because their image is useless with
    /// another prediction.
    pub fn leave_image(&mut self) {
        if let RangeCoder::Image(_) = self.parameters.range_coder {
            self.coded_image.clear();
            self.parameters.range_coder = RangeCoder::EXACT;
            self.parameters.range_coder.fit(&self.image.steps);
        }
    }
}
