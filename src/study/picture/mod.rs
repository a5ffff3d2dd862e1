//! Pictures of a frame: range image, occupancy, labels, prediction, residual, error, and the points from
//! above or in perspective. Pure functions of plain data, for viewing only.

mod bird;
mod cells;
mod colour;
mod font;
mod legend;
mod painting;
mod perspective;
mod scale;

pub use bird::BirdsEye;
pub use cells::{LabelStyle, Zoom, error, labels, occupancy, range, residual};
pub use colour::Rgb;
pub use painting::{Picture, stack};
pub use perspective::Perspective;
pub use scale::Scale;
