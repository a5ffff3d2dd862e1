//! Frames as they arrive: from a tar archive, or each after a line with its name and size.

use std::io::{BufReader, Chain, Cursor, Read};
use std::path::PathBuf;

use super::EXTENSIONS;
use super::names::{FileNames, NameConflict};
use super::sequence::{LeftOut, LeftOutKind};
use super::tar::TarReader;
use crate::ground::error::{Error, Limits, Result};

/// The longest line before a frame, in bytes: a name, a space, and a number.
const MAX_LINE: usize = 300;
/// The longest name in such a line, in bytes: the number takes ten.
pub const MOST_NAME_BYTES: usize = MAX_LINE - 12;

/// The first bytes of compressed files, which no name can begin with, and the programs that decompress them.
const COMPRESSORS: [(&[u8], &str); 4] =
    [(b"\x1f\x8b", "gzip"), (b"\x28\xb5\x2f\xfd", "zstd"), (b"\xfd7zXZ", "xz"), (b"BZh91AY&SY", "bzip2")];

/// A file that arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArrivedFile {
    /// Its name; in an archive, with its folder unless that is the first one.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// Reads frames as they arrive, never further than necessary. The first bytes tell the two kinds of input
/// apart: a line ends with a line feed, and a tar archive has a zero byte before any line feed.
pub struct ArrivingFrames<R> {
    source: Source<R>,
    /// The names so far, since no decoder could write two files with one name; none if names may repeat.
    names: Option<FileNames<()>>,
    /// Whether there was a frame so far.
    has_frames: bool,
    left_out: LeftOut,
}

/// The input, including the bytes read to recognise its kind.
type Whole<R> = Chain<Cursor<Vec<u8>>, BufReader<R>>;

enum Source<R> {
    /// Nothing has been read yet.
    New(BufReader<R>),
    Lines(Whole<R>),
    Tar(TarReader<Whole<R>>),
    /// After the last frame, or after an error.
    Ended,
}

impl<R: Read> ArrivingFrames<R> {
    /// Starts at the first byte of the input.
    pub fn new(input: R) -> Self {
        let source = Source::New(BufReader::new(input));
        ArrivingFrames {
            source,
            names: Some(FileNames::default()),
            has_frames: false,
            left_out: LeftOut::default(),
        }
    }

    /// This reader, but names may repeat: for frames that do not become one stream.
    #[must_use]
    pub fn with_any_names(self) -> Self {
        ArrivingFrames { names: None, ..self }
    }

    /// The contents of the archive other than frames; complete after the last frame.
    pub fn left_out(&self) -> &LeftOut {
        &self.left_out
    }

    /// The next frame; `None` after the last.
    fn next_file(&mut self) -> Result<Option<ArrivedFile>> {
        if matches!(self.source, Source::New(_)) {
            self.source = detect(std::mem::replace(&mut self.source, Source::Ended))?;
        }
        let file = match &mut self.source {
            Source::Lines(input) => next_of_lines(input)?,
            Source::Tar(archive) => match archive.next_scan()? {
                Some(file) => Some(file),
                None => {
                    self.left_out = std::mem::take(&mut archive.left_out);
                    return self.end_of_archive();
                }
            },
            Source::New(_) | Source::Ended => None,
        };
        let Some(file) = file else { return Ok(None) };
        self.has_frames = true;
        let conflict = self.names.as_mut().and_then(|names| names.add(&file.name, ()).err());
        let what = match conflict {
            None => return Ok(Some(file)),
            Some(NameConflict::SameName(())) => "arrives a second time",
            Some(NameConflict::FileAndFolder) => "needs a file and a folder of one name",
        };
        Err(refuse(&file.name, format!("{what}; give each frame a name of its own")))
    }

    /// An archive without scans is an error, like a folder without scans.
    fn end_of_archive(&self) -> Result<Option<ArrivedFile>> {
        if self.has_frames {
            return Ok(None);
        }
        let what = match (self.left_out.0.get(&LeftOutKind::Link), self.left_out.0.values().next()) {
            (Some(links), _) => {
                format!(
                    "holds no scans but symbolic links ({}); make it with tar's --dereference",
                    links.first
                )
            }
            (None, Some(others)) => {
                format!("holds no {EXTENSIONS} with points, only files such as {}", others.first)
            }
            (None, None) => "is empty: tar found no file to put into it".to_owned(),
        };
        Err(refuse("the archive", what))
    }
}

impl<R: Read> Iterator for ArrivingFrames<R> {
    type Item = Result<ArrivedFile>;

    fn next(&mut self) -> Option<Self::Item> {
        let file = self.next_file().transpose();
        if !matches!(file, Some(Ok(_))) {
            self.source = Source::Ended;
        }
        file
    }
}

fn detect<R: Read>(source: Source<R>) -> Result<Source<R>> {
    let Source::New(mut input) = source else { return Ok(source) };
    let mut start = Vec::new();
    while start.len() < MAX_LINE && input.by_ref().take(1).read_to_end(&mut start)? > 0 {
        if let Some(0 | b'\n') = start.last() {
            break;
        }
    }
    if let Some((_, program)) = COMPRESSORS.iter().find(|(magic, _)| start.starts_with(magic)) {
        let what =
            format!("is compressed by {program}; decompress it first: {program} -dc | lidarpc encode -");
        return Err(refuse("stdin", what));
    }
    let is_tar = start.last() == Some(&0);
    let whole = Cursor::new(start).chain(input);
    Ok(if is_tar { Source::Tar(TarReader::new(whole)) } else { Source::Lines(whole) })
}

/// Reads a line `NAME SIZE`, then `SIZE` bytes.
fn next_of_lines(input: &mut impl Read) -> Result<Option<ArrivedFile>> {
    let mut line = Vec::new();
    loop {
        if input.by_ref().take(1).read_to_end(&mut line)? == 0 {
            return if line.is_empty() { Ok(None) } else { Err(cut_short("stdin")) };
        }
        if line.last() == Some(&b'\n') {
            break;
        }
        if line.len() > MAX_LINE {
            return Err(no_line(&line));
        }
    }
    let parts = str::from_utf8(&line).ok().and_then(|line| line.trim_end().rsplit_once(' '));
    let parts = parts.and_then(|(name, size)| Some((name.to_owned(), size.parse().ok()?)));
    let (name, size) = parts.ok_or_else(|| no_line(&line))?;
    Ok(Some(ArrivedFile { bytes: read_file(input, &name, size)?, name }))
}

/// Reads the bytes of a file. Memory grows with the bytes that arrive.
pub(super) fn read_file(input: &mut impl Read, name: &str, size: u64) -> Result<Vec<u8>> {
    let max = Limits::default().file_bytes;
    Error::check_fits("bytes", size, max).map_err(|e| e.at(name))?;
    let mut bytes = Vec::new();
    if input.by_ref().take(size).read_to_end(&mut bytes)? as u64 != size {
        return Err(cut_short(name));
    }
    Ok(bytes)
}

/// An error about a file, or about the input that contains it.
pub(super) fn refuse(name: &str, what: impl Into<String>) -> Error {
    Error::Input { path: PathBuf::from(name), what: what.into() }
}

pub(super) fn cut_short(name: &str) -> Error {
    refuse(name, "is cut short; send it again")
}

fn no_line(line: &[u8]) -> Error {
    let shown = String::from_utf8_lossy(&line[..line.len().min(40)]).into_owned();
    refuse("stdin", format!("sends {shown:?}, neither a tar archive nor a line of name and size"))
}
