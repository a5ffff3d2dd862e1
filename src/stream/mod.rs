//! Encodes a sequence of scans as a stream of groups, and decodes it.
//!
//! Groups are independent, so they are coded in parallel; they are delivered in order.

pub mod decoder;
pub mod encoder;
pub mod input;
pub mod options;

pub(crate) mod ordered;
pub(crate) mod scanner_choice;
pub(crate) mod source;
pub(crate) mod statistics;

pub use decoder::{DecodedFrame, decode, decode_indexed};
pub use encoder::{encode, encode_known, encode_live};
pub use input::FrameInput;
pub use options::{DecodeOptions, FrameRange};
pub use scanner_choice::DriveScanners;
pub use statistics::EncodeStatistics;

#[cfg(all(test, feature = "cli"))]
mod tests;
