//! lidarpc compresses sequences of spinning-LiDAR scans.
//!
//! The data's way, in which the modules are listed:
//!
//! ```text
//! files -> Scan -> scanner -> range image -> models -> frame -> stream -> .lpc
//!  files    scan    scanner                  over       frame    stream
//!                                            entropy
//! ```

pub mod ground;

pub mod scan;

pub mod files;

pub mod scanner;

pub mod entropy;

pub mod backend;
pub mod models;

pub mod inter;

pub mod article;

pub mod frame;

pub mod stream;

pub mod edit;

pub mod study;

mod library;

#[doc(hidden)]
pub mod cli;

pub use ground::error::{Error, Limits, Result};
pub use library::{
    ChannelInfo, Decoder, Encoder, FrameDetails, FrameInfo, Scalar, Scan, Scans, Settings, Summary,
};
pub use scan::Scalar as ScalarType;
pub use stream::container::{SectionKind, Unit};
