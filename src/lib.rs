//! lidarpc compresses sequences of spinning-LiDAR scans.
//!
//! The data's way:
//!
//! ```text
//! files -> ScanFile -> sensor model -> RangeImage -> sections -> container
//!  io       scan        sensor          range_image   codec       bitstream
//! ```

pub mod error;
pub mod grid;
mod rounding;
pub mod scan;
pub mod varint;

pub mod entropy;
pub mod sensor;

pub mod range_image;

pub mod context;

pub mod bitstream;
pub mod codec;
pub mod io;
pub mod synth;

pub mod metrics;
