//! A table of rows and columns.

/// A table of `rows` x `columns` values, stored row after row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Grid<T> {
    rows: usize,
    columns: usize,
    cells: Vec<T>,
}

impl<T: Clone + Default> Grid<T> {
    /// A table filled with the default value.
    pub fn new(rows: usize, columns: usize) -> Self {
        Grid { rows, columns, cells: vec![T::default(); rows * columns] }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The values of a row.
    pub fn row(&self, row: usize) -> &[T] {
        &self.cells[row * self.columns..][..self.columns]
    }

    /// The values of a row, mutable.
    pub fn row_mut(&mut self, row: usize) -> &mut [T] {
        &mut self.cells[row * self.columns..][..self.columns]
    }

    /// All values, row after row.
    pub fn cells(&self) -> &[T] {
        &self.cells
    }

    /// All values, row after row, mutable.
    pub fn cells_mut(&mut self) -> &mut [T] {
        &mut self.cells
    }

    /// The rows above `row`, and the remaining rows. Both halves of an empty table are empty.
    pub fn split(mut self, row: usize) -> [Self; 2] {
        let row = row.min(self.rows);
        let below = self.cells.split_off(row * self.columns);
        let lower = Grid { rows: self.rows - row, columns: self.columns, cells: below };
        self.rows = row;
        [self, lower]
    }

    /// The rows of two tables with equal numbers of columns, one table below the other.
    pub fn joined([mut upper, mut lower]: [Self; 2]) -> Self {
        upper.rows += lower.rows;
        upper.cells.append(&mut lower.cells);
        upper
    }

    /// A table of the same shape, with each value computed from the corresponding one.
    pub fn map<U>(&self, of: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { rows: self.rows, columns: self.columns, cells: self.cells.iter().map(of).collect() }
    }
}

impl Grid<bool> {
    /// The indices of the cells that are `true`, row after row.
    pub fn places(&self) -> Vec<u32> {
        let mut places = vec![0; self.cells.len() + 1];
        let mut count = 0;
        // Without branches: every index is written to the next entry, which the following one overwrites
        // unless the cell is true.
        for (place, filled) in (0u32..).zip(&self.cells) {
            places[count] = place;
            count += usize::from(*filled);
        }
        places.truncate(count);
        places
    }
}

impl<T: Copy + Default> Grid<T> {
    /// The values of the cells with these indices.
    pub fn at(&self, places: &[u32]) -> Vec<T> {
        places.iter().map(|&place| self.cells[place as usize]).collect()
    }

    /// Sets the cells with these indices to these values.
    pub fn fill(&mut self, places: &[u32], values: &[T]) {
        places.iter().zip(values).for_each(|(&place, &value)| self.cells[place as usize] = value);
    }

    /// The value at an offset from a cell; the default value outside the table.
    #[inline]
    pub fn beside(&self, (row, column): (usize, usize), down: isize, right: isize) -> T {
        match (row.checked_add_signed(down), column.checked_add_signed(right)) {
            (Some(row), Some(column)) if row < self.rows && column < self.columns => self[(row, column)],
            _ => T::default(),
        }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Grid<T> {
    type Output = T;

    fn index(&self, (row, column): (usize, usize)) -> &T {
        &self.cells[row * self.columns + column]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Grid<T> {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut T {
        &mut self.cells[row * self.columns + column]
    }
}
