//! What the encoder is given.

use std::fs;
use std::path::PathBuf;

use crate::files::sequence::is_safe_name;
use crate::ground::error::{Error, Limits, Result};

/// One frame to encode.
#[derive(Clone, Debug)]
pub enum FrameInput {
    /// A file, read when its turn comes. The frame gets the file's name, without the folder.
    File(PathBuf),
    /// A file's bytes.
    Memory {
        /// The name to give back on decoding.
        name: String,
        /// The file's bytes.
        bytes: Vec<u8>,
    },
}

impl FrameInput {
    /// The name that the decoded file gets.
    ///
    /// # Errors
    /// If no decoder would write a file of that name.
    pub fn name(&self) -> Result<&str> {
        let name = match self {
            FrameInput::File(path) => path.file_name().and_then(|name| name.to_str()),
            FrameInput::Memory { name, .. } => Some(name.as_str()),
        };
        name.filter(|name| is_safe_name(name)).ok_or_else(|| {
            let what = "has a name that not every system can restore; rename the file".to_owned();
            Error::Input { path: self.path(), what }
        })
    }

    /// Where it comes from, for errors.
    pub(crate) fn path(&self) -> PathBuf {
        match self {
            FrameInput::File(path) => path.clone(),
            FrameInput::Memory { name, .. } => PathBuf::from(name),
        }
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// If the file's size cannot be read.
    pub fn size(&self) -> Result<u64> {
        match self {
            FrameInput::File(path) => Ok(fs::metadata(path).map_err(|e| Error::from(e).at(path))?.len()),
            FrameInput::Memory { bytes, .. } => Ok(bytes.len() as u64),
        }
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// If it cannot be read, or is larger than any decoder takes.
    pub fn read(&self) -> Result<Vec<u8>> {
        check_limit("bytes of a file", self.size()?, Limits::default().file_bytes)
            .map_err(|e| e.at(self.path()))?;
        match self {
            FrameInput::File(path) => fs::read(path).map_err(|e| Error::from(e).at(path)),
            FrameInput::Memory { bytes, .. } => Ok(bytes.clone()),
        }
    }
}

/// An error if decoders would refuse what is encoded.
fn check_limit(what: &'static str, got: u64, max: u64) -> Result<()> {
    if got > max { Err(Error::LimitExceeded { what: what.to_owned(), got, max }) } else { Ok(()) }
}
