//! Writing blocks of Lizard 1.x, with Lizard's own codewords and without Huffman coding: the reference
//! program's levels 20 to 29.

use super::block::{FAR_SHORTEST, FAR_TOKENS, LITERAL_FIELD, MATCH_FIELD, PART, STORED};
use crate::backend::lz::parser::{Format, Sequence, parse};

/// The level in the block, from which decoders learn which codewords it uses.
const LEVEL: u8 = 29;
/// 16-bit offsets are below the first of these, 24-bit offsets below the second.
const NEAR: usize = 1 << 16;
const FAR: usize = 1 << 24;
/// The shortest match with a new 16-bit offset.
const NEAR_SHORTEST: usize = 4;

/// Compresses a block; `depth` is the effort.
pub fn encode(input: &[u8], depth: usize) -> Vec<u8> {
    let mut out = vec![LEVEL];
    for start in (0..input.len()).step_by(PART) {
        let end = (start + PART).min(input.len());
        let part = encode_part(&input[..end], start, depth);
        if part.len() < end - start {
            out.extend(part);
        } else {
            out.push(STORED as u8);
            out.extend(&((end - start) as u32).to_le_bytes()[..3]);
            out.extend(&input[start..end]);
        }
    }
    out
}

/// The streams of a part.
#[derive(Default)]
struct Streams {
    tokens: Vec<u8>,
    literals: Vec<u8>,
    offsets_16: Vec<u8>,
    offsets_24: Vec<u8>,
}

fn encode_part(input: &[u8], start: usize, depth: usize) -> Vec<u8> {
    let mut streams = Streams::default();
    let (mut at, mut last) = (start, LizardFormat::FIRST_OFFSET);
    for sequence in parse(&LizardFormat, input, start, depth) {
        let after = at + sequence.literals;
        streams.put(&sequence, &input[at..after], sequence.offset == last);
        at = after + sequence.length;
        last = sequence.offset;
    }
    streams.literals.extend(&input[at..]);
    let mut out = vec![0];
    for stream in [&[][..], &streams.offsets_16, &streams.offsets_24, &streams.tokens, &streams.literals] {
        out.extend(&(stream.len() as u32).to_le_bytes()[..3]);
        out.extend(stream);
    }
    out
}

impl Streams {
    fn put(&mut self, sequence: &Sequence, literals: &[u8], repeats: bool) {
        let &Sequence { offset, length, .. } = sequence;
        if repeats || offset < NEAR {
            self.put_token(literals, length, repeats);
            if !repeats {
                self.offsets_16.extend(&offset.to_le_bytes()[..2]);
            }
            return;
        }
        if !literals.is_empty() {
            // A token with a 24-bit offset has no literals; these go before it, with an empty match.
            self.put_token(literals, 0, true);
        }
        let field = (length - FAR_SHORTEST).min(FAR_TOKENS - 1);
        self.tokens.push(field as u8);
        self.put_length(length - FAR_SHORTEST, FAR_TOKENS - 1);
        self.offsets_24.extend(&offset.to_le_bytes()[..3]);
    }

    fn put_token(&mut self, literals: &[u8], length: usize, repeats: bool) {
        let fields = length.min(MATCH_FIELD) << 3 | literals.len().min(LITERAL_FIELD);
        self.tokens.push((usize::from(repeats) << 7 | fields) as u8);
        self.put_length(literals.len(), LITERAL_FIELD);
        self.literals.extend(literals);
        self.put_length(length, MATCH_FIELD);
    }

    /// Stores the part of a length that does not fit into the token's field, among the literals.
    fn put_length(&mut self, length: usize, field: usize) {
        let Some(rest) = length.checked_sub(field) else { return };
        let bytes = (rest as u32).to_le_bytes();
        match rest {
            ..254 => self.literals.push(rest as u8),
            254..NEAR => {
                self.literals.push(254);
                self.literals.extend(&bytes[..2]);
            }
            _ => {
                self.literals.push(255);
                self.literals.extend(&bytes[..3]);
            }
        }
    }
}

struct LizardFormat;

impl Format for LizardFormat {
    const FIRST_OFFSET: usize = 0;
    // The reference program copies eight bytes at a time.
    const NEAREST: usize = 8;
    const LAST_MATCH: usize = 20;
    const LAST_LITERALS: usize = 16;

    fn match_bits(&self, literals: usize, offset: usize, length: usize, repeats: bool) -> Option<u32> {
        let bytes = match offset {
            _ if repeats => 1 + length_bytes(length, MATCH_FIELD),
            ..NEAR if length >= NEAR_SHORTEST => 3 + length_bytes(length, MATCH_FIELD),
            NEAR..FAR if length >= FAR_SHORTEST => {
                4 + usize::from(literals > 0) + length_bytes(length - FAR_SHORTEST, FAR_TOKENS - 1)
            }
            _ => return None,
        };
        Some(8 * bytes as u32)
    }

    fn run_bits(&self, literals: usize) -> u32 {
        if literals == LITERAL_FIELD {
            8
        } else if literals == LITERAL_FIELD + 254 || literals == LITERAL_FIELD + NEAR {
            16
        } else {
            0
        }
    }
}

/// Bytes that a length takes besides its field.
fn length_bytes(length: usize, field: usize) -> usize {
    match length.checked_sub(field) {
        None => 0,
        Some(..254) => 1,
        Some(..NEAR) => 3,
        Some(_) => 4,
    }
}
