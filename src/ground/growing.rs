//! A table that is read while it is written.

use std::sync::OnceLock;

#[cfg(any(test, feature = "internals"))]
use super::grid::Grid;

/// A table whose rows are written one after the other, and may be read by another thread as they come.
pub struct GrowingGrid<T> {
    columns: usize,
    rows: Vec<OnceLock<Vec<T>>>,
}

impl<T: Clone + Default> GrowingGrid<T> {
    /// A table without any row yet.
    pub fn new(rows: usize, columns: usize) -> Self {
        GrowingGrid { columns, rows: (0..rows).map(|_| OnceLock::new()).collect() }
    }

    /// A table of which all rows are there.
    #[cfg(any(test, feature = "internals"))]
    pub fn of(grid: &Grid<T>) -> Self {
        let rows = (0..grid.rows()).map(|row| OnceLock::from(grid.row(row).to_vec())).collect();
        GrowingGrid { columns: grid.columns(), rows }
    }

    /// What writes the rows. There is to be only one.
    pub fn writer(&self) -> RowWriter<'_, T> {
        RowWriter { grid: self, next: 0 }
    }

    /// A row; waits until it has been written.
    pub fn row(&self, row: usize) -> &[T] {
        self.rows[row].wait()
    }
}

/// Writes the rows of a table. Those that are not written when it is dropped are filled with the default value, so that
/// nobody waits for them.
pub struct RowWriter<'g, T: Clone + Default> {
    grid: &'g GrowingGrid<T>,
    next: usize,
}

impl<T: Clone + Default> RowWriter<'_, T> {
    /// Writes the next row, if there is one left.
    pub fn push(&mut self, row: &[T]) {
        if let Some(place) = self.grid.rows.get(self.next) {
            place.get_or_init(|| row.to_vec());
        }
        self.next += 1;
    }
}

impl<T: Clone + Default> Drop for RowWriter<'_, T> {
    fn drop(&mut self) {
        let missing = vec![T::default(); self.grid.columns];
        while self.next < self.grid.rows.len() {
            self.push(&missing);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn a_reader_gets_each_row_as_it_comes_and_never_waits_for_ever() {
        let grid = GrowingGrid::<u16>::new(5, 3);
        thread::scope(|scope| {
            let reader = scope.spawn(|| (0..5).map(|row| grid.row(row).to_vec()).collect::<Vec<_>>());
            let mut writer = grid.writer();
            (0..3).for_each(|row| writer.push(&[row; 3]));
            drop(writer);
            assert_eq!(reader.join().unwrap(), [[0; 3], [1; 3], [2; 3], [0; 3], [0; 3]]);
        });
        let whole = Grid::<u16>::new(2, 2);
        assert_eq!(GrowingGrid::of(&whole).row(1), [0; 2]);
    }
}
