//! JPEG (ITU-T T.81, baseline), by the crate `image`, for one pass: values are scaled to 8 bits by a step.
//! FORMAT.md 8.14.
//!
//! The payload is one byte for the quality, then the coded data of the scan.

mod header;

use std::io::Cursor;

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{ExtendedColorType, ImageDecoder};

use self::header::{END, SCAN_HEADER, header};
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

#[cfg(test)]
mod tests;
