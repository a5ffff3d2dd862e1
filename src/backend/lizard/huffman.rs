//! Huff0, the Huffman coder of Lizard's streams (described in RFC 8878, 4.2, except for its short streams).

use super::bits::BackwardBits;
use super::fse;
use crate::backend::lz::{take, take_number};
use crate::ground::error::{Error, Result};

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
pub fn decode(coded: &[u8], length: usize) -> Result<Vec<u8>> {
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
            fse::decode(take(input, header)?, SYMBOLS - 1)?
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
