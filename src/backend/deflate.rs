//! Deflate: LZ77 and Huffman codes.

use std::io::Write;

use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;

use super::{Backend, Level, read_up_to};
use crate::ground::error::Result;

/// Levels are zlib's own. The payload is a raw deflate stream.
pub struct Deflate;

impl Backend for Deflate {
    fn id(&self) -> u8 {
        9
    }

    fn name(&self) -> &'static str {
        "deflate"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::new(level.number().into()));
        encoder.write_all(input)?;
        Ok(encoder.finish()?)
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        read_up_to(DeflateDecoder::new(input), length)
    }
}
