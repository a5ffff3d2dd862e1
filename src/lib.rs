//! lidarpc compresses sequences of spinning-LiDAR scans.
//!
//! The data's way:
//!
//! ```text
//! files -> ScanFile -> sensor model -> RangeImage -> sections -> container
//!  io       scan        sensor          range_image   codec       bitstream
//! ```

pub mod error;
pub mod scan;

pub mod entropy;
pub mod sensor;

pub mod bitstream;
pub mod codec;
pub mod io;
pub mod synth;
