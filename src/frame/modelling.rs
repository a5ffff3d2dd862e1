//! How the context coder models the parts of a frame, from fast to thorough. FORMAT.md 8.10.

use crate::ground::error::{Error, Result};

/// The models of a frame's occupancy, intensities, ranges and corrections; the numbers are those of the
/// format. With back-ends and image coders, everything except the ranges is coded as by
/// [`Light`](Modelling::Light).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Modelling {
    /// Mixed adaptive models of occupancy and ranges, simpler ones of intensities.
    Mixed = 0,
    /// More models of ranges and of intensities: smallest.
    Deep = 1,
    /// Adaptive models of occupancy and intensities; ranges, predicted by least squares, and corrections as
    /// tokens.
    Light = 2,
    /// Tokens with static tables; ranges are predicted from the left neighbour: fast.
    Tokens = 3,
    /// Tokens with static tables; ranges are predicted by least squares.
    FittedTokens = 4,
    /// Ranges and intensities as differences in packed bits, everything else as tokens: fastest.
    Packed = 5,
}

/// How the occupancy of the range image is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OccupancyModelling {
    /// Bits, each mixed from all views.
    Mixed,
    /// Bits; two views decide alone where they are certain.
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
    /// Bits, mixed from even more views.
    Deep,
    /// Prediction errors; ranges are predicted by least squares if `fitted`, otherwise from the left
    /// neighbour.
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
pub(crate) struct PartModellings {
    pub occupancy: OccupancyModelling,
    pub intensity: IntensityModelling,
    pub range: RangeModelling,
    pub correction: CorrectionModelling,
}

impl PartModellings {
    /// Whether the models of intensities, and those of ranges above the default level, adapt to each value.
    pub(crate) fn is_adaptive(&self) -> bool {
        matches!(self.intensity, IntensityModelling::Light | IntensityModelling::Deep)
    }
}

impl Modelling {
    /// All modellings, in the order of their numbers.
    const ALL: [Modelling; 6] = [
        Modelling::Mixed,
        Modelling::Deep,
        Modelling::Light,
        Modelling::Tokens,
        Modelling::FittedTokens,
        Modelling::Packed,
    ];

    /// How each part is modelled.
    pub(crate) fn parts(self) -> PartModellings {
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
        PartModellings { occupancy, intensity, range, correction }
    }

    /// Whether there are P frames: not if all parts are tokens.
    pub(crate) fn has_p_frames(self) -> bool {
        self.parts().occupancy != OccupancyModelling::Tokens
    }

    /// Its number in the stream.
    pub(crate) fn to_code(self) -> u64 {
        self as u64
    }

    /// Its name in reports; empty for the first.
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

    /// The modelling with this number.
    ///
    /// # Errors
    /// If there is none.
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
