//! Snake prediction (article, V-C): each pixel is predicted from the one before it on a path that runs
//! through the rows in alternating directions, so that the first pixel of a row has its reference right
//! above. FORMAT.md 8.13.

use crate::ground::grid::Grid;
use crate::inter::snake_path as path;

/// Replaces the value of each return by its difference from the one before it on the path.
pub fn difference(occupancy: &Grid<bool>, values: &mut Grid<i32>) {
    let mut before = 0;
    for cell in path(occupancy) {
        let value = values[cell];
        values[cell] = value.wrapping_sub(before);
        before = value;
    }
}

/// The inverse of [`difference`].
pub fn sum(occupancy: &Grid<bool>, values: &mut Grid<i32>) {
    let mut before = 0i32;
    for cell in path(occupancy) {
        before = before.wrapping_add(values[cell]);
        values[cell] = before;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_path_turns_at_the_ends_of_rows() {
        let mut occupancy = Grid::new(2, 3);
        for cell in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)] {
            occupancy[cell] = true;
        }
        assert_eq!(path(&occupancy).collect::<Vec<_>>(), [(0, 0), (0, 1), (0, 2), (1, 2), (1, 0)]);
        let mut values = Grid::new(2, 3);
        for (row, column, value) in [(0, 0, 5), (0, 1, 7), (0, 2, 8), (1, 0, 1), (1, 1, 77), (1, 2, 9)] {
            values[(row, column)] = value;
        }
        difference(&occupancy, &mut values);
        assert_eq!(values.cells(), [5, 2, 1, -8, 77, 1]);
    }

    proptest! {
        #[test]
        fn any_values_come_back(
            cells in prop::collection::vec((any::<bool>(), any::<i32>()), 12),
            rows in prop::sample::select(vec![1usize, 2, 3, 4]),
        ) {
            let (mut occupancy, mut values) = (Grid::new(rows, 12 / rows), Grid::new(rows, 12 / rows));
            for (i, (filled, value)) in cells.into_iter().enumerate() {
                occupancy[(i % rows, i / rows)] = filled;
                values[(i % rows, i / rows)] = value;
            }
            let before = values.clone();
            difference(&occupancy, &mut values);
            sum(&occupancy, &mut values);
            prop_assert_eq!(values, before);
        }
    }
}
