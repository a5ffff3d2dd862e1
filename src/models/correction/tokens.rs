//! The corrections as tokens: the number of points without a correction, then the correction of the next
//! point, in units of the grid. FORMAT.md 8.16.

use crate::entropy::TokenCoder;
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::squared_distance;
use crate::scanner::Coordinates;

/// The context of the number of points without corrections; those of the axes follow.
const GAP: usize = 0;
/// Number of contexts of a correction.
pub const CORRECTION_CONTEXTS: usize = 4;

/// Corrects positions, which are on a grid (metres), given the formula's positions. The encoder replaces a
/// position by that in `wanted` if the two differ or, if an error is allowed, are farther apart than it.
pub fn correct_positions<C: TokenCoder>(
    coder: &mut C,
    grid: Coordinates,
    formula: impl Fn(usize) -> [f64; 3],
    (wanted, max_error): (&[[f32; 3]], Option<f64>),
    positions: &mut [[f32; 3]],
) {
    let is_corrected = |wanted: &[f32; 3], position: &[f32; 3]| {
        let same = position.map(f32::to_bits) == wanted.map(f32::to_bits);
        !same && max_error.is_none_or(|max| squared_distance(position, wanted).sqrt() > max)
    };
    let (mut next, end) = (0, positions.len());
    loop {
        // In a decoder `wanted` is empty, and the number comes from the stream.
        let known = wanted.iter().zip(&*positions).skip(next);
        let gap = known.take_while(|(wanted, position)| !is_corrected(wanted, position)).count();
        let gap = coder.number(GAP, gap as u64).min((end - next) as u64) as usize;
        let point = next + gap;
        let Some(position) = positions.get_mut(point).filter(|_| !coder.is_exhausted()) else { return };
        let formula = formula(point);
        for axis in 0..3 {
            let unit = grid.unit_of(formula[axis]);
            let file = wanted.get(point).map_or(0.0, |wanted| wanted[axis]);
            let correction = grid.unit_of(f64::from(file)).wrapping_sub(unit);
            let correction = unzigzag(coder.number(1 + axis, zigzag(correction) & ((1 << 60) - 1)));
            position[axis] = grid.value(unit.wrapping_add(correction), formula[axis]);
        }
        next = point + 1;
    }
}
