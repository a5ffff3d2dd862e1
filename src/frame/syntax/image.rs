//! The columns of the range image, and which of its cells hold a return.

use super::within;
use crate::entropy::TokenTables;
use crate::frame::frame::Frame;
use crate::frame::modelling::OccupancyModelling;
use crate::frame::sections::SectionCoder;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::Reference;
use crate::models::{OCCUPANCY_CONTEXTS, OccupancyModel, code_occupancy};
use crate::scanner::{ColumnModels, Scanner};
use crate::stream::container::SectionKind;

/// What a group's range images have taught so far.
#[derive(Clone, Default)]
pub struct ImageModels {
    columns: ColumnModels,
    // Made when it is first wanted: it is large.
    occupancy: Option<OccupancyModel>,
    occupancy_tokens: TokenTables,
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
        frame: &mut Frame,
    ) -> Result<()> {
        let Some(scanner) = scanner else { return Ok(()) };
        let most = sections.limits().points;
        sections.section(SectionKind::Columns, true, |coder| {
            scanner.code_columns(&mut self.columns, coder, &mut frame.image, most)
        })?;
        let cells = scanner.rows().saturating_mul(frame.image.columns.len());
        within(cells, most, "cells of the range image")?;
        frame.fit_image(scanner.rows());
        Ok(())
    }

    /// Codes which cells hold a return, if there is a range image.
    ///
    /// # Errors
    /// If the section is damaged, or there are other returns than the frame has.
    pub fn code_occupancy<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &mut Frame,
    ) -> Result<()> {
        let records = frame.records - frame.strays;
        if records == 0 {
            return Ok(());
        }
        let occupancy = &mut frame.occupancy;
        match frame.parameters.modelling().parts().occupancy {
            OccupancyModelling::Tokens => {
                let tables = &mut self.occupancy_tokens;
                sections.tokens(SectionKind::Occupancy, OCCUPANCY_CONTEXTS, tables, |coder| {
                    code_occupancy(coder, occupancy);
                })?;
            }
            depth => {
                let model = self.occupancy.get_or_insert_default();
                model.set_quick(depth == OccupancyModelling::Light);
                sections.section(SectionKind::Occupancy, true, |coder| {
                    model.code(coder, reference, occupancy);
                    Ok(())
                })?;
            }
        }
        frame.cells = frame.occupancy.places();
        let is_full = frame.image.is_full;
        let in_image = if is_full { frame.occupancy.cells().len() } else { frame.cells.len() };
        // The others are echoes.
        if in_image > records || is_full && in_image < records {
            return Err(Error::corrupt("the range image holds another number of records than the frame"));
        }
        if is_full {
            frame.blanks = frame.occupancy.map(|filled| !filled).places();
        }
        Ok(())
    }
}

impl Frame {
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
