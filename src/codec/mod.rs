//! The codec: frames to a stream, and a stream to frames.
//!
//! [`encoder`] and [`decoder`] work on sequences and know nothing of how a frame is coded; [`group`]
//! codes the frames of one group and knows nothing of sequences. Groups are independent, so they
//! are coded in parallel, and delivered in order.

pub mod config;
pub mod decoder;
pub mod encoder;
pub mod group;

mod frame;
mod ordered;
mod syntax;

pub use config::{DecodeOptions, EncoderConfig, FrameRange, Mode};
pub use decoder::{DecodedFrame, decode, decode_indexed};
pub use encoder::{Encoded, FrameInput, encode};

#[cfg(test)]
mod tests;
