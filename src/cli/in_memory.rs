//! Scans given to a command that works on streams: they are coded in memory.

use crate::stream;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::container::MAGIC;
use crate::frame::StepReport;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::Result;
use crate::stream::FrameInput;

use super::input::is_dash;
use super::progress;

/// Whether an input is a stream: begins as one does, or is stdin.
pub fn is_stream(path: &Path) -> bool {
    let mut magic = [0; MAGIC.len()];
    is_dash(path)
        || File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == MAGIC
}

/// Codes scans. Gives what each step took, and the stream.
pub fn encode(frames: &[FrameInput], config: &EncoderConfig, quiet: bool) -> Result<(StepReport, Vec<u8>)> {
    let bar = progress::bar(Some(frames.len() as u64), "encoding", quiet);
    let mut stream = Vec::new();
    let encoded = stream::encode(frames, config, &mut stream, &|| bar.inc(1));
    bar.finish_and_clear();
    Ok((encoded?.steps, stream))
}
