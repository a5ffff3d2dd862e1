//! Records whose coordinates are integers in units of a step, as in LAS. FORMAT.md 9.

use byteorder::{ByteOrder, LittleEndian};

use super::records::Parts;
use crate::scan::{Axis, Layout, ScanFile, Wrapping};

/// Splits a file whose records follow one another from byte `start` on, at most `count` of them. The layout
/// has float32 fields x, y and z in place of the integers. `None` if the layout is not valid, or if some
/// integer could not be restored from its float32 value.
pub(super) fn parse(
    layout: Layout,
    axes: [Axis; 3],
    bytes: &[u8],
    start: usize,
    count: u64,
) -> Option<ScanFile> {
    let layout = Layout { wrapping: Wrapping::Scaled(axes), ..layout };
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), count)?;
    let mut metres = parts.body.to_vec();
    to_metres(&mut metres, &layout, &axes);
    let mut again = metres.clone();
    to_steps(&mut again, &layout, &axes);
    (again == parts.body).then(|| parts.file(layout, &metres))
}

fn to_metres(body: &mut [u8], layout: &Layout, axes: &[Axis; 3]) {
    each(body, layout, axes, |axis, value| {
        LittleEndian::write_f32(value, axis.metres(LittleEndian::read_i32(value)));
    });
}

/// Converts the coordinates in whole records to the integers of the file.
pub(super) fn to_steps(body: &mut [u8], layout: &Layout, axes: &[Axis; 3]) {
    each(body, layout, axes, |axis, value| {
        LittleEndian::write_i32(value, axis.steps(LittleEndian::read_f32(value), [i32::MIN, i32::MAX]));
    });
}

fn each(body: &mut [u8], layout: &Layout, axes: &[Axis; 3], change: impl Fn(&Axis, &mut [u8])) {
    let Some(offsets) = layout.position_offsets() else { return };
    for record in body.chunks_exact_mut(layout.stride().max(1)) {
        for (at, axis) in offsets.into_iter().zip(axes) {
            change(axis, &mut record[at..at + 4]);
        }
    }
}
