//! A scan: points with named, typed channels, and metadata; and its table of ranges.

use std::collections::HashSet;

use super::scalar::{ChannelValues, Scalar};
use crate::container::{FrameKind, Stamp, Time, TimeSource};
use crate::files::{self, INTENSITY, POSITION};
use crate::frame::decoder::DecodedImage;
use crate::ground::error::{Error, Result};
use crate::ground::floats::square;
use crate::scan::{Channel, Field, Layout, MAX_STRIDE, PointCloud, ScalarType, ScanFile};

/// A scan: points with named, typed channels. Every bit of every value counts: NaN payloads and the sign of
/// zero are kept.
///
/// It is either [a file](Self::from_file), which is restored byte for byte, or points in memory, of which
/// positions and channels are restored.
///
/// ```
/// # fn main() -> lidarpc::Result<()> {
/// let scan = lidarpc::Scan::from_positions(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
///     .with_channel("intensity", &[0.25f32, 0.5])?
///     .with_channel("ring", &[7u16, 8])?
///     .with_time(1_316_998_000_123_456_789);
/// assert_eq!(scan.channel::<u16>("ring")?, [7, 8]);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct Scan {
    name: String,
    track: u8,
    time: Option<Time>,
    points: usize,
    positions: Vec<[f32; 3]>,
    /// All channels, in the order of the records.
    channels: Vec<TypedChannel>,
    /// The data needed to restore the file, if it was one.
    file: Option<Box<Envelope>>,
    /// The range image, if it was requested.
    image: Option<Box<RangeImage>>,
}

/// A field other than the position, with `count` values for each point.
#[derive(Clone, Debug)]
struct TypedChannel {
    name: String,
    /// Number of values per point.
    count: u32,
    values: ChannelValues,
}

/// A file without its points.
#[derive(Clone, Debug)]
struct Envelope {
    kind: FrameKind,
    layout: Layout,
    prefix: Vec<u8>,
    suffix: Vec<u8>,
}

/// The properties of a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ChannelInfo<'s> {
    /// Its name.
    pub name: &'s str,
    /// The type of its values.
    pub scalar: ScalarType,
    /// Number of values for each point, one after the other: 1, except for fields of files that have more.
    pub count: u32,
}

impl Scan {
    /// Points with positions only: x, y and z in metres.
    pub fn from_positions(positions: &[[f32; 3]]) -> Self {
        Scan { points: positions.len(), positions: positions.to_vec(), ..Scan::default() }
    }

    /// Points in KITTI's form: x, y and z in metres, and the intensity, which becomes a channel of that name.
    pub fn from_xyzi(points: &[[f32; 4]]) -> Self {
        let positions = points.iter().map(|&[x, y, z, _]| [x, y, z]).collect();
        let values = ChannelValues::F32(points.iter().map(|point| point[3]).collect());
        let intensity = TypedChannel { name: INTENSITY.to_owned(), count: 1, values };
        Scan { points: points.len(), positions, channels: vec![intensity], ..Scan::default() }
    }

    /// A file, given its name and bytes. The extension determines its format (`.bin`, `.pcd.bin`, `.pcd`,
    /// `.ply`, `.las`, `.csv`, `.txt`, `.xyz`, `.npy`, `.feather`). A file of any other kind is a scan
    /// without points.
    pub fn from_file(name: &str, bytes: Vec<u8>) -> Self {
        Scan::of_parts(files::parse(name, bytes), Stamp::default())
    }

    /// The scan with an additional channel, one value for each point. A channel named `intensity` (or `i`,
    /// `reflectivity` or `reflectance`) of type `f32`, `u8` or `u16` is coded as intensities. A scan that was
    /// a file becomes points in memory.
    ///
    /// # Errors
    /// [`Error::Usage`] if the number of values differs from the number of points, if the scan already has a
    /// channel of this name (x, y and z included), if it has 253 channels, or if the name is invalid: empty,
    /// longer than 64 bytes, or with white space.
    pub fn with_channel<T: Scalar>(mut self, name: &str, values: &[T]) -> Result<Self> {
        let refuse = |what: String| Err(Error::Usage(format!("channel {name:?}: {what}")));
        if name.is_empty() || !Field::is_name(name) {
            return refuse("a name has 1 to 64 bytes without white space".to_owned());
        }
        if POSITION.contains(&name) || self.channels.iter().any(|channel| channel.name == name) {
            return refuse("the scan has it already".to_owned());
        }
        if POSITION.len() + self.channels.len() >= files::MOST_FIELDS {
            return refuse(format!("a scan has at most {} channels", files::MOST_FIELDS - POSITION.len()));
        }
        if values.len() != self.points {
            return refuse(format!("{} values for {} points", values.len(), self.points));
        }
        let width = self
            .channels
            .iter()
            .map(|channel| channel.count as usize * channel.values.scalar().size() as usize);
        if width.sum::<usize>() + 3 * size_of::<f32>() + size_of::<T>() > MAX_STRIDE as usize {
            return refuse(format!("a point is at most {MAX_STRIDE} bytes"));
        }
        let values = T::into_values(values.to_vec());
        self.channels.push(TypedChannel { name: name.to_owned(), count: 1, values });
        self.file = None;
        Ok(self)
    }

    /// The scan with a name for its frame in the stream, such as `000001`. A file already has one.
    #[must_use]
    pub fn with_name(self, name: &str) -> Self {
        Scan { name: name.to_owned(), ..self }
    }

    /// The scan with the time at which it was taken: nanoseconds since 1970.
    #[must_use]
    pub fn with_time(self, nanoseconds: i64) -> Self {
        Scan { time: Some(Time { source: TimeSource::Recording, nanoseconds }), ..self }
    }

    /// The scan as one from another scanner than that of track 0. Scans from several scanners may alternate;
    /// those of each are modelled separately.
    #[must_use]
    pub fn with_track(self, track: u8) -> Self {
        Scan { track, ..self }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points == 0
    }

    /// x, y and z of each point, in metres; empty if the scan [has none](Self::has_positions).
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    /// Whether each point has a position. The points of a file whose coordinates are not float32 have none, as
    /// these are channels named `x`, `y` and `z`; nor have those of a file without coordinates.
    pub fn has_positions(&self) -> bool {
        let is_other = || self.channels.iter().any(|channel| channel.name == POSITION[0]);
        self.positions.len() == self.points && !(self.is_empty() && is_other())
    }

    /// The values of a channel, point after point.
    ///
    /// # Errors
    /// [`Error::Usage`] if the scan has no channel of this name, or if its type is another; the message says
    /// which.
    pub fn channel<T: Scalar>(&self, name: &str) -> Result<&[T]> {
        let values = self.values(name)?;
        T::of_values(values).ok_or_else(|| {
            let (wanted, scalar) = (T::TYPE.name(), values.scalar().name());
            Error::Usage(format!("channel {name:?} holds {scalar}, not {wanted}"))
        })
    }

    /// The values of a channel of any type, point after point.
    ///
    /// # Errors
    /// [`Error::Usage`] if the scan has no channel of this name.
    pub fn values(&self, name: &str) -> Result<&ChannelValues> {
        let channel = self.channels.iter().find(|channel| channel.name == name);
        let channel = channel.ok_or_else(|| Error::Usage(format!("the scan has no channel {name:?}")))?;
        Ok(&channel.values)
    }

    /// The named channels, in the order of the records: all fields except the position, and of a file's
    /// fields with the same name only the first.
    pub fn channels(&self) -> impl Iterator<Item = ChannelInfo<'_>> {
        let mut names = HashSet::from([""]);
        self.channels.iter().filter(move |channel| names.insert(&channel.name)).map(|channel| ChannelInfo {
            name: &channel.name,
            scalar: channel.values.scalar(),
            count: channel.count,
        })
    }

    /// The time at which it was taken, in nanoseconds since 1970, if known.
    pub fn time(&self) -> Option<i64> {
        self.time.map(|time| time.nanoseconds)
    }

    /// Its name, such as `000001.bin`; empty if it has none. A name from a stream may be any string: check it
    /// before use as a path.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Which of several alternating scanners it is from; the first is 0.
    pub fn track(&self) -> u8 {
        self.track
    }

    /// The kind of input: a file, a message, or points in memory.
    pub fn kind(&self) -> FrameKind {
        self.file.as_ref().map_or(FrameKind::Points, |file| file.kind)
    }

    /// The bytes of the file; `None` if it was none.
    ///
    /// # Errors
    /// Never for a scan from [`from_file`](Self::from_file) or a [`Decoder`](crate::Decoder).
    pub fn file_bytes(&self) -> Result<Option<Vec<u8>>> {
        self.file.is_some().then(|| self.clone().into_parts().0.to_bytes()).transpose()
    }

    /// Its points in the scanner's rows and columns, if the scan is from a [`Decoder`](crate::Decoder) that
    /// returns [range images](crate::Decoder::with_range_images) and the scanner is known; otherwise `None`.
    pub fn range_image(&self) -> Option<&RangeImage> {
        self.image.as_deref()
    }

    /// The scan with this range image.
    pub(super) fn with_range_image(self, image: Option<RangeImage>) -> Self {
        Scan { image: image.map(Box::new), ..self }
    }

    /// A scan from a parsed or decoded file.
    pub(crate) fn of_parts(scan: ScanFile, stamp: Stamp) -> Self {
        let ScanFile { name, layout, prefix, records, cloud, suffix } = scan;
        let mut channels: Vec<_> = cloud
            .channels
            .into_iter()
            .map(|Channel { field, bytes }| TypedChannel {
                values: ChannelValues::from_le_bytes(field.scalar, &bytes),
                name: field.name,
                count: field.count,
            })
            .collect();
        if let Some((place, field)) = intensity_channel(&layout) {
            let values = intensity_values(field.scalar, cloud.intensity);
            let channel = TypedChannel { name: field.name.clone(), count: 1, values };
            channels.insert(place.min(channels.len()), channel);
        }
        let Stamp { kind, track, time } = stamp;
        let file = (kind != FrameKind::Points).then(|| Box::new(Envelope { kind, layout, prefix, suffix }));
        Scan { name, track, time, points: records, positions: cloud.positions, channels, file, image: None }
    }

    /// The scan as parts for the encoder.
    pub(crate) fn into_parts(self) -> (ScanFile, Stamp) {
        let stamp = Stamp { kind: self.kind(), track: self.track, time: self.time };
        let (layout, prefix, suffix) = match self.file {
            Some(file) => (file.layout, file.prefix, file.suffix),
            None => (
                layout_in_memory(self.positions.len() == self.points, &self.channels),
                Vec::new(),
                Vec::new(),
            ),
        };
        let mut cloud = PointCloud { positions: self.positions, ..PointCloud::default() };
        let intensity = intensity_channel(&layout).map(|(place, _)| place);
        for (place, TypedChannel { name, count, values }) in self.channels.into_iter().enumerate() {
            if intensity == Some(place) {
                cloud.intensity = intensities(values);
            } else {
                let field = Field { name, scalar: values.scalar(), count };
                cloud.channels.push(Channel { field, bytes: values.to_le_bytes() });
            }
        }
        let records = self.points;
        (ScanFile { name: self.name, layout, prefix, records, cloud, suffix }, stamp)
    }
}

/// The index of the intensity among the channels, and its field.
fn intensity_channel(layout: &Layout) -> Option<(usize, &Field)> {
    let number = layout.intensity?;
    let positions_before = layout.position.iter().flatten().filter(|field| **field < number).count();
    Some((number as usize - positions_before, layout.fields.get(number as usize)?))
}

/// Intensities, which are coded as float32, converted to the type of their field.
fn intensity_values(scalar: ScalarType, values: Vec<f32>) -> ChannelValues {
    match scalar {
        ScalarType::U8 => ChannelValues::U8(values.into_iter().map(|value| (value + 0.5) as u8).collect()),
        ScalarType::U16 => ChannelValues::U16(values.into_iter().map(|value| (value + 0.5) as u16).collect()),
        _ => ChannelValues::F32(values),
    }
}

/// The inverse of [`intensity_values`]; empty for types that intensities cannot have.
fn intensities(values: ChannelValues) -> Vec<f32> {
    match values {
        ChannelValues::F32(values) => values,
        ChannelValues::U8(values) => values.into_iter().map(f32::from).collect(),
        ChannelValues::U16(values) => values.into_iter().map(f32::from).collect(),
        _ => Vec::new(),
    }
}

/// The layout of points in memory: that of a file without a header whose records have the same fields.
fn layout_in_memory(has_positions: bool, channels: &[TypedChannel]) -> Layout {
    let positions = POSITION.map(|name| Field::new(name, ScalarType::F32));
    let positions = positions.into_iter().filter(|_| has_positions);
    let others = channels.iter().map(|TypedChannel { name, count, values }| Field {
        name: name.clone(),
        scalar: values.scalar(),
        count: *count,
    });
    let layout = files::plain_layout(positions.chain(others).collect());
    let mut layout = layout.unwrap_or_default();
    layout.position = layout.position.filter(|_| has_positions);
    let values = intensity_channel(&layout).and_then(|(place, _)| Some(&channels.get(place)?.values));
    if let Some(ChannelValues::U16(values)) = values
        && !files::are_intensities(ScalarType::U16, values.iter().map(|&value| value.into()))
    {
        layout.intensity = None;
    }
    layout
}

/// The points of a scan in the rows and columns of the scanner: a row for each laser, a column for each
/// azimuth at which the lasers fired. Second returns, and points that the scanner's formula does not explain,
/// have no cell.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeImage {
    rows: usize,
    columns: usize,
    ranges: Vec<f32>,
    points: Vec<Option<u32>>,
}

impl RangeImage {
    /// The decoded image for the public interface.
    pub(super) fn new(decoded: &DecodedImage, positions: &[[f32; 3]]) -> Self {
        let (steps, scanner) = (&decoded.image.steps, &decoded.scanner);
        let points = decoded.point_of_cell.cells().to_vec();
        let range = |(&steps, point): (&u32, &Option<u32>)| match (steps, point) {
            (0, _) => 0.0,
            // The scanner's ranges are not multiples of a step.
            (_, Some(point)) if scanner.range_step_m() == 0.0 => {
                let position = positions.get(*point as usize).copied().unwrap_or_default();
                position.iter().map(|metres| square(f64::from(*metres))).sum::<f64>().sqrt() as f32
            }
            _ => scanner.metres(steps) as f32,
        };
        let ranges = steps.cells().iter().zip(&points).map(range).collect();
        RangeImage { rows: steps.rows(), columns: steps.columns(), ranges, points }
    }

    /// Number of lasers.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of azimuths.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The range of the first return of each cell from the laser, in metres, row after row; 0 for cells
    /// without one.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// The index of the scan's point in each cell, counted from 0, row after row. Records without a measured
    /// point that were kept have a cell, too.
    pub fn points(&self) -> &[Option<u32>] {
        &self.points
    }
}
