//! Records as bytes and as a cloud of points.

use byteorder::{ByteOrder, LittleEndian};

use crate::error::{Error, Result};
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

/// Bytes of a record of KITTI's: position, intensity and nothing else.
const PACKED: usize = 16;

/// Whether records are like KITTI's, which are dealt with far quicker than others.
fn is_packed(layout: &Layout) -> bool {
    let (position, intensity) = (Some([0, 4, 8]), Some(12));
    layout.stride as usize == PACKED && layout.position == position && layout.intensity == intensity
}

/// Turns whole records, one after the other, into points. The layout must be valid.
pub(super) fn split(layout: &Layout, body: &[u8]) -> PointCloud {
    if is_packed(layout) {
        let (records, _) = body.as_chunks::<PACKED>();
        return PointCloud {
            positions: records
                .iter()
                .map(|record| [0, 4, 8].map(|at| LittleEndian::read_f32(&record[at..])))
                .collect(),
            intensity: records.iter().map(|record| LittleEndian::read_f32(&record[12..])).collect(),
            extra: Vec::new(),
        };
    }
    let stride = layout.stride.max(1) as usize;
    let records = body.len() / stride;
    let extra_ranges = layout.extra_ranges();
    let mut cloud = PointCloud {
        positions: Vec::with_capacity(if layout.position.is_some() { records } else { 0 }),
        intensity: Vec::with_capacity(if layout.intensity.is_some() { records } else { 0 }),
        extra: Vec::with_capacity(records * layout.extra_stride()),
    };
    for record in body.chunks_exact(stride) {
        let value = |at: u32| LittleEndian::read_f32(&record[at as usize..]);
        cloud.positions.extend(layout.position.map(|offsets| offsets.map(value)));
        cloud.intensity.extend(layout.intensity.map(value));
        for range in &extra_ranges {
            cloud.extra.extend_from_slice(&record[range.clone()]);
        }
    }
    cloud
}

/// Appends the records of `file`, one after the other: the inverse of [`split`].
/// The file must have passed [`check`].
pub(super) fn join(file: &ScanFile, out: &mut Vec<u8>) {
    let (layout, cloud) = (&file.layout, &file.cloud);
    if is_packed(layout) {
        out.reserve_exact(file.records * PACKED);
        out.extend(cloud.positions.iter().zip(&cloud.intensity).flat_map(|([x, y, z], intensity)| {
            let mut record = [0; PACKED];
            LittleEndian::write_f32_into(&[*x, *y, *z, *intensity], &mut record);
            record
        }));
        return;
    }
    let (stride, extra_stride) = (layout.stride as usize, layout.extra_stride());
    let extra_ranges = layout.extra_ranges();
    let start = out.len();
    out.resize(start + file.records * stride, 0);
    for (i, record) in out[start..].chunks_exact_mut(stride.max(1)).enumerate() {
        if let Some(offsets) = layout.position {
            for (at, value) in offsets.into_iter().zip(cloud.positions[i]) {
                LittleEndian::write_f32(&mut record[at as usize..], value);
            }
        }
        if let Some(at) = layout.intensity {
            LittleEndian::write_f32(&mut record[at as usize..], cloud.intensity[i]);
        }
        let mut extra = &cloud.extra[i * extra_stride..(i + 1) * extra_stride];
        for range in &extra_ranges {
            let (gap, rest) = extra.split_at(range.len());
            record[range.clone()].copy_from_slice(gap);
            extra = rest;
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
