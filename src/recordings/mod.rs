//! Recordings of ROS: files of messages, some of which are clouds.
//!
//! [`pack`] copies a recording and writes each cloud as a compressed message, which stands by itself: its payload is a
//! stream of one frame that decodes to the message, byte for byte. [`unpack`] undoes it. [`Clouds`] gives the clouds alone,
//! as scans. A recording is read front to back; a few messages are in memory at a time.

mod mcap;
mod message;

pub use mcap::{Clouds, Contents, Copied, Topic, TopicFilter, examine, pack, same_messages, unpack};
