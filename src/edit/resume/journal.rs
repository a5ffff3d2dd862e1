//! The journal of an encode: the inputs of the stream. It is text, one JSON value per line: the settings,
//! then, for each group written to the stream, the files in it.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Seek, SeekFrom, Write};
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::settings::Settings;
use crate::container::FrameHeader;
use crate::ground::error::{Error, Result};

/// The first line.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Head {
    settings: Settings,
}

/// Any further line: files that were coded together, and the state of the stream after them.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// The files, in order.
    pub files: Vec<InputFile>,
    /// Size of the stream at the end of their groups.
    pub stream_end: u64,
    /// The fingerprint of their groups.
    pub fingerprint: u32,
}

/// A file as it was before encoding.
#[derive(Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct InputFile {
    pub name: String,
    /// Its kind, track and time.
    pub stamp: String,
    /// Size in bytes.
    pub size: u64,
    /// CRC-32C of its bytes.
    pub crc: u32,
}

impl InputFile {
    pub fn of(header: &FrameHeader) -> Self {
        let stamp = format!("{:?}", header.stamp);
        InputFile { name: header.name.clone(), stamp, size: header.file_size, crc: header.file_crc }
    }
}

/// The contents of a journal, up to the last complete line.
#[derive(Debug)]
pub struct Journal {
    pub settings: Settings,
    /// The lines after the first, each with the offset of its end, in bytes.
    pub entries: Vec<(Entry, u64)>,
}

impl Journal {
    /// Reads a journal; `None` if it or its first line is missing.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let file = match File::open(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            file => file.map_err(|e| Error::from(e).at(path))?,
        };
        let (mut input, mut end) = (BufReader::new(file), 0);
        let Some(Head { settings }) = read_line(&mut input, &mut end)? else { return Ok(None) };
        let mut entries = Vec::new();
        while let Some(entry) = read_line(&mut input, &mut end)? {
            entries.push((entry, end));
        }
        Ok(Some(Journal { settings, entries }))
    }
}

/// Reads a line, and sets `end` to the offset of its end; `None` if there is no line, or an incomplete one.
fn read_line<T: DeserializeOwned>(input: &mut impl BufRead, end: &mut u64) -> Result<Option<T>> {
    let mut line = Vec::new();
    *end += input.read_until(b'\n', &mut line)? as u64;
    Ok(line.strip_suffix(b"\n").and_then(|line| serde_json::from_slice(line).ok()))
}

/// Writes a journal.
#[derive(Debug)]
pub struct JournalWriter(File);

impl JournalWriter {
    /// Creates a journal with its first line, and waits until that is on disk: a stream must not exist
    /// without its journal.
    ///
    /// # Errors
    /// This and all other functions: if writing fails.
    pub fn begin(path: &Path, settings: Settings) -> Result<Self> {
        let mut writer = JournalWriter(File::create(path).map_err(|e| Error::from(e).at(path))?);
        writer.write_line(&Head { settings })?;
        writer.0.sync_all()?;
        Ok(writer)
    }

    /// Continues after `end` bytes.
    pub fn resume(path: &Path, end: u64) -> Result<Self> {
        let mut file = File::options().write(true).open(path).map_err(|e| Error::from(e).at(path))?;
        file.set_len(end)?;
        file.seek(SeekFrom::End(0))?;
        Ok(JournalWriter(file))
    }

    /// Writes a line about files whose groups were written.
    pub fn write(&mut self, entry: &Entry) -> Result<()> {
        self.write_line(entry)
    }

    fn write_line(&mut self, value: &impl Serialize) -> Result<()> {
        let mut line = serde_json::to_vec(value).map_err(io::Error::from)?;
        line.push(b'\n');
        Ok(self.0.write_all(&line)?)
    }
}
