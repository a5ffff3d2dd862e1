use proptest::prelude::*;

use super::*;
use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};

/// Codes labels, decodes them and compares; returns the number of bytes.
fn comes_back(occupancy: &Grid<bool>, labels: &Grid<u32>) -> usize {
    let mut numbered = labels.clone();
    let regions = renumber(occupancy, &mut numbered).len() as u32;
    let mut encoder = ArithmeticEncoder::default();
    let mut coded = numbered.clone();
    assert_eq!(ContourModel::default().code(&mut encoder, occupancy, &mut coded).unwrap(), regions);
    assert_eq!(coded, numbered);
    let bytes = encoder.finish();
    let mut decoded = Grid::new(occupancy.rows(), occupancy.columns());
    let mut decoder = ArithmeticDecoder::new(&bytes);
    assert_eq!(ContourModel::default().code(&mut decoder, occupancy, &mut decoded).unwrap(), regions);
    assert_eq!(decoded, numbered);
    bytes.len()
}

fn grid<T: Clone + Default>(rows: usize, columns: usize, value: impl Fn(usize, usize) -> T) -> Grid<T> {
    let mut grid = Grid::new(rows, columns);
    for row in 0..rows {
        for column in 0..columns {
            grid[(row, column)] = value(row, column);
        }
    }
    grid
}

#[test]
fn odd_maps_come_back() {
    let all = grid(64, 100, |_, _| true);
    comes_back(&Grid::new(0, 0), &Grid::new(0, 0));
    comes_back(&Grid::new(64, 0), &Grid::new(64, 0));
    comes_back(&Grid::new(64, 100), &Grid::new(64, 100));
    comes_back(&grid(64, 100, |r, c| (r, c) == (20, 30)), &grid(64, 100, |_, _| 9));
    assert!(comes_back(&all, &grid(64, 100, |_, _| 5)) < 40, "one region");
    comes_back(&all, &grid(64, 100, |r, c| (r * 100 + c) as u32));
    comes_back(&all, &grid(64, 100, |r, c| 1 + (r + c) as u32 % 2));
    // More rows than have their own contexts.
    comes_back(&grid(300, 20, |r, c| (r * c) % 5 > 0), &grid(300, 20, |r, c| (r / 7 + c / 3) as u32));
}

#[test]
fn sixty_thousand_regions_come_back() {
    comes_back(&grid(64, 1000, |r, c| (r + c) % 16 != 0), &grid(64, 1000, |r, c| (r * 1000 + c) as u32));
}

#[test]
fn numbers_are_in_order_of_appearance() {
    let occupancy = grid(2, 3, |r, c| (r, c) != (0, 0));
    let mut labels = grid(2, 3, |r, c| [[8, 7, 7], [9, 3, 7]][r][c]);
    assert_eq!(renumber(&occupancy, &mut labels), [7, 9, 3]);
    assert_eq!(labels.cells(), [0, 1, 1, 2, 3, 1]);
}

#[test]
fn cells_without_a_return_cost_nothing() {
    // A wall of three regions, complete and with two of three returns missing.
    let labels = grid(60, 300, |r, c| (c + r / 10) as u32 / 110);
    let sparse = grid(60, 300, |r, c| (r + c) % 3 == 0);
    let whole = grid(60, 300, |_, _| true);
    assert!(comes_back(&sparse, &labels) <= comes_back(&whole, &labels) + 10);
}

#[test]
fn what_borders_imply_costs_nothing() {
    // A diagonal border between two regions: wherever a piece begins, the border determines its region.
    let stairs = grid(64, 64, |r, c| u32::from(r + c >= 64));
    assert!(comes_back(&grid(64, 64, |_, _| true), &stairs) < 60);
}

proptest! {
    #[test]
    fn any_map_comes_back(
        cells in prop::collection::vec((any::<bool>(), 0u32..5), 60),
        rows in prop::sample::select(vec![1usize, 3, 5, 10, 60]),
    ) {
        let columns = 60 / rows;
        let occupancy = grid(rows, columns, |r, c| cells[r * columns + c].0);
        comes_back(&occupancy, &grid(rows, columns, |r, c| cells[r * columns + c].1));
    }

    #[test]
    fn any_bytes_give_a_labelling_or_an_error(
        bytes in prop::collection::vec(any::<u8>(), 0..60),
        filled in prop::collection::vec(any::<bool>(), 60),
    ) {
        let occupancy = grid(6, 10, |r, c| filled[r * 10 + c]);
        let mut labels = Grid::new(6, 10);
        let coded = ContourModel::default().code(&mut ArithmeticDecoder::new(&bytes), &occupancy, &mut labels);
        if let Ok(regions) = coded {
            for (label, filled) in labels.cells().iter().zip(occupancy.cells()) {
                prop_assert_eq!((1..=regions).contains(label), *filled);
                prop_assert!(*filled || *label == 0);
            }
        }
    }
}
