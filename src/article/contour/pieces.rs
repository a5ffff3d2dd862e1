//! The pieces between borders. FORMAT.md 8.11, "Pieces".

use super::returns::Returns;

/// The piece of each return, determined by filling between the borders. A return that is not on a border is
/// in the same piece as the next returns to its right and below. A piece is identified by its first return.
pub fn fill(returns: &Returns, borders: &[bool]) -> Vec<u32> {
    let mut first: Vec<u32> = (0..returns.len() as u32).collect();
    for number in (0..returns.len()).filter(|&number| !borders[number]) {
        for other in [returns.right(number), returns.below(number)].into_iter().flatten() {
            join(&mut first, number as u32, other as u32);
        }
    }
    // The first return of a piece precedes all others of it, so one pass is enough.
    for number in 0..first.len() {
        first[number] = first[first[number] as usize];
    }
    first
}

/// Joins the pieces of two returns; the earlier first return stays the first.
fn join(first: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(first, a), root(first, b));
    first[a.max(b) as usize] = a.min(b);
}

/// The first return of a piece; halves the path to it (union-find).
fn root(first: &mut [u32], mut number: u32) -> u32 {
    while first[number as usize] != number {
        first[number as usize] = first[first[number as usize] as usize];
        number = first[number as usize];
    }
    number
}
