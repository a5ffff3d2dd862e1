//! JPEG 2000 (ITU-T T.800), by OpenJPEG translated to Rust (crates `openjp2` and `jpeg2k`), for one pass.
//! FORMAT.md 8.14.
//!
//! The 5/3 wavelet is used at every rate: it works on integers, so that all decoders return the same samples;
//! it can be lossless; and it leaves 1 to 20 % less error on range images than the 9/7 wavelet. The payload
//! is one byte each for the bits of a sample and the number of resolutions, then the packets. The main header
//! of the codestream (annex A) follows from data that the decoder has, so it is not in the stream and cannot
//! be damaged: one tile of one component, one layer, code-blocks of 64 x 64, the reversible wavelet.

mod library;

use super::plane::Plane;
use super::recurrent::{Pass, PassKind};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// The largest number of bits of a sample, including its sign: the library has 32, of which the wavelet takes
/// 2 and the error estimate 6.
const MOST_BITS: u8 = 22;
/// Number of resolutions for smooth images. More make hardly any difference.
const RESOLUTIONS: u32 = 6;

/// Codes a plane in one pass, within `most_bytes` or losslessly; `None` if `most_bytes` cannot hold an image.
///
/// An early pass does not use the wavelet: it codes isolated values, such as those at the edges of objects.
/// The rest is smooth and suits the wavelet. In lossless coding, the smaller result is used.
///
/// # Errors
/// If the library fails.
pub fn encode(plane: &Plane<'_>, kind: PassKind, most_bytes: Option<usize>) -> Result<Option<Pass>> {
    let by_wavelet = || encode_values(&plane.interpolated(), middle(plane), RESOLUTIONS, most_bytes);
    let apart = || {
        let median = plane.median();
        encode_values(&plane.padded(median), median, 1, most_bytes)
    };
    match (kind, most_bytes) {
        (PassKind::Early, _) => apart(),
        (PassKind::Last, Some(_)) => by_wavelet(),
        (PassKind::Last, None) => {
            let passes = [apart()?, by_wavelet()?].into_iter().flatten();
            Ok(passes.min_by_key(|pass| pass.image.len()))
        }
    }
}

fn middle(plane: &Plane<'_>) -> i32 {
    let (least, greatest) = plane.extremes();
    ((i64::from(least) + i64::from(greatest)) / 2) as i32
}

/// Codes values minus their centre, in steps of 1 if they then fit into [`MOST_BITS`].
fn encode_values(
    values: &Grid<i32>,
    centre: i32,
    resolutions: u32,
    most_bytes: Option<usize>,
) -> Result<Option<Pass>> {
    let (rows, columns) = (values.rows(), values.columns());
    let above = |value: &i32| i64::from(*value) - i64::from(centre);
    let bits = values.cells().iter().map(|value| bits(above(value))).max().unwrap_or(1);
    let shift = bits.saturating_sub(MOST_BITS);
    // Half a step is added for rounding; at the upper limit that would need another bit.
    let most = (1 << (MOST_BITS - 1)) - 1;
    let samples = values.map(|value| ((above(value) + ((1 << shift) >> 1)) >> shift).min(most) as i32);

    let levels = rows.min(columns).checked_ilog2().unwrap_or(0);
    let shape = Shape::new(rows, columns, bits.min(MOST_BITS), resolutions.min(levels + 1) as u8)?;
    let empty = shape.header(0).len() + END.len();
    let Some(stream) = library::encode(&samples, shape, most_bytes.map(|bytes| bytes + empty)) else {
        // It also fails if there is no room for the smallest image.
        return most_bytes.map(|_| None).ok_or_else(|| Error::corrupt("the JPEG 2000 library failed"));
    };
    let packets = packets(&stream).ok_or_else(|| Error::corrupt("the JPEG 2000 library wrote no image"))?;
    let image = [&[shape.precision, shape.resolutions], packets].concat();
    let fits = most_bytes.is_none_or(|bytes| image.len() <= bytes);
    Ok(fits.then_some(Pass { centre, step: 1 << shift, image }))
}

/// Bits of a value, including its sign.
fn bits(value: i64) -> u8 {
    (65 - (if value < 0 { !value } else { value }).leading_zeros()) as u8
}

/// The part between the headers and the end of a codestream with one tile-part.
fn packets(stream: &[u8]) -> Option<&[u8]> {
    const START_OF_DATA: [u8; 2] = [0xff, 0x93];
    let header = stream.windows(2).position(|bytes| bytes == START_OF_DATA)?;
    stream[header + START_OF_DATA.len()..].strip_suffix(&END)
}

/// The samples of an image.
///
/// # Errors
/// If it is damaged in a way that the library detects.
pub fn decode(image: &[u8], rows: usize, columns: usize) -> Result<Grid<i32>> {
    let damaged = |what: &str| Error::corrupt(format!("JPEG 2000: {what}"));
    let &[precision, resolutions, ref packets @ ..] = image else {
        return Err(damaged("no image"));
    };
    let shape = Shape::new(rows, columns, precision, resolutions)?;
    let stream = [&shape.header(packets.len())[..], packets, &END].concat();
    let decoded = jpeg2k::Image::from_bytes(&stream).map_err(|error| damaged(&error.to_string()))?;
    let component = decoded.components().first().ok_or_else(|| damaged("no component"))?;
    let samples = component.data();
    if samples.len() != rows * columns {
        return Err(damaged("of another size"));
    }
    let mut grid = Grid::new(rows, columns);
    samples.chunks(columns).enumerate().for_each(|(row, samples)| grid.row_mut(row).copy_from_slice(samples));
    Ok(grid)
}

/// The end marker of the codestream.
const END: [u8; 2] = [0xff, 0xd9];

/// Bits of headroom in each sub-band, as in OpenJPEG.
const GUARD_BITS: u8 = 2;

/// The properties that determine the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    /// Rows of samples.
    rows: u32,
    /// Samples in a row.
    columns: u32,
    /// Bits of a sample, including its sign.
    precision: u8,
    /// One more than the number of times the wavelet is applied.
    resolutions: u8,
}

impl Shape {
    /// The shape of an image of this size.
    ///
    /// # Errors
    /// If there is no such image.
    fn new(rows: usize, columns: usize, precision: u8, resolutions: u8) -> Result<Self> {
        let wrong = || Error::corrupt("JPEG 2000: no such image");
        let side = |length: usize| u32::try_from(length).map_err(|_| wrong());
        let most = rows.min(columns).checked_ilog2().ok_or_else(wrong)? + 1;
        if !(1..=MOST_BITS).contains(&precision) || !(1..=most).contains(&u32::from(resolutions)) {
            return Err(wrong());
        }
        Ok(Shape { rows: side(rows)?, columns: side(columns)?, precision, resolutions })
    }

    /// All bytes before the packets, which take `packet_bytes` bytes.
    fn header(self, packet_bytes: usize) -> Vec<u8> {
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
    use super::*;
    use crate::ground::grid::Grid;

    /// The format's rule for coefficients whose last bits are missing; without a wavelet, nothing else is
    /// lost.
    #[test]
    fn missing_bits_are_taken_for_half() {
        let mut samples: Grid<i32> = Grid::new(64, 130);
        for row in 0..64 {
            (0..)
                .zip(samples.row_mut(row))
                .for_each(|(i, value)| *value = (i * i * 37 + i * row as i32) % 9001 - 4500);
        }
        let mut coarser = 0;
        for most_bytes in [500, 4000, 9000] {
            let pass = encode_values(&samples, 0, 1, Some(most_bytes)).unwrap().unwrap();
            let decoded = decode(&pass.image, 64, 130).unwrap();
            for (value, decoded) in samples.cells().iter().zip(decoded.cells()) {
                let is_middle = |bits: u32| {
                    let known = value.abs() >> bits;
                    known > 0 && *decoded == value.signum() * ((known << bits) + (1 << bits) / 2)
                };
                assert!(*decoded == 0 || (0..14).any(is_middle), "{value} became {decoded}");
                coarser += usize::from(decoded != value);
            }
        }
        assert!(coarser > 5000);
    }

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
