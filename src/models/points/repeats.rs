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
#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Repeat {
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
    /// Codes which points repeat an earlier one; a decoder need not pass more than their number.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, positions: &[[f32; 3]]) -> Vec<Option<Source>> {
        let mut finder = Finder::default();
        let mut sources: Vec<Option<Source>> = Vec::with_capacity(positions.len());
        let (mut last, mut distance, mut held) = (Repeat::No, 0, Source::Origin);
        for index in 0..positions.len() {
            if coder.is_exhausted() {
                break;
            }
            let repeat =
                if C::ENCODES { finder.find(positions, (distance, held), index) } else { Repeat::No };
            let kind = last.kind();
            // The distance is at most `index`, except in damaged streams.
            let at = |distance: usize| index.checked_sub(distance).filter(|_| distance > 0);
            let ends = at(distance).is_some_and(|source| sources[source].is_some());
            if !self.is_repeat[kind][usize::from(ends)].code(coder, repeat != Repeat::No) {
                last = Repeat::No;
                sources.push(None);
                continue;
            }
            let source = |distance| at(distance).map_or(Source::Origin, Source::Point);
            if self.is_at[kind].code(coder, matches!(repeat, Repeat::At(_))) {
                let own = if let Repeat::At(distance) = repeat { distance } else { 0 };
                distance = saturated(self.distances.code(coder, own as u64));
                last = Repeat::At(distance);
                held = source(distance);
                sources.push(Some(held));
            } else if self.is_held[kind].code(coder, repeat == Repeat::Held) {
                last = Repeat::Held;
                sources.push(Some(held));
            } else {
                last = Repeat::Next;
                sources.push(Some(source(distance)));
            }
        }
        sources.resize(positions.len(), None);
        sources
    }
}

/// Finds repeats for an encoder.
#[derive(Default)]
struct Finder {
    /// The last point with these bits.
    places: HashMap<[u32; 3], usize>,
}

impl Finder {
    /// How a point is coded.
    fn find(&mut self, positions: &[[f32; 3]], (distance, held): (usize, Source), index: usize) -> Repeat {
        /// A run that begins with a new distance has at least this many points; what fewer points have in common may
        /// be chance.
        const SHORTEST: usize = 4;
        let bits = |index: usize| positions.get(index).map(|position| position.map(f32::to_bits));
        let own = positions[index].map(f32::to_bits);
        let before = self.places.insert(own, index);
        let is_next = distance > 0 && index.checked_sub(distance).and_then(bits) == Some(own);
        let is_no_place = positions[index].iter().any(|value| !value.is_finite());
        let is_run = |before: usize| {
            (1..SHORTEST).all(|n| bits(index + n).is_some_and(|own| Some(own) == bits(before + n)))
        };
        match before {
            _ if is_next => Repeat::Next,
            _ if own == held.position(positions).map(f32::to_bits) => Repeat::Held,
            Some(before) if is_no_place || is_run(before) => Repeat::At(index - before),
            _ => Repeat::No,
        }
    }
}
