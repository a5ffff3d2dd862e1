//! Chooses the matches: the cheapest path through a block, by dynamic programming over the prices of literals
//! and matches.

use super::matches::{Match, MatchFinder, Search, common_length};

/// Literals, then a match.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sequence {
    /// Number of literals.
    pub literals: usize,
    /// Distance back to the beginning of the match.
    pub offset: usize,
    /// Length of the match in bytes.
    pub length: usize,
}

/// The prices and restrictions of a format.
pub trait Format {
    /// Bits of a match after `literals` literals, which are not counted; `repeats` if its offset equals that
    /// of the preceding match. `None` if there is no code for it.
    fn match_bits(&self, literals: usize, offset: usize, length: usize, repeats: bool) -> Option<u32>;

    /// Additional bits for the length of a run of literals when it grows to `literals`.
    fn run_bits(&self, literals: usize) -> u32;

    /// The offset that counts as the preceding match's at the start of a block; 0 if there is none.
    const FIRST_OFFSET: usize;
    /// The least distance of a match.
    const NEAREST: usize;
    /// The last match starts at least this many bytes before the end of a block ...
    const LAST_MATCH: usize;
    /// ... and ends at least this many bytes before it.
    const LAST_LITERALS: usize;
}

/// A match of this length is taken without a search for others inside it, so that runs of equal bytes take no
/// more time than other data.
const NICE_LENGTH: usize = 96;
/// Bits of a literal.
const LITERAL: u32 = 8;

/// The cheapest known path to a position.
#[derive(Clone, Copy)]
struct Step {
    bits: u32,
    /// Literals since the last match.
    literals: u32,
    /// The last match's offset.
    offset: u32,
    /// Length of the match that ends here; 0 for a literal.
    length: u32,
}

/// Parses `input` from `start` on, where a new block begins; earlier bytes can be matched. `depth` earlier
/// positions are tried for each position. The bytes after the last match are literals.
pub fn parse<F: Format>(format: &F, input: &[u8], start: usize, depth: usize) -> Vec<Sequence> {
    let mut finder = MatchFinder::new(input);
    let (count, limit) = (input.len() - start, input.len().saturating_sub(F::LAST_LITERALS));
    let unknown = Step { bits: u32::MAX, literals: 0, offset: 0, length: 0 };
    let mut steps = vec![unknown; count + 1];
    steps[0] = Step { bits: 0, offset: F::FIRST_OFFSET as u32, ..unknown };
    let mut found: Vec<Match> = Vec::new();
    let search = Search { depth, nearest: F::NEAREST, enough: NICE_LENGTH };
    let mut next = 0;
    for at in 0..count {
        if at < next {
            continue;
        }
        let (place, step) = (start + at, steps[at]);
        let literals = step.literals + 1;
        let bits = step.bits + LITERAL + format.run_bits(literals as usize);
        improve(&mut steps[at + 1], Step { bits, literals, offset: step.offset, length: 0 });
        if place + F::LAST_MATCH > input.len() {
            continue;
        }
        let mut relax = |offset: usize, shortest: usize, length: usize, repeats: bool| {
            let is_long = length >= NICE_LENGTH;
            let shortest = if is_long { length } else { shortest };
            for length in shortest..=length {
                if let Some(bits) = format.match_bits(step.literals as usize, offset, length, repeats) {
                    let reached = Step {
                        bits: step.bits + bits,
                        literals: 0,
                        offset: offset as u32,
                        length: length as u32,
                    };
                    improve(&mut steps[at + length], reached);
                    next = if is_long { at + length } else { next };
                }
            }
        };
        let last = step.offset as usize;
        let repeated = match (1..=place).contains(&last) {
            true => common_length(&input[..limit], place - last, place.min(limit)),
            false => 0,
        };
        relax(last, 1, repeated, true);
        found.clear();
        if repeated < NICE_LENGTH {
            finder.find(place, limit, &search, &mut found);
        }
        let mut shortest = 3;
        for Match { offset, length } in found.iter().copied() {
            relax(offset, shortest, length, offset == last);
            shortest = length + 1;
        }
    }
    trace(&steps)
}

fn improve(step: &mut Step, other: Step) {
    if other.bits < step.bits {
        *step = other;
    }
}

/// The sequences on the cheapest path to the end.
fn trace(steps: &[Step]) -> Vec<Sequence> {
    let mut sequences = Vec::new();
    let mut at = steps.len() - 1;
    while at > 0 {
        let step = steps[at];
        if step.length == 0 {
            at -= 1;
            continue;
        }
        at -= step.length as usize;
        sequences.push(Sequence {
            literals: steps[at].literals as usize,
            offset: step.offset as usize,
            length: step.length as usize,
        });
    }
    sequences.reverse();
    sequences
}
