//! LZF, the compression inside PCD `binary_compressed` (format of liblzf by M. Lehmann).
//! FORMAT.md 9.
//!
//! ```text
//! 000LLLLL                    L + 1 literal bytes follow (1..=32)
//! LLLooooo oooooooo           copy L + 2 bytes (3..=8) from o + 1 bytes back (1..=8192)
//! 111ooooo LLLLLLLL oooooooo  copy L + 9 bytes (9..=264) from o + 1 bytes back
//! ```
//!
//! The compressor finds exactly the matches that the C programs find, because a file comes back byte for byte
//! only if compressing its points again gives the same bytes.

use crate::scan::LzfDialect;

const MAX_LITERALS: usize = 32;
const MAX_OFFSET: usize = 1 << 13;
const MAX_MATCH: usize = (1 << 8) + (1 << 3);
/// The C programs compare this many bytes without looking at the longest match allowed.
const UNCHECKED_MATCH: usize = 19;
/// No three input bytes can stand for more output than this.
const MAX_EXPANSION: usize = MAX_MATCH.div_ceil(3);

/// Decompresses `input` into exactly `size` bytes; `None` if it is damaged or of another size. No memory is
/// allocated for a `size` that `input` cannot reach.
pub fn decompress(input: &[u8], size: usize) -> Option<Vec<u8>> {
    if size > input.len().checked_mul(MAX_EXPANSION)? {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut rest = input;
    while let Some((&control, after)) = rest.split_first() {
        rest = after;
        if usize::from(control) < MAX_LITERALS {
            let (literals, after) = rest.split_at_checked(usize::from(control) + 1)?;
            out.extend_from_slice(literals);
            rest = after;
        } else {
            let mut length = usize::from(control >> 5) + 2;
            if control >> 5 == 7 {
                let (&more, after) = rest.split_first()?;
                length += usize::from(more);
                rest = after;
            }
            let (&low, after) = rest.split_first()?;
            rest = after;
            let offset = (usize::from(control & 0x1f) << 8) + usize::from(low) + 1;
            copy_back(&mut out, offset, length)?;
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

/// Appends `length` bytes from `offset` bytes back; they may overlap what is being written.
fn copy_back(out: &mut Vec<u8>, offset: usize, length: usize) -> Option<()> {
    let from = out.len().checked_sub(offset)?;
    if offset >= length {
        out.extend_from_within(from..from + length);
    } else {
        for at in from..from + length {
            out.push(out[at]);
        }
    }
    Some(())
}

/// Compresses `input` as the programs of that dialect do. Inputs of 4 GiB and more do not fit into a PCD
/// file, and positions are stored as u32.
pub fn compress(input: &[u8], dialect: LzfDialect) -> Vec<u8> {
    let mut out = Vec::with_capacity(input.len() / 2);
    let mut table = HashTable::new(dialect);
    let mut literals = 0; // start of the literals not yet written
    let mut at = 0;
    while at + 2 < input.len() {
        let candidate = table.replace(input, at);
        // Slot value 0 also means empty: the C programs never match the first byte.
        let near = candidate > 0 && candidate < at && at - candidate <= MAX_OFFSET;
        if !near || input[candidate..candidate + 3] != input[at..at + 3] {
            at += 1;
            continue;
        }
        write_literals(&input[literals..at], &mut out);
        let length = match_length(input, candidate, at);
        write_match(at - candidate - 1, length, &mut out);
        at += length;
        literals = at;
        if at + 2 >= input.len() {
            break;
        }
        for back in (1..=table.inserts_after_match).rev() {
            table.replace(input, at - back);
        }
    }
    write_literals(&input[literals..], &mut out);
    out
}

/// The length of the match between the bytes at `candidate` and at `at`; the first three are known to match.
fn match_length(input: &[u8], candidate: usize, at: usize) -> usize {
    let left = input.len() - at - 2;
    let limit = match left.min(MAX_MATCH) {
        few @ ..=16 => few.max(3),
        many => many.max(UNCHECKED_MATCH),
    };
    let same = (3..limit).take_while(|&i| input[candidate + i] == input[at + i]).count();
    3 + same
}

fn write_literals(literals: &[u8], out: &mut Vec<u8>) {
    for run in literals.chunks(MAX_LITERALS) {
        out.push((run.len() - 1) as u8);
        out.extend_from_slice(run);
    }
}

fn write_match(offset: usize, length: usize, out: &mut Vec<u8>) {
    let (high, low) = ((offset >> 8) as u8, offset as u8);
    match length - 2 {
        short @ ..=6 => out.extend([(short << 5) as u8 | high, low]),
        long => out.extend([7 << 5 | high, (long - 7) as u8, low]),
    }
}

/// The last position of each sequence of three bytes, by hash.
struct HashTable {
    slots: Vec<u32>,
    bits: u32,
    multiplier: u32,
    /// How many of the last positions inside a match are entered.
    inserts_after_match: usize,
}

impl HashTable {
    fn new(dialect: LzfDialect) -> Self {
        let (bits, multiplier, inserts_after_match) = match dialect {
            LzfDialect::Ultra13 => (13, 1, 1),
            LzfDialect::Ultra16 => (16, 1, 1),
            LzfDialect::Very16 => (16, 5, 2),
        };
        HashTable { slots: vec![0; 1 << bits], bits, multiplier, inserts_after_match }
    }

    /// Enters the three bytes at `at`; returns the previous entry of their slot.
    fn replace(&mut self, input: &[u8], at: usize) -> usize {
        let bytes = u32::from_be_bytes([0, input[at], input[at + 1], input[at + 2]]);
        let hash = (bytes >> (24 - self.bits)).wrapping_sub(bytes.wrapping_mul(self.multiplier));
        let slot = (hash & ((1 << self.bits) - 1)) as usize;
        std::mem::replace(&mut self.slots[slot], at as u32) as usize
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::files::tests::sample;

    #[test]
    fn literals_and_matches_decompress() {
        assert_eq!(decompress(&[2, b'a', b'b', b'c', 0x20, 2], 6).unwrap(), b"abcabc");
        // Overlap: three bytes, then nine and 264 from one back.
        assert_eq!(decompress(&[0, 7, 0xe0, 0, 0], 10).unwrap(), [7; 10]);
        assert_eq!(decompress(&[0, 7, 0xe0, 255, 0], 265).unwrap(), [7; 265]);
        assert_eq!(decompress(&[], 0).unwrap(), b"");
    }

    #[test]
    fn damage_is_refused() {
        assert!(decompress(&[2, b'a', b'b'], 3).is_none(), "literals cut short");
        assert!(decompress(&[0x20], 3).is_none(), "match cut short");
        assert!(decompress(&[0xe0, 1], 10).is_none(), "long match cut short");
        assert!(decompress(&[0, 7, 0x20, 1], 4).is_none(), "match before the start");
        assert!(decompress(&[0, 7], 2).is_none(), "too short");
        assert!(decompress(&[1, 7, 7], 1).is_none(), "too long");
        assert!(decompress(&[0, 7], usize::MAX).is_none(), "absurd size");
    }

    #[test]
    fn short_inputs_are_literals() {
        assert_eq!(compress(b"", LzfDialect::Ultra13), b"");
        assert_eq!(compress(b"aa", LzfDialect::Ultra13), [1, b'a', b'a']);
        // The first byte is never matched, so four equal bytes give no match and five do.
        assert_eq!(compress(b"aaaa", LzfDialect::Ultra13), [3, b'a', b'a', b'a', b'a']);
        assert_eq!(compress(b"aaaaa", LzfDialect::Ultra13), [1, b'a', b'a', 0x20, 0]);
    }

    #[test]
    fn matches_reach_8192_bytes_back() {
        let apart = |offset: usize| [&b"-xyz"[..], &vec![0; offset - 3], b"xyz"].concat();
        assert!(compress(&apart(8192), LzfDialect::Ultra13).ends_with(&[0x3f, 0xff]));
        assert!(compress(&apart(8193), LzfDialect::Ultra13).ends_with(b"xyz"));
    }

    /// Check values computed with the C compressors of PCL and liblzf on the same bytes.
    #[test]
    fn bytes_are_those_of_the_c_programs() {
        let cases = [
            (7, 1, 9, [(8, 0x7bfde884), (8, 0x7bfde884), (8, 0x7bfde884)]),
            (21, 1, 9, [(6, 0xaf4de84b), (6, 0xaf4de84b), (6, 0xaf4de84b)]),
            (36, 2, 9, [(25, 0x764908a5), (27, 0xae40873e), (26, 0x44ef0f51)]),
            (600, 3, 20, [(231, 0x8c474752), (316, 0x0a6a679e), (372, 0xd1c36812)]),
            (20000, 256, 30, [(3857, 0x59877759), (3839, 0x9973a79b), (3826, 0xa339590b)]),
            (20000, 2, 200, [(9981, 0xc49268ba), (10672, 0xf978904a), (10079, 0xb167e33f)]),
            (120000, 40, 60, [(41109, 0x3f48fe9e), (41382, 0xfad2866f), (40521, 0x56549f9d)]),
        ];
        for (length, values, run, expected) in cases {
            let input = sample(length, values, run);
            for (dialect, expected) in LzfDialect::ALL.into_iter().zip(expected) {
                let packed = compress(&input, dialect);
                assert_eq!((packed.len(), crc32c::crc32c(&packed)), expected, "{length} {dialect:?}");
                assert_eq!(decompress(&packed, input.len()).unwrap(), input);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn what_is_compressed_comes_back(bytes in prop::collection::vec(0u8..3, 0..2000)) {
            for dialect in LzfDialect::ALL {
                prop_assert_eq!(&decompress(&compress(&bytes, dialect), bytes.len()).unwrap(), &bytes);
            }
        }

        #[test]
        fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), size in 0usize..3000) {
            if let Some(out) = decompress(&bytes, size) {
                prop_assert_eq!(out.len(), size);
            }
        }
    }
}
