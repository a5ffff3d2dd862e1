//! The coding of a frame and of a group of frames: syntax, parameters, and fidelity.

pub mod decoder;
pub mod encoder;
pub mod fidelity;
pub mod parameters;
pub mod settings;
pub mod stages;

pub(crate) mod bound;
pub(crate) mod levels;
pub(crate) mod modelling;
pub(crate) mod parts;
pub(crate) mod sections;
pub(crate) mod syntax;
mod whole;

pub use decoder::DecodedImage;
pub use fidelity::{IntensityFidelity, MOST_INTENSITY_STEP_MILLIONTHS, MOST_MAX_ERROR_UM, PositionFidelity};
pub use modelling::Modelling;
pub use parameters::{FrameParameters, OriginalFile, Prediction};
pub use settings::{Coder, EncoderConfig, FrameOrder, Mode, PredictionChoice, ProjectionKind};
pub use stages::{Stage, StageReport};
