//! Named fields of a record, as the headers of files declare them.

use crate::scan::{Field, INTENSITY_TYPES, Layout, MAX_NAME, MAX_STRIDE, ScalarType, Wrapping};

/// The name given to an intensity without a name.
pub(crate) const INTENSITY: &str = "intensity";
/// The usual names of the intensity, the likeliest first; `scalar_intensity` is CloudCompare's.
const INTENSITY_NAMES: [&str; 5] = [INTENSITY, "scalar_intensity", "i", "reflectivity", "reflectance"];
/// Tables with fewer columns are not points.
pub(super) const FEWEST_COLUMNS: usize = 3;
/// The names of the coordinates.
pub(crate) const POSITION: [&str; 3] = ["x", "y", "z"];
/// PCL's name for padding.
const PADDING: &str = "_";

/// One field of a record, as a header declares it.
#[derive(Clone, Debug)]
pub(super) struct Declared<'a> {
    /// Its name.
    pub name: &'a str,
    /// The type of its values, if it is a type that this program knows.
    pub scalar: Option<ScalarType>,
    /// Number of bytes that a record has for it.
    pub width: u32,
}

impl Declared<'_> {
    /// Number of values, if they are of a known type; otherwise 1.
    pub fn count(&self) -> u32 {
        self.scalar.map_or(1, |scalar| self.width / scalar.size())
    }

    /// Whether its meaning is unknown.
    pub fn is_padding(&self) -> bool {
        self.name == PADDING || self.scalar.is_none()
    }

    /// The field; `None` if it takes no bytes.
    pub fn field(&self) -> Option<Field> {
        if self.width == 0 {
            return None;
        }
        Some(match self.scalar {
            Some(scalar) => Field { name: name_of(self.name), scalar, count: self.width / scalar.size() },
            None => Field::padding(self.width),
        })
    }
}

/// The name of the field in a layout: shortened if it is too long, empty for padding.
pub(super) fn name_of(name: &str) -> String {
    let name = (0..=MAX_NAME.min(name.len())).rev().find_map(|end| name.get(..end)).unwrap_or_default();
    if name == PADDING || !Field::is_name(name) { String::new() } else { name.to_owned() }
}

/// A name with its white space replaced.
pub(super) fn with_underscores(name: &str) -> String {
    name.split_whitespace().collect::<Vec<_>>().join("_")
}

/// The largest number of fields of a record; scanners' have 3 to about 20.
pub const MOST_FIELDS: usize = 256;

/// The names of columns in files without names: those of KITTI, then numbers.
pub(super) fn usual_names(columns: usize) -> Vec<String> {
    let known = POSITION.into_iter().chain([INTENSITY]).map(str::to_owned);
    known.chain((5..).map(|number| format!("column_{number}"))).take(columns).collect()
}

/// Whether the coordinates are among these names, ignoring case.
pub(super) fn names_coordinates<'a>(names: impl Iterator<Item = &'a str> + Clone) -> bool {
    POSITION.iter().all(|axis| names.clone().any(|name| name.eq_ignore_ascii_case(axis)))
}

/// Whether this is the name of a coordinate, ignoring case.
pub(super) fn is_coordinate(name: &str) -> bool {
    POSITION.iter().any(|axis| name.eq_ignore_ascii_case(axis))
}

/// Whether this is a name of an intensity, ignoring case.
pub(super) fn is_intensity(name: &str) -> bool {
    INTENSITY_NAMES.iter().any(|known| name.eq_ignore_ascii_case(known))
}

/// The field with this name, ignoring case.
pub(super) fn find(fields: &[Field], name: &str) -> Option<usize> {
    fields.iter().position(|field| field.name.eq_ignore_ascii_case(name))
}

/// The field that holds intensities: of those that `suits` accepts, the one with the likeliest name.
pub(super) fn find_intensity(fields: &[Field], suits: impl Fn(&Field) -> bool) -> Option<usize> {
    INTENSITY_NAMES.iter().find_map(|name| find(fields, name).filter(|&at| suits(&fields[at])))
}

/// The layout of records with these fields side by side. They have a position if x, y and z are single
/// float32 values, and an intensity if a single float32, u8 or u16 value has one of its names. `None` if the
/// records are empty, too long or of too many fields: each has models of its own.
pub(super) fn layout_of(fields: Vec<Field>, wrapping: Wrapping) -> Option<Layout> {
    let stride: u64 = fields.iter().map(|field| field.width() as u64).sum();
    if stride == 0 || stride > MAX_STRIDE.into() || fields.len() > MOST_FIELDS {
        return None;
    }
    let coordinate = |name: &str| {
        let at = find(&fields, name)?;
        let suits = fields[at].scalar == ScalarType::F32 && fields[at].count == 1;
        suits.then_some(at as u32)
    };
    let position = match (coordinate("x"), coordinate("y"), coordinate("z")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    let suits = |field: &Field| INTENSITY_TYPES.contains(&field.scalar) && field.count == 1;
    let intensity = find_intensity(&fields, suits).map(|at| at as u32);
    Some(Layout { wrapping, fields, position, intensity })
}

/// Takes one line off the front of `rest`, without its `\n` or `\r\n`; `None` at the end, for an incomplete
/// line, and for a line that is not text.
pub(super) fn next_line<'a>(rest: &mut &'a [u8]) -> Option<&'a str> {
    let end = rest.iter().position(|&b| b == b'\n')?;
    let line = &rest[..end];
    *rest = &rest[end + 1..];
    std::str::from_utf8(line.strip_suffix(b"\r").unwrap_or(line)).ok()
}
