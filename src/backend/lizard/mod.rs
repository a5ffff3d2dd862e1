//! Lizard 1.x: LZ77 in separate streams of tokens, offsets and literals, each of which may be Huffman-coded
//! ("Lizard v1.x Block Format Description" and "Lizard Frame Format Description" by P. Skibinski and Y.
//! Collet). The payload is a frame that the reference program decodes. Written without Huffman coding (the
//! reference's levels 10 to 29); read with and without it.

mod bits;
mod block;
mod fse;
mod huffman;
mod write;

use super::lz::frame::{self, FrameFormat};
use super::{Backend, Level};
use crate::ground::error::Result;

/// At levels 1 to 9, 1 to 1024 earlier positions are tried for each byte.
pub struct Lizard;

const FORMAT: FrameFormat = FrameFormat {
    magic: 0x184d_2206,
    block_sizes: [128 << 10, 256 << 10, 1 << 20, 4 << 20, 16 << 20, 64 << 20, 256 << 20],
};
const DEPTH: [usize; 9] = [1, 2, 4, 8, 16, 32, 64, 256, 1024];

impl Backend for Lizard {
    fn id(&self) -> u8 {
        8
    }

    fn name(&self) -> &'static str {
        "lizard"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        Ok(frame::encode(input, &FORMAT, |bytes| write::encode(bytes, level.of(DEPTH))))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        frame::decode(input, &FORMAT, length, block::decode)
    }
}
