//! PPMd, variant H (7-Zip's PPMd7): prediction by partial matching, and range coding.

use std::io::Write;

use ppmd_rust::{Ppmd7Decoder, Ppmd7Encoder};

use super::{Backend, Level, Packing, read_up_to};
use crate::ground::error::{Error, Result};

/// Levels 1 to 9 are orders 2 to 10. The payload is the order, then the stream.
pub struct Ppmd;

/// The model's memory in bytes for data of this length: more than the contexts of residuals need.
fn memory(length: usize) -> u32 {
    length.saturating_mul(64).clamp(1 << 16, 16 << 20) as u32
}

impl Backend for Ppmd {
    fn id(&self) -> u8 {
        4
    }

    fn name(&self) -> &'static str {
        "ppmd"
    }

    fn packing(&self) -> Packing {
        Packing::Varint
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>> {
        let order = level.number() + 1;
        let failed = |error: ppmd_rust::Error| Error::unsupported(format!("ppmd: {error}"));
        let mut encoder =
            Ppmd7Encoder::new(vec![order], order.into(), memory(input.len())).map_err(failed)?;
        encoder.write_all(input)?;
        Ok(encoder.finish(false)?)
    }

    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>> {
        let (&order, stream) = input.split_first().ok_or_else(|| Error::corrupt("no bytes"))?;
        if length == 0 {
            return Ok(Vec::new());
        }
        let decoder = Ppmd7Decoder::new(stream, order.into(), memory(length));
        let decoder = decoder.map_err(|error| Error::corrupt(error.to_string()))?;
        // Without an end marker the stream never ends.
        read_up_to(decoder, length - 1)
    }
}
