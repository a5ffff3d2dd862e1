//! Finds the intact records of a damaged stream, wherever they are.
//!
//! Any place may be the start of a record, and telling takes a checksum over as many bytes as its length
//! says. So that this does not take the square of the stream's size, one checksum runs over the whole
//! stream, and that of a long record is the difference of its values at the record's two ends.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io::{Read, Seek, SeekFrom};

use super::group::{NAME_MAX, TRACKS_MAX};
use super::record::{END, GROUP, INDEX, RawRecord, SCANNER, read_record};
use crate::ground::error::{Limits, Result};
use crate::ground::varint::read_unsigned;

/// Bytes that are looked at around each place. Shorter records are checked by themselves.
const WINDOW: usize = 1 << 13;

/// Bytes that are read at a time.
const CHUNK: usize = 1 << 16;

/// Long records that may be under way at the same place. More are only in streams that were made to
/// take memory.
const MOST_OPEN: usize = 1 << 16;

/// How often as many bytes as the stream has may be read in vain for records that only look like one. More
/// are only in streams that were made to take time.
const PATIENCE: u64 = 8;

/// Bytes of the shortest record that means anything: kind, length, two numbers, checksum.
const SHORTEST: usize = 2 + 2 + 4;

/// An intact record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FoundRecord {
    /// From the start of the stream, in bytes.
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

/// Finds all records of the kinds 1 to 4 whose checksum matches and whose payload `is_one` of the kind (for
/// sections are built as records are), in order. Of two that overlap, the one that starts first counts: what
/// is inside a record is not looked for.
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
        // The last window stays, to be looked at again with what follows.
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

/// A long record that began where the checksum so far was `crc`. Ordered by its end.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct OpenRecord {
    /// Where its checksum stands.
    end: u64,
    record: FoundRecord,
    crc: u32,
}

/// One way through the stream.
struct Sweep {
    /// Up to where the checksum goes.
    position: u64,
    /// Checksum of all bytes from the start of the sweep.
    crc: u32,
    shifts: Shifts,
    open: BinaryHeap<Reverse<OpenRecord>>,
    found: Vec<FoundRecord>,
}

impl Sweep {
    /// Looks at the first `done` places of `bytes`, which begin at the sweep's position.
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

    /// Runs the checksum up to `offset`.
    fn advance(&mut self, base: u64, bytes: &[u8], offset: u64) {
        let (from, to) = ((self.position - base) as usize, (offset - base) as usize);
        self.crc = crc32c::crc32c_append(self.crc, &bytes[from..to]);
        self.position = offset;
    }

    /// Judges the open record whose checksum stands at the front of `rest`.
    fn close(&mut self, rest: &[u8], base: u64, bytes: &[u8]) {
        let Some(Reverse(OpenRecord { end, record, crc })) = self.open.pop() else { return };
        self.advance(base, bytes, end);
        // The checksum of the bytes since then: that of all bytes, less what those before do to it.
        let crc = self.crc ^ self.shifts.apply(crc, end - record.offset);
        if rest.starts_with(&crc.to_le_bytes()) {
            self.found.push(FoundRecord { crc, ..record });
        }
    }
}

/// What bytes that follow do to the part of a checksum that comes from before them: each multiplies it by
/// x^8, modulo the polynomial of the CRC.
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

    /// `crc` after this many bytes of zeros, less the checksum of those.
    fn apply(&self, mut crc: u32, bytes: u64) -> u32 {
        for n in (0..61).filter(|n| bytes >> n & 1 == 1) {
            crc = multiply(self.powers[n + 3], crc);
        }
        crc
    }
}

/// The product of polynomials of bits, modulo that of CRC-32C; the top bit is that of x^0.
fn multiply(a: u32, mut b: u32) -> u32 {
    let mut product = 0;
    for bit in (0..32).rev() {
        product ^= b & 0u32.wrapping_sub(a >> bit & 1);
        b = b >> 1 ^ 0x82f6_3b78 & 0u32.wrapping_sub(b & 1);
    }
    product
}

/// A record that may begin here, its checksum yet unknown, and the length of its kind and length.
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

/// Whether a long record may be one, by the first numbers of its payload.
fn may_be(record: &FoundRecord, head: usize, bytes: &[u8]) -> bool {
    let mut payload = &bytes[head..];
    let mut next = || read_unsigned(&mut payload, "number").ok();
    match record.kind {
        GROUP => {
            let Some(scanners @ 1..=TRACKS_MAX) = next() else { return false };
            // They, and the number of the frames.
            if (0..=scanners).any(|_| next().is_none()) {
                return false;
            }
            let Some(name_length) = next() else { return false };
            let name = usize::try_from(name_length).ok().and_then(|length| payload.get(..length));
            name_length <= NAME_MAX && name.is_some_and(|name| std::str::from_utf8(name).is_ok())
        }
        INDEX => {
            // How many scanners, then the family of the first or how many groups; all of them stand before it.
            let (Some(scanners), Some(groups)) = (next(), next()) else { return false };
            scanners < record.offset && (scanners > 0 || groups < record.offset)
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

    /// The payload of a group whose only frame is called `name`, as far as the scan looks at it.
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
    fn a_record_inside_a_record_is_not_one() {
        let mut inner = group(10_000);
        write_record(&mut inner, SCANNER, &[7; 30]).unwrap();
        let mut bytes = vec![9; 40];
        write_record(&mut bytes, GROUP, &[&inner[..], &[1; 20_000]].concat()).unwrap();
        assert_eq!(find(&bytes), [(40, GROUP)]);
        // Unless the outer one is damaged: then nothing tells.
        bytes[45] ^= 1;
        assert_eq!(find(&bytes).len(), 1);
        assert_ne!(find(&bytes), [(40, GROUP)]);
    }

    #[test]
    fn a_stream_that_looks_like_records_everywhere_takes_no_long_time() {
        // A long record may begin at every fourth byte: 1.5 * 10^11 bytes of checksums, one by one.
        let bytes: Vec<u8> = [SCANNER, 0x80, 0x80, 0x10].into_iter().cycle().take(1 << 20).collect();
        assert_eq!(find(&bytes), []);
    }
}
