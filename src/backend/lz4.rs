//! LZ4: LZ77 without entropy coding.

use super::{Backend, Level};
use crate::ground::error::{Error, Result};

/// There is only one level, as the library has no optimal parser.
pub struct Lz4;

impl Backend for Lz4 {
    fn id(&self) -> u8 {
        5
    }

    fn name(&self) -> &'static str {
        "lz4"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], _level: Level) -> Result<Vec<u8>> {
        Ok(lz4_flex::block::compress(input))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        lz4_flex::block::decompress(input, length).map_err(|error| Error::corrupt(error.to_string()))
    }
}
