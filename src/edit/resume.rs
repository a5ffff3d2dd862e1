//! Resumes an interrupted encode; the resulting stream is the same as without the interruption.
//!
//! A group depends only on the program, its settings, the scanners and the group's files, so the groups of a
//! partial stream are kept if all of these are unchanged. A *journal* beside the stream records the program,
//! the settings, and the names, sizes and checksums of all files in the stream. (The checksums in frame
//! headers are those of the decoded files, which differ in lossy modes.) The files are read again and
//! compared, and the scanners are fitted again. The journal also holds a checksum of the groups themselves,
//! so that it applies to this stream only, and not to data that a killed program or a power failure left
//! half-written.
//!
//! It would be simpler to encode the rest separately and join the two. But scanners are fitted to a sample of
//! all frames, so the rest would get another scanner, and the resulting stream would differ. Nor can a stream
//! alone identify the files and settings from which it was encoded if the encoding was lossy: this is what
//! the journal is for.

mod complete;
mod journal;

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

pub use complete::confirm_complete;
use journal::{Entry, InputFile, Journal, JournalWriter, Settings};

use crate::container::{CodedFrame, Group, Index, Record, ScannerRecord, StreamReader};
use crate::frame::settings::EncoderConfig;
use crate::frame::stages::StageReport;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::encoder::{OpenStream, SequenceCoder, groups_of};
use crate::stream::input::FrameInput;
use crate::stream::ordered::run_ordered;
use crate::stream::scanner_choice::{DriveScanners, choose_scanners, records_of};
use crate::stream::statistics::{EncodeStatistics, FrameStatistics};

/// Advice for a partial stream that cannot be continued.
const ADVICE: &str = "delete it to start anew, or encode without resuming";

/// The files of an encode that may be interrupted.
#[derive(Debug)]
pub struct PartialFiles {
    /// The name of the partial stream in errors.
    pub path: PathBuf,
    /// The stream as far as it was written; open for reading and writing, initially empty.
    pub stream: File,
    /// The journal; initially missing.
    pub journal: PathBuf,
}

/// As [`encode`](crate::stream::encode()), into files that are continued if an earlier encode was
/// interrupted: groups that are already in them are kept. The result is the same stream, byte for byte, as
/// that of an uninterrupted encode. For kept frames, `on_frame` is called after their files were compared.
///
/// # Errors
/// As [`encode`](crate::stream::encode()); also if the files are not those of an encode, or those of an
/// encode with other settings or frames. They are then left unchanged.
pub fn encode_resuming(
    frames: &[FrameInput],
    config: &EncoderConfig,
    partial: PartialFiles,
    on_frame: &(dyn Fn() + Sync),
) -> Result<EncodeStatistics> {
    config.check()?;
    let settings = journal::settings_of(config, frames.len());
    let kept = find_kept(&partial)?;
    if !kept.entries.is_empty() {
        if let Some(what) = journal::changed_setting(&kept.settings, &settings) {
            return Err(refuse(&partial.path, format!("was begun with other settings ({what})")));
        }
        compare_inputs(&kept, frames, config, &partial.path, on_frame)?;
    }
    let scanners = choose_scanners(frames, config)?;
    let kept_scanners = kept.index.scanners().iter().map(|entry| entry.id);
    if !kept.entries.is_empty() && !kept_scanners.eq(records_of(&scanners).iter().map(ScannerRecord::id)) {
        let what = "was begun with another scanner model, so scans that it was fitted to were changed";
        return Err(refuse(&partial.path, what));
    }

    let rest = groups_of(frames, config).skip(kept.entries.len());
    let (mut stream, mut journal) = open(&partial, kept, settings, &scanners)?;
    let coder = SequenceCoder::new(&scanners, config, on_frame);
    coder.run(rest, |groups| {
        stream.write(&groups)?;
        journal.write(&Entry {
            files: groups.iter().flat_map(|group| &group.originals).map(InputFile::of).collect(),
            stream_end: stream.position(),
            fingerprint: fingerprint(groups.iter().map(|group| &group.group)),
        })
    })?;
    stream.finish()
}

/// Opens the files for writing after the kept part, or from the start if nothing is kept.
fn open<'p>(
    partial: &'p PartialFiles,
    kept: IntactPart,
    settings: Settings,
    scanners: &[DriveScanners],
) -> Result<(OpenStream<BufWriter<&'p File>>, JournalWriter)> {
    let scanners = records_of(scanners);
    let mut stream = &partial.stream;
    stream.set_len(kept.stream_end)?;
    stream.seek(SeekFrom::Start(kept.stream_end))?;
    let out = BufWriter::new(stream);
    Ok(if kept.entries.is_empty() {
        // The journal is created first: a stream must never exist without one.
        let journal = JournalWriter::begin(&partial.journal, settings)?;
        (OpenStream::begin(out, &scanners)?, journal)
    } else {
        let journal = JournalWriter::resume(&partial.journal, kept.journal_end)?;
        (OpenStream::resume(out, (kept.index, kept.stream_end), &scanners, kept.encoded)?, journal)
    })
}

/// The intact part of the files; nothing if they are new.
fn find_kept(partial: &PartialFiles) -> Result<IntactPart> {
    match Journal::read(&partial.journal)? {
        Some(journal) => IntactPart::find(&partial.stream, journal),
        None if partial.stream.metadata()?.len() == 0 => Ok(IntactPart::default()),
        None => Err(refuse(&partial.path, "has no journal that says what it was made from")),
    }
}

/// An error if these are not the files from which the kept groups were encoded.
fn compare_inputs(
    kept: &IntactPart,
    frames: &[FrameInput],
    config: &EncoderConfig,
    partial: &Path,
    on_frame: &(dyn Fn() + Sync),
) -> Result<()> {
    if kept.encoded.frames.len() > frames.len() {
        return Err(refuse(partial, "was begun with more frames"));
    }
    let pairs = kept.entries.iter().zip(groups_of(frames, config));
    let pairs = pairs.map(|(entry, inputs)| Ok((entry, inputs?)));
    let compare = |(entry, inputs): (&Entry, Cow<'_, [FrameInput]>)| {
        if entry.files.len() != inputs.len() {
            return Err(refuse(partial, "was begun with other frames"));
        }
        for (file, input) in entry.files.iter().zip(&*inputs) {
            let name = input.name()?;
            if file.name != name || file.stamp != format!("{:?}", input.stamp()) {
                let what = format!("was begun with other frames ({:?}, now {name:?})", file.name);
                return Err(refuse(partial, what));
            }
            if *file != InputFile::of(&input.header(&input.read()?)?) {
                let partial = partial.display();
                let what = format!(
                    "was changed after {partial} was begun with it; delete that to start anew, or encode \
                     without resuming"
                );
                return Err(Error::Input { path: input.path(), what });
            }
            on_frame();
        }
        Ok(())
    };
    run_ordered(config.threads, pairs, compare, Ok)
}

/// An error about a partial stream.
fn refuse(partial: &Path, what: impl std::fmt::Display) -> Error {
    Error::Input { path: partial.to_path_buf(), what: format!("{what}; {ADVICE}") }
}

/// The beginning of a partial stream that is intact and recorded in the journal.
#[derive(Default)]
struct IntactPart {
    /// The settings with which it was encoded.
    settings: Settings,
    /// The journal's entries about its groups; empty if nothing is kept.
    entries: Vec<Entry>,
    /// The locations of its records.
    index: Index,
    /// Statistics of its contents.
    encoded: EncodeStatistics,
    /// Its length in bytes.
    stream_end: u64,
    /// Length in bytes of the part of the journal that describes it.
    journal_end: u64,
}

impl IntactPart {
    /// Reads a stream up to the first byte that contradicts the journal. Damage is not an error; it only
    /// reduces what is kept.
    ///
    /// # Errors
    /// If the file cannot be read.
    fn find(mut stream: &File, journal: Journal) -> Result<Self> {
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

/// A checksum over the checksums of everything in the groups. A CRC over the bytes of the stream would be
/// useless: each section ends in its own CRC-32C, and a CRC over such bytes depends on their length alone.
fn fingerprint<'g>(groups: impl IntoIterator<Item = &'g Group>) -> u32 {
    let mut parts = Vec::new();
    for group in groups {
        let names = group.scanners.iter().map(|scanner| scanner.map_or(0, |id| u64::from(id.0) + 1));
        parts.extend(names.flat_map(u64::to_le_bytes));
        for CodedFrame { header, sections } in &group.frames {
            CodedFrame { header: header.clone(), sections: Vec::new() }.write_to(&mut parts);
            for section in sections {
                parts.push(section.kind.number());
                parts.extend(crc32c::crc32c(&section.payload).to_le_bytes());
            }
        }
    }
    crc32c::crc32c(&parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::container::{FrameHeader, ScannerId, Section, SectionKind};

    #[test]
    fn groups_of_the_same_length_differ() {
        let scanner = Some(ScannerId(7));
        let group = |name: &str, byte, kind, scanner| {
            let sections = vec![Section { kind, payload: vec![byte; 9] }];
            Group {
                scanners: vec![scanner],
                frames: vec![CodedFrame { header: FrameHeader::of(name, b"", 0), sections }],
            }
        };
        let groups = [
            group("1", 1, SectionKind::Range, scanner),
            group("2", 1, SectionKind::Range, scanner),
            group("1", 2, SectionKind::Range, scanner),
            group("1", 1, SectionKind::Strays, scanner),
            group("1", 1, SectionKind::Range, None),
        ];
        for (place, one) in groups.iter().enumerate() {
            let same = groups.iter().filter(|other| fingerprint([*other]) == fingerprint([one])).count();
            assert_eq!(same, 1, "{place}");
        }
    }
}
