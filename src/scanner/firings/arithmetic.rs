//! How the programs that write scans turn integers into coordinates: precision and order of operations.
//! FORMAT.md 3.3.

use std::f64::consts::PI;

use super::Laser;
use super::recipe::{Axes, FINE_TICKS, Origin, Recipe, SumPrecision, radians};
use crate::ground::doubles::{Choose, Real};
use crate::ground::floats::round_ties_even;
use crate::ground::lanes::lanes;
use crate::ground::lazy_table::LazyTable;

/// Radians per degree in single precision.
const DEGREE: f32 = (PI / 180.0) as f32;

/// Radians per degree in LSLiDAR's driver.
const LS_DEGREE: f64 = 0.017_453_293;

/// What a recipe stores for every tick.
#[derive(Debug)]
pub(super) enum TurnTable {
    /// Cosine and sine, rounded to float32.
    Tables(LazyTable<[f32; 2]>),
    /// The angle in radians.
    Angles(LazyTable<f32>),
    /// Degrees per tick, because the recipe adds a laser's offset before it takes the cosine; and cosine and
    /// sine without an offset.
    Degrees(f64, LazyTable<[f64; 2]>),
    /// Number of ticks: [`Recipe::HesaiSdk2`] has so many angles that its tables are not stored.
    Fine(u32),
}

impl TurnTable {
    pub fn new(recipe: Recipe, ticks: u32) -> Self {
        let tick = 360.0 / f64::from(ticks);
        let degrees = move |t: u32| f64::from(t) / (f64::from(ticks) / 360.0);
        match recipe {
            Recipe::VelodyneRos | Recipe::VelodyneRosGlibc => {
                let angle = move |t: u32| radians(f64::from(tick as f32 * t as f32)) as f32;
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::NebulaVelodyne => {
                let angle = move |t: u32| radians(tick * f64::from(t)) as f32;
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::Apollo => {
                let angle = move |t: u32| tick as f32 * (f64::from(t) * PI) as f32 / 180.0;
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e => {
                let angle = move |t: u32| tick as f32 * t as f32 * DEGREE;
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::Pandar64 | Recipe::Pandar64InDegrees => {
                let later = move |t: u32| ((t + ticks / 4) % ticks) as f32;
                let angle = move |t: u32| match recipe {
                    Recipe::Pandar64 => later(t) * (tick * PI / 180.0) as f32,
                    _ => radians(f64::from(tick as f32 * later(t))) as f32,
                };
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::HesaiGeneralSdk => {
                let angle = move |t: u32| (f64::from(t) * PI / (0.5 * f64::from(ticks))) as f32;
                TurnTable::Tables(LazyTable::new(ticks, move |t| recipe.cos_sin(angle(t))))
            }
            Recipe::HesaiSdk2 => TurnTable::Fine(ticks),
            Recipe::RoboSense | Recipe::RoboSenseFused => {
                TurnTable::Tables(LazyTable::new(ticks, move |t| {
                    single_cos_sin(radians(f64::from(t) * tick))
                }))
            }
            Recipe::RoboSenseEarly | Recipe::RoboSenseEarlyFused => {
                TurnTable::Tables(LazyTable::new(ticks, move |t| single_cos_sin(early_radians(t, ticks))))
            }
            Recipe::Nebula => {
                TurnTable::Angles(LazyTable::new(ticks, move |t| (degrees(t) * (PI / 180.0)) as f32))
            }
            _ if recipe.sum() == Some(SumPrecision::Radians) => {
                TurnTable::Angles(LazyTable::new(ticks, move |t| radians(degrees(t)) as f32))
            }
            _ => {
                let radians = move |t: u32| match recipe {
                    Recipe::LsLidar => f64::from(t) * tick * LS_DEGREE,
                    Recipe::RosRslidar => f64::from((f64::from(t as f32 / (0.5 * ticks as f32)) * PI) as f32),
                    _ => radians(f64::from(t) * tick),
                };
                TurnTable::Degrees(tick, LazyTable::new(ticks, move |t| cos_sin(radians(t))))
            }
        }
    }
}

fn cos_sin(radians: f64) -> [f64; 2] {
    [libm::cos(radians), libm::sin(radians)]
}

fn single_cos_sin(radians: f64) -> [f32; 2] {
    cos_sin(radians).map(|value| value as f32)
}

/// Cosine and sine of an angle of [`Recipe::HesaiSdk2`], in parts of a turn.
fn fine_cos_sin(angle: u32) -> [f32; 2] {
    single_cos_sin(f64::from(angle) * 2.0 * PI / f64::from(FINE_TICKS))
}

/// The angle of a tick in RoboSense's early driver.
fn early_radians(tick: u32, ticks: u32) -> f64 {
    radians(f64::from(tick) * f64::from((360.0 / f64::from(ticks)) as f32))
}

/// A laser's constants as the recipe uses them, with the [`TurnTable`] of the same recipe; with the table of
/// another, all positions are zeros.
#[derive(Clone, Copy, Debug)]
pub(super) enum Arithmetic {
    Single(Single),
    Double(Double),
    /// Cosine and sine of the elevation; the azimuth offset in ticks; metres from the axis and up; which
    /// products are rounded only with their sums.
    Tables {
        cos_v: f32,
        sin_v: f32,
        turned: u32,
        along: f32,
        up: f32,
        fused: Fused,
    },
    /// Cosine and sine of the elevation; the azimuth offset in ticks.
    Hesai {
        cos_v: f32,
        sin_v: f32,
        turned: u32,
    },
    /// Cosine and sine of the elevation; the azimuth offset in parts of a turn ([`FINE_TICKS`]).
    Fine {
        cos_v: f32,
        sin_v: f32,
        turned: u32,
    },
    /// As `Hesai`, in double precision.
    RosRslidar {
        cos_v: f64,
        sin_v: f64,
        turned: u32,
    },
    /// As `Tables`, in double precision; also the azimuth offset in degrees, and its cosine and sine.
    Ls {
        cos_v: f64,
        sin_v: f64,
        turned: u32,
        offset: f64,
        offsets: [f64; 2],
        along: f64,
        up: f64,
    },
    /// Cosine and sine of the elevation; the azimuth offset, to be added to the angle of the tick in radians
    /// or degrees; the program, which decides on the precision of ranges and coordinates.
    Sum {
        cos_v: f32,
        sin_v: f32,
        offset: f64,
        recipe: Recipe,
    },
    /// Cosine and sine of the elevation; the azimuth offset in degrees, and its cosine and sine; where the
    /// beam starts; whether direction and start are rounded.
    Ouster {
        cos_v: f64,
        sin_v: f64,
        offset: f64,
        offsets: [f64; 2],
        start: OusterStart,
        is_single: bool,
    },
}

/// A laser's constants by recipes in single precision.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Single {
    /// Cosine and sine of the elevation.
    pub cos_v: f32,
    pub sin_v: f32,
    /// Cosine and sine of the azimuth offset.
    pub offset: [f32; 2],
    /// In metres: -0.0 if the laser has no height, which changes no sum.
    pub up: f32,
    /// Whether ranges are products in double precision and x and y are negated.
    pub is_turned: bool,
    /// Whether x and y are products in double precision.
    pub in_double: bool,
}

/// A laser's constants by recipes in double precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Double {
    /// Cosine and sine of the elevation.
    pub cos_v: f64,
    pub sin_v: f64,
    /// The azimuth offset in degrees, and its cosine and sine.
    pub offset: f64,
    pub offsets: [f64; 2],
    pub axes: Axes,
    /// Whether ranges are products in single precision.
    pub single_range: bool,
}

impl Single {
    /// A range of whole steps, in metres; `step` is one.
    #[inline(always)]
    pub fn metres(&self, steps: u32, step: f64) -> f32 {
        if self.is_turned { (f64::from(steps) * step) as f32 } else { steps as f32 * step as f32 }
    }

    /// The coordinates, given cosine and sine of the tick.
    pub fn position(&self, [cos, sin]: [f32; 2], metres: f32) -> [f32; 3] {
        let [[mut x], [mut y], [z]] = Self::positions(&[self], [[cos], [sin]], [metres]);
        if self.in_double {
            let flat = f64::from(metres) * f64::from(self.cos_v);
            [x, y] = self.turned([cos, sin]).map(|turned| (flat * f64::from(turned)) as f32);
        }
        if self.is_turned { [-x, y, z] } else { [x, -y, z] }
    }

    /// The coordinates of several ranges by most recipes, but for the sign of y: each by a laser of its own, and
    /// given cosine and sine of its tick.
    #[inline(always)]
    pub fn positions<const N: usize>(
        lasers: &[&Self; N],
        [cos, sin]: [[f32; N]; 2],
        metres: [f32; N],
    ) -> [[f32; N]; 3] {
        let flat: [f32; N] = lanes(|i| metres[i] * lasers[i].cos_v);
        let turned = |i: usize| lasers[i].turned([cos[i], sin[i]]);
        [
            lanes(|i| flat[i] * turned(i)[0]),
            lanes(|i| flat[i] * turned(i)[1]),
            lanes(|i| metres[i] * lasers[i].sin_v + lasers[i].up),
        ]
    }

    /// Cosine and sine of a tick, turned by the azimuth offset; the same bits if there is none, because no
    /// recipe has a table with a zero whose sign is negative.
    #[inline(always)]
    fn turned(&self, [cos, sin]: [f32; 2]) -> [f32; 2] {
        let [cos_o, sin_o] = self.offset;
        [cos * cos_o + sin * sin_o, sin * cos_o - cos * sin_o]
    }
}

impl Double {
    /// A range of whole steps, in metres; `step` is one.
    #[inline(always)]
    pub fn metres(&self, steps: u32, step: f64) -> f64 {
        if self.single_range { f64::from(steps as f32 * step as f32) } else { f64::from(steps) * step }
    }

    /// The constants for [`Directions::nearly`].
    #[inline(always)]
    pub fn directions(&self) -> Directions<f64> {
        Directions { cos_v: self.cos_v, sin_v: self.sin_v, offset: self.offsets }
    }
}

/// Cosine and sine of the elevation, and those of the azimuth offset: of one laser, or of several.
#[derive(Clone, Copy, Debug)]
pub(super) struct Directions<V> {
    pub cos_v: V,
    pub sin_v: V,
    pub offset: [V; 2],
}

/// Nearly the results of a recipe in double precision.
pub(super) struct Near<V: Choose> {
    pub point: [V; 3],
    /// The largest error of x and of y; z has none.
    pub error: V,
    /// Where the signs of x and y are certain; the rest is right only there.
    pub has_signs: V::Mask,
}

impl<V: Choose> Directions<V> {
    /// Nearly the results of [`Arithmetic::double`], in a fraction of the time, given cosine and sine of the
    /// tick.
    #[inline(always)]
    pub fn nearly(self, axes: Axes, tick: [V; 2], metres: V) -> Near<V> {
        let turned = turned_by(tick, self.offset);
        let flat = metres * self.cos_v;
        let (cos, sin) = (flat * turned[0], flat * turned[1]);
        let [x, y] = match axes {
            Axes::XAhead => [cos, sin * -1.0],
            Axes::YAhead => [sin, cos],
        };
        Near {
            point: [x, y, metres * self.sin_v],
            error: flat.abs() * TURNED_ERROR,
            has_signs: has_signs(&turned),
        }
    }
}

/// The product of x that a compiler fused with the sum: of the start of the beam, or of the beam. If it is
/// either, those of y and z are fused, too.
#[derive(Clone, Copy, Debug)]
pub(super) enum Fused {
    Neither,
    Start,
    Beam,
}

impl Arithmetic {
    pub fn new(recipe: Recipe, laser: &Laser, origin: Origin, ticks: u32) -> Self {
        let elevation = radians(laser.elevation_degrees());
        let [along, up] = origin.metres();
        let in_parts = |degrees: f64, parts: u32| {
            let whole = round_ties_even(degrees / 360.0 * f64::from(parts)) as i64;
            whole.rem_euclid(i64::from(parts)) as u32
        };
        let in_ticks = |degrees: f64| in_parts(degrees, ticks);
        let turned = in_ticks(laser.azimuth_degrees());
        match recipe {
            Recipe::VelodyneRos
            | Recipe::VelodyneRosGlibc
            | Recipe::NebulaVelodyne
            | Recipe::Pandar64
            | Recipe::Pandar64InDegrees
            | Recipe::Apollo => {
                let [cos_v, sin_v] = recipe.cos_sin(elevation as f32);
                // These drivers turn back by their constants, where the formula here adds them.
                let offset = recipe.cos_sin(radians(-laser.azimuth_degrees()) as f32);
                let is_turned = matches!(recipe, Recipe::Pandar64 | Recipe::Pandar64InDegrees);
                let in_double = recipe == Recipe::Apollo;
                Arithmetic::Single(Single { cos_v, sin_v, offset, up: -0.0, is_turned, in_double })
            }
            Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e => {
                let single = |degrees: f64| radians(f64::from(degrees as f32)) as f32;
                let elevation = single(laser.elevation_degrees());
                let [cos_v, sin_v] = recipe.cos_sin(elevation);
                let offset = recipe.cos_sin(single(-laser.azimuth_degrees()));
                // A laser's height is where its beam, which passes through the focal point, meets the axis.
                let [cos, sin] = cos_sin(f64::from(elevation));
                let tangent = -sin / cos;
                let up = match recipe {
                    Recipe::VelodyneDecoder => along as f32 * tangent as f32,
                    _ => (round_ties_even(along * tangent * 1e5) / 1e5) as f32,
                };
                Arithmetic::Single(Single { cos_v, sin_v, offset, up, ..Single::default() })
            }
            Recipe::DoubleYAhead | Recipe::DoubleXAhead | Recipe::SingleRangeXAhead => {
                Arithmetic::Double(Double {
                    single_range: recipe == Recipe::SingleRangeXAhead,
                    cos_v: libm::cos(elevation),
                    sin_v: libm::sin(elevation),
                    offset: laser.azimuth_degrees(),
                    offsets: cos_sin(radians(laser.azimuth_degrees())),
                    axes: recipe.axes(),
                })
            }
            Recipe::RoboSense
            | Recipe::RoboSenseEarly
            | Recipe::RoboSenseFused
            | Recipe::RoboSenseEarlyFused => {
                let elevation = match recipe {
                    Recipe::RoboSenseEarly | Recipe::RoboSenseEarlyFused => {
                        early_radians(in_ticks(laser.elevation_degrees()), ticks)
                    }
                    _ => elevation,
                };
                let [cos_v, sin_v] = single_cos_sin(elevation);
                let fused = match recipe {
                    Recipe::RoboSenseFused => Fused::Start,
                    Recipe::RoboSenseEarlyFused => Fused::Beam,
                    _ => Fused::Neither,
                };
                Arithmetic::Tables { cos_v, sin_v, turned, along: along as f32, up: up as f32, fused }
            }
            Recipe::HesaiGeneralSdk => {
                let [cos_v, sin_v] = recipe.cos_sin(elevation as f32);
                Arithmetic::Hesai { cos_v, sin_v, turned }
            }
            Recipe::HesaiSdk2 => {
                let [elevation, turned] = [laser.elevation_degrees(), laser.azimuth_degrees()]
                    .map(|degrees| in_parts(degrees, FINE_TICKS));
                let [cos_v, sin_v] = fine_cos_sin(elevation);
                Arithmetic::Fine { cos_v, sin_v, turned }
            }
            Recipe::RosRslidar => {
                let [cos_v, sin_v] = cos_sin(f64::from(elevation as f32));
                Arithmetic::RosRslidar { cos_v, sin_v, turned }
            }
            Recipe::LsLidar => {
                let elevation = laser.elevation_degrees() * LS_DEGREE;
                let (cos_v, sin_v) = (libm::cos(elevation), libm::sin(elevation));
                let offset = laser.azimuth_degrees();
                let offsets = cos_sin(offset * LS_DEGREE);
                Arithmetic::Ls { cos_v, sin_v, turned, offset, offsets, along, up }
            }
            Recipe::Nebula => {
                let single = |degrees: f64| degrees as f32 * DEGREE;
                let [cos_v, sin_v] = recipe.cos_sin(single(laser.elevation_degrees()));
                Arithmetic::Sum { cos_v, sin_v, offset: single(laser.azimuth_degrees()).into(), recipe }
            }
            Recipe::Nebula2025
            | Recipe::NebulaJune2023Pandar40
            | Recipe::NebulaJanuary2023
            | Recipe::NebulaApril2023
            | Recipe::NebulaApril2023Pandar40
            | Recipe::Once => {
                let [elevation, azimuth] =
                    [laser.elevation_degrees(), laser.azimuth_degrees()].map(|angle| f64::from(angle as f32));
                let [cos_v, sin_v] = recipe.cos_sin(radians(elevation) as f32);
                let offset = match recipe.sum() {
                    Some(SumPrecision::Radians) => f64::from(radians(azimuth) as f32),
                    _ => azimuth,
                };
                Arithmetic::Sum { cos_v, sin_v, offset, recipe }
            }
            Recipe::Ouster | Recipe::OusterRos | Recipe::OusterEarly => Arithmetic::Ouster {
                cos_v: libm::cos(elevation),
                sin_v: libm::sin(elevation),
                offset: laser.azimuth_degrees(),
                offsets: cos_sin(radians(laser.azimuth_degrees())),
                start: OusterStart::new(recipe, origin),
                is_single: recipe == Recipe::OusterRos,
            },
        }
    }

    /// The coordinates in the file of a range of whole steps.
    #[inline(always)]
    pub fn position(&self, turn: &TurnTable, tick: u32, steps: u32, range_step_um: u32) -> [f32; 3] {
        let step = f64::from(range_step_um) * 1e-6;
        let (single, double) = (steps as f32 * step as f32, f64::from(steps) * step);
        match self {
            Arithmetic::Single(laser) => self.single(turn, tick, laser.metres(steps, step)),
            Arithmetic::Tables { .. } => self.single(turn, tick, single),
            Arithmetic::Sum { recipe: Recipe::NebulaJune2023Pandar40, .. } => {
                self.sum(turn, tick, single.into())
            }
            Arithmetic::Sum { .. } => self.sum(turn, tick, double),
            Arithmetic::Hesai { .. } | Arithmetic::Fine { .. } => self.hesai(turn, tick, double),
            Arithmetic::Double(_) | Arithmetic::Ls { .. } | Arithmetic::RosRslidar { .. } => {
                let metres = self.metres(steps, range_step_um);
                self.double_by_table(turn, tick, metres)
                    .unwrap_or_else(|| self.double(turn, tick, metres).map(|v| v as f32))
            }
            Arithmetic::Ouster { .. } => {
                let millimetres = f64::from(steps) * (f64::from(range_step_um) * 1e-3);
                self.ouster_by_table(turn, tick, millimetres)
                    .unwrap_or_else(|| self.ouster(turn, tick, millimetres))
            }
        }
    }

    /// The coordinates of [`position`](Self::position) in the precision in which they are computed, before
    /// they are rounded.
    pub fn unrounded(&self, turn: &TurnTable, tick: u32, steps: u32, range_step_um: u32) -> [f64; 3] {
        match self {
            Arithmetic::Double(_) | Arithmetic::Ls { .. } | Arithmetic::RosRslidar { .. } => {
                self.double(turn, tick, self.metres(steps, range_step_um))
            }
            _ => self.position(turn, tick, steps, range_step_um).map(f64::from),
        }
    }

    /// Nearly the same, in a fraction of the time, and the largest error of x and y; z has none. `None` for
    /// some ticks, and for most recipes.
    #[inline(always)]
    pub fn nearly_unrounded(
        &self,
        turn: &TurnTable,
        tick: u32,
        steps: u32,
        range_step_um: u32,
    ) -> Option<([f64; 3], f64)> {
        let (Arithmetic::Double(laser), TurnTable::Degrees(_, table)) = (self, turn) else { return None };
        let metres = self.metres(steps, range_step_um);
        let near = laser.directions().nearly(laser.axes, *table.get(tick), metres);
        near.has_signs.then_some((near.point, near.error))
    }

    /// A range of whole steps, in metres, as recipes in double precision compute it.
    #[inline(always)]
    fn metres(&self, steps: u32, range_step_um: u32) -> f64 {
        let step = f64::from(range_step_um) * 1e-6;
        match self {
            Arithmetic::Double(laser) => laser.metres(steps, step),
            Arithmetic::RosRslidar { .. } => f64::from(steps as f32 * step as f32),
            _ => f64::from(steps) * step,
        }
    }

    /// The result of [`double`](Self::double), rounded to single precision, but from the cosine and the sine
    /// of the tick: in a fraction of the time. `None` in the rare cases in which the different errors might
    /// show.
    #[inline(always)]
    fn double_by_table(&self, turn: &TurnTable, tick: u32, metres: f64) -> Option<[f32; 3]> {
        let TurnTable::Degrees(_, table) = turn else { return None };
        match self {
            Arithmetic::Double(laser) => {
                let near = laser.directions().nearly(laser.axes, *table.get(tick), metres);
                let [x, y, z] = near.point;
                let are_sure = near.has_signs && is_sure(x, near.error) && is_sure(y, near.error);
                are_sure.then_some([x as f32, y as f32, z as f32])
            }
            Arithmetic::Ls { cos_v, sin_v, turned, offsets: [cos_o, sin_o], along, up, .. } => {
                let [cos, sin] = *table.get(turned_tick(tick, *turned, table.len()));
                let start = turned_by([cos, sin], [*cos_o, -sin_o]);
                let [cos_s, sin_s] = Some(start).filter(has_signs)?;
                let (flat, error) = (metres * cos_v, along.abs() * TURNED_ERROR);
                Some([
                    sure(flat * sin + along * sin_s, error)?,
                    sure(flat * cos + along * cos_s, error)?,
                    (metres * sin_v + up) as f32,
                ])
            }
            Arithmetic::RosRslidar { .. } => Some(self.double(turn, tick, metres).map(|value| value as f32)),
            _ => None,
        }
    }

    /// The result of [`ouster`](Self::ouster) from the cosine and the sine of the tick, as by
    /// [`double_by_table`](Self::double_by_table).
    #[inline]
    fn ouster_by_table(&self, turn: &TurnTable, tick: u32, millimetres: f64) -> Option<[f32; 3]> {
        let (
            Arithmetic::Ouster { cos_v, sin_v, offsets, start, is_single, .. },
            TurnTable::Degrees(_, table),
        ) = (self, turn)
        else {
            return None;
        };
        let [cos_t, sin_t] = *table.get(tick);
        let [cos, sin] = Some(turned_by([cos_t, sin_t], *offsets)).filter(has_signs)?;
        let along = start.along;
        let [direction, start] = start.ray([cos_t, -sin_t], [cos * cos_v, -sin * cos_v, *sin_v]);
        let mut position = [0.0; 3];
        for axis in 0..3 {
            // The height is computed in the same way by both.
            let error = if axis < 2 { TURNED_ERROR * 1e-3 } else { 0.0 };
            position[axis] = match is_single {
                true => {
                    let direction = sure(direction[axis], error)?;
                    millimetres as f32 * direction + sure(start[axis], along.abs() * error)?
                }
                false => {
                    let error = (millimetres.abs() + along.abs()) * error;
                    sure(millimetres * direction[axis] + start[axis], error)?
                }
            };
        }
        Some(position)
    }

    /// The coordinates by the recipes of Ouster.
    fn ouster(&self, turn: &TurnTable, tick: u32, millimetres: f64) -> [f32; 3] {
        let is_single = matches!(self, Arithmetic::Ouster { is_single: true, .. });
        let [direction, start] = self.ray(turn, tick);
        [0, 1, 2].map(|axis| match is_single {
            true => millimetres as f32 * direction[axis] as f32 + start[axis] as f32,
            false => (millimetres * direction[axis] + start[axis]) as f32,
        })
    }

    /// What a millimetre of range adds to a position, and the position at range 0, in metres.
    fn ray(&self, turn: &TurnTable, tick: u32) -> [[f64; 3]; 2] {
        let (Arithmetic::Ouster { cos_v, sin_v, offset, start, .. }, TurnTable::Degrees(degrees, _)) =
            (self, turn)
        else {
            return [[0.0; 3]; 2];
        };
        let encoder = f64::from(tick) * degrees;
        let ([cos_t, sin_t], [cos, sin]) = (cos_sin(radians(encoder)), cos_sin(radians(encoder + offset)));
        start.ray([cos_t, -sin_t], [cos * cos_v, -sin * cos_v, *sin_v])
    }

    /// The coordinates of any range, in metres.
    pub fn position_at(&self, turn: &TurnTable, tick: u32, metres: f64) -> [f64; 3] {
        match self {
            Arithmetic::Double(_) | Arithmetic::Ls { .. } | Arithmetic::RosRslidar { .. } => {
                self.double(turn, tick, metres)
            }
            Arithmetic::Ouster { .. } => {
                let [direction, start] = self.ray(turn, tick);
                [0, 1, 2].map(|axis| metres * 1e3 * direction[axis] + start[axis])
            }
            Arithmetic::Sum { .. } => self.sum(turn, tick, metres).map(f64::from),
            Arithmetic::Hesai { .. } | Arithmetic::Fine { .. } => {
                self.hesai(turn, tick, metres).map(f64::from)
            }
            _ => self.single(turn, tick, metres as f32).map(f64::from),
        }
    }

    /// The coordinates by the recipes that take cosine and sine of a sum of angles.
    fn sum(&self, turn: &TurnTable, tick: u32, metres: f64) -> [f32; 3] {
        let Arithmetic::Sum { cos_v, sin_v, offset, recipe } = *self else { return [0.0; 3] };
        let angle = match turn {
            TurnTable::Angles(angles) => *angles.get(tick) + offset as f32,
            TurnTable::Degrees(degrees, _) => radians(offset + f64::from(tick) / (1.0 / degrees)) as f32,
            TurnTable::Tables(_) | TurnTable::Fine(_) => return [0.0; 3],
        };
        let [cos, sin] = recipe.cos_sin(angle);
        let single = metres as f32;
        let metres = match recipe {
            Recipe::Once | Recipe::NebulaApril2023Pandar40 => metres,
            Recipe::NebulaApril2023 => single.into(),
            _ => {
                let flat = single * cos_v;
                return [flat * sin, flat * cos, single * sin_v];
            }
        };
        let [cos_v, sin_v, cos, sin] = [cos_v, sin_v, cos, sin].map(f64::from);
        let flat = metres * cos_v;
        [flat * sin, flat * cos, metres * sin_v].map(|metres| metres as f32)
    }

    /// The coordinates by the recipes of Hesai's own programs.
    fn hesai(&self, turn: &TurnTable, tick: u32, metres: f64) -> [f32; 3] {
        match (self, turn) {
            (Arithmetic::Hesai { cos_v, sin_v, turned }, TurnTable::Tables(table)) => {
                let [cos, sin] = *table.get(turned_tick(tick, *turned, table.len()));
                let flat = (metres * f64::from(*cos_v)) as f32;
                [flat * sin, flat * cos, (metres * f64::from(*sin_v)) as f32]
            }
            (Arithmetic::Fine { cos_v, sin_v, turned }, TurnTable::Fine(ticks)) => {
                let parts = u64::from(tick) * u64::from(FINE_TICKS) / u64::from(*ticks) + u64::from(*turned);
                let [cos, sin] = fine_cos_sin((parts % u64::from(FINE_TICKS)) as u32);
                let (single, flat) = (metres as f32, metres as f32 * cos_v);
                [flat * sin, flat * cos, single * sin_v]
            }
            _ => [0.0; 3],
        }
    }

    /// The coordinates computed in single precision.
    #[inline(always)]
    fn single(&self, turn: &TurnTable, tick: u32, metres: f32) -> [f32; 3] {
        match (self, turn) {
            (Arithmetic::Single(laser), TurnTable::Tables(table)) => laser.position(*table.get(tick), metres),
            (Arithmetic::Tables { cos_v, sin_v, turned, along, up, fused }, TurnTable::Tables(table)) => {
                let [cos, sin] = *table.get(turned_tick(tick, *turned, table.len()));
                let [cos_t, sin_t] = *table.get(tick);
                let flat = metres * cos_v;
                let x = match fused {
                    Fused::Neither => {
                        let (x, y) = (flat * cos + along * cos_t, -flat * sin - along * sin_t);
                        return [x, y, metres * sin_v + up];
                    }
                    Fused::Start => libm::fmaf(*along, cos_t, flat * cos),
                    Fused::Beam => libm::fmaf(flat, cos, along * cos_t),
                };
                [x, libm::fmaf(-flat, sin, -(along * sin_t)), libm::fmaf(metres, *sin_v, *up)]
            }
            _ => [0.0; 3],
        }
    }

    /// The coordinates computed in double precision.
    fn double(&self, turn: &TurnTable, tick: u32, metres: f64) -> [f64; 3] {
        let TurnTable::Degrees(degrees, table) = turn else { return [0.0; 3] };
        match self {
            Arithmetic::Double(Double { cos_v, sin_v, offset, axes, .. }) => {
                let angle = radians(f64::from(tick) * degrees + offset);
                let (sin, cos) = (libm::sin(angle), libm::cos(angle));
                let flat = metres * cos_v;
                match axes {
                    Axes::XAhead => [flat * cos, -(flat * sin), metres * sin_v],
                    Axes::YAhead => [flat * sin, flat * cos, metres * sin_v],
                }
            }
            Arithmetic::Ls { cos_v, sin_v, turned, offset, along, up, .. } => {
                let angle = f64::from(turned_tick(tick, *turned, table.len())) * degrees;
                let (turned, start) = (angle * LS_DEGREE, (angle - offset) * LS_DEGREE);
                let flat = metres * cos_v;
                [
                    flat * libm::sin(turned) + along * libm::sin(start),
                    flat * libm::cos(turned) + along * libm::cos(start),
                    metres * sin_v + up,
                ]
            }
            Arithmetic::RosRslidar { cos_v, sin_v, turned } => {
                let [cos, sin] = *table.get(turned_tick(tick, *turned, table.len()));
                let flat = metres * cos_v;
                [flat * cos, -(flat * sin), metres * sin_v]
            }
            _ => [0.0; 3],
        }
    }
}

/// Where an Ouster's beams start, in millimetres.
#[derive(Clone, Copy, Debug)]
pub(super) struct OusterStart {
    /// From the axis, in the direction of the tick.
    along: f64,
    /// By how much ranges are more than the distances that heights are computed from.
    crossing: f64,
    up: f64,
}

impl OusterStart {
    fn new(recipe: Recipe, origin: Origin) -> Self {
        let [along, up] = [origin.along_um, origin.up_um].map(|um| f64::from(um) * 1e-3);
        OusterStart { along, crossing: recipe.crossing(along), up }
    }

    /// A beam: what a millimetre of range adds to a position, and the position at range 0, in metres. `beam`
    /// is the direction of the beam, `ahead` that of its tick.
    fn ray(&self, ahead: [f64; 2], beam: [f64; 3]) -> [[f64; 3]; 2] {
        let OusterStart { along, crossing, up } = *self;
        let start = |ahead, crossing, beam, above| (along * ahead - crossing * beam + above) * 1e-3;
        [
            beam.map(|beam| beam * 1e-3),
            [
                start(ahead[0], along, beam[0], 0.0),
                start(ahead[1], along, beam[1], 0.0),
                start(0.0, crossing, beam[2], up),
            ],
        ]
    }
}

/// An upper bound of the difference between cosine and sine by [`turned_by`] and those of the rounded sum of
/// the angles: the angles, of up to two turns in degrees, are rounded to 3e-14 degrees and converted to
/// radians with errors of 3e-15; cosines and sines are rounded to 1e-16.
pub(super) const TURNED_ERROR: f64 = 2e-14;

/// Cosine and sine of the sum of two angles.
#[inline(always)]
fn turned_by<V: Real>([cos, sin]: [V; 2], [cos_o, sin_o]: [V; 2]) -> [V; 2] {
    [cos * cos_o - sin * sin_o, sin * cos_o + cos * sin_o]
}

/// A tick turned by an offset in ticks; both are less than a turn. Divisions are slow.
#[inline(always)]
fn turned_tick(tick: u32, turned: u32, turn: u32) -> u32 {
    let sum = tick + turned;
    if sum < turn { sum } else { sum - turn }
}

/// Whether neither cosine nor sine by [`turned_by`] is so small that its sign is uncertain.
#[inline(always)]
fn has_signs<V: Choose>(turned: &[V; 2]) -> V::Mask {
    turned[0].abs().is_above(TURNED_ERROR) & turned[1].abs().is_above(TURNED_ERROR)
}

/// Whether the same float32 is nearest to all numbers within `error` of a value.
#[inline(always)]
fn is_sure(value: f64, error: f64) -> bool {
    let (low, high) = ((value - error) as f32, (value + error) as f32);
    // If the error is 0, adding it changes no more than the sign of a zero.
    (error == 0.0) | (low.to_bits() == high.to_bits())
}

/// The float32 that is nearest to all numbers within `error` of a value; `None` if there is more than one.
#[inline]
pub(super) fn sure(value: f64, error: f64) -> Option<f32> {
    is_sure(value, error).then_some(value as f32)
}

/// Upper limit of ranges, in steps.
pub(super) const MOST_LOCATED: u32 = 1 << 24;

/// A range in metres as a number of steps; `None` if it is too short or too long.
pub(super) fn whole_steps(metres: f64, range_step_m: f64) -> Option<u32> {
    let steps = round_ties_even(metres / range_step_m);
    (steps >= 1.0 && steps < f64::from(MOST_LOCATED)).then_some(steps as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    /// The formula as it is written, without tables of unrounded values.
    fn written_out(arithmetic: &Arithmetic, turn: &TurnTable, tick: u32, steps: u32, um: u32) -> [f32; 3] {
        let step = f64::from(um) * 1e-6;
        let metres = match arithmetic {
            Arithmetic::Double(Double { single_range: true, .. }) | Arithmetic::RosRslidar { .. } => {
                f64::from(steps as f32 * step as f32)
            }
            Arithmetic::Ouster { .. } => {
                return arithmetic.ouster(turn, tick, f64::from(steps) * (f64::from(um) * 1e-3));
            }
            _ => f64::from(steps) * step,
        };
        arithmetic.double(turn, tick, metres).map(|v| v as f32)
    }

    #[test]
    fn tables_change_no_bit() {
        let mut random = Rng::keyed(1, &[]);
        let (mut by_table, mut all) = (0, 0);
        for recipe in Recipe::ALL {
            for number in 0..40 {
                let ticks = [36_000, 1024, 4000, 7][number % 4];
                let turn = TurnTable::new(recipe, ticks);
                if !matches!(turn, TurnTable::Degrees(..)) || recipe.sum().is_some() {
                    continue;
                }
                let mut angle = |most: usize| random.below(2 * most) as i64 - most as i64;
                let laser = Laser {
                    elevation: angle(90_000_000_000),
                    azimuth: [0, 1_042_000_000, angle(20_000_000_000), angle(360_000_000_000)]
                        [number / 4 % 4],
                };
                let origin = match number % 5 {
                    0 => Origin::default(),
                    _ => Origin { along_um: angle(50_000) as i32, up_um: angle(50_000) as i32 },
                };
                let arithmetic = Arithmetic::new(recipe, &laser, origin, ticks);
                for _ in 0..500 {
                    let (tick, steps) = (random.below(ticks as usize) as u32, random.below(60_000) as u32);
                    // Whole quarters of a turn, where a coordinate is nearly zero; and ranges of 0.
                    let tick = if steps % 16 == 0 { tick / (ticks / 4).max(1) * (ticks / 4) } else { tick };
                    let steps = if steps % 50 == 0 { 0 } else { steps };
                    let expected = written_out(&arithmetic, &turn, tick % ticks, steps, 2000);
                    let position = arithmetic.position(&turn, tick % ticks, steps, 2000);
                    let bits = |position: [f32; 3]| position.map(f32::to_bits);
                    assert_eq!(
                        bits(position),
                        bits(expected),
                        "{recipe:?} {laser:?} {origin:?} {tick} {steps}"
                    );
                    let metres = f64::from(steps) * 2e-3;
                    by_table += usize::from(match recipe {
                        _ if recipe.measures_from_axis() => {
                            arithmetic.ouster_by_table(&turn, tick % ticks, f64::from(steps) * 2.0).is_some()
                        }
                        _ => arithmetic.double_by_table(&turn, tick % ticks, metres).is_some(),
                    });
                    all += 1;
                }
            }
        }
        assert!(by_table > all * 3 / 4, "{by_table} of {all}");
    }

    /// The sum of the turned parts of a negative zero would be a positive one.
    #[test]
    fn no_table_has_a_negative_zero() {
        for recipe in Recipe::ALL {
            for ticks in [36_000, 4000, 1024, 7] {
                if let TurnTable::Tables(table) = TurnTable::new(recipe, ticks) {
                    let values = (0..ticks).flat_map(|tick| *table.get(tick));
                    assert!(
                        values.into_iter().all(|value| value.to_bits() != (-0f32).to_bits()),
                        "{recipe:?}"
                    );
                }
            }
        }
    }
}
