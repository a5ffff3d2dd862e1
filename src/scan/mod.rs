//! A scan in memory: the points, and what is needed to restore the file byte for byte.

mod layout;
mod scalar;
pub mod sorted;
mod text_format;

pub use layout::{
    Axis, Field, INTENSITY_TYPES, Layout, LzfDialect, MAX_NAME, MAX_STRIDE, Widening, Wrapping,
};
pub use scalar::{Number, ScalarType};
pub use text_format::{Column, MAX_DIGITS, NumberRule, Printf, Separator, TextFormat};

use crate::ground::floats::square;

/// The points of one scan, in the order of the file. Every bit of every value counts:
/// NaN payloads and the sign of zero are kept.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    /// x, y, z in metres, one entry for each point. Empty if the file's records hold no float32 position.
    pub positions: Vec<[f32; 3]>,
    /// One value for each point, in the file's own unit. Empty if the records hold no intensity.
    pub intensity: Vec<f32>,
    /// The channels: all other fields, in the order of the records.
    pub channels: Vec<Channel>,
}

/// A field of all points.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its name and type.
    pub field: Field,
    /// The little-endian bytes of its values, point after point.
    pub bytes: Vec<u8>,
}

impl PointCloud {
    /// The points with these numbers, in this order.
    pub fn select(&self, points: &[u32]) -> PointCloud {
        PointCloud {
            positions: pick(&self.positions, points),
            intensity: pick(&self.intensity, points),
            channels: self.channels.iter().map(|channel| channel.select(points)).collect(),
        }
    }

    /// These points and then those of another cloud. `None` if the clouds have different fields.
    pub fn followed_by(&self, other: &PointCloud) -> Option<PointCloud> {
        let both = |one: &Channel, other: &Channel| {
            let bytes = [&one.bytes[..], &other.bytes].concat();
            (one.field == other.field).then(|| Channel { field: one.field.clone(), bytes })
        };
        let channels = self.channels.iter().zip(&other.channels);
        let have_same = self.channels.len() == other.channels.len()
            && self.intensity.is_empty() == other.intensity.is_empty();
        Some(PointCloud {
            positions: [&self.positions[..], &other.positions].concat(),
            intensity: [&self.intensity[..], &other.intensity].concat(),
            channels: channels
                .map(|(one, other)| both(one, other))
                .collect::<Option<_>>()
                .filter(|_| have_same)?,
        })
    }

    /// The number of points that have a direction. Organised clouds also hold points for beams without a
    /// return.
    pub fn measured(&self) -> usize {
        self.positions.iter().filter(|position| has_direction(position)).count()
    }

    /// The channel with this name.
    #[cfg(test)]
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.field.name == name)
    }
}

impl Channel {
    /// The bytes of a point's value.
    pub fn value(&self, point: usize) -> &[u8] {
        let width = self.field.width();
        &self.bytes[point * width..][..width]
    }

    /// The values of the points with these numbers, in this order.
    fn select(&self, points: &[u32]) -> Channel {
        let width = self.field.width();
        let value = |&point: &u32| &self.bytes[point as usize * width..][..width];
        Channel { field: self.field.clone(), bytes: points.iter().flat_map(value).copied().collect() }
    }
}

/// Whether a point has a direction: x and y are finite and not both 0.
pub fn has_direction([x, y, _]: &[f32; 3]) -> bool {
    (x.abs() + y.abs()).is_finite() && (*x != 0.0 || *y != 0.0)
}

/// The values at the indices `points`; nothing if there are no values at all.
fn pick<T: Copy>(values: &[T], points: &[u32]) -> Vec<T> {
    if values.is_empty() { Vec::new() } else { points.iter().map(|&point| values[point as usize]).collect() }
}

/// A file, split into records of points and the bytes around them. A file without records of a known kind is
/// all `prefix`.
#[derive(Clone, Debug, Default)]
pub struct ScanFile {
    /// The name under which the file is restored, without any folder.
    pub name: String,
    /// How the records are laid out.
    pub layout: Layout,
    /// Bytes before the records, such as a PCD header.
    pub prefix: Vec<u8>,
    /// Number of records.
    pub records: usize,
    /// The contents of the records.
    pub cloud: PointCloud,
    /// Bytes after the records, such as an incomplete last record.
    pub suffix: Vec<u8>,
}

impl ScanFile {
    /// A file without records of a known kind: all bytes are `prefix`.
    pub fn opaque(name: impl Into<String>, bytes: Vec<u8>) -> Self {
        ScanFile { name: name.into(), prefix: bytes, ..ScanFile::default() }
    }

    /// True if the file has no records and its bytes are kept as they are.
    pub fn is_opaque(&self) -> bool {
        self.layout.fields.is_empty()
    }
}

/// The scan of a sample with the most returns.
pub fn fullest(sample: &[ScanFile]) -> Option<&ScanFile> {
    sample.iter().max_by_key(|scan| scan.cloud.measured())
}

/// Squared 3-D distance of two positions, in square metres.
pub fn squared_distance(a: &[f32; 3], b: &[f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| square(f64::from(*a) - f64::from(*b))).sum()
}
