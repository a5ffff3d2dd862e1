//! Scans given to a command that works on streams: they are coded in memory.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use lidarpc::bitstream::MAGIC;
use lidarpc::codec::{self, EncoderConfig, FrameInput, StepReport};
use lidarpc::error::Result;

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
    let encoded = codec::encode(frames, config, &mut stream, &|| bar.inc(1));
    bar.finish_and_clear();
    Ok((encoded?.steps, stream))
}
