//! The order in which a file holds the returns of a range image.

use std::cmp::Ordering;

use super::{RangeImage, Return};
use crate::sensor::SensorModel;

impl RangeImage {
    /// The returns in the order in which a file holds them: row by row, by the azimuth that the
    /// formula gives; those of equal azimuth column by column.
    pub fn file_order(&self, sensor: &SensorModel) -> Vec<Return> {
        let mut returns = Vec::with_capacity(self.returns());
        let mut of_row: Vec<(f64, Return)> = Vec::new();
        for row in 0..self.steps.rows() {
            of_row.clear();
            let cells = self.steps.row(row).iter().zip(&self.columns).zip(0u32..);
            of_row.extend(cells.filter(|((steps, _), _)| **steps > 0).map(
                |((&steps, &column_tick), column)| {
                    let tick = sensor.tick_of_column(row, column_tick);
                    (sensor.azimuth(row, tick, steps), Return { row: row as u32, column, tick, steps })
                },
            ));
            sort(&mut of_row);
            returns.extend(of_row.iter().map(|(_, found)| *found));
        }
        returns
    }
}

/// Sorts by azimuth, then column, what nearly is but for where the turn begins.
fn sort(of_row: &mut [(f64, Return)]) {
    /// Radians: more than azimuths that are out of order differ by.
    const SEAM: f64 = 3.0;
    /// Places, for each return, that are worth moving returns by one by one.
    const MOVES: usize = 4;
    let order = |a: &(f64, Return), b: &(f64, Return)| a.0.total_cmp(&b.0).then(a.1.column.cmp(&b.1.column));
    let seam = of_row.windows(2).position(|pair| pair[1].0 < pair[0].0 - SEAM);
    of_row.rotate_left(seam.map_or(0, |last| last + 1));
    let mut moves = MOVES * of_row.len();
    for next in 1..of_row.len() {
        let mut place = next;
        while place > 0 && moves > 0 && order(&of_row[place - 1], &of_row[place]) == Ordering::Greater {
            of_row.swap(place - 1, place);
            (place, moves) = (place - 1, moves - 1);
        }
        if moves == 0 {
            of_row.sort_unstable_by(order);
            return;
        }
    }
}
