//! The meaning of the context coder's levels, in one table.

use super::modelling::Modelling;
use crate::backend::{Compressors, Level};

/// When the encoder tries to predict a frame from the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InterChoice {
    Never,
    /// If the scanner has not moved, which is quickly determined.
    StandingStill,
    /// If the motion of the scanner can be estimated, which takes time.
    IfItFits,
}

/// The settings of the context coder at a level. [`Modelling::parts`] defines the modelling of each part of a
/// frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LevelSettings {
    pub modelling: Modelling,
    /// When P frames are tried.
    pub inter: InterChoice,
    /// Number of frames to which the scanner is fitted: with more frames the constants are more accurate.
    pub sample_frames: usize,
    /// Frames in a group, by default.
    pub gop: usize,
    /// Which general-purpose compressors are tried where models may do worse.
    pub compressors: Compressors,
}

/// Frames in a group: few enough for seeking, at a cost of a few thousandths of the size.
pub(crate) const GOP: usize = 10;

/// Frames in a group if only size counts.
const LONG_GOP: usize = 30;

/// The levels, by number. Each is smaller and slower than the one before; numbers without a useful setting
/// between their neighbours are left out.
#[rustfmt::skip]
const LEVELS: [(u8, LevelSettings); 7] = {
    use Compressors::{All, Fast, Slow};
    use InterChoice::{IfItFits, Never, StandingStill};
    use Modelling::{Deep, FittedTokens, Light, Mixed, Packed, Tokens};
    [
        (1, LevelSettings { modelling: Packed,       inter: Never,         sample_frames: 2, gop: GOP, compressors: Fast }),
        (2, LevelSettings { modelling: Tokens,       inter: Never,         sample_frames: 2, gop: GOP, compressors: Fast }),
        (3, LevelSettings { modelling: FittedTokens, inter: Never,         sample_frames: 2, gop: GOP, compressors: Fast }),
        (6, LevelSettings { modelling: Light,        inter: StandingStill, sample_frames: 3, gop: GOP, compressors: Slow }),
        (7, LevelSettings { modelling: Mixed,        inter: StandingStill, sample_frames: 6, gop: GOP, compressors: All }),
        (8, LevelSettings { modelling: Mixed,        inter: IfItFits,      sample_frames: 6, gop: GOP, compressors: All }),
        (9, LevelSettings { modelling: Deep,         inter: IfItFits,      sample_frames: 6, gop: LONG_GOP, compressors: All }),
    ]
};

/// The settings of all coders other than the context coder, at every level: these have their own scales of
/// effort.
pub(crate) const OTHER_CODERS: LevelSettings = LevelSettings {
    modelling: Modelling::Light,
    inter: InterChoice::IfItFits,
    sample_frames: 6,
    gop: GOP,
    compressors: Compressors::Slow,
};

/// The settings of the context coder at this level; `None` if it has no such level.
pub(crate) fn settings_of(level: Level) -> Option<LevelSettings> {
    LEVELS.iter().find(|(number, _)| *number == level.number()).map(|(_, settings)| *settings)
}

/// The numbers of the context coder's levels, for messages.
pub(crate) fn numbers() -> String {
    let numbers: Vec<String> = LEVELS.iter().map(|(number, _)| number.to_string()).collect();
    numbers.join(", ")
}
