//! General-purpose lossless back-ends (article, IV-D.2): bytes to fewer bytes, and back.
//!
//! [`BACKENDS`] is the registry: help texts, reports and tests loop over it.

mod brotli;
mod bzip2;
mod deflate;
mod lizard;
mod lz;
mod lz4;
mod lz5;
mod lzma;
mod packing;
mod ppmd;
mod store;
mod zstd;

use std::io::Read;

use crate::ground::error::{Error, Result};

/// The number of `store`.
pub const STORE: u8 = 0;

/// The number of `lzma`, which paper mode uses.
pub const LZMA: u8 = 3;

/// The number of `zstd`.
pub const ZSTD: u8 = 6;

/// All back-ends, by their numbers.
pub static BACKENDS: &[&dyn Backend] = &[
    &store::Store,
    &bzip2::Bzip2,
    &brotli::Brotli,
    &lzma::Lzma,
    &ppmd::Ppmd,
    &lz4::Lz4,
    &zstd::Zstd,
    &lz5::Lz5,
    &lizard::Lizard,
    &deflate::Deflate,
];

/// A lossless compressor of bytes.
pub trait Backend: Sync {
    /// Its number in the stream, which is never reused for another back-end.
    fn id(&self) -> u8;

    /// Its name on the command line and in reports: lower case.
    fn name(&self) -> &'static str;

    /// The packing of residuals that suits it best, according to measurements on real ones.
    fn packing(&self) -> Packing {
        Packing::Escape
    }

    /// Compresses `input`.
    ///
    /// # Errors
    /// If the library fails.
    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], level: Level) -> Result<Vec<u8>>;

    /// Always fails: the compressors are left out of the WebAssembly module, which is downloaded; they would
    /// take a third of its size.
    ///
    /// # Errors
    /// [`Error::Internal`].
    #[cfg(target_family = "wasm")]
    fn compress(&self, _: &[u8], _: Level) -> Result<Vec<u8>> {
        Err(decodes_only())
    }

    /// Decompresses to `length` bytes, or to another number if `input` is damaged: use [`decompress`].
    ///
    /// # Errors
    /// If `input` is damaged in a way that the library detects.
    fn decompress_unchecked(&self, input: &[u8], length: usize) -> Result<Vec<u8>>;
}

/// The back-end with this number.
///
/// # Errors
/// If this program knows no such back-end.
pub fn by_id(id: u8) -> Result<&'static dyn Backend> {
    let found = BACKENDS.iter().find(|backend| backend.id() == id);
    found.copied().ok_or_else(|| Error::unsupported(format!("unknown back-end {id}")))
}

/// The back-end with this name.
pub fn by_name(name: &str) -> Option<&'static dyn Backend> {
    BACKENDS.iter().find(|backend| backend.name() == name).copied()
}

/// Decompresses to exactly `length` bytes. Memory stays within a small multiple of `length`, whatever `input`
/// contains.
///
/// # Errors
/// If `input` does not hold exactly that many: some libraries silently return wrong data.
pub fn decompress(backend: &dyn Backend, input: &[u8], length: usize) -> Result<Vec<u8>> {
    let bytes = backend.decompress_unchecked(input, length).map_err(|e| e.within(backend.name()))?;
    if bytes.len() != length {
        return Err(Error::corrupt(format!("{}: {} bytes, not {length}", backend.name(), bytes.len())));
    }
    Ok(bytes)
}

pub use lzma::compress_hardest;
pub use packing::Packing;
pub use zstd::compress_quickly;

/// Which general-purpose compressors an encoder tries where models may do worse.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compressors {
    /// zstd.
    Fast,
    /// LZMA as well, which takes long, on the arrangement of bytes that suits zstd best.
    #[default]
    Slow,
    /// LZMA on every arrangement of bytes.
    All,
}

/// The shorter of what zstd and LZMA make of bytes, with the number of the back-end. LZMA is tried only if
/// `is_worth` says so, given the size that zstd achieves.
///
/// # Errors
/// If a library fails.
pub fn shortest(
    bytes: &[u8],
    compressors: Compressors,
    is_worth: impl FnOnce(usize) -> bool,
) -> Result<(u8, Vec<u8>)> {
    let quick = compress_quickly(bytes)?;
    if compressors != Compressors::Fast && is_worth(quick.len()) {
        let hardest = compress_hardest(bytes)?;
        if hardest.len() < quick.len() {
            return Ok((LZMA, hardest));
        }
    }
    Ok((ZSTD, quick))
}

/// Whether LZMA may take fewer than `most` bytes for what zstd makes `quick` bytes of. As LZMA takes long,
/// this is judged by what it gains on a sample, if there is one.
pub fn may_lzma_pay(quick: usize, most: usize, sample: impl FnOnce() -> Option<Vec<u8>>) -> bool {
    /// The smallest fraction of zstd's size that LZMA achieves, except if repetitions lie far apart.
    const LEAST: f64 = 0.5;
    /// LZMA gains up to this factor more on everything than on the sample.
    const UNSURE: f64 = 1.2;
    let could_pay = |fraction: f64| quick as f64 * fraction < most as f64;
    if !could_pay(LEAST) {
        return false;
    }
    let Some(sample) = sample() else { return true };
    match (compress_quickly(&sample), compress_hardest(&sample)) {
        (Ok(quick), Ok(hardest)) => could_pay(hardest.len() as f64 / quick.len().max(1) as f64 / UNSURE),
        _ => false,
    }
}

/// Whether a general-purpose coder took fewer bytes than the models in the last frame that tried both. In a
/// similar frame, the encoder skips the one that was clearly longer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Verdict {
    /// Nothing, or that both take about the same number of bytes.
    #[default]
    Open,
    /// That the models take fewer bytes, in a frame of this [likeness](Verdict::likeness).
    Lost(f64),
    /// That the coder takes fewer bytes, in a frame of this likeness.
    Won(f64),
}

impl Verdict {
    /// A number that is about the same for frames that are alike: the bytes a record that zstd makes of them,
    /// judged by a part from the middle.
    pub fn likeness(bytes: &[u8], records: usize) -> f64 {
        const SAMPLE: usize = 64 << 10;
        let sample = &bytes[bytes.len().saturating_sub(SAMPLE) / 2..][..bytes.len().min(SAMPLE)];
        let of_sample = records as f64 * sample.len() as f64 / bytes.len() as f64;
        compress_quickly(sample).map_or(f64::NAN, |quick| quick.len() as f64 / of_sample)
    }

    /// The verdict, given the bytes that the coder and the models take.
    pub fn of(coder: usize, models: usize, likeness: f64) -> Self {
        /// One part in this number is a clear difference.
        const CLEAR: usize = 64;
        if coder > models.saturating_add(models / CLEAR) {
            Verdict::Lost(likeness)
        } else if models > coder.saturating_add(coder / CLEAR) {
            Verdict::Won(likeness)
        } else {
            Verdict::Open
        }
    }

    /// Whether the coder lost in a frame like this one.
    pub fn has_lost(self, likeness: impl FnOnce() -> f64) -> bool {
        matches!(self, Verdict::Lost(before) if is_alike(before, likeness()))
    }

    /// Whether the coder won in a frame like this one.
    pub fn has_won(self, likeness: impl FnOnce() -> f64) -> bool {
        matches!(self, Verdict::Won(before) if is_alike(before, likeness()))
    }
}

fn is_alike(before: f64, likeness: f64) -> bool {
    /// Frames of one scanner differ by less than one part in this number.
    const ALIKE: f64 = 8.0;
    (likeness - before).abs() <= before / ALIKE
}

/// Effort: 1 is fastest, 9 gives the smallest result. Each coder maps it to a scale of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level(u8);

impl Level {
    /// `None` if it is not from 1 to 9.
    pub fn new(level: u8) -> Option<Self> {
        (1..=9).contains(&level).then_some(Level(level))
    }

    /// All levels in ascending order.
    #[cfg(test)]
    pub fn all() -> impl Iterator<Item = Level> {
        (1..=9).map(Level)
    }

    /// The number, 1 to 9.
    pub fn number(self) -> u8 {
        self.0
    }

    /// The entry in a back-end's own scale.
    fn of<T: Copy>(self, scale: [T; 9]) -> T {
        scale[usize::from(self.0) - 1]
    }
}

impl Default for Level {
    /// Level 6.
    fn default() -> Self {
        Level(6)
    }
}

/// The error of functions that the WebAssembly module lacks.
#[cfg(target_family = "wasm")]
fn decodes_only() -> Error {
    Error::Internal("lidarpc as WebAssembly only decodes".to_owned())
}

/// Reads up to one byte more than `length`, so that excess bytes are detected but not kept.
fn read_up_to(reader: impl Read, length: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = reader.take(length as u64 + 1).read_to_end(&mut bytes);
    read.map_err(|error| Error::corrupt(error.to_string()))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests;
