//! How the context coder models the parts of a frame: quickly or well.

use crate::context::Depth;
use crate::error::{Error, Result};

/// What models the columns' cells, intensities, ranges and corrections of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Modelling {
    /// Mixed adaptive models.
    #[default]
    Mixed,
    /// More of them: smallest.
    Deep,
    /// Ranges, predicted by least squares, and corrections as tokens; all else by mixed adaptive models.
    Balanced {
        /// Whether ranges of P frames are predicted from the frame before. Else, as up to version 3, they are
        /// predicted as if there were none.
        refers: bool,
    },
    /// Tokens with static tables: quickest.
    Tokens {
        /// Whether ranges are predicted by least squares, or else by the left neighbour.
        fitted: bool,
    },
}

impl Modelling {
    /// Whether all parts are tokens.
    pub(super) fn is_quick(self) -> bool {
        matches!(self, Modelling::Tokens { .. })
    }

    /// How far the adaptive models go.
    pub(super) fn depth(self) -> Depth {
        match self {
            Modelling::Mixed => Depth::Mixed,
            Modelling::Deep => Depth::Deep,
            Modelling::Balanced { .. } | Modelling::Tokens { .. } => Depth::Quick,
        }
    }

    /// How ranges are tokens, if they are: whether they are predicted by least squares.
    pub(super) fn range_tokens(self) -> Option<bool> {
        match self {
            Modelling::Mixed | Modelling::Deep => None,
            Modelling::Balanced { .. } => Some(true),
            Modelling::Tokens { fitted } => Some(fitted),
        }
    }

    /// Whether ranges of P frames that are tokens are predicted from the frame before.
    pub(super) fn range_tokens_refer(self) -> bool {
        self == Modelling::Balanced { refers: true }
    }

    /// Whether P frames from where the scanner has not moved take the same cells of the frame before alone: it
    /// is quicker not to look for surfaces.
    pub(super) fn can_do_without_surfaces(self) -> bool {
        self == Modelling::Balanced { refers: true }
    }

    /// Its number in the stream.
    pub(super) fn to_code(self) -> u64 {
        match self {
            Modelling::Mixed => 0,
            Modelling::Tokens { fitted: false } => 1,
            Modelling::Tokens { fitted: true } => 2,
            Modelling::Balanced { refers: false } => 3,
            Modelling::Deep => 4,
            Modelling::Balanced { refers: true } => 5,
        }
    }

    /// What reports add to the coder's name.
    pub(super) fn suffix(self) -> &'static str {
        match self {
            Modelling::Mixed => "",
            Modelling::Deep => " (deep)",
            Modelling::Balanced { .. } => " (balanced)",
            Modelling::Tokens { fitted: false } => " (tokens)",
            Modelling::Tokens { fitted: true } => " (tokens, fitted)",
        }
    }

    /// # Errors
    /// If this program knows none of this number.
    pub(super) fn from_code(code: u64) -> Result<Self> {
        match code {
            0 => Ok(Modelling::Mixed),
            1 => Ok(Modelling::Tokens { fitted: false }),
            2 => Ok(Modelling::Tokens { fitted: true }),
            3 => Ok(Modelling::Balanced { refers: false }),
            4 => Ok(Modelling::Deep),
            5 => Ok(Modelling::Balanced { refers: true }),
            _ => Err(Error::unsupported(format!("frame parameters: unknown modelling {code}"))),
        }
    }
}
