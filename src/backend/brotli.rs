//! Brotli: LZ77, context-modelled Huffman codes and a dictionary of words.

use std::io::Write;

use super::{Backend, Level, read_up_to};
use crate::ground::error::Result;

/// Levels 1 to 9 are Brotli's qualities 1, 3, 4, 5, 7, 9, 9, 10 and 11. The last two take seconds a frame.
pub struct Brotli;

const QUALITY: [u32; 9] = [1, 3, 4, 5, 7, 9, 9, 10, 11];
/// Binary logarithm of the window: 4 MB, more than a frame's residuals.
const WINDOW_BITS: u32 = 22;
/// Bytes that the library moves at a time.
const BUFFER: usize = 1 << 16;

impl Backend for Brotli {
    fn id(&self) -> u8 {
        2
    }

    fn name(&self) -> &'static str {
        "brotli"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut writer = brotli::CompressorWriter::new(&mut out, BUFFER, level.of(QUALITY), WINDOW_BITS);
        writer.write_all(input)?;
        drop(writer);
        Ok(out)
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        read_up_to(brotli::Decompressor::new(input, BUFFER), length)
    }
}
