//! The ranges of a frame: coded by context, or as residuals by a general-purpose back-end or an image coder
//! (article, IV-C and IV-D).

use super::frame::Frame;
use super::images;
use super::modelling::RangeModelling;
use super::parameters::{Prediction, RangeCoder};
use super::sections::SectionCoder;
use super::steps::{Step, StepReport};
use super::syntax::Models;
use crate::article::prediction::{Predictor, Rays};
use crate::article::residual::{self, Packing};
use crate::backend;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter;
use crate::inter::Reference;
use crate::models::RangeContext;
use crate::scanner::Scanner;
use crate::stream::container::SectionKind;

impl Models {
    /// The range of each return.
    pub(crate) fn code_ranges<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut Frame,
        (levels, reference): (&Grid<u16>, Option<&Reference>),
        report: &mut StepReport,
    ) -> Result<()> {
        match frame.parameters.range_coder {
            RangeCoder::Context { modelling, range_bits, bin, .. } => {
                report.predicted += 4 * (frame.records - frame.strays) as u64;
                let axis = (range_bits, bin);
                report.timed(Step::Coding, || match modelling.parts().range {
                    RangeModelling::Packed => self.quick.code_packed_ranges(sections, axis, frame),
                    RangeModelling::Tokens { fitted } => {
                        let reference = reference.filter(|_| modelling.has_p_frames());
                        let expected = reference.map(Reference::ranges);
                        self.quick.code_ranges(sections, (fitted, expected.as_ref()), axis, frame)
                    }
                    depth => sections.section(SectionKind::Range, true, |coder| {
                        let known = RangeContext {
                            occupancy: &frame.occupancy,
                            intensity: levels,
                            reference,
                            range_bits,
                            bin,
                        };
                        let model = self.range.get_or_insert_default();
                        if depth == RangeModelling::Deep {
                            model.go_deep();
                        }
                        model.code(coder, &known, &mut frame.image.steps);
                        Ok(())
                    }),
                })
            }
            RangeCoder::Backend { id, packing } => {
                let predictor = self.code_predictor(sections, scanner, frame, reference, report)?;
                code_residuals(sections, &predictor, (id, packing), frame, report)?;
                check_ranges(frame, scanner)
            }
            RangeCoder::Image(codec) => {
                let before = sections.bytes_written();
                let predictor = self.code_predictor(sections, scanner, frame, reference, report)?;
                let side = sections.bytes_written() - before;
                images::code_ranges(sections, &predictor, (codec, side), (frame, scanner), report)
            }
        }
    }

    /// The side data of the prediction: the contour map and the models of regions.
    fn code_predictor<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut Frame,
        reference: Option<&Reference>,
        report: &mut StepReport,
    ) -> Result<Predictor> {
        let snake = frame.parameters.snake;
        match (frame.parameters.prediction, reference) {
            (Prediction::None, _) => return Ok(Predictor { ranges: None, snake }),
            (_, Some(reference)) => {
                let ranges = report.timed(Step::Prediction, || inter::ranges(reference, &frame.occupancy));
                return Ok(Predictor { ranges: Some(ranges), snake });
            }
            _ => {}
        }
        report.timed(Step::Contour, || {
            sections.section(SectionKind::Contour, true, |coder| {
                frame.intra.code_contour(&mut self.contour, coder, &frame.occupancy)
            })
        })?;
        sections.section(SectionKind::Regions, true, |coder| {
            frame.intra.code_models(&mut self.surfaces, coder);
            Ok(())
        })?;
        let scanner = scanner.hdl64().ok_or_else(|| Error::corrupt("regions of a scanner that has none"))?;
        let rays = Rays::of(scanner, &frame.image.columns);
        let ranges = report.timed(Step::Prediction, || frame.intra.ranges(&frame.occupancy, &rays));
        Ok(Predictor { ranges: Some(ranges), snake })
    }
}

/// The residuals, coded by a general-purpose back-end.
fn code_residuals<S: SectionCoder>(
    sections: &mut S,
    predictor: &Predictor,
    (id, packing): (u8, Packing),
    frame: &mut Frame,
    report: &mut StepReport,
) -> Result<()> {
    let backend = backend::by_id(id)?;
    let mut payload = Vec::new();
    let mut packed = 0;
    if S::ENCODES {
        let residuals =
            report.timed(Step::Prediction, || predictor.residuals(&frame.occupancy, &frame.image.steps));
        let level = sections.effort().level;
        (payload, packed) =
            report.timed(Step::Coding, || residual::compress(&residuals, backend, level, packing))?;
    }
    sections.payload(SectionKind::Residual, &mut payload);
    if !S::ENCODES {
        let count = frame.records - frame.strays;
        let residuals;
        (residuals, packed) =
            report.timed(Step::Coding, || residual::decompress(&payload, backend, packing, count))?;
        frame.image.steps =
            report.timed(Step::Prediction, || predictor.restore(&frame.occupancy, &residuals));
    }
    report.predicted += packed as u64;
    Ok(())
}

/// Checks that every return has a range that the scanner accepts.
fn check_ranges(frame: &Frame, scanner: &Scanner) -> Result<()> {
    let cells = frame.occupancy.cells().iter().zip(frame.image.steps.cells());
    let most = scanner.most_steps();
    if cells.into_iter().any(|(filled, steps)| *filled && !(1..=most).contains(steps)) {
        return Err(Error::corrupt("a range is out of range"));
    }
    Ok(())
}
