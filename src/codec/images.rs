//! What prediction leaves of the ranges, by an image coder (article, VI-C). The encoder goes on with the ranges
//! that the decoder will have.

use super::frame::Frame;
use super::parameters::RangeCoder;
use super::sections::SectionCoder;
use super::steps::{Step, StepReport};
use crate::bitstream::SectionKind;
use crate::error::Result;
use crate::grid::Grid;
use crate::image_coding::{self, ImageCodec};
use crate::prediction::Predictor;
use crate::range_image::{EXACT_RANGE_BITS, RangeImage};
use crate::sensor::SensorModel;

/// The range of each return, of which `side` bytes of the prediction are written already.
///
/// # Errors
/// If the section is damaged, or the image's size is none that the format can have.
pub fn code_ranges<S: SectionCoder>(
    sections: &mut S,
    predictor: &Predictor,
    (codec, side): (ImageCodec, usize),
    (frame, sensor): (&mut Frame, &SensorModel),
    report: &mut StepReport,
) -> Result<()> {
    let returns = frame.records - frame.strays;
    report.predicted += 4 * returns as u64;
    if S::ENCODES && frame.image.is_empty() {
        let residuals =
            report.timed(Step::Prediction, || predictor.differences(&frame.occupancy, &frame.steps));
        let config = sections.effort().image;
        let most_bytes = config.rate.bytes(returns).map(|bytes| bytes.saturating_sub(side));
        frame.image = report.timed(Step::Coding, || {
            image_coding::encode(codec, residuals, &frame.occupancy, config.passes, most_bytes)
        })?;
    }
    sections.payload(SectionKind::Residual, &mut frame.image);
    let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
    let residuals =
        report.timed(Step::Coding, || image_coding::decode(codec, &frame.image, rows, columns))?;
    let most = sensor.most_steps();
    let steps =
        report.timed(Step::Prediction, || predictor.restore_within(&frame.occupancy, &residuals, most));
    frame.take_ranges(steps, sensor);
    Ok(())
}

impl Frame {
    /// Has the ranges, as they were decoded, coded by context from now on: their image is of no use with another
    /// prediction.
    pub fn leave_image(&mut self) {
        if let RangeCoder::Image(_) = self.parameters.range_coder {
            self.image.clear();
            self.parameters.range_coder = RangeCoder::Context { range_bits: EXACT_RANGE_BITS };
            self.parameters.range_coder.fit(&self.steps);
        }
    }

    /// Takes other ranges of the same returns. Their order in the file depends on them; what is kept in that
    /// order, beside the ranges, is moved with them.
    fn take_ranges(&mut self, steps: Grid<u32>, sensor: &SensorModel) {
        let columns = self.columns.clone();
        let mut image = RangeImage { columns, steps: std::mem::replace(&mut self.steps, steps) };
        let stride = self.layout.extra_stride();
        if self.extra.is_empty() || image.steps == self.steps {
            return;
        }
        let mut place_of: Grid<usize> = Grid::new(image.steps.rows(), image.steps.columns());
        for (place, found) in image.file_order(sensor).iter().enumerate() {
            place_of[(found.row as usize, found.column as usize)] = place;
        }
        image.steps = self.steps.clone();
        let returns = image.file_order(sensor);
        let mut moved = Vec::with_capacity(self.extra.len());
        for found in &returns {
            let place = place_of[(found.row as usize, found.column as usize)];
            moved.extend_from_slice(&self.extra[place * stride..][..stride]);
        }
        moved.extend_from_slice(&self.extra[returns.len() * stride..]);
        self.extra = moved;
    }
}
