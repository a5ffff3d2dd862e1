//! How the azimuth advances while the lasers fire one after another. FORMAT.md 3.3.

/// How the azimuth advances within a block: the firings that share one azimuth in the scanner's packets.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Timing {
    /// All slots of a firing have the same tick.
    #[default]
    Together,
    /// Velodyne's VLP-16, with two firings per block, in single precision: at slot `s` of firing `f`, the
    /// part `(s * slot + f * firing) / block` of the ticks to the next block has passed; rounded.
    Vlp16,
    /// The part of the ticks to the next block that has passed at each slot, in 2^-24, firing after firing;
    /// rounded down.
    Parts(Vec<u32>),
}

/// One whole block, in the unit of its parts.
pub const WHOLE: u32 = 1 << 24;
/// Largest number of blocks that pass while the lasers of one fire: the next one may begin before all have.
pub const MOST_BLOCKS: i64 = 2;

/// The ticks that have passed after `part` of a block of `span` ticks.
#[inline(always)]
pub fn passed_ticks(span: u32, part: u32) -> u32 {
    (u64::from(span) * u64::from(part) / u64::from(WHOLE)) as u32
}

/// Time from slot to slot, from firing to firing and from block to block of a VLP-16, in microseconds.
const VLP_16_TIMES: [f32; 3] = [2.304, 55.296, 110.592];

/// When the lasers of RoboSense's scanners fire, unless they do so evenly, in microseconds since a block began.
const RS_32: [f32; 32] = [
    0.0, 2.88, 5.76, 8.64, 11.52, 14.4, 17.28, 20.16, 23.04, 25.92, 28.8, 31.68, 34.56, 37.44, 40.32, 44.64,
    1.44, 4.32, 7.2, 10.08, 12.96, 15.84, 18.72, 21.6, 24.48, 27.36, 30.24, 33.12, 36.0, 38.88, 41.76, 46.08,
];
const BPEARL_EARLY: [f32; 32] = [
    0.0, 2.56, 5.12, 7.68, 10.24, 12.8, 15.36, 17.92, 25.68, 28.24, 30.8, 33.36, 35.92, 38.48, 41.04, 43.6,
    1.28, 3.84, 6.4, 8.96, 11.52, 14.08, 16.64, 19.2, 26.96, 29.52, 32.08, 34.64, 37.2, 39.76, 42.32, 44.88,
];
const HELIOS_EARLY: [f32; 32] = [
    0.0, 1.57, 3.15, 4.72, 6.3, 7.87, 9.45, 11.36, 13.26, 15.17, 17.08, 18.99, 20.56, 22.14, 23.71, 25.29,
    26.53, 29.01, 27.77, 30.25, 31.49, 33.98, 32.73, 35.22, 36.46, 37.7, 38.94, 40.18, 41.42, 42.67, 43.91,
    45.15,
];
const HELIOS_16P_EARLY: [f32; 32] = [
    0.0, 3.15, 6.3, 9.45, 13.26, 17.08, 20.56, 23.71, 26.53, 27.77, 31.49, 32.73, 36.46, 38.94, 41.42, 43.91,
    55.56, 58.7, 61.85, 65.0, 68.82, 72.64, 76.12, 79.27, 82.08, 83.32, 87.05, 88.29, 92.01, 94.5, 96.98,
    99.46,
];

impl Timing {
    /// Whether ticks differ from slot to slot.
    pub fn is_interpolated(&self) -> bool {
        !matches!(self, Timing::Together)
    }

    /// Number of firings per block.
    pub fn firings(&self, rows: usize) -> u32 {
        match self {
            Timing::Together => 1,
            Timing::Vlp16 => 2,
            Timing::Parts(parts) => (parts.len() / rows.max(1)) as u32,
        }
    }

    /// The timings of RoboSense's scanners with so many lasers, as versions of the manufacturer's rs_driver
    /// have them.
    pub fn of_robosense(rows: usize) -> Vec<Self> {
        // Rounded up: the driver's products in single precision may be the next whole number.
        let part = |time: &f32, block: f32| (f64::from(time / block) * f64::from(WHOLE)).ceil() as u32;
        let parts =
            |times: &[f32], block: f32| Timing::Parts(times.iter().map(|time| part(time, block)).collect());
        let times = robosense_times(rows);
        // A block of a packet has both firings of 16 lasers, or with dual returns one.
        let dual = times.iter().filter(|_| rows == 16).map(|(times, block)| parts(&times[..16], 0.5 * block));
        times.iter().map(|(times, block)| parts(times, *block)).chain(dual).collect()
    }

    /// The tick at a place in a block, counted slot by slot and firing by firing. The block begins at the
    /// tick `base`, `span` ticks before the next one. The result is not reduced to the first turn.
    #[inline(always)]
    pub fn tick(&self, passed: &BlockTimes, place: usize, base: u32, span: u32) -> u32 {
        match self {
            Timing::Together => base,
            Timing::Vlp16 => {
                let [.., of_block] = VLP_16_TIMES;
                // Rounds halves away from zero, as the driver's `round` does: no tick is negative, so `as`
                // rounds down.
                (base as f32 + span as f32 * passed.times[place] / of_block + 0.5) as u32
            }
            Timing::Parts(parts) => base + passed_ticks(span, parts.get(place).copied().unwrap_or(0)),
        }
    }
}

/// When the lasers of RoboSense's scanners with so many of them fire, and how long a block takes, in
/// microseconds.
fn robosense_times(rows: usize) -> Vec<([f32; 32], f32)> {
    let even = |step: f64| std::array::from_fn(|slot| (slot as f64 * step) as f32);
    let rs_16 = |slot: usize| ((slot % 16) as f64 * 2.8 + (slot / 16) as f64 * 55.5) as f32;
    match rows {
        16 => vec![(std::array::from_fn(rs_16), 111.0), (even(1.73), 111.12), (HELIOS_16P_EARLY, 111.12)],
        32 => vec![
            (even(1.73), 55.56),
            (HELIOS_EARLY, 55.56),
            (BPEARL_EARLY, 55.52),
            (even(1.668), 55.56),
            (RS_32, 55.52),
        ],
        _ => Vec::new(),
    }
}

/// How much of a block has passed at each slot of its firings, firing by firing.
#[derive(Clone, Debug, Default)]
pub struct BlockTimes {
    /// As a fraction of the block.
    pub parts: Vec<f64>,
    /// In microseconds; only for a VLP-16.
    pub times: Vec<f32>,
}

impl BlockTimes {
    /// For a scanner with this timing and `rows` lasers.
    pub fn new(timing: &Timing, rows: usize) -> Self {
        match timing {
            Timing::Together => BlockTimes::default(),
            Timing::Vlp16 => {
                let [of_slot, of_firing, _] = VLP_16_TIMES;
                let places = || (0..2 * rows).map(|place| ((place % rows) as f32, (place / rows) as f32));
                let time = |(slot, firing)| slot * of_slot + firing * of_firing;
                let [of_slot, of_firing, of_block] = VLP_16_TIMES.map(f64::from);
                let part = |(slot, firing): (f32, f32)| {
                    (f64::from(slot) * of_slot + f64::from(firing) * of_firing) / of_block
                };
                BlockTimes { parts: places().map(part).collect(), times: places().map(time).collect() }
            }
            Timing::Parts(parts) => {
                let parts = parts.iter().map(|&part| f64::from(part) / f64::from(WHOLE));
                BlockTimes { parts: parts.collect(), times: Vec::new() }
            }
        }
    }
}

/// A column's position in its block and the ticks to the next block, as stored in the range image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Ticks from this block to the next.
    pub ticks: u32,
    /// The number of this firing in the block.
    pub firing: u32,
}

impl Span {
    /// Unpacks a value of the range image.
    pub fn unpacked(packed: u32) -> Self {
        Span { ticks: packed >> 1, firing: packed & 1 }
    }

    /// Packs it into a value of the range image.
    pub fn packed(self) -> u32 {
        self.ticks << 1 | self.firing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// rs_driver multiplies in single precision, and rounds down.
    #[test]
    fn robosenses_ticks_are_those_of_the_driver() {
        /// Ticks from block to block are fewer.
        const MOST: u32 = 200;
        for rows in [16, 32] {
            let timings = Timing::of_robosense(rows);
            for ((times, block), timing) in robosense_times(rows).iter().zip(&timings) {
                assert_eq!(timing.firings(rows), 32 / rows as u32);
                for (slot, time) in times.iter().enumerate() {
                    let driver = |span: u32| (span as f32 * (time / block)) as u32;
                    let own = |span: u32| timing.tick(&BlockTimes::default(), slot, 0, span);
                    (0..MOST).for_each(|span| assert_eq!(own(span), driver(span), "{slot} {span}"));
                }
            }
        }
        assert_eq!(Timing::of_robosense(16).len(), 6);
        assert!(Timing::of_robosense(128).is_empty());
    }
}
