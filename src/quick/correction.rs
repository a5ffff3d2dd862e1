//! What the formula's coordinates miss the file's by, in units of their grid: how many points need no
//! correction, and then those of the one that does.

use crate::entropy::TokenCoder;
use crate::scan::squared_distance;
use crate::sensor::Coordinates;
use crate::varint::{unzigzag, zigzag};

/// The context of the number of points without corrections; the axes' come after it.
const GAP: usize = 0;
pub const CORRECTION_CONTEXTS: usize = 4;

/// Where a return is by the formula.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// Metres.
    pub formula: [f64; 3],
    /// What the file holds if there is no correction, in metres.
    pub position: [f32; 3],
}

/// Codes positions on a grid (metres), given where each is by the formula. The encoder's are corrected that
/// are not the same and, if an error is allowed, farther than `max_error` metres from there.
pub fn code_positions<C: TokenCoder>(
    coder: &mut C,
    grid: Coordinates,
    near: impl Fn(usize) -> Near,
    max_error: Option<f64>,
    positions: &mut [[f32; 3]],
) {
    let is_corrected = |(point, position): (usize, &[f32; 3])| {
        let Near { position: near, .. } = near(point);
        let same = near.map(f32::to_bits) == position.map(f32::to_bits);
        let within = max_error.is_some_and(|max| squared_distance(&near, position).sqrt() <= max);
        !(same || within)
    };
    let mut corrected = Vec::new();
    if C::ENCODES {
        let points = positions.iter().enumerate();
        corrected.extend(points.filter(|&point| is_corrected(point)).map(|(point, _)| point));
    }
    let mut corrected = corrected.into_iter();
    let mut point = 0;
    loop {
        let next = corrected.next().unwrap_or(positions.len());
        let gap = coder.number(GAP, (next - point) as u64).min((positions.len() - point) as u64) as usize;
        // The encoder's are these already, unless an error is allowed.
        if !C::ENCODES || max_error.is_some() {
            (point..point + gap).for_each(|point| positions[point] = near(point).position);
        }
        point += gap;
        let Some(position) = positions.get_mut(point).filter(|_| !coder.is_exhausted()) else { return };
        let formula = near(point).formula;
        for axis in 0..3 {
            let unit = grid.unit_of(formula[axis]);
            let correction = grid.unit_of(f64::from(position[axis])).wrapping_sub(unit);
            let correction = unzigzag(coder.number(1 + axis, zigzag(correction) & ((1 << 60) - 1)));
            if !C::ENCODES {
                position[axis] = grid.value(unit.wrapping_add(correction), formula[axis]);
            }
        }
        point += 1;
    }
}
