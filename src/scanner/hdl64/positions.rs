//! The positions of the returns of a range image by the formula. FORMAT.md 8.7.

use pulp::NullaryFnOnce;

use super::Hdl64;
use crate::ground::lanes::dispatch;
use crate::scanner::{CoordinateGrid, Return, nearest_millimetre};

/// Positions of returns (metres), which are in row order and `offset_m` metres farther away than their steps:
/// rounded to the file's grid if `on_grid`, otherwise as the formula gives them.
pub fn positions(scanner: &Hdl64, returns: &[Return], offset_m: f64, on_grid: bool) -> Vec<[f32; 3]> {
    dispatch(Filling { scanner, returns, offset_m, on_grid })
}

/// The arguments of [`positions`], for a function compiled for several vector units.
struct Filling<'a> {
    scanner: &'a Hdl64,
    returns: &'a [Return],
    offset_m: f64,
    on_grid: bool,
}

impl NullaryFnOnce for Filling<'_> {
    type Output = Vec<[f32; 3]>;

    #[inline(always)]
    fn call(self) -> Vec<[f32; 3]> {
        let Filling { scanner, returns, offset_m, on_grid } = self;
        /// In metres: the range in which `nearest_millimetre` is valid, whatever the beams' offsets.
        const NEAR: f64 = 1.9e6;
        let grid = scanner.coordinates;
        let is_near = scanner.metres(scanner.most_steps()) < NEAR;
        match (on_grid, grid) {
            (true, CoordinateGrid::Millimetre) if is_near => {
                fill(scanner, returns, offset_m, nearest_millimetre)
            }
            (true, CoordinateGrid::Float32) => {
                // The same result as `nearest`, without converting to units and back.
                fill(
                    scanner,
                    returns,
                    offset_m,
                    |formula| if formula.is_nan() { 0.0 } else { formula as f32 },
                )
            }
            (true, _) => fill(scanner, returns, offset_m, |formula| grid.nearest(formula)),
            (false, _) => fill(scanner, returns, offset_m, |formula| formula as f32),
        }
    }
}

#[inline(always)]
fn fill(scanner: &Hdl64, returns: &[Return], offset_m: f64, stored: impl Fn(f64) -> f32) -> Vec<[f32; 3]> {
    let mut positions = vec![[0.0; 3]; returns.len()];
    let (mut returns, mut rest) = (returns, positions.as_mut_slice());
    while let Some(first) = returns.first() {
        let of_row = returns.partition_point(|found| found.row <= first.row).max(1);
        let (of_row, others) = returns.split_at(of_row);
        let (own, behind) = rest.split_at_mut(of_row.len());
        scanner.fill_positions(first.row as usize, (of_row, offset_m), &stored, own);
        (returns, rest) = (others, behind);
    }
    positions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::hdl64::Refinement;
    use crate::scanner::hdl64::testing::scanner;

    #[test]
    fn every_vector_unit_gives_the_same_bits() {
        let bits =
            |positions: &[[f32; 3]]| positions.concat().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let (scanner, image) = scanner();
        let single = scanner.clone().with_refinements(vec![Refinement::default(); scanner.rows()]);
        let mut of_floats = single.clone();
        of_floats.coordinates = CoordinateGrid::Float32;
        for scanner in [of_floats, single, scanner] {
            let returns = image.file_order(&scanner);
            for on_grid in [false, true] {
                let here = positions(&scanner, &returns, 1e-4, on_grid);
                let anywhere =
                    Filling { scanner: &scanner, returns: &returns, offset_m: 1e-4, on_grid }.call();
                assert_eq!(bits(&here), bits(&anywhere));
                let alone = returns.iter().map(|found| {
                    let metres = scanner.metres(found.steps) + 1e-4;
                    let position = scanner.position_at(found.row as usize, found.tick, metres);
                    position.map(|m| if on_grid { scanner.coordinates.nearest(m) } else { m as f32 })
                });
                assert_eq!(bits(&here), bits(&alone.collect::<Vec<_>>()));
            }
        }
    }
}
