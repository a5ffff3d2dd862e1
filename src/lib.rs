//! lidarpc compresses sequences of spinning-LiDAR scans.
//!
//! The data's way, in which the modules are listed below the ground that they stand on:
//!
//! ```text
//! files -> ScanFile -> SensorModel -> RangeImage -> sections -> groups, index -> .lpc
//!  io       scan        sensor         range_image   context     bitstream
//!                                                    over entropy
//! ```
//!
//! [`codec::encode`] and [`codec::decode`] go it from end to end.

pub mod error;
pub mod grid;
mod random;
mod rounding;
pub mod scan;
pub mod varint;

pub mod entropy;
pub mod sensor;

pub mod compensation;
pub mod range_image;

pub mod outlier;
pub mod prediction;
pub mod registration;
pub mod segmentation;

pub mod context;
pub mod contour;
mod quick;

pub mod backend;
pub mod image_coding;
pub mod residual;

pub mod bitstream;
pub mod codec;
pub mod io;
pub mod synth;

pub mod bench;
pub mod metrics;
pub mod picture;
