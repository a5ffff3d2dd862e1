//! Numbers quantised to a few classes, to serve as contexts. FORMAT.md 7.2, 7.3, and 8.16, "Tokens of
//! ranges".

/// The sign and half-octave of a difference: 0 to 31, with 16 for a difference of 0.
#[inline]
pub fn signed_level(difference: i32) -> usize {
    let level = LEVELS.get(difference.unsigned_abs() as usize).map_or(15, |&level| usize::from(level));
    if difference < 0 { 16 - level } else { 16 + level }
}

/// The half-octave of each magnitude below the last class.
static LEVELS: [u8; 128] = {
    let mut levels = [0; 128];
    let mut magnitude = 0;
    while magnitude < levels.len() {
        levels[magnitude] = half_octave(magnitude as u32) as u8;
        magnitude += 1;
    }
    levels
};

/// 0 for 0, then two classes an octave.
const fn half_octave(magnitude: u32) -> u32 {
    match magnitude {
        0 => 0,
        m => {
            let octave = m.ilog2();
            // The upper half begins at sqrt(2) times the power of two.
            let upper = m as u64 * m as u64 >= 1 << (2 * octave + 1);
            2 * octave + 1 + upper as u32
        }
    }
}

/// Counts the thresholds that a value reaches; they start at `first` and grow by `factor`.
#[derive(Clone, Debug)]
pub struct Thresholds<const N: usize>([f32; N]);

impl<const N: usize> Thresholds<N> {
    /// Creates `N` thresholds, so `N + 1` classes.
    pub fn new(first: f32, factor: f32) -> Self {
        let mut thresholds = [first; N];
        (1..N).for_each(|i| thresholds[i] = thresholds[i - 1] * factor);
        Thresholds(thresholds)
    }

    /// The class of a value: 0 to `N`.
    #[inline]
    pub fn of(&self, value: f32) -> usize {
        self.0.iter().map(|&threshold| usize::from(value >= threshold)).sum()
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_rise_with_the_magnitude() {
        assert_eq!([0, 1, 2, 3, 4, 6, 8].map(half_octave), [0, 1, 3, 4, 5, 6, 7]);
        assert!((1..5000u32).all(|m| half_octave(m + 1) >= half_octave(m)));
        assert_eq!([-1, 0, 1, i32::MIN, i32::MAX].map(signed_level), [15, 16, 17, 1, 31]);
        assert_eq!([0.5, 1.0, 1.9, 2.0, 99.0].map(|v| Thresholds::<3>::new(1.0, 2.0).of(v)), [0, 1, 1, 2, 3]);
    }
}
