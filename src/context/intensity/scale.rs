//! The grid of intensities: levels that are whole parts of 1.0.

/// How many levels make 1.0, in the files of known scanners: hundredths (KITTI), 256ths
/// (KITTI-360), 255ths, whole numbers (nuScenes, many PCD files).
const SCALES: [u32; 4] = [100, 256, 255, 1];
/// Bits of such a number.
const SCALE_BITS: u32 = 16;
/// Levels have at most this many bits.
pub const MOST_BITS: u32 = 9;

/// The grid on which the intensities of a frame lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntensityScale {
    /// Levels that make 1.0; 0 if the intensities lie on no known grid.
    per_unit: u32,
    /// Bits of the highest level.
    bits: u32,
    /// Whether some values of the frame lie off the grid.
    exceptions: bool,
}

impl IntensityScale {
    /// Finds the grid of a frame's intensities, which may be one of `expected` levels a unit.
    pub fn of(intensity: &[f32], expected: Option<u32>) -> Self {
        let off_grid = |per_unit: u32| intensity.iter().filter(|v| level_of(**v, per_unit).is_none()).count();
        let mut best = (usize::MAX, 0);
        for per_unit in expected.into_iter().filter(|&levels| levels < 1 << SCALE_BITS).chain(SCALES) {
            best = best.min((off_grid(per_unit), per_unit));
            if best.0 == 0 {
                break;
            }
        }
        let (misses, per_unit) = best;
        if misses * 20 > intensity.len() {
            return IntensityScale::default();
        }
        let highest = intensity.iter().filter_map(|v| level_of(*v, per_unit)).max().unwrap_or(0);
        let bits = (32 - highest.leading_zeros()).max(1);
        IntensityScale { per_unit, bits, exceptions: misses > 0 }
    }

    /// Codes the grid itself, by what codes plain numbers of so many bits.
    pub fn code(&mut self, mut code_plain: impl FnMut(u32, u32) -> u32) {
        self.per_unit = code_plain(self.per_unit, SCALE_BITS);
        self.bits = code_plain(self.bits, 4).clamp(1, MOST_BITS);
        self.exceptions = code_plain(u32::from(self.exceptions), 1) == 1;
    }

    /// The level of a value, cut to 1 to 128, as a context; 1 for values off the grid.
    pub fn context_level(&self, value: f32) -> u16 {
        self.context_of(self.level_of(value).unwrap_or(0))
    }

    /// A level, cut to 1 to 128, as a context.
    #[inline]
    pub fn context_of(&self, level: u32) -> u16 {
        (level >> self.bits.saturating_sub(7)).min(127) as u16 + 1
    }

    /// How many levels make a context level: 1, 2 or 4.
    #[inline]
    pub fn context_step(&self) -> u32 {
        1 << self.bits.saturating_sub(7)
    }

    /// The level of a value, if it is that of a level exactly.
    #[inline]
    pub fn level_of(&self, value: f32) -> Option<u32> {
        level_of(value, self.per_unit)
    }

    /// The value at a level.
    #[inline]
    pub fn value_of(&self, level: u32) -> f32 {
        value_of(level, self.per_unit)
    }

    /// Whether there is a grid at all.
    pub fn is_on_grid(&self) -> bool {
        self.per_unit > 0
    }

    /// Whether some values lie off the grid.
    pub fn has_exceptions(&self) -> bool {
        self.exceptions
    }

    /// Bits of the highest level: 1 to 9.
    pub fn bits(&self) -> u32 {
        self.bits
    }
}

/// The level of a value, if it is that of a level exactly.
fn level_of(value: f32, per_unit: u32) -> Option<u32> {
    let level = f64::from(value) * f64::from(per_unit) + 0.5;
    if !(level >= 0.0 && level < f64::from(1u32 << MOST_BITS)) || per_unit == 0 {
        return None;
    }
    let level = level as u32;
    (value_of(level, per_unit).to_bits() == value.to_bits()).then_some(level)
}

/// The value at a level.
fn value_of(level: u32, per_unit: u32) -> f32 {
    (f64::from(level) / f64::from(per_unit)) as f32
}
