//! Maps each number below 4096 to a token, so that each token has as many numbers as its frequency. Walker's
//! alias method keeps the table small: equal buckets, each shared by at most two tokens.
//! FORMAT.md 5.5, "Alias method".

use super::frequencies::{Frequencies, SCALE, TOKENS};

/// Numbers in a bucket.
const BUCKET: u32 = SCALE / TOKENS as u32;

/// A bucket: its first numbers belong to its own token, the rest to another token.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bucket {
    own_frequency: u16,
    other_frequency: u16,
    /// The index of the bucket's first number among those of the other token; negative if it would be before
    /// the first of them.
    other_place: i16,
    /// How many numbers belong to the bucket's own token.
    own: u8,
    other: u8,
}

/// The token of a number below 4096.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    pub token: u8,
    /// The token's frequency.
    pub frequency: u32,
    /// The index of the number among those of the token.
    pub place: u32,
}

/// The buckets of a context.
pub fn buckets(Frequencies(frequencies): &Frequencies) -> [Bucket; TOKENS] {
    let mut left = frequencies.map(u32::from);
    let mut buckets: [Bucket; TOKENS] = std::array::from_fn(|token| Bucket {
        own_frequency: frequencies[token],
        other_frequency: frequencies[token],
        other_place: 0,
        own: 0,
        other: token as u8,
    });
    let (mut poor, mut rich): (Vec<usize>, Vec<usize>) =
        (0..TOKENS).filter(|&token| left[token] != BUCKET).partition(|&token| left[token] < BUCKET);
    while let (Some(from), Some(to)) = (rich.pop(), poor.pop()) {
        // The rest of this token's bucket is filled from the end of the other token's numbers.
        let own = left[to];
        left[from] -= BUCKET - own;
        buckets[to].own = own as u8;
        buckets[to].other = from as u8;
        buckets[to].other_frequency = frequencies[from];
        buckets[to].other_place = (left[from] as i32 - own as i32) as i16;
        match left[from] {
            rest if rest < BUCKET => poor.push(from),
            rest if rest > BUCKET => rich.push(from),
            _ => {}
        }
    }
    buckets
}

/// Calls `give` for all numbers below 4096 with the number's token, its index among that token's numbers, and
/// the number.
pub fn for_each_number(buckets: &[Bucket; TOKENS], mut give: impl FnMut(u8, u32, u32)) {
    for (index, bucket) in buckets.iter().enumerate() {
        let (first, own) = (index as u32 * BUCKET, u32::from(bucket.own));
        (0..own).for_each(|place| give(index as u8, place, first + place));
        let other_place = |place: u32| place.wrapping_add_signed(i32::from(bucket.other_place));
        (own..BUCKET).for_each(|place| give(bucket.other, other_place(place), first + place));
    }
}

/// The token of a number below 4096.
#[inline]
pub fn look_up(buckets: &[Bucket; TOKENS], number: u32) -> Slot {
    let index = (number / BUCKET) as usize % TOKENS;
    let bucket = &buckets[index];
    let place = number % BUCKET;
    // Selected without a branch, which would be unpredictable.
    let is_own = place < u32::from(bucket.own);
    let token = if is_own { index as u8 } else { bucket.other };
    let frequency = if is_own { bucket.own_frequency } else { bucket.other_frequency };
    let first = if is_own { 0 } else { bucket.other_place };
    Slot { token, frequency: u32::from(frequency), place: place.wrapping_add_signed(i32::from(first)) }
}
