//! Confirms that a complete stream need not be encoded again.

use std::fs::File;
use std::io::BufReader;

use super::fingerprint;
use crate::container::{FrameHeader, Record, ScannerId, ScannerRecord, StreamReader};
use crate::frame::settings::EncoderConfig;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::encoder::{SequenceCoder, groups_of};
use crate::stream::input::FrameInput;
use crate::stream::ordered::run_ordered;
use crate::stream::scanner_choice::{choose_scanners, records_of};
use crate::stream::statistics::{EncodeStatistics, FrameStatistics};

/// Confirms that a complete stream is the one that an encode of these frames with these settings gives; there
/// is no journal of it any more. An exact stream holds the checksums of the files, so that they only need be
/// read, and one group is encoded again, as a sample of the settings. Of any other stream all groups are.
/// `on_frame` is called for each frame that was compared.
///
/// # Errors
/// [`Error::Usage`], with what differs; if a file or the stream cannot be read.
pub fn confirm_complete(
    frames: &[FrameInput],
    config: &EncoderConfig,
    stream: &File,
    on_frame: &(dyn Fn() + Sync),
) -> Result<EncodeStatistics> {
    config.check()?;
    let Complete { encoded, scanners, groups } = Complete::read(stream).map_err(|error| match error {
        Error::Io(_) => error,
        _ => differs(format!("is no whole stream: {error}")),
    })?;
    if encoded.frames.len() != frames.len() {
        return Err(differs(format!("holds {} frames, not {}", encoded.frames.len(), frames.len())));
    }
    let is_exact = config.is_exact();
    if is_exact && encoded.exact + encoded.beside != frames.len() as u64 {
        return Err(differs("does not hold the files exactly"));
    }
    compare_inputs(&encoded.frames, frames, config, &|| {
        if is_exact {
            on_frame()
        }
    })?;
    let of_drives = choose_scanners(frames, config)?;
    if !records_of(&of_drives).iter().map(ScannerRecord::id).eq(scanners) {
        return Err(differs(OTHER_SETTINGS));
    }
    let sizes = groups_of(frames, config).map(|group| group.map(|group| group.len()));
    let has_sizes = sizes.collect::<Result<Vec<_>>>()?.iter().eq(groups.iter().map(|(size, _)| size));
    let sample = if is_exact && has_sizes { 1 } else { usize::MAX };
    let mut known = groups.iter();
    let count = || {
        if !is_exact {
            on_frame()
        }
    };
    SequenceCoder::new(&of_drives, config, &count).run(groups_of(frames, config).take(sample), |coded| {
        coded.iter().try_for_each(|coded| match known.next() {
            Some((_, known)) if *known == fingerprint([&coded.group]) => Ok(()),
            Some((size, _)) if *size != coded.group.frames.len() => {
                Err(differs(format!("has {size} frames in a group, not {}", coded.group.frames.len())))
            }
            _ => Err(differs(OTHER_SETTINGS)),
        })
    })?;
    Ok(encoded)
}

/// The error that a stream is not the one that an encode gives.
fn differs(what: impl Into<String>) -> Error {
    Error::Usage(what.into())
}

/// What may differ if the same frames are coded in another way.
const OTHER_SETTINGS: &str = "was made with other settings, of other files, or by another version of lidarpc";

/// The contents of a complete stream.
struct Complete {
    encoded: EncodeStatistics,
    /// The checksums of its scanners.
    scanners: Vec<ScannerId>,
    /// Number of frames and fingerprint of each group.
    groups: Vec<(usize, u32)>,
}

impl Complete {
    /// # Errors
    /// If the stream is damaged anywhere, or not complete.
    fn read(stream: &File) -> Result<Self> {
        let mut reader = StreamReader::open(BufReader::new(stream), Limits::default())?;
        let (mut encoded, mut groups) = (EncodeStatistics::default(), Vec::new());
        while let Some(record) = reader.next_record()? {
            let Record::Group(group) = record else { continue };
            for frame in &group.frames {
                encoded.add(FrameStatistics::kept(frame)?);
            }
            groups.push((group.frames.len(), fingerprint([&group])));
        }
        encoded.resumed_frames = encoded.frames.len() as u64;
        encoded.stream_bytes = reader.position();
        let scanners = reader.index().scanners().iter().map(|entry| entry.id).collect();
        Ok(Complete { encoded, scanners, groups })
    }
}

/// An error if these are not the files of the stream's frames, as far as their headers tell.
fn compare_inputs(
    headers: &[FrameHeader],
    frames: &[FrameInput],
    config: &EncoderConfig,
    on_frame: &(dyn Fn() + Sync),
) -> Result<()> {
    let compare = |(known, input): (&FrameHeader, &FrameInput)| {
        let (name, stamp) = (input.name()?, input.stamp());
        if known.name != name {
            return Err(differs(format!("holds other frames ({:?}, not {name:?})", known.name)));
        }
        if (known.stamp.kind, known.stamp.time) != (stamp.kind, stamp.time) {
            return Err(differs(format!("holds {name:?} with another time or as another kind of file")));
        }
        if config.is_exact() {
            let now = input.header(&input.read()?)?;
            if (known.file_size, known.file_crc) != (now.file_size, now.file_crc) {
                return Err(differs(format!("holds another {name:?} than there is now")));
            }
        }
        on_frame();
        Ok(())
    };
    run_ordered(config.threads, headers.iter().zip(frames).map(Ok), compare, Ok)
}
