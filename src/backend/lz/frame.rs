//! The frame around blocks of LZ5 1.x and Lizard 1.x: magic number, descriptor, blocks with their
//! lengths, end mark, checksum ("LZ5 Frame Format Description", "Lizard Frame Format Description").

use super::xxh32::xxh32;
use super::{copy_literals, take, take_number};
use crate::ground::error::{Error, Result};

/// The differences between the formats.
pub struct FrameFormat {
    /// The first four bytes, little-endian.
    pub magic: u32,
    /// The largest block, in bytes, of each code from 1 on.
    pub block_sizes: [usize; 7],
}

/// Flags of the descriptor.
const VERSION: u8 = 0b0100_0000;
const VERSION_MASK: u8 = 0b1100_0000;
const INDEPENDENT: u8 = 0b0010_0000;
const BLOCK_CHECKSUMS: u8 = 0b0001_0000;
const CONTENT_SIZE: u8 = 0b0000_1000;
const CONTENT_CHECKSUM: u8 = 0b0000_0100;
const RESERVED: u8 = 0b0000_0011;
/// The bit of a block's length that marks it as not compressed.
const STORED: usize = 1 << 31;
/// The code of the block size used for writing: 1 MB.
const LARGEST_WRITTEN: usize = 3;

/// Decodes a frame to at most `most` bytes. `decode_block` appends the contents of a block to the bytes
/// decoded so far, up to the total that it is given.
///
/// # Errors
/// If the frame is damaged, or anything follows it.
pub fn decode(
    mut input: &[u8],
    format: &FrameFormat,
    most: usize,
    mut decode_block: impl FnMut(&[u8], &mut Vec<u8>, usize) -> Result<()>,
) -> Result<Vec<u8>> {
    let input = &mut input;
    if take_number(input, 4)? != format.magic as usize {
        return Err(Error::corrupt("no frame of this format"));
    }
    let (flags, largest) = read_descriptor(input, format)?;
    let mut out = Vec::new();
    loop {
        let length = take_number(input, 4)?;
        if length == 0 {
            break;
        }
        let block = take(input, length & !STORED)?;
        if flags & BLOCK_CHECKSUMS != 0 && take_number(input, 4)? != xxh32(block) as usize {
            return Err(Error::corrupt("a block's checksum does not match"));
        }
        let end = most.min(out.len().saturating_add(largest));
        match length & STORED {
            0 => decode_block(block, &mut out, end)?,
            _ => copy_literals(&mut out, block, end)?,
        }
    }
    if flags & CONTENT_CHECKSUM != 0 && take_number(input, 4)? != xxh32(&out) as usize {
        return Err(Error::corrupt("the checksum does not match"));
    }
    if input.is_empty() { Ok(out) } else { Err(Error::corrupt("bytes after the end")) }
}

/// The flags, and the size of the largest block.
fn read_descriptor(input: &mut &[u8], format: &FrameFormat) -> Result<(u8, usize)> {
    let descriptor = *input;
    let fields = take(input, 2)?;
    let (flags, block_size) = (fields[0], fields[1]);
    if flags & VERSION_MASK != VERSION || flags & RESERVED != 0 {
        return Err(Error::unsupported("a frame of another version"));
    }
    let code = usize::from(block_size >> 4 & 7);
    let largest = code.checked_sub(1).map(|code| format.block_sizes[code]);
    let largest = largest.ok_or_else(|| Error::corrupt("no size of blocks"))?;
    if flags & CONTENT_SIZE != 0 {
        take(input, 8)?;
    }
    let length = descriptor.len() - input.len();
    if take(input, 1)?[0] != header_checksum(&descriptor[..length]) {
        return Err(Error::corrupt("the descriptor's checksum does not match"));
    }
    Ok((flags, largest))
}

fn header_checksum(descriptor: &[u8]) -> u8 {
    (xxh32(descriptor) >> 8) as u8
}

/// Writes a frame of independent blocks without checksums. A block that `compress_block` does not make
/// smaller is stored uncompressed.
pub fn encode(input: &[u8], format: &FrameFormat, compress_block: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let code = (1..LARGEST_WRITTEN).find(|code| input.len() <= format.block_sizes[code - 1]);
    let code = code.unwrap_or(LARGEST_WRITTEN);
    let descriptor = [VERSION | INDEPENDENT, (code as u8) << 4];
    let mut out = format.magic.to_le_bytes().to_vec();
    out.extend(descriptor);
    out.push(header_checksum(&descriptor));
    for block in input.chunks(format.block_sizes[code - 1]) {
        let packed = compress_block(block);
        let (length, bytes) = if packed.len() < block.len() {
            (packed.len(), &packed[..])
        } else {
            (block.len() | STORED, block)
        };
        out.extend((length as u32).to_le_bytes());
        out.extend(bytes);
    }
    out.extend([0; 4]);
    out
}
