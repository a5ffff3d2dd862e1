//! Velodyne HDL-64E: a formula with constants for each beam; files row by row.

mod alignment;
mod beams;
mod column_shifts;
mod columns;
mod file_order;
mod fit;
mod formula;
mod heights;
mod model;
mod positions;
mod projection;
mod sharpen;
mod sine;
mod single_precision;
#[cfg(test)]
mod testing;

pub use alignment::Alignment;
pub(crate) use beams::{Point as BeamPoint, split_beams};
pub use columns::Hdl64ColumnModel;
pub use fit::{RANGE_STEP_UM, fit, is_evident};
pub use model::{BeamConstants, Hdl64, Sighting};
pub use positions::positions;
pub use projection::{project, project_nearest};
pub use sine::sine_and_cosine;
pub use single_precision::Refinement;
