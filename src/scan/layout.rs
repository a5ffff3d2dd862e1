//! How a file's records are laid out, and the serialised form of that.

use std::ops::Range;

use super::text_format::TextFormat;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Longest record in bytes. Scanners' records have 12 to some 50; point features a few thousand.
pub const MAX_STRIDE: u32 = 1 << 16;

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

/// How the records stand in the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Wrapping {
    /// One after the other (KITTI `.bin`, binary PCD, binary little-endian PLY).
    #[default]
    Plain,
    /// Field by field (all x, then all y, ...), compressed with LZF, behind two u32 that give
    /// the compressed and the uncompressed size (PCD `binary_compressed`).
    PcdCompressed {
        /// Bytes a record of each field, in the order of the file and of the record.
        fields: Vec<u32>,
        /// Which of the LZF compressors wrote it.
        lzf: LzfDialect,
    },
    /// As text, one record a line (ascii PCD and PLY).
    Text(TextFormat),
    /// One after the other, the bytes of each value from the last to the first (binary big-endian PLY).
    BigEndian {
        /// Bytes of each value of a record.
        values: Vec<u32>,
    },
}

/// The LZF compressors that write PCD files. They write one format, but find different matches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LzfDialect {
    /// 2^13 hash slots, the "ultra fast" hash (today's PCL).
    Ultra13,
    /// 2^16 hash slots, the "ultra fast" hash (older PCL).
    Ultra16,
    /// 2^16 hash slots, the "very fast" hash (liblzf as it comes; Open3D).
    Very16,
}

impl LzfDialect {
    /// Every dialect, at its number in the serialised form; the likeliest first.
    pub const ALL: [LzfDialect; 3] = [LzfDialect::Ultra13, LzfDialect::Ultra16, LzfDialect::Very16];
}

// The first byte of a serialised layout: the wrapping's number and two flags.
const PLAIN: u8 = 0;
const PCD_COMPRESSED: u8 = 1;
const TEXT: u8 = 2;
const BIG_ENDIAN: u8 = 3;
const WRAPPING_MASK: u8 = 0x0f;
const HAS_POSITION: u8 = 0x10;
const HAS_INTENSITY: u8 = 0x20;

impl Layout {
    /// Bytes of a record that are neither position nor intensity.
    pub fn extra_stride(&self) -> usize {
        let known = 12 * u32::from(self.position.is_some()) + 4 * u32::from(self.intensity.is_some());
        self.stride.saturating_sub(known) as usize
    }

    /// Where the bytes counted by [`extra_stride`](Self::extra_stride) are in a record: the gaps
    /// between the known values, in rising order. Meaningful for a layout that is valid.
    pub fn extra_ranges(&self) -> Vec<Range<usize>> {
        let mut gaps = Vec::new();
        let mut from = 0;
        for at in self.known_offsets() {
            if from < at as usize {
                gaps.push(from..at as usize);
            }
            from = at as usize + 4;
        }
        if from < self.stride as usize {
            gaps.push(from..self.stride as usize);
        }
        gaps
    }

    /// The offsets of position and intensity, rising.
    fn known_offsets(&self) -> Vec<u32> {
        let mut offsets: Vec<u32> = self.position.into_iter().flatten().chain(self.intensity).collect();
        offsets.sort_unstable();
        offsets
    }

    /// Checks that all values lie inside the record and apart from each other, and that the
    /// wrapping describes a record of this stride.
    ///
    /// # Errors
    /// [`Error::Corrupt`] if not.
    pub fn validate(&self) -> Result<()> {
        let check = |ok: bool, what: &str| match ok {
            true => Ok(()),
            false => Err(Error::corrupt(format!("record layout: {what}"))),
        };
        check(self.stride <= MAX_STRIDE, "records too long")?;
        let mut free = 0;
        for at in self.known_offsets() {
            check(at >= free, "values overlap")?;
            check(at < self.stride && self.stride - at >= 4, "a value lies outside the record")?;
            free = at + 4;
        }
        match &self.wrapping {
            Wrapping::Plain => Ok(()),
            Wrapping::PcdCompressed { fields, .. } | Wrapping::BigEndian { values: fields } => {
                let sum: u64 = fields.iter().map(|&width| u64::from(width)).sum();
                let fits = sum == u64::from(self.stride) && sum > 0 && !fields.contains(&0);
                check(fits, "fields do not fill the record")
            }
            Wrapping::Text(format) => {
                let fits = format.stride() == u64::from(self.stride) && self.stride > 0;
                check(fits, "columns do not fill the record")?;
                format.validate()
            }
        }
    }

    /// Appends the serialised layout: flags, stride, x, y, z, intensity, wrapping's parameters.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        let wrapping = match self.wrapping {
            Wrapping::Plain => PLAIN,
            Wrapping::PcdCompressed { .. } => PCD_COMPRESSED,
            Wrapping::Text(_) => TEXT,
            Wrapping::BigEndian { .. } => BIG_ENDIAN,
        };
        let position = if self.position.is_some() { HAS_POSITION } else { 0 };
        let intensity = if self.intensity.is_some() { HAS_INTENSITY } else { 0 };
        out.push(wrapping | position | intensity);
        write_unsigned(out, u64::from(self.stride));
        for offset in self.position.into_iter().flatten().chain(self.intensity) {
            write_unsigned(out, u64::from(offset));
        }
        match &self.wrapping {
            Wrapping::Plain => {}
            Wrapping::PcdCompressed { fields, lzf } => {
                out.push(*lzf as u8);
                write_widths(out, fields);
            }
            Wrapping::BigEndian { values } => write_widths(out, values),
            Wrapping::Text(format) => format.write_to(out),
        }
    }

    /// Takes a serialised layout off the front of `input`.
    ///
    /// # Errors
    /// [`Error::Corrupt`] if it is cut short or is not [valid](Self::validate).
    pub fn read_from(input: &mut &[u8]) -> Result<Layout> {
        let flags = read_byte(input)?;
        if flags & !(WRAPPING_MASK | HAS_POSITION | HAS_INTENSITY) != 0 {
            return Err(Error::corrupt("record layout: unknown flags"));
        }
        let stride = read_number(input)?;
        if stride > MAX_STRIDE {
            return Err(Error::corrupt("record layout: records too long"));
        }
        let position = match flags & HAS_POSITION {
            0 => None,
            _ => Some([read_number(input)?, read_number(input)?, read_number(input)?]),
        };
        let intensity = match flags & HAS_INTENSITY {
            0 => None,
            _ => Some(read_number(input)?),
        };
        let wrapping = match flags & WRAPPING_MASK {
            PLAIN => Wrapping::Plain,
            PCD_COMPRESSED => read_compressed(input, stride)?,
            BIG_ENDIAN => Wrapping::BigEndian { values: read_widths(input, stride)? },
            TEXT => Wrapping::Text(TextFormat::read_from(input, stride)?),
            _ => return Err(Error::corrupt("record layout: unknown wrapping")),
        };
        let layout = Layout { wrapping, stride, position, intensity };
        layout.validate()?;
        Ok(layout)
    }
}

fn read_compressed(input: &mut &[u8], stride: u32) -> Result<Wrapping> {
    let lzf = *LzfDialect::ALL
        .get(usize::from(read_byte(input)?))
        .ok_or_else(|| Error::corrupt("record layout: unknown LZF dialect"))?;
    Ok(Wrapping::PcdCompressed { fields: read_widths(input, stride)?, lzf })
}

/// Their number is not written: they end where the record is full.
fn write_widths(out: &mut Vec<u8>, widths: &[u32]) {
    widths.iter().for_each(|&width| write_unsigned(out, u64::from(width)));
}

fn read_widths(input: &mut &[u8], stride: u32) -> Result<Vec<u32>> {
    let mut widths = Vec::new();
    let mut filled = 0u32;
    while filled < stride {
        let width = read_number(input)?;
        filled = filled.saturating_add(width);
        widths.push(width);
    }
    Ok(widths)
}

fn read_byte(input: &mut &[u8]) -> Result<u8> {
    let (&byte, rest) = input.split_first().ok_or_else(|| Error::corrupt("record layout: cut short"))?;
    *input = rest;
    Ok(byte)
}

fn read_number(input: &mut &[u8]) -> Result<u32> {
    let number = read_unsigned(input, "record layout")?;
    u32::try_from(number).map_err(|_| Error::corrupt("record layout: number too large"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{Column, NumberRule, Scalar};
    use super::*;

    fn kitti() -> Layout {
        Layout { wrapping: Wrapping::Plain, stride: 16, position: Some([0, 4, 8]), intensity: Some(12) }
    }

    fn text(columns: Vec<Column>) -> Wrapping {
        Wrapping::Text(TextFormat { crlf: true, tab: false, trailing_separator: true, columns })
    }

    fn round_trip(layout: &Layout) -> usize {
        let mut bytes = Vec::new();
        layout.write_to(&mut bytes);
        let mut input = &bytes[..];
        assert_eq!(&Layout::read_from(&mut input).unwrap(), layout);
        assert!(input.is_empty());
        for cut in 0..bytes.len() {
            assert!(Layout::read_from(&mut &bytes[..cut]).is_err(), "cut at {cut}");
        }
        bytes.len()
    }

    #[test]
    fn layouts_come_back() {
        assert_eq!(round_trip(&Layout::default()), 2);
        assert_eq!(round_trip(&kitti()), 6);
        let fields = Wrapping::PcdCompressed { fields: vec![4, 4, 4, 300], lzf: LzfDialect::Very16 };
        round_trip(&Layout { wrapping: fields, stride: 312, ..kitti() });
        let values = Wrapping::BigEndian { values: vec![4, 4, 4, 4, 8, 1] };
        round_trip(&Layout { wrapping: values, stride: 25, ..kitti() });
        let shortest = NumberRule::Shortest { double: true, point_zero: false };
        let columns = vec![
            Column { scalar: Scalar::F32, rule: NumberRule::Significant(8) },
            Column { scalar: Scalar::F64, rule: shortest },
            Column { scalar: Scalar::I16, rule: NumberRule::Integer },
        ];
        round_trip(&Layout { wrapping: text(columns), stride: 14, position: None, intensity: Some(0) });
    }

    #[test]
    fn gaps_are_what_is_not_known() {
        assert!(kitti().extra_ranges().is_empty());
        let padded = Layout { stride: 32, position: Some([4, 8, 12]), intensity: Some(20), ..kitti() };
        assert_eq!(padded.extra_ranges(), [0..4, 16..20, 24..32]);
        assert_eq!(padded.extra_stride(), 16);
    }

    #[test]
    fn impossible_layouts_are_refused() {
        let bad = [
            Layout { stride: MAX_STRIDE + 1, ..kitti() },
            Layout { position: Some([0, 4, 7]), ..kitti() },
            Layout { position: Some([8, 4, 8]), ..kitti() },
            Layout { intensity: Some(13), ..kitti() },
            Layout { intensity: Some(u32::MAX), ..kitti() },
            Layout { stride: 0, ..kitti() },
            Layout { wrapping: text(vec![]), ..Layout::default() },
            Layout {
                wrapping: Wrapping::PcdCompressed { fields: vec![12], lzf: LzfDialect::Ultra13 },
                ..kitti()
            },
            Layout { wrapping: Wrapping::BigEndian { values: vec![4, 4, 4, 8] }, ..kitti() },
            Layout {
                wrapping: text(vec![Column { scalar: Scalar::F32, rule: NumberRule::Integer }; 4]),
                ..kitti()
            },
            Layout {
                wrapping: text(vec![Column { scalar: Scalar::F32, rule: NumberRule::Fixed(41) }; 4]),
                ..kitti()
            },
        ];
        for layout in bad {
            let mut bytes = Vec::new();
            layout.write_to(&mut bytes);
            assert!(layout.validate().is_err(), "{layout:?}");
            assert!(Layout::read_from(&mut &bytes[..]).is_err(), "{layout:?}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_give_a_valid_layout_or_an_error(bytes in prop::collection::vec(0u8..64, 0..40)) {
            let mut input = &bytes[..];
            if let Ok(layout) = Layout::read_from(&mut input) {
                prop_assert!(layout.validate().is_ok());
                let mut again = Vec::new();
                layout.write_to(&mut again);
                prop_assert_eq!(&Layout::read_from(&mut &again[..]).unwrap(), &layout);
                let gaps: usize = layout.extra_ranges().iter().map(|r| r.len()).sum();
                prop_assert_eq!(gaps, layout.extra_stride());
            }
        }
    }
}
