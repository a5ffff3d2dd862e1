//! The `context` back-end: each part of a frame through adaptive binary arithmetic coding, each
//! part one function that serves both directions.
//!
//! The models live as long as a group of pictures: what one frame teaches helps the next.

mod bytes;
mod columns;
mod correction;
mod depth;
mod intensity;
mod least_squares;
mod occupancy;
mod order;
mod points;
mod quantise;
mod range;
mod shape;

pub use bytes::ByteModel;
pub use columns::ColumnModel;
pub use correction::CorrectionModel;
pub use depth::Depth;
pub use intensity::{IntensityModel, IntensityNeighbours, IntensityReference, IntensityScale};
pub(crate) use least_squares::LeastSquares;
pub use occupancy::OccupancyModel;
pub use order::{OrderExceptions, OrderModel};
pub use points::{PointModel, neighbours_above};
pub(crate) use range::Bins;
pub use range::{RangeContext, RangeModel};
