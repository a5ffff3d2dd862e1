//! Code shared by LZ5 and Lizard: copying of matches, the search for them, their choice, and frames with
//! their checksum.
//!
//! Earlier occurrences of the bytes at a position are found by hash chains. The matches are chosen as the
//! cheapest path through a block, by dynamic programming over the prices of literals and matches. A frame is
//! what is around the blocks of LZ5 1.x and Lizard 1.x: magic number, descriptor, blocks with their lengths,
//! end mark, checksum ("LZ5 Frame Format Description", "Lizard Frame Format Description").

use crate::ground::error::{Error, Result};

/// Appends `length` bytes from `offset` bytes back, up to `most` bytes in all.
pub fn copy_match(out: &mut Vec<u8>, offset: usize, length: usize, most: usize) -> Result<()> {
    let start = out.len().checked_sub(offset).filter(|start| *start < out.len());
    let start = start.ok_or_else(|| Error::corrupt("a match from before the data"))?;
    check_room(out, length, most)?;
    if offset >= length {
        out.extend_from_within(start..start + length);
    } else {
        (start..start + length).for_each(|at| out.push(out[at]));
    }
    Ok(())
}

/// Appends literals, up to `most` bytes in all.
pub fn copy_literals(out: &mut Vec<u8>, literals: &[u8], most: usize) -> Result<()> {
    check_room(out, literals.len(), most)?;
    out.extend_from_slice(literals);
    Ok(())
}

fn check_room(out: &[u8], length: usize, most: usize) -> Result<()> {
    if length > most.saturating_sub(out.len()) {
        return Err(Error::corrupt(format!("more than {most} bytes")));
    }
    Ok(())
}

/// Takes `count` bytes off the front.
pub fn take<'a>(input: &mut &'a [u8], count: usize) -> Result<&'a [u8]> {
    let taken = input.split_off(..count);
    taken.ok_or_else(|| Error::corrupt("cut short"))
}

/// Takes a little-endian number of `bytes` bytes, at most 4, off the front.
pub fn take_number(input: &mut &[u8], bytes: usize) -> Result<usize> {
    let number = take(input, bytes)?.iter().rev().fold(0u32, |number, byte| number << 8 | u32::from(*byte));
    Ok(number as usize)
}

/// Bits of the hashes of three and of four bytes.
const HASH3_BITS: u32 = 13;
const HASH4_BITS: u32 = 15;
/// No position.
const NONE: u32 = u32::MAX;

/// A match: a repetition of earlier bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Match {
    /// Distance back to its beginning.
    offset: usize,
    /// Length in bytes.
    length: usize,
}

/// Settings of the search for matches.
struct Search {
    /// Number of earlier positions to try.
    depth: usize,
    /// Least distance of these positions.
    nearest: usize,
    /// A match of this length ends the search.
    enough: usize,
}

/// The positions of a block by hashes of the bytes there.
struct MatchFinder<'a> {
    input: &'a [u8],
    /// The last position of each hash of three bytes.
    last3: Vec<u32>,
    /// The last position of each hash of four bytes, and for each position the preceding one with the same
    /// hash.
    last4: Vec<u32>,
    before: Vec<u32>,
    next: usize,
}

impl<'a> MatchFinder<'a> {
    /// Creates a finder for a block.
    fn new(input: &'a [u8]) -> Self {
        MatchFinder {
            input,
            last3: vec![NONE; 1 << HASH3_BITS],
            last4: vec![NONE; 1 << HASH4_BITS],
            before: vec![NONE; input.len()],
            next: 0,
        }
    }

    /// Finds matches at `place` that end before `end`, each longer than the one before. Calls must be in
    /// ascending order of positions.
    fn find(&mut self, place: usize, end: usize, search: &Search, found: &mut Vec<Match>) {
        self.insert_up_to(place);
        if place + 4 > end {
            return;
        }
        let mut longest = 2;
        let mut look = |earlier: u32| -> usize {
            let earlier = earlier as usize;
            let length = common_length(&self.input[..end], earlier, place);
            if length > longest {
                longest = length;
                found.push(Match { offset: place - earlier, length });
            }
            longest
        };
        let is_near = |earlier: u32| place - (earlier as usize) < search.nearest;
        let last = self.last3[self.hash3(place)];
        if last != NONE && !is_near(last) {
            look(last);
        }
        let mut earlier = self.last4[self.hash4(place)];
        while earlier != NONE && is_near(earlier) {
            earlier = self.before[earlier as usize];
        }
        for _ in 0..search.depth {
            if earlier == NONE || look(earlier) >= search.enough {
                break;
            }
            earlier = self.before[earlier as usize];
        }
    }

    fn insert_up_to(&mut self, place: usize) {
        while self.next < place && self.next + 4 <= self.input.len() {
            let (hash3, hash4) = (self.hash3(self.next), self.hash4(self.next));
            self.last3[hash3] = self.next as u32;
            self.before[self.next] = self.last4[hash4];
            self.last4[hash4] = self.next as u32;
            self.next += 1;
        }
    }

    fn hash3(&self, place: usize) -> usize {
        let bytes = [self.input[place], self.input[place + 1], self.input[place + 2], 0];
        (u32::from_le_bytes(bytes).wrapping_mul(0x9e37_79b1) >> (32 - HASH3_BITS)) as usize
    }

    fn hash4(&self, place: usize) -> usize {
        let bytes = self.input[place..].first_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes));
        (bytes.wrapping_mul(0x9e37_79b1) >> (32 - HASH4_BITS)) as usize
    }
}

/// Number of bytes that the data at two positions have in common.
fn common_length(input: &[u8], a: usize, b: usize) -> usize {
    let (first, second) = (&input[a..], &input[b..]);
    first.iter().zip(second).take_while(|(a, b)| a == b).count()
}

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

/// The differences between the formats.
pub struct FrameFormat {
    /// The first four bytes, little-endian.
    pub magic: u32,
    /// The largest block, in bytes, of each code from 1 on.
    pub block_sizes: [usize; 7],
}

/// Flags of the descriptor.
const VERSION: u8 = 0b0100_0000;
const VERSION_MASK: u8 = 0b1100_0000;
const INDEPENDENT: u8 = 0b0010_0000;
const BLOCK_CHECKSUMS: u8 = 0b0001_0000;
const CONTENT_SIZE: u8 = 0b0000_1000;
const CONTENT_CHECKSUM: u8 = 0b0000_0100;
const RESERVED: u8 = 0b0000_0011;
/// The bit of a block's length that marks it as not compressed.
const STORED: usize = 1 << 31;
/// The code of the block size used for writing: 1 MB.
const LARGEST_WRITTEN: usize = 3;

/// Decodes a frame to at most `most` bytes. `decode_block` appends the contents of a block to the bytes
/// decoded so far, up to the total that it is given.
///
/// # Errors
/// If the frame is damaged, or anything follows it.
pub fn decode_frame(
    mut input: &[u8],
    format: &FrameFormat,
    most: usize,
    mut decode_block: impl FnMut(&[u8], &mut Vec<u8>, usize) -> Result<()>,
) -> Result<Vec<u8>> {
    let input = &mut input;
    if take_number(input, 4)? != format.magic as usize {
        return Err(Error::corrupt("no frame of this format"));
    }
    let (flags, largest) = read_descriptor(input, format)?;
    let mut out = Vec::new();
    loop {
        let length = take_number(input, 4)?;
        if length == 0 {
            break;
        }
        let block = take(input, length & !STORED)?;
        if flags & BLOCK_CHECKSUMS != 0 && take_number(input, 4)? != xxh32(block) as usize {
            return Err(Error::corrupt("a block's checksum does not match"));
        }
        let end = most.min(out.len().saturating_add(largest));
        match length & STORED {
            0 => decode_block(block, &mut out, end)?,
            _ => copy_literals(&mut out, block, end)?,
        }
    }
    if flags & CONTENT_CHECKSUM != 0 && take_number(input, 4)? != xxh32(&out) as usize {
        return Err(Error::corrupt("the checksum does not match"));
    }
    if input.is_empty() { Ok(out) } else { Err(Error::corrupt("bytes after the end")) }
}

/// The flags, and the size of the largest block.
fn read_descriptor(input: &mut &[u8], format: &FrameFormat) -> Result<(u8, usize)> {
    let descriptor = *input;
    let fields = take(input, 2)?;
    let (flags, block_size) = (fields[0], fields[1]);
    if flags & VERSION_MASK != VERSION || flags & RESERVED != 0 {
        return Err(Error::unsupported("a frame of another version"));
    }
    let code = usize::from(block_size >> 4 & 7);
    let largest = code.checked_sub(1).map(|code| format.block_sizes[code]);
    let largest = largest.ok_or_else(|| Error::corrupt("no size of blocks"))?;
    if flags & CONTENT_SIZE != 0 {
        take(input, 8)?;
    }
    let length = descriptor.len() - input.len();
    if take(input, 1)?[0] != header_checksum(&descriptor[..length]) {
        return Err(Error::corrupt("the descriptor's checksum does not match"));
    }
    Ok((flags, largest))
}

fn header_checksum(descriptor: &[u8]) -> u8 {
    (xxh32(descriptor) >> 8) as u8
}

/// Writes a frame of independent blocks without checksums. A block that `compress_block` does not make
/// smaller is stored uncompressed.
pub fn encode_frame(
    input: &[u8],
    format: &FrameFormat,
    compress_block: impl Fn(&[u8]) -> Vec<u8>,
) -> Vec<u8> {
    let code = (1..LARGEST_WRITTEN).find(|code| input.len() <= format.block_sizes[code - 1]);
    let code = code.unwrap_or(LARGEST_WRITTEN);
    let descriptor = [VERSION | INDEPENDENT, (code as u8) << 4];
    let mut out = format.magic.to_le_bytes().to_vec();
    out.extend(descriptor);
    out.push(header_checksum(&descriptor));
    for block in input.chunks(format.block_sizes[code - 1]) {
        let packed = compress_block(block);
        let (length, bytes) = if packed.len() < block.len() {
            (packed.len(), &packed[..])
        } else {
            (block.len() | STORED, block)
        };
        out.extend((length as u32).to_le_bytes());
        out.extend(bytes);
    }
    out.extend([0; 4]);
    out
}

const PRIMES: [u32; 5] = [0x9e37_79b1, 0x85eb_ca77, 0xc2b2_ae3d, 0x27d4_eb2f, 0x1656_67b1];

/// The digest of `input` with seed 0.
fn xxh32(input: &[u8]) -> u32 {
    let [p1, p2, p3, p4, p5] = PRIMES;
    let (stripes, rest) = input.as_chunks::<16>();
    let mut hash = p5;
    if !stripes.is_empty() {
        let mut lanes = [p1.wrapping_add(p2), p2, 0, 0u32.wrapping_sub(p1)];
        for stripe in stripes {
            for (lane, word) in lanes.iter_mut().zip(stripe.as_chunks::<4>().0) {
                let mixed = lane.wrapping_add(u32::from_le_bytes(*word).wrapping_mul(p2));
                *lane = mixed.rotate_left(13).wrapping_mul(p1);
            }
        }
        let rotated = lanes.iter().zip([1, 7, 12, 18]).map(|(lane, bits)| lane.rotate_left(bits));
        hash = rotated.fold(0, u32::wrapping_add);
    }
    hash = hash.wrapping_add(input.len() as u32);
    let (words, bytes) = rest.as_chunks::<4>();
    for word in words {
        hash = hash.wrapping_add(u32::from_le_bytes(*word).wrapping_mul(p3)).rotate_left(17).wrapping_mul(p4);
    }
    for byte in bytes {
        hash = hash.wrapping_add(u32::from(*byte).wrapping_mul(p5)).rotate_left(11).wrapping_mul(p1);
    }
    hash = (hash ^ hash >> 15).wrapping_mul(p2);
    hash = (hash ^ hash >> 13).wrapping_mul(p3);
    hash ^ hash >> 16
}

#[cfg(test)]
mod tests {
    use super::xxh32;

    #[test]
    fn digests_are_those_of_the_specification() {
        assert_eq!(xxh32(b""), 0x02cc_5d05);
        assert_eq!(xxh32(b"a"), 0x550d_7456);
        assert_eq!(xxh32(b"abc"), 0x32d1_53ff);
        assert_eq!(xxh32(b"Nobody inspects the spammish repetition"), 0xe229_3b2f);
    }
}
