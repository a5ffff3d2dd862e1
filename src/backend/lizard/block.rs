//! Reading blocks of Lizard 1.x: a byte that gives the level, then parts of up to 128 KB, each with five
//! streams. The level determines the codewords of the tokens: LZ4's or Lizard's own.

use super::huffman;
use crate::backend::lz::{copy_literals, copy_match, take, take_number};
use crate::ground::error::{Error, Result};

/// Input bytes of a part.
pub const PART: usize = 128 << 10;
/// The header of a part that is not compressed.
pub const STORED: usize = 128;
/// Flags of the header: the streams that are Huffman-coded.
const LITERALS: usize = 1;
const TOKENS: usize = 2;
const OFFSETS_16: usize = 4;
const OFFSETS_24: usize = 8;
const KNOWN: usize = LITERALS | TOKENS | OFFSETS_16 | OFFSETS_24;
/// The reference program's levels; of each 20, the first 10 have LZ4's codewords.
const LEVELS: std::ops::RangeInclusive<usize> = 10..=49;

/// Lizard's codewords: the fields of a token for lengths, and their offsets.
pub const LITERAL_FIELD: usize = 7;
pub const MATCH_FIELD: usize = 15;
/// Tokens below this have a 24-bit offset and no literals; the last of them means that more of the length
/// follows.
pub const FAR_TOKENS: usize = 32;
/// The shortest match with a 24-bit offset.
pub const FAR_SHORTEST: usize = 16;
/// LZ4's codewords: both fields, and the shortest match.
const LZ4_FIELD: usize = 15;
const LZ4_SHORTEST: usize = 4;

/// The streams of a part. Lengths that do not fit into tokens are stored among the literals.
struct Streams<'a> {
    tokens: &'a [u8],
    literals: &'a [u8],
    offsets_16: &'a [u8],
    offsets_24: &'a [u8],
}

/// Appends the contents of a block, up to `most` bytes in all.
///
/// # Errors
/// If the block is damaged.
pub fn decode(mut block: &[u8], out: &mut Vec<u8>, most: usize) -> Result<()> {
    let input = &mut block;
    let level = take_number(input, 1)?;
    if !LEVELS.contains(&level) {
        return Err(Error::unsupported(format!("unknown level {level}")));
    }
    let lz4 = (level - 10) % 20 < 10;
    while !input.is_empty() {
        let header = take_number(input, 1)?;
        if header == STORED {
            let length = take_number(input, 3)?;
            copy_literals(out, take(input, length)?, most)?;
            continue;
        }
        if header & !KNOWN != 0 {
            return Err(Error::corrupt("unknown flags of a part"));
        }
        let _lengths = take_stream(input, false)?;
        let offsets_16 = take_stream(input, header & OFFSETS_16 != 0)?;
        let offsets_24 = take_stream(input, header & OFFSETS_24 != 0)?;
        let tokens = take_stream(input, header & TOKENS != 0)?;
        let literals = take_stream(input, header & LITERALS != 0)?;
        let streams = Streams {
            tokens: &tokens,
            literals: &literals,
            offsets_16: &offsets_16,
            offsets_24: &offsets_24,
        };
        if lz4 { decode_lz4(streams, out, most)? } else { decode_lizard(streams, out, most)? }
    }
    Ok(())
}

/// A stream, decoded if it is Huffman-coded.
fn take_stream(input: &mut &[u8], is_coded: bool) -> Result<Vec<u8>> {
    let length = take_number(input, 3)?;
    if !is_coded {
        return Ok(take(input, length)?.to_vec());
    }
    if length > PART {
        return Err(Error::corrupt("a stream longer than its part"));
    }
    let coded = take_number(input, 3)?;
    huffman::decode(take(input, coded)?, length)
}

fn decode_lz4(mut streams: Streams, out: &mut Vec<u8>, most: usize) -> Result<()> {
    for &token in streams.tokens {
        let token = usize::from(token);
        let literals = streams.take_length(token & LZ4_FIELD, LZ4_FIELD)?;
        copy_literals(out, take(&mut streams.literals, literals)?, most)?;
        let offset = take_number(&mut streams.literals, 2)?;
        let length = streams.take_length(token >> 4, LZ4_FIELD)? + LZ4_SHORTEST;
        copy_match(out, offset, length, most)?;
    }
    copy_literals(out, streams.literals, most)
}

fn decode_lizard(mut streams: Streams, out: &mut Vec<u8>, most: usize) -> Result<()> {
    let mut offset = 0;
    for &token in streams.tokens {
        let token = usize::from(token);
        let length;
        if token >= FAR_TOKENS {
            let literals = streams.take_length(token & LITERAL_FIELD, LITERAL_FIELD)?;
            copy_literals(out, take(&mut streams.literals, literals)?, most)?;
            if token >> 7 == 0 {
                offset = take_number(&mut streams.offsets_16, 2)?;
            }
            length = streams.take_length(token >> 3 & MATCH_FIELD, MATCH_FIELD)?;
        } else {
            length = streams.take_length(token, FAR_TOKENS - 1)? + FAR_SHORTEST;
            offset = take_number(&mut streams.offsets_24, 3)?;
        }
        if length > 0 {
            copy_match(out, offset, length, most)?;
        }
    }
    copy_literals(out, streams.literals, most)
}

impl Streams<'_> {
    /// A length, with its extension if the token's field is at its maximum: a byte, or 254 and two bytes, or
    /// 255 and three.
    fn take_length(&mut self, field: usize, most: usize) -> Result<usize> {
        if field < most {
            return Ok(field);
        }
        let more = match take_number(&mut self.literals, 1)? {
            254 => take_number(&mut self.literals, 2)?,
            255 => take_number(&mut self.literals, 3)?,
            more => more,
        };
        Ok(field + more)
    }
}
