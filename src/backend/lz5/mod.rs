//! LZ5 1.5: LZ77 without entropy coding, with short codes for near matches ("LZ5 v1.x Block Format
//! Description" and "LZ5 Frame Format Description" by P. Skibinski and Y. Collet). The payload is a frame
//! that the reference program decodes.

mod block;

use super::lz::frame::{self, FrameFormat};
use super::{Backend, Level};
use crate::ground::error::Result;

/// At levels 1 to 9, 1 to 1024 earlier positions are tried for each byte.
pub struct Lz5;

const FORMAT: FrameFormat = FrameFormat {
    magic: 0x184d_2205,
    block_sizes: [64 << 10, 256 << 10, 1 << 20, 4 << 20, 16 << 20, 64 << 20, 256 << 20],
};
const DEPTH: [usize; 9] = [1, 2, 4, 8, 16, 32, 64, 256, 1024];

impl Backend for Lz5 {
    fn id(&self) -> u8 {
        7
    }

    fn name(&self) -> &'static str {
        "lz5"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        Ok(frame::encode(input, &FORMAT, |bytes| block::encode(bytes, level.of(DEPTH))))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        frame::decode(input, &FORMAT, length, block::decode)
    }
}
