//! JPEG 2000 (ITU-T T.800), by OpenJPEG translated to Rust (crates `openjp2` and `jpeg2k`), for one pass.
//! FORMAT.md 8.14.
//!
//! The 5/3 wavelet is used at every rate: it works on integers, so that all decoders return the same samples;
//! it can be lossless; and it leaves 1 to 20 % less error on range images than the 9/7 wavelet. The payload
//! is one byte each for the bits of a sample and the number of resolutions, then the packets.

mod header;
mod library;

use self::header::{END, Shape};
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
