//! The interface for other programs: scans in, scans out.

mod decoder;
mod encoder;
mod scalar;
mod scan;
mod settings;

pub use decoder::{Decoder, FrameDetails, FrameInfo, Scans};
pub use encoder::{Encoder, MessageEncoder, Summary};
pub use scalar::{ChannelValues, Scalar};
pub use scan::{ChannelInfo, RangeImage, Scan};
pub use settings::Settings;

#[cfg(test)]
mod tests;
