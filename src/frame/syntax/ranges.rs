//! The ranges of the returns: coded by the context coder, or as residuals by a back-end or an image coder
//! (article, IV-C, IV-D and VI-C). FORMAT.md 8.6 and 8.11 to 8.14.

use super::returns::Part;
use crate::article::contour::ContourModel;
use crate::article::image_coding::{self, ImageCodec};
use crate::article::prediction::surface::SurfaceCoder;
use crate::article::prediction::{Predictor, Rays};
use crate::article::residual;
use crate::backend::{self, Packing};
use crate::container::SectionKind;
use crate::entropy::TokenTables;
use crate::frame::modelling::RangeModelling;
use crate::frame::parameters::{Prediction, RangeCoder};
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::frame::stages::Stage;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::{self, Reference};
use crate::models::{
    KnownCells, PACKED_RANGE_CONTEXTS, RANGE_CONTEXTS, RangeContext, RangeModel, RangeScale, RangeTokens,
    code_packed_ranges, start_tables,
};
use crate::scanner::Scanner;

/// The models of ranges.
#[derive(Clone, Default)]
pub struct RangeModels {
    // Created when first needed, as it is large.
    mixed: Option<RangeModel>,
    tokens: RangeTokens,
    token_tables: TokenTables,
    packed: TokenTables,
}

impl RangeModels {
    /// Codes the ranges with the context coder, if the frame uses it, given the context levels of the
    /// intensities.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        levels: &Grid<u16>,
        part: &Part,
        steps: &mut Grid<u32>,
    ) -> Result<()> {
        let RangeCoder::Context { modelling, range_bits, bin, .. } = part.frame.parameters.range_coder else {
            return Ok(());
        };
        let Part { occupancy, cells, reference, .. } = *part;
        let scale = RangeScale { bits: range_bits, bin };
        sections.report().predicted += 4 * cells.len() as u64;
        match modelling.parts().range {
            RangeModelling::Packed => {
                sections.tokens(SectionKind::Range, PACKED_RANGE_CONTEXTS, &mut self.packed, |coder| {
                    let mut ranges = if S::ENCODES { steps.at(cells) } else { vec![0; cells.len()] };
                    code_packed_ranges(coder, scale, &mut ranges);
                    steps.fill(cells, &ranges);
                })
            }
            RangeModelling::Tokens { fitted } => {
                let expected = reference.filter(|_| modelling.has_p_frames()).map(Reference::ranges);
                self.token_tables.start_from(start_tables(fitted), S::ENCODES);
                let model = &mut self.tokens;
                sections.tokens(SectionKind::Range, RANGE_CONTEXTS, &mut self.token_tables, |coder| {
                    let expected = expected.as_ref();
                    model.code(coder, &KnownCells { occupancy, fitted, expected, levels }, scale, steps);
                })
            }
            mixed_or_deep => {
                let model = self.mixed.get_or_insert_default();
                if mixed_or_deep == RangeModelling::Deep {
                    model.use_deep();
                }
                let known = RangeContext { occupancy, intensity: levels, reference, scale };
                sections.section(SectionKind::Range, true, |coder| {
                    model.code(coder, &known, steps);
                    Ok(())
                })
            }
        }
    }
}

/// The models of regions.
#[derive(Clone, Default)]
pub struct ResidualModels {
    contour: ContourModel,
    surfaces: SurfaceCoder,
}

impl ResidualModels {
    /// Codes the ranges by a back-end or an image coder, if there is a range image and they are not coded by
    /// the [context coder](RangeModels::code).
    ///
    /// # Errors
    /// If a section is damaged, or a range is impossible.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        reference: Option<&Reference>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let Some(scanner) = scanner else { return Ok(()) };
        match frame.parameters.range_coder {
            RangeCoder::Context { .. } => Ok(()),
            RangeCoder::Backend { id, packing } => {
                let predictor = self.code_predictor(sections, scanner, frame, reference)?;
                code_residuals(sections, &predictor, (id, packing), frame)?;
                check_ranges(frame, scanner)
            }
            RangeCoder::Image(codec) => {
                let before = sections.bytes_written();
                let predictor = self.code_predictor(sections, scanner, frame, reference)?;
                let side = sections.bytes_written() - before;
                code_image(sections, &predictor, (codec, side), frame, scanner.most_steps())
            }
        }
    }

    /// The side data of the prediction: the contour map and the models of regions.
    fn code_predictor<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut FrameParts,
        reference: Option<&Reference>,
    ) -> Result<Predictor> {
        let snake = frame.parameters.snake;
        match (frame.parameters.prediction, reference) {
            (Prediction::None, _) => return Ok(Predictor { ranges: None, snake }),
            (_, Some(reference)) => {
                let predict = || inter::ranges(reference, &frame.occupancy);
                let ranges = sections.report().timed(Stage::Prediction, predict);
                return Ok(Predictor { ranges: Some(ranges), snake });
            }
            _ => {}
        }
        sections.section(SectionKind::Contour, true, |coder| {
            frame.intra.code_contour(&mut self.contour, coder, &frame.occupancy)
        })?;
        sections.section(SectionKind::Regions, true, |coder| {
            frame.intra.code_models(&mut self.surfaces, coder);
            Ok(())
        })?;
        let scanner = scanner
            .hdl64()
            .ok_or_else(|| Error::corrupt("regions, which only scanners of the family hdl64 have"))?;
        let rays = Rays::of(scanner, &frame.image.columns);
        let predict = || frame.intra.ranges(&frame.occupancy, &rays);
        let ranges = sections.report().timed(Stage::Prediction, predict);
        Ok(Predictor { ranges: Some(ranges), snake })
    }
}

/// The residuals, coded by a back-end.
fn code_residuals<S: SectionCoder>(
    sections: &mut S,
    predictor: &Predictor,
    (id, packing): (u8, Packing),
    frame: &mut FrameParts,
) -> Result<()> {
    let backend = backend::by_id(id)?;
    let level = sections.effort().level;
    let mut payload = Vec::new();
    let mut packed = 0;
    if S::ENCODES {
        let report = sections.report();
        let residuals =
            report.timed(Stage::Prediction, || predictor.residuals(&frame.occupancy, &frame.image.steps));
        (payload, packed) =
            report.timed(Stage::Coding, || residual::compress(&residuals, backend, level, packing))?;
    }
    sections.payload(SectionKind::Residual, &mut payload);
    let report = sections.report();
    if !S::ENCODES {
        let count = frame.cells.len();
        let residuals;
        (residuals, packed) = report
            .timed(Stage::Coding, || residual::decompress(&payload, backend, packing, count))
            .map_err(|e| e.within_section(SectionKind::Residual))?;
        frame.image.steps =
            report.timed(Stage::Prediction, || predictor.restore(&frame.occupancy, &residuals));
    }
    report.predicted += packed as u64;
    Ok(())
}

/// Checks that every return has a range that the scanner accepts.
fn check_ranges(frame: &FrameParts, scanner: &Scanner) -> Result<()> {
    let cells = frame.occupancy.cells().iter().zip(frame.image.steps.cells());
    let most = scanner.most_steps();
    if cells.into_iter().any(|(filled, steps)| *filled && !(1..=most).contains(steps)) {
        return Err(Error::corrupt("a range is out of range"));
    }
    Ok(())
}

/// The residuals, coded by an image coder; `side` bytes of the prediction were already written, and no range
/// exceeds `most` steps. The encoder continues with the decoded ranges.
fn code_image<S: SectionCoder>(
    sections: &mut S,
    predictor: &Predictor,
    (codec, side): (ImageCodec, usize),
    frame: &mut FrameParts,
    most: u32,
) -> Result<()> {
    let returns = frame.cells.len();
    sections.report().predicted += 4 * returns as u64;
    if S::ENCODES && frame.coded_image.is_empty() {
        let config = sections.effort().image;
        let report = sections.report();
        let residuals =
            report.timed(Stage::Prediction, || predictor.differences(&frame.occupancy, &frame.image.steps));
        let most_bytes = config.rate.bytes(returns).map(|bytes| bytes.saturating_sub(side));
        frame.coded_image = report.timed(Stage::Coding, || {
            image_coding::encode(codec, residuals, &frame.occupancy, config.passes, most_bytes)
        })?;
    }
    sections.payload(SectionKind::Residual, &mut frame.coded_image);
    let report = sections.report();
    let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
    let residuals = report
        .timed(Stage::Coding, || image_coding::decode(codec, &frame.coded_image, rows, columns))
        .map_err(|e| e.within_section(SectionKind::Residual))?;
    frame.image.steps =
        report.timed(Stage::Prediction, || predictor.restore_within(&frame.occupancy, &residuals, most));
    Ok(())
}

impl FrameParts {
    /// Switches the decoded ranges to the context coder, because their coded image is useless with another
    /// prediction.
    pub fn leave_image(&mut self) {
        if let RangeCoder::Image(_) = self.parameters.range_coder {
            self.coded_image.clear();
            self.parameters.range_coder = RangeCoder::EXACT;
            self.parameters.range_coder.fit(&self.image.steps);
        }
    }
}
