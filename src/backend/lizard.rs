//! Lizard 1.x: LZ77 in separate streams of tokens, offsets and literals, each of which may be Huffman-coded
//! ("Lizard v1.x Block Format Description" and "Lizard Frame Format Description" by P. Skibinski and Y.
//! Collet). The payload is a frame that the reference program decodes. Written with Lizard's own codewords
//! and without Huffman coding (the reference's levels 20 to 29); read with and without it.
//!
//! A block is a byte that gives the level, then parts of up to 128 KB, each with five streams. The level
//! determines the codewords of the tokens: LZ4's or Lizard's own. Streams are coded by Huff0, a Huffman coder
//! (described in RFC 8878, 4.2, except for its short streams), whose weights are coded by FSE, the
//! table-based asymmetric numeral system (4.1 and 4.2.1.2). Both read bits from the end of a stream to its
//! beginning: the highest set bit of the last byte marks the end.

use super::lz::{self, Format, FrameFormat, Sequence, copy_literals, copy_match, parse, take, take_number};
use super::{Backend, Level};
use crate::ground::error::{Error, Result};

/// At levels 1 to 9, 1 to 1024 earlier positions are tried for each byte.
pub struct Lizard;

const FORMAT: FrameFormat = FrameFormat {
    magic: 0x184d_2206,
    block_sizes: [128 << 10, 256 << 10, 1 << 20, 4 << 20, 16 << 20, 64 << 20, 256 << 20],
};
const DEPTH: [usize; 9] = [1, 2, 4, 8, 16, 32, 64, 256, 1024];

impl Backend for Lizard {
    fn id(&self) -> u8 {
        8
    }

    fn name(&self) -> &'static str {
        "lizard"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        Ok(lz::encode_frame(input, &FORMAT, |bytes| encode_block(bytes, level.of(DEPTH))))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        lz::decode_frame(input, &FORMAT, length, decode_block)
    }
}

/// Input bytes of a part.
const PART: usize = 128 << 10;
/// The header of a part that is not compressed.
const STORED: usize = 128;
/// Flags of the header: the streams that are Huffman-coded.
const LITERALS: usize = 1;
const TOKENS: usize = 2;
const OFFSETS_16: usize = 4;
const OFFSETS_24: usize = 8;
const KNOWN: usize = LITERALS | TOKENS | OFFSETS_16 | OFFSETS_24;
/// The reference program's levels; of each 20, the first 10 have LZ4's codewords.
const LEVELS: std::ops::RangeInclusive<usize> = 10..=49;

/// Lizard's codewords: the fields of a token for lengths, and their offsets.
const LITERAL_FIELD: usize = 7;
const MATCH_FIELD: usize = 15;
/// Tokens below this have a 24-bit offset and no literals; the last of them means that more of the length
/// follows.
const FAR_TOKENS: usize = 32;
/// The shortest match with a 24-bit offset.
const FAR_SHORTEST: usize = 16;
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
fn decode_block(mut block: &[u8], out: &mut Vec<u8>, most: usize) -> Result<()> {
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
    decode_huffman(take(input, coded)?, length)
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

/// The level in the block, from which decoders learn which codewords it uses.
const LEVEL: u8 = 29;
/// 16-bit offsets are below the first of these, 24-bit offsets below the second.
const NEAR: usize = 1 << 16;
const FAR: usize = 1 << 24;
/// The shortest match with a new 16-bit offset.
const NEAR_SHORTEST: usize = 4;

/// Compresses a block; `depth` is the effort.
fn encode_block(input: &[u8], depth: usize) -> Vec<u8> {
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
struct WrittenStreams {
    tokens: Vec<u8>,
    literals: Vec<u8>,
    offsets_16: Vec<u8>,
    offsets_24: Vec<u8>,
}

fn encode_part(input: &[u8], start: usize, depth: usize) -> Vec<u8> {
    let mut streams = WrittenStreams::default();
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

impl WrittenStreams {
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

/// Codes are at most this long, in bits.
const LONGEST: usize = 12;
/// Headers from this value on store the weights uncompressed, four bits each.
const PLAIN_WEIGHTS: usize = 128;
/// The most symbols; all but one of them have a weight in the header.
const SYMBOLS: usize = 256;

/// Decodes a stream of `length` bytes.
///
/// # Errors
/// If it is damaged.
fn decode_huffman(coded: &[u8], length: usize) -> Result<Vec<u8>> {
    match coded {
        _ if length == 0 || coded.len() > length => Err(Error::corrupt("a stream of a wrong length")),
        _ if coded.len() == length => Ok(coded.to_vec()),
        [byte] => Ok(vec![*byte; length]),
        _ => {
            let mut input = coded;
            let table = Table::read_from(&mut input)?;
            decode_four(input, length, &table)
        }
    }
}

/// Four streams, each of a quarter of the bytes.
fn decode_four(mut input: &[u8], length: usize, table: &Table) -> Result<Vec<u8>> {
    let input = &mut input;
    let lengths = [take_number(input, 2)?, take_number(input, 2)?, take_number(input, 2)?];
    let quarter = length.div_ceil(4);
    let mut out = Vec::with_capacity(length);
    for coded in lengths {
        let count = quarter.min(length - out.len());
        table.decode(take(input, coded)?, count, &mut out)?;
    }
    let count = length - out.len();
    table.decode(input, count, &mut out)?;
    Ok(out)
}

/// The symbol for each prefix of the bits.
struct Table {
    bits: usize,
    /// For each value of the next bits: the symbol, and the number of bits that it takes.
    entries: Vec<(u8, u8)>,
}

impl Table {
    fn read_from(input: &mut &[u8]) -> Result<Self> {
        let header = take_number(input, 1)?;
        let weights = if header >= PLAIN_WEIGHTS {
            let count = header + 1 - PLAIN_WEIGHTS;
            let pairs = take(input, count.div_ceil(2))?;
            pairs.iter().flat_map(|pair| [pair >> 4, pair & 15]).take(count).collect()
        } else {
            decode_weights(take(input, header)?, SYMBOLS - 1)?
        };
        Table::of(weights)
    }

    /// The table for these weights; the weight of the last symbol follows from the others.
    fn of(mut weights: Vec<u8>) -> Result<Self> {
        let wrong = || Error::corrupt("weights that make no code");
        if weights.iter().any(|weight| usize::from(*weight) > LONGEST) {
            return Err(wrong());
        }
        let total: usize = weights.iter().map(|&weight| 1 << weight >> 1).sum();
        if total == 0 {
            return Err(wrong());
        }
        let bits = total.ilog2() as usize + 1;
        let rest = (1 << bits) - total;
        if bits > LONGEST || !rest.is_power_of_two() {
            return Err(wrong());
        }
        weights.push(rest.ilog2() as u8 + 1);
        let mut entries = Vec::with_capacity(1 << bits);
        for weight in 1..=bits as u8 {
            for (symbol, _) in (0..=255u8).zip(&weights).filter(|(_, other)| **other == weight) {
                let entry = (symbol, bits as u8 + 1 - weight);
                entries.extend(std::iter::repeat_n(entry, 1 << (weight - 1)));
            }
        }
        if entries.len() == 1 << bits { Ok(Table { bits, entries }) } else { Err(wrong()) }
    }

    /// Appends `count` symbols, which must use up all bits.
    fn decode(&self, coded: &[u8], count: usize, out: &mut Vec<u8>) -> Result<()> {
        let mut bits = BackwardBits::new(coded)?;
        for _ in 0..count {
            let (symbol, length) = self.entries[bits.peek(self.bits)];
            bits.skip(length.into())?;
            out.push(symbol);
        }
        if bits.left() == 0 { Ok(()) } else { Err(Error::corrupt("bits left over")) }
    }
}

/// The greatest accuracy of the tables for weights.
const MOST_ACCURACY: usize = 6;
/// Weights are below this.
const WEIGHTS: usize = 13;

/// Decodes up to `most` weights with two alternating states.
///
/// # Errors
/// If the bytes are damaged.
fn decode_weights(coded: &[u8], most: usize) -> Result<Vec<u8>> {
    let (accuracy, counts, used) = read_counts(coded)?;
    let table = table_of(accuracy, &counts)?;
    let mut bits = BackwardBits::new(&coded[used..])?;
    let mut states = [bits.take(accuracy)?, bits.take(accuracy)?];
    let mut weights = Vec::new();
    // Each state gives a symbol until there are not enough bits to update it; then the symbol of the other
    // state is the last.
    for turn in 0.. {
        let state = turn % 2;
        let entry = &table[states[state]];
        weights.push(entry.symbol);
        if weights.len() >= most {
            return Err(Error::corrupt("too many weights"));
        }
        if bits.left() < entry.bits {
            weights.push(table[states[1 - state]].symbol);
            break;
        }
        states[state] = entry.base + bits.take(entry.bits)?;
    }
    Ok(weights)
}

/// Bits read from the front, the lowest bit of each byte first.
struct ForwardBits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl ForwardBits<'_> {
    fn peek(&self, count: usize) -> usize {
        let window = (0..4).fold(0u32, |window, i| {
            window | u32::from(self.bytes.get(self.at / 8 + i).copied().unwrap_or(0)) << (8 * i)
        });
        (window >> (self.at % 8)) as usize & ((1 << count) - 1)
    }

    fn take(&mut self, count: usize) -> usize {
        let bits = self.peek(count);
        self.at += count;
        bits
    }
}

/// The accuracy of the table, how often each symbol occurs (-1: less than once), and the number of bytes
/// read.
fn read_counts(coded: &[u8]) -> Result<(usize, Vec<i32>, usize)> {
    let wrong = || Error::corrupt("counts that make no table");
    let mut bits = ForwardBits { bytes: coded, at: 0 };
    let accuracy = bits.take(4) + 5;
    if accuracy > MOST_ACCURACY {
        return Err(wrong());
    }
    let mut left = (1i32 << accuracy) + 1;
    let mut counts = Vec::new();
    while left > 1 {
        if counts.len() > WEIGHTS || bits.at > coded.len() * 8 {
            return Err(wrong());
        }
        // A value from 0 to `left`: the lower ones take one bit less.
        let width = (left as u32).ilog2() as usize + 1;
        let spare = (1 << width) - 1 - left;
        let low = bits.peek(width - 1) as i32;
        let value = if low < spare {
            bits.take(width - 1) as i32
        } else {
            let value = bits.take(width) as i32;
            if value >= 1 << (width - 1) { value - spare } else { value }
        };
        let count = value - 1;
        left -= count.abs();
        counts.push(count);
        if count == 0 {
            // The number of further symbols that do not occur, two bits at a time.
            loop {
                let more = bits.take(2);
                counts.extend(std::iter::repeat_n(0, more));
                if more < 3 || counts.len() > WEIGHTS {
                    break;
                }
            }
        }
    }
    let used = bits.at.div_ceil(8);
    let fits = left == 1 && counts.len() <= WEIGHTS && used <= coded.len();
    if fits { Ok((accuracy, counts, used)) } else { Err(wrong()) }
}

/// The symbol of a state, and how the next state is computed.
#[derive(Clone, Copy, Default)]
struct Entry {
    symbol: u8,
    bits: usize,
    base: usize,
}

/// The entry of each state.
fn table_of(accuracy: usize, counts: &[i32]) -> Result<Vec<Entry>> {
    let size = 1usize << accuracy;
    let mut symbols: Vec<Option<u8>> = vec![None; size];
    let mut end = size;
    for (symbol, _) in (0u8..).zip(counts).filter(|(_, count)| **count == -1) {
        end = end.checked_sub(1).ok_or_else(|| Error::corrupt("counts that make no table"))?;
        symbols[end] = Some(symbol);
    }
    let step = (size >> 1) + (size >> 3) + 3;
    let mut place = 0;
    for (symbol, &count) in (0u8..).zip(counts) {
        for _ in 0..count.max(0) {
            symbols[place] = Some(symbol);
            loop {
                place = (place + step) & (size - 1);
                if place < end || end == 0 {
                    break;
                }
            }
        }
    }
    let mut next: Vec<usize> = counts.iter().map(|count| count.unsigned_abs() as usize).collect();
    symbols
        .into_iter()
        .map(|symbol| {
            let symbol = symbol.ok_or_else(|| Error::corrupt("counts that make no table"))?;
            let state = next[usize::from(symbol)];
            next[usize::from(symbol)] += 1;
            let bits = accuracy - state.ilog2() as usize;
            Ok(Entry { symbol, bits, base: (state << bits) - size })
        })
        .collect()
}

/// Reads bits in reverse.
struct BackwardBits<'a> {
    bytes: &'a [u8],
    /// Number of bits that are left.
    left: usize,
}

impl<'a> BackwardBits<'a> {
    /// # Errors
    /// If there is no end mark.
    fn new(bytes: &'a [u8]) -> Result<Self> {
        let last = bytes.last().filter(|last| **last > 0).ok_or_else(|| Error::corrupt("no end mark"))?;
        Ok(BackwardBits { bytes, left: bytes.len() * 8 - 1 - last.leading_zeros() as usize })
    }

    /// Number of bits that are left.
    fn left(&self) -> usize {
        self.left
    }

    /// The next `count` bits, at most 16, the first of them highest; as if zeros followed the last bit.
    fn peek(&self, count: usize) -> usize {
        let start = self.left.saturating_sub(count);
        let missing = count - (self.left - start);
        let byte = start / 8;
        let window = (0..4).fold(0u32, |window, i| {
            window | u32::from(self.bytes.get(byte + i).copied().unwrap_or(0)) << (8 * i)
        });
        let bits = (window >> (start % 8)) as usize & ((1 << (count - missing)) - 1);
        bits << missing
    }

    /// Skips bits.
    ///
    /// # Errors
    /// If there are not that many.
    fn skip(&mut self, count: usize) -> Result<()> {
        self.left = self.left.checked_sub(count).ok_or_else(|| Error::corrupt("bits run out"))?;
        Ok(())
    }

    /// Takes bits; see [`peek`](Self::peek).
    ///
    /// # Errors
    /// If there are not that many.
    fn take(&mut self, count: usize) -> Result<usize> {
        let bits = self.peek(count);
        self.skip(count)?;
        Ok(bits)
    }
}
