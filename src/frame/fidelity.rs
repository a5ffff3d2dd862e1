//! The fidelity of decoded points: how accurately positions and intensities are restored. FORMAT.md 8.10.

use std::fmt;

use super::parameters::PART;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, read_within, write_unsigned};
use crate::scanner::CoordinateGrid;

/// How the positions of decoded points are obtained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PositionFidelity {
    /// The formula's positions, corrected to those of the file, in the order of the file.
    #[default]
    Exact,
    /// The formula's positions as they are, in the order of the range image.
    Formula,
    /// No position differs from that of the file by more than the bound (3-D distance), in the order of the
    /// file: the formula's positions, replaced by those of the file where they are farther away.
    Bounded {
        /// The bound, in micrometres; not 0.
        max_error_um: u32,
        /// Whether the formula's positions are rounded to the grid of the file, which is best if ranges are
        /// exact.
        on_grid: bool,
    },
}

/// How intensities are restored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IntensityFidelity {
    /// Exactly.
    #[default]
    Exact,
    /// Not at all: they are left out, and decode to 0.
    None,
    /// Rounded to integer multiples of a step.
    Rounded {
        /// The step, in millionths of the file's unit: 1 to [`MOST_INTENSITY_STEP_MILLIONTHS`].
        step_millionths: u32,
    },
}

/// The largest bound, in micrometres: 10 m.
pub const MOST_MAX_ERROR_UM: u32 = 10_000_000;
/// The largest step of intensities, in millionths of the file's unit: 1000.
pub const MOST_INTENSITY_STEP_MILLIONTHS: u32 = 1_000_000_000;

impl PositionFidelity {
    /// The grid for points outside the range image, or `None` if it is that of the file. No point is farther
    /// than the bound from the nearest point of this cubic grid.
    pub fn lattice(self) -> Option<CoordinateGrid> {
        match self {
            PositionFidelity::Bounded { max_error_um, .. } => {
                // A cube with edges of 2 / sqrt(3) bounds has its corners at the bound; slightly shorter
                // edges leave room for rounding to float32.
                Some(CoordinateGrid::Lattice { step_nm: u64::from(max_error_um) * 1140 })
            }
            PositionFidelity::Exact | PositionFidelity::Formula => None,
        }
    }

    pub(crate) fn write_to(self, out: &mut Vec<u8>) {
        match self {
            PositionFidelity::Exact => write_unsigned(out, 0),
            PositionFidelity::Formula => write_unsigned(out, 1),
            PositionFidelity::Bounded { max_error_um, on_grid } => {
                write_unsigned(out, if on_grid { 3 } else { 2 });
                write_unsigned(out, u64::from(max_error_um));
            }
        }
    }

    pub(crate) fn read_from(input: &mut &[u8]) -> Result<Self> {
        match read_unsigned(input, PART)? {
            0 => Ok(PositionFidelity::Exact),
            1 => Ok(PositionFidelity::Formula),
            code @ 2..4 => {
                let max_error_um =
                    read_within(input, "frame parameters: a largest error", 1..=MOST_MAX_ERROR_UM.into())?
                        as u32;
                Ok(PositionFidelity::Bounded { max_error_um, on_grid: code == 3 })
            }
            other => Err(Error::unsupported(format!("frame parameters: unknown positions {other}"))),
        }
    }
}

/// In words: `exact`, `range image`, `within 10 mm`.
impl fmt::Display for PositionFidelity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PositionFidelity::Exact => f.write_str("exact"),
            PositionFidelity::Formula => f.write_str("range image"),
            PositionFidelity::Bounded { max_error_um, .. } => {
                write!(f, "within {} mm", f64::from(*max_error_um) / 1000.0)
            }
        }
    }
}

/// In words: `intensities exact`, `intensities dropped`, `intensities in steps of 0.05`.
impl fmt::Display for IntensityFidelity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            IntensityFidelity::Exact => f.write_str("intensities exact"),
            IntensityFidelity::None => f.write_str("intensities dropped"),
            IntensityFidelity::Rounded { step_millionths } => {
                write!(f, "intensities in steps of {}", f64::from(*step_millionths) / 1e6)
            }
        }
    }
}

impl IntensityFidelity {
    /// Levels per 1.0 of the rounded intensities, if that is a whole number.
    pub fn levels_per_unit(self) -> Option<u32> {
        match self {
            IntensityFidelity::Rounded { step_millionths: step } => {
                (1_000_000 % step == 0).then(|| 1_000_000 / step)
            }
            IntensityFidelity::Exact | IntensityFidelity::None => None,
        }
    }

    pub(crate) fn write_to(self, out: &mut Vec<u8>) {
        match self {
            IntensityFidelity::None => write_unsigned(out, 0),
            IntensityFidelity::Exact => write_unsigned(out, 1),
            IntensityFidelity::Rounded { step_millionths } => {
                write_unsigned(out, 2);
                write_unsigned(out, u64::from(step_millionths));
            }
        }
    }

    pub(crate) fn read_from(input: &mut &[u8]) -> Result<Self> {
        match read_unsigned(input, PART)? {
            0 => Ok(IntensityFidelity::None),
            1 => Ok(IntensityFidelity::Exact),
            2 => {
                let steps = 1..=u32::MAX.into();
                Ok(IntensityFidelity::Rounded {
                    step_millionths: read_within(input, "frame parameters: a step of intensities", steps)?
                        as u32,
                })
            }
            other => Err(Error::unsupported(format!("frame parameters: unknown intensities {other}"))),
        }
    }
}
