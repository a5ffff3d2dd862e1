//! Finds the intact records of a damaged stream, wherever they are.
//!
//! A record may start at any byte, and checking a candidate takes a checksum over its whole length. To avoid
//! time quadratic in the stream's size, one checksum runs over the whole stream, and that of a long record is
//! computed from its values at the record's two ends.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io::{Read, Seek, SeekFrom};

use super::group::{NAME_MAX, TRACKS_MAX};
use super::record::{END, GROUP, INDEX, RawRecord, SCANNER, read_record};
use crate::ground::error::{Limits, Result};
use crate::ground::varint::read_unsigned;

/// Bytes that are examined around each offset. Records that fit are checked on their own.
const WINDOW: usize = 1 << 13;

/// Bytes that are read at a time.
const CHUNK: usize = 1 << 16;

/// The largest number of long candidates that may overlap. Only streams made to use up memory have more.
const MOST_OPEN: usize = 1 << 16;

/// Limit of the bytes read in vain for candidates that turn out not to be records, as a multiple of the
/// stream's size. Only streams made to use up time exceed it.
const PATIENCE: u64 = 8;

/// Bytes of the shortest meaningful record: kind, length, two numbers, checksum.
const SHORTEST: usize = 2 + 2 + 4;

/// An intact record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FoundRecord {
    /// Offset from the start of the stream, in bytes.
    pub offset: u64,
    /// Bytes of the whole record.
    pub length: u64,
    pub kind: u8,
    /// Its checksum.
    pub crc: u32,
}

impl FoundRecord {
    pub fn end(&self) -> u64 {
        self.offset + self.length
    }
}

/// Finds all records of the kinds 1 to 4 whose checksum matches and whose payload passes `is_one` for the
/// kind (sections have the same structure as records), in order. Of two overlapping records the one that
/// starts first counts: records inside a record are not searched for.
pub(super) fn find_records<R: Read + Seek>(
    input: &mut R,
    start: u64,
    limits: &Limits,
    is_one: impl Fn(&RawRecord) -> bool,
) -> Result<Vec<FoundRecord>> {
    let size = input.seek(SeekFrom::End(0))?;
    input.seek(SeekFrom::Start(start.min(size)))?;
    let mut sweep =
        Sweep { position: start, crc: 0, shifts: Shifts::new(), open: BinaryHeap::new(), found: Vec::new() };
    let mut buffer = Vec::new();
    let mut at_end = false;
    while !at_end || !buffer.is_empty() {
        if !at_end && buffer.len() < WINDOW {
            at_end = input.by_ref().take(CHUNK as u64).read_to_end(&mut buffer)? < CHUNK;
            continue;
        }
        // The last window is kept and examined again with the bytes that follow.
        let done = if at_end { buffer.len() } else { buffer.len() - WINDOW + 1 };
        sweep.pass(&buffer, done, size, limits);
        buffer.drain(..done);
    }
    sweep.found.sort_unstable();
    let (mut records, mut end, mut patience) = (Vec::new(), start, PATIENCE * size);
    for found in sweep.found {
        if found.offset < end || found.length > patience {
            continue;
        }
        input.seek(SeekFrom::Start(found.offset))?;
        if is_one(&read_record(input, limits)?) {
            end = found.end();
            records.push(found);
        } else {
            patience -= found.length;
        }
    }
    Ok(records)
}

/// A long candidate, and the running checksum `crc` at its start. Ordered by its end.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct OpenRecord {
    /// Offset of its checksum.
    end: u64,
    record: FoundRecord,
    crc: u32,
}

/// One pass over the stream.
struct Sweep {
    /// The offset that the running checksum has reached.
    position: u64,
    /// Checksum of all bytes from the start of the pass.
    crc: u32,
    shifts: Shifts,
    open: BinaryHeap<Reverse<OpenRecord>>,
    found: Vec<FoundRecord>,
}

impl Sweep {
    /// Examines the first `done` offsets of `bytes`, which begin at the pass's position.
    fn pass(&mut self, bytes: &[u8], done: usize, size: u64, limits: &Limits) {
        let base = self.position;
        for place in 0..done {
            let offset = base + place as u64;
            while self.open.peek().is_some_and(|Reverse(open)| open.end == offset) {
                self.close(&bytes[(offset - base) as usize..], base, bytes);
            }
            let Some((record, head)) = begin(&bytes[place..], offset, size, limits) else { continue };
            let end = record.end() - 4;
            if let Some(all) = bytes[place..].get(..record.length as usize).filter(|all| all.len() <= WINDOW)
            {
                let (covered, stored) = all.split_at(all.len() - 4);
                let crc = crc32c::crc32c(covered);
                if crc.to_le_bytes() == stored {
                    self.found.push(FoundRecord { crc, ..record });
                }
            } else if self.open.len() < MOST_OPEN && may_be(&record, head, &bytes[place..]) {
                self.advance(base, bytes, offset);
                self.open.push(Reverse(OpenRecord { end, record, crc: self.crc }));
            }
        }
        self.advance(base, bytes, base + done as u64);
    }

    /// Continues the running checksum up to `offset`.
    fn advance(&mut self, base: u64, bytes: &[u8], offset: u64) {
        let (from, to) = ((self.position - base) as usize, (offset - base) as usize);
        self.crc = crc32c::crc32c_append(self.crc, &bytes[from..to]);
        self.position = offset;
    }

    /// Checks the open candidate whose checksum is at the front of `rest`.
    fn close(&mut self, rest: &[u8], base: u64, bytes: &[u8]) {
        let Some(Reverse(OpenRecord { end, record, crc })) = self.open.pop() else { return };
        self.advance(base, bytes, end);
        // The checksum of the bytes since then: that of all bytes, minus the contribution of the bytes
        // before.
        let crc = self.crc ^ self.shifts.apply(crc, end - record.offset);
        if rest.starts_with(&crc.to_le_bytes()) {
            self.found.push(FoundRecord { crc, ..record });
        }
    }
}

/// The effect of following bytes on the part of a checksum that comes from the bytes before them: each
/// multiplies it by x^8, modulo the polynomial of the CRC.
struct Shifts {
    /// x^(2^n).
    powers: [u32; 64],
}

impl Shifts {
    fn new() -> Self {
        let mut powers = [1 << 30; 64];
        for n in 1..64 {
            powers[n] = multiply(powers[n - 1], powers[n - 1]);
        }
        Shifts { powers }
    }

    /// `crc` after this many zero bytes, minus the checksum of the zeros alone.
    fn apply(&self, mut crc: u32, bytes: u64) -> u32 {
        for n in (0..61).filter(|n| bytes >> n & 1 == 1) {
            crc = multiply(self.powers[n + 3], crc);
        }
        crc
    }
}

/// The product of two polynomials over bits, modulo that of CRC-32C; the top bit is the coefficient of x^0.
fn multiply(a: u32, mut b: u32) -> u32 {
    let mut product = 0;
    for bit in (0..32).rev() {
        product ^= b & 0u32.wrapping_sub(a >> bit & 1);
        b = b >> 1 ^ 0x82f6_3b78 & 0u32.wrapping_sub(b & 1);
    }
    product
}

/// A candidate that begins here, with its checksum still unchecked, and the number of bytes before its
/// payload.
fn begin(bytes: &[u8], offset: u64, size: u64, limits: &Limits) -> Option<(FoundRecord, usize)> {
    let (&kind, mut rest) = bytes.split_first()?;
    if !matches!(kind, SCANNER | GROUP | INDEX | END) || bytes.len() < SHORTEST {
        return None;
    }
    let before = rest.len();
    let payload = read_unsigned(&mut rest, "length").ok().filter(|length| *length <= limits.record_bytes)?;
    let head = 1 + before - rest.len();
    let record = FoundRecord { offset, length: head as u64 + payload + 4, kind, crc: 0 };
    (record.end() <= size).then_some((record, head))
}

/// Whether a long candidate may be a record, judging by the first numbers of its payload.
fn may_be(record: &FoundRecord, head: usize, bytes: &[u8]) -> bool {
    let mut payload = &bytes[head..];
    let mut next = || read_unsigned(&mut payload, "number").ok();
    match record.kind {
        GROUP => {
            let Some(scanners @ 1..=TRACKS_MAX) = next() else { return false };
            // The references to the scanners, and the number of frames.
            if (0..=scanners).any(|_| next().is_none()) {
                return false;
            }
            let Some(name_length) = next() else { return false };
            let name = usize::try_from(name_length).ok().and_then(|length| payload.get(..length));
            name_length <= NAME_MAX && name.is_some_and(|name| std::str::from_utf8(name).is_ok())
        }
        INDEX => {
            // The number of scanners, then the checksum of the first, which may be anything, or the number of
            // groups. Both numbers are limited by the offset of the record.
            let Some(scanners) = next() else { return false };
            let is_possible = |number| number < record.offset;
            is_possible(scanners) && (scanners > 0 || next().is_some_and(is_possible))
        }
        SCANNER => {
            let (Some(_), Some(length)) = (next(), next()) else { return false };
            let before = (bytes.len() - payload.len()) as u64;
            before.checked_add(length) == Some(record.length - 4)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::super::record::write_record;
    use super::*;
    use crate::ground::varint::write_unsigned;

    fn find(bytes: &[u8]) -> Vec<(u64, u8)> {
        let found = find_records(&mut Cursor::new(bytes), 0, &Limits::default(), |_| true).unwrap();
        found.iter().map(|record| (record.offset, record.kind)).collect()
    }

    /// A payload of `length` bytes that the search accepts as a group's.
    fn group(length: usize) -> Vec<u8> {
        let mut payload = vec![1, 0, 1, 1, b'a'];
        payload.extend((5..length).map(|place| (place * 7 % 251) as u8));
        payload
    }

    #[test]
    fn records_of_any_length_are_found_between_any_bytes() {
        let noise = |length: u32| (0..length).map(|n| (n.wrapping_mul(2_654_435_761) >> 23) as u8);
        for length in [5, 100, WINDOW - 20, WINDOW, WINDOW + 1, CHUNK, 3 * CHUNK + 5] {
            for before in [0, 1, 3000, CHUNK as u32 - 3, CHUNK as u32 + 9000] {
                let mut bytes: Vec<u8> = noise(before).collect();
                write_record(&mut bytes, GROUP, &group(length)).unwrap();
                bytes.extend(noise(300));
                let second = bytes.len() as u64;
                write_record(&mut bytes, SCANNER, &group(50)).unwrap();
                assert_eq!(find(&bytes), [(u64::from(before), GROUP), (second, SCANNER)]);
            }
        }
    }

    #[test]
    fn groups_are_found_whatever_their_first_name() {
        for name in ["ü".repeat(NAME_MAX as usize / 2), "n".repeat(256)] {
            // One scanner, none in particular, one frame, the length of its name.
            let mut payload = vec![1, 0, 1];
            write_unsigned(&mut payload, name.len() as u64);
            payload.extend(name.as_bytes());
            payload.extend([7; CHUNK]);
            let mut bytes = vec![9; 40];
            write_record(&mut bytes, GROUP, &payload).unwrap();
            assert_eq!(find(&bytes), [(40, GROUP)]);
        }
    }

    #[test]
    fn indexes_are_found_whatever_the_checksum_of_their_first_scanner() {
        for checksum in [[0x80, 0, 1, 2], [0xff; 4], [0; 4]] {
            let payload = [&[1][..], &checksum, &[0x80; 3 * WINDOW]].concat();
            let mut bytes = vec![9; 40];
            write_record(&mut bytes, INDEX, &payload).unwrap();
            assert_eq!(find(&bytes), [(40, INDEX)]);
        }
    }

    #[test]
    fn a_record_inside_a_record_is_not_one() {
        let mut inner = group(10_000);
        write_record(&mut inner, SCANNER, &[7; 30]).unwrap();
        let mut bytes = vec![9; 40];
        write_record(&mut bytes, GROUP, &[&inner[..], &[1; 20_000]].concat()).unwrap();
        assert_eq!(find(&bytes), [(40, GROUP)]);
        // If the outer record is damaged, the inner one is found.
        bytes[45] ^= 1;
        assert_eq!(find(&bytes).len(), 1);
        assert_ne!(find(&bytes), [(40, GROUP)]);
    }

    #[test]
    fn a_stream_that_looks_like_records_everywhere_takes_no_long_time() {
        // A long candidate at every fourth byte: 1.5 * 10^11 bytes of checksums if each were computed
        // separately.
        let bytes: Vec<u8> = [SCANNER, 0x80, 0x80, 0x10].into_iter().cycle().take(1 << 20).collect();
        assert_eq!(find(&bytes), []);
    }
}
