//! Encodes scans in memory for commands that work on streams.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::container::MAGIC;
use crate::frame::StepReport;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Result;
use crate::stream::{self, FrameInput};

use super::input::is_dash;
use super::progress;

/// Whether an input is a stream: it begins like one, or is stdin.
pub fn is_stream(path: &Path) -> bool {
    let mut magic = [0; MAGIC.len()];
    is_dash(path)
        || File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == MAGIC
}

/// Encodes scans. Returns the time and size of each step, and the stream.
pub fn encode(frames: &[FrameInput], config: &EncoderConfig, quiet: bool) -> Result<(StepReport, Vec<u8>)> {
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let mut stream = Vec::new();
    let encoded = stream::encode(frames, config, &mut stream, &|| bar.inc(1));
    bar.finish_and_clear();
    Ok((encoded?.steps, stream))
}
