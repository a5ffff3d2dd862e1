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
mod fingerprint;
mod journal;
mod kept;
mod settings;

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom};
use std::path::{Path, PathBuf};

pub use complete::confirm_complete;
use fingerprint::fingerprint;
use journal::{Entry, InputFile, Journal, JournalWriter};
use kept::IntactPart;
use settings::Settings;

use crate::container::ScannerRecord;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::{Error, Result};
use crate::stream::encoder::OpenStream;
use crate::stream::encoder::{SequenceCoder, groups_of};
use crate::stream::input::FrameInput;
use crate::stream::ordered::run_ordered;
use crate::stream::scanner_choice::{DriveScanners, choose_scanners, records_of};
use crate::stream::statistics::EncodeStatistics;

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
    let settings = settings::list(config, frames.len());
    let kept = find_kept(&partial)?;
    if !kept.entries.is_empty() {
        if let Some(what) = settings::difference(&kept.settings, &settings) {
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
