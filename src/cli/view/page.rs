//! A page that contains a drive: `web/page.html` and `web/view.js` with the points of each frame, decoded and
//! rounded. Thus it opens anywhere, even from disk, and a program that writes it needs no decoder for
//! browsers.

use std::ffi::OsStr;
use std::io::{Read, Seek, Write};
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde::Serialize;

use crate::cli::errors::about;
use crate::library::{ChannelValues, Decoder, FrameDetails, FrameInfo, Scan};

const PAGE: &str = include_str!("../../../web/page.html");
const SCRIPT: &str = include_str!("../../../web/view.js");
/// The places of the frames and of the script in the page.
const MARKS: [&str; 2] = ["<!-- contents -->\n", "<script type=\"module\" src=\"view.js\"></script>\n"];

/// The unit to which coordinates are rounded, in metres, unless their extent exceeds 16 bits.
const UNIT: f64 = 0.01;

/// The input of the script. Its names are those of `js/index.d.ts`.
#[derive(Serialize)]
struct Drive<'d> {
    name: &'d str,
    bytes: u64,
    scanners: Vec<String>,
    frames: Vec<Frame>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Frame {
    number: u64,
    name: String,
    /// Nanoseconds since 1970. As text, because JavaScript's numbers have 53 bits.
    time: Option<String>,
    points: usize,
    /// Size of the file.
    bytes: u64,
    coded_bytes: u64,
    /// The unit of coordinates, in metres.
    unit: f64,
    /// Rows of the range image; 0 if there is none.
    rows: usize,
    columns: usize,
    fields: Vec<Field>,
}

/// A field. Each value is a byte: the number of steps above the least value.
#[derive(Serialize)]
struct Field {
    name: String,
    least: f64,
    step: f64,
}

/// Writes the page for a stream with this name and size. `advance` is called after each frame.
///
/// # Errors
/// If the stream is damaged, or does not contain these frames; and those of the output.
pub fn write<R: Read + Seek + Send>(
    decoder: &mut Decoder<R>,
    (path, bytes): (&str, u64),
    numbers: Range<u64>,
    out: &mut impl Write,
    advance: impl Fn(),
) -> Result<()> {
    let (head, rest) = PAGE.split_once(MARKS[0]).context("web/page.html has no place for frames")?;
    let (middle, tail) = rest.split_once(MARKS[1]).context("web/page.html has no place for its script")?;
    let of_stream = |error| about(error, path);
    let details = decoder.details(numbers.clone()).map_err(of_stream)?;
    let scanners = decoder.scanners().map_err(of_stream)?;
    let infos: Vec<_> = decoder.frames().filter(|info| numbers.contains(&info.number)).collect();

    out.write_all(head.as_bytes())?;
    let mut frames = Vec::new();
    for ((scan, details), info) in decoder.scans(numbers).zip(details).zip(infos) {
        let (frame, packed) = pack(&scan.map_err(of_stream)?, details, &info).map_err(of_stream)?;
        frames.push(frame);
        writeln!(out, "<script type=\"text/plain\" class=\"frame\">{}</script>", base64(&packed))?;
        advance();
    }
    let name = Path::new(path).file_name().map_or_else(|| path.into(), OsStr::to_string_lossy);
    // Names may be any string, but must not end the script.
    let drive =
        serde_json::to_string(&Drive { name: &name, bytes, scanners, frames })?.replace('<', "\\u003c");
    writeln!(out, "<script type=\"application/json\" id=\"drive\">{drive}</script>")?;
    write!(out, "{middle}<script type=\"module\">{SCRIPT}</script>\n{tail}")?;
    Ok(())
}

/// A frame, and its points in the form that the script's function `unpacked` expects.
fn pack(
    scan: &Scan,
    details: FrameDetails,
    info: &FrameInfo,
) -> crate::ground::error::Result<(Frame, Vec<u8>)> {
    let positions = positions(scan);
    let finite = positions.iter().flatten().filter(|metres| metres.is_finite());
    let reach = finite.fold(0.0, |reach: f64, metres| reach.max(metres.abs()));
    let unit = UNIT.max(reach / f64::from(i16::MAX));
    // Images whose cells 16 bits cannot count are left out.
    let image = scan.range_image().filter(|image| image.rows().max(image.columns()) < usize::from(u16::MAX));
    let (rows, columns) = image.map_or((0, 0), |image| (image.rows(), image.columns()));
    let mut cells = vec![[u16::MAX; 2]; positions.len()];
    for (cell, point) in image.iter().flat_map(|image| image.points().iter().enumerate()) {
        if let Some(place) = point.and_then(|point| cells.get_mut(point as usize)) {
            *place = [(cell / columns) as u16, (cell % columns) as u16];
        }
    }

    let mut packed = Vec::new();
    let rounded = |position: &[f64; 3], axis: usize| match position.iter().all(|metres| metres.is_finite()) {
        true => (position[axis] / unit).round() as i16 as u16,
        false => i16::MIN as u16,
    };
    for axis in 0..3 {
        write_differences(positions.iter().map(|position| rounded(position, axis)), &mut packed);
    }
    for axis in 0..2 {
        write_differences(cells.iter().map(|cell| cell[axis]), &mut packed);
    }
    let mut fields = Vec::new();
    for channel in
        scan.channels().filter(|channel| channel.count == 1 && !["x", "y", "z"].contains(&channel.name))
    {
        let values = scan.values(channel.name)?.to_f64();
        let finite = || values.iter().copied().filter(|value| value.is_finite());
        let least = finite().reduce(f64::min).unwrap_or(0.0);
        let range = finite().reduce(f64::max).unwrap_or(0.0) - least;
        // Small ranges of whole numbers are not scaled.
        let is_whole = range <= 255.0 && finite().all(|value| value.fract() == 0.0);
        let step = if is_whole { 1.0 } else { range / 255.0 };
        packed.extend(values.iter().map(|value| ((value - least) / step).round() as u8));
        fields.push(Field { name: channel.name.to_owned(), least, step });
    }
    let mut compressed = ZlibEncoder::new(Vec::new(), Compression::default());
    compressed.write_all(&packed)?;

    let time = info.time.map(|time| time.to_string());
    let FrameDetails { number, name, bytes, .. } = details;
    let (points, coded_bytes) = (positions.len(), info.coded_bytes);
    let frame = Frame { number, name, time, points, bytes, coded_bytes, unit, rows, columns, fields };
    Ok((frame, compressed.finish()?))
}

/// x, y and z of each point, in metres; NaN for files without them.
fn positions(scan: &Scan) -> Vec<[f64; 3]> {
    if scan.has_positions() {
        return scan.positions().iter().map(|position| position.map(f64::from)).collect();
    }
    let column = |name| {
        let values = scan.values(name).ok().filter(|values| values.len() == scan.len());
        values.map(ChannelValues::to_f64)
    };
    let columns = ["x", "y", "z"].map(|name| column(name).unwrap_or_else(|| vec![f64::NAN; scan.len()]));
    (0..scan.len()).map(|point| std::array::from_fn(|axis| columns[axis][point])).collect()
}

/// Appends the differences between consecutive numbers: the low bytes of all, then the high bytes.
fn write_differences(values: impl Iterator<Item = u16>, out: &mut Vec<u8>) {
    let differences =
        values.scan(0u16, |last, value| Some(value.wrapping_sub(std::mem::replace(last, value))));
    let (low, high): (Vec<_>, Vec<_>) = differences.map(|difference| difference.to_le_bytes().into()).unzip();
    out.extend(low);
    out.extend(high);
}

/// Bytes as text, four characters for three bytes (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let number =
            three.iter().fold(0, |number, byte| number << 8 | u32::from(*byte)) << (8 * (3 - three.len()));
        for digit in 0..4 {
            let is_there = digit <= three.len();
            text.push(if is_there { DIGITS[(number >> (18 - 6 * digit) & 63) as usize].into() } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_text() {
        // RFC 4648, section 10.
        let texts = ["", "f", "fo", "foo", "foob", "fooba", "foobar"].map(|bytes| base64(bytes.as_bytes()));
        assert_eq!(texts, ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"]);
    }

    #[test]
    fn differences_wrap() {
        let mut bytes = Vec::new();
        write_differences([1, 0x0203, 0, u16::MAX].into_iter(), &mut bytes);
        assert_eq!(bytes, [0x01, 0x02, 0xfd, 0xff, 0x00, 0x02, 0xfd, 0xff]);
    }

    #[test]
    fn the_script_does_not_end_itself() {
        assert!(!SCRIPT.contains("</script") && !SCRIPT.contains("<!--"));
    }
}
