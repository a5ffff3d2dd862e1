//! The kinds of sections, which errors name too. FORMAT.md 2.6.

use std::fmt;

/// A kind of a record or section that readers who do not know it may skip: this one and all above.
pub(crate) const SKIPPABLE: u8 = 0x80;

/// What a section holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum SectionKind {
    /// Layout of the file, and the bytes before and after the records.
    File,
    /// Which columns of the range image are used.
    Columns,
    /// Which cells of the range image hold a point.
    Occupancy,
    /// Ranges.
    Range,
    /// What rounding leaves between the model's coordinates and the file's.
    Correction,
    /// Intensities.
    Intensity,
    /// Where the points' order differs from the canonical one.
    Order,
    /// Points that no model explains, as they come.
    Points,
    /// Fields other than position and intensity.
    Channels,
    /// How the frame is coded; the first of all.
    Parameters,
    /// The contour map: which region each return belongs to.
    Contour,
    /// The models of the regions.
    Regions,
    /// What prediction leaves of the ranges, coded by a general-purpose back-end.
    Residual,
    /// How the points were moved after they were measured; left out if they were not.
    Compensation,
    /// The file as it is, through a general-purpose coder: then nothing else is there but parameters.
    Bytes,
    /// Positions of the records without a return that the range image holds.
    Blanks,
    /// How the points were moved through the coordinates of a map; left out if they were not.
    World,
    /// Further returns of the cells.
    Echoes,
    /// By which channel the records were sorted; left out if they are in the order of arrival.
    Sorted,
    /// How the points were moved by their time stamps; left out if they were not.
    Stamped,
    /// Something that this program does not know, of this number, but may leave aside.
    Skippable(u8),
}

impl SectionKind {
    /// All kinds that this program knows, in the order of their numbers, the first of which is 1.
    pub(crate) const ALL: [SectionKind; 20] = [
        SectionKind::File,
        SectionKind::Columns,
        SectionKind::Occupancy,
        SectionKind::Range,
        SectionKind::Correction,
        SectionKind::Intensity,
        SectionKind::Order,
        SectionKind::Points,
        SectionKind::Channels,
        SectionKind::Parameters,
        SectionKind::Contour,
        SectionKind::Regions,
        SectionKind::Residual,
        SectionKind::Compensation,
        SectionKind::Bytes,
        SectionKind::Blanks,
        SectionKind::World,
        SectionKind::Echoes,
        SectionKind::Sorted,
        SectionKind::Stamped,
    ];

    /// For tests: all kinds that this program knows.
    #[cfg(feature = "internals")]
    #[doc(hidden)]
    pub fn all() -> &'static [SectionKind] {
        &Self::ALL
    }

    /// The kind's name in reports: lower case, one word.
    pub fn name(self) -> &'static str {
        match self {
            SectionKind::File => "file",
            SectionKind::Columns => "columns",
            SectionKind::Occupancy => "occupancy",
            SectionKind::Range => "range",
            SectionKind::Correction => "correction",
            SectionKind::Intensity => "intensity",
            SectionKind::Order => "order",
            SectionKind::Points => "points",
            SectionKind::Channels => "channels",
            SectionKind::Parameters => "parameters",
            SectionKind::Contour => "contour",
            SectionKind::Regions => "regions",
            SectionKind::Residual => "residual",
            SectionKind::Compensation => "compensation",
            SectionKind::Bytes => "bytes",
            SectionKind::Blanks => "blanks",
            SectionKind::World => "world",
            SectionKind::Echoes => "echoes",
            SectionKind::Sorted => "sorted",
            SectionKind::Stamped => "stamped",
            SectionKind::Skippable(_) => "skippable",
        }
    }

    /// The number in the stream.
    pub fn number(self) -> u8 {
        match self {
            SectionKind::Skippable(number) => number,
            known => 1 + Self::ALL.iter().take_while(|kind| **kind != known).count() as u8,
        }
    }

    /// The kind with this number, if there is one.
    pub fn from_number(number: u8) -> Option<Self> {
        match number {
            SKIPPABLE.. => Some(SectionKind::Skippable(number)),
            _ => Self::ALL.get(usize::from(number).checked_sub(1)?).copied(),
        }
    }

    /// Whether a decoder leaves the section aside.
    pub fn is_skippable(self) -> bool {
        matches!(self, SectionKind::Skippable(_))
    }
}

impl fmt::Display for SectionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
