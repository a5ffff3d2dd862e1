//! Clouds in messages: `sensor_msgs/PointCloud2` and `point_cloud_interfaces/CompressedPointCloud2`, as ROS 1
//! and ROS 2 serialise them.
//!
//! Both begin in the same way: header, height, width, fields, byte order, size of a record and of a row. Then
//! come the records or the compressed payload, a flag for whether all points are valid and, in the compressed
//! message, the name of its format.

use std::ops::Range;

use crate::files::{big_endian_file, plain_file, plain_layout};
use crate::ground::error::{Error, Result};
use crate::scan::{Field, Layout, MAX_STRIDE, ScalarType, ScanFile, Wrapping};

/// The format that compressed messages name.
pub const FORMAT: &str = "lidarpc";

/// How messages are serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// ROS 1: one value after another, little-endian.
    Ros1,
    /// ROS 2, CDR: four bytes that identify the byte order, then values at multiples of their size.
    Cdr,
}

impl Encoding {
    /// The encoding with this name in a channel, if it is known.
    pub fn of(name: &str) -> Option<Self> {
        match name {
            "cdr" => Some(Encoding::Cdr),
            "ros1" => Some(Encoding::Ros1),
            _ => None,
        }
    }

    /// The names of a channel's schema for clouds and for compressed clouds.
    pub fn schemas(self) -> [&'static str; 2] {
        match self {
            Encoding::Ros1 => ["sensor_msgs/PointCloud2", "point_cloud_interfaces/CompressedPointCloud2"],
            Encoding::Cdr => {
                ["sensor_msgs/msg/PointCloud2", "point_cloud_interfaces/msg/CompressedPointCloud2"]
            }
        }
    }

    /// The schema of clouds or of compressed clouds: its encoding and its text, without comments.
    pub fn schema(self, is_compressed: bool) -> (&'static str, String) {
        let rule = "=".repeat(80);
        let (kind, time, sequence) = match self {
            Encoding::Ros1 => ("ros1msg", "time stamp", "uint32 seq\n"),
            Encoding::Cdr => ("ros2msg", "builtin_interfaces/Time stamp", ""),
        };
        let (data, format) =
            if is_compressed { ("compressed_data", "string format\n") } else { ("data", "") };
        let mut text = format!(
            "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n\
             bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] {data}\nbool is_dense\n\
             {format}{rule}\nMSG: std_msgs/Header\n{sequence}{time}\nstring frame_id\n{rule}\n\
             MSG: sensor_msgs/PointField\nuint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\n\
             uint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\n\
             uint8 datatype\nuint32 count\n"
        );
        if self == Encoding::Cdr {
            text.push_str(&format!("{rule}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"));
        }
        (kind, text)
    }
}

/// The common beginning of both messages, and the position of their data.
struct Cloud<'m> {
    /// Nanoseconds since 1970.
    stamp: i64,
    /// Number of points.
    points: u64,
    fields: Vec<PointField<'m>>,
    is_big_endian: bool,
    record_bytes: u32,
    row_bytes: u32,
    rows: u32,
    /// Where the length of the data is stored.
    length_at: usize,
    data: Range<usize>,
    is_dense: u8,
}

/// A field as described in the message.
struct PointField<'m> {
    name: &'m str,
    offset: u32,
    datatype: u8,
    count: u32,
}

/// Reads the values of a message.
struct Values<'m> {
    bytes: &'m [u8],
    at: usize,
    encoding: Encoding,
    is_big_endian: bool,
}

/// Size of the header of a CDR message, in bytes.
const ENCAPSULATION: usize = 4;

impl<'m> Values<'m> {
    /// `None` if a CDR message has no valid header.
    fn new(bytes: &'m [u8], encoding: Encoding) -> Option<Self> {
        let (at, is_big_endian) = match (encoding, bytes) {
            (Encoding::Ros1, _) => (0, false),
            (Encoding::Cdr, [0, order @ (0 | 1), _, _, ..]) => (ENCAPSULATION, *order == 0),
            _ => return None,
        };
        Some(Values { bytes, at, encoding, is_big_endian })
    }

    fn take(&mut self, bytes: usize) -> Option<&'m [u8]> {
        let taken = self.bytes.get(self.at..)?.get(..bytes)?;
        self.at += bytes;
        Some(taken)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take(1).map(|bytes| bytes[0])
    }

    fn u32(&mut self) -> Option<u32> {
        if self.encoding == Encoding::Cdr {
            self.at = ENCAPSULATION + (self.at - ENCAPSULATION).next_multiple_of(4);
        }
        let bytes = self.take(4)?.try_into().ok()?;
        Some(if self.is_big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    /// In CDR, strings end with a zero byte, which their length includes.
    fn string(&mut self) -> Option<&'m str> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        let text = match self.encoding {
            Encoding::Ros1 => bytes,
            Encoding::Cdr => bytes.strip_suffix(&[0]).unwrap_or(bytes),
        };
        std::str::from_utf8(text).ok()
    }
}

impl<'m> Cloud<'m> {
    /// Parses a message up to its data and what follows them in both kinds; `None` if it is truncated.
    fn read(values: &mut Values<'m>) -> Option<Self> {
        /// No record has more fields.
        const MOST_FIELDS: u32 = 1024;
        if values.encoding == Encoding::Ros1 {
            values.u32()?;
        }
        let (seconds, nanoseconds) = (values.u32()?, values.u32()?);
        let seconds = match values.encoding {
            Encoding::Ros1 => i64::from(seconds),
            Encoding::Cdr => i64::from(seconds as i32),
        };
        values.string()?;
        let (rows, columns) = (values.u32()?, values.u32()?);
        let count = values.u32().filter(|count| *count <= MOST_FIELDS)?;
        let field = |_| {
            let (name, offset) = (values.string()?, values.u32()?);
            Some(PointField { name, offset, datatype: values.u8()?, count: values.u32()? })
        };
        let fields = (0..count).map(field).collect::<Option<_>>()?;
        let is_big_endian = values.u8()? != 0;
        let (record_bytes, row_bytes) = (values.u32()?, values.u32()?);
        let length = values.u32()? as usize;
        let data = values.at..values.at.checked_add(length)?;
        values.take(length)?;
        Some(Cloud {
            stamp: seconds * 1_000_000_000 + i64::from(nanoseconds),
            points: u64::from(rows) * u64::from(columns),
            fields,
            is_big_endian,
            record_bytes,
            row_bytes,
            rows,
            length_at: data.start - 4,
            data,
            is_dense: values.u8()?,
        })
    }

    /// The fields of a record, with padding where the message describes none. `None` if they overlap, have an
    /// unknown type, or do not fit.
    fn layout(&self) -> Option<Layout> {
        let mut described: Vec<&PointField> = self.fields.iter().collect();
        described.sort_by_key(|field| field.offset);
        let mut fields = Vec::new();
        let mut end = 0;
        for PointField { name, offset, datatype, count } in
            described.into_iter().filter(|field| field.count > 0)
        {
            let gap = offset.checked_sub(end)?;
            if gap > 0 {
                fields.push(Field::padding(gap));
            }
            let scalar = scalar(*datatype)?;
            // An invalid field name can be dropped here, because the bytes of the message are kept.
            let name = if Field::is_name(name) { *name } else { "" };
            fields.push(Field { name: name.to_owned(), scalar, count: *count });
            end = offset.checked_add(scalar.size().checked_mul(*count)?)?;
            if end > MAX_STRIDE {
                return None;
            }
        }
        let rest = self.record_bytes.checked_sub(end)?;
        if rest > 0 {
            fields.push(Field::padding(rest));
        }
        plain_layout(fields)
    }
}

/// The type of a field, by its number in the message.
fn scalar(datatype: u8) -> Option<ScalarType> {
    use ScalarType::{F32, F64, I8, I16, I32, U8, U16, U32};
    [I8, U8, I16, U16, I32, U32, F32, F64].get(usize::from(datatype.checked_sub(1)?)).copied()
}

/// Parses a cloud. The bytes around its records are kept, so that the message can be restored. `None` if the
/// message is not a cloud, or is one that cannot be parsed.
pub fn scan(message: &[u8], encoding: Encoding) -> Option<(ScanFile, i64)> {
    let cloud = Cloud::read(&mut Values::new(message, encoding)?)?;
    let layout = cloud.layout()?;
    let bytes = cloud.points.checked_mul(cloud.record_bytes.into())?;
    let is_contiguous = cloud.rows <= 1 || u64::from(cloud.row_bytes) * u64::from(cloud.rows) == bytes;
    let is_whole = bytes == cloud.data.len() as u64;
    if !is_contiguous || !is_whole {
        return None;
    }
    let start = cloud.data.start;
    let scan = match cloud.is_big_endian {
        false => plain_file(layout, message, start, cloud.points),
        true => big_endian_file(layout, message, start, cloud.points),
    };
    Some((scan?, cloud.stamp))
}

/// Only the records of a parsed cloud, as little-endian points without a message. `None` if they have no
/// position.
pub fn points(scan: ScanFile) -> Option<ScanFile> {
    scan.layout.position?;
    // In memory, the values of big-endian records have the order of little-endian ones.
    let layout = Layout { wrapping: Wrapping::Plain, ..scan.layout };
    Some(ScanFile { layout, prefix: Vec::new(), suffix: Vec::new(), ..scan })
}

/// The compressed message of a cloud, with this payload.
///
/// # Errors
/// If the message is not a cloud, or the payload is too large for a message.
pub fn compress(message: &[u8], encoding: Encoding, payload: &[u8]) -> Result<Vec<u8>> {
    let values = Values::new(message, encoding);
    let cloud = values.and_then(|mut values| Some((Cloud::read(&mut values)?, values.is_big_endian)));
    let (cloud, is_big_endian) = cloud.ok_or_else(|| Error::corrupt("a message that is no cloud"))?;
    let length = |length: usize| -> Result<[u8; 4]> {
        let length = u32::try_from(length).map_err(|_| {
            Error::Usage(format!("a compressed cloud of {length} bytes, more than a message can hold"))
        })?;
        Ok(if is_big_endian { length.to_be_bytes() } else { length.to_le_bytes() })
    };
    let mut out = message[..cloud.length_at].to_vec();
    out.extend(length(payload.len())?);
    out.extend_from_slice(payload);
    out.push(cloud.is_dense);
    match encoding {
        Encoding::Ros1 => {
            out.extend(length(FORMAT.len())?);
            out.extend_from_slice(FORMAT.as_bytes());
        }
        Encoding::Cdr => {
            out.resize(ENCAPSULATION + (out.len() - ENCAPSULATION).next_multiple_of(4), 0);
            out.extend(length(FORMAT.len() + 1)?);
            out.extend_from_slice(FORMAT.as_bytes());
            out.push(0);
        }
    }
    Ok(out)
}

/// The payload of a compressed message; `None` if it has another format or is not a compressed cloud.
pub fn payload(message: &[u8], encoding: Encoding) -> Option<&[u8]> {
    let mut values = Values::new(message, encoding)?;
    let cloud = Cloud::read(&mut values)?;
    (values.string()? == FORMAT).then(|| &message[cloud.data])
}
