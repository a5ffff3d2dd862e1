//! Records whose values are big-endian, as in a `binary_big_endian` PLY. FORMAT.md 9.

use super::records::Parts;
use crate::scan::{Layout, ScanFile, Wrapping};

/// Splits a file whose records follow one another from byte `start` on, at most `records` of them. `None` if
/// the layout is not valid.
pub(crate) fn parse(layout: Layout, bytes: &[u8], start: usize, records: u64) -> Option<ScanFile> {
    let layout = Layout { wrapping: Wrapping::BigEndian, ..layout };
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), records)?;
    let mut swapped = parts.body.to_vec();
    swap(&mut swapped, &layout);
    Some(parts.file(layout, &swapped))
}

/// Reverses the bytes of each value in whole records.
pub(super) fn swap(records: &mut [u8], layout: &Layout) {
    for record in records.chunks_exact_mut(layout.stride().max(1)) {
        let mut rest = record;
        for field in &layout.fields {
            let (values, after) = rest.split_at_mut(field.width());
            values.chunks_exact_mut(field.scalar.size() as usize).for_each(<[u8]>::reverse);
            rest = after;
        }
    }
}
