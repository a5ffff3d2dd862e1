//! Residuals of a range image, compressed by a back-end (article, IV-D.2). FORMAT.md 8.13.

use crate::backend::{self, Backend, Level, Packing};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// Packs and compresses residuals. The payload is the number of packed bytes, then the output of the
/// back-end; the number is also returned.
///
/// # Errors
/// If the back-end's library fails.
pub fn compress(
    residuals: &[i32],
    backend: &dyn Backend,
    level: Level,
    packing: Packing,
) -> Result<(Vec<u8>, usize)> {
    let packed = packing.pack(residuals);
    let mut payload = Vec::new();
    write_unsigned(&mut payload, packed.len() as u64);
    payload.extend(backend.compress(&packed, level)?);
    Ok((payload, packed.len()))
}

/// The inverse of [`compress`] for `count` residuals; also returns the number of packed bytes.
///
/// # Errors
/// If the payload does not hold exactly that many.
pub fn decompress(
    mut payload: &[u8],
    backend: &dyn Backend,
    packing: Packing,
    count: usize,
) -> Result<(Vec<i32>, usize)> {
    let length = read_unsigned(&mut payload, "residuals' length")?;
    let most = Packing::most_bytes(count);
    if length > most as u64 {
        return Err(Error::corrupt(format!("{length} bytes for {count} residuals")));
    }
    let packed = backend::decompress(backend, payload, length as usize)?;
    Ok((packing.unpack(&packed, count)?, packed.len()))
}
