//! The codec: frames to a stream, and a stream to frames.
//!
//! [`encoder`] and [`decoder`] work on sequences and know nothing of how a frame is coded; [`group`]
//! codes the frames of one group and knows nothing of sequences. Groups are independent, so they
//! are coded in parallel, and delivered in order. [`mod@cat`] and [`mod@cut`] copy groups from stream to
//! stream, and code anew only what they must.

pub mod cat;
pub mod config;
pub mod cut;
pub mod decoder;
pub mod encoded;
pub mod encoder;
pub mod fidelity;
pub mod group;
pub mod input;
pub mod options;
pub mod parameters;
pub mod recover;
pub mod resume;
pub mod steps;

mod bound;
mod copier;
mod frame;
mod images;
mod modelling;
mod ordered;
mod quick;
mod ranges;
mod recode;
mod sections;
mod sensor_choice;
mod source;
mod syntax;

pub use cat::{Joined, cat};
pub use config::{Coder, EncoderConfig, FrameOrder, Mode, PredictionChoice, ProjectionKind};
pub use copier::Named;
pub use cut::{Cut, cut, cut_indexed};
pub use decoder::{DecodedFrame, decode, decode_indexed};
pub use encoded::Encoded;
pub use encoder::{encode, encode_live};
pub use fidelity::{Intensity, MOST_MAX_ERROR_UM, Positions};
pub use group::DecodedImage;
pub use input::FrameInput;
pub use modelling::Modelling;
pub use options::{DecodeOptions, FrameRange};
pub use parameters::{FrameParameters, Prediction, Source};
pub use recover::{Recovered, recover, repair};
pub use resume::{PartialFiles, encode_resuming};
pub use steps::{Step, StepReport};

#[cfg(test)]
mod tests;
