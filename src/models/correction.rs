//! The corrections: values added to the formula's coordinates, in units of the file's grid; as adaptive bits,
//! and as tokens. FORMAT.md 8.7 and 8.16.

use pulp::bytemuck::cast_slice;

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel, TokenCoder};
use crate::ground::floats::round_ties_even;
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::squared_distance;
use crate::scanner::CoordinateGrid;

/// Classes of the distance (in units) to the rounding boundary: the formula is accurate to a few micrometres,
/// so only coordinates closer to a boundary are ever rounded to the other side.
const BORDER_DISTANCES: [f64; 6] = [0.0005, 0.001, 0.002, 0.004, 0.008, 0.016];
/// Farther from a boundary than this, hardly any coordinate is corrected.
const CLEAR_DISTANCE: f64 = 0.05;
/// Contexts of float32 corrections: how much finer the coordinate's unit is than the range's.
const FINENESS: usize = 24;
/// Contexts of whether a point is corrected: which of the last three were.
const RECENT: usize = 8;

/// The adaptive models of corrections.
#[derive(Clone)]
pub struct CorrectionModel {
    /// Whether a point is corrected, if this is coded first.
    is_corrected: [AdaptiveBit; RECENT],
    /// Which of the last three points were corrected, one bit each.
    recent: usize,
    /// Whether a point is corrected although no coordinate is near a boundary.
    unclear: AdaptiveBit,
    /// Whether there is a correction, for each distance to the boundary.
    any: Vec<AdaptiveBit>,
    /// Whether the correction crosses the boundary that is near.
    expected: Vec<AdaptiveBit>,
    /// The remaining magnitudes, for each axis, fineness, and whether a preceding coordinate is corrected.
    rest: Vec<IntegerModel>,
}

impl Default for CorrectionModel {
    fn default() -> Self {
        CorrectionModel {
            is_corrected: Default::default(),
            recent: 0,
            unclear: AdaptiveBit::default(),
            any: vec![AdaptiveBit::default(); 3 * (BORDER_DISTANCES.len() + 1)],
            expected: vec![AdaptiveBit::default(); BORDER_DISTANCES.len() + 1],
            rest: vec![IntegerModel::default(); 3 * FINENESS * 2],
        }
    }
}

impl CorrectionModel {
    /// Codes the position of a return. It is `near`, the formula's position on the grid, unless it is
    /// corrected as by [`correct`](Self::correct). The encoder corrects it if it is farther than `max_error`
    /// metres from `near`, or, if no error is allowed, if the two differ.
    #[inline]
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: CoordinateGrid,
        formula: impl FnOnce() -> [f64; 3],
        (near, max_error): ([f32; 3], Option<f64>),
        position: &mut [f32; 3],
    ) {
        let is_far = C::ENCODES
            && match max_error {
                None => (0..3).any(|axis| near[axis].to_bits() != position[axis].to_bits()),
                Some(max_error) => squared_distance(&near, position).sqrt() > max_error,
            };
        if self.code_whether(coder, is_far) {
            self.correct(coder, grid, formula(), position);
        } else {
            *position = near;
        }
    }

    /// Codes whether a point is corrected.
    fn code_whether<C: BitCoder>(&mut self, coder: &mut C, is_corrected: bool) -> bool {
        let is_corrected = self.is_corrected[self.recent].code(coder, is_corrected);
        self.recent = (self.recent << 1 | usize::from(is_corrected)) % RECENT;
        is_corrected
    }

    /// Codes the corrections of a position, given the formula's position in metres. The encoder's position
    /// must be on the grid.
    pub fn correct<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: CoordinateGrid,
        formula: [f64; 3],
        position: &mut [f32; 3],
    ) {
        let predicted = formula.map(|metres| grid.unit_of(metres));
        let mut corrections = [0; 3];
        if C::ENCODES {
            corrections =
                std::array::from_fn(|axis| grid.unit_of(f64::from(position[axis])) - predicted[axis]);
        }
        match grid {
            CoordinateGrid::Millimetre => {
                self.code_roundings(coder, formula.map(|v| v * 1000.0), &mut corrections)
            }
            _ => self.code_floats(coder, formula, &mut corrections),
        }
        if !C::ENCODES {
            let value =
                |axis: usize| grid.value(predicted[axis].wrapping_add(corrections[axis]), formula[axis]);
            *position = std::array::from_fn(value);
        }
    }

    /// Corrections on a grid far coarser than the formula's errors: 0 except near a boundary.
    fn code_roundings<C: BitCoder>(&mut self, coder: &mut C, units: [f64; 3], corrections: &mut [i64; 3]) {
        let offsets = units.map(|u| u - round_ties_even(u));
        let distances = offsets.map(|offset| 0.5 - offset.abs());
        if distances.iter().all(|&d| d >= CLEAR_DISTANCE) && !self.unclear.code(coder, *corrections != [0; 3])
        {
            return;
        }
        for axis in 0..3 {
            let level = BORDER_DISTANCES.iter().filter(|&&border| distances[axis] >= border).count();
            let correction = &mut corrections[axis];
            let over_border = if offsets[axis] < 0.0 { -1 } else { 1 };
            if !self.any[level * 3 + axis].code(coder, *correction != 0) {
                *correction = 0;
            } else if self.expected[level].code(coder, *correction == over_border) {
                *correction = over_border;
            } else {
                *correction = self.rest[2 * axis * FINENESS].code_signed(coder, *correction);
            }
        }
    }

    /// Corrections on a grid finer than the formula's errors, which are about equally large along every axis,
    /// however fine its unit is.
    fn code_floats<C: BitCoder>(&mut self, coder: &mut C, formula: [f64; 3], corrections: &mut [i64; 3]) {
        let exponents = formula.map(|v| (v.to_bits() >> 52 & 0x7ff) as usize);
        let largest = exponents.into_iter().max().unwrap_or(0);
        let mut is_any = false;
        for axis in 0..3 {
            let fineness = (largest - exponents[axis]).min(FINENESS - 1);
            let context = 2 * (axis * FINENESS + fineness) + usize::from(is_any);
            corrections[axis] = self.rest[context].code_signed(coder, corrections[axis]);
            is_any |= corrections[axis] != 0;
        }
    }
}

/// The context of the number of points without corrections; those of the axes follow.
const GAP: usize = 0;
/// Number of contexts of a correction.
pub const CORRECTION_CONTEXTS: usize = 4;

/// Corrects positions, which are on a grid (metres), given the formula's positions: those with these numbers,
/// in ascending order, or all. The encoder replaces a position by that in `wanted` if the two differ or, if an
/// error is allowed, are farther apart than it. As tokens: the number of points without a correction, then the
/// correction of the next point, in units of the grid.
pub fn correct_positions<C: TokenCoder>(
    coder: &mut C,
    grid: CoordinateGrid,
    formula: impl Fn(usize) -> [f64; 3],
    (wanted, max_error): (&[[f32; 3]], Option<f64>),
    (positions, numbers): (&mut [[f32; 3]], Option<&[u32]>),
) {
    let is_corrected = |wanted: &[f32; 3], position: &[f32; 3]| {
        let same = position.map(f32::to_bits) == wanted.map(f32::to_bits);
        !same && max_error.is_none_or(|max| squared_distance(position, wanted).sqrt() > max)
    };
    let at = |point: usize| numbers.map_or(point, |numbers| numbers[point] as usize);
    let end = numbers.map_or(positions.len(), <[u32]>::len);
    let mut next = 0;
    loop {
        // In a decoder `wanted` is empty, and the number comes from the stream.
        let is_right = |point: &usize| {
            let wanted = wanted.get(at(*point));
            wanted.is_some_and(|wanted| !is_corrected(wanted, &positions[at(*point)]))
        };
        // Most points need no correction, which is seen faster of many at once.
        let first =
            next + if numbers.is_none() { same_points(&positions[next..], wanted.get(next..)) } else { 0 };
        let gap = first - next + (first..end).take_while(is_right).count();
        let gap = coder.number(GAP, gap as u64).min((end - next) as u64) as usize;
        next += gap;
        if next == end || coder.is_exhausted() {
            return;
        }
        let point = at(next);
        let formula = formula(point);
        for axis in 0..3 {
            let unit = grid.unit_of(formula[axis]);
            let file = wanted.get(point).map_or(0.0, |wanted| wanted[axis]);
            let correction = grid.unit_of(f64::from(file)).wrapping_sub(unit);
            let correction = unzigzag(coder.number(1 + axis, zigzag(correction) & ((1 << 60) - 1)));
            positions[point][axis] = grid.value(unit.wrapping_add(correction), formula[axis]);
        }
        next += 1;
    }
}

/// A number of points at the start that have the same bits in both lists: not always all of them.
fn same_points(a: &[[f32; 3]], b: Option<&[[f32; 3]]>) -> usize {
    const MANY: usize = 64;
    let blocks = a.chunks_exact(MANY).zip(b.unwrap_or_default().chunks_exact(MANY));
    let same = |(a, b): &(&[[f32; 3]], &[[f32; 3]])| cast_slice::<_, u8>(a) == cast_slice::<_, u8>(b);
    MANY * blocks.take_while(same).count()
}
