//! The calibrated sensor model: the formula of a Velodyne HDL-64E with constants for each beam.
//!
//! For beam `k` with elevation V, range offset b, height c, sideways offset h and azimuth
//! offset rot, a range of `n` steps and an azimuth of `t` ticks:
//!
//! ```text
//! d   = n * range_step
//! rho = d * cos V + b                    horizontal distance from the axis
//! z   = d * sin V + c
//! phi = t * tick + rot + atan(h / rho)
//! x, y = rho * cos phi, rho * sin phi
//! ```
//!
//! Encoder and decoder evaluate it with the same operations on the same quantised constants;
//! the hot path holds only `+ - * / sqrt`, which every platform rounds alike.

use std::f64::consts::TAU;

use super::Coordinates;
use super::single_precision::{Arithmetic, Refinement};
use crate::error::{Error, Result};
use crate::rounding::round_ties_even;
use crate::varint::{read_signed, read_unsigned, write_signed, write_unsigned};

/// Radians of one unit of a quantised angle.
const ANGLE_UNIT: f64 = 1.0 / (1u64 << 32) as f64;
/// Metres of one unit of a quantised length.
const LENGTH_UNIT: f64 = 1.0 / (1u64 << 24) as f64;
/// Quantised constants are below this: 4 rad, or 1 km.
const LARGEST_CONSTANT: u64 = 1 << 34;
/// More beams than any scanner has.
const MOST_BEAMS: u64 = 1024;
/// The number that stands for float32 coordinates by single-precision arithmetic, beside those of the grids.
const SINGLE_PRECISION: u64 = 2;
/// The finest azimuth grid allowed: 0.001 degree.
pub const MOST_TICKS: u64 = 360_000;

/// The constants of one beam, quantised as they stand in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BeamConstants {
    /// V, in 2^-32 rad.
    pub elevation: i64,
    /// b, in 2^-24 m.
    pub range_offset: i64,
    /// c, in 2^-24 m.
    pub height: i64,
    /// h, in 2^-24 m.
    pub side_offset: i64,
    /// rot, in 2^-32 rad.
    pub azimuth_offset: i64,
    /// Ticks from this beam's azimuth to the column of its firing: column tick = t + shift.
    pub column_shift: i64,
}

impl BeamConstants {
    /// Quantises (V, b, c, h, rot), in radians and metres.
    pub fn quantise([v, b, c, h, rot]: [f64; 5]) -> Self {
        let angle = |a: f64| (a / ANGLE_UNIT).round() as i64;
        let length = |l: f64| (l / LENGTH_UNIT).round() as i64;
        BeamConstants {
            elevation: angle(v),
            range_offset: length(b),
            height: length(c),
            side_offset: length(h),
            azimuth_offset: angle(rot),
            column_shift: 0,
        }
    }

    fn fields(&mut self) -> [&mut i64; 6] {
        [
            &mut self.elevation,
            &mut self.range_offset,
            &mut self.height,
            &mut self.side_offset,
            &mut self.azimuth_offset,
            &mut self.column_shift,
        ]
    }
}

/// One beam's constants as the formula uses them.
#[derive(Clone, Copy, Debug)]
struct Beam {
    cos_v: f64,
    sin_v: f64,
    b: f64,
    c: f64,
    h: f64,
    rot: f64,
    cos_rot: f64,
    sin_rot: f64,
}

impl Beam {
    fn new(q: &BeamConstants) -> Self {
        let v = q.elevation as f64 * ANGLE_UNIT;
        let rot = q.azimuth_offset as f64 * ANGLE_UNIT;
        Beam {
            cos_v: libm::cos(v),
            sin_v: libm::sin(v),
            b: q.range_offset as f64 * LENGTH_UNIT,
            c: q.height as f64 * LENGTH_UNIT,
            h: q.side_offset as f64 * LENGTH_UNIT,
            rot,
            cos_rot: libm::cos(rot),
            sin_rot: libm::sin(rot),
        }
    }

    /// z at horizontal distance `rho`, both in metres.
    fn height_at(&self, rho: f64) -> f64 {
        (rho - self.b) * (self.sin_v / self.cos_v) + self.c
    }
}

/// Where a point is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The nearest beam.
    pub row: usize,
    /// The nearest column tick.
    pub column_tick: u32,
    /// The range at which that beam passes nearest to it.
    pub metres: f64,
    /// How far it is from that beam and tick, in radians.
    pub off: f64,
}

/// The scanner of a sequence.
#[derive(Clone, Debug)]
pub struct SensorModel {
    /// The grid of the file's coordinates.
    pub coordinates: Coordinates,
    /// Azimuth ticks a turn (4000 for 0.09 degrees).
    pub ticks: u32,
    /// One range step, in micrometres (2000 for 2 mm); [`FLOAT_RANGES`]: steps are the bits of ranges
    /// in metres as float32.
    pub range_step_um: u32,
    /// Constants of each beam, in the order of the rows of the file.
    constants: Vec<BeamConstants>,
    beams: Vec<Beam>,
    /// cos and sin of each tick.
    tick_directions: Vec<[f64; 2]>,
    /// Refinements of each beam, if the file's coordinates come from single-precision arithmetic.
    refinements: Option<Vec<Refinement>>,
    single: Vec<Arithmetic>,
}

impl PartialEq for SensorModel {
    fn eq(&self, other: &Self) -> bool {
        self.coordinates == other.coordinates
            && self.ticks == other.ticks
            && self.range_step_um == other.range_step_um
            && self.constants == other.constants
            && self.refinements == other.refinements
    }
}

impl SensorModel {
    /// A model from quantised constants. `ticks` must not be 0.
    pub fn new(
        coordinates: Coordinates,
        ticks: u32,
        range_step_um: u32,
        constants: Vec<BeamConstants>,
    ) -> Self {
        let beams = constants.iter().map(Beam::new).collect();
        let angle = |t: u32| f64::from(t) / f64::from(ticks) * TAU;
        let tick_directions = (0..ticks).map(|t| [libm::cos(angle(t)), libm::sin(angle(t))]).collect();
        let (refinements, single) = (None, Vec::new());
        SensorModel {
            coordinates,
            ticks,
            range_step_um,
            constants,
            beams,
            tick_directions,
            refinements,
            single,
        }
    }

    /// The same scanner, whose file was written by single-precision arithmetic with constants that are sharper
    /// by these, one for each beam.
    pub fn with_refinements(mut self, refinements: Vec<Refinement>) -> Self {
        let of_row = |(row, refinement)| self.single_precision(row).refined(refinement);
        self.single = refinements.iter().take(self.rows()).enumerate().map(of_row).collect();
        self.refinements = Some(refinements);
        self
    }

    /// The constants of beam `row` as single-precision arithmetic has them, but not refined.
    pub(super) fn single_precision(&self, row: usize) -> Arithmetic {
        let Beam { sin_v, cos_v, b, c, h, rot, .. } = self.beams[row];
        Arithmetic::new([sin_v, cos_v, b, c, h, rot], self.ticks)
    }

    /// The same scanner, its ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        SensorModel { range_step_um, ..self }
    }

    /// Number of beams, which is the number of rows of the range image.
    pub fn rows(&self) -> usize {
        self.beams.len()
    }

    /// The elevation of beam `row`, in radians.
    pub fn elevation(&self, row: usize) -> f64 {
        self.constants[row].elevation as f64 * ANGLE_UNIT
    }

    /// The height above the scanner's centre at which beam `row` leaves it, in metres.
    pub fn height(&self, row: usize) -> f64 {
        self.constants[row].height as f64 * LENGTH_UNIT
    }

    /// The unit vector along which beam `row` looks at azimuth tick `tick`, as if all beams left one
    /// point.
    #[inline]
    pub fn direction(&self, row: usize, tick: u32) -> [f64; 3] {
        let beam = &self.beams[row];
        let [cos_t, sin_t] = self.tick_directions[tick as usize];
        let (x, y) =
            (cos_t * beam.cos_rot - sin_t * beam.sin_rot, sin_t * beam.cos_rot + cos_t * beam.sin_rot);
        [x * beam.cos_v, y * beam.cos_v, beam.sin_v]
    }

    /// One range step, in metres; 0 if ranges are float32.
    pub fn range_step_m(&self) -> f64 {
        f64::from(self.range_step_um) * 1e-6
    }

    /// A range of `steps`, in metres.
    #[inline]
    pub fn metres(&self, steps: u32) -> f64 {
        match self.range_step_um {
            FLOAT_RANGES => f64::from(f32::from_bits(steps)),
            _ => f64::from(steps) * self.range_step_m(),
        }
    }

    /// The longest range that a range image of this sensor holds, in steps.
    pub fn most_steps(&self) -> u32 {
        if self.range_step_um == FLOAT_RANGES { FARTHEST.to_bits() } else { MOST_STEPS }
    }

    /// The steps nearest to a positive range in metres, as far as the range image goes.
    pub fn nearest_steps(&self, metres: f64) -> u32 {
        let metres = metres.min(f64::from(FARTHEST));
        match self.range_step_um {
            FLOAT_RANGES => (metres as f32).to_bits(),
            step => round_ties_even(metres * (1e6 / f64::from(step))).min(f64::from(MOST_STEPS)) as u32,
        }
    }

    /// The steps nearest to a range in metres, for the encoder. None if there are none.
    pub fn steps(&self, metres: f64) -> Option<u32> {
        let steps = match self.range_step_um {
            FLOAT_RANGES => f64::from((metres as f32).to_bits()),
            step => round_ties_even(metres * (1e6 / f64::from(step))),
        };
        let in_reach = metres > 0.0 && steps >= 1.0 && steps <= f64::from(self.most_steps());
        in_reach.then_some(steps as u32)
    }

    /// The column tick (0 to `ticks`, exclusive) of azimuth tick `tick` of beam `row`.
    pub fn column_tick(&self, row: usize, tick: i64) -> u32 {
        (tick + self.constants[row].column_shift).rem_euclid(i64::from(self.ticks)) as u32
    }

    /// The azimuth tick (0 to `ticks`, exclusive) of beam `row` at a column tick.
    pub fn tick_of_column(&self, row: usize, column_tick: u32) -> u32 {
        (i64::from(column_tick) - self.constants[row].column_shift).rem_euclid(i64::from(self.ticks)) as u32
    }

    /// The formula: x, y and z in metres, before they are rounded to the file's grid.
    pub fn point(&self, row: usize, tick: u32, steps: u32) -> [f64; 3] {
        self.point_at(row, tick, self.metres(steps))
    }

    /// phi of the formula, in radians from 0 to 2 pi: the order of the points of a row in the file.
    pub fn azimuth(&self, row: usize, tick: u32, steps: u32) -> f64 {
        let beam = &self.beams[row];
        let rho = self.metres(steps) * beam.cos_v + beam.b;
        let azimuth = f64::from(tick) / f64::from(self.ticks) * TAU + beam.rot + small_atan(beam.h / rho);
        if azimuth < 0.0 {
            azimuth + TAU
        } else if azimuth >= TAU {
            azimuth - TAU
        } else {
            azimuth
        }
    }

    /// The formula inverted: the azimuth tick and range steps that come nearest to a point of beam
    /// `row` (metres), for the encoder. None if the point has no such range.
    pub fn invert(&self, row: usize, [x, y, z]: [f64; 3]) -> Option<(u32, u32)> {
        let beam = &self.beams[row];
        let rho = (x * x + y * y).sqrt();
        let d = (rho - beam.b) * beam.cos_v + (z - beam.c) * beam.sin_v;
        let steps = self.steps(d)?;
        let azimuth = y.atan2(x) - small_atan(beam.h / rho) - beam.rot;
        let tick = round_ties_even(azimuth * (f64::from(self.ticks) / TAU));
        tick.is_finite().then(|| ((tick as i64).rem_euclid(i64::from(self.ticks)) as u32, steps))
    }

    /// As [`invert`](Self::invert); quicker if the tick is near `hint`.
    #[inline]
    pub fn invert_near(&self, row: usize, point: [f64; 3], hint: u32) -> Option<(u32, u32)> {
        /// Ticks over which an angle is as good as its sine.
        const NEAR: f64 = 16.0;
        let [x, y, z] = point;
        let (beam, ticks) = (&self.beams[row], f64::from(self.ticks));
        let rho = (x * x + y * y).sqrt();
        let (cos_a, sin_a) = self.heading(beam, hint);
        let turned = (y * cos_a - x * sin_a - beam.h) / rho * (ticks / TAU);
        if !(turned.abs() < NEAR && x * cos_a + y * sin_a > 0.0 && ticks > 16.0 * NEAR) {
            return self.invert(row, point);
        }
        let steps = self.steps((rho - beam.b) * beam.cos_v + (z - beam.c) * beam.sin_v)?;
        let tick = i64::from(hint) + round_ties_even(turned) as i64;
        let turn = i64::from(self.ticks);
        let tick = if tick < 0 {
            tick + turn
        } else if tick >= turn {
            tick - turn
        } else {
            tick
        };
        Some((tick as u32, steps))
    }

    /// Cosine and sine of a beam's azimuth at a tick.
    #[inline]
    fn heading(&self, beam: &Beam, tick: u32) -> (f64, f64) {
        let [cos_t, sin_t] = self.tick_directions[tick as usize];
        (cos_t * beam.cos_rot - sin_t * beam.sin_rot, sin_t * beam.cos_rot + cos_t * beam.sin_rot)
    }

    /// Where a point (metres) near beam `hint`'s cone is seen, for both sides; the same on every platform.
    /// None if it is on no cone, or too near.
    pub fn locate(&self, hint: usize, [x, y, z]: [f64; 3]) -> Option<Sighting> {
        /// Metres; nearer than this is inside the scanner.
        const NEAREST: f64 = 0.5;
        let rho = (x * x + y * y).sqrt();
        let miss = |row: usize| self.beams.get(row).map(|beam| (beam.height_at(rho) - z).abs());
        let (mut row, mut least) = (hint, miss(hint)?);
        // The beams of real scanners are in the order of their elevations.
        for step in [1, -1] {
            while let Some((next, off)) = row.checked_add_signed(step).and_then(|row| Some((row, miss(row)?)))
            {
                if off >= least {
                    break;
                }
                (row, least) = (next, off);
            }
        }
        let beam = &self.beams[row];
        let metres = (rho - beam.b) * beam.cos_v + (z - beam.c) * beam.sin_v;
        if !(metres > NEAREST && metres < f64::from(FARTHEST)) {
            return None;
        }
        let azimuth = libm::atan2(y, x) - small_atan(beam.h / rho) - beam.rot;
        let tick = azimuth * (f64::from(self.ticks) / TAU);
        let nearest = round_ties_even(tick);
        let aside = (tick - nearest).abs() * (TAU / f64::from(self.ticks));
        let column_tick = self.column_tick(row, nearest as i64);
        Some(Sighting { row, column_tick, metres, off: least / metres + aside })
    }

    /// The formula for a range in metres that need not be a whole number of steps.
    #[inline]
    pub fn point_at(&self, row: usize, tick: u32, metres: f64) -> [f64; 3] {
        let beam = &self.beams[row];
        let rho = metres * beam.cos_v + beam.b;
        let (cos_a, sin_a) = self.heading(beam, tick);
        // Turned by atan(h / rho), whose cosine and sine are rho and h over their hypotenuse.
        let along = rho / (rho * rho + beam.h * beam.h).sqrt();
        [
            along * (cos_a * rho - sin_a * beam.h),
            along * (sin_a * rho + cos_a * beam.h),
            metres * beam.sin_v + beam.c,
        ]
    }

    /// The position in the file, as well as the model gives it, in metres; by single-precision arithmetic if the
    /// file was written so, else by the formula. The range need not be a whole number of steps.
    #[inline]
    pub fn position_at(&self, row: usize, tick: u32, metres: f64) -> [f64; 3] {
        match self.single.get(row) {
            Some(single) => single.position(tick, metres).map(f64::from),
            None => self.point_at(row, tick, metres),
        }
    }

    /// Whether the model has single-precision arithmetic.
    pub fn is_single_precision(&self) -> bool {
        self.refinements.is_some()
    }

    /// The beam whose cone passes nearest to a point at distance `rho` and height `z` (metres),
    /// looking at `hint` first.
    pub fn nearest_beam(&self, rho: f64, z: f64, hint: usize) -> usize {
        /// Metres; closer than half the distance of two beams' cones at any range.
        const ON_CONE: f64 = 0.004;
        let miss = |row: usize| (self.beams[row].height_at(rho) - z).abs();
        for row in [hint, hint + 1] {
            if row < self.rows() && miss(row) < ON_CONE {
                return row;
            }
        }
        (0..self.rows()).min_by(|&a, &b| miss(a).total_cmp(&miss(b))).unwrap_or(0)
    }

    /// The payload of the model's record in the stream.
    pub fn to_record(&self) -> Vec<u8> {
        let mut record = Vec::new();
        self.write_to(&mut record);
        record
    }

    /// Writes the model's record of the stream.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        let coordinates =
            if self.is_single_precision() { SINGLE_PRECISION } else { self.coordinates.to_code() };
        write_unsigned(out, coordinates);
        write_unsigned(out, u64::from(self.ticks));
        write_unsigned(out, u64::from(self.range_step_um));
        write_unsigned(out, self.constants.len() as u64);
        for mut beam in self.constants.iter().copied() {
            beam.fields().into_iter().for_each(|field| write_signed(out, *field));
        }
        self.refinements.iter().flatten().for_each(|refinement| refinement.write_to(out));
    }

    /// Reads what [`write_to`](Self::write_to) wrote.
    ///
    /// # Errors
    /// If the record is cut short or holds values that no scanner has.
    pub fn read_from(bytes: &mut &[u8]) -> Result<Self> {
        let (coordinates, is_single_precision) = match read_unsigned(bytes, "sensor model")? {
            code @ 0..2 => (Coordinates::from_code(code), false),
            SINGLE_PRECISION => (Coordinates::Float32, true),
            other => return Err(Error::corrupt(format!("sensor model: unknown coordinate grid {other}"))),
        };
        let mut bounded = |what: &str, min, max| match read_unsigned(bytes, "sensor model")? {
            got if (min..=max).contains(&got) => Ok(got as u32),
            got => Err(Error::LimitExceeded { what: what.to_owned(), got, max }),
        };
        let ticks = bounded("sensor model: ticks a turn", 1, MOST_TICKS)?;
        let range_step_um = bounded("sensor model: range step in micrometres", 0, MOST_RANGE_STEP_UM)?;
        let rows = bounded("sensor model: beams", 1, MOST_BEAMS)?;
        let mut constants = Vec::new();
        for _ in 0..rows {
            let mut beam = BeamConstants::default();
            for field in beam.fields() {
                *field = read_signed(bytes, "sensor model")?;
                if field.unsigned_abs() > LARGEST_CONSTANT {
                    return Err(Error::corrupt("sensor model: a constant is out of range"));
                }
            }
            constants.push(beam);
        }
        let model = Self::new(coordinates, ticks, range_step_um, constants);
        if !is_single_precision {
            return Ok(model);
        }
        let refinements = (0..rows).map(|_| Refinement::read_from(bytes)).collect::<Result<_>>()?;
        Ok(model.with_refinements(refinements))
    }

    /// The column shifts, for the fit to fill in.
    pub(super) fn set_column_shifts(&mut self, shifts: &[i64]) {
        self.constants.iter_mut().zip(shifts).for_each(|(beam, &shift)| beam.column_shift = shift);
    }
}

/// The longest range that any range image holds, in steps.
pub const MOST_STEPS: u32 = (1 << 24) - 1;

/// The value of [`SensorModel::range_step_um`] for ranges that are float32.
pub const FLOAT_RANGES: u32 = 0;

/// The coarsest range step, in micrometres.
pub const MOST_RANGE_STEP_UM: u64 = 1_000_000;

/// Metres: the longest range of ranges that are float32.
const FARTHEST: f32 = 1e6;

/// atan for the small angles of the sideways offset: a fixed polynomial, the same on every
/// platform. Off by less than 1e-9 rad below 0.05 rad; what is larger only spoils the order
/// that the file is expected to have, never the result.
pub(super) fn small_atan(tangent: f64) -> f64 {
    let square = tangent * tangent;
    tangent * (1.0 - square * (1.0 / 3.0 - square * (1.0 / 5.0 - square / 7.0)))
}
