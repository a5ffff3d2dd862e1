//! Records as bytes and as a cloud of points, also those whose values are big-endian, as in a
//! `binary_big_endian` PLY. FORMAT.md 9.

use std::ops::Range;

use byteorder::{ByteOrder, LittleEndian};

use super::collected;
use crate::ground::error::{Error, Result};
use crate::scan::{Channel, Layout, PointCloud, ScalarType, ScanFile, Wrapping};

/// Splits a file whose records follow one another from byte `start` on: at most `records` of them, fewer if
/// the file is shorter. `None` if the layout is not valid.
pub(crate) fn plain_file(layout: Layout, bytes: &[u8], start: usize, records: u64) -> Option<ScanFile> {
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), records)?;
    Some(parts.file(layout, parts.body))
}

/// The parts of a file whose records follow one another.
pub(super) struct Parts<'b> {
    prefix: &'b [u8],
    /// The complete records.
    pub body: &'b [u8],
    suffix: &'b [u8],
    /// Number of records.
    pub records: usize,
}

impl<'b> Parts<'b> {
    /// The parts of a file whose records of `stride` bytes begin at byte `start`, at most `records` of them.
    /// `None` if the file is shorter than `start`, or if `stride` is 0.
    pub fn of(bytes: &'b [u8], start: usize, stride: usize, records: u64) -> Option<Self> {
        let (prefix, rest) = bytes.split_at_checked(start)?;
        let present = rest.len().checked_div(stride)?;
        let records = usize::try_from(records).map_or(present, |count| count.min(present));
        let (body, suffix) = rest.split_at(records * stride);
        Some(Parts { prefix, body, suffix, records })
    }

    /// The file with its records replaced by these bytes. The layout must be valid.
    pub fn file(&self, layout: Layout, body: &[u8]) -> ScanFile {
        let (layout, cloud) = split(layout, body);
        ScanFile {
            prefix: self.prefix.to_vec(),
            records: self.records,
            cloud,
            suffix: self.suffix.to_vec(),
            layout,
            name: String::new(),
        }
    }
}

/// Whether the intensity models support these values of an intensity of this type.
pub fn are_intensities(scalar: ScalarType, mut values: impl Iterator<Item = f32>) -> bool {
    /// The largest whole number that they support.
    const MOST: f32 = 511.0;
    scalar != ScalarType::U16 || values.all(|value| value <= MOST)
}

/// Converts complete records, one after the other, to points. The layout must be valid. If integer
/// intensities exceed the supported maximum, they become a channel: the returned layout then has no
/// intensity.
pub(super) fn split(mut layout: Layout, body: &[u8]) -> (Layout, PointCloud) {
    let stride = layout.stride().max(1);
    let records = body.chunks_exact(stride);
    let value = |record: &[u8], at: usize| LittleEndian::read_f32(&record[at..]);
    // Field by field, because a vector that is collected in one go does not check its capacity for each
    // value.
    let positions = layout.position_offsets().map_or_else(Vec::new, |[x, y, z]| {
        records.clone().map(|record| [value(record, x), value(record, y), value(record, z)]).collect()
    });
    let mut intensity: Vec<f32> = match layout.intensity_offset() {
        Some((at, ScalarType::F32)) => records.map(|record| value(record, at)).collect(),
        Some((at, ScalarType::U16)) => {
            records.map(|record| LittleEndian::read_u16(&record[at..]).into()).collect()
        }
        Some((at, _)) => records.map(|record| record[at].into()).collect(),
        None => Vec::new(),
    };
    let scalar = layout.intensity_offset().map(|(_, scalar)| scalar);
    if scalar.is_some_and(|scalar| !are_intensities(scalar, intensity.iter().copied())) {
        layout.intensity = None;
        intensity.clear();
    }
    let channels = layout
        .channels()
        .map(|(at, field)| Channel { field: field.clone(), bytes: taken(body, stride, at, field.width()) })
        .collect();
    (layout, PointCloud { positions, intensity, channels })
}

/// The bytes of one field, record after record.
fn taken(body: &[u8], stride: usize, at: usize, width: usize) -> Vec<u8> {
    let mut bytes = vec![0; body.len() / stride * width];
    copy_values(width, (body, stride, at), (&mut bytes, width, 0));
    bytes
}

/// Copies values of `width` bytes between records, given the bytes, the stride and the offset on either side.
pub(super) fn copy_values(
    width: usize,
    (from, from_stride, from_at): (&[u8], usize, usize),
    (to, to_stride, to_at): (&mut [u8], usize, usize),
) {
    /// Wider values are copied one by one.
    const WIDE: usize = 32;
    /// Copies `WIDTH` bytes of each value; with a width known at compile time, each copy is one move.
    fn copy_parts<const WIDTH: usize>(
        (from, from_stride, from_at): (&[u8], usize, usize),
        (to, to_stride, to_at): (&mut [u8], usize, usize),
    ) {
        for (to, from) in to.chunks_exact_mut(to_stride).zip(from.chunks_exact(from_stride)) {
            to[to_at..to_at + WIDTH].copy_from_slice(&from[from_at..from_at + WIDTH]);
        }
    }
    if width > WIDE {
        for (to, from) in to.chunks_exact_mut(to_stride).zip(from.chunks_exact(from_stride)) {
            to[to_at..to_at + width].copy_from_slice(&from[from_at..from_at + width]);
        }
        return;
    }
    let mut copied = 0;
    while copied < width {
        let from = (from, from_stride, from_at + copied);
        let to = (&mut *to, to_stride, to_at + copied);
        copied += match width - copied {
            8.. => {
                copy_parts::<8>(from, to);
                8
            }
            4.. => {
                copy_parts::<4>(from, to);
                4
            }
            2.. => {
                copy_parts::<2>(from, to);
                2
            }
            _ => {
                copy_parts::<1>(from, to);
                1
            }
        };
    }
}

/// Passes the records of `file` to `give`, which may change them, a block of records at a time: the inverse
/// of [`split`]. The file must have passed [`check`].
///
/// # Errors
/// Those of `give`.
pub(super) fn give(file: &ScanFile, mut give: impl FnMut(&mut [u8]) -> Result<()>) -> Result<()> {
    /// Bytes per block. A block should stay in the cache while its fields are filled in one after the other
    /// and then read again.
    const AT_ONCE: usize = 64 << 10;
    let stride = file.layout.stride().max(1);
    let count = (AT_ONCE / stride).max(1);
    let mut body = vec![0; count.min(file.records) * stride];
    for first in (0..file.records).step_by(count) {
        let records = first..file.records.min(first + count);
        let body = &mut body[..records.len() * stride];
        fill(&file.layout, &file.cloud, records, body);
        give(body)?;
    }
    Ok(())
}

/// As [`give`], in one piece.
pub(super) fn join(file: &ScanFile) -> Result<Vec<u8>> {
    collected(|out| give(file, |block| out(block)))
}

/// Fills in all fields of some records, and with them every byte.
fn fill(layout: &Layout, cloud: &PointCloud, records: Range<usize>, body: &mut [u8]) {
    let stride = layout.stride().max(1);
    if let Some(offsets) = layout.position_offsets() {
        for (record, position) in body.chunks_exact_mut(stride).zip(&cloud.positions[records.clone()]) {
            for (at, value) in offsets.into_iter().zip(position) {
                LittleEndian::write_f32(&mut record[at..], *value);
            }
        }
    }
    if let Some((at, scalar)) = layout.intensity_offset() {
        for (record, value) in body.chunks_exact_mut(stride).zip(&cloud.intensity[records.clone()]) {
            // Rounded intensities need not be whole numbers.
            match scalar {
                ScalarType::F32 => LittleEndian::write_f32(&mut record[at..], *value),
                ScalarType::U16 => LittleEndian::write_u16(&mut record[at..], (value + 0.5) as u16),
                _ => record[at] = (value + 0.5) as u8,
            }
        }
    }
    for ((at, field), channel) in layout.channels().zip(&cloud.channels) {
        let width = field.width();
        let values = &channel.bytes[records.start * width..records.end * width];
        copy_values(width, (values, width, 0), (&mut *body, stride, at));
    }
}

/// Checks that the cloud contains exactly the values of `records` records of this layout. If so, the records
/// take no more bytes than the cloud already takes in memory.
///
/// # Errors
/// [`Error::Corrupt`] if not, which a damaged stream can cause.
pub(super) fn check(file: &ScanFile) -> Result<()> {
    let (layout, cloud) = (&file.layout, &file.cloud);
    layout.validate()?;
    let positions = if layout.position.is_some() { file.records } else { 0 };
    let intensities = if layout.intensity.is_some() { file.records } else { 0 };
    let channels_fit = layout.channels().map(Some).chain(std::iter::repeat(None)).zip(&cloud.channels).all(
        |(field, channel)| {
            field.is_some_and(|(_, field)| {
                *field == channel.field
                    && Some(channel.bytes.len()) == file.records.checked_mul(field.width())
            })
        },
    );
    let fits = cloud.positions.len() == positions
        && cloud.intensity.len() == intensities
        && channels_fit
        && layout.channels().count() == cloud.channels.len()
        && (layout.stride() > 0 || (file.records == 0 && layout.wrapping == Wrapping::Plain));
    match fits {
        true => Ok(()),
        false => Err(Error::corrupt("points do not match the record layout")),
    }
}

/// Splits a file whose records follow one another from byte `start` on, at most `records` of them. `None` if
/// the layout is not valid.
pub(crate) fn parse_big_endian(layout: Layout, bytes: &[u8], start: usize, records: u64) -> Option<ScanFile> {
    let layout = Layout { wrapping: Wrapping::BigEndian, ..layout };
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), records)?;
    let mut swapped = parts.body.to_vec();
    swap_bytes(&mut swapped, &layout);
    Some(parts.file(layout, &swapped))
}

/// Reverses the bytes of each value in whole records.
pub(super) fn swap_bytes(records: &mut [u8], layout: &Layout) {
    for record in records.chunks_exact_mut(layout.stride().max(1)) {
        let mut rest = record;
        for field in &layout.fields {
            let (values, after) = rest.split_at_mut(field.width());
            values.chunks_exact_mut(field.scalar.size() as usize).for_each(<[u8]>::reverse);
            rest = after;
        }
    }
}
