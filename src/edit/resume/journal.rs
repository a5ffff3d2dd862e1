//! The journal of an encode: the inputs of the stream. It is text, one JSON value per line: the settings,
//! that is, everything that determines a stream besides the contents and order of the files, then, for each
//! group written to the stream, the files in it.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Seek, SeekFrom, Write};
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::container::FrameHeader;
use crate::frame::PositionFidelity;
use crate::frame::settings::EncoderConfig;
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

/// Names and values, in the order in which they are compared.
pub type Settings = Vec<(String, String)>;

/// The settings of an encode: the program's version, and all choices except the number of threads, which has
/// no effect. The number of frames is included, because scanners are fitted to a sample of all frames.
pub fn settings_of(config: &EncoderConfig, frames: usize) -> Settings {
    // Every field is named, so that new ones cannot be forgotten here.
    let EncoderConfig {
        gop,
        threads: _,
        outliers,
        headerless,
        projection,
        positions,
        intensity,
        prediction,
        order,
        registration,
        snake,
        halved_from,
        segmentation,
        intra,
        coder,
        level,
        packing,
        image,
    } = config;
    let settings = [
        ("lidarpc", env!("CARGO_PKG_VERSION").to_owned()),
        ("frames", frames.to_string()),
        ("gop", gop.to_string()),
        ("largest error", largest_error(*positions)),
        ("intensity", format!("{intensity:?}")),
        ("projection", format!("{projection:?}")),
        ("layout", format!("{headerless:?}")),
        ("outliers", format!("{outliers:?}")),
        ("backend", format!("{coder:?}")),
        ("level", level.number().to_string()),
        ("packing", format!("{packing:?}")),
        ("snake", format!("{snake:?}")),
        ("halved from", format!("{halved_from:?}")),
        ("image", format!("{image:?}")),
        ("predict", format!("{prediction:?}")),
        ("order", format!("{order:?}")),
        ("registration", format!("{registration:?}")),
        ("segmentation", format!("{segmentation:?}")),
        ("regions", format!("{intra:?}")),
    ];
    settings.map(|(name, value)| (name.to_owned(), value)).into()
}

/// The largest error of positions, in words.
fn largest_error(positions: PositionFidelity) -> String {
    match positions {
        PositionFidelity::Exact => "none".to_owned(),
        PositionFidelity::Formula => "that of paper mode".to_owned(),
        PositionFidelity::Bounded { max_error_um, on_grid } => {
            let grid = if on_grid { " on the file's grid" } else { "" };
            format!("{} mm{grid}", f64::from(max_error_um) / 1000.0)
        }
    }
}

/// The first setting that differs, with both values, if there is any.
pub fn changed_setting(before: &Settings, now: &Settings) -> Option<String> {
    let differs = before.iter().zip(now).find(|(before, now)| before != now);
    match differs {
        Some(((name, before), (other, now))) if name == other => Some(format!("{name}: {before}, now {now}")),
        None if before.len() == now.len() => None,
        _ => Some("of another program".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Level;
    use crate::frame::settings::Mode;

    #[test]
    fn what_differs_is_named_and_threads_do_not() {
        let exact = EncoderConfig::default();
        let before = settings_of(&exact, 3);
        assert_eq!(
            changed_setting(&before, &settings_of(&EncoderConfig { threads: 7, ..exact.clone() }, 3)),
            None
        );
        assert_eq!(changed_setting(&before, &settings_of(&exact, 4)).unwrap(), "frames: 3, now 4");
        assert_eq!(
            changed_setting(&before, &settings_of(&EncoderConfig { gop: 2, ..exact }, 3)).unwrap(),
            "gop: 10, now 2"
        );
        let bounded = |max_error_um| settings_of(&EncoderConfig::preset(Mode::Bounded { max_error_um }), 3);
        let what = changed_setting(&bounded(10_000), &bounded(10_001)).unwrap();
        assert_eq!(what, "largest error: 10 mm, now 10.001 mm");
        assert!(changed_setting(&before[..5].to_vec(), &before).is_some());
        let level = |number| EncoderConfig { level: Level::new(number).unwrap(), ..EncoderConfig::default() };
        assert_eq!(
            changed_setting(&settings_of(&level(6), 3), &settings_of(&level(9), 3)).unwrap(),
            "level: 6, now 9"
        );
    }
}
