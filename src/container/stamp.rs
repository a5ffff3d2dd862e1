//! Origin of a frame: kind, track, time. FORMAT.md 2.5.

use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};

/// What a frame decodes to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum FrameKind {
    /// A file.
    #[default]
    File = 0,
    /// A message of a recording.
    Message = 1,
    /// Points passed in memory.
    Points = 2,
    /// A file beside the scans; or an empty folder, if its name ends in `/`.
    Beside = 3,
}

impl FrameKind {
    const ALL: [FrameKind; 4] = [FrameKind::File, FrameKind::Message, FrameKind::Points, FrameKind::Beside];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            FrameKind::File => "file",
            FrameKind::Message => "message",
            FrameKind::Points => "points",
            FrameKind::Beside => "file beside the scans",
        }
    }
}

/// The source of a frame's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeSource {
    /// The recording that it is from, or the caller.
    Recording = 1,
    /// The file's name.
    FileName = 2,
    /// A list beside the files.
    List = 3,
}

impl TimeSource {
    const ALL: [TimeSource; 3] = [TimeSource::Recording, TimeSource::FileName, TimeSource::List];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            TimeSource::Recording => "recording",
            TimeSource::FileName => "file name",
            TimeSource::List => "list",
        }
    }
}

/// A point in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Time {
    /// The source.
    pub source: TimeSource,
    /// Nanoseconds since the beginning of 1970, UTC.
    pub nanoseconds: i64,
}

/// Origin of a frame: kind, track, time. The same in the frame's header and in the index.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// What it decodes to.
    pub kind: FrameKind,
    /// Index of its track in the group, the first being 0. Each track has a scanner of its own.
    pub track: u8,
    /// The time of the scan, if known.
    pub time: Option<Time>,
}

impl Stamp {
    /// Appends kind, track and time.
    pub(super) fn write_to(&self, out: &mut Vec<u8>) {
        write_unsigned(out, self.kind as u64);
        write_unsigned(out, u64::from(self.track));
        write_unsigned(out, self.time.map_or(0, |time| time.source as u64));
        if let Some(time) = self.time {
            write_signed(out, time.nanoseconds);
        }
    }

    /// Takes a stamp off the front of `input`.
    ///
    /// # Errors
    /// If it is cut short or holds a value that this program does not know.
    pub(super) fn read_from(input: &mut &[u8]) -> Result<Self> {
        let kind = read_unsigned(input, "frame's kind")?;
        let kind = FrameKind::ALL
            .into_iter()
            .find(|known| *known as u64 == kind)
            .ok_or_else(|| Error::unsupported(format!("unknown kind {kind} of a frame")))?;
        let track = read_unsigned(input, "frame's track")?;
        let track = u8::try_from(track)
            .map_err(|_| Error::corrupt(format!("a frame of track {track}, which no group has")))?;
        let time = match read_unsigned(input, "source of a frame's time")? {
            0 => None,
            number => {
                let source =
                    TimeSource::ALL.into_iter().find(|known| *known as u64 == number).ok_or_else(|| {
                        Error::unsupported(format!("unknown source {number} of a frame's time"))
                    })?;
                Some(Time { source, nanoseconds: read_signed(input, "frame's time")? })
            }
        };
        Ok(Stamp { kind, track, time })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comes_back_and_leaves_what_follows() {
        let times = [i64::MIN, -1, 0, 1_316_998_000_123_456_789, i64::MAX]
            .into_iter()
            .flat_map(|nanoseconds| TimeSource::ALL.map(|source| Some(Time { source, nanoseconds })));
        for time in times.chain([None]) {
            for (kind, track) in FrameKind::ALL.into_iter().zip([0, 7, 254, 1]) {
                let stamp = Stamp { kind, track, time };
                let mut bytes = Vec::new();
                stamp.write_to(&mut bytes);
                bytes.push(42);
                let mut input = &bytes[..];
                assert_eq!(Stamp::read_from(&mut input).unwrap(), stamp);
                assert_eq!(input, [42]);
            }
        }
    }

    #[test]
    fn what_is_unknown_is_named() {
        for (bytes, complaint) in [
            (&[4u8, 0, 0][..], "unknown kind 4"),
            (&[0, 0x80, 2, 0], "track 256"),
            (&[0, 0, 4, 0], "unknown source 4"),
            (&[0, 0, 1], "frame's time"),
        ] {
            let error = Stamp::read_from(&mut &bytes[..]).unwrap_err().to_string();
            assert!(error.contains(complaint), "{error}");
        }
    }
}
