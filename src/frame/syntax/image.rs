//! The columns of the range image, and its occupancy. FORMAT.md 8.2 and 8.3.

use std::mem::take;

use crate::container::SectionKind;
use crate::entropy::TokenTables;
use crate::frame::modelling::OccupancyModelling;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::Reference;
use crate::models::{OCCUPANCY_CONTEXTS, OccupancyModel, code_occupancy};
use crate::scanner::{ColumnModels, Scanner};

/// The models of columns and occupancy.
#[derive(Clone, Default)]
pub struct ImageModels {
    columns: ColumnModels,
    /// The models of the whole image or its upper half, and of the lower half.
    occupancy: [OccupancyModels; 2],
}

#[derive(Clone, Default)]
struct OccupancyModels {
    // Created when first needed, as it is large.
    adaptive: Option<OccupancyModel>,
    tokens: TokenTables,
}

impl ImageModels {
    /// Codes the columns, if there is a range image.
    ///
    /// # Errors
    /// If there are more cells than the limits allow, or a column is impossible.
    pub fn code_columns<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let Some(scanner) = scanner else { return Ok(()) };
        let most = sections.limits().points;
        sections.section(SectionKind::Columns, true, |coder| {
            scanner.code_columns(&mut self.columns, coder, &mut frame.image, most)
        })?;
        let cells = scanner.rows().saturating_mul(frame.image.columns.len());
        Error::check_limit("cells of the range image", cells as u64, most)?;
        frame.fit_image(scanner.rows());
        Ok(())
    }

    /// Codes which cells hold a return, if there is a range image.
    ///
    /// # Errors
    /// If the section is damaged, or the number of returns contradicts the frame.
    pub fn code_occupancy<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let records = frame.in_image();
        if records == 0 {
            return Ok(());
        }
        let modelling = frame.parameters.modelling().parts().occupancy;
        let [models, lower_models] = &mut self.occupancy;
        match frame.middle() {
            None => models.code(sections, modelling, reference, &mut frame.occupancy)?,
            Some(middle) => {
                let [mut upper, mut lower] = take(&mut frame.occupancy).split(middle);
                let references = reference.map(|reference| reference.clone().split(middle));
                let [above, below] = [0, 1].map(|half| references.as_ref().map(|halves| &halves[half]));
                sections.both(
                    SectionKind::Occupancy,
                    |sections| models.code(sections, modelling, above, &mut upper),
                    |sections| lower_models.code(sections, modelling, below, &mut lower),
                )?;
                frame.occupancy = Grid::joined([upper, lower]);
            }
        }
        frame.cells = frame.occupancy.places();
        let is_full = frame.image.is_full;
        let in_image = if is_full { frame.occupancy.cells().len() } else { frame.cells.len() };
        // The remaining records are echoes.
        if in_image > records || is_full && in_image < records {
            return Err(Error::corrupt("the range image holds another number of records than the frame"));
        }
        if is_full {
            frame.blanks = frame.occupancy.map(|filled| !filled).places();
        }
        Ok(())
    }
}

impl OccupancyModels {
    /// Codes an image or one half.
    fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        modelling: OccupancyModelling,
        reference: Option<&Reference>,
        occupancy: &mut Grid<bool>,
    ) -> Result<()> {
        if modelling == OccupancyModelling::Tokens {
            let code = |coder: &mut S::Tokens<'_>| code_occupancy(coder, occupancy);
            return sections.tokens(SectionKind::Occupancy, OCCUPANCY_CONTEXTS, &mut self.tokens, code);
        }
        let model = self.adaptive.get_or_insert_default();
        model.use_light(modelling == OccupancyModelling::Light);
        sections.section(SectionKind::Occupancy, true, |coder| {
            model.code(coder, reference, occupancy);
            Ok(())
        })
    }
}

impl FrameParts {
    /// The first row of the lower half, if the halves of the image are coded separately.
    pub fn middle(&self) -> Option<usize> {
        (self.parameters.halved && self.records > self.strays.count)
            .then(|| self.occupancy.rows().div_ceil(2))
    }

    /// Resizes the decoder's grids to the size of the image.
    fn fit_image(&mut self, rows: usize) {
        let columns = self.image.columns.len();
        if self.occupancy.rows() != rows || self.occupancy.columns() != columns {
            self.occupancy = Grid::new(rows, columns);
            self.image.steps = Grid::new(rows, columns);
            self.intensity = Grid::new(rows, columns);
        }
    }
}
