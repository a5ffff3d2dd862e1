//! The intact part of a partial stream.

use std::fs::File;
use std::io::{BufReader, Read, Seek};

use super::fingerprint::fingerprint;
use super::journal::{Entry, Journal};
use super::settings::Settings;
use crate::container::{CodedFrame, Index, Record, StreamReader};
use crate::frame::stages::StageReport;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::statistics::{EncodeStatistics, FrameStatistics};

/// The beginning of a partial stream that is intact and recorded in the journal.
#[derive(Default)]
pub struct IntactPart {
    /// The settings with which it was encoded.
    pub settings: Settings,
    /// The journal's entries about its groups; empty if nothing is kept.
    pub entries: Vec<Entry>,
    /// The locations of its records.
    pub index: Index,
    /// Statistics of its contents.
    pub encoded: EncodeStatistics,
    /// Its length in bytes.
    pub stream_end: u64,
    /// Length in bytes of the part of the journal that describes it.
    pub journal_end: u64,
}

impl IntactPart {
    /// Reads a stream up to the first byte that contradicts the journal. Damage is not an error; it only
    /// reduces what is kept.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn find(mut stream: &File, journal: Journal) -> Result<Self> {
        stream.rewind()?;
        let mut kept = IntactPart { settings: journal.settings, ..IntactPart::default() };
        let reader = StreamReader::open(BufReader::new(stream), Limits::default());
        let Some(mut reader) = intact(reader)? else { return Ok(kept) };
        for (entry, journal_end) in journal.entries {
            let Some(part) = intact(read_part(&mut reader, &entry))? else { break };
            part.into_iter().for_each(|frame| kept.encoded.add(frame));
            (kept.stream_end, kept.journal_end) = (entry.stream_end, journal_end);
            kept.entries.push(entry);
        }
        kept.encoded.resumed_frames = kept.encoded.frames.len() as u64;
        // Records read after the kept part are not included.
        kept.index = reader.index().clone();
        kept.index.truncate(kept.stream_end);
        Ok(kept)
    }
}

/// Reads the part of a stream that an entry of the journal describes; returns its frames.
///
/// # Errors
/// If it contradicts the journal.
fn read_part(reader: &mut StreamReader<impl Read>, entry: &Entry) -> Result<Vec<FrameStatistics>> {
    let mut groups = Vec::new();
    while reader.position() < entry.stream_end {
        match reader.next_record()? {
            Some(Record::Scanner(_)) => {}
            Some(Record::Group(group)) => groups.push(group),
            None => break,
        }
    }
    let frames = || groups.iter().flat_map(|group| &group.frames);
    let is_same = reader.position() == entry.stream_end
        && fingerprint(&groups) == entry.fingerprint
        && frames().map(|frame| &frame.header.name).eq(entry.files.iter().map(|file| &file.name));
    if !is_same {
        return Err(Error::corrupt("it is not what the journal tells"));
    }
    frames().map(FrameStatistics::kept).collect()
}

impl FrameStatistics {
    /// A frame that was encoded by an earlier run.
    pub(super) fn kept(frame: &CodedFrame) -> Result<Self> {
        let mut kept = FrameStatistics::of(frame, StageReport::default())?;
        // The size of the original file, if it differs from the decoded one.
        kept.stages = StageReport { frames: 1, original: kept.source.file_size, ..StageReport::default() };
        kept.stages.count_sections(&frame.sections);
        Ok(kept)
    }
}

/// A result of reading the stream; `None` if its bytes are damaged.
fn intact<T>(result: Result<T>) -> Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error @ Error::Io(_)) => Err(error),
        Err(_) => Ok(None),
    }
}
