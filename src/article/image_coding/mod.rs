//! Lossy image coding of range residuals (article, IV-D.2 and VI-C): JPEG and JPEG 2000, in passes, each of
//! which codes the remaining error of those before. FORMAT.md 8.14.
//!
//! Neither format supports empty cells: the encoder fills them such that they cost little, and the decoder
//! ignores them. The images' headers follow from the settings and are not in the stream, so that the
//! libraries only read the coded samples from it.

#[cfg(feature = "article")]
mod jpeg;
#[cfg(feature = "article")]
mod jpeg2000;
#[cfg(feature = "article")]
mod plane;
#[cfg(feature = "article")]
mod recurrent;

#[cfg(feature = "article")]
pub use recurrent::{decode, encode};
#[cfg(not(feature = "article"))]
pub use without::{decode, encode};

use crate::ground::error::{Error, Result};

/// The image formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageCodec {
    /// JPEG (ITU-T T.81): 8 bits a sample, always with loss.
    Jpeg,
    /// JPEG 2000 (ITU-T T.800) with the reversible wavelet: lossless, if enough bits may be used.
    Jpeg2000,
}

impl ImageCodec {
    /// All formats.
    pub const ALL: [ImageCodec; 2] = [ImageCodec::Jpeg, ImageCodec::Jpeg2000];

    /// Its name on the command line and in reports: lower case.
    pub fn name(self) -> &'static str {
        match self {
            ImageCodec::Jpeg => "jpeg",
            ImageCodec::Jpeg2000 => "jpeg2000",
        }
    }

    /// The format with this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|codec| codec.name() == name)
    }
}

/// The limit of the coded size of a frame's ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Lossless, without a limit.
    Lossless,
    /// This many bits for each return, on average.
    Bits(f64),
}

impl Rate {
    /// The bound in bytes; `None` if there is none.
    pub fn bytes(self, returns: usize) -> Option<usize> {
        match self {
            Rate::Lossless => None,
            Rate::Bits(bits) => Some((bits * returns as f64 / 8.0) as usize),
        }
    }
}

/// The largest number of bits per return that [`Rate::Bits`] accepts.
const MOST_BITS: f64 = 64.0;
/// The largest number of passes.
pub const MOST_PASSES: u8 = 8;

/// Settings of the encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageConfig {
    /// The largest number of passes, 1 to 8; fewer are used if that leaves less error. Default 2, as in the
    /// article.
    pub passes: u8,
    /// The rate of all passes together. Default 2 bits a return.
    pub rate: Rate,
}

impl Default for ImageConfig {
    fn default() -> Self {
        ImageConfig { passes: 2, rate: Rate::Bits(2.0) }
    }
}

impl ImageConfig {
    /// Checks that all settings are in range.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] names the setting that is not.
    pub fn check(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::InvalidSettings(what));
        if !(1..=MOST_PASSES).contains(&self.passes) {
            return wrong(format!("there are 1 to {MOST_PASSES} passes"));
        }
        match self.rate {
            Rate::Bits(bits) if !(bits > 0.0 && bits <= MOST_BITS) => {
                wrong(format!("a rate is more than 0 and at most {MOST_BITS} bits a return, or lossless"))
            }
            _ => Ok(()),
        }
    }
}

/// Replaces the image coders in builds without them.
#[cfg(not(feature = "article"))]
mod without {
    use super::ImageCodec;
    use crate::ground::error::{Error, Result};
    use crate::ground::grid::Grid;

    /// Always fails.
    ///
    /// # Errors
    /// [`Error::Unsupported`].
    pub fn encode(
        codec: ImageCodec,
        _: Grid<i32>,
        _: &Grid<bool>,
        _: u8,
        _: Option<usize>,
    ) -> Result<Vec<u8>> {
        Err(not_built(codec))
    }

    /// Always fails.
    ///
    /// # Errors
    /// [`Error::Unsupported`].
    pub fn decode(codec: ImageCodec, _: &[u8], _: usize, _: usize) -> Result<Grid<i32>> {
        Err(not_built(codec))
    }

    fn not_built(codec: ImageCodec) -> Error {
        Error::not_built(format!("ranges coded by {}", codec.name()), "article")
    }
}

#[cfg(all(test, feature = "article"))]
mod tests;
