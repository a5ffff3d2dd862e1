//! JPEG (ITU-T T.81, baseline), by the crate `image`, for one pass: values are scaled to 8 bits by a step.
//! FORMAT.md 8.14.
//!
//! The payload is one byte for the quality, then the coded data of the scan. The header of the image (annex
//! B) follows from data that the decoder has, so it is not in the stream and cannot be damaged: the tables of
//! annex K, with the quantisation tables scaled by the quality as the Independent JPEG Group does.

use std::io::Cursor;

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{ExtendedColorType, ImageDecoder};

use super::ImageCodec;
use super::plane::Plane;
use super::recurrent::Pass;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// The sample value that represents the centre.
const CENTRE: i32 = 128;
/// The steps that the encoder tries next, relative to the last: larger ones leave room for a better quality,
/// smaller ones clip.
const FACTORS: [f64; 2] = [std::f64::consts::SQRT_2, std::f64::consts::FRAC_1_SQRT_2];
/// The largest step that it tries, relative to the one that scales all values to 8 bits.
const MOST_SHARE: f64 = 64.0;
/// The best quality.
const BEST: u8 = 100;

/// Codes a plane in one pass, with the step and the quality that leave the least error; `None` if
/// `most_bytes` cannot hold an image, or if no loss is allowed.
///
/// # Errors
/// If there are more rows or columns than the format allows.
pub fn encode(plane: &Plane<'_>, most_bytes: Option<usize>) -> Result<Option<Pass>> {
    let Some(most_bytes) = most_bytes else { return Ok(None) };
    let values = plane.interpolated();
    let mut best = encode_in_steps(plane, &values, 1.0, most_bytes)?;
    for factor in FACTORS {
        let mut share = factor;
        while share < MOST_SHARE {
            let next = encode_in_steps(plane, &values, share, most_bytes)?;
            let improves = match (&next, &best) {
                (Some((error, _)), Some((least, _))) => error < least,
                (next, best) => best.is_none() && (next.is_some() || factor > 1.0),
            };
            if !improves {
                break;
            }
            (best, share) = (next, share * factor);
        }
    }
    Ok(best.map(|(_, pass)| pass))
}

/// Codes with `share` times the step that scales all values to 8 bits, and the quality that leaves the least
/// error; also returns that error.
fn encode_in_steps(
    plane: &Plane<'_>,
    values: &Grid<i32>,
    share: f64,
    most_bytes: usize,
) -> Result<Option<(f64, Pass)>> {
    let (least, greatest) = plane.extremes();
    // If values are clipped, it is best to keep those around the median.
    let centre =
        if share < 1.0 { plane.median() } else { ((i64::from(least) + i64::from(greatest)) / 2) as i32 };
    let whole = (f64::from(greatest) - f64::from(least)) / 255.0;
    let step = (whole * share).ceil().clamp(1.0, f64::from(i32::MAX)) as u32;
    let samples = samples(values, centre, step);
    let mut best: Option<(f64, Pass)> = None;
    let mut qualities = (1, BEST + 1);
    while qualities.0 < qualities.1 {
        let quality = (qualities.0 + qualities.1) / 2;
        let image = encode_samples(&samples, quality)?;
        if image.len() > most_bytes {
            qualities.1 = quality;
            continue;
        }
        qualities.0 = quality + 1;
        let pass = Pass { centre, step, image };
        let error = plane.without(&pass.decode(ImageCodec::Jpeg, plane.size())?).energy();
        if best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, pass));
        }
    }
    Ok(best)
}

/// Scales values to 8 bits.
fn samples(values: &Grid<i32>, centre: i32, step: u32) -> Grid<u8> {
    let step = i64::from(step);
    values.map(|value| {
        let sample = (i64::from(*value) - i64::from(centre) + step / 2).div_euclid(step);
        (sample + i64::from(CENTRE)).clamp(0, 255) as u8
    })
}

fn encode_samples(samples: &Grid<u8>, quality: u8) -> Result<Vec<u8>> {
    let failed = || Error::corrupt("the JPEG library failed");
    let (rows, columns) = sides(samples.rows(), samples.columns())?;
    let mut stream = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut stream, quality);
    let encoded = encoder.encode(samples.cells(), columns.into(), rows.into(), ExtendedColorType::L8);
    encoded.map_err(|_| failed())?;
    let header =
        stream.windows(SCAN_HEADER.len()).position(|bytes| bytes == SCAN_HEADER).ok_or_else(failed)?;
    let scan = stream[header + SCAN_HEADER.len()..].strip_suffix(&END).ok_or_else(failed)?;
    Ok([&[quality], scan].concat())
}

/// The samples of an image, minus that of the centre: -128 to 127.
///
/// # Errors
/// If it is damaged in a way that the library detects.
pub fn decode(image: &[u8], rows: usize, columns: usize) -> Result<Grid<i32>> {
    let damaged = |what: &str| Error::corrupt(format!("JPEG: {what}"));
    let (&quality, scan) = image.split_first().ok_or_else(|| damaged("no image"))?;
    if !(1..=BEST).contains(&quality) {
        return Err(damaged("no such quality"));
    }
    // After any of these markers the library would expect other tables, sizes and scans.
    if scan.windows(2).any(|pair| pair[0] == 0xff && pair[1] != 0) || scan.ends_with(&[0xff]) {
        return Err(damaged("a marker in the scan"));
    }
    let (height, width) = sides(rows, columns)?;
    let stream = [&header(height, width, quality)[..], scan, &END].concat();
    let failed = |error: image::ImageError| damaged(&error.to_string().replace('\n', " "));
    let decoder = JpegDecoder::new(Cursor::new(stream)).map_err(failed)?;
    let mut samples = vec![0; rows * columns];
    if decoder.total_bytes() != samples.len() as u64 {
        return Err(damaged("of another size"));
    }
    decoder.read_image(&mut samples).map_err(failed)?;
    let mut grid = Grid::new(rows, columns);
    for (row, samples) in samples.chunks(columns).enumerate() {
        let cells = grid.row_mut(row).iter_mut().zip(samples);
        cells.for_each(|(cell, sample)| *cell = i32::from(*sample) - CENTRE);
    }
    Ok(grid)
}

/// The sides in the type that the format requires.
fn sides(rows: usize, columns: usize) -> Result<(u16, u16)> {
    let side = |length: usize| u16::try_from(length).ok().filter(|length| *length > 0);
    let wrong = || {
        Error::InvalidSettings(format!("no JPEG image has {rows} rows and {columns} columns; 65535 are most"))
    };
    side(rows).zip(side(columns)).ok_or_else(wrong)
}

/// The end marker of the image.
const END: [u8; 2] = [0xff, 0xd9];

/// The last segment of the header: the only component, with the first tables and all frequencies.
const SCAN_HEADER: [u8; 10] = [0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0];

/// Table K.1, row by row.
#[rustfmt::skip]
const QUANTISATION: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61,
    12, 12, 14, 19, 26, 58, 60, 55,
    14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77,
    24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.3: the number of codes of each length, from 1 bit on, and their values.
const DC_LENGTHS: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
const DC_VALUES: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

/// Table K.5.
const AC_LENGTHS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d];
#[rustfmt::skip]
const AC_VALUES: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07,
    0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0,
    0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28,
    0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
    0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
    0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
    0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5,
    0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2,
    0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa,
];

/// All bytes before the scan data, for a quality from 1 to 100.
fn header(rows: u16, columns: u16, quality: u8) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8]; // SOI
    segment(&mut out, 0xdb, &[&[0], &quantisation(quality)]);
    let (rows, columns) = (rows.to_be_bytes(), columns.to_be_bytes());
    // Eight bits, one component, sampled once, by quantisation table 0.
    segment(&mut out, 0xc0, &[&[8], &rows, &columns, &[1, 1, 0x11, 0]]);
    segment(&mut out, 0xc4, &[&[0x00], &DC_LENGTHS, &DC_VALUES]);
    segment(&mut out, 0xc4, &[&[0x10], &AC_LENGTHS, &AC_VALUES]);
    out.extend(SCAN_HEADER);
    out
}

/// The quantisation table for a quality, in zigzag order.
fn quantisation(quality: u8) -> [u8; 64] {
    let quality = u32::from(quality.clamp(1, 100));
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    zigzag().map(|place| ((u32::from(QUANTISATION[place]) * scale + 50) / 100).clamp(1, 255) as u8)
}

/// The positions in a block of 8 x 8 in ascending order of frequency: along the diagonals, alternately up and
/// down.
fn zigzag() -> [usize; 64] {
    let mut places: [usize; 64] = std::array::from_fn(|place| place);
    places.sort_by_key(|place| {
        let (row, column) = (place / 8, place % 8);
        (row + column, if (row + column) % 2 == 0 { column } else { row })
    });
    places
}

fn segment(out: &mut Vec<u8>, marker: u8, parts: &[&[u8]]) {
    let length: usize = 2 + parts.iter().map(|part| part.len()).sum::<usize>();
    out.extend([0xff, marker]);
    out.extend((length as u16).to_be_bytes());
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

#[cfg(test)]
mod tests {
    //! A straightforward implementation of the format's specification, compared with the library, which must
    //! return the same samples with and without its vector instructions.

    use image::ExtendedColorType;
    use image::codecs::jpeg::JpegEncoder;

    use super::*;
    use crate::ground::random::Rng;

    /// The library's own header also contains a format name, and has another order; both headers must decode
    /// to the same samples.
    #[test]
    fn the_header_is_as_good_as_the_librarys() {
        let (rows, columns) = (17, 30);
        let samples: Vec<u8> = (0..rows * columns).map(|i| (i * i / 7 + i % 30 * 6) as u8).collect();
        for quality in [1, 20, 50, 77, 100] {
            let mut stream = Vec::new();
            let mut encoder = JpegEncoder::new_with_quality(&mut stream, quality);
            encoder.encode(&samples, columns, rows, ExtendedColorType::L8).unwrap();
            let scan = stream.windows(10).position(|bytes| bytes == SCAN_HEADER).unwrap() + 10;
            let own = [&header(rows as u16, columns as u16, quality)[..], &stream[scan..]].concat();
            let [theirs, own] = [stream, own].map(|stream| image::load_from_memory(&stream).unwrap());
            assert!(theirs == own && theirs.to_luma8().as_raw() != &samples, "quality {quality}");
        }
    }

    /// The bits of a scan.
    struct Bits<'s>(std::slice::Iter<'s, u8>, u8, u32);

    impl Bits<'_> {
        fn bit(&mut self) -> i32 {
            if self.2 == 0 {
                (self.1, self.2) = (*self.0.next().unwrap(), 8);
                assert!(self.1 != 255 || *self.0.next().unwrap() == 0, "a marker");
            }
            self.2 -= 1;
            i32::from(self.1 >> self.2 & 1)
        }

        /// A number of this many bits; its first bit is 0 if it is negative.
        fn number(&mut self, size: u8) -> i32 {
            let value = (0..size).fold(0, |value, _| value << 1 | self.bit());
            if size > 0 && value >> (size - 1) == 0 { value - (1 << size) + 1 } else { value }
        }

        fn symbol(&mut self, lengths: &[u8; 16], values: &[u8]) -> u8 {
            let (mut code, mut first, mut before) = (0, 0, 0);
            for &count in lengths {
                code = code << 1 | self.bit();
                if code < first + i32::from(count) {
                    return values[before + (code - first) as usize];
                }
                (first, before) = ((first + i32::from(count)) << 1, before + usize::from(count));
            }
            panic!("no such code")
        }
    }

    fn inverse(c: [i32; 8], bias: i32, shift: u32) -> [i32; 8] {
        let e = (c[2] + c[6]) * 2217;
        let (e2, e3) = (e - c[6] * 7567, e + c[2] * 3135);
        let (d0, d1) = ((c[0] + c[4]) << 12, (c[0] - c[4]) << 12);
        let x = [d0 + e3 + bias, d1 + e2 + bias, d1 - e2 + bias, d0 - e3 + bias];
        let o = (c[7] + c[3] + c[5] + c[1]) * 4816;
        let (a, b) = (o - (c[7] + c[1]) * 3685, o - (c[5] + c[3]) * 10497);
        let (f, g) = ((c[7] + c[3]) * 8034, (c[5] + c[1]) * 1597);
        let o = [c[1] * 6149 + a - g, c[3] * 12586 + b - f, c[5] * 8410 + b - g, c[7] * 1223 + a - f];
        std::array::from_fn(|i| if i < 4 { x[i] + o[i] } else { x[7 - i] - o[7 - i] } >> shift)
    }

    /// The samples of an image, as FORMAT.md describes it.
    fn plainly(image: &[u8], rows: usize, columns: usize) -> Grid<i32> {
        let (quality, scan) = image.split_first().unwrap();
        let (table, zigzag) = (quantisation(*quality), zigzag());
        let mut bits = Bits(scan.iter(), 0, 0);
        let mut samples = Grid::new(rows, columns);
        let mut last = 0;
        for top in (0..rows).step_by(8) {
            for left in (0..columns).step_by(8) {
                let mut block = [0; 64];
                let size = bits.symbol(&DC_LENGTHS, &DC_VALUES);
                last += bits.number(size);
                block[0] = last * i32::from(table[0]);
                let mut place = 1;
                while place < 64 {
                    let symbol = bits.symbol(&AC_LENGTHS, &AC_VALUES);
                    match symbol {
                        0 => break,
                        0xf0 => place += 16,
                        _ => {
                            place += usize::from(symbol >> 4);
                            block[zigzag[place]] = bits.number(symbol & 15) * i32::from(table[place]);
                            place += 1;
                        }
                    }
                }
                for column in 0..8 {
                    let values = inverse(std::array::from_fn(|row| block[row * 8 + column]), 512, 10);
                    (0..8).for_each(|row| block[row * 8 + column] = values[row]);
                }
                for row in 0..8.min(rows - top) {
                    let values = inverse(
                        std::array::from_fn(|column| block[row * 8 + column]),
                        66048 + (128 << 17),
                        17,
                    );
                    for column in 0..8.min(columns - left) {
                        samples[(top + row, left + column)] = values[column].clamp(0, 255) - CENTRE;
                    }
                }
            }
        }
        samples
    }

    #[test]
    fn the_library_does_what_the_format_says() {
        let mut random = Rng::keyed(5, &[]);
        for (rows, columns) in [(8, 8), (21, 90), (64, 33)] {
            for kind in 0..4 {
                let mut samples: Grid<u8> = Grid::new(rows, columns);
                for row in 0..rows {
                    for (column, sample) in samples.row_mut(row).iter_mut().enumerate() {
                        *sample = match kind {
                            0 => 128,
                            1 => (row * 3 + column * 2 % 180) as u8,
                            2 => random.below(256) as u8,
                            // The largest possible coefficients.
                            _ => 255 * u8::from(random.chance(0.5)),
                        };
                    }
                }
                for quality in [1, 5, 25, 50, 75, 90, 100] {
                    let image = encode_samples(&samples, quality).unwrap();
                    let decoded = decode(&image, rows, columns).unwrap();
                    assert!(
                        decoded == plainly(&image, rows, columns),
                        "{rows} x {columns}, {kind}, {quality}"
                    );
                }
            }
        }
    }
}
