//! What the levels of the context coder mean: one table.

use super::modelling::Modelling;
use crate::backend::Level;

/// When the encoder predicts a frame from the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InterChoice {
    Never,
    /// If the scanner has not moved, which is quick to see.
    StandingStill,
    /// If it is found how the scanner has moved, which takes time.
    IfItFits,
}

/// What the context coder does at a level. What it means for each part of a frame is
/// [`Modelling::parts`]'s to say.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LevelSettings {
    pub modelling: Modelling,
    /// When P frames are tried.
    pub inter: InterChoice,
    /// How many frames the scanner model is fitted to: more make the formula sharper.
    pub sample_frames: usize,
    /// Frames a group, unless the user says.
    pub gop: usize,
}

/// Frames a group: enough to seek by, at the price of a few thousandths of the size.
pub(crate) const GOP: usize = 10;

/// Frames a group where size is all.
const LONG_GOP: usize = 30;

/// The levels, by number. Each is smaller than the one before and takes longer; numbers at which nothing lies
/// between their neighbours have none.
#[rustfmt::skip]
const LEVELS: [(u8, LevelSettings); 7] = {
    use InterChoice::{IfItFits, Never, StandingStill};
    use Modelling::{Deep, FittedTokens, Light, Mixed, Packed, Tokens};
    [
        (1, LevelSettings { modelling: Packed,       inter: Never,         sample_frames: 2, gop: GOP }),
        (2, LevelSettings { modelling: Tokens,       inter: Never,         sample_frames: 2, gop: GOP }),
        (3, LevelSettings { modelling: FittedTokens, inter: Never,         sample_frames: 2, gop: GOP }),
        (6, LevelSettings { modelling: Light,        inter: StandingStill, sample_frames: 3, gop: GOP }),
        (7, LevelSettings { modelling: Mixed,        inter: StandingStill, sample_frames: 6, gop: GOP }),
        (8, LevelSettings { modelling: Mixed,        inter: IfItFits,      sample_frames: 6, gop: GOP }),
        (9, LevelSettings { modelling: Deep,         inter: IfItFits,      sample_frames: 6, gop: LONG_GOP }),
    ]
};

/// What all other coders than the context coder do, whatever their level, which is on a scale of their own.
pub(crate) const OTHER_CODERS: LevelSettings =
    LevelSettings { modelling: Modelling::Light, inter: InterChoice::IfItFits, sample_frames: 6, gop: GOP };

/// What the context coder does at this level; `None` if it has no such level.
pub(crate) fn settings_of(level: Level) -> Option<LevelSettings> {
    LEVELS.iter().find(|(number, _)| *number == level.number()).map(|(_, settings)| *settings)
}

/// The numbers of the context coder's levels, to choose from.
pub(crate) fn numbers() -> String {
    let numbers: Vec<String> = LEVELS.iter().map(|(number, _)| number.to_string()).collect();
    numbers.join(", ")
}
