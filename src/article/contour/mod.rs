//! The contour map (article, IV-D.1): the region of each return, coded as borders and the regions of the
//! pieces between them. The same functions code it in both directions. FORMAT.md 8.11.
//!
//! A return is on a border if the next return to its right or below it, however far away, belongs to another
//! region. The bitmap of borders is coded in blocks of 4 x 4 cells. A return that is not on a border is
//! joined with the next returns to its right and below; joined returns are a *piece*. The region of each
//! piece is coded in scan order. Single returns between borders, the article's exceptions, are pieces like
//! others. The image does not wrap around: the seam is one column of many.

mod borders;
mod pieces;
mod returns;
mod values;

use crate::entropy::BitCoder;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use borders::BorderModel;
use returns::Returns;
use values::ValueModel;

/// The adaptive models of contour maps.
#[derive(Clone, Default)]
pub struct ContourModel {
    borders: BorderModel,
    values: ValueModel,
}

impl ContourModel {
    /// Codes the labels (rows x columns) of the cells that hold a return. The encoder's must be numbered as
    /// by [`renumber`]; a decoder's are ignored except for their size. Returns the number of regions.
    ///
    /// Rows should be [aligned](crate::scanner::hdl64::Alignment::align), since vertical borders are cheap.
    ///
    /// # Errors
    /// If the stream refers to a region that does not exist.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        labels: &mut Grid<u32>,
    ) -> Result<u32> {
        let returns = Returns::of(occupancy);
        let (mut regions_of, mut borders) = (vec![0; returns.len()], Vec::new());
        if C::ENCODES {
            (0..returns.len()).for_each(|number| regions_of[number] = labels[returns.cell(number)]);
            borders = borders_of(&returns, &regions_of);
        }
        let borders = self.borders.code(coder, &returns, &borders);
        let pieces = pieces::fill(&returns, &borders);
        let regions = self.values.code(coder, &returns, &pieces, &mut regions_of)?;
        *labels = Grid::new(occupancy.rows(), occupancy.columns());
        (0..returns.len()).for_each(|number| labels[returns.cell(number)] = regions_of[number]);
        Ok(regions)
    }
}

/// Numbers the labels of returns from 1 in the order of their first appearance in the scan; 0 elsewhere.
/// Returns the old label of each number, from 1 on.
pub fn renumber(occupancy: &Grid<bool>, labels: &mut Grid<u32>) -> Vec<u32> {
    let end = labels.cells().iter().max().map_or(0, |most| *most as usize + 1);
    let (mut numbers, mut old) = (vec![0; end], Vec::new());
    for row in 0..labels.rows() {
        for (label, filled) in labels.row_mut(row).iter_mut().zip(occupancy.row(row)) {
            if !filled {
                *label = 0;
                continue;
            }
            let number = &mut numbers[*label as usize];
            if *number == 0 {
                old.push(*label);
                *number = old.len() as u32;
            }
            *label = *number;
        }
    }
    old
}

/// Whether each return differs from the next one to the right or below.
fn borders_of(returns: &Returns, regions_of: &[u32]) -> Vec<bool> {
    let is_border = |number: usize| {
        let differs = |other: Option<usize>| other.is_some_and(|o| regions_of[o] != regions_of[number]);
        differs(returns.right(number)) || differs(returns.below(number))
    };
    (0..returns.len()).map(is_border).collect()
}

#[cfg(test)]
mod tests;
