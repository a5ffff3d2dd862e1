//! The main header of the codestream (ITU-T T.800, annex A). It follows from data that the decoder has, so it
//! is not in the stream and cannot be damaged: one tile of one component, one layer, code-blocks of 64 x 64,
//! the reversible wavelet. FORMAT.md 8.14.

use super::MOST_BITS;
use crate::ground::error::{Error, Result};

/// The end marker of the codestream.
pub const END: [u8; 2] = [0xff, 0xd9];

/// Bits of headroom in each sub-band, as in OpenJPEG.
const GUARD_BITS: u8 = 2;

/// The properties that determine the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Rows of samples.
    pub rows: u32,
    /// Samples in a row.
    pub columns: u32,
    /// Bits of a sample, including its sign.
    pub precision: u8,
    /// One more than the number of times the wavelet is applied.
    pub resolutions: u8,
}

impl Shape {
    /// The shape of an image of this size.
    ///
    /// # Errors
    /// If there is no such image.
    pub fn new(rows: usize, columns: usize, precision: u8, resolutions: u8) -> Result<Self> {
        let wrong = || Error::corrupt("JPEG 2000: no such image");
        let side = |length: usize| u32::try_from(length).map_err(|_| wrong());
        let most = rows.min(columns).checked_ilog2().ok_or_else(wrong)? + 1;
        if !(1..=MOST_BITS).contains(&precision) || !(1..=most).contains(&u32::from(resolutions)) {
            return Err(wrong());
        }
        Ok(Shape { rows: side(rows)?, columns: side(columns)?, precision, resolutions })
    }

    /// All bytes before the packets, which take `packet_bytes` bytes.
    pub fn header(self, packet_bytes: usize) -> Vec<u8> {
        let Shape { rows, columns, precision, resolutions } = self;
        let levels = resolutions - 1;
        let mut out = vec![0xff, 0x4f]; // SOC
        segment(&mut out, 0x51, |out| {
            out.extend([0, 0]); // No capabilities beyond the base.
            let size = [columns, rows, 0, 0]; // Of the image, and of the only tile.
            [size, size].as_flattened().iter().for_each(|number| out.extend(number.to_be_bytes()));
            out.extend([0, 1, 0x80 | (precision - 1), 1, 1]);
        });
        // Progression by layers, of which there is one; 2^(4 + 2) x 2^(4 + 2) cells in a code-block.
        segment(&mut out, 0x52, |out| out.extend([0, 0, 0, 1, 0, levels, 4, 4, 0, 1]));
        segment(&mut out, 0x5c, |out| {
            out.push(GUARD_BITS << 5);
            out.push(precision << 3);
            // The sub-bands HL, LH and HH of each level.
            (0..levels).for_each(|_| out.extend([1, 1, 2].map(|gain| (precision + gain) << 3)));
        });
        let tile_part = (12 + 2 + packet_bytes) as u32;
        segment(&mut out, 0x90, |out| {
            out.extend([0, 0]);
            out.extend(tile_part.to_be_bytes());
            out.extend([0, 1]);
        });
        out.extend([0xff, 0x93]); // SOD
        out
    }
}

/// A marker segment: SIZ, COD, QCD or SOT.
fn segment(out: &mut Vec<u8>, marker: u8, fill: impl FnOnce(&mut Vec<u8>)) {
    out.extend([0xff, marker]);
    let start = out.len();
    out.extend([0, 0]);
    fill(out);
    let length = (out.len() - start) as u16;
    out[start..start + 2].copy_from_slice(&length.to_be_bytes());
}

#[cfg(test)]
mod tests {
    use super::super::{library, packets};
    use super::*;
    use crate::ground::grid::Grid;

    #[test]
    fn the_header_is_the_librarys_but_for_its_comment() {
        for (rows, columns, resolutions) in [(64, 200, 1), (64, 200, 6), (10, 17, 4), (1, 1, 1), (1, 90, 1)] {
            let mut samples: Grid<i32> = Grid::new(rows, columns);
            for row in 0..rows {
                (0..)
                    .zip(samples.row_mut(row))
                    .for_each(|(i, value)| *value = (i * i * 7 + row as i32) % 999 - 400);
            }
            let shape = Shape::new(rows, columns, 12, resolutions).unwrap();
            let stream = library::encode(&samples, shape, None).unwrap();
            let header = shape.header(packets(&stream).unwrap().len());
            let comment = stream.windows(2).position(|bytes| bytes == [0xff, 0x64]).unwrap();
            let behind = comment + 2 + usize::from(stream[comment + 3]);
            assert!(stream.starts_with(&header[..comment]), "{shape:?}");
            assert!(stream[behind..].starts_with(&header[comment..]), "{shape:?}");
        }
    }

    #[test]
    fn shapes_that_the_library_cannot_have_are_refused() {
        assert!(Shape::new(64, 2000, MOST_BITS, 7).is_ok());
        for (rows, columns, precision, resolutions) in [
            (0, 5, 8, 1),
            (5, 0, 8, 1),
            (64, 9, 0, 1),
            (64, 9, MOST_BITS + 1, 1),
            (64, 9, 8, 0),
            (64, 9, 8, 5),
        ] {
            assert!(Shape::new(rows, columns, precision, resolutions).is_err());
        }
    }
}
