//! What can go wrong, and the limits that a decoder keeps. FORMAT.md 10.

use std::path::{Path, PathBuf};
use std::{fmt, io};

use super::section_kind::SectionKind;

/// The result of the library's fallible functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong. Messages are one line; the command line adds the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Reading or writing failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The first bytes are not those of a lidarpc stream.
    #[error("not a lidarpc stream (it starts with {0:02x?})")]
    BadMagic([u8; 4]),
    /// The stream has another version of the format.
    #[error("format version {found} is not one that this program reads ({known})")]
    UnsupportedVersion {
        /// The version that the stream names.
        found: u16,
        /// The version that this program reads.
        known: u16,
    },
    /// The stream is damaged, cut short, or was never valid.
    #[error("damaged stream: {location}{what}")]
    Corrupt {
        /// What is wrong.
        what: String,
        /// Where.
        location: Location,
    },
    /// The stream exceeds a limit of the reader.
    #[error("{location}{what}: {got} is over the limit of {max}")]
    LimitExceeded {
        /// What was requested.
        what: String,
        /// The amount.
        got: u64,
        /// The amount that is allowed.
        max: u64,
        /// Where.
        location: Location,
    },
    /// The stream holds something that this program does not know.
    #[error("written by a newer lidarpc: {location}{what}")]
    Unsupported {
        /// What is unknown.
        what: String,
        /// Where.
        location: Location,
    },
    /// The stream holds something that this program knows, but was built without support for.
    #[error("{location}{what}: this program was built without the feature `{feature}`")]
    NotBuilt {
        /// What it holds.
        what: String,
        /// The cargo feature.
        feature: &'static str,
        /// Where.
        location: Location,
    },
    /// The settings contradict each other or are out of range.
    #[error("{0}")]
    InvalidSettings(String),
    /// An input other than a stream, such as a recording, is damaged or not of its kind; or nothing is left of
    /// a damaged stream.
    #[error("{0}")]
    DamagedInput(String),
    /// What was requested does not exist or cannot be done.
    #[error("{0}")]
    Usage(String),
    /// A fault of this library, or a request that the system refused, such as for threads.
    #[error("{0}")]
    Internal(String),
    /// A file or folder of the input cannot be used.
    #[error("{} {what}", one_line(path.display()))]
    Input {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it and what to do about it, as a sentence that continues after the path.
        what: String,
    },
    /// An operation on this file or folder failed.
    #[error("{}: {source}", one_line(path.display()))]
    At {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong with it.
        source: Box<Error>,
    },
}

impl Error {
    /// An error about a damaged stream; `what` says what is wrong.
    pub(crate) fn corrupt(what: impl Into<String>) -> Self {
        Error::Corrupt { what: what.into(), location: Location::default() }
    }

    /// An error about something that only a newer program knows.
    pub(crate) fn unsupported(what: impl Into<String>) -> Self {
        Error::Unsupported { what: what.into(), location: Location::default() }
    }

    /// An error about something that needs a program built with this feature.
    #[cfg(not(feature = "article"))]
    pub(crate) fn not_built(what: impl Into<String>, feature: &'static str) -> Self {
        Error::NotBuilt { what: what.into(), feature, location: Location::default() }
    }

    /// An error about `what`, whose amount exceeds the limit.
    pub(crate) fn over_limit(what: impl Into<String>, got: u64, max: u64) -> Self {
        Error::LimitExceeded { what: what.into(), got, max, location: Location::default() }
    }

    /// `got`, unless it exceeds the limit.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] about `what`, if it does.
    pub(crate) fn check_limit(what: impl Into<String>, got: u64, max: u64) -> Result<u64> {
        if got > max { Err(Error::over_limit(what, got, max)) } else { Ok(got) }
    }

    /// An error about `what` to be encoded, if its amount exceeds what a stream can hold.
    ///
    /// # Errors
    /// [`Error::Usage`], if it does.
    pub(crate) fn check_fits(what: &str, got: u64, max: u64) -> Result<()> {
        let too_much = || format!("{got} {what}, more than the {max} that a stream can hold; leave it out");
        if got > max { Err(Error::Usage(too_much())) } else { Ok(()) }
    }

    /// This error, naming the file that it is about.
    pub(crate) fn at(self, path: impl AsRef<Path>) -> Self {
        Error::At { path: path.as_ref().to_path_buf(), source: Box::new(self) }
    }

    /// This error, naming the part of the stream that it is about.
    pub(crate) fn within(mut self, part: impl Into<String>) -> Self {
        if let Some(location) = self.location_mut() {
            location.parts.push(part.into());
        }
        self
    }

    /// This error, naming the frame that it is about.
    pub(crate) fn within_frame(mut self, number: u64, name: &str) -> Self {
        if let Some(location) = self.location_mut() {
            location.frame = Some(number);
            location.names_frame = true;
        }
        self.within(format!("frame {number} ({name:?})"))
    }

    /// This error, naming the frame of a group that it is about; the first is 0.
    pub(crate) fn within_frame_of_group(mut self, number: u64) -> Self {
        if let Some(location) = self.location_mut() {
            location.frame = Some(number);
        }
        self.within(format!("frame {number} of the group"))
    }

    /// This error, about a frame of the group whose first frame has this number.
    pub(crate) fn counted_from(mut self, first_frame: u64) -> Self {
        if let Some(frame) = self.location_mut().and_then(|location| location.frame.as_mut()) {
            *frame = frame.saturating_add(first_frame);
        }
        self
    }

    /// This error, which is about a section of this kind.
    pub(crate) fn within_section(mut self, kind: SectionKind) -> Self {
        if let Some(location) = self.location_mut() {
            location.section = Some(kind);
        }
        self
    }

    /// The location in the stream, if known.
    pub fn location(&self) -> Option<&Location> {
        match self {
            Error::Corrupt { location, .. }
            | Error::Unsupported { location, .. }
            | Error::NotBuilt { location, .. }
            | Error::LimitExceeded { location, .. } => Some(location),
            Error::At { source, .. } => source.location(),
            _ => None,
        }
    }

    /// Whether a stream is damaged.
    pub(crate) fn is_damage(&self) -> bool {
        match self {
            Error::Corrupt { .. } => true,
            Error::At { source, .. } => source.is_damage(),
            _ => false,
        }
    }

    /// The number of the frame that the error is about, and a message that names it. `frame` is that number,
    /// if the caller knows it and the error does not.
    #[cfg(any(feature = "python", feature = "wasm"))]
    pub(crate) fn about_frame(&self, frame: Option<u64>) -> (Option<u64>, String) {
        let frame = self.location().and_then(|location| location.frame).or(frame);
        let what = self.to_string();
        // Messages about a group number the frames within it.
        let unnamed = frame.filter(|_| !self.location().is_some_and(|location| location.names_frame));
        let message = unnamed.map(|number| format!("frame {number}: {what}"));
        (frame, message.unwrap_or(what))
    }

    fn location_mut(&mut self) -> Option<&mut Location> {
        match self {
            Error::Corrupt { location, .. }
            | Error::Unsupported { location, .. }
            | Error::NotBuilt { location, .. }
            | Error::LimitExceeded { location, .. } => Some(location),
            _ => None,
        }
    }
}

/// The location of an error in a stream, as far as known. Its text names the parts from the outermost
/// inwards, each followed by a colon.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Location {
    /// Number of the frame, the first being 0.
    pub frame: Option<u64>,
    /// The section of the frame.
    pub section: Option<SectionKind>,
    /// Whether the parts name the frame by this number.
    names_frame: bool,
    /// The parts in words, the innermost first.
    parts: Vec<String>,
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.parts.iter().rev().try_for_each(|part| write!(f, "{part}: "))
    }
}

/// Text for a message of one line: names of files may contain line breaks and terminal control sequences.
pub(crate) fn one_line(text: impl fmt::Display) -> String {
    text.to_string().replace(char::is_control, "?")
}

/// The largest sizes that a decoder accepts; checked before any memory is allocated.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Points (records) in one frame, and cells of its range image.
    pub points: u64,
    /// Bytes of one decoded file, and of all files of a group together.
    pub file_bytes: u64,
    /// Bytes of one coded record (a group of frames) of the stream.
    pub record_bytes: u64,
}

impl Limits {
    /// These limits, with no more than `most` points and `most` bytes in a frame.
    pub(crate) fn at_most(&self, most: u64) -> Self {
        Limits { points: self.points.min(most), file_bytes: self.file_bytes.min(most), ..*self }
    }
}

impl Default for Limits {
    /// 16 million points, 1 GiB a file, 2 GiB a group: ten times the largest frame of any scanner.
    fn default() -> Self {
        Limits { points: 1 << 24, file_bytes: 1 << 30, record_bytes: 1 << 31 }
    }
}
