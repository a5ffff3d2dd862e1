//! lidarpc compresses sequences of spinning-LiDAR scans, losslessly unless configured otherwise.
//!
//! [`Encoder`] writes scans to a stream; [`Decoder`] reads them back by number or in order, [`Scans`] from a pipe. A
//! [`Scan`] has positions and named, typed channels. It comes from memory or from a file, which is restored
//! byte for byte. [`Settings`] define how much accuracy may be lost, if any, and how hard the encoder tries.
//!
//! ```no_run
//! use std::fs::File;
//!
//! use lidarpc::{Decoder, Encoder, Scan, Settings};
//!
//! fn round_trip(drive: &[(i64, Vec<[f32; 4]>)]) -> lidarpc::Result<()> {
//!     let mut encoder = Encoder::new(File::create("drive.lpc")?, Settings::exact())?;
//!     for (time, xyzi) in drive {
//!         encoder.push(Scan::from_xyzi(xyzi).with_time(*time))?;
//!     }
//!     encoder.finish()?;
//!     for scan in Decoder::open(File::open("drive.lpc")?)?.scans(..) {
//!         let scan = scan?;
//!         let (positions, intensities) = (scan.positions(), scan.channel::<f32>("intensity")?);
//!         assert_eq!(positions.len(), intensities.len());
//!     }
//!     Ok(())
//! }
//! ```
//!
//! # Features
//!
//! On by default; a program that only reads and writes streams needs none of them:
//!
//! - `cli`: the program `lidarpc`.
//! - `article`: what only the article's codec needs, `Settings::paper` and its image coders. Without it a
//!   stream of JPEG or JPEG 2000 images is [`Error::NotBuilt`]; all others decode.
//! - `study`: the instruments of the program's `bench`, `view` and `synth`.
//! - `recordings`: MCAP recordings, read and written by the module `recordings`.
//!
//! Not on by default are `python`, the extension module of the Python package, built by maturin; and `wasm`,
//! the WebAssembly module of the npm package, built by `js/build`.

// Unused code is detected in builds with all features: the program uses much that the library alone does not.
#![cfg_attr(not(feature = "cli"), allow(dead_code))]
// Some re-exports are used by tests only.
#![cfg_attr(not(all(feature = "cli", feature = "internals")), allow(unused_imports))]

// The modules in data-flow order:
//
// files -> Scan -> scanner -> range image -> models -> frame -> stream -> .lpc
//  files    scan    scanner                  over       frame    stream
//                                            entropy

mod ground;

mod container;

mod scan;

mod files;

mod entropy;

mod scanner;

mod backend;

mod inter;

mod models;

mod article;

mod frame;

mod stream;

#[cfg(feature = "cli")]
mod edit;

#[cfg(feature = "study")]
mod study;

mod library;

#[cfg(feature = "recordings")]
pub mod recordings;

#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;

#[cfg(feature = "python")]
mod python;

#[cfg(feature = "wasm")]
mod wasm;

pub use container::{FrameKind, SectionKind};
pub use ground::error::{Error, Limits, Location, Result};
pub use library::{
    ChannelInfo, ChannelValues, Decoder, Encoder, FrameDetails, FrameInfo, MessageEncoder, RangeImage,
    Scalar, Scan, Scans, Settings, Summary,
};
pub use scan::ScalarType;

/// The internals, for this crate's own tests, benchmarks and fuzz targets. They may change at any time.
#[cfg(feature = "internals")]
#[doc(hidden)]
#[rustfmt::skip]
pub mod internals {
    pub mod ground { pub use crate::ground::*; }
    pub mod container { pub use crate::container::*; }
    pub mod scan { pub use crate::scan::*; }
    pub mod files { pub use crate::files::*; }
    pub mod entropy { pub use crate::entropy::*; }
    pub mod scanner { pub use crate::scanner::*; }
    pub mod backend { pub use crate::backend::*; }
    pub mod inter { pub use crate::inter::*; }
    pub mod models { pub use crate::models::*; }
    pub mod article { pub use crate::article::*; }
    pub mod frame { pub use crate::frame::*; }
    pub mod stream { pub use crate::stream::*; }
    #[cfg(feature = "cli")]
    pub mod edit { pub use crate::edit::*; }
    #[cfg(feature = "study")]
    pub mod study { pub use crate::study::*; }
}
