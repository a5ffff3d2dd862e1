//! Pictures of a frame: range image, occupancy, labels, prediction, residual, error, and the points from
//! above or in perspective. Pure functions of plain data, for viewing only.

mod bird;
mod cells;
mod colour;
mod painting;
mod perspective;

pub use bird::BirdsEye;
pub use cells::{LabelStyle, Zoom, error, labels, occupancy, range, residual};
pub use colour::{Rgb, Scale};
pub use painting::{Picture, stack};
pub use perspective::Perspective;
