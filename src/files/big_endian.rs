//! Records whose values are big-endian, as in a `binary_big_endian` PLY.

use super::records::plain_file;
use crate::scan::{Layout, ScanFile, Wrapping};

/// Takes a file apart whose records stand one after the other from byte `start` on: at most `records`
/// of them, of values of these many bytes. `None` if the layout is not valid.
pub(super) fn parse(
    layout: Layout,
    values: Vec<u32>,
    bytes: &[u8],
    start: usize,
    records: u64,
) -> Option<ScanFile> {
    let stride = layout.stride as usize;
    let present = bytes.len().checked_sub(start)?.checked_div(stride)?;
    let count = usize::try_from(records).map_or(present, |n| n.min(present));
    let mut swapped = bytes.to_vec();
    swap(&mut swapped[start..start + count * stride], &values);
    let file = plain_file(layout, &swapped, start, records)?;
    Some(ScanFile { layout: Layout { wrapping: Wrapping::BigEndian { values }, ..file.layout }, ..file })
}

/// Turns the bytes of each value around. Whole records, of values of these many bytes.
pub(super) fn swap(records: &mut [u8], values: &[u32]) {
    let mut rest = records;
    for &width in values.iter().cycle() {
        let Some((value, after)) =
            rest.split_at_mut_checked(width as usize).filter(|(value, _)| !value.is_empty())
        else {
            return;
        };
        value.reverse();
        rest = after;
    }
}
