//! Decoded frames as files: the original ones, or in another format.

use std::collections::HashMap;
use std::sync::Mutex;

use crate::container::FrameKind;
use crate::files::{FileFormat, Give, convert, is_convertible};
use crate::ground::error::{Error, Result, one_line};
use crate::ground::team::locked;
use crate::scan::ScanFile;
use crate::stream::DecodedFrame;

use super::args::FormatArg;
use super::console::Console;
use super::readable;

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

/// The name of a file, but for its extension, for the points of a frame with this name, if it has one, and this
/// number. Clouds of a recording have that of a folder.
pub fn name_of_points(name: &str, number: u64) -> String {
    if name.is_empty() || name.ends_with('/') { format!("{name}{number:06}") } else { name.to_owned() }
}

/// Converts frames to files: the original ones, or in another format.
pub struct Converter {
    format: Option<FileFormat>,
    /// The frames' own names, by the names of the written files; `None` if several files may have one name.
    names: Option<Mutex<HashMap<String, String>>>,
    /// Files without points, which cannot be converted: their number, and the number and name of the first
    /// frame of them.
    without_points: Mutex<(u64, Option<(u64, String)>)>,
}

impl Converter {
    /// Converts to this format; without one, only points that were never in a file.
    pub fn new(format: Option<FormatArg>) -> Self {
        let format = format.map(FormatArg::format);
        Converter { format, names: Some(Mutex::default()), without_points: Mutex::default() }
    }

    /// The same, but several files may have one name, as messages do.
    pub fn with_any_names(self) -> Self {
        Converter { names: None, ..self }
    }

    /// Tells how many files were not converted.
    pub fn report_unconverted(&self, console: Console) {
        let without_points = locked(&self.without_points);
        if let (count, Some((_, first))) = &*without_points {
            let first = one_line(first);
            let files = readable::count(*count, "file");
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
            scan.name = name_of_points(&scan.name, number);
            File::Converted(Box::new(convert(&scan, format)?))
        } else {
            self.count_without_points(frame.number, &name);
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
    fn count_without_points(&self, number: u64, name: &str) {
        let mut without_points = locked(&self.without_points);
        let (count, first) = &mut *without_points;
        *count += 1;
        // Frames come from several threads, in any order.
        let this = (number, name.to_owned());
        *first = Some(first.take().map_or(this.clone(), |first| first.min(this)));
    }

    /// Reserves the name of a file for the frame with this name of its own.
    ///
    /// # Errors
    /// If another frame already has it, and names may not be repeated.
    fn reserve(&self, file: &str, frame: String) -> Result<()> {
        let Some(names) = &self.names else { return Ok(()) };
        let mut names = locked(names);
        match names.insert(file.to_owned(), frame.clone()) {
            None => Ok(()),
            Some(other) => {
                let what = format!("becomes {file}, as {other} does; decode them apart, by --frames");
                Err(Error::Input { path: frame.into(), what })
            }
        }
    }
}
