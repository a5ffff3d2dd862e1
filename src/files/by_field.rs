//! Records stored field by field: all values of the first field, then all of the second, and so on.
//! FORMAT.md 9.

use super::field::layout_of;
use super::records::{Parts, copy_values};
use super::widened;
use crate::ground::error::Result;
use crate::scan::{Field, Layout, ScalarType, ScanFile, Widening, Wrapping};

/// Splits a file whose `count` records begin at byte `start`. Numbers become float32 as in
/// [`widened::parse`]. `None` if the layout is not valid, or if the file is too short.
pub(super) fn parse(
    layout: Layout,
    halves: &[bool],
    bytes: &[u8],
    start: usize,
    count: u64,
) -> Option<ScanFile> {
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), count)?;
    if parts.records as u64 != count {
        return None;
    }
    let (fields, widenings, body) = narrowed(&layout.fields, halves, parts.body)?;
    Some(parts.file(layout_of(fields, Wrapping::ByField(widenings))?, &body))
}

/// The fields, how they are widened, and the complete records of values that are stored field by field, where
/// numbers may become float32 as in [`widened::narrowed`]. `None` if the layout of the fields is not valid.
pub(super) fn narrowed(
    fields: &[Field],
    halves: &[bool],
    by_field: &[u8],
) -> Option<(Vec<Field>, Vec<Widening>, Vec<u8>)> {
    layout_of(fields.to_vec(), Wrapping::Plain)?.validate().ok()?;
    let body = to_records(by_field, fields);
    Some(match widened::narrowed(fields, halves, &body) {
        Some(narrowed) => (narrowed.fields, narrowed.widenings, narrowed.body),
        None => (fields.to_vec(), vec![Widening::None; fields.len()], body),
    })
}

/// The fields as the file has them.
pub(super) fn stored(layout: &Layout, widenings: &[Widening]) -> impl Iterator<Item = Field> {
    layout.fields.iter().zip(widenings).map(|(field, widening)| match widening {
        // A valid layout has no steps here.
        Widening::None | Widening::Steps(_) => field.clone(),
        Widening::Half => Field { scalar: ScalarType::U16, ..field.clone() },
        Widening::Exact | Widening::Decimal(_) => Field { scalar: ScalarType::F64, ..field.clone() },
    })
}

/// The values of records, field by field, whose doubles and halves are float32 in the fields that are
/// widened.
///
/// # Errors
/// Those of [`widened::write`].
pub(super) fn write(body: &[u8], layout: &Layout, widenings: &[Widening]) -> Result<Vec<u8>> {
    let fields: Vec<_> = stored(layout, widenings).collect();
    Ok(from_records(&widened::write(body, layout, widenings)?, &fields))
}

/// Complete records with these fields, from a body that is stored field by field.
pub(super) fn to_records(by_field: &[u8], fields: &[Field]) -> Vec<u8> {
    let mut records = vec![0; by_field.len()];
    let stride = stride(fields);
    let mut rest = by_field;
    let mut at = 0;
    for width in fields.iter().map(Field::width) {
        let (own, after) = rest.split_at(by_field.len() / stride * width);
        copy_values(width, (own, width, 0), (&mut records, stride, at));
        (rest, at) = (after, at + width);
    }
    records
}

/// The inverse of [`to_records`].
pub(super) fn from_records(records: &[u8], fields: &[Field]) -> Vec<u8> {
    let mut by_field = vec![0; records.len()];
    let stride = stride(fields);
    let mut rest = &mut by_field[..];
    let mut at = 0;
    for width in fields.iter().map(Field::width) {
        let (own, after) = rest.split_at_mut(records.len() / stride * width);
        copy_values(width, (records, stride, at), (own, width, 0));
        (rest, at) = (after, at + width);
    }
    by_field
}

/// Bytes of a record; at least 1.
fn stride(fields: &[Field]) -> usize {
    fields.iter().map(Field::width).sum::<usize>().max(1)
}
