//! Reports on stderr what is lost of a damaged stream.

use std::path::Path;

use crate::container::Lost;
use crate::ground::error::{Error, one_line};
use crate::stream::FrameRange;
use anyhow::Result;
use serde::Serialize;

use super::console::to_stderr;
use super::errors::NotWhole;
use super::input::name_of;
use super::readable;

/// Largest number of names that are listed for one loss.
const MOST_NAMES: usize = 10;

/// Reports losses as they are found, and counts them.
pub struct Losses {
    /// The name of the input in messages.
    input: String,
    /// The frames that are wanted; others do not count.
    wanted: FrameRange,
    places: u64,
    frames: u64,
    /// Whether an unknown number of further frames was lost.
    maybe_more: bool,
}

/// The machine-readable losses of a damaged input.
#[derive(Clone, Debug, Serialize)]
pub struct LossReport {
    file: String,
    /// Number of damaged places.
    places: u64,
    /// Number of frames lost there; 0 if only data is damaged that exists twice or that no frame needs.
    frames: u64,
    maybe_more: bool,
}

impl Losses {
    pub fn new(input: &Path, wanted: FrameRange) -> Self {
        Losses { input: name_of(input), wanted, places: 0, frames: 0, maybe_more: false }
    }

    /// Reports one loss in a line, with all frames that were lost with it.
    pub fn report_loss(&mut self, lost: &Lost) {
        self.places += 1;
        let (from, to) = (lost.bytes.start, lost.bytes.end);
        let frames = match &lost.frames {
            None => {
                self.maybe_more = true;
                None
            }
            Some(frames) => {
                self.frames += self.wanted.count_of(frames.end) - self.wanted.count_of(frames.start);
                Some(match frames.end - frames.start {
                    0 => "no frame".to_owned(),
                    1 => format!("frame {}", frames.start),
                    _ => format!("frames {} to {}", frames.start, frames.end - 1),
                })
            }
        };
        let has_frames = lost.frames.as_ref().is_some_and(|frames| !frames.is_empty());
        let what = match (frames, from == to) {
            (None, false) => {
                format!("bytes {from} to {to} are lost, and nothing tells how many frames with them")
            }
            (None, true) => format!("at byte {from}, nothing tells how many frames are lost"),
            (Some(frames), false) if has_frames => format!("bytes {from} to {to} are lost, with {frames}"),
            (Some(frames), false) => format!("bytes {from} to {to} are lost, but {frames}"),
            // Nothing is damaged here, but something is missing, or in the wrong place.
            (Some(frames), true) => format!("at byte {from}, {frames} lost"),
        };
        let mut line = format!("{}: {what}", self.input);
        for (n, name) in lost.names.iter().take(MOST_NAMES).enumerate() {
            line.push_str(if n == 0 { " (" } else { ", " });
            line.push_str(&format!("{name:?}"));
        }
        if !lost.names.is_empty() {
            line.push_str(if lost.names.len() > MOST_NAMES { ", ...)" } else { ")" });
        }
        to_stderr(format_args!("lidarpc: {}", one_line(format_args!("{line}: {}", lost.why))));
    }

    /// Reports the loss of a frame that is intact, but cannot be written.
    pub fn report_frame(&mut self, why: &Error) {
        self.places += 1;
        self.frames += 1;
        to_stderr(format_args!("lidarpc: {}: {}", self.input, one_line(why)));
    }

    /// The machine-readable report; `None` if nothing was lost.
    pub fn report(&self) -> Option<LossReport> {
        let &Losses { places, frames, maybe_more, .. } = self;
        (places > 0).then(|| LossReport { file: self.input.clone(), places, frames, maybe_more })
    }

    /// An error if anything was lost.
    ///
    /// # Errors
    /// With the total losses.
    pub fn check(&self, recovered: u64) -> Result<()> {
        if self.places == 0 {
            return Ok(());
        }
        let lost = match (self.frames, self.maybe_more) {
            (0, true) => "an unknown number".to_owned(),
            (frames, true) => format!("{} and perhaps more", readable::count(frames, "frame")),
            (frames, false) => readable::count(frames, "frame"),
        };
        let recovered = readable::count(recovered, "frame");
        Err(NotWhole(format!("{}: damaged; {recovered} saved, {lost} lost", self.input)).into())
    }
}
