//! Columns coded by a general-purpose coder after their bytes are arranged for it. FORMAT.md 8.17.

use crate::backend::{self, Compressors, LZMA, ZSTD, may_lzma_pay};
use crate::entropy::{BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::scan::ScalarType;

/// How the bytes of records are arranged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrangement {
    /// Unchanged.
    Records,
    /// The first byte of every record, then the second, ...
    Planes,
    /// As [`Planes`](Self::Planes), of each value's difference from the value of the record before.
    Differences,
}

impl Arrangement {
    /// All arrangements, in the order of their numbers.
    pub const ALL: [Arrangement; 3] = [Arrangement::Records, Arrangement::Planes, Arrangement::Differences];

    /// Arranges records of `width` bytes with values of this type.
    pub fn apply(self, bytes: &[u8], scalar: ScalarType, width: usize) -> Vec<u8> {
        match self {
            Arrangement::Records => bytes.to_vec(),
            Arrangement::Planes => planes(bytes, width),
            Arrangement::Differences => {
                let mut differences = bytes.to_vec();
                let size = scalar.size() as usize;
                for at in (width..bytes.len()).step_by(size) {
                    let value =
                        number(&bytes[at..at + size]).wrapping_sub(number(&bytes[at - width..][..size]));
                    differences[at..at + size].copy_from_slice(&value.to_le_bytes()[..size]);
                }
                planes(&differences, width)
            }
        }
    }

    /// The inverse of [`apply`](Self::apply).
    pub fn undo(self, arranged: &[u8], scalar: ScalarType, width: usize, bytes: &mut [u8]) {
        if self == Arrangement::Records {
            bytes.copy_from_slice(arranged);
            return;
        }
        let records = bytes.len() / width.max(1);
        for (at, plane) in arranged.chunks_exact(records.max(1)).enumerate() {
            bytes.iter_mut().skip(at).step_by(width).zip(plane).for_each(|(to, from)| *to = *from);
        }
        if self == Arrangement::Differences {
            let size = scalar.size() as usize;
            for at in (width..bytes.len()).step_by(size) {
                let value = number(&bytes[at..at + size]).wrapping_add(number(&bytes[at - width..][..size]));
                bytes[at..at + size].copy_from_slice(&value.to_le_bytes()[..size]);
            }
        }
    }
}

fn planes(bytes: &[u8], width: usize) -> Vec<u8> {
    (0..width).flat_map(|at| bytes.iter().skip(at).step_by(width)).copied().collect()
}

/// The number in up to eight little-endian bytes.
fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

/// Records compressed by a general-purpose coder.
pub struct Compressed {
    backend: u8,
    arrangement: Arrangement,
    payload: Vec<u8>,
}

impl Compressed {
    /// The shortest way; slow ones are tried only if they may take fewer than `most` bytes. `None` if `most`
    /// is small anyway.
    pub fn shortest(
        bytes: &[u8],
        scalar: ScalarType,
        width: usize,
        compressors: Compressors,
        most: usize,
    ) -> Option<Self> {
        /// In 16ths of a byte per record: records that take less than this are explained by the models.
        const EXPLAINED: usize = 1;
        /// In bytes.
        const SMALL: usize = 1000;
        /// Records of a sample. Fewer than four times as many are not sampled.
        const SAMPLE: usize = 4096;
        let records = bytes.len() / width.max(1);
        if most < SMALL || most < records * EXPLAINED / 16 {
            return None;
        }
        let arranged = Arrangement::ALL.map(|arrangement| arrangement.apply(bytes, scalar, width));
        let quick = arranged.iter().map(|bytes| backend::compress_quickly(bytes).ok());
        // The arrangement that suits one coder usually suits the other.
        let quick = quick.enumerate().filter_map(|(at, payload)| Some((at, payload?)));
        let (best, payload) = quick.min_by_key(|(_, payload)| payload.len())?;
        let mut compressed = Compressed { backend: ZSTD, arrangement: Arrangement::ALL[best], payload };
        let sample = || {
            let at = (records >= 4 * SAMPLE).then(|| (records - SAMPLE) / 2)?;
            Some(Arrangement::ALL[best].apply(&bytes[at * width..][..SAMPLE * width], scalar, width))
        };
        if compressors != Compressors::Fast && may_lzma_pay(compressed.payload.len(), most, sample) {
            let tried = (0..arranged.len()).filter(|&at| at == best || compressors == Compressors::All);
            for at in tried {
                let payload = backend::compress_hardest(&arranged[at]).ok()?;
                if payload.len() < compressed.payload.len() {
                    compressed = Compressed { backend: LZMA, arrangement: Arrangement::ALL[at], payload };
                }
            }
        }
        Some(compressed)
    }

    /// Number of bytes that it takes.
    pub fn size(&self) -> usize {
        /// Size of the numbers before the payload, in bytes.
        const HEADER: usize = 8;
        self.payload.len() + HEADER
    }
}

/// Codes records that a general-purpose coder has compressed. A decoder passes zeros of the same length, and
/// `None` for `compressed`.
///
/// # Errors
/// If a decoder's input is damaged.
pub fn code_compressed<C: BitCoder>(
    coder: &mut C,
    compressed: Option<Compressed>,
    scalar: ScalarType,
    width: usize,
    bytes: &mut [u8],
) -> Result<()> {
    let mut compressed = compressed.unwrap_or(Compressed {
        backend: 0,
        arrangement: Arrangement::Records,
        payload: Vec::new(),
    });
    let backend = coder.code_plain(compressed.backend.into(), 8) as u8;
    let arrangement = coder.code_plain(compressed.arrangement as u64, 8) as usize;
    let arrangement = Arrangement::ALL.get(arrangement);
    let arrangement =
        arrangement.ok_or_else(|| Error::unsupported("compressed bytes: unknown arrangement"))?;
    code_payload(coder, &mut compressed.payload)?;
    if !C::ENCODES {
        let arranged = backend::decompress(backend::by_id(backend)?, &compressed.payload, bytes.len())?;
        arrangement.undo(&arranged, scalar, width, bytes);
    }
    Ok(())
}

/// Codes bytes that are already compressed, and their number.
fn code_payload<C: BitCoder>(coder: &mut C, payload: &mut Vec<u8>) -> Result<()> {
    let length = IntegerModel::default().code(coder, payload.len() as u64);
    // Each takes eight bits, as compressed bytes are all equally likely.
    if length > coder.most_bits() / 8 || length > usize::MAX as u64 / 2 {
        return Err(Error::corrupt("compressed bytes: more than the section can hold"));
    }
    if C::ENCODES {
        payload.iter().for_each(|&byte| {
            coder.code_plain(byte.into(), 8);
        });
        return Ok(());
    }
    for _ in 0..length {
        if coder.is_exhausted() {
            return Err(Error::corrupt("compressed bytes: cut short"));
        }
        payload.push(coder.code_plain(0, 8) as u8);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn arrangements_are_undone(values: Vec<u8>, number in 0u8..10, count in 1usize..4) {
            let scalar = ScalarType::from_number(number).unwrap();
            let width = scalar.size() as usize * count;
            let bytes = &values[..values.len() / width * width];
            for arrangement in Arrangement::ALL {
                let mut again = vec![0; bytes.len()];
                arrangement.undo(&arrangement.apply(bytes, scalar, width), scalar, width, &mut again);
                prop_assert_eq!(&again[..], bytes);
            }
        }
    }
}
