//! LZMA: LZ77 with a large window, and adaptive binary range coding.
//!
//! The payload is the byte of LZMA's properties, then the raw stream without an end marker. The size of the
//! window is not stored, because it is that of the data.

use std::io::Write;

use lzma_rust2::{LzmaOptions, LzmaReader, LzmaWriter};

use super::{Backend, Level, read_up_to};
use crate::ground::error::{Error, Result};

/// Levels 1 to 9 are liblzma's presets.
pub struct Lzma;

/// The smallest window that LZMA supports, in bytes.
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

/// Compresses about as well as `xz -9e`, with the literal and position contexts that suit a sample best;
/// [`Lzma`] decompresses the result.
///
/// # Errors
/// If the library fails.
pub fn compress_hardest(input: &[u8]) -> Result<Vec<u8>> {
    /// Number of bytes on which the contexts are compared.
    const SAMPLE: usize = 64 << 10;
    /// LZMA's lc, lp and pb (context bits from the byte before, of a literal's position, of a match's
    /// position): for text, for values of four bytes, and for values or records of eight and of sixteen.
    const CONTEXTS: [(u32, u32, u32); 4] = [(3, 0, 2), (0, 2, 2), (0, 3, 3), (0, 4, 4)];
    /// Where bytes repeat so well that this many take one, the longest matches gain nothing, and a search for
    /// them takes several times as long as elsewhere.
    const REPETITIVE: usize = 100;
    let from = input.len().saturating_sub(SAMPLE) / 2 / 8 * 8;
    let sample = &input[from..input.len().min(from + SAMPLE)];
    let mut best: Option<(usize, LzmaOptions)> = None;
    for (lc, lp, pb) in CONTEXTS {
        let options = LzmaOptions { lc, lp, pb, ..LzmaOptions::with_preset(QUICK) };
        let size = compress_by(sample, options.clone())?.len();
        if best.as_ref().is_none_or(|(least, _)| size < *least) {
            best = Some((size, options));
        }
    }
    let (size, options) = best.unwrap_or_default();
    compress_by(input, if size * REPETITIVE < sample.len() { options } else { hardest(options) })
}

/// liblzma's preset by which the contexts are compared.
const QUICK: u32 = 6;

/// These options, but with nearly the search of `xz -9e`.
fn hardest(options: LzmaOptions) -> LzmaOptions {
    /// Matches of this length are taken without further search. `xz -9e` has 273, which makes scans at most
    /// 1 % shorter, or longer, but takes up to twice as long where much repeats.
    const NICE_LENGTH: u32 = 128;
    const DEPTH: i32 = 512;
    LzmaOptions { nice_len: NICE_LENGTH, depth_limit: DEPTH, ..options }
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
