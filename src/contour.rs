//! The contour map (article, IV-D.1): which region each return belongs to, as borders and what is
//! between them. The same functions code it in both directions.
//!
//! The image of labels is made whole first: cells without a return take the label to their left. A cell
//! is on a border if the one to its right or the one below has another label. The bitmap of borders is
//! coded in blocks of 4 x 4 bits. Cells that are not on a border are filled together with the cells to
//! their right and below; what is filled together is a *piece*. The region of each piece is coded in
//! scan order. Single cells between borders, the article's exceptions, are pieces like others.

mod borders;
mod pieces;
mod values;

use crate::entropy::BitCoder;
use crate::error::Result;
use crate::grid::Grid;
use borders::BorderModel;
use pieces::Pieces;
use values::ValueModel;

/// What the coder has learned about contour maps.
#[derive(Default)]
pub struct ContourModel {
    borders: BorderModel,
    values: ValueModel,
}

impl ContourModel {
    /// Codes the labels (rows x columns) of the cells that hold a return. The encoder's must be
    /// numbered as [`renumber`] does. Returns the number of regions.
    ///
    /// # Errors
    /// If the stream names a region that there is not.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        occupancy: &Grid<bool>,
        labels: &mut Grid<u32>,
    ) -> Result<u32> {
        let mut borders = Grid::new(occupancy.rows(), occupancy.columns());
        if C::ENCODES {
            borders = borders_of(&whole(occupancy, labels));
        }
        self.borders.code(coder, occupancy, &mut borders);
        let pieces = Pieces::fill(&borders);
        self.values.code(coder, occupancy, &pieces, labels)
    }
}

/// Numbers the labels of returns from 1 on as they first appear in scan order; 0 elsewhere. Returns the
/// old label of each number, from 1 on.
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

/// The labels, with those of empty cells from the left, or from the row above where a row begins.
fn whole(occupancy: &Grid<bool>, labels: &Grid<u32>) -> Grid<u32> {
    let mut whole = labels.clone();
    let mut first = 0;
    for row in 0..labels.rows() {
        let mut left = first;
        for (column, label) in whole.row_mut(row).iter_mut().enumerate() {
            if occupancy[(row, column)] {
                left = *label;
            }
            *label = left;
            if column == 0 {
                first = left;
            }
        }
    }
    whole
}

/// Which cells differ from the one to the right or the one below.
fn borders_of(labels: &Grid<u32>) -> Grid<bool> {
    let mut borders = Grid::new(labels.rows(), labels.columns());
    for row in 0..labels.rows() {
        for column in 0..labels.columns() {
            let own = labels[(row, column)];
            let right = column + 1 < labels.columns() && labels[(row, column + 1)] != own;
            let below = row + 1 < labels.rows() && labels[(row + 1, column)] != own;
            borders[(row, column)] = right || below;
        }
    }
    borders
}

#[cfg(test)]
mod tests;
