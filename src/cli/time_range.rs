//! Selection of frames by their times.

use std::str::FromStr;

use crate::container::{FrameEntry, Index};
use crate::ground::error::{Error, Result};
use crate::stream::FrameRange;

/// A half-open range of times since the first frame that has a time, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeRange {
    start: i64,
    /// None: no end.
    end: Option<i64>,
}

/// Frames in a range of times.
#[derive(Debug)]
pub struct TimedFrames {
    /// From the first to the last of them.
    pub frames: FrameRange,
    /// Number of frames before and after these that have no time.
    pub untimed: u64,
    /// Number of frames among these whose times are not in the range.
    pub of_other_times: u64,
    pub times: Times,
}

/// A range of times, and the time of the first frame, from which it counts.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    range: TimeRange,
    first: i64,
}

impl Times {
    /// Whether a time, in nanoseconds, is in the range.
    pub fn contains(&self, time: i64) -> bool {
        let after = time.saturating_sub(self.first);
        after >= self.range.start && self.range.end.is_none_or(|end| after < end)
    }
}

impl TimeRange {
    /// The frames in this range of times.
    ///
    /// # Errors
    /// If no frame has a time, or none is in the range.
    pub fn frames(&self, index: &Index) -> Result<TimedFrames> {
        let frames =
            || index.groups.iter().flat_map(|group| &group.frames).filter(|frame| !frame.is_beside());
        let time = |frame: &FrameEntry| frame.stamp.time.map(|time| time.nanoseconds);
        let Some(first) = frames().find_map(time) else {
            return Err(Error::Usage("its frames have no times; choose by --frames".to_owned()));
        };
        let times = Times { range: *self, first };
        let is_wanted = |time: i64| times.contains(time);
        let numbered = (0u64..).zip(frames());
        let wanted =
            numbered.filter(|(_, frame)| time(frame).is_some_and(is_wanted)).map(|(number, _)| number);
        let ends = wanted.fold(None, |ends, number| Some((ends.map_or(number, |(start, _)| start), number)));
        let Some((start, last)) = ends else {
            let longest = frames().filter_map(time).map(|time| time.saturating_sub(first)).max().unwrap_or(0);
            let seconds = longest as f64 * 1e-9;
            return Err(Error::Usage(format!(
                "holds no frame of that time; its times go from 0 to {seconds:.3} s"
            )));
        };
        let is_within = |number: u64| (start..=last).contains(&number);
        let numbered = || (0u64..).zip(frames());
        let untimed = numbered().filter(|(number, frame)| !is_within(*number) && time(frame).is_none());
        let of_other_times =
            numbered().filter(|(number, frame)| is_within(*number) && !time(frame).is_none_or(is_wanted));
        Ok(TimedFrames {
            frames: FrameRange { start, end: Some(last + 1) },
            untimed: untimed.count() as u64,
            of_other_times: of_other_times.count() as u64,
            times,
        })
    }
}

impl FromStr for TimeRange {
    type Err = String;

    /// Reads `12s..15s`, `1m30s..`, `..0.5`; numbers without a unit are seconds.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || format!("'{text}' is no range of times like 12s..15s, 1m30s.. or ..0.5");
        let (start, end) = text.split_once("..").ok_or_else(wrong)?;
        let time = |text: &str| nanoseconds(text).ok_or_else(wrong);
        let range = TimeRange {
            start: if start.is_empty() { 0 } else { time(start)? },
            end: if end.is_empty() { None } else { Some(time(end)?) },
        };
        match range.end {
            Some(end) if end <= range.start => Err(format!("'{text}' holds no time")),
            _ => Ok(range),
        }
    }
}

/// A duration in nanoseconds.
fn nanoseconds(text: &str) -> Option<i64> {
    let seconds = text.strip_suffix('s').unwrap_or(text).parse::<f64>();
    match seconds {
        Ok(seconds) => (0.0..9e9).contains(&seconds).then_some((seconds * 1e9).round() as i64),
        Err(_) => humantime::parse_duration(text).ok()?.as_nanos().try_into().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::{GroupEntry, Stamp, Time, TimeSource};

    #[test]
    fn ranges_are_read() {
        let range = |text: &str| text.parse::<TimeRange>().ok().map(|range| (range.start, range.end));
        assert_eq!(range("12s..15s"), Some((12_000_000_000, Some(15_000_000_000))));
        assert_eq!(range("1m30s.."), Some((90_000_000_000, None)));
        assert_eq!(range("..0.5"), Some((0, Some(500_000_000))));
        assert_eq!(range("250ms..1.5s"), Some((250_000_000, Some(1_500_000_000))));
        for wrong in ["", "5", "5..5", "2s..1s", "x..", "-1..", "..nan"] {
            assert_eq!(range(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn frames_are_found_by_their_times() {
        let frame = |time: Option<i64>| FrameEntry {
            size: 1,
            stamp: Stamp {
                time: time
                    .map(|tenths| Time { source: TimeSource::List, nanoseconds: 5 + tenths * 100_000_000 }),
                ..Stamp::default()
            },
        };
        let entry = |first_frame, times: &[Option<i64>]| GroupEntry {
            offset: 0,
            length: 0,
            crc: 0,
            first_frame,
            frames: times.iter().copied().map(frame).collect(),
        };
        let mut index = Index::default();
        index.groups = vec![entry(0, &[None, Some(0), Some(1)]), entry(3, &[Some(2), None, Some(4)])];
        let frames = |text: &str| {
            let found = text.parse::<TimeRange>().unwrap().frames(&index);
            found.map(|found| (found.frames.start, found.frames.end, found.untimed))
        };
        assert_eq!(frames("0.1..0.3").unwrap(), (2, Some(4), 2));
        assert_eq!(frames("0.2..").unwrap(), (3, Some(6), 1));
        assert_eq!(frames("..1").unwrap(), (1, Some(6), 1));
        assert!(frames("7s..8s").unwrap_err().to_string().contains("from 0 to 0.400 s"));
        let none = "..1".parse::<TimeRange>().unwrap().frames(&Index::default());
        assert!(none.unwrap_err().to_string().contains("no times"));
    }
}
