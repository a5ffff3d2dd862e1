//! How the context coder models the parts of a frame: quickly or well.

use crate::ground::error::{Error, Result};
use crate::models::Depth;

/// What models the columns' cells, intensities, ranges and corrections of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modelling {
    /// Mixed adaptive models; in the second edition, intensities by two of them.
    Mixed(Edition),
    /// More of them: smallest.
    Deep,
    /// Ranges, predicted by least squares, and corrections as tokens; intensities by two adaptive models.
    Light,
    /// Ranges, predicted by least squares, and corrections as tokens; all else by mixed adaptive models.
    Balanced(Edition),
    /// Tokens with static tables: quick.
    Tokens {
        /// Whether ranges are predicted by least squares, or else by the left neighbour.
        fitted: bool,
        /// What is added to ranges.
        edition: Edition,
    },
    /// Ranges and intensities as differences in packed bits, all else as tokens: quickest.
    Packed,
}

/// Modellings have been improved since the version of the format that brought them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edition {
    /// As they were at first.
    First,
    /// Tables of ranges start from what these are like, and P frames predict them from the frame before; mixed
    /// models leave intensities to the lighter one, which turned out to be better.
    Second,
}

/// How ranges are tokens.
#[derive(Clone, Copy, Debug)]
pub struct RangeTokenSettings {
    /// Whether they are predicted by least squares.
    pub fitted: bool,
    /// Whether tables start from what ranges are like.
    pub has_start: bool,
    /// Whether those of P frames are predicted from the frame before.
    pub refers: bool,
}

/// The modellings, by their numbers in the stream.
const NUMBERED: [Modelling; 11] = [
    Modelling::FIRST,
    Modelling::Tokens { fitted: false, edition: Edition::First },
    Modelling::Tokens { fitted: true, edition: Edition::First },
    Modelling::Balanced(Edition::First),
    Modelling::Deep,
    Modelling::Balanced(Edition::Second),
    Modelling::Tokens { fitted: false, edition: Edition::Second },
    Modelling::Tokens { fitted: true, edition: Edition::Second },
    Modelling::Packed,
    Modelling::Light,
    Modelling::Mixed(Edition::Second),
];

impl Modelling {
    /// That of frames that do not say.
    pub(crate) const FIRST: Self = Modelling::Mixed(Edition::First);

    /// Whether all parts are tokens.
    pub(crate) fn is_quick(self) -> bool {
        matches!(self, Modelling::Tokens { .. } | Modelling::Packed)
    }

    /// Whether ranges and intensities are in packed bits.
    pub(crate) fn is_packed(self) -> bool {
        self == Modelling::Packed
    }

    /// How far the adaptive models go.
    pub(crate) fn depth(self) -> Depth {
        match self {
            Modelling::Mixed(_) => Depth::Mixed,
            Modelling::Deep => Depth::Deep,
            Modelling::Light | Modelling::Tokens { .. } | Modelling::Packed => Depth::Light,
            Modelling::Balanced(_) => Depth::Quick,
        }
    }

    /// How far those of intensities go.
    pub(crate) fn intensity_depth(self) -> Depth {
        if self == Modelling::Mixed(Edition::Second) { Depth::Light } else { self.depth() }
    }

    /// How ranges are tokens, if they are.
    pub(crate) fn range_tokens(self) -> Option<RangeTokenSettings> {
        let settings = |fitted, edition| RangeTokenSettings {
            fitted,
            has_start: edition == Edition::Second,
            refers: self.can_do_without_surfaces(),
        };
        match self {
            Modelling::Mixed(_) | Modelling::Deep | Modelling::Packed => None,
            Modelling::Light => Some(settings(true, Edition::Second)),
            Modelling::Balanced(edition) => Some(settings(true, edition)),
            Modelling::Tokens { fitted, edition } => Some(settings(fitted, edition)),
        }
    }

    /// Whether P frames from where the scanner has not moved take the same cells of the frame before alone: it
    /// is quicker not to look for surfaces.
    pub(crate) fn can_do_without_surfaces(self) -> bool {
        matches!(self, Modelling::Light | Modelling::Balanced(Edition::Second))
    }

    /// Its number in the stream.
    pub(crate) fn to_code(self) -> u64 {
        NUMBERED.iter().position(|modelling| *modelling == self).unwrap_or_default() as u64
    }

    /// What reports add to the coder's name.
    pub(crate) fn suffix(self) -> &'static str {
        match self {
            Modelling::Mixed(_) => "",
            Modelling::Deep => " (deep)",
            Modelling::Light => " (light)",
            Modelling::Balanced(_) => " (balanced)",
            Modelling::Tokens { fitted: false, .. } => " (tokens)",
            Modelling::Tokens { fitted: true, .. } => " (tokens, fitted)",
            Modelling::Packed => " (packed)",
        }
    }

    /// # Errors
    /// If this program knows none of this number.
    pub(crate) fn from_code(code: u64) -> Result<Self> {
        let known = usize::try_from(code).ok().and_then(|code| NUMBERED.get(code).copied());
        known.ok_or_else(|| Error::unsupported(format!("frame parameters: unknown modelling {code}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modellings_come_back_from_their_numbers() {
        for code in 0..NUMBERED.len() as u64 {
            assert_eq!(Modelling::from_code(code).unwrap().to_code(), code);
        }
        assert!(Modelling::from_code(NUMBERED.len() as u64).is_err());
    }
}
