//! ROS messages with clouds.

use super::scans::Points;

/// Writes values as CDR or ROS 1 do.
struct Message {
    bytes: Vec<u8>,
    is_cdr: bool,
    is_big_endian: bool,
}

impl Message {
    fn new(is_cdr: bool, is_big_endian: bool) -> Self {
        let start: &[u8] = if is_cdr { &[0, u8::from(!is_big_endian), 0, 0] } else { &[] };
        Message { bytes: start.to_vec(), is_cdr, is_big_endian }
    }

    fn u32(&mut self, value: u32) {
        if self.is_cdr {
            self.bytes.resize(self.bytes.len().next_multiple_of(4), 0xee);
        }
        self.bytes.extend(if self.is_big_endian { value.to_be_bytes() } else { value.to_le_bytes() });
    }

    fn text(&mut self, text: &str) {
        self.u32((text.len() + usize::from(self.is_cdr)) as u32);
        self.bytes.extend(text.bytes());
        if self.is_cdr {
            self.bytes.push(0);
        }
    }
}

/// A cloud with fields in records of 26 bytes: x, y, z, intensity, ring, and a float64 time at an offset that
/// is not a multiple of 8.
pub fn cloud(points: &Points, is_cdr: bool, is_big_endian: bool) -> Vec<u8> {
    let mut message = Message::new(is_cdr, is_big_endian);
    if !is_cdr {
        message.u32(7);
    }
    message.u32(1_700_000_000);
    message.u32(123_456_789);
    message.text("lidar");
    message.u32(1);
    message.u32(points.len() as u32);
    let fields =
        [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("timestamp", 18, 8)];
    message.u32(fields.len() as u32);
    for (name, offset, kind) in fields {
        message.text(name);
        message.u32(offset);
        message.bytes.push(kind);
        message.u32(1);
    }
    message.bytes.push(u8::from(is_big_endian));
    message.u32(26);
    message.u32(26 * points.len() as u32);
    message.u32(26 * points.len() as u32);
    for (number, point) in points.iter().enumerate() {
        let mut put = |bytes: &[u8]| match is_big_endian {
            true => message.bytes.extend(bytes.iter().rev()),
            false => message.bytes.extend(bytes),
        };
        point.iter().for_each(|value| put(&value.to_le_bytes()));
        put(&((number % 16) as u16).to_le_bytes());
        put(&(1.7e9 + (number / 16) as f64 * 55.296e-6).to_le_bytes());
    }
    message.bytes.push(1);
    message.bytes
}
