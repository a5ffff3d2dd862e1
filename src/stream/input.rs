//! What the encoder is given.

use std::fs;
use std::path::PathBuf;

use crate::files::sequence::is_safe_name;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::container::{FrameHeader, STREAMS_MAX, Stamp};

/// One frame to encode.
#[derive(Clone, Debug)]
pub struct FrameInput {
    data: Data,
    stamp: Stamp,
}

/// Where its bytes are.
#[derive(Clone, Debug)]
enum Data {
    File(PathBuf),
    Memory { name: String, bytes: Vec<u8> },
}

impl FrameInput {
    /// A file, read when its turn comes. The frame gets the file's name, without the folder.
    pub fn file(path: PathBuf) -> Self {
        FrameInput { data: Data::File(path), stamp: Stamp::default() }
    }

    /// A file's bytes, and the name to give back on decoding.
    pub fn memory(name: String, bytes: Vec<u8>) -> Self {
        FrameInput { data: Data::Memory { name, bytes }, stamp: Stamp::default() }
    }

    /// The same, saying what it is, of which stream, and of when; if this is not said, it is a file of the
    /// first stream, of which no time is known.
    pub fn stamped(self, stamp: Stamp) -> Self {
        FrameInput { stamp, ..self }
    }

    /// What it is, of which stream, and of when.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The name that the decoded file gets.
    ///
    /// # Errors
    /// If no decoder would write a file of that name.
    pub fn name(&self) -> Result<&str> {
        let name = match &self.data {
            Data::File(path) => path.file_name().and_then(|name| name.to_str()),
            Data::Memory { name, .. } => Some(name.as_str()),
        };
        name.filter(|name| is_safe_name(name)).ok_or_else(|| {
            let what = "has a name that not every system can restore; rename the file".to_owned();
            Error::Input { path: self.path(), what }
        })
    }

    /// Where it comes from, for errors.
    pub(crate) fn path(&self) -> PathBuf {
        match &self.data {
            Data::File(path) => path.clone(),
            Data::Memory { name, .. } => PathBuf::from(name),
        }
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// If the file's size cannot be read.
    pub fn size(&self) -> Result<u64> {
        match &self.data {
            Data::File(path) => Ok(fs::metadata(path).map_err(|e| Error::from(e).at(path))?.len()),
            Data::Memory { bytes, .. } => Ok(bytes.len() as u64),
        }
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// If it cannot be read, or is larger than any decoder takes.
    pub fn read(&self) -> Result<Vec<u8>> {
        check_limit("bytes of a file", self.size()?, Limits::default().file_bytes)
            .map_err(|e| e.at(self.path()))?;
        match &self.data {
            Data::File(path) => fs::read(path).map_err(|e| Error::from(e).at(path)),
            Data::Memory { bytes, .. } => Ok(bytes.clone()),
        }
    }

    /// The header of a frame that decodes to these bytes; its points are not counted yet.
    ///
    /// # Errors
    /// As [`name`](Self::name); also if no group has so many streams.
    pub(crate) fn header(&self, bytes: &[u8]) -> Result<FrameHeader> {
        check_limit("number of a frame's stream", self.stamp.stream.into(), STREAMS_MAX - 1)?;
        Ok(FrameHeader { stamp: self.stamp, ..FrameHeader::of(self.name()?, bytes, 0) })
    }
}

/// An error if decoders would refuse what is encoded.
fn check_limit(what: &'static str, got: u64, max: u64) -> Result<()> {
    if got > max { Err(Error::LimitExceeded { what: what.to_owned(), got, max }) } else { Ok(()) }
}
