//! The models of the parts of a frame, for adaptive binary arithmetic coding, tokens or packed bits; each is
//! one function for both directions.
//!
//! The models persist for a group of pictures, so that each frame benefits from those before.

mod blanks;
mod bytes;
pub(crate) mod channels;
mod correction;
mod intensity;
mod least_squares;
mod numbers;
mod occupancy;
mod order;
mod packed;
mod points;
mod quantise;
mod range;
mod shape;

pub use blanks::BlankModel;
pub use bytes::ByteModel;
pub use channels::{ChannelsModel, RecordContext};
pub use correction::{CORRECTION_CONTEXTS, CorrectionModel, correct_positions};
pub use intensity::{
    INTENSITY_CONTEXTS, IntensityModel, IntensityNeighbours, IntensityReference, IntensityScale,
    IntensityTokens,
};
pub(crate) use least_squares::LeastSquares;
pub use occupancy::{OCCUPANCY_CONTEXTS, OccupancyModel, code_occupancy};
pub use order::{OrderExceptions, OrderModel};
pub use packed::{
    PACKED_INTENSITY_CONTEXTS, PACKED_RANGE_CONTEXTS, code_packed_intensities, code_packed_ranges,
};
pub use points::{Analysis, PointModel, PointTrail, TrailSizes};
pub use range::{
    KnownCells, RANGE_CONTEXTS, RangeContext, RangeModel, RangeScale, RangeTokens, start_tables,
};

#[cfg(test)]
mod tests;
