//! What can go wrong, and the limits that a decoder keeps.

use std::io;
use std::path::{Path, PathBuf};

/// The result of every fallible function of the library.
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
    /// The stream is of another version of the format.
    #[error("format version {found} is not one that this program reads ({known})")]
    UnsupportedVersion {
        /// The version that the stream names.
        found: u16,
        /// The version that this program reads.
        known: u16,
    },
    /// The stream is damaged, cut short, or was never valid.
    #[error("damaged stream: {what}")]
    Corrupt {
        /// What is wrong, and in which part.
        what: String,
    },
    /// The stream asks for more than the reader allows.
    #[error("{what}: {got} is over the limit of {max}")]
    LimitExceeded {
        /// What was asked for.
        what: String,
        /// The amount.
        got: u64,
        /// The amount that is allowed.
        max: u64,
    },
    /// The settings contradict each other or are out of range.
    #[error("{0}")]
    InvalidConfig(String),
    /// What was asked for is not there, or cannot be done.
    #[error("{0}")]
    Usage(String),
    /// Something that should never happen, or that the system refuses, such as threads.
    #[error("{0}")]
    Internal(String),
    /// A file or folder that was given cannot be used.
    #[error("{} {what}", one_line(path))]
    Input {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong with it and what to do about it, as a sentence that continues after the path.
        what: String,
    },
    /// The stream holds something that this program does not know.
    #[error("written by a newer lidarpc: {what}")]
    Unsupported {
        /// What is unknown, and in which part.
        what: String,
    },
    /// Something went wrong with this file or folder.
    #[error("{}: {source}", one_line(path))]
    At {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong with it.
        source: Box<Error>,
    },
}

impl Error {
    /// An error about a damaged stream; `what` says what is wrong.
    pub fn corrupt(what: impl Into<String>) -> Self {
        Error::Corrupt { what: what.into() }
    }

    /// An error about something that only a newer program knows.
    pub fn unsupported(what: impl Into<String>) -> Self {
        Error::Unsupported { what: what.into() }
    }

    /// The same error, naming the file that it is about.
    pub fn at(self, path: impl AsRef<Path>) -> Self {
        Error::At { path: path.as_ref().to_path_buf(), source: Box::new(self) }
    }

    /// The same error, naming the part of the stream that it is about.
    pub(crate) fn within(self, part: &str) -> Self {
        match self {
            Error::Corrupt { what } => Error::Corrupt { what: format!("{part}: {what}") },
            Error::Unsupported { what } => Error::Unsupported { what: format!("{part}: {what}") },
            Error::LimitExceeded { what, got, max } => {
                Error::LimitExceeded { what: format!("{part}: {what}"), got, max }
            }
            other => other,
        }
    }
}

/// A path for a message: file names may contain line breaks and terminal control sequences.
fn one_line(path: &Path) -> String {
    path.display().to_string().replace(char::is_control, "?")
}

/// What a decoder is willing to allocate; checked before any memory is allocated.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Points (records) in one frame, and cells of its range image.
    pub points: u64,
    /// Bytes of one decoded file.
    pub file_bytes: u64,
    /// Bytes of one coded record (a group of frames) of the stream.
    pub record_bytes: u64,
}

impl Default for Limits {
    /// 16 million points, 1 GiB a file, 2 GiB a group: ten times the frame of any scanner.
    fn default() -> Self {
        Limits { points: 1 << 24, file_bytes: 1 << 30, record_bytes: 1 << 31 }
    }
}
