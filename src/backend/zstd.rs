//! Zstandard: LZ77, tabled asymmetric numeral systems and Huffman codes.

use super::{Backend, Level};
use crate::article::residual::Packing;
use crate::ground::error::{Error, Result};

/// Levels 1 to 9 are Zstandard's 1, 3, 6, 9, 12, 15, 17, 19 and 22.
pub struct Zstd;

const LEVELS: [i32; 9] = [1, 3, 6, 9, 12, 15, 17, 19, 22];

/// Compresses as `zstd -3` does; [`Zstd`] reads the result.
///
/// # Errors
/// If the library fails.
pub fn compress_quickly(input: &[u8]) -> Result<Vec<u8>> {
    Ok(zstd::bulk::compress(input, 3)?)
}

impl Backend for Zstd {
    fn id(&self) -> u8 {
        super::ZSTD
    }

    fn name(&self) -> &'static str {
        "zstd"
    }

    fn packing(&self) -> Packing {
        Packing::Varint
    }

    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        Ok(zstd::bulk::compress(input, level.of(LEVELS))?)
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        zstd::bulk::decompress(input, length).map_err(|error| Error::corrupt(error.to_string()))
    }
}
