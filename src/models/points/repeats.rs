//! Points that are the same as an earlier one, to the bit. FORMAT.md 8.4.

use std::collections::HashMap;

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::ground::varint::saturated;

/// The point that another one repeats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The point with this index.
    Point(usize),
    /// The position (0, 0, 0), before any other one was repeated.
    Origin,
}

impl Source {
    /// Its position.
    pub fn position(self, positions: &[[f32; 3]]) -> [f32; 3] {
        match self {
            Source::Point(index) => positions.get(index).copied().unwrap_or_default(),
            Source::Origin => [0.0; 3],
        }
    }
}

/// How a point is the same as an earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Repeat {
    /// It is not, or is coded as if it were not.
    #[default]
    No,
    /// The point at the last distance: in a run of second returns that are the same as the first ones.
    Next,
    /// That of the last `At`, at first the origin: the position of points without a return.
    Held,
    /// The point so many points before.
    At(usize),
}

impl Repeat {
    /// Its number as a context.
    fn kind(self) -> usize {
        match self {
            Repeat::No => 0,
            Repeat::Next => 1,
            Repeat::Held => 2,
            Repeat::At(_) => 3,
        }
    }
}

/// Number of kinds of repeats.
const REPEAT_KINDS: usize = 4;

/// What the coming repeats may refer to.
struct Sources {
    /// How far back the source of the last repeat but those held was.
    distance: usize,
    held: Source,
}

impl Default for Sources {
    fn default() -> Self {
        Sources { distance: 0, held: Source::Origin }
    }
}

impl Sources {
    /// The index of the point at the last distance; `None` if there is none, as at first or in damaged
    /// streams.
    fn next(&self, index: usize) -> Option<usize> {
        index.checked_sub(self.distance).filter(|_| self.distance > 0)
    }

    /// The source of a point, if it is a repeat.
    fn of(&mut self, index: usize, repeat: Repeat) -> Option<Source> {
        if let Repeat::At(distance) = repeat {
            self.distance = distance;
            self.held = self.next(index).map_or(Source::Origin, Source::Point);
        }
        match repeat {
            Repeat::No => None,
            Repeat::Next => Some(self.next(index).map_or(Source::Origin, Source::Point)),
            Repeat::Held | Repeat::At(_) => Some(self.held),
        }
    }
}

/// The adaptive models of repeats, by the kind of the point before.
#[derive(Clone, Default)]
pub struct RepeatModel {
    /// Also by whether the next point of a run is itself a repeat, which usually ends the run.
    is_repeat: [[AdaptiveBit; 2]; REPEAT_KINDS],
    is_at: [AdaptiveBit; REPEAT_KINDS],
    is_held: [AdaptiveBit; REPEAT_KINDS],
    distances: IntegerModel,
}

impl RepeatModel {
    /// Codes which of so many points repeat an earlier one; an encoder passes what [`find`] returns for them.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        points: usize,
        known: &[Repeat],
    ) -> Vec<Option<Source>> {
        let mut sources = Sources::default();
        let mut all: Vec<Option<Source>> = Vec::with_capacity(points);
        let mut last = Repeat::No;
        for index in 0..points {
            if coder.is_exhausted() {
                break;
            }
            let ends = sources.next(index).is_some_and(|next| all[next].is_some());
            let known = known.get(index).copied().unwrap_or_default();
            last = self.code_repeat(coder, (last.kind(), ends), known);
            all.push(sources.of(index, last));
        }
        all.resize(points, None);
        all
    }

    /// Codes how a point repeats an earlier one. The context is the kind of the point before, and whether the
    /// next point of a run is itself a repeat.
    fn code_repeat<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (kind, ends): (usize, bool),
        repeat: Repeat,
    ) -> Repeat {
        if !self.is_repeat[kind][usize::from(ends)].code(coder, repeat != Repeat::No) {
            Repeat::No
        } else if self.is_at[kind].code(coder, matches!(repeat, Repeat::At(_))) {
            let distance = if let Repeat::At(distance) = repeat { distance } else { 0 };
            Repeat::At(saturated(self.distances.code(coder, distance as u64)))
        } else if self.is_held[kind].code(coder, repeat == Repeat::Held) {
            Repeat::Held
        } else {
            Repeat::Next
        }
    }
}

/// For an encoder: how each point repeats an earlier one.
pub fn find(positions: &[[f32; 3]]) -> Vec<Repeat> {
    /// A run that begins with a new distance has at least this many points; what fewer points have in common
    /// may be chance.
    const SHORTEST: usize = 4;
    let bits = |index: usize| positions.get(index).map(|position| position.map(f32::to_bits));
    let is_run = |before: usize, index: usize| {
        (1..SHORTEST).all(|n| bits(index + n).is_some_and(|own| Some(own) == bits(before + n)))
    };
    let mut sources = Sources::default();
    // The last point with these bits.
    let mut places: HashMap<[u32; 3], usize> = HashMap::with_capacity(positions.len());
    let mut repeats = Vec::with_capacity(positions.len());
    for (index, position) in positions.iter().enumerate() {
        let own = position.map(f32::to_bits);
        let is_no_place = position.iter().any(|value| !value.is_finite());
        let repeat = match places.insert(own, index) {
            _ if sources.next(index).and_then(bits) == Some(own) => Repeat::Next,
            _ if own == sources.held.position(positions).map(f32::to_bits) => Repeat::Held,
            Some(before) if is_no_place || is_run(before, index) => Repeat::At(index - before),
            _ => Repeat::No,
        };
        sources.of(index, repeat);
        repeats.push(repeat);
    }
    repeats
}
