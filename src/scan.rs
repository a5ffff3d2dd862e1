//! A scan in memory: the points, and what it takes to give the file back byte for byte.

/// The points of one scan, in the order of the file. Every bit of every value counts:
/// NaN payloads and the sign of zero are kept.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    /// x, y, z in metres, one entry a point. Empty if the file's records hold no float32 position.
    pub positions: Vec<[f32; 3]>,
    /// One value a point, in the file's own unit. Empty if the records hold no float32 intensity.
    pub intensity: Vec<f32>,
    /// The bytes of each record that are neither position nor intensity, record after record,
    /// `Layout::extra_stride` bytes each.
    pub extra: Vec<u8>,
}

/// How the records of a file are laid out, and how they are wrapped into it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// How the records stand in the file.
    pub wrapping: Wrapping,
    /// Bytes a record; 0 if the file holds no records.
    pub stride: u32,
    /// Where the little-endian float32 x, y and z are in a record (byte offsets).
    pub position: Option<[u32; 3]>,
    /// Where the little-endian float32 intensity is in a record (byte offset).
    pub intensity: Option<u32>,
}

impl Layout {
    /// Bytes of a record that are neither position nor intensity.
    pub fn extra_stride(&self) -> usize {
        let known = 12 * u32::from(self.position.is_some()) + 4 * u32::from(self.intensity.is_some());
        self.stride.saturating_sub(known) as usize
    }
}

/// A file, taken apart into records of points and the bytes around them.
/// A file that holds no records of a known kind is all `prefix`.
#[derive(Clone, Debug, Default)]
pub struct ScanFile {
    /// The file's name as it is to come back, without any folder.
    pub name: String,
    /// How the records are laid out.
    pub layout: Layout,
    /// Bytes before the records, such as a PCD header.
    pub prefix: Vec<u8>,
    /// Number of records.
    pub records: usize,
    /// What the records hold.
    pub cloud: PointCloud,
    /// Bytes after the records, such as a cut-off last record.
    pub suffix: Vec<u8>,
}

/// How the records stand in the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Wrapping {
    /// One after the other (KITTI `.bin`, binary PCD, binary little-endian PLY).
    #[default]
    Plain,
}
