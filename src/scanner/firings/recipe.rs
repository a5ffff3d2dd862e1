//! How the programs that write scans turn integers into coordinates: which precision, which order, which axes.

use std::f64::consts::PI;

use super::Laser;
use crate::ground::rounding::round_ties_even;

/// A program that writes scans. A new one needs a number here and its arithmetic below; the fit tries them all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Recipe {
    /// ROS `velodyne_pointcloud`: single precision throughout, tables of cosine and sine, x ahead, y to the left,
    /// azimuth clockwise.
    VelodyneRos = 0,
    /// Double precision, rounded once; y ahead, azimuth clockwise: PCL's grabber, VeloView, Hesai's driver.
    DoubleYAhead = 1,
    /// Double precision, rounded once; x ahead, azimuth clockwise.
    DoubleXAhead = 2,
    /// The same with ranges in single precision: Ouster.
    SingleRangeXAhead = 3,
}

/// Axes of the coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axes {
    XAhead,
    YAhead,
}

impl Recipe {
    /// Every recipe, in the order in which the fit tries them.
    pub const ALL: [Recipe; 4] =
        [Recipe::VelodyneRos, Recipe::DoubleYAhead, Recipe::DoubleXAhead, Recipe::SingleRangeXAhead];

    /// The recipe of this number in the stream.
    pub fn of_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|recipe| *recipe as u32 == number)
    }

    fn axes(self) -> Axes {
        match self {
            Recipe::VelodyneRos | Recipe::DoubleXAhead | Recipe::SingleRangeXAhead => Axes::XAhead,
            Recipe::DoubleYAhead => Axes::YAhead,
        }
    }

    /// Degrees by which elevations are told apart: by a float32 in radians, or by seven digits.
    pub(super) fn elevation_step(self, degrees: f64) -> f64 {
        match self {
            Recipe::VelodyneRos => {
                let single = radians(degrees.abs()) as f32;
                f64::from(single.next_up() - single).to_degrees()
            }
            _ => 1e-7,
        }
    }

    /// The azimuth of a point, in radians from -pi to pi.
    pub(super) fn azimuth(self, x: f64, y: f64) -> f64 {
        match self.axes() {
            Axes::XAhead => libm::atan2(-y, x),
            Axes::YAhead => libm::atan2(x, y),
        }
    }
}

fn radians(degrees: f64) -> f64 {
    degrees * PI / 180.0
}

/// Cosine and sine of every tick, as the recipe has them.
#[derive(Clone, Debug)]
pub(super) enum Turn {
    /// Of float32 angles, rounded to float32.
    Single(Vec<[f32; 2]>),
    /// Degrees of a tick; the recipe adds a laser's offset before it takes the cosine.
    Double(f64),
}

impl Turn {
    pub fn new(recipe: Recipe, ticks: u32) -> Self {
        let tick = 360.0 / f64::from(ticks);
        match recipe {
            Recipe::VelodyneRos => {
                let entry = |t: u32| {
                    let degrees = tick as f32 * t as f32;
                    let angle = f64::from(radians(f64::from(degrees)) as f32);
                    [libm::cos(angle) as f32, libm::sin(angle) as f32]
                };
                Turn::Single((0..ticks).map(entry).collect())
            }
            _ => Turn::Double(tick),
        }
    }
}

/// A laser's constants as the recipe uses them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Arithmetic {
    /// Cosine and sine of the elevation, and of the azimuth offset if there is one.
    Single { cos_v: f32, sin_v: f32, offset: Option<[f32; 2]> },
    /// The same in double precision; the azimuth offset in degrees.
    Double { cos_v: f64, sin_v: f64, offset: f64, axes: Axes, single_range: bool },
}

impl Arithmetic {
    pub fn new(recipe: Recipe, laser: &Laser) -> Self {
        let elevation = radians(laser.elevation_degrees());
        match recipe {
            Recipe::VelodyneRos => {
                let elevation = f64::from(elevation as f32);
                // The driver turns back by its constant, where the formula here adds one.
                let offset = f64::from(radians(-laser.azimuth_degrees()) as f32);
                Arithmetic::Single {
                    cos_v: libm::cos(elevation) as f32,
                    sin_v: libm::sin(elevation) as f32,
                    offset: (laser.azimuth != 0)
                        .then(|| [libm::cos(offset) as f32, libm::sin(offset) as f32]),
                }
            }
            _ => Arithmetic::Double {
                single_range: recipe == Recipe::SingleRangeXAhead,
                cos_v: libm::cos(elevation),
                sin_v: libm::sin(elevation),
                offset: laser.azimuth_degrees(),
                axes: recipe.axes(),
            },
        }
    }

    /// The coordinates in the file of a whole number of steps.
    pub fn position(&self, turn: &Turn, tick: u32, steps: u32, range_step_um: u32) -> [f32; 3] {
        let step = f64::from(range_step_um) * 1e-6;
        match self {
            Arithmetic::Single { .. } => self.single(turn, tick, steps as f32 * step as f32),
            Arithmetic::Double { single_range, .. } => {
                let metres = if *single_range {
                    f64::from(steps as f32 * step as f32)
                } else {
                    f64::from(steps) * step
                };
                self.double(turn, tick, metres).map(|v| v as f32)
            }
        }
    }

    /// The coordinates of any range in metres.
    pub fn position_at(&self, turn: &Turn, tick: u32, metres: f64) -> [f64; 3] {
        match self {
            Arithmetic::Single { .. } => self.single(turn, tick, metres as f32).map(f64::from),
            Arithmetic::Double { .. } => self.double(turn, tick, metres),
        }
    }

    fn single(&self, turn: &Turn, tick: u32, metres: f32) -> [f32; 3] {
        let (Arithmetic::Single { cos_v, sin_v, offset }, Turn::Single(table)) = (self, turn) else {
            return [0.0; 3];
        };
        let [mut cos, mut sin] = table[tick as usize];
        if let Some([cos_o, sin_o]) = offset {
            (cos, sin) = (cos * cos_o + sin * sin_o, sin * cos_o - cos * sin_o);
        }
        let along = metres * cos_v;
        [along * cos, -(along * sin), metres * sin_v]
    }

    fn double(&self, turn: &Turn, tick: u32, metres: f64) -> [f64; 3] {
        let (Arithmetic::Double { cos_v, sin_v, offset, axes, .. }, Turn::Double(degrees)) = (self, turn)
        else {
            return [0.0; 3];
        };
        let angle = radians(f64::from(tick) * degrees + offset);
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        let along = metres * cos_v;
        let [x, y] = match axes {
            Axes::XAhead => [along * cos, -(along * sin)],
            Axes::YAhead => [along * sin, along * cos],
        };
        [x, y, metres * sin_v]
    }
}

/// The range of a position in metres, in steps; none if there is none.
pub(super) fn steps_of(position: [f64; 3], range_step_m: f64) -> Option<u32> {
    let metres = position.iter().map(|v| v * v).sum::<f64>().sqrt();
    let steps = round_ties_even(metres / range_step_m);
    (steps >= 1.0 && steps < f64::from(1u32 << 24)).then_some(steps as u32)
}
