//! How the azimuth goes on while the lasers fire one after the other. FORMAT.md 3.3.

/// How the azimuth goes on inside a block: the firings that share one azimuth in the scanner's packets.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Timing {
    /// All slots of a firing have the same tick.
    #[default]
    Together,
    /// Velodyne's VLP-16, with two firings a block, in single precision: of the ticks to the next block, the part
    /// `(s * slot + f * firing) / block` has passed at slot `s` of firing `f`; rounded.
    Vlp16,
    /// Of the ticks to the next block, these parts have passed at each slot, in 2^-24, firing after firing; rounded
    /// down.
    Parts(Vec<u32>),
}

/// One in the unit of the parts of a block.
pub const WHOLE: u32 = 1 << 24;
/// Blocks that pass while the lasers of one fire, at most: the next one may begin before all have.
pub const MOST_BLOCKS: i64 = 2;

/// The ticks that have passed, if this part of so many has.
#[inline(always)]
pub fn passed_ticks(span: u32, part: u32) -> u32 {
    (u64::from(span) * u64::from(part) / u64::from(WHOLE)) as u32
}

/// From slot to slot, from firing to firing and from block to block of a VLP-16, in microseconds.
const VLP_16_TIMES: [f32; 3] = [2.304, 55.296, 110.592];

impl Timing {
    /// Whether ticks differ from slot to slot.
    pub fn is_interpolated(&self) -> bool {
        *self != Timing::Together
    }

    /// Firings of a block.
    pub fn firings(&self, rows: usize) -> u32 {
        match self {
            Timing::Together => 1,
            Timing::Vlp16 => 2,
            Timing::Parts(parts) => (parts.len() / rows.max(1)) as u32,
        }
    }

    /// The tick at a place in a block, counted slot by slot and firing by firing, that begins at the tick `base`, `span`
    /// ticks before the next one; not taken back to the first turn.
    #[inline(always)]
    pub fn tick(&self, passed: &Passed, place: usize, base: u32, span: u32) -> u32 {
        match self {
            Timing::Together => base,
            Timing::Vlp16 => {
                let [.., of_block] = VLP_16_TIMES;
                // Halves away from zero, as the driver's `round`; no tick is negative, so that `as` rounds down.
                (base as f32 + span as f32 * passed.times[place] / of_block + 0.5) as u32
            }
            Timing::Parts(parts) => base + passed_ticks(span, parts.get(place).copied().unwrap_or(0)),
        }
    }
}

/// How much of a block has passed at each slot of its firings, one after the other.
#[derive(Clone, Debug, Default)]
pub struct Passed {
    /// The part.
    pub parts: Vec<f64>,
    /// Microseconds, of a VLP-16.
    pub times: Vec<f32>,
}

impl Passed {
    /// By the timing of a scanner with so many lasers.
    pub fn new(timing: &Timing, rows: usize) -> Self {
        match timing {
            Timing::Together => Passed::default(),
            Timing::Vlp16 => {
                let [of_slot, of_firing, _] = VLP_16_TIMES;
                let places = || (0..2 * rows).map(|place| ((place % rows) as f32, (place / rows) as f32));
                let time = |(slot, firing)| slot * of_slot + firing * of_firing;
                let [of_slot, of_firing, of_block] = VLP_16_TIMES.map(f64::from);
                let part = |(slot, firing): (f32, f32)| {
                    (f64::from(slot) * of_slot + f64::from(firing) * of_firing) / of_block
                };
                Passed { parts: places().map(part).collect(), times: places().map(time).collect() }
            }
            Timing::Parts(parts) => {
                let parts = parts.iter().map(|&part| f64::from(part) / f64::from(WHOLE));
                Passed { parts: parts.collect(), times: Vec::new() }
            }
        }
    }
}

/// A column's place in its block and the ticks to the next block, as the range image keeps them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Ticks from this block to the next.
    pub ticks: u32,
    /// Which firing of the block this is.
    pub firing: u32,
}

impl Span {
    /// What a range image keeps.
    pub fn of(kept: u32) -> Self {
        Span { ticks: kept >> 1, firing: kept & 1 }
    }

    /// What it keeps of this one.
    pub fn kept(self) -> u32 {
        self.ticks << 1 | self.firing
    }
}
