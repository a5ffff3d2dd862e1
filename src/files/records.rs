//! Records as bytes and as a cloud of points.

use std::ops::Range;

use byteorder::{ByteOrder, LittleEndian};

use super::collected;
use crate::ground::error::{Error, Result};
use crate::scan::{Layout, PointCloud, ScanFile, Wrapping};

/// Takes a file apart whose records stand one after the other from byte `start` on: at most
/// `records` of them, fewer if the file ends before. `None` if the layout is not valid.
pub(super) fn plain_file(layout: Layout, bytes: &[u8], start: usize, records: u64) -> Option<ScanFile> {
    layout.validate().ok()?;
    let stride = layout.stride as usize;
    let body = bytes.get(start..)?;
    let present = body.len().checked_div(stride)?;
    let records = usize::try_from(records).map_or(present, |n| n.min(present));
    let (body, suffix) = body.split_at(records * stride);
    Some(ScanFile {
        prefix: bytes[..start].to_vec(),
        records,
        cloud: split(&layout, body),
        suffix: suffix.to_vec(),
        layout,
        name: String::new(),
    })
}

/// Turns whole records, one after the other, into points. The layout must be valid.
pub(super) fn split(layout: &Layout, body: &[u8]) -> PointCloud {
    let records = body.chunks_exact(layout.stride.max(1) as usize);
    let value = |record: &[u8], at: u32| LittleEndian::read_f32(&record[at as usize..]);
    // Field by field: a vector that is collected at once does not ask for each value whether it has room.
    let mut cloud = PointCloud {
        positions: layout.position.map_or_else(Vec::new, |offsets| {
            records.clone().map(|record| offsets.map(|at| value(record, at))).collect()
        }),
        intensity: layout
            .intensity
            .map_or_else(Vec::new, |at| records.clone().map(|record| value(record, at)).collect()),
        extra: Vec::with_capacity(records.len() * layout.extra_stride()),
    };
    let extra_ranges = layout.extra_ranges();
    if !extra_ranges.is_empty() {
        for record in records {
            extra_ranges.iter().for_each(|range| cloud.extra.extend_from_slice(&record[range.clone()]));
        }
    }
    cloud
}

/// Gives the records of `file`, one after the other and some at a time: the inverse of [`split`].
/// The file must have passed [`check`].
///
/// # Errors
/// Those of `give`.
pub(super) fn give(file: &ScanFile, mut give: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
    /// Bytes at a time: as many as a processor keeps near while fields are filled in one after the other, and then
    /// they are read again.
    const AT_ONCE: usize = 64 << 10;
    let stride = file.layout.stride.max(1) as usize;
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

/// As [`give`], all at once.
pub(super) fn join(file: &ScanFile) -> Result<Vec<u8>> {
    collected(|out| give(file, out))
}

/// Fills in the fields of some records: between them they are every byte of these.
fn fill(layout: &Layout, cloud: &PointCloud, records: Range<usize>, body: &mut [u8]) {
    let (stride, extra_stride) = (layout.stride.max(1) as usize, layout.extra_stride());
    if let Some(offsets) = layout.position {
        for (record, position) in body.chunks_exact_mut(stride).zip(&cloud.positions[records.clone()]) {
            for (at, value) in offsets.into_iter().zip(position) {
                LittleEndian::write_f32(&mut record[at as usize..], *value);
            }
        }
    }
    if let Some(at) = layout.intensity {
        for (record, value) in body.chunks_exact_mut(stride).zip(&cloud.intensity[records.clone()]) {
            LittleEndian::write_f32(&mut record[at as usize..], *value);
        }
    }
    if extra_stride > 0 {
        let extra_ranges = layout.extra_ranges();
        let extra = cloud.extra[records.start * extra_stride..].chunks_exact(extra_stride);
        for (record, mut extra) in body.chunks_exact_mut(stride).zip(extra) {
            for range in &extra_ranges {
                let (gap, rest) = extra.split_at(range.len());
                record[range.clone()].copy_from_slice(gap);
                extra = rest;
            }
        }
    }
}

/// Checks that the cloud has exactly what `records` records of this layout hold. After that the
/// records' bytes are no more than the cloud already takes in memory.
///
/// # Errors
/// [`Error::Corrupt`] if not, as a damaged stream can have it.
pub(super) fn check(file: &ScanFile) -> Result<()> {
    let (layout, cloud) = (&file.layout, &file.cloud);
    layout.validate()?;
    let positions = if layout.position.is_some() { file.records } else { 0 };
    let intensities = if layout.intensity.is_some() { file.records } else { 0 };
    let fits = cloud.positions.len() == positions
        && cloud.intensity.len() == intensities
        && Some(cloud.extra.len()) == file.records.checked_mul(layout.extra_stride())
        && (layout.stride > 0 || (file.records == 0 && layout.wrapping == Wrapping::Plain));
    match fits {
        true => Ok(()),
        false => Err(Error::corrupt("points do not match the record layout")),
    }
}
