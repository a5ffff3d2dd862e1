//! Headerless float32 records: KITTI's `.bin`, nuScenes' `.pcd.bin`, and what else a user says a
//! record is.
//!
//! Sources: A. Geiger et al., "Vision meets Robotics: The KITTI Dataset" (raw data development
//! kit); nuScenes devkit, `LidarPointCloud.from_file`.

use std::fmt;
use std::str::FromStr;

use super::records::plain_file;
use crate::ground::error::{Error, Result};
use crate::scan::{Layout, ScanFile, Wrapping};

/// Most values of a record; scanners' have 3 to some 20.
const MOST_VALUES: usize = 64;
/// Bytes of a value.
const VALUE: u32 = 4;

/// What a record of a file without a header holds: little-endian float32 values, one a letter.
///
/// `x`, `y`, `z` (metres), `i` intensity, `r` ring, `t` time, `_` a value of no known meaning. x, y and
/// z are needed; only `_` may stand there more than once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeaderlessLayout(String);

impl HeaderlessLayout {
    /// KITTI: x, y, z, intensity.
    pub fn kitti() -> Self {
        HeaderlessLayout("xyzi".to_owned())
    }

    /// nuScenes: x, y, z, intensity, ring.
    pub fn nuscenes() -> Self {
        HeaderlessLayout("xyzir".to_owned())
    }

    /// Takes a file apart; what is left over after the last whole record is `suffix`.
    pub(super) fn parse(&self, bytes: &[u8]) -> Option<ScanFile> {
        plain_file(self.layout()?, bytes, 0, u64::MAX)
    }

    /// The layout of the records; `None` is not possible for what was read from text.
    pub(super) fn layout(&self) -> Option<Layout> {
        let position = [self.offset('x')?, self.offset('y')?, self.offset('z')?];
        let stride = u32::try_from(self.0.len()).ok()? * VALUE;
        let intensity = self.offset('i');
        Some(Layout { wrapping: Wrapping::Plain, stride, position: Some(position), intensity })
    }

    /// Bytes before the value of this letter.
    pub(super) fn offset(&self, letter: char) -> Option<u32> {
        Some(u32::try_from(self.0.find(letter)?).ok()? * VALUE)
    }
}

impl FromStr for HeaderlessLayout {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |what: &str| Err(Error::InvalidConfig(format!("'{text}' {what}")));
        if let Some(letter) = text.chars().find(|letter| !"xyzirt_".contains(*letter)) {
            return wrong(&format!("has the letter '{letter}'; known are x, y, z, i, r, t and _"));
        }
        if let Some(letter) = "xyzirt".chars().find(|letter| text.matches(*letter).count() > 1) {
            return wrong(&format!("has the letter {letter} twice"));
        }
        if !"xyz".chars().all(|letter| text.contains(letter)) {
            return wrong("needs the letters x, y and z");
        }
        if text.len() > MOST_VALUES {
            return wrong(&format!("has more than {MOST_VALUES} letters"));
        }
        Ok(HeaderlessLayout(text.to_owned()))
    }
}

impl fmt::Display for HeaderlessLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::{comes_back, floats};

    #[test]
    fn kitti_records_are_four_values() {
        let scan =
            comes_back("0.bin", [floats(&[1.0, 2.0, 3.0, 0.5, -0.0, 5.0, 6.0, 0.25]), vec![9; 15]].concat());
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0], [-0.0, 5.0, 6.0]]);
        assert!(scan.cloud.positions[1][0].is_sign_negative());
        assert_eq!(scan.cloud.intensity, [0.5, 0.25]);
        assert_eq!(scan.suffix, [9; 15]);
    }

    #[test]
    fn nuscenes_records_have_a_ring_too() {
        let scan = comes_back("0.pcd.bin", [floats(&[1.0, 2.0, 3.0, 40.0, 31.0]), vec![9]].concat());
        assert_eq!((scan.records, scan.cloud.intensity[0]), (1, 40.0));
        assert_eq!(scan.cloud.extra, floats(&[31.0]));
        assert_eq!(scan.suffix, [9]);
    }

    #[test]
    fn every_bit_of_nan_is_kept() {
        let payloads = [0x7f80_0001u32, 0xffc1_2345, 0x7fc0_0000, 0x8000_0000];
        let scan = comes_back("0.bin", payloads.iter().flat_map(|p| p.to_le_bytes()).collect());
        assert_eq!(scan.records, 1);
    }

    #[test]
    fn an_empty_file_has_no_records() {
        let scan = comes_back("0.bin", vec![]);
        assert_eq!((scan.records, scan.is_opaque()), (0, false));
    }

    #[test]
    fn letters_say_where_the_values_are() {
        let layout: HeaderlessLayout = "_tzyxir".parse().unwrap();
        let bytes = [floats(&[9.0, 8.0, 3.0, 2.0, 1.0, 0.5, 7.0]), vec![1; 5]].concat();
        let scan = layout.parse(&bytes).unwrap();
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(scan.cloud.intensity, [0.5]);
        assert_eq!(scan.cloud.extra, floats(&[9.0, 8.0, 7.0]));
        assert_eq!(scan.to_bytes().unwrap(), bytes);
        assert_eq!(layout.to_string(), "_tzyxir");
        let without = "xyz".parse::<HeaderlessLayout>().unwrap().parse(&floats(&[1.0; 6])).unwrap();
        assert_eq!((without.records, without.layout.intensity), (2, None));
    }

    #[test]
    fn layouts_of_no_sense_are_refused() {
        let long = format!("xyz{}", "_".repeat(62));
        for wrong in ["", "xy", "xyi", "xyzz", "xyzii", "xyzI", "x y z", "xyz\u{e9}", &long] {
            assert!(wrong.parse::<HeaderlessLayout>().is_err(), "{wrong:?}");
        }
        assert!(long[1..].parse::<HeaderlessLayout>().is_err());
        assert!(long[..64].parse::<HeaderlessLayout>().is_ok());
    }
}
