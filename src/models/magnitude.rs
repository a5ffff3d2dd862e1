//! Magnitudes in logarithmic classes, as contexts of tokens. FORMAT.md 8.16, "Tokens of ranges".

/// The class of a magnitude: four classes an octave; the last class includes all higher magnitudes.
pub fn magnitude_level(magnitude: u32, levels: usize) -> usize {
    let magnitude = magnitude + 4;
    let octave = magnitude.ilog2();
    let level = ((octave - 2) << 2 | (magnitude >> (octave - 2) & 3)) as usize;
    level.min(levels - 1)
}

/// The least magnitude of a class.
pub fn magnitude_of_level(level: usize) -> u32 {
    ((4 + level as u32 % 4) << (level / 4)) - 4
}
