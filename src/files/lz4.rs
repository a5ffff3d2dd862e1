//! LZ4 frames as liblz4 makes them in one call (`LZ4F_compressFrame`), the compression inside Arrow files.
//! FORMAT.md 9.
//!
//! The compressor finds exactly the matches that liblz4 finds at its fast level, because a file comes back
//! byte for byte only if compressing its values again gives the same bytes.
//!
//! Source: LZ4 1.10, `doc/lz4_Frame_format.md` and `doc/lz4_Block_format.md`.

use std::mem::replace;
use std::ops::Range;

use lz4_flex::block::decompress_into_with_dict;

const MAGIC: [u8; 4] = 0x184d_2204_u32.to_le_bytes();
/// The descriptor of a frame of independent blocks of 64 KiB, and its checksum; for values that fill one
/// block.
const INDEPENDENT: [u8; 3] = [0x60, 0x40, 0x82];
/// The descriptor of a frame of blocks that refer to those before them, and its checksum.
const LINKED: [u8; 3] = [0x40, 0x40, 0xc0];
/// The values of a block, in bytes.
const BLOCK: usize = 64 << 10;
/// Marks the size of a block that is stored as it is.
const STORED: u32 = 1 << 31;
/// No byte can stand for more output than this.
const MAX_EXPANSION: usize = 255;
/// The distance of a match is at most this.
const MOST_DISTANCE: usize = 0xffff;
const LEAST_MATCH: usize = 4;
/// A block ends with at least this number of literals.
const LAST_LITERALS: usize = 5;
/// No match begins in the last bytes of a block, one fewer than this.
const LAST_START: usize = 11;
/// Lengths from this on continue in further bytes.
const LONG: usize = 15;
/// After this number of misses, the search takes wider steps, a power of two.
const PATIENCE: u32 = 6;

/// Decompresses a frame into exactly `size` bytes; `None` if it is damaged, of another size, or none that
/// [`compress`] might make. No memory is allocated for a `size` that the frame cannot reach.
pub fn decompress(frame: &[u8], size: usize) -> Option<Vec<u8>> {
    if size > frame.len().checked_mul(MAX_EXPANSION)? {
        return None;
    }
    let (descriptor, mut rest) = frame.strip_prefix(&MAGIC)?.split_first_chunk::<3>()?;
    if ![INDEPENDENT, LINKED].contains(descriptor) {
        return None;
    }
    let mut out = vec![0; size];
    let mut done = 0;
    loop {
        let (packed_size, after) = rest.split_first_chunk()?;
        let packed_size = u32::from_le_bytes(*packed_size);
        if packed_size == 0 {
            return (done == size && after.is_empty()).then_some(out);
        }
        let (packed, after) = after.split_at_checked((packed_size & !STORED) as usize)?;
        rest = after;
        let (before, block) = out.split_at_mut(done);
        let most = block.len().min(BLOCK);
        done += if packed_size & STORED > 0 {
            block.get_mut(..packed.len())?.copy_from_slice(packed);
            packed.len()
        } else {
            let dictionary = &before[done.saturating_sub(BLOCK)..];
            let dictionary = if *descriptor == LINKED { dictionary } else { &[] };
            decompress_into_with_dict(packed, &mut block[..most], dictionary).ok()?
        };
    }
}

/// The frame of these bytes, fewer than 4 GiB.
pub fn compress(input: &[u8]) -> Vec<u8> {
    let is_linked = input.len() > BLOCK;
    let mut out = [MAGIC.as_slice(), if is_linked { &LINKED } else { &INDEPENDENT }].concat();
    let mut positions = Positions::new(is_linked);
    for start in (0..input.len()).step_by(BLOCK) {
        let block = start..input.len().min(start + BLOCK);
        match compressed(input, block.clone(), &mut positions) {
            Some(packed) => {
                out.extend((packed.len() as u32).to_le_bytes());
                out.extend(packed);
            }
            None => {
                out.extend((block.len() as u32 | STORED).to_le_bytes());
                out.extend_from_slice(&input[block]);
            }
        }
    }
    out.extend([0; 4]);
    out
}

/// A block; `None` if liblz4 sees no way to make it shorter than its values.
fn compressed(input: &[u8], block: Range<usize>, positions: &mut Positions) -> Option<Vec<u8>> {
    let mut sequences = Sequences { out: Vec::with_capacity(block.len()), most: block.len() - 1 };
    let mut literals = block.start;
    if block.len() > LAST_START + 1 {
        let (last_start, match_end) = (block.end - LAST_START, block.end - LAST_LITERALS);
        let is_match = |candidate: usize, at: usize| {
            candidate + MOST_DISTANCE >= at && input[candidate..][..LEAST_MATCH] == input[at..][..LEAST_MATCH]
        };
        positions.replace(input, block.start);
        let mut from = block.start + 1;
        while let Some((mut at, mut candidate)) = positions.search(input, from, last_start, is_match) {
            while at > literals && candidate > 0 && input[at - 1] == input[candidate - 1] {
                (at, candidate) = (at - 1, candidate - 1);
            }
            // One match after the other, for as long as they follow without literals between them.
            loop {
                let both = input[at + LEAST_MATCH..match_end].iter().zip(&input[candidate + LEAST_MATCH..]);
                let more = both.take_while(|(a, b)| a == b).count();
                sequences.push(&input[literals..at], at - candidate, more)?;
                at += LEAST_MATCH + more;
                literals = at;
                if at >= last_start {
                    break;
                }
                positions.replace(input, at - 2);
                candidate = positions.replace(input, at);
                if !is_match(candidate, at) {
                    break;
                }
            }
            if at >= last_start {
                break;
            }
            from = at + 1;
        }
    }
    sequences.end(&input[literals..block.end])
}

/// The last position of each hash.
struct Positions {
    slots: Vec<u32>,
    /// In blocks that refer to others, the hash is of five bytes and has fewer values.
    is_linked: bool,
}

impl Positions {
    fn new(is_linked: bool) -> Self {
        Positions { slots: vec![0; if is_linked { 1 << 12 } else { 1 << 13 }], is_linked }
    }

    /// Enters a position, which eight bytes or more must follow; returns the one before with the same hash, 0
    /// if there is none.
    fn replace(&mut self, input: &[u8], at: usize) -> usize {
        let bytes = &input[at..at + 8];
        let slot = if self.is_linked {
            let bytes = bytes.iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte));
            (bytes << 24).wrapping_mul(889_523_592_379) >> (64 - 12)
        } else {
            let bytes = bytes[..4].iter().rev().fold(0, |all, byte| all << 8 | u32::from(*byte));
            (bytes.wrapping_mul(2_654_435_761) >> (32 - 13)).into()
        };
        replace(&mut self.slots[slot as usize], at as u32) as usize
    }

    /// The next position that matches an earlier one, and that; `None` if the search reaches the end.
    fn search(
        &mut self,
        input: &[u8],
        from: usize,
        last_start: usize,
        is_match: impl Fn(usize, usize) -> bool,
    ) -> Option<(usize, usize)> {
        let (mut at, mut step, mut tried) = (from, 1, 1 << PATIENCE);
        while at + step <= last_start {
            let candidate = self.replace(input, at);
            if is_match(candidate, at) {
                return Some((at, candidate));
            }
            (at, step, tried) = (at + step, tried >> PATIENCE, tried + 1);
        }
        None
    }
}

/// The sequences of a block.
struct Sequences {
    out: Vec<u8>,
    /// The block may have this number of bytes.
    most: usize,
}

impl Sequences {
    /// Appends literals and a match that is `more` bytes longer than the shortest; `None` if the block might
    /// become too long.
    fn push(&mut self, literals: &[u8], distance: usize, more: usize) -> Option<()> {
        let length = self.out.len() + 1 + literals.len();
        self.limit(length + literals.len() / 255 + 3 + LAST_LITERALS)?;
        self.out.push((literals.len().min(LONG) << 4 | more.min(LONG)) as u8);
        self.put_rest(literals.len());
        self.out.extend_from_slice(literals);
        self.out.extend((distance as u16).to_le_bytes());
        self.limit(self.out.len() + 1 + LAST_LITERALS + (more + 240) / 255)?;
        self.put_rest(more);
        Some(())
    }

    /// The block, with its last literals.
    fn end(mut self, literals: &[u8]) -> Option<Vec<u8>> {
        self.limit(self.out.len() + literals.len() + 1 + (literals.len() + 255 - LONG) / 255)?;
        self.out.push((literals.len().min(LONG) << 4) as u8);
        self.put_rest(literals.len());
        self.out.extend_from_slice(literals);
        Some(self.out)
    }

    /// What a token cannot hold of a length.
    fn put_rest(&mut self, length: usize) {
        if let Some(rest) = length.checked_sub(LONG) {
            self.out.resize(self.out.len() + rest / 255, 255);
            self.out.push((rest % 255) as u8);
        }
    }

    fn limit(&self, length: usize) -> Option<()> {
        (length <= self.most).then_some(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::files::tests::sample;

    /// Check values computed with `pyarrow.Codec("lz4")`, version 26, on the same bytes.
    #[test]
    fn bytes_are_those_of_liblz4() {
        let cases = [
            (7, 1, 9, (22, 0x0066c21a)),
            (13, 1, 9, (25, 0x4f62cafc)),
            (21, 1, 9, (25, 0xe4808d2e)),
            (600, 3, 20, (252, 0x240dc8ca)),
            (20000, 256, 30, (3358, 0xe7c7d4fd)),
            (20000, 2, 200, (11728, 0x8b34a171)),
            (65536, 40, 3000, (63019, 0xe0c13da0)),
            (65537, 40, 60, (18070, 0xdef33830)),
            (200000, 256, 30, (34516, 0x18e9ed77)),
            (200000, 256, 4000, (190098, 0x227c5310)),
            (300000, 4, 200, (108635, 0xde6887a2)),
        ];
        for (length, values, run, expected) in cases {
            let input = sample(length, values, run);
            let frame = compress(&input);
            assert_eq!((frame.len(), crc32c::crc32c(&frame)), expected, "{length} {values} {run}");
            assert_eq!(decompress(&frame, length).unwrap(), input);
        }
    }

    #[test]
    fn damage_is_refused() {
        let input = sample(70_000, 256, 4000);
        let frame = compress(&input);
        assert!(decompress(&frame, input.len()).is_some());
        for size in [0, input.len() - 1, input.len() + 1, usize::MAX] {
            assert!(decompress(&frame, size).is_none(), "{size}");
        }
        for end in [0, 3, 6, 7, 10, 11, 5000, frame.len() - 4, frame.len() - 1] {
            assert!(decompress(&frame[..end], input.len()).is_none(), "{end}");
        }
        assert!(decompress(&[&frame[..], &[0]].concat(), input.len()).is_none());
        for at in 0..7 {
            let mut other = frame.clone();
            other[at] ^= 1;
            assert!(decompress(&other, input.len()).is_none(), "{at}");
        }
        // A stored block longer than what is left, and a match before the start.
        let start = &frame[..7];
        let block = |size: u32, bytes: &[u8]| [start, &size.to_le_bytes(), bytes, &[0; 4]].concat();
        assert_eq!(decompress(&block(STORED | 3, b"abc"), 3).unwrap(), b"abc");
        assert!(decompress(&block(STORED | 3, b"abc"), 2).is_none());
        assert!(decompress(&block(4, &[0x10, b'a', 2, 0]), 5).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn what_is_compressed_comes_back(bytes in prop::collection::vec(0u8..3, 0..2000)) {
            prop_assert_eq!(&decompress(&compress(&bytes), bytes.len()).unwrap(), &bytes);
        }

        #[test]
        fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), size in 0usize..3000) {
            let frame = [&MAGIC[..], &LINKED, &bytes].concat();
            if let Some(out) = decompress(&frame, size) {
                prop_assert_eq!(out.len(), size);
            }
        }
    }
}
