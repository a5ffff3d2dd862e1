//! How the context coder models the parts of a frame: quickly or well.

use crate::ground::error::{Error, Result};

/// What models the columns' cells, intensities, ranges and corrections of a frame; the numbers are those of the
/// format. What general-purpose back-ends and image coders leave is coded as by [`Light`](Modelling::Light).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modelling {
    /// Mixed adaptive models of cells and ranges, lighter ones of intensities.
    Mixed = 0,
    /// More of them, of intensities too: smallest.
    Deep = 1,
    /// Cells and intensities by adaptive models, ranges, predicted by least squares, and corrections as tokens.
    Light = 2,
    /// Tokens with static tables, ranges predicted by the left neighbour: quick.
    Tokens = 3,
    /// Tokens with static tables, ranges predicted by least squares.
    FittedTokens = 4,
    /// Ranges and intensities as differences in packed bits, all else as tokens: quickest.
    Packed = 5,
}

/// How the cells of the range image are modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OccupancyModelling {
    /// Bits, each mixed from all views.
    Mixed,
    /// Bits; two views decide where they are sure.
    Light,
    Tokens,
}

/// How intensities are modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum IntensityModelling {
    /// Bits, mixed from two views.
    Light,
    /// Bits, mixed from many views.
    Deep,
    Tokens,
    /// Differences in packed bits.
    Packed,
}

/// How ranges are modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RangeModelling {
    /// Bits, mixed from many views.
    Mixed,
    /// Bits, mixed from more of them.
    Deep,
    /// What a prediction by least squares misses them by, or one by the left neighbour.
    Tokens { fitted: bool },
    /// Differences in packed bits.
    Packed,
}

/// How corrections are modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CorrectionModelling {
    /// Adaptive bits.
    Adaptive,
    /// Tokens on the millimetre grid; adaptive bits on finer grids, where most points are corrected.
    Light,
    Tokens,
}

/// How each part of a frame is modelled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parts {
    pub occupancy: OccupancyModelling,
    pub intensity: IntensityModelling,
    pub range: RangeModelling,
    pub correction: CorrectionModelling,
}

impl Modelling {
    /// All, in the order of their numbers.
    const ALL: [Modelling; 6] = [
        Modelling::Mixed,
        Modelling::Deep,
        Modelling::Light,
        Modelling::Tokens,
        Modelling::FittedTokens,
        Modelling::Packed,
    ];

    /// How each part is modelled.
    pub(crate) fn parts(self) -> Parts {
        use {
            CorrectionModelling as Correction, IntensityModelling as Intensity,
            OccupancyModelling as Occupancy, RangeModelling as Range,
        };
        let (occupancy, intensity, range, correction) = match self {
            Self::Mixed => (Occupancy::Mixed, Intensity::Light, Range::Mixed, Correction::Adaptive),
            Self::Deep => (Occupancy::Mixed, Intensity::Deep, Range::Deep, Correction::Adaptive),
            Self::Light => {
                (Occupancy::Light, Intensity::Light, Range::Tokens { fitted: true }, Correction::Light)
            }
            Self::Tokens => {
                (Occupancy::Tokens, Intensity::Tokens, Range::Tokens { fitted: false }, Correction::Tokens)
            }
            Self::FittedTokens => {
                (Occupancy::Tokens, Intensity::Tokens, Range::Tokens { fitted: true }, Correction::Tokens)
            }
            Self::Packed => (Occupancy::Tokens, Intensity::Packed, Range::Packed, Correction::Tokens),
        };
        Parts { occupancy, intensity, range, correction }
    }

    /// Whether frames may be predicted from the one before: not where all parts are tokens.
    pub(crate) fn has_p_frames(self) -> bool {
        self.parts().occupancy != OccupancyModelling::Tokens
    }

    /// Its number in the stream.
    pub(crate) fn to_code(self) -> u64 {
        self as u64
    }

    /// Its name in reports; none for that of the first number.
    pub(crate) fn suffix(self) -> &'static str {
        match self {
            Modelling::Mixed => "",
            Modelling::Deep => " (deep)",
            Modelling::Light => " (light)",
            Modelling::Tokens => " (tokens)",
            Modelling::FittedTokens => " (tokens, fitted)",
            Modelling::Packed => " (packed)",
        }
    }

    /// # Errors
    /// If there is none of this number.
    pub(crate) fn from_code(code: u64) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|modelling| modelling.to_code() == code);
        known.ok_or_else(|| Error::unsupported(format!("frame parameters: unknown coder {code}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modellings_come_back_from_their_numbers() {
        for code in 0..6 {
            assert_eq!(Modelling::from_code(code).unwrap().to_code(), code);
        }
        assert!(Modelling::from_code(6).is_err());
    }
}
