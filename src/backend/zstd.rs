//! Zstandard: LZ77, tabled asymmetric numeral systems and Huffman codes.

use super::{Backend, Level, Packing};
use crate::ground::error::Result;

/// Levels 1 to 9 are Zstandard's 1, 3, 6, 9, 12, 15, 17, 19 and 22.
pub struct Zstd;

const LEVELS: [i32; 9] = [1, 3, 6, 9, 12, 15, 17, 19, 22];

/// Compresses like `zstd -3`; [`Zstd`] decompresses the result.
///
/// # Errors
/// If the library fails.
pub fn compress_quickly(input: &[u8]) -> Result<Vec<u8>> {
    library::compress(input, 3)
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

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        library::compress(input, level.of(LEVELS))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        library::decompress(input, length)
    }
}

/// Zstandard's own library.
#[cfg(not(target_family = "wasm"))]
mod library {
    use crate::ground::error::{Error, Result};

    pub fn compress(input: &[u8], level: i32) -> Result<Vec<u8>> {
        Ok(zstd::bulk::compress(input, level)?)
    }

    pub fn decompress(input: &[u8], length: usize) -> Result<Vec<u8>> {
        zstd::bulk::decompress(input, length).map_err(|error| Error::corrupt(error.to_string()))
    }
}

/// A decoder in Rust: Zstandard's own library is in C and needs a C standard library, which WebAssembly
/// lacks.
#[cfg(target_family = "wasm")]
mod library {
    use super::super::{decodes_only, read_up_to};
    use crate::ground::error::{Error, Result};

    pub fn compress(_: &[u8], _: i32) -> Result<Vec<u8>> {
        Err(decodes_only())
    }

    pub fn decompress(input: &[u8], length: usize) -> Result<Vec<u8>> {
        let reader = ruzstd::decoding::StreamingDecoder::new(input);
        read_up_to(reader.map_err(|error| Error::corrupt(error.to_string()))?, length)
    }
}
