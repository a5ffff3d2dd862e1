//! How a column is coded: the encoder's choice, as stored in the stream.
//! FORMAT.md 8.9, "Columns of channels".

use super::RecordContext;
use super::rules::Rule;
use crate::entropy::BitCoder;
use crate::ground::error::{Error, Result};
use crate::models::numbers::Scale;
use crate::scan::ScalarType;

/// How a column is coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Plan {
    /// All records have the same value.
    #[default]
    Constant,
    /// The values are those of another column: 0 to 2 for x, y and z, 3 for the intensity, then the channels.
    Same(u16),
    /// As integers, each predicted in several ways.
    Integers(Integers),
    /// As integers of which there are few.
    Levels(Levels),
    /// As integers that form an image.
    Image(Image),
}

/// The kind of a [`Plan`].
#[derive(Clone, Copy)]
enum Method {
    Constant,
    Same,
    Integers,
    Levels,
    Image,
}

impl Method {
    /// All methods, in the order of their numbers.
    const ALL: [Method; 5] =
        [Method::Constant, Method::Same, Method::Integers, Method::Levels, Method::Image];
}

/// How values become integers, and what predicts these.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Integers {
    /// How values become integers.
    pub scale: Scale,
    /// Whether some values lie off this scale.
    pub has_exceptions: bool,
    /// What identifies the beam of a record: 0 for its row in the range image, if there is one, otherwise the
    /// number of a channel, counted from 1.
    pub key: u16,
    /// The distance, in records, at which a value is likely to recur; 0 for none.
    pub lag: u32,
    /// The number, computed from the position or the place, from which integers may follow.
    pub geometry: Geometry,
    /// The rule that nearly all integers follow, if there is one.
    pub rule: Option<Rule>,
}

/// How values become levels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// How values become integers.
    pub scale: Scale,
    /// Whether some values lie off this scale.
    pub has_exceptions: bool,
}

/// How values become the integers of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Image {
    /// How values become integers.
    pub scale: Scale,
    /// Whether some values lie off this scale.
    pub has_exceptions: bool,
    /// All integers are multiples of this number, by which they are divided; at least 1.
    pub divisor: u16,
}

/// A number that is computed from a position, or from a place in the range image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Geometry(u8);

/// Number of geometries: none, distances, and angles in radians, degrees and hundredths of degrees.
const GEOMETRIES: u8 = 21;
/// The first of the geometries of a place: the range in metres, the azimuth in both directions, then the
/// range in millimetres.
const FIRST_OF_PLACE: u8 = 12;
const MILLIMETRES_OF_PLACE: u8 = 19;
/// The distance of a position in millimetres.
const MILLIMETRES_OF_POSITION: u8 = 20;

impl Geometry {
    /// The geometries of a position.
    pub fn of_positions() -> impl Iterator<Item = Geometry> {
        (1..FIRST_OF_PLACE).chain([MILLIMETRES_OF_POSITION]).map(Geometry)
    }

    /// The geometries of a place in the range image.
    pub fn of_places() -> impl Iterator<Item = Geometry> {
        (FIRST_OF_PLACE..=MILLIMETRES_OF_PLACE).map(Geometry)
    }

    /// The number for a record, if it is known.
    #[inline(always)]
    pub fn of(self, record: usize, context: &RecordContext) -> Option<f64> {
        if self.0 == 0 { None } else { self.of_record(record, context) }
    }

    fn of_record(self, record: usize, context: &RecordContext) -> Option<f64> {
        match self.0 {
            0..FIRST_OF_PLACE | MILLIMETRES_OF_POSITION => {
                context.positions.get(record).map(|position| self.of_position(position))
            }
            FIRST_OF_PLACE => Some(f64::from(*context.steps.get(record)?) * context.range_step_m),
            MILLIMETRES_OF_PLACE => {
                Some(f64::from(*context.steps.get(record)?) * context.range_step_m * 1000.0)
            }
            _ => {
                let degrees = f64::from(*context.ticks.get(record)?) * context.tick_degrees;
                let angle = match (self.0 - FIRST_OF_PLACE - 1) % 3 {
                    0 => degrees * (std::f64::consts::PI / 180.0),
                    1 => degrees,
                    _ => degrees * 100.0,
                };
                Some(if self.0 < FIRST_OF_PLACE + 4 { angle } else { -angle })
            }
        }
    }

    fn of_position(self, position: &[f32; 3]) -> f64 {
        let [x, y, z] = position.map(f64::from);
        let flat = x * x + y * y;
        let angle = |radians: f64| match (self.0 - 3) % 3 {
            0 => radians,
            1 => radians * (180.0 / std::f64::consts::PI),
            _ => radians * (18_000.0 / std::f64::consts::PI),
        };
        match self.0 {
            1 => (flat + z * z).sqrt(),
            MILLIMETRES_OF_POSITION => (flat + z * z).sqrt() * 1000.0,
            2 => flat.sqrt(),
            3..6 => angle(libm::atan2(y, x)),
            6..9 => angle(libm::atan2(x, y)),
            _ => angle(libm::atan2(z, flat.sqrt())),
        }
    }
}

impl Integers {
    /// Whether integers are the ranks of float32 values.
    pub fn are_singles(&self, scalar: ScalarType) -> bool {
        self.scale == Scale::RANK && scalar == ScalarType::F32
    }
}

impl Plan {
    /// Whether values have neighbours in an image.
    pub fn has_image(self) -> bool {
        matches!(self, Plan::Levels(_) | Plan::Image(_))
    }

    /// Codes the choice; a decoder passes any plan.
    ///
    /// # Errors
    /// If a decoder reads a choice that this program does not know.
    pub fn code<C: BitCoder>(self, coder: &mut C) -> Result<Self> {
        let unknown = || Error::unsupported("channels: unknown method");
        let (method, source) = match self {
            Plan::Constant => (Method::Constant, 0),
            Plan::Same(source) => (Method::Same, source),
            Plan::Integers(_) => (Method::Integers, 0),
            Plan::Levels(_) => (Method::Levels, 0),
            Plan::Image(_) => (Method::Image, 0),
        };
        let number = coder.code_plain(method as u64, 8) as usize;
        match Method::ALL.get(number).copied().ok_or_else(unknown)? {
            Method::Constant => Ok(Plan::Constant),
            Method::Same => Ok(Plan::Same(coder.code_plain(source.into(), 16) as u16)),
            Method::Integers => {
                let Integers { scale, has_exceptions, key, lag, geometry, rule } = match self {
                    Plan::Integers(integers) => integers,
                    _ => Integers::default(),
                };
                let code = coder.code_plain(scale.to_code().into(), 8) as u8;
                let scale = Scale::from_code(code).ok_or_else(unknown)?;
                let has_exceptions = coder.code_plain(has_exceptions.into(), 1) == 1;
                let key = coder.code_plain(key.into(), 16) as u16;
                let lag = coder.code_plain(lag.into(), 24) as u32;
                let geometry = coder.code_plain(geometry.0.into(), 8) as u8;
                let geometry = Some(Geometry(geometry)).filter(|g| g.0 < GEOMETRIES).ok_or_else(unknown)?;
                let rule = Rule::from_code(coder.code_plain(Rule::to_code(rule).into(), 8) as u8);
                Ok(Plan::Integers(Integers { scale, has_exceptions, key, lag, geometry, rule }))
            }
            Method::Levels => {
                let levels = if let Plan::Levels(levels) = self { levels } else { Levels::default() };
                let code = coder.code_plain(levels.scale.to_code().into(), 8) as u8;
                let scale = Scale::from_code(code).ok_or_else(unknown)?;
                let has_exceptions = coder.code_plain(levels.has_exceptions.into(), 1) == 1;
                Ok(Plan::Levels(Levels { scale, has_exceptions }))
            }
            Method::Image => {
                let image = if let Plan::Image(image) = self { image } else { Image::default() };
                let code = coder.code_plain(image.scale.to_code().into(), 8) as u8;
                Ok(Plan::Image(Image {
                    scale: Scale::from_code(code).ok_or_else(unknown)?,
                    has_exceptions: coder.code_plain(image.has_exceptions.into(), 1) == 1,
                    divisor: (coder.code_plain(image.divisor.into(), 16) as u16).max(1),
                }))
            }
        }
    }
}
