//! Decoded frames as files: the original ones, or in another format.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use crate::container::FrameKind;
use crate::files::{FileFormat, Give, convert, is_convertible};
use crate::ground::error::{Error, Result};
use crate::scan::ScanFile;
use crate::stream::DecodedFrame;

use super::args::FormatArg;
use super::console::Console;
use super::table;

/// A file to write.
pub enum File {
    /// The original file.
    Original(Box<DecodedFrame>),
    /// A file in another format.
    Converted(Box<ScanFile>),
}

impl File {
    pub fn name(&self) -> &str {
        match self {
            File::Original(frame) => &frame.header.name,
            File::Converted(scan) => &scan.name,
        }
    }

    /// Passes its bytes to `give`, piece by piece.
    pub fn write(&self, give: &mut Give<'_>) -> Result<()> {
        match self {
            File::Original(frame) => frame.write(give),
            File::Converted(scan) => crate::files::write(scan, give),
        }
    }
}

/// Converts frames to files: the original ones, or in another format.
pub struct Converter {
    format: Option<FileFormat>,
    /// The frames' own names, by the names of the written files.
    names: Mutex<HashMap<String, String>>,
    /// Files without points, which cannot be converted: their number, and the number and name of the first
    /// frame of them.
    pointless: Mutex<(u64, Option<(u64, String)>)>,
}

impl Converter {
    /// Converts to this format; without one, only points that were never in a file.
    pub fn new(format: Option<FormatArg>) -> Self {
        let format = format.map(FormatArg::format);
        Converter { format, names: Mutex::default(), pointless: Mutex::default() }
    }

    /// Tells how many files were not converted.
    pub fn tell_unconverted(&self, console: Console) {
        let pointless = self.pointless.lock().unwrap_or_else(PoisonError::into_inner);
        if let (count, Some((_, first))) = &*pointless {
            let first = first.replace(char::is_control, "?");
            let files = table::count(*count, "file");
            console.say(format_args!(
                "lidarpc: {files} without points, such as {first}: not converted, but written as stored"
            ));
        }
    }

    /// The file of a frame. Files without points are not converted.
    ///
    /// # Errors
    /// If the frame cannot be converted, or if another frame already has its file name.
    pub fn file(&self, frame: DecodedFrame) -> Result<File> {
        let Some(format) = self.format_of(&frame) else { return Ok(File::Original(Box::new(frame))) };
        let frame = frame.checked()?;
        let name = frame.header.name.clone();
        let file = if is_convertible(&frame.scan) {
            let DecodedFrame { number, mut scan, .. } = frame;
            if scan.name.is_empty() {
                scan.name = format!("{number:06}");
            }
            File::Converted(Box::new(convert(&scan, format)?))
        } else {
            self.count_pointless(frame.number, &name);
            File::Original(Box::new(frame))
        };
        self.reserve(file.name(), name)?;
        Ok(file)
    }

    /// The format to which a frame is converted, if any.
    fn format_of(&self, frame: &DecodedFrame) -> Option<FileFormat> {
        match frame.header.stamp.kind {
            FrameKind::Beside => None,
            // Points in memory are converted to a format that names their channels.
            FrameKind::Points => self.format.or(Some(FileFormat::Pcd)),
            FrameKind::File | FrameKind::Message => self.format,
        }
    }

    /// Counts a file without points.
    fn count_pointless(&self, number: u64, name: &str) {
        let mut pointless = self.pointless.lock().unwrap_or_else(PoisonError::into_inner);
        let (count, first) = &mut *pointless;
        *count += 1;
        // Frames come from several threads, in any order.
        let this = (number, name.to_owned());
        *first = Some(first.take().map_or(this.clone(), |first| first.min(this)));
    }

    /// Reserves the name of a file for the frame with this name of its own.
    ///
    /// # Errors
    /// If another frame already has it.
    fn reserve(&self, file: &str, frame: String) -> Result<()> {
        let mut names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        match names.insert(file.to_owned(), frame.clone()) {
            None => Ok(()),
            Some(other) => {
                let what = format!("becomes {file}, as {other} does; decode them apart, by --frames");
                Err(Error::Input { path: frame.into(), what })
            }
        }
    }
}
