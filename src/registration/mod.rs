//! The motion of the scanner from one frame to the next (article, V-A and V-B).

mod pose;
mod projective;
mod surface;

pub use pose::{Pose, QuantisedPose, RigidMotion};
pub use projective::{Registration, RegistrationConfig, columns_by_tick, register};
pub use surface::{Surface, Surfel, dot};
