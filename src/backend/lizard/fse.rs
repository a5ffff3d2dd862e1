//! FSE, the table-based asymmetric numeral system that codes Huff0's weights (described in RFC 8878, 4.1 and
//! 4.2.1.2).

use super::bits::BackwardBits;
use crate::ground::error::{Error, Result};

/// The greatest accuracy of the tables for weights.
const MOST_ACCURACY: usize = 6;
/// Weights are below this.
const SYMBOLS: usize = 13;

/// Decodes up to `most` weights with two alternating states.
///
/// # Errors
/// If the bytes are damaged.
pub fn decode(coded: &[u8], most: usize) -> Result<Vec<u8>> {
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
        if counts.len() > SYMBOLS || bits.at > coded.len() * 8 {
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
                if more < 3 || counts.len() > SYMBOLS {
                    break;
                }
            }
        }
    }
    let used = bits.at.div_ceil(8);
    let fits = left == 1 && counts.len() <= SYMBOLS && used <= coded.len();
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
