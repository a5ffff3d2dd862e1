//! The positions of the returns: those of the formula, corrected as far as necessary; and those of the
//! blanks. FORMAT.md 8.7 and 8.19.

use crate::container::SectionKind;
use crate::entropy::TokenTables;
use crate::frame::fidelity::PositionFidelity;
use crate::frame::modelling::CorrectionModelling;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::models::{BlankModel, CORRECTION_CONTEXTS, CorrectionModel, correct_positions};
use crate::scanner::{CoordinateGrid, Return, Scanner};

/// The models of corrections.
#[derive(Clone, Default)]
pub struct CorrectionModels {
    adaptive: CorrectionModel,
    tokens: TokenTables,
    blanks: BlankModel,
}

impl CorrectionModels {
    /// Codes the positions of the returns, if there is a range image.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let Some(scanner) = scanner else { return Ok(()) };
        if !frame.image.is_full {
            return self.code_returns(sections, scanner, frame);
        }
        // The blanks are taken out: they are coded after the returns.
        let all = std::mem::take(&mut frame.returns);
        let is_return = |found: &&Return| found.steps > 0;
        frame.returns = all.iter().filter(is_return).copied().collect();
        let mut positions = std::mem::take(&mut frame.positions);
        positions.resize(all.len(), [0.0; 3]);
        let returns = all.iter().zip(&positions).filter(|(found, _)| is_return(found));
        frame.positions = returns.map(|(_, position)| *position).collect();
        self.code_returns(sections, scanner, frame)?;
        let in_image = all.iter().zip(&mut positions);
        in_image
            .filter(|(found, _)| is_return(found))
            .zip(&frame.positions)
            .for_each(|((_, position), coded)| *position = *coded);
        frame.returns = all;
        frame.positions = positions;
        let blanks = frame.returns.iter().zip(&mut frame.positions).filter(|(found, _)| found.steps == 0);
        let with_formula = blanks.map(|(found, position)| (scanner.single_position(found), position));
        sections.section(SectionKind::Blanks, !frame.blanks.is_empty(), |coder| {
            self.blanks.code(coder, with_formula);
            Ok(())
        })
    }

    /// Codes the positions of the returns.
    fn code_returns<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let grid = scanner.coordinates();
        let offset_m = frame.parameters.range_coder.offset_m(scanner);
        let (max_error, on_grid) = match frame.parameters.positions {
            PositionFidelity::Formula => {
                frame.positions = scanner.positions(&frame.returns, offset_m, false);
                return Ok(());
            }
            PositionFidelity::Exact => (None, true),
            PositionFidelity::Bounded { max_error_um, on_grid } => {
                (Some(f64::from(max_error_um) * 1e-6), on_grid)
            }
        };
        let as_tokens = match frame.parameters.modelling().parts().correction {
            CorrectionModelling::Adaptive => false,
            CorrectionModelling::Light => grid == CoordinateGrid::Millimetre,
            CorrectionModelling::Tokens => true,
        };
        let (returns, positions) = (&frame.returns, &mut frame.positions);
        let formula = |found: &Return| scanner.position(found, offset_m);
        if as_tokens {
            let near = scanner.positions(returns, offset_m, on_grid);
            let wanted = std::mem::replace(positions, near);
            let formula = |point: usize| formula(&returns[point]);
            return sections.tokens(
                SectionKind::Correction,
                CORRECTION_CONTEXTS,
                &mut self.tokens,
                |coder| {
                    correct_positions(coder, grid, formula, (&wanted, max_error), positions);
                },
            );
        }
        positions.resize(returns.len(), [0.0; 3]);
        let model = &mut self.adaptive;
        sections.section(SectionKind::Correction, true, |coder| {
            if grid == CoordinateGrid::Millimetre && max_error.is_none() {
                // Whether a point is corrected depends on its distances from the rounding boundaries.
                let points = returns.iter().zip(positions);
                points.for_each(|(found, position)| model.correct(coder, grid, formula(found), position));
                return Ok(());
            }
            let near = scanner.positions(returns, offset_m, on_grid);
            for ((found, position), near) in returns.iter().zip(positions).zip(near) {
                model.code(coder, grid, || formula(found), (near, max_error), position);
            }
            Ok(())
        })
    }
}
