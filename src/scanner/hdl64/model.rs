//! The calibrated scanner: the formula of a Velodyne HDL-64E with constants for each beam.
//! FORMAT.md 3.2.
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
//! Encoder and decoder evaluate it with the same operations on the same quantised constants; the hot path
//! uses only `+ - * / sqrt`, which are rounded in the same way on every platform.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::formula::{Formula, Tick, small_atan};
use super::single_precision::{Refinement, SingleBeam};
use crate::ground::doubles::Array;
use crate::ground::error::{Error, Result};
use crate::ground::floats::round_ties_even;
use crate::ground::lanes::lanes;
use crate::ground::lazy_table::LazyTable;
use crate::ground::varint::{read_signed, read_unsigned, read_within, write_signed, write_unsigned};
use crate::scanner::{
    AT_ONCE, CoordinateGrid, FLOAT_RANGES, MOST_RANGE_STEP_UM, MOST_ROWS, MOST_STEPS, MOST_TICKS, Return,
};

/// The unit of quantised angles, in radians.
const ANGLE_UNIT: f64 = 1.0 / (1u64 << 32) as f64;
/// The unit of quantised lengths, in metres.
const LENGTH_UNIT: f64 = 1.0 / (1u64 << 24) as f64;
/// The limit of quantised constants: 4 rad, or 1 km.
const LARGEST_CONSTANT: u64 = 1 << 34;
/// The codes of the arithmetic: whole millimetres, and float32 coordinates computed in double and in single
/// precision.
const MILLIMETRE: u64 = 0;
const FLOAT32: u64 = 1;
const SINGLE_PRECISION: u64 = 2;

/// The constants of one beam, quantised as in the stream.
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
    /// Ticks between this beam's azimuth and the column of its firing: column tick = t + shift.
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

    /// (V, b, c, h, rot), in radians and metres.
    pub(crate) fn values(&self) -> [f64; 5] {
        let angle = |units: i64| units as f64 * ANGLE_UNIT;
        let length = |units: i64| units as f64 * LENGTH_UNIT;
        [
            angle(self.elevation),
            length(self.range_offset),
            length(self.height),
            length(self.side_offset),
            angle(self.azimuth_offset),
        ]
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

/// The beam and column tick nearest to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The nearest beam.
    pub row: usize,
    /// The nearest column tick.
    pub column_tick: u32,
    /// The range at which that beam passes closest to the point.
    pub metres: f64,
    /// The point's distance from that beam and tick, in radians.
    pub off: f64,
}

/// The scanner of a sequence.
#[derive(Clone, Debug)]
pub struct Hdl64 {
    /// The grid of the file's coordinates.
    pub coordinates: CoordinateGrid,
    /// Azimuth ticks in a turn (4000 for 0.09 degrees).
    pub ticks: u32,
    /// One range step, in micrometres (2000 for 2 mm); [`FLOAT_RANGES`]: steps are the bits of ranges
    /// in metres as float32.
    pub range_step_um: u32,
    /// The constants of each beam, in the order of the rows of the file.
    constants: Vec<BeamConstants>,
    pub(crate) beams: Vec<Formula>,
    pub(crate) ticks_of_turn: Arc<LazyTable<Tick>>,
    /// The column shift of each beam, without whole turns: 0 to `ticks`, exclusive.
    shifts: Vec<u32>,
    /// Refinements of each beam, if the file's coordinates come from single-precision arithmetic.
    refinements: Option<Vec<Refinement>>,
    single: Vec<SingleBeam>,
}

impl PartialEq for Hdl64 {
    fn eq(&self, other: &Self) -> bool {
        self.coordinates == other.coordinates
            && self.ticks == other.ticks
            && self.range_step_um == other.range_step_um
            && self.constants == other.constants
            && self.refinements == other.refinements
    }
}

/// The angle of a tick, in radians.
#[inline(always)]
fn angle_of(tick: u32, ticks: u32) -> f64 {
    f64::from(tick) / f64::from(ticks) * TAU
}

impl Hdl64 {
    /// A scanner with these quantised constants. `ticks` must not be 0.
    pub fn new(
        coordinates: CoordinateGrid,
        ticks: u32,
        range_step_um: u32,
        constants: Vec<BeamConstants>,
    ) -> Self {
        let beams = constants.iter().map(Formula::new).collect();
        let ticks_of_turn = Arc::new(LazyTable::new(ticks, move |tick| Tick::at(angle_of(tick, ticks))));
        let (refinements, single, shifts) = (None, Vec::new(), Vec::new());
        let mut model = Hdl64 {
            coordinates,
            ticks,
            range_step_um,
            constants,
            beams,
            ticks_of_turn,
            shifts,
            refinements,
            single,
        };
        model.shifts = model.constants.iter().map(|beam| model.within_turn(beam.column_shift)).collect();
        model
    }

    /// This scanner, with coordinates computed in single precision, and with refinements of the constants
    /// for each beam.
    pub fn with_refinements(mut self, refinements: Vec<Refinement>) -> Self {
        let of_row = |(row, refinement)| self.single_precision(row).refined(refinement);
        self.single = refinements.iter().take(self.rows()).enumerate().map(of_row).collect();
        self.refinements = Some(refinements);
        self
    }

    /// The constants of beam `row` as used in single precision, without refinements.
    pub(crate) fn single_precision(&self, row: usize) -> SingleBeam {
        let Formula { sin_v, cos_v, b, c, h, rot, .. } = self.beams[row];
        SingleBeam::new([sin_v, cos_v, b, c, h, rot], self.ticks)
    }

    /// This scanner, with ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        Hdl64 { range_step_um, ..self }
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

    /// The unit vector of beam `row` at azimuth tick `tick`, as if all beams started at one point.
    #[inline]
    pub fn direction(&self, row: usize, tick: u32) -> [f64; 3] {
        let beam = &self.beams[row];
        let (x, y) = beam.heading(*self.ticks_of_turn.get(tick));
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

    /// The longest range in a range image of this scanner, in steps.
    pub fn most_steps(&self) -> u32 {
        if self.range_step_um == FLOAT_RANGES { FARTHEST.to_bits() } else { MOST_STEPS }
    }

    /// The steps nearest to a positive range in metres, within the limits of the range image.
    pub fn nearest_steps(&self, metres: f64) -> u32 {
        let metres = metres.min(f64::from(FARTHEST));
        match self.range_step_um {
            FLOAT_RANGES => (metres as f32).to_bits(),
            step => round_ties_even(metres * (1e6 / f64::from(step))).min(f64::from(MOST_STEPS)) as u32,
        }
    }

    /// The steps nearest to a range in metres, for the encoder. `None` if the range is impossible.
    pub fn steps(&self, metres: f64) -> Option<u32> {
        let steps = match self.range_step_um {
            FLOAT_RANGES => f64::from((metres as f32).to_bits()),
            step => round_ties_even(metres * (1e6 / f64::from(step))),
        };
        let in_reach = metres > 0.0 && steps >= 1.0 && steps <= f64::from(self.most_steps());
        in_reach.then_some(steps as u32)
    }

    /// The column tick (0 to `ticks`, exclusive) of azimuth tick `tick` of beam `row`.
    #[inline]
    pub fn column_tick(&self, row: usize, tick: i64) -> u32 {
        self.within_turn(tick + i64::from(self.shifts[row]))
    }

    /// The azimuth tick (0 to `ticks`, exclusive) of beam `row` at a column tick in the same range.
    #[inline]
    pub fn tick_of_column(&self, row: usize, column_tick: u32) -> u32 {
        self.ticks_of_columns(row)(column_tick)
    }

    /// As [`tick_of_column`](Self::tick_of_column), for many columns.
    #[inline(always)]
    pub fn ticks_of_columns(&self, row: usize) -> impl Fn(u32) -> u32 + use<> {
        let (ticks, shift) = (self.ticks, self.shifts[row]);
        move |column_tick| {
            debug_assert!(column_tick < ticks);
            let turn = if column_tick < shift { ticks } else { 0 };
            column_tick + turn - shift
        }
    }

    /// The inverse of [`ticks_of_columns`](Self::ticks_of_columns).
    #[inline(always)]
    pub fn columns_of_ticks(&self, row: usize) -> impl Fn(u32) -> u32 + use<> {
        let (ticks, shift) = (self.ticks, self.shifts[row]);
        move |tick| {
            debug_assert!(tick < ticks);
            let column_tick = tick + shift;
            column_tick - if column_tick >= ticks { ticks } else { 0 }
        }
    }

    /// The first column tick at which the azimuth of beam `row` has passed 0; it increases from there on.
    /// Sideways offsets, whose effect depends on the range, may still put single points out of order.
    pub fn first_column_tick(&self, row: usize) -> u32 {
        let turned = self.beams[row].rot * (f64::from(self.ticks) / TAU);
        self.column_tick(row, (-turned).ceil() as i64)
    }

    /// A tick reduced to one turn; usually it is at most one turn away.
    #[inline]
    fn within_turn(&self, tick: i64) -> u32 {
        let turn = i64::from(self.ticks);
        if (-turn..2 * turn).contains(&tick) {
            (tick + if tick < 0 { turn } else { 0 } - if tick >= turn { turn } else { 0 }) as u32
        } else {
            tick.rem_euclid(turn) as u32
        }
    }

    /// The formula: x, y and z in metres, before they are rounded to the file's grid.
    pub fn point(&self, row: usize, tick: u32, steps: u32) -> [f64; 3] {
        self.point_at(row, tick, self.metres(steps))
    }

    /// Converts ranges from steps to metres.
    #[inline(always)]
    fn metres_of<const N: usize>(&self, steps: [u32; N]) -> [f64; N] {
        match self.range_step_um {
            FLOAT_RANGES => lanes(|i| self.metres(steps[i])),
            _ => lanes(|i| f64::from(steps[i]) * self.range_step_m()),
        }
    }

    /// phi of the formula, in radians from 0 to 2 pi, for returns of one row in the order of the file.
    #[inline(always)]
    pub fn fill_azimuths(&self, row: usize, returns: &[Return], azimuths: &mut [f64]) {
        let (blocks, rest) = returns.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = azimuths.as_chunks_mut::<AT_ONCE>();
        for (block, azimuths) in blocks.iter().zip(of_blocks) {
            *azimuths = self.azimuths(row, block);
        }
        for (found, azimuth) in rest.iter().zip(of_rest) {
            [*azimuth] = self.azimuths(row, std::array::from_ref(found));
        }
    }

    #[inline(always)]
    fn azimuths<const N: usize>(&self, row: usize, returns: &[Return; N]) -> [f64; N] {
        let metres = self.metres_of(lanes(|i| returns[i].steps));
        self.beams[row].azimuths(lanes(|i| angle_of(returns[i].tick, self.ticks)), metres)
    }

    /// The inverse of the formula, for the encoder: the azimuth tick and range steps nearest to a point of
    /// beam `row` (metres). `None` if no range is possible.
    pub fn invert(&self, row: usize, [x, y, z]: [f64; 3]) -> Option<(u32, u32)> {
        let beam = &self.beams[row];
        let rho = (x * x + y * y).sqrt();
        let steps = self.steps(beam.range(rho, z))?;
        let azimuth = libm::atan2(y, x);
        azimuth.is_finite().then(|| (self.nearest_tick(row, azimuth, rho), steps))
    }

    /// The tick of beam `row` nearest to an azimuth, in radians, at distance `rho` from the axis, in metres.
    pub(crate) fn nearest_tick(&self, row: usize, azimuth: f64, rho: f64) -> u32 {
        let beam = &self.beams[row];
        let turned = azimuth - small_atan(beam.h / rho) - beam.rot;
        self.within_turn(round_ties_even(turned * (f64::from(self.ticks) / TAU)) as i64)
    }

    /// The beam and column tick nearest to a point (metres) near the cone of beam `hint`; the same on every
    /// platform, because both sides use it. `None` if the point is on no cone, or too near.
    pub fn locate(&self, hint: usize, [x, y, z]: [f64; 3]) -> Option<Sighting> {
        /// In metres; nearer points are inside the scanner.
        const NEAREST: f64 = 0.5;
        /// Near the axis, a beam's offset divided by the distance may be anything.
        const MOST_TICK: f64 = 1e9;
        let rho = (x * x + y * y).sqrt();
        let miss = |row: usize| self.beams.get(row).map(|beam| (beam.height_at(rho) - z).abs());
        let (mut row, mut least) = (hint, miss(hint)?);
        // The beams of real scanners are ordered by elevation.
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
        let metres = beam.range(rho, z);
        if !(metres > NEAREST && metres < f64::from(FARTHEST)) {
            return None;
        }
        let azimuth = libm::atan2(y, x) - small_atan(beam.h / rho) - beam.rot;
        let tick = azimuth * (f64::from(self.ticks) / TAU);
        if tick.is_nan() || tick.abs() >= MOST_TICK {
            return None;
        }
        let nearest = round_ties_even(tick);
        let aside = (tick - nearest).abs() * (TAU / f64::from(self.ticks));
        let column_tick = self.column_tick(row, nearest as i64);
        Some(Sighting { row, column_tick, metres, off: least / metres + aside })
    }

    /// The formula for a range in metres that need not be a whole number of steps.
    #[inline]
    pub fn point_at(&self, row: usize, tick: u32, metres: f64) -> [f64; 3] {
        self.beams[row].point(*self.ticks_of_turn.get(tick), metres)
    }

    /// Computes the positions of returns of beam `row` as accurately as the formula allows
    /// ([`position_at`](Self::position_at)). `stored` converts a coordinate in metres to its stored form. The
    /// points are `offset_m` metres farther away than their steps.
    #[inline(always)]
    pub fn fill_positions(
        &self,
        row: usize,
        (returns, offset_m): (&[Return], f64),
        stored: impl Fn(f64) -> f32,
        positions: &mut [[f32; 3]],
    ) {
        let (blocks, rest) = returns.as_chunks::<AT_ONCE>();
        let (of_blocks, of_rest) = positions.as_chunks_mut::<AT_ONCE>();
        let single = self.single.get(row);
        for (block, positions) in blocks.iter().zip(of_blocks) {
            let ticks: [u32; AT_ONCE] = lanes(|i| block[i].tick);
            let near: [f64; AT_ONCE] = self.metres_of(lanes(|i| block[i].steps));
            let metres: [f64; AT_ONCE] = lanes(|i| near[i] + offset_m);
            let [x, y, z]: [[f64; AT_ONCE]; 3] = match single {
                Some(single) => {
                    let [x, y, z] = single.positions(ticks, metres);
                    [lanes(|i| x[i].into()), lanes(|i| y[i].into()), lanes(|i| z[i].into())]
                }
                None => self.points(row, ticks, metres),
            };
            *positions = lanes(|i| [stored(x[i]), stored(y[i]), stored(z[i])]);
        }
        for (found, position) in rest.iter().zip(of_rest) {
            let metres = self.metres(found.steps) + offset_m;
            *position = self.position_at(row, found.tick, metres).map(&stored);
        }
    }

    /// x, y and z, in metres, of points of beam `row` by the formula.
    #[inline(always)]
    fn points<const N: usize>(&self, row: usize, ticks: [u32; N], metres: [f64; N]) -> [[f64; N]; 3] {
        let ticks = self.ticks_of_turn.at(ticks);
        let tick = Tick { cos: Array(lanes(|i| ticks[i].cos)), sin: Array(lanes(|i| ticks[i].sin)) };
        let [Array(x), Array(y), Array(z)] = self.beams[row].point(tick, Array(metres));
        [x, y, z]
    }

    /// The position as accurately as the formula allows, in metres; in single precision if the file was
    /// computed that way. The range need not be a whole number of steps.
    #[inline]
    pub fn position_at(&self, row: usize, tick: u32, metres: f64) -> [f64; 3] {
        match self.single.get(row) {
            Some(single) => single.position(tick, metres).map(f64::from),
            None => self.point_at(row, tick, metres),
        }
    }

    /// Whether coordinates are computed in single precision.
    pub fn is_single_precision(&self) -> bool {
        self.refinements.is_some()
    }

    /// The beam whose cone passes closest to a point at distance `rho` and height `z` (metres); the search
    /// starts at `hint`.
    pub fn nearest_beam(&self, rho: f64, z: f64, hint: usize) -> usize {
        let miss = |row: usize| (self.beams[row].height_at(rho) - z).abs();
        for row in [hint, hint + 1] {
            if row < self.rows() && miss(row) < ON_CONE {
                return row;
            }
        }
        (0..self.rows()).min_by(|&a, &b| miss(a).total_cmp(&miss(b))).unwrap_or(0)
    }

    /// The payload of the scanner's record in the stream.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        self.write_to(&mut payload);
        payload
    }

    /// Writes the payload of the scanner's record in the stream.
    pub fn write_to(&self, out: &mut Vec<u8>) {
        let arithmetic = match self.coordinates {
            _ if self.is_single_precision() => SINGLE_PRECISION,
            CoordinateGrid::Millimetre => MILLIMETRE,
            _ => FLOAT32,
        };
        write_unsigned(out, arithmetic);
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
        let (coordinates, is_single_precision) = match read_unsigned(bytes, "scanner model")? {
            MILLIMETRE => (CoordinateGrid::Millimetre, false),
            FLOAT32 => (CoordinateGrid::Float32, false),
            SINGLE_PRECISION => (CoordinateGrid::Float32, true),
            other => return Err(Error::corrupt(format!("scanner model: unknown coordinate grid {other}"))),
        };
        let ticks = read_within(bytes, "scanner model: ticks a turn", 1..=MOST_TICKS)? as u32;
        let range_step_um =
            read_within(bytes, "scanner model: range step in micrometres", 0..=MOST_RANGE_STEP_UM)? as u32;
        let rows = read_within(bytes, "scanner model: beams", 1..=MOST_ROWS)? as u32;
        let mut constants = Vec::new();
        for _ in 0..rows {
            let mut beam = BeamConstants::default();
            for field in beam.fields() {
                *field = read_signed(bytes, "scanner model")?;
                if field.unsigned_abs() > LARGEST_CONSTANT {
                    return Err(Error::corrupt("scanner model: a constant is out of range"));
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

    /// Sets the column shifts, which the fit determines last.
    pub(crate) fn set_column_shifts(&mut self, shifts: &[i64]) {
        self.constants.iter_mut().zip(shifts).for_each(|(beam, &shift)| beam.column_shift = shift);
        self.shifts = shifts.iter().map(|&shift| self.within_turn(shift)).collect();
    }
}

/// In metres: less than half the distance between the cones of two beams at any range.
pub(crate) const ON_CONE: f64 = 0.004;

/// The longest float32 range, in metres.
const FARTHEST: f32 = 1e6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_on_the_axis_is_seen_nowhere() {
        let mut beam = BeamConstants::quantise([0.0, -1.0, 0.0, 0.026, 0.0]);
        beam.column_shift = 1;
        let scanner = Hdl64::new(CoordinateGrid::Millimetre, 4000, 2000, vec![beam]);
        assert!(scanner.locate(0, [0.0, 0.0, 0.0]).is_none());
        assert!(scanner.locate(0, [0.0, 9.0, 0.0]).is_some());
    }
}
