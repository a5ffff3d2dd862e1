//! What the scanner is: the formula that turns integers (beam, tick, range steps) into the
//! coordinates of a file, and the fit of its constants to the sequence at hand.

mod beams;
mod columns;
mod coordinates;
mod fit;
mod formula;
mod ideal;
mod lanes;
mod model;
mod near;
mod sharpen;
mod sine;
mod single_precision;

pub(crate) use beams::{Point as BeamPoint, split_beams, thinned};
pub use coordinates::{Coordinates, nearest_millimetre};
pub use fit::{RANGE_STEP_UM, fit};
pub use ideal::ideal;
pub(crate) use lanes::lanes;
pub use model::{
    BeamConstants, FLOAT_RANGES, MOST_RANGE_STEP_UM, MOST_STEPS, MOST_TICKS, SensorModel, Sighting,
};
pub use sine::sine_and_cosine;
pub use single_precision::Refinement;
