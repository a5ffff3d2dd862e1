//! The user's settings for decoding.

use std::fmt;
use std::str::FromStr;

use crate::container::Index;
use crate::ground::error::{Error, Limits, Result};

/// Settings of the decoder.
#[derive(Clone, Debug, Default)]
pub struct DecodeOptions {
    /// Groups decoded at the same time; 0, the default, means one for each processor.
    pub threads: usize,
    /// The largest sizes that the decoder allocates.
    pub limits: Limits,
    /// Which frames to decode. Default: all.
    pub frames: FrameRange,
    /// Whether to return range images too, as for pictures. Default: no.
    pub images: bool,
}

/// A range of frame numbers, the sequence's first frame being 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRange {
    /// The first frame.
    pub start: u64,
    /// The frame after the last; `None`: up to the end of the sequence.
    pub end: Option<u64>,
}

impl FrameRange {
    /// Whether the range includes all frames of any sequence.
    pub fn is_all(&self) -> bool {
        *self == FrameRange::default()
    }

    /// Whether the range contains the frame with this number.
    pub fn contains(&self, number: u64) -> bool {
        number >= self.start && !self.is_past(number)
    }

    /// Whether the frame with this number comes after the range.
    pub fn is_past(&self, number: u64) -> bool {
        self.end.is_some_and(|end| number >= end)
    }

    /// Whether the range contains any of the `count` frames from `first` on.
    pub fn overlaps(&self, first: u64, count: u64) -> bool {
        count > 0 && !self.is_past(first) && first.saturating_add(count) > self.start
    }

    /// Whether a group of `count` frames from `first` on is to be read. Files beside the scans are read only
    /// if all frames are, as they have no numbers of their own.
    pub fn wants(&self, first: u64, count: u64, is_beside: bool) -> bool {
        self.overlaps(first, count) && (!is_beside || self.is_all())
    }

    /// The number of files beside the scans that are not read.
    pub fn left_out(&self, index: &Index) -> u64 {
        if self.is_all() { 0 } else { index.frame_count() - index.scan_count() }
    }

    /// The number of frames in the range, out of a sequence of `count` frames.
    pub fn count_of(&self, count: u64) -> u64 {
        self.end.map_or(count, |end| end.min(count)).saturating_sub(self.start)
    }

    /// Checks that a sequence of `count` frames contains the whole range.
    ///
    /// # Errors
    /// [`Error::Usage`], with the number of frames.
    pub fn check(&self, count: u64) -> Result<()> {
        let missing = self.end.is_some_and(|end| end > count) || self.start >= count;
        if missing && !self.is_all() {
            let range = match count {
                0 => "no frames".to_owned(),
                1 => "only frame 0".to_owned(),
                _ => format!("only frames 0 to {}", count - 1),
            };
            return Err(Error::Usage(format!("holds {range}, not {self}")));
        }
        Ok(())
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.end {
            Some(_) if self.end == self.start.checked_add(1) => write!(f, "{}", self.start),
            Some(end) => write!(f, "{}..{end}", self.start),
            None => write!(f, "{}..", self.start),
        }
    }
}

impl FromStr for FrameRange {
    type Err = Error;

    /// Reads `5`, `10..20` (without 20), `10..=20` (with 20), `10..`, `..20`, `..=20` or `..`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || Error::Usage(format!("'{text}' is no range like 5, 10..20, 10.. or ..=20"));
        let number = |text: &str| text.parse::<u64>().map_err(|_| wrong());
        let after = |text: &str| number(text)?.checked_add(1).ok_or_else(wrong);
        let range = match text.split_once("..") {
            None => FrameRange { start: number(text)?, end: Some(after(text)?) },
            Some((start, end)) => FrameRange {
                start: if start.is_empty() { 0 } else { number(start)? },
                end: match end.strip_prefix('=') {
                    Some(last) => Some(after(last)?),
                    None if end.is_empty() => None,
                    None => Some(number(end)?),
                },
            },
        };
        if range.end.is_some_and(|end| end <= range.start) {
            return Err(Error::Usage(format!("'{text}' holds no frame")));
        }
        Ok(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read() {
        let range = |text: &str| text.parse::<FrameRange>().ok().map(|range| (range.start, range.end));
        assert_eq!(range("5"), Some((5, Some(6))));
        assert_eq!(range("10..20"), Some((10, Some(20))));
        assert_eq!(range("10..=20"), Some((10, Some(21))));
        assert_eq!(range("10.."), Some((10, None)));
        assert_eq!(range("..=20"), Some((0, Some(21))));
        assert_eq!(range(".."), Some((0, None)));
        for wrong in ["", "x", "5..5", "7..3", "..0", "-1", "1..2..3", "18446744073709551615", "=3"] {
            assert_eq!(range(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn ranges_meet_groups() {
        let range = FrameRange { start: 10, end: Some(20) };
        let groups = [(0, 10), (0, 11), (10, 1), (19, 5), (20, 5), (15, 0)];
        let met = groups.map(|(first, count)| range.overlaps(first, count));
        assert_eq!(met, [false, true, true, true, false, false]);
        assert!(!range.contains(9) && range.contains(10) && range.contains(19) && !range.contains(20));
    }

    #[test]
    fn ranges_must_be_in_the_sequence() {
        assert!(FrameRange { start: 3, end: Some(5) }.check(5).is_ok());
        assert!(FrameRange { start: 3, end: Some(6) }.check(5).is_err());
        assert!(FrameRange { start: 5, end: None }.check(5).is_err());
        assert!(FrameRange::default().check(0).is_ok());
    }
}
