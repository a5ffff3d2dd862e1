//! The kinds of sections; here because errors name them. FORMAT.md 2.6.

use std::fmt;

/// The first of the kinds of records and sections that readers who do not know them may skip.
pub(crate) const SKIPPABLE: u8 = 0x80;

/// The kind of a section: what it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum SectionKind {
    /// Layout of the file, and the bytes before and after the records.
    File,
    /// Which columns of the range image are used.
    Columns,
    /// Which cells of the range image hold a return.
    Occupancy,
    /// Ranges.
    Range,
    /// The differences between the model's coordinates and the file's.
    Correction,
    /// Intensities.
    Intensity,
    /// How the order of the points differs from canonical order (FORMAT.md 4.2).
    Order,
    /// Points that no model explains, in the order of the file.
    Strays,
    /// Fields other than position and intensity.
    Channels,
    /// How the frame is coded; always the first section.
    Parameters,
    /// The contour map: which region each return belongs to.
    Contour,
    /// The models of the regions.
    Regions,
    /// The residuals of the ranges, coded by a back-end.
    Residual,
    /// How the points were moved after they were measured; absent if they were not.
    Compensation,
    /// The whole file through a general-purpose compressor; the only other section is then the parameters.
    Bytes,
    /// Positions of the records without a measured point that the range image holds.
    Blanks,
    /// How the points were moved through map coordinates; absent if they were not.
    World,
    /// Echoes: further points of the cells.
    Echoes,
    /// The channel by which the records were sorted; absent if they are in the order of arrival.
    Sorted,
    /// How the points were moved by their time stamps; absent if they were not.
    Stamped,
    /// A section of an unknown kind, with this number, that decoders may skip.
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
        SectionKind::Strays,
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

    /// All kinds that this program knows, for tests.
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
            SectionKind::Strays => "strays",
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

    /// The kind's number in the stream.
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

    /// Whether a decoder that does not know the section may skip it.
    pub fn is_skippable(self) -> bool {
        matches!(self, SectionKind::Skippable(_))
    }
}

impl fmt::Display for SectionKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
