//! Alignment of the rows of a range image, so that cells above one another have the same direction.
//! FORMAT.md 4.3, "Surfels".

use super::Hdl64;
use crate::ground::grid::Grid;

/// The rotation of each row of a range image relative to the others. A column holds simultaneous shots, but
/// the beams of a real scanner point up to about ten degrees to either side of its centre: the top and the
/// bottom of a column may be in very different directions. Shifting rows back by whole columns gives a
/// picture of the scene.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// The shift of each row, in columns.
    turns: Vec<usize>,
}

impl Alignment {
    /// The alignment of an image with `columns` columns by this scanner. Rows of the ideal scanner are not
    /// shifted.
    pub fn of(scanner: &Hdl64, columns: usize) -> Self {
        let ticks = u64::from(scanner.ticks);
        let turn = |row| {
            let shift = u64::from(scanner.column_tick(row, 0));
            ((shift * columns as u64 + ticks / 2) / ticks) as usize
        };
        // A shift of almost a turn may be rounded up to a whole turn, which is no shift.
        let turns = (0..scanner.rows()).map(|row| turn(row).checked_rem(columns).unwrap_or(0)).collect();
        Alignment { turns }
    }

    /// The number of columns by which a row is shifted: the column of the image that is its first aligned
    /// one.
    pub fn turn(&self, row: usize) -> usize {
        self.turns[row]
    }

    /// Shifts the rows of an image so that each column has one azimuth. The image must have the size that
    /// this alignment was made for.
    pub fn align<T: Clone + Default>(&self, grid: &mut Grid<T>) {
        (0..grid.rows()).for_each(|row| grid.row_mut(row).rotate_left(self.turns[row]));
    }

    /// Undoes [`align`](Self::align).
    pub fn restore<T: Clone + Default>(&self, grid: &mut Grid<T>) {
        (0..grid.rows()).for_each(|row| grid.row_mut(row).rotate_right(self.turns[row]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::hdl64::BeamConstants;
    use crate::scanner::{CoordinateGrid, ideal};

    /// A scanner of 4000 ticks with these shifts.
    fn shifted(shifts: &[i64]) -> Hdl64 {
        let beam = |&column_shift: &i64| BeamConstants { column_shift, ..BeamConstants::default() };
        Hdl64::new(CoordinateGrid::Millimetre, 4000, 2000, shifts.iter().map(beam).collect())
    }

    #[test]
    fn what_looks_the_same_way_comes_together() {
        let scanner = shifted(&[0, 20, -20, 3999]);
        let columns: Vec<u32> = (0..2000).map(|column| 2 * column).collect();
        let alignment = Alignment::of(&scanner, columns.len());
        let mut seen = Grid::new(4, 2000);
        for row in 0..4 {
            let way = |(tick, &column): (&mut u32, &u32)| *tick = scanner.tick_of_column(row, column);
            seen.row_mut(row).iter_mut().zip(&columns).for_each(way);
        }
        let before = seen.clone();
        alignment.align(&mut seen);
        for column in 0..2000u32 {
            let tick = |row| seen[(row, column as usize)];
            assert_eq!([tick(0), tick(1), tick(2)], [2 * column; 3]);
            assert_eq!(tick(3), (2 * column + 1) % 4000);
        }
        alignment.restore(&mut seen);
        assert_eq!(seen, before);
    }

    #[test]
    fn images_without_columns_or_shifts_stay_as_they_are() {
        let mut none = Grid::<u32>::new(2, 0);
        Alignment::of(&shifted(&[5, 7]), 0).align(&mut none);
        assert_eq!(none, Grid::new(2, 0));
        let alignment = Alignment::of(&ideal(2000, 10_000), 2000);
        assert!((0..64).all(|row| alignment.turn(row) == 0));
    }
}
