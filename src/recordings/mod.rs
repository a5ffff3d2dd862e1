//! ROS recordings: files of messages, some of which are clouds.
//!
//! [`pack()`] copies a recording and writes each cloud as a compressed message that is independent of all
//! others: its payload is a stream of one frame that decodes to the message, byte for byte. [`unpack`] is the
//! inverse. [`Clouds`] reads only the clouds, as scans. A recording is read front to back, with only a few
//! messages in memory at a time.

mod contents;
mod message;
mod pack;
mod records;

pub use contents::{Clouds, Contents, Topic, TopicFilter, examine, same_messages};
pub use pack::{CopySummary, pack, unpack};

/// For this crate's own tests and fuzz targets.
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod internals {
    pub use super::message::{Encoding, compress, payload, points, scan};
    pub use super::pack::unpacked;
}
