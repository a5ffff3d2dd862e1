//! The interface for other programs: scans in, scans out.

mod decoder;
mod encoder;
mod range_image;
mod scalar;
mod scan;
mod settings;

pub use decoder::{Decoder, FrameDetails, FrameInfo, Scans};
pub use encoder::{Encoder, MessageEncoder, Summary};
pub use range_image::RangeImage;
pub use scalar::{ChannelValues, Scalar};
pub use scan::{ChannelInfo, Scan};
pub use settings::Settings;

#[cfg(test)]
mod tests;
