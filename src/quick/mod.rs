//! Quick coding: each part of a frame as tokens with static tables, each part one function that serves both
//! directions. The parts are those of [`context`](crate::context), which is smaller and slower.

mod correction;
mod intensity;
mod occupancy;
mod packed;
mod range;

pub use correction::{CORRECTION_CONTEXTS, correct_positions};
pub use intensity::{INTENSITY_CONTEXTS, IntensityTokens};
pub use occupancy::{OCCUPANCY_CONTEXTS, code_occupancy};
pub use packed::{
    PACKED_INTENSITY_CONTEXTS, PACKED_RANGE_CONTEXTS, code_packed_intensities, code_packed_ranges,
};
pub use range::{RANGE_CONTEXTS, RangeTokens, start_counts};

/// Levels of a magnitude, four an octave, of which the last stands for all that are higher.
fn magnitude_level(magnitude: u32, levels: usize) -> usize {
    let magnitude = magnitude + 4;
    let octave = magnitude.ilog2();
    let level = ((octave - 2) << 2 | (magnitude >> (octave - 2) & 3)) as usize;
    level.min(levels - 1)
}

/// The least magnitude of a level.
fn magnitude_of_level(level: usize) -> u32 {
    ((4 + level as u32 % 4) << (level / 4)) - 4
}

#[cfg(test)]
mod tests;
