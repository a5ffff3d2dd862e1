//! Named fields of a record, as the headers of PCD and PLY declare them.

use crate::scan::{Layout, MAX_STRIDE, Scalar, Wrapping};

/// What writers call intensity, the likeliest first; `scalar_intensity` is CloudCompare's.
const INTENSITY_NAMES: [&str; 5] = ["intensity", "scalar_intensity", "i", "reflectivity", "reflectance"];

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
    /// How many values it has, if it is of a known type; else 1.
    pub fn count(&self) -> u32 {
        self.scalar.map_or(1, |scalar| self.width / scalar.size())
    }

    fn is_single_float32(&self) -> bool {
        self.scalar == Some(Scalar::F32) && self.width == 4
    }
}

/// The field of this name, in any case of letters.
pub(super) fn find(fields: &[Field], name: &str) -> Option<usize> {
    fields.iter().position(|field| field.name.eq_ignore_ascii_case(name))
}

/// The field that holds intensities: that of the likeliest name, of those that `suits` approves.
pub(super) fn find_intensity(fields: &[Field], suits: impl Fn(&Field) -> bool) -> Option<usize> {
    INTENSITY_NAMES.iter().find_map(|name| find(fields, name).filter(|&at| suits(&fields[at])))
}

/// The layout of records with these fields side by side, without gaps: position if x, y and z are
/// float32, intensity if a float32 field has a name for it. `None` if the records are empty or too
/// long.
pub(super) fn layout_of(fields: &[Field], wrapping: Wrapping) -> Option<Layout> {
    let mut offsets = Vec::with_capacity(fields.len());
    let mut stride = 0u32;
    for field in fields {
        offsets.push(stride);
        stride = stride.checked_add(field.width).filter(|&s| s <= MAX_STRIDE)?;
    }
    let offset_of = |name: &str| {
        let at = find(fields, name)?;
        fields[at].is_single_float32().then_some(offsets[at])
    };
    let position = match (offset_of("x"), offset_of("y"), offset_of("z")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    let intensity = find_intensity(fields, |field| field.is_single_float32()).map(|at| offsets[at]);
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
