//! bzip2: Burrows-Wheeler transform and Huffman codes.

use bzip2::Compression;
use bzip2::read::{BzDecoder, BzEncoder};

use super::{Backend, Level, Packing, read_up_to};
use crate::ground::error::Result;

/// Levels are bzip2's own: blocks of 100 to 900 kB.
pub struct Bzip2;

impl Backend for Bzip2 {
    fn id(&self) -> u8 {
        1
    }

    fn name(&self) -> &'static str {
        "bzip2"
    }

    fn packing(&self) -> Packing {
        Packing::Varint
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        std::io::copy(&mut BzEncoder::new(input, Compression::new(level.number().into())), &mut out)?;
        Ok(out)
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        read_up_to(BzDecoder::new(input), length)
    }
}
