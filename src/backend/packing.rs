//! Residuals as bytes, arranged so that general-purpose back-ends find their similarities. FORMAT.md 8.13.

use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// How residuals are arranged as bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Two's complement, 32 bits, little-endian: as in a program's memory.
    Words,
    /// Zigzag (0, -1, 1, -2, ...), each in as many bytes as the largest needs, little-endian.
    Zigzag,
    /// As `Zigzag`, but first the lowest bytes of all, then the next bytes, and so on.
    Planes,
    /// Zigzag, one byte each; 255 stands for 255 and more, with the excess of each as a varint at the end.
    Escape,
    /// Zigzag varints (LEB128).
    Varint,
}

/// The byte that [`Packing::Escape`] uses as its escape.
const ESCAPE: u32 = 255;

impl Packing {
    /// All packings, in the order of their numbers.
    pub const ALL: [Packing; 5] =
        [Packing::Words, Packing::Zigzag, Packing::Planes, Packing::Escape, Packing::Varint];

    /// The packing's name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Packing::Words => "words",
            Packing::Zigzag => "zigzag",
            Packing::Planes => "planes",
            Packing::Escape => "escape",
            Packing::Varint => "varint",
        }
    }

    /// The packing's number in the stream.
    pub fn to_code(self) -> u8 {
        self as u8
    }

    /// The packing with this number, if there is one.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// An upper limit of the packed bytes of `count` residuals, for every packing.
    pub fn most_bytes(count: usize) -> usize {
        count.saturating_mul(6).saturating_add(1)
    }

    /// Packs residuals into bytes.
    pub fn pack(self, residuals: &[i32]) -> Vec<u8> {
        let mut out = Vec::with_capacity(residuals.len() * 2);
        match self {
            Packing::Words => residuals.iter().for_each(|value| out.extend(value.to_le_bytes())),
            Packing::Zigzag => {
                let width = start_width(residuals, &mut out);
                residuals.iter().for_each(|&value| out.extend(&zigzag(value).to_le_bytes()[..width]));
            }
            Packing::Planes => {
                let width = start_width(residuals, &mut out);
                for byte in 0..width {
                    out.extend(residuals.iter().map(|&value| zigzag(value).to_le_bytes()[byte]));
                }
            }
            Packing::Escape => {
                out.extend(residuals.iter().map(|&value| zigzag(value).min(ESCAPE) as u8));
                for &value in residuals {
                    if let Some(excess) = zigzag(value).checked_sub(ESCAPE) {
                        write_unsigned(&mut out, u64::from(excess));
                    }
                }
            }
            Packing::Varint => {
                residuals.iter().for_each(|&value| write_unsigned(&mut out, u64::from(zigzag(value))));
            }
        }
        out
    }

    /// Unpacks `count` residuals from bytes.
    ///
    /// # Errors
    /// If the bytes do not hold exactly that many.
    pub fn unpack(self, bytes: &[u8], count: usize) -> Result<Vec<i32>> {
        let wrong = || Error::corrupt(format!("{} bytes do not hold {count} residuals", bytes.len()));
        match self {
            Packing::Words => {
                let (words, rest) = bytes.as_chunks::<4>();
                let fits = words.len() == count && rest.is_empty();
                fits.then(|| words.iter().map(|word| i32::from_le_bytes(*word)).collect()).ok_or_else(wrong)
            }
            Packing::Zigzag => {
                let (width, body) = take_width(bytes, count).ok_or_else(wrong)?;
                let value = |i: usize| (0..width).map(move |byte| body[i * width + byte]);
                Ok((0..count).map(|i| from_bytes(value(i))).collect())
            }
            Packing::Planes => {
                let (width, body) = take_width(bytes, count).ok_or_else(wrong)?;
                let value = |i: usize| (0..width).map(move |byte| body[byte * count + i]);
                Ok((0..count).map(|i| from_bytes(value(i))).collect())
            }
            Packing::Escape => {
                let (small, mut excess) = bytes.split_at_checked(count).ok_or_else(wrong)?;
                let read = |&byte: &u8| match u32::from(byte) {
                    ESCAPE => Ok(unzigzag(read_zigzag(&mut excess)?.checked_add(ESCAPE).ok_or_else(wrong)?)),
                    value => Ok(unzigzag(value)),
                };
                let residuals = small.iter().map(read).collect::<Result<_>>()?;
                if excess.is_empty() { Ok(residuals) } else { Err(wrong()) }
            }
            Packing::Varint => {
                let mut input = bytes;
                let residuals =
                    (0..count).map(|_| Ok(unzigzag(read_zigzag(&mut input)?))).collect::<Result<_>>()?;
                if input.is_empty() { Ok(residuals) } else { Err(wrong()) }
            }
        }
    }
}

/// Writes the number of bytes that the largest residual needs.
fn start_width(residuals: &[i32], out: &mut Vec<u8>) -> usize {
    let all = residuals.iter().fold(0, |bits, &value| bits | zigzag(value));
    let width = (32 - all.leading_zeros()).div_ceil(8);
    out.push(width as u8);
    width as usize
}

/// The width that [`start_width`] wrote, and the bytes that follow it, if their number is right.
fn take_width(bytes: &[u8], count: usize) -> Option<(usize, &[u8])> {
    let (&width, body) = bytes.split_first()?;
    let width = usize::from(width);
    (width <= 4 && Some(body.len()) == count.checked_mul(width)).then_some((width, body))
}

fn from_bytes(bytes: impl Iterator<Item = u8>) -> i32 {
    unzigzag(bytes.zip(0..).fold(0, |value, (byte, place)| value | u32::from(byte) << (8 * place)))
}

fn zigzag(value: i32) -> u32 {
    (value << 1 ^ value >> 31) as u32
}

fn unzigzag(value: u32) -> i32 {
    (value >> 1) as i32 ^ -((value & 1) as i32)
}

fn read_zigzag(input: &mut &[u8]) -> Result<u32> {
    let value = read_unsigned(input, "residual")?;
    u32::try_from(value).map_err(|_| Error::corrupt("a residual is out of range"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers_and_layouts() {
        for packing in Packing::ALL {
            assert_eq!(Packing::from_code(packing.to_code()), Some(packing));
        }
        assert_eq!(Packing::from_code(5), None);
        assert_eq!(Packing::Planes.pack(&[1, -1, 200]), [2, 2, 1, 144, 0, 0, 1]);
        assert_eq!(Packing::Zigzag.pack(&[1, -1, 200]), [2, 2, 0, 1, 0, 144, 1]);
        assert_eq!(Packing::Escape.pack(&[1, -1, 200]), [2, 1, 255, 145, 1]);
        assert_eq!(Packing::Planes.pack(&[0, 0]), [0]);
    }

    proptest! {
        #[test]
        fn all_residuals_come_back(
            residuals in prop::collection::vec(prop_oneof![-300..300, any::<i32>()], 0..50)
        ) {
            for packing in Packing::ALL {
                let packed = packing.pack(&residuals);
                prop_assert!(packed.len() <= Packing::most_bytes(residuals.len()));
                prop_assert_eq!(packing.unpack(&packed, residuals.len()).unwrap(), residuals.clone());
            }
        }

        #[test]
        fn other_bytes_are_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..40), count in 0usize..20) {
            for packing in Packing::ALL {
                if let Ok(residuals) = packing.unpack(&bytes, count) {
                    prop_assert_eq!(residuals.len(), count);
                }
            }
        }
    }
}
