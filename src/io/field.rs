//! Named fields of a record, as the headers of PCD and PLY declare them.

use crate::scan::{Layout, MAX_STRIDE, Scalar, Wrapping};

/// One field of a record.
#[derive(Debug)]
pub(super) struct Field<'a> {
    /// Its name.
    pub name: &'a str,
    /// The type of its values, if it is one of those that this program knows.
    pub scalar: Option<Scalar>,
    /// Bytes it takes in a record.
    pub width: u32,
}

impl Field<'_> {
    fn is_single_float32(&self) -> bool {
        self.scalar == Some(Scalar::F32) && self.width == 4
    }
}

/// The layout of records with these fields side by side, without gaps: position if x, y and z are
/// float32, intensity if a field of one of those names (the first that is there, in any case of
/// letters) is float32. `None` if the records are empty or too long.
pub(super) fn layout_of(fields: &[Field], intensity_names: &[&str], wrapping: Wrapping) -> Option<Layout> {
    let mut offsets = Vec::with_capacity(fields.len());
    let mut stride = 0u32;
    for field in fields {
        offsets.push(stride);
        stride = stride.checked_add(field.width).filter(|&s| s <= MAX_STRIDE)?;
    }
    let offset_of = |name: &str| {
        let at = fields.iter().position(|f| f.name.eq_ignore_ascii_case(name))?;
        fields[at].is_single_float32().then_some(offsets[at])
    };
    let position = match (offset_of("x"), offset_of("y"), offset_of("z")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    let intensity = intensity_names.iter().find_map(|name| offset_of(name));
    (stride > 0).then_some(Layout { wrapping, stride, position, intensity })
}

/// Takes one line off the front of `rest`, without its `\n` or `\r\n`; `None` at the end, for a
/// line that is not ended, and for one that is not text.
pub(super) fn next_line<'a>(rest: &mut &'a [u8]) -> Option<&'a str> {
    let end = rest.iter().position(|&b| b == b'\n')?;
    let line = &rest[..end];
    *rest = &rest[end + 1..];
    std::str::from_utf8(line.strip_suffix(b"\r").unwrap_or(line)).ok()
}
