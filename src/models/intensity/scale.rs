//! The grid of intensities: levels are multiples of an equal part of 1.0. FORMAT.md 8.5.

use crate::models::numbers::{NumberGrid, Scale};
use crate::scan::ScalarType;

/// Levels per 1.0 in the files of known scanners: hundredths (KITTI), 256ths (KITTI-360), 255ths, whole
/// numbers (nuScenes, many PCD files).
const SCALES: [u32; 4] = [100, 256, 255, 1];
/// Number of bits of such a coded number.
const SCALE_BITS: u32 = 16;
/// The largest number of bits of a level.
pub const MOST_BITS: u32 = 9;

/// The grid on which the intensities of a frame lie.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IntensityScale {
    grid: LevelGrid,
    /// Bits of the highest level.
    bits: u32,
    /// Whether some values of the frame are not on the grid.
    exceptions: bool,
    /// How the values of a frame without a grid become integers.
    rough: Scale,
}

/// A grid with some number of levels per 1.0.
#[derive(Clone, Debug, Default, PartialEq)]
struct LevelGrid {
    /// 0 if the intensities are on no known grid.
    per_unit: u32,
    /// The value of each level; empty if there is no grid.
    values: Vec<f32>,
}

impl LevelGrid {
    fn new(per_unit: u32) -> Self {
        let value = |level: u32| (f64::from(level) / f64::from(per_unit)) as f32;
        let levels = if per_unit > 0 { 1 << MOST_BITS } else { 0 };
        LevelGrid { per_unit, values: (0..levels).map(value).collect() }
    }

    /// The level nearest to a value.
    #[inline]
    fn nearest(&self, value: f32) -> u32 {
        (f64::from(value) * f64::from(self.per_unit) + 0.5) as u32
    }

    /// The level with exactly this value, if there is one.
    #[inline]
    fn level_of(&self, value: f32) -> Option<u32> {
        let level = self.nearest(value);
        let found = self.values.get(level as usize)?;
        (found.to_bits() == value.to_bits()).then_some(level)
    }

    /// The number of values that are not on the grid, and the highest level; `None` if there are more than
    /// `most` such values. Those that repeat the one before, such as NaN, do not count: they cost little.
    fn misses(&self, values: &[f32], most: usize) -> Option<(usize, u32)> {
        let (mut misses, mut highest) = (0, 0);
        let mut last = None;
        for value in values {
            match self.level_of(*value) {
                Some(level) => highest = highest.max(level),
                None if last == Some(value.to_bits()) => {}
                None if misses < most => {
                    misses += 1;
                    last = Some(value.to_bits());
                }
                None => return None,
            }
        }
        Some((misses, highest))
    }
}

/// The integers of values without a [`LevelGrid`].
#[derive(Clone, Copy)]
pub struct RoughGrid(NumberGrid);

impl RoughGrid {
    /// The integer of a value, modulo 2^32.
    #[inline]
    pub fn integer(&self, value: f32) -> u32 {
        self.0.integer(&value.to_le_bytes()).unwrap_or(0) as u32
    }

    /// The value of an integer, modulo 2^32.
    #[inline]
    pub fn value(&self, integer: u32) -> f32 {
        let mut bytes = [0; 4];
        self.0.write((integer as i32).into(), &mut bytes);
        f32::from_le_bytes(bytes)
    }
}

/// A scale on which all of these values are integers of 32 bits.
fn rough_scale(values: &[f32]) -> Scale {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let scale = Scale::of(ScalarType::F32, &bytes);
    let rough = RoughGrid(scale.grid(ScalarType::F32));
    let comes_back = |value: &f32| rough.value(rough.integer(*value)).to_bits() == value.to_bits();
    if values.iter().all(comes_back) { scale } else { Scale::RANK }
}

impl IntensityScale {
    /// Determines the grid of a frame's intensities; `expected`: a number of levels per unit that is likely.
    pub fn of(intensity: &[f32], expected: Option<u32>) -> Self {
        let most = intensity.len() / 20;
        let mut best: Option<(usize, u32, LevelGrid)> = None;
        for per_unit in expected.into_iter().filter(|&levels| levels < 1 << SCALE_BITS).chain(SCALES) {
            let grid = LevelGrid::new(per_unit);
            let Some((misses, highest)) = grid.misses(intensity, most) else { continue };
            let is_better =
                |(fewest, _, other): &(usize, u32, LevelGrid)| (misses, per_unit) < (*fewest, other.per_unit);
            if best.as_ref().is_none_or(is_better) {
                best = Some((misses, highest, grid));
            }
            if misses == 0 {
                break;
            }
        }
        let Some((misses, highest, grid)) = best else {
            return IntensityScale { rough: rough_scale(intensity), ..IntensityScale::default() };
        };
        let bits = (32 - highest.leading_zeros()).max(1);
        IntensityScale { grid, bits, exceptions: misses > 0, rough: Scale::RANK }
    }

    /// The grid of whole numbers below `count`.
    pub fn of_levels(count: usize) -> Self {
        let bits = count.saturating_sub(1).max(1).ilog2() + 1;
        IntensityScale { grid: LevelGrid::new(1), bits: bits.min(MOST_BITS), ..IntensityScale::default() }
    }

    /// Codes the grid itself; `code_plain` codes plain numbers with a given number of bits.
    pub fn code(&mut self, mut code_plain: impl FnMut(u32, u32) -> u32) {
        self.grid = LevelGrid::new(code_plain(self.grid.per_unit, SCALE_BITS));
        self.bits = code_plain(self.bits, 4).clamp(1, MOST_BITS);
        self.exceptions = code_plain(u32::from(self.exceptions), 1) == 1;
        if !self.is_on_grid() {
            self.rough =
                Scale::from_code(code_plain(self.rough.to_code().into(), 8) as u8).unwrap_or_default();
        }
    }

    /// The level of a value as a context, limited to 1 to 128; 1 for values that are not on the grid.
    pub fn context_level(&self, value: f32) -> u16 {
        self.context_of(self.level_of(value).unwrap_or(0))
    }

    /// A level as a context, limited to 1 to 128.
    #[inline]
    pub fn context_of(&self, level: u32) -> u16 {
        (level >> self.bits.saturating_sub(7)).min(127) as u16 + 1
    }

    /// How many levels share a context level: 1, 2 or 4.
    #[inline]
    pub fn context_step(&self) -> u32 {
        1 << self.bits.saturating_sub(7)
    }

    /// The level with exactly this value, if there is one.
    #[inline]
    pub fn level_of(&self, value: f32) -> Option<u32> {
        self.grid.level_of(value)
    }

    /// The level of a value that is on the grid.
    #[inline]
    pub fn level_on_grid(&self, value: f32) -> u32 {
        self.grid.nearest(value)
    }

    /// The value of a level; 0 if there is no grid.
    #[inline]
    pub fn value_of(&self, level: u32) -> f32 {
        self.grid.values.get(level as usize).copied().unwrap_or_default()
    }

    /// How the values of a frame without a grid become integers, of 32 bits.
    pub fn rough(&self) -> RoughGrid {
        RoughGrid(self.rough.grid(ScalarType::F32))
    }

    /// Whether there is a grid at all.
    pub fn is_on_grid(&self) -> bool {
        self.grid.per_unit > 0
    }

    /// Whether some values are not on the grid.
    pub fn has_exceptions(&self) -> bool {
        self.exceptions
    }

    /// Bits of the highest level: 1 to 9.
    pub fn bits(&self) -> u32 {
        self.bits
    }
}
