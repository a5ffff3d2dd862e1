//! LZ5 1.5: LZ77 without entropy coding, with short codes for near matches ("LZ5 v1.x Block Format
//! Description" and "LZ5 Frame Format Description" by P. Skibinski and Y. Collet). The payload is a frame
//! that the reference program decodes.

use super::lz::{self, Format, FrameFormat, copy_literals, copy_match, parse, take, take_number};
use super::{Backend, Level};
use crate::ground::error::Result;

/// At levels 1 to 9, 1 to 1024 earlier positions are tried for each byte.
pub struct Lz5;

const FORMAT: FrameFormat = FrameFormat {
    magic: 0x184d_2205,
    block_sizes: [64 << 10, 256 << 10, 1 << 20, 4 << 20, 16 << 20, 64 << 20, 256 << 20],
};
const DEPTH: [usize; 9] = [1, 2, 4, 8, 16, 32, 64, 256, 1024];

impl Backend for Lz5 {
    fn id(&self) -> u8 {
        7
    }

    fn name(&self) -> &'static str {
        "lz5"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        Ok(lz::encode_frame(input, &FORMAT, |bytes| encode_block(bytes, level.of(DEPTH))))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        lz::decode_frame(input, &FORMAT, length, decode_block)
    }
}

/// Matches are at least this long; lengths in tokens are relative to it.
const SHORTEST: usize = 3;
/// The largest value of the token's field for the match length, which means that more follows.
const MATCH_FIELD: usize = 7;
/// Upper limits of the offsets.
const NEAR: usize = 1 << 10;
const MIDDLE: usize = 1 << 16;
const FAR: usize = 1 << 22;

/// The kinds of tokens.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Near,
    Middle,
    Far,
    Repeated,
}

impl Kind {
    fn of_match(offset: usize, repeats: bool) -> Self {
        match offset {
            _ if repeats => Kind::Repeated,
            ..NEAR => Kind::Near,
            NEAR..MIDDLE => Kind::Middle,
            _ => Kind::Far,
        }
    }

    fn of_token(token: usize) -> Self {
        match token >> 5 {
            0 | 1 => Kind::Middle,
            2 => Kind::Far,
            3 => Kind::Repeated,
            _ => Kind::Near,
        }
    }

    /// The largest number of literals that the token itself can express.
    fn literal_field(self) -> usize {
        if self == Kind::Middle { 7 } else { 3 }
    }

    /// Bytes of the offset.
    fn offset_bytes(self) -> usize {
        match self {
            Kind::Repeated => 0,
            Kind::Near => 1,
            Kind::Middle => 2,
            Kind::Far => 3,
        }
    }

    /// The token without its lengths.
    fn token(self, offset: usize) -> usize {
        match self {
            Kind::Middle => 0,
            Kind::Far => 2 << 5,
            Kind::Repeated => 3 << 5,
            Kind::Near => 1 << 7 | (offset >> 8) << 5,
        }
    }
}

/// Appends the contents of a block, up to `most` bytes in all.
///
/// # Errors
/// If the block is damaged.
fn decode_block(mut block: &[u8], out: &mut Vec<u8>, most: usize) -> Result<()> {
    let input = &mut block;
    let mut offset = 1;
    loop {
        let token = take_number(input, 1)?;
        let kind = Kind::of_token(token);
        let field = kind.literal_field();
        let literals = take_length(input, token >> 3 & field, field)?;
        copy_literals(out, take(input, literals)?, most)?;
        if input.is_empty() {
            return Ok(());
        }
        offset = match kind {
            Kind::Repeated => offset,
            Kind::Near => take_number(input, 1)? | (token >> 5 & 3) << 8,
            _ => take_number(input, kind.offset_bytes())?,
        };
        let length = take_length(input, token & MATCH_FIELD, MATCH_FIELD)?;
        copy_match(out, offset, length.saturating_add(SHORTEST), most)?;
    }
}

/// A length, with its extension if the token's field is at its maximum.
fn take_length(input: &mut &[u8], field: usize, most: usize) -> Result<usize> {
    let mut length = field;
    if field == most {
        loop {
            let more = take_number(input, 1)?;
            length = length.saturating_add(more);
            if more < 255 {
                break;
            }
        }
    }
    Ok(length)
}

/// Compresses a block; `depth` is the effort.
fn encode_block(input: &[u8], depth: usize) -> Vec<u8> {
    let mut out = Vec::new();
    let (mut at, mut last) = (0, Lz5Format::FIRST_OFFSET);
    for sequence in parse(&Lz5Format, input, 0, depth) {
        let kind = Kind::of_match(sequence.offset, sequence.offset == last);
        let (field, length) = (kind.literal_field(), sequence.length - SHORTEST);
        let lengths = sequence.literals.min(field) << 3 | length.min(MATCH_FIELD);
        out.push((kind.token(sequence.offset) | lengths) as u8);
        put_length(&mut out, sequence.literals, field);
        out.extend(&input[at..at + sequence.literals]);
        out.extend(&sequence.offset.to_le_bytes()[..kind.offset_bytes()]);
        put_length(&mut out, length, MATCH_FIELD);
        at += sequence.literals + sequence.length;
        last = sequence.offset;
    }
    let (literals, field) = (&input[at..], Kind::Middle.literal_field());
    out.push((literals.len().min(field) << 3) as u8);
    put_length(&mut out, literals.len(), field);
    out.extend(literals);
    out
}

fn put_length(out: &mut Vec<u8>, length: usize, field: usize) {
    if let Some(mut rest) = length.checked_sub(field) {
        while rest >= 255 {
            out.push(255);
            rest -= 255;
        }
        out.push(rest as u8);
    }
}

struct Lz5Format;

impl Format for Lz5Format {
    const FIRST_OFFSET: usize = 1;
    const NEAREST: usize = 1;
    const LAST_MATCH: usize = 12;
    const LAST_LITERALS: usize = 5;

    fn match_bits(&self, literals: usize, offset: usize, length: usize, repeats: bool) -> Option<u32> {
        if length < SHORTEST || offset >= FAR {
            return None;
        }
        let kind = Kind::of_match(offset, repeats);
        let field = kind.literal_field();
        let more = |length: usize, field: usize| length.checked_sub(field).map_or(0, |rest| 1 + rest / 255);
        // Up to 7 literals cost as little as with the widest field; the extra cost of narrower fields is
        // added here.
        let narrow = usize::from(field < 7 && (field..7).contains(&literals));
        let bytes = 1 + kind.offset_bytes() + more(length - SHORTEST, MATCH_FIELD) + narrow;
        Some(8 * bytes as u32)
    }

    fn run_bits(&self, literals: usize) -> u32 {
        if literals == 7 || (literals > 7 && (literals - 7).is_multiple_of(255)) { 8 } else { 0 }
    }
}
