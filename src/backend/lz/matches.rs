//! Earlier occurrences of the bytes at a position, found by hash chains.

/// Bits of the hashes of three and of four bytes.
const HASH3_BITS: u32 = 13;
const HASH4_BITS: u32 = 15;
/// No position.
const NONE: u32 = u32::MAX;

/// A match: a repetition of earlier bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Distance back to its beginning.
    pub offset: usize,
    /// Length in bytes.
    pub length: usize,
}

/// Settings of the search for matches.
pub struct Search {
    /// Number of earlier positions to try.
    pub depth: usize,
    /// Least distance of these positions.
    pub nearest: usize,
    /// A match of this length ends the search.
    pub enough: usize,
}

/// The positions of a block by hashes of the bytes there.
pub struct MatchFinder<'a> {
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
    pub fn new(input: &'a [u8]) -> Self {
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
    pub fn find(&mut self, place: usize, end: usize, search: &Search, found: &mut Vec<Match>) {
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
pub fn common_length(input: &[u8], a: usize, b: usize) -> usize {
    let (first, second) = (&input[a..], &input[b..]);
    first.iter().zip(second).take_while(|(a, b)| a == b).count()
}
