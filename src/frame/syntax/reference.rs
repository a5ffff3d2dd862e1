//! The frame before, from which a P frame is predicted. FORMAT.md 4.3.

use std::sync::Arc;

use crate::frame::parameters::Prediction;
use crate::frame::parts::FrameParts;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::registration::QuantisedPose;
use crate::inter::{MOST_CELLS, Past, Reference};
use crate::scanner::{Family, Scanner};

/// The last frame of the group with a range image.
#[derive(Clone, Default)]
pub struct PastFrame(Option<Arc<Past>>);

impl PastFrame {
    /// The frame, if there is one.
    pub fn get(&self) -> Option<&Past> {
        self.0.as_deref()
    }

    /// The reference of this frame, if it is predicted from the frame before.
    ///
    /// # Errors
    /// If there is no frame before, or one that cannot be used for prediction.
    pub fn reference(&self, scanner: Option<&Scanner>, frame: &FrameParts) -> Result<Option<Reference>> {
        let Some(scanner) = scanner.filter(|_| frame.parameters.prediction == Prediction::Inter) else {
            return Ok(None);
        };
        let past =
            self.get().ok_or_else(|| Error::corrupt("there is no frame before to predict this one from"))?;
        let cells = frame.occupancy.cells().len();
        if cells > MOST_CELLS {
            return Err(Error::corrupt(format!("a P frame of {cells} cells, but at most {MOST_CELLS}")));
        }
        let motion = frame.parameters.motion;
        let scanner = match scanner.family() {
            Family::Hdl64(scanner) => scanner,
            Family::Firings(scanner) => {
                return Ok(Some(past.same_directions(&frame.image.columns, scanner.build().ticks)));
            }
        };
        if frame.parameters.can_do_without_surfaces() && motion == QuantisedPose::default() {
            return Ok(Some(past.same_cells_alone(&frame.image.columns)));
        }
        let motion = motion.pose().motion();
        Ok(Some(past.reference(scanner, &frame.image.columns, &motion)))
    }

    /// Keeps this frame for the prediction of the next one. `levels` are the context levels of its
    /// intensities.
    pub fn remember(&mut self, scanner: Option<&Scanner>, levels: Grid<u16>, frame: &FrameParts) {
        let can_be_past = scanner.is_some()
            && frame.image.steps.cells().len() <= MOST_CELLS
            && frame.parameters.modelling().has_p_frames();
        if can_be_past {
            self.0 = Some(Arc::new(Past::new(frame.image.clone(), levels)));
        }
    }
}
