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
