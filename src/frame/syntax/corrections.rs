//! The positions of the returns: those of the formula, corrected as far as necessary; and those of the
//! blanks. FORMAT.md 8.7 and 8.19.

use std::cell::LazyCell;

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
            return self.code_returns(sections, scanner, frame, None);
        }
        let is_return = |number: &u32| frame.returns[*number as usize].steps > 0;
        let (returns, blanks): (Vec<u32>, Vec<u32>) = (0..frame.returns.len() as u32).partition(is_return);
        let position = |blank: &u32| frame.positions.get(*blank as usize).copied().unwrap_or_default();
        let mut positions: Vec<[f32; 3]> = blanks.iter().map(position).collect();
        self.code_returns(sections, scanner, frame, Some(&returns))?;
        let all = &frame.returns;
        let formula = LazyCell::new(|| {
            let blanks: Vec<Return> = blanks.iter().map(|&blank| all[blank as usize]).collect();
            scanner.positions(&blanks, 0.0, false)
        });
        sections.section(SectionKind::Blanks, !frame.blanks.is_empty(), |coder| {
            self.blanks.code(coder, |blank| formula[blank], &mut positions);
            Ok(())
        })?;
        let coded = blanks.iter().zip(positions);
        coded.for_each(|(&blank, position)| frame.positions[blank as usize] = position);
        Ok(())
    }

    /// Codes the positions of the returns: of those with these numbers, or of all. Other positions become
    /// arbitrary.
    fn code_returns<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: &Scanner,
        frame: &mut FrameParts,
        numbers: Option<&[u32]>,
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
                    correct_positions(coder, grid, formula, (&wanted, max_error), (positions, numbers));
                },
            );
        }
        positions.resize(returns.len(), [0.0; 3]);
        let model = &mut self.adaptive;
        sections.section(SectionKind::Correction, true, |coder| {
            let count = numbers.map_or(returns.len(), <[u32]>::len);
            let at = |point: usize| numbers.map_or(point, |numbers| numbers[point] as usize);
            if grid == CoordinateGrid::Millimetre && max_error.is_none() {
                // Whether a point is corrected depends on its distances from the rounding boundaries.
                for point in (0..count).map(at) {
                    model.correct(coder, grid, formula(&returns[point]), &mut positions[point]);
                }
                return Ok(());
            }
            let near = scanner.positions(returns, offset_m, on_grid);
            for point in (0..count).map(at) {
                let formula = || formula(&returns[point]);
                model.code(coder, grid, formula, (near[point], max_error), &mut positions[point]);
            }
            Ok(())
        })
    }
}
