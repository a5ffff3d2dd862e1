//! Encodes scans that are pushed one by one.

use std::io::Write;
use std::mem::take;
use std::sync::Arc;

use super::scan::Scan;
use super::settings::Settings;
use crate::container::{FrameKind, Stamp, TRACKS_MAX};
use crate::frame::settings::EncoderConfig;
use crate::ground::error::{Error, Limits, Result};
use crate::stream::FrameInput;
use crate::stream::encoder::{
    EncodedGroup, MOST_WAITING, MessageCoder, OpenStream, SequenceCoder, may_show_scanner,
};
use crate::stream::ordered::Workers;
use crate::stream::scanner_choice::{DriveScanners, choose_scanners, records_of};

/// Encodes scans as they arrive. The scanner is fitted to the first group of scans; groups are coded on other
/// threads while more scans are pushed, and written as they are done. A few groups are in memory at a time,
/// with all their scans.
///
/// A stream whose encoder is dropped before [`finish`](Self::finish) has no index and no end.
#[derive(Debug)]
#[must_use = "a stream without finish() has no index and no end"]
pub struct Encoder<W> {
    config: Arc<EncoderConfig>,
    /// The scans of the next group.
    open: Vec<FrameInput>,
    state: State<W>,
}

#[derive(Debug)]
enum State<W> {
    /// Until the first group is full, and shows a scanner.
    Waiting(W),
    Coding(Box<Coding<W>>),
    /// After an error, which was reported.
    Failed,
}

/// An encoder with known scanners.
struct Coding<W> {
    scanners: Arc<Vec<DriveScanners>>,
    workers: Workers<Vec<EncodedGroup>>,
    stream: OpenStream<W>,
}

impl<W> std::fmt::Debug for Coding<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Coding").finish_non_exhaustive()
    }
}

/// Statistics of an encoded stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Summary {
    /// Number of scans.
    pub scans: u64,
    /// Number of points in all scans.
    pub points: u64,
    /// Total size in bytes of all scans: of files as they are, of points in memory as records.
    pub scan_bytes: u64,
    /// Size of the stream in bytes.
    pub stream_bytes: u64,
}

impl<W: Write> Encoder<W> {
    /// An encoder that writes a stream to `out`. It writes large pieces, so there is no need to buffer `out`.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] if the settings are out of range or do not fit together.
    pub fn new(out: W, settings: Settings) -> Result<Self> {
        let config = Arc::new(settings.config()?);
        Ok(Encoder { config, open: Vec::new(), state: State::Waiting(out) })
    }

    /// Adds the next scan. The scan that completes the first group also has the scanner fitted, which takes
    /// up to a few seconds; groups of empty scans before it wait for it. Later, the scan that completes a group
    /// waits for a free thread; with one thread, it has the group encoded.
    ///
    /// # Errors
    /// If this scan exceeds the limits that every decoder has, or has a name that not every system can restore:
    /// it is refused, and the encoder takes further scans. If the output fails, or an earlier scan cannot be
    /// encoded, the stream cannot be finished.
    pub fn push(&mut self, scan: Scan) -> Result<()> {
        let points = scan.len() as u64;
        let (scan, stamp) = scan.into_parts();
        let input = FrameInput::scan(scan).stamped(stamp);
        check(&input, points).map_err(|error| match error {
            Error::At { .. } | Error::Input { .. } => error,
            other => other.at(input.path()),
        })?;
        self.open.push(input);
        if self.open.len() < self.config.gop || self.is_waiting() { Ok(()) } else { self.close_group() }
    }

    /// Codes and writes the remaining scans, and the index.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn finish(mut self) -> Result<Summary> {
        // Even without scans a valid stream is written.
        if !self.open.is_empty() || matches!(self.state, State::Waiting(_)) {
            self.close_group()?;
        }
        let State::Coding(mut coding) = self.state else { return Err(failed()) };
        while let Some(groups) = coding.workers.wait() {
            coding.stream.write(&groups?)?;
        }
        let encoded = coding.stream.finish()?;
        Ok(Summary {
            scans: encoded.frames.len() as u64,
            points: encoded.points,
            scan_bytes: encoded.file_bytes(),
            stream_bytes: encoded.stream_bytes,
        })
    }

    /// Whether the first groups wait for one to which a scanner can be fitted.
    fn is_waiting(&self) -> bool {
        let may_wait = self.open.len() < MOST_WAITING * self.config.gop;
        may_wait && matches!(self.state, State::Waiting(_)) && !may_show_scanner(&self.open)
    }

    /// Starts the coding of the open group, and of those that have waited with it.
    fn close_group(&mut self) -> Result<()> {
        let mut scans = take(&mut self.open);
        let state = std::mem::replace(&mut self.state, State::Failed);
        let mut coding = match state {
            State::Waiting(out) => Box::new(Coding::begin(out, &scans, &self.config)?),
            State::Coding(coding) => coding,
            State::Failed => return Err(failed()),
        };
        while !scans.is_empty() {
            let later = scans.split_off(scans.len().min(self.config.gop));
            coding.code(std::mem::replace(&mut scans, later), &self.config)?;
        }
        self.state = State::Coding(coding);
        Ok(())
    }
}

/// Encodes scans one by one, each to a stream of its own: for messages, which must be decodable individually.
/// The scanner is fitted to the first scans, and kept once it explains the next one, so that later scans only
/// take the time to code them.
///
/// All scans are assumed to be from one scanner; those from others are restored too, but are larger when
/// coded. A clone continues with the fitted scanner, for example on another thread.
#[derive(Clone)]
pub struct MessageEncoder(MessageCoder);

impl MessageEncoder {
    /// An encoder with these settings.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] if they are out of range or do not fit together.
    pub fn new(settings: Settings) -> Result<Self> {
        Ok(MessageEncoder(MessageCoder::new(settings.config()?)?))
    }

    /// A stream with this scan alone, which a [`Decoder`](crate::Decoder) reads.
    ///
    /// # Errors
    /// As [`Encoder::push`].
    pub fn encode(&mut self, scan: Scan) -> Result<Vec<u8>> {
        let (scan, stamp) = scan.into_parts();
        // Tracks are only needed to distinguish several scanners.
        self.0.encode(FrameInput::scan(scan).stamped(Stamp { track: 0, ..stamp }))
    }
}

impl std::fmt::Debug for MessageEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MessageEncoder").field("config", self.0.config()).finish_non_exhaustive()
    }
}

/// Refuses what could not be coded later, together with its group.
fn check(input: &FrameInput, points: u64) -> Result<()> {
    let limits = Limits::default();
    Error::check_fits("tracks", u64::from(input.stamp().track) + 1, TRACKS_MAX)?;
    if input.stamp().kind == FrameKind::Points {
        Error::check_fits("points", points, limits.points)?;
    }
    Error::check_fits("bytes", input.size()?, limits.file_bytes)?;
    input.name().map(drop)
}

fn failed() -> Error {
    Error::Usage("the encoder has failed before, and its stream is incomplete; start a new one".to_owned())
}

impl<W: Write> Coding<W> {
    /// Fits the scanners, and begins the stream.
    fn begin(out: W, group: &[FrameInput], config: &EncoderConfig) -> Result<Self> {
        let scanners = Arc::new(choose_scanners(group, config)?);
        let stream = OpenStream::begin(out, &records_of(&scanners))?;
        Ok(Coding { scanners, workers: Workers::new(config.threads)?, stream })
    }

    /// Starts the coding of a group, and writes those that are done.
    fn code(&mut self, group: Vec<FrameInput>, config: &Arc<EncoderConfig>) -> Result<()> {
        while self.workers.is_full() {
            if let Some(groups) = self.workers.wait() {
                self.stream.write(&groups?)?;
            }
        }
        if !group.is_empty() {
            let (scanners, config) = (Arc::clone(&self.scanners), Arc::clone(config));
            self.workers.start(move || SequenceCoder::new(&scanners, &config, &|| ()).encode_frames(group));
        }
        while let Some(groups) = self.workers.poll() {
            self.stream.write(&groups?)?;
        }
        Ok(())
    }
}
