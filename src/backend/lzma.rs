//! LZMA: LZ77 with a large window, and adaptive binary range coding.
//!
//! The payload is the byte of LZMA's properties, then the raw stream without an end marker. The size of the
//! window is not sent, because it is that of the data.

use std::io::Write;

use lzma_rust2::{LzmaOptions, LzmaReader, LzmaWriter};

use super::{Backend, Level, read_up_to};
use crate::ground::error::{Error, Result};

/// Levels 1 to 9 are liblzma's presets.
pub struct Lzma;

/// The smallest window that LZMA knows, in bytes.
const SMALLEST_WINDOW: u32 = 4096;

impl Backend for Lzma {
    fn id(&self) -> u8 {
        super::LZMA
    }

    fn name(&self) -> &'static str {
        "lzma"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        compress_by(input, LzmaOptions::with_preset(level.number().into()))
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        let (&properties, stream) = input.split_first().ok_or_else(|| Error::corrupt("no bytes"))?;
        let reader = LzmaReader::new_with_props(stream, length as u64, properties, window(length)?, None);
        read_up_to(reader.map_err(|error| Error::corrupt(error.to_string()))?, length)
    }
}

/// Compresses as `xz -9e` does; [`Lzma`] reads the result.
///
/// # Errors
/// If the library fails.
pub fn compress_hardest(input: &[u8]) -> Result<Vec<u8>> {
    /// The longest match that LZMA knows is taken without looking further.
    const NICE_LENGTH: u32 = 273;
    const DEPTH: i32 = 512;
    let mut options = LzmaOptions::with_preset(9);
    options.nice_len = NICE_LENGTH;
    options.depth_limit = DEPTH;
    compress_by(input, options)
}

fn compress_by(input: &[u8], mut options: LzmaOptions) -> Result<Vec<u8>> {
    options.dict_size = window(input.len())?;
    let mut out = vec![options.get_props()];
    let mut writer = LzmaWriter::new_no_header(&mut out, &options, false)?;
    writer.write_all(input)?;
    writer.finish()?;
    Ok(out)
}

/// The window for data of this length.
fn window(length: usize) -> Result<u32> {
    let length = u32::try_from(length).ok().filter(|length| *length <= 1 << 30);
    Ok(length.ok_or_else(|| Error::unsupported("more than 1 GiB at once"))?.max(SMALLEST_WINDOW))
}
