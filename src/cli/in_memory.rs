//! Encodes scans in memory for commands that work on streams.

use std::path::Path;

use crate::container::MAGIC;
use crate::frame::StageReport;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Result;
use crate::stream::{self, FrameInput};

use super::input::{first_bytes, is_dash, is_pipe};
use super::progress;

/// Whether an input is a stream: it begins like one, or is stdin or a pipe.
pub fn is_stream(path: &Path) -> bool {
    is_dash(path) || is_pipe(path) || first_bytes(path) == Some(MAGIC)
}

/// Encodes scans. Returns the time and size of each stage, and the stream.
pub fn encode(frames: &[FrameInput], config: &EncoderConfig, quiet: bool) -> Result<(StageReport, Vec<u8>)> {
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let mut stream = Vec::new();
    let encoded = stream::encode(frames, config, &mut stream, &|| bar.inc(1));
    bar.finish_and_clear();
    Ok((encoded?.stages, stream))
}
