//! The input of the encoder.

use std::fs;
use std::path::PathBuf;

use crate::container::{FrameHeader, FrameKind, Stamp, TRACKS_MAX};
#[cfg(feature = "cli")]
use crate::container::{Time, TimeSource};
use crate::files::names::check_name;
#[cfg(feature = "cli")]
use crate::files::sequence::FoundFile;
use crate::files::{self, HeaderlessLayout, parse_with};
use crate::ground::error::{Error, Limits, Result};
use crate::scan::ScanFile;

/// One frame to encode.
#[derive(Clone, Debug)]
pub struct FrameInput {
    data: Data,
    stamp: Stamp,
    drive: usize,
}

/// The data of a frame, or where to read them.
#[derive(Clone, Debug)]
enum Data {
    File { path: PathBuf, name: String },
    Memory { name: String, bytes: Vec<u8> },
    Scan(Box<ScanFile>),
}

/// A frame that was read, for the encoder.
pub(crate) struct ReadFrame {
    /// The frame header of the decoded file.
    pub header: FrameHeader,
    /// The file, split into points and the bytes around them.
    pub scan: ScanFile,
}

impl FrameInput {
    /// A file, which is read when its turn comes, and its name for decoding, which may be a path with `/` as
    /// separator.
    pub fn file(path: PathBuf, name: String) -> Self {
        FrameInput { data: Data::File { path, name }, stamp: Stamp::default(), drive: 0 }
    }

    /// A file [beside](FrameKind::Beside) the scans, which is stored as plain bytes; or, if the name ends in
    /// `/`, an empty folder.
    pub fn beside(path: PathBuf, name: String) -> Self {
        let stamp = Stamp { kind: FrameKind::Beside, ..Stamp::default() };
        FrameInput::file(path, name).stamped(stamp)
    }

    /// The bytes of a file, and its name for decoding.
    pub fn memory(name: String, bytes: Vec<u8>) -> Self {
        FrameInput { data: Data::Memory { name, bytes }, stamp: Stamp::default(), drive: 0 }
    }

    /// Points that are already parsed: [points in memory](FrameKind::Points), which need no name, unless
    /// [`stamped`](Self::stamped) says otherwise.
    pub fn scan(scan: ScanFile) -> Self {
        let stamp = Stamp { kind: FrameKind::Points, ..Stamp::default() };
        FrameInput { data: Data::Scan(Box::new(scan)), stamp, drive: 0 }
    }

    /// This input with its kind, track and time. By default it is a file on the first track, without a
    /// time.
    pub fn stamped(self, stamp: Stamp) -> Self {
        FrameInput { stamp, ..self }
    }

    /// The files found below an input; frames of different drives are marked as such.
    #[cfg(feature = "cli")]
    pub fn from_files(files: impl IntoIterator<Item = FoundFile>) -> Vec<Self> {
        let (mut inputs, mut last, mut number) = (Vec::new(), None, 0);
        for FoundFile { path, name, drive, time } in files {
            if last.as_ref().is_some_and(|last| *last != drive) {
                number += 1;
            }
            last = Some(drive);
            let time = time.map(|found| Time {
                source: if found.is_listed { TimeSource::List } else { TimeSource::FileName },
                nanoseconds: found.nanoseconds,
            });
            let stamp = Stamp { time, ..Stamp::default() };
            inputs.push(FrameInput::file(path, name).stamped(stamp).of_drive(number));
        }
        inputs
    }

    /// This input as part of the drive with this number: frames of different drives share no group, and
    /// each drive has its own scanners. Frames of one drive must be consecutive.
    pub fn of_drive(self, drive: usize) -> Self {
        FrameInput { drive, ..self }
    }

    /// The number of its drive.
    pub(crate) fn drive(&self) -> usize {
        self.drive
    }

    /// Its kind, track and time.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The name for the decoded file.
    ///
    /// # Errors
    /// If no decoder would write a file with that name.
    pub fn name(&self) -> Result<&str> {
        let name = match &self.data {
            Data::File { name, .. } | Data::Memory { name, .. } => name,
            Data::Scan(scan) => &scan.name,
        };
        let can_do_without = self.stamp.kind != FrameKind::File;
        if !(name.is_empty() && can_do_without) {
            // An empty folder, or a folder for the points of a topic.
            let may_be_folder = matches!(self.stamp.kind, FrameKind::Beside | FrameKind::Points);
            let folder = name.strip_suffix('/').filter(|_| may_be_folder);
            check_name(&self.path(), folder.unwrap_or(name))?;
        }
        Ok(name)
    }

    /// Its origin, for errors.
    pub(crate) fn path(&self) -> PathBuf {
        match &self.data {
            Data::File { path, .. } => path.clone(),
            Data::Memory { name, .. } => PathBuf::from(name),
            Data::Scan(scan) if scan.name.is_empty() => PathBuf::from("scan"),
            Data::Scan(scan) => PathBuf::from(&scan.name),
        }
    }

    /// Whether it is an empty folder.
    fn is_folder(&self) -> bool {
        self.stamp.kind == FrameKind::Beside && self.name().is_ok_and(|name| name.ends_with('/'))
    }

    /// Bytes of the file.
    ///
    /// # Errors
    /// If the file's size cannot be read.
    pub fn size(&self) -> Result<u64> {
        match &self.data {
            Data::File { .. } if self.is_folder() => Ok(0),
            Data::File { path, .. } => Ok(fs::metadata(path).map_err(|e| Error::from(e).at(path))?.len()),
            Data::Memory { bytes, .. } => Ok(bytes.len() as u64),
            Data::Scan(scan) => {
                let records = (scan.records as u64).saturating_mul(scan.layout.stride() as u64);
                Ok(records.saturating_add((scan.prefix.len() + scan.suffix.len()) as u64))
            }
        }
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// If it cannot be read, or is larger than any decoder accepts.
    pub fn read(&self) -> Result<Vec<u8>> {
        self.clone().into_bytes()
    }

    fn into_bytes(self) -> Result<Vec<u8>> {
        Error::check_fits("bytes", self.size()?, Limits::default().file_bytes)
            .map_err(|e| e.at(self.path()))?;
        let is_folder = self.is_folder();
        match self.data {
            Data::File { .. } if is_folder => Ok(Vec::new()),
            Data::File { path, .. } => fs::read(&path).map_err(|e| Error::from(e).at(path)),
            Data::Memory { bytes, .. } => Ok(bytes),
            Data::Scan(scan) => scan.to_bytes(),
        }
    }

    /// The frame, parsed. `headerless` gives the fields of records in files without a header.
    ///
    /// # Errors
    /// As [`read`](Self::read) and [`name`](Self::name); also if its track number exceeds what a group can
    /// have.
    pub(crate) fn into_frame(self, headerless: Option<&HeaderlessLayout>) -> Result<ReadFrame> {
        let path = self.path();
        self.try_into_frame(headerless).map_err(|error| match error {
            Error::At { .. } | Error::Input { .. } => error,
            other => other.at(path),
        })
    }

    fn try_into_frame(self, headerless: Option<&HeaderlessLayout>) -> Result<ReadFrame> {
        Error::check_fits("tracks", u64::from(self.stamp.track) + 1, TRACKS_MAX)?;
        let (name, stamp) = (self.name()?.to_owned(), self.stamp);
        let (header, scan) = match self.data {
            Data::Scan(scan) => {
                if stamp.kind == FrameKind::Points {
                    Error::check_fits("points", scan.records as u64, Limits::default().points)?;
                }
                (header_of(&scan)?, *scan)
            }
            Data::File { .. } | Data::Memory { .. } => {
                let bytes = self.into_bytes()?;
                let header = FrameHeader::of(&name, &bytes, 0);
                match stamp.kind {
                    FrameKind::Beside => (header, ScanFile::opaque(name, bytes)),
                    _ => (header, parse_with(&name, bytes, headerless)),
                }
            }
        };
        Error::check_fits("bytes", header.file_size, Limits::default().file_bytes)?;
        let point_count = scan.records as u64;
        Ok(ReadFrame { header: FrameHeader { stamp, point_count, ..header }, scan })
    }

    /// The header of a frame that decodes to these bytes; its points are not counted yet.
    ///
    /// # Errors
    /// As [`name`](Self::name); also if its track number exceeds what a group can have.
    pub(crate) fn header(&self, bytes: &[u8]) -> Result<FrameHeader> {
        Error::check_fits("tracks", u64::from(self.stamp.track) + 1, TRACKS_MAX)?;
        Ok(FrameHeader { stamp: self.stamp, ..FrameHeader::of(self.name()?, bytes, 0) })
    }
}

/// The frame header for a parsed file.
fn header_of(scan: &ScanFile) -> Result<FrameHeader> {
    let mut header = FrameHeader { name: scan.name.clone(), ..FrameHeader::default() };
    files::write(scan, |piece| {
        header.file_size += piece.len() as u64;
        header.file_crc = crc32c::crc32c_append(header.file_crc, piece);
        Ok(())
    })?;
    Ok(header)
}
