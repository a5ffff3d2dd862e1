//! Scanners whose files hold firing after firing: those of Velodyne except the HDL-64E, of Hesai, RoboSense
//! and LSLiDAR, and Ouster's by columns. FORMAT.md 3.3.
//!
//! A firing is one column of the range image: one shot of each laser, in a fixed order (the *slots*), at one
//! azimuth tick or at ticks that advance from slot to slot. If all beams start in one point, then for a laser
//! with elevation E and azimuth offset O, a range of `n` steps and an azimuth of `t` ticks:
//!
//! ```text
//! d = n * range_step
//! A = t * tick + O
//! x, y, z = d * cos E * cos A, -d * cos E * sin A, d * sin E      or with the axes of another program
//! ```
//!
//! The [`Recipe`] of the program that wrote the file defines in which precision and in which order this was
//! computed. The beams of some scanners start away from the axis ([`Origin`]), most in the direction of the
//! tick, not of the beam.

mod arithmetic;
mod blocks;
mod blur;
mod columns;
mod constants;
mod fit;
mod glibc;
mod mounting;
mod off_axis;
mod order;
mod ouster;
mod payload;
mod projection;
mod recipe;
mod side_by_side;
mod timing;

pub use columns::FiringColumnModel;
pub use constants::Moved;
pub(in crate::scanner) use constants::MovedBy;
pub use fit::{fit, fit_moved};
pub use mounting::{Mounting, TransformOrder, fit as fit_mounted};
pub use projection::Sight;
pub use recipe::{Origin, Recipe};
pub use timing::Timing;

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;
use std::sync::Arc;

use rayon::prelude::*;

use pulp::Simd;

use crate::ground::angle;
use crate::ground::doubles::{Choose, Doubles};
use crate::ground::floats::round_ties_even;
use crate::scanner::hdl64::{BeamConstants, Hdl64};
use crate::scanner::{CoordinateGrid, RangeImage, Return, median};
use arithmetic::{Arithmetic, MOST_LOCATED, TurnTable};
use recipe::Axes;
use side_by_side::or_zero;
use timing::{BlockTimes, Span};

/// Degrees per unit of a laser's constants.
const ANGLE_UNIT: f64 = 1e-9;
/// A thousandth of a degree in this unit.
const THOUSANDTH: i64 = 1_000_000;

/// The constants of a laser, as stored in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Laser {
    /// E, in 1e-9 degrees.
    pub elevation: i64,
    /// O, in 1e-9 degrees.
    pub azimuth: i64,
}

impl Laser {
    /// E in degrees.
    fn elevation_degrees(&self) -> f64 {
        self.elevation as f64 * ANGLE_UNIT
    }

    /// O in degrees.
    fn azimuth_degrees(&self) -> f64 {
        self.azimuth as f64 * ANGLE_UNIT
    }
}

/// The direction of a laser, or of several, for locating their measurements.
#[derive(Clone, Copy, Debug, Default)]
struct Bearing<V = f64> {
    /// Cosine and sine of E.
    cos: V,
    sin: V,
    /// O, in radians.
    offset: V,
    /// Where its beam starts: metres beside the axis and ahead of it, relative to the azimuth of the beam.
    beside: V,
    ahead: V,
    /// Metres above the origin.
    up: V,
    /// By how many metres a range is more than the distance from there.
    farther: V,
}

impl Bearing {
    fn new(recipe: Recipe, laser: &Laser, origin: Origin) -> Self {
        let (elevation, offset) =
            (laser.elevation_degrees().to_radians(), laser.azimuth_degrees().to_radians());
        let [along, up] = origin.metres();
        let aside = if recipe.starts_in_beam() { 0.0 } else { offset };
        let (sin, cos) = libm::sincos(elevation);
        Bearing {
            cos,
            sin,
            offset,
            beside: along * libm::sin(aside),
            ahead: along * libm::cos(aside),
            up: up + recipe.higher(along, sin),
            farther: recipe.farther(along, cos),
        }
    }
}

impl<S: Simd> Bearing<Doubles<S>> {
    /// Those of the lasers of some rows.
    #[inline(always)]
    fn of_rows(simd: S, bearings: &[Bearing], row: impl Fn(usize) -> usize) -> Self {
        let all = |value: fn(&Bearing) -> f64| Doubles::of(simd, |lane| value(&bearings[row(lane)]));
        Bearing {
            cos: all(|bearing| bearing.cos),
            sin: all(|bearing| bearing.sin),
            offset: all(|bearing| bearing.offset),
            beside: all(|bearing| bearing.beside),
            ahead: all(|bearing| bearing.ahead),
            up: all(|bearing| bearing.up),
            farther: all(|bearing| bearing.farther),
        }
    }
}

/// The measurement of a laser that is nearest to a point, or those of several lasers.
#[derive(Clone, Copy, Debug)]
struct Measurement<V> {
    /// A whole number; below 1 if there is no such measurement.
    steps: V,
    /// A whole number below that of a turn; anything else if the azimuth is too large or not a number.
    tick: V,
    /// Radians from the tick to the point.
    aside: V,
}

/// The properties of a scanner of firings that all its lasers share.
#[derive(Clone, Debug, PartialEq)]
pub struct Build {
    /// The program that wrote the files.
    pub recipe: Recipe,
    /// Azimuth ticks per turn; not 0.
    pub ticks: u32,
    /// One range step, in micrometres.
    pub range_step_um: u32,
    /// The grid of the file's coordinates.
    pub coordinates: CoordinateGrid,
    /// Where beams start.
    pub origin: Origin,
    /// How the azimuth advances within a block.
    pub timing: Timing,
    /// How points were moved to the frame of a vehicle, if they were.
    pub mounting: Option<Box<Mounting>>,
}

/// A scanner of firings.
#[derive(Clone, Debug)]
pub struct Firings {
    build: Build,
    /// One per row, from the highest to the lowest.
    lasers: Vec<Laser>,
    /// The row of each slot.
    rows_of_slots: Vec<u32>,
    /// The row of each line of the file, if it holds row after row; empty if it holds firing after firing.
    rows_of_lines: Vec<u32>,
    /// The ticks by which each row lags behind its column, less than a turn; empty if none does.
    lags: Vec<u32>,
    // Derived from the fields above.
    slots_of_rows: Vec<u32>,
    arithmetic: Vec<Arithmetic>,
    bearings: Vec<Bearing>,
    turn: Arc<TurnTable>,
    passed: BlockTimes,
}

impl PartialEq for Firings {
    fn eq(&self, other: &Self) -> bool {
        self.to_payload() == other.to_payload()
    }
}

impl Firings {
    /// A scanner with these lasers, from the highest to the lowest, which fire in this order: `rows_of_slots`
    /// must be a permutation of the rows.
    pub fn new(build: Build, lasers: Vec<Laser>, rows_of_slots: Vec<u32>) -> Self {
        let mut slots_of_rows = vec![0; lasers.len()];
        (0u32..).zip(&rows_of_slots).for_each(|(slot, &row)| slots_of_rows[row as usize] = slot);
        let of_laser = |laser: &Laser| Arithmetic::new(build.recipe, laser, build.origin, build.ticks);
        let arithmetic = lasers.iter().map(of_laser).collect();
        let bearings = lasers.iter().map(|laser| Bearing::new(build.recipe, laser, build.origin)).collect();
        let turn = Arc::new(TurnTable::new(build.recipe, build.ticks));
        let (rows_of_lines, lags) = (Vec::new(), Vec::new());
        let passed = BlockTimes::new(&build.timing, lasers.len());
        Firings {
            build,
            lasers,
            rows_of_slots,
            rows_of_lines,
            lags,
            slots_of_rows,
            arithmetic,
            bearings,
            turn,
            passed,
        }
    }

    /// A scanner without lasers, for which the fit looks.
    fn without_lasers(build: Build) -> Self {
        Firings::new(build, Vec::new(), Vec::new())
    }

    /// This scanner for files that hold row after row, in this order: `rows_of_lines` must be a permutation
    /// of the rows, or empty for files that hold firing after firing.
    pub fn line_by_line(self, rows_of_lines: Vec<u32>) -> Self {
        Firings { rows_of_lines, ..self }
    }

    /// This scanner with rows that lag behind their columns by these ticks: columns then hold points that
    /// were not fired together, as in Ouster's destaggered clouds, or the lasers look that far back and the
    /// program adds this to the tick. `lags` must have one element per row, all less than a turn, or be
    /// empty.
    pub fn lagging(self, lags: Vec<u32>) -> Self {
        Firings { lags, ..self }
    }

    /// This scanner with firings that begin at this slot of the order.
    fn begun_at(self, slot: usize) -> Self {
        let mut rows_of_slots = self.rows_of_slots;
        rows_of_slots.rotate_left(slot);
        Firings::new(self.build, self.lasers, rows_of_slots)
            .line_by_line(self.rows_of_lines)
            .lagging(self.lags)
    }

    /// This scanner with another timing of its firings.
    fn with_timing(self, timing: Timing) -> Self {
        let passed = BlockTimes::new(&timing, self.rows());
        Firings { build: Build { timing, ..self.build }, passed, ..self }
    }

    /// This scanner by each of the recipes, for files that hold firing after firing; the angles of its lasers
    /// are rounded to thousandths of degrees, as manufacturers write them. `None` if most of its angles are not
    /// near thousandths.
    pub fn as_written_by_all_recipes(&self) -> Option<Vec<Self>> {
        /// Largest median distance; that of angles that have more digits is a quarter of a thousandth.
        const NEAR: f64 = 0.1 * THOUSANDTH as f64;
        let written = |angle: i64| (angle + THOUSANDTH / 2).div_euclid(THOUSANDTH) * THOUSANDTH;
        let off = self.lasers.iter().map(|laser| (laser.elevation - written(laser.elevation)).abs() as f64);
        if median(off) > NEAR {
            return None;
        }
        let lasers = self.lasers.iter();
        let lasers = lasers.map(|l| Laser { elevation: written(l.elevation), azimuth: written(l.azimuth) });
        let lasers: Vec<Laser> = lasers.collect();
        let by = |recipe: Recipe| {
            let build = Build { recipe, ..self.build.clone() };
            Firings::new(build, lasers.clone(), self.rows_of_slots.clone())
        };
        Some(Recipe::ALL.into_par_iter().map(by).collect())
    }

    /// A scanner with this laser alone, for the fit.
    fn of_laser(&self, laser: Laser) -> Self {
        let arithmetic =
            vec![Arithmetic::new(self.build.recipe, &laser, self.build.origin, self.build.ticks)];
        Firings {
            build: Build { timing: Timing::Together, mounting: None, ..self.build },
            lasers: vec![laser],
            arithmetic,
            rows_of_slots: vec![0],
            rows_of_lines: Vec::new(),
            lags: Vec::new(),
            slots_of_rows: vec![0],
            bearings: vec![Bearing::new(self.build.recipe, &laser, self.build.origin)],
            turn: self.turn.clone(),
            passed: BlockTimes::default(),
        }
    }

    /// The properties that all lasers share.
    pub fn build(&self) -> &Build {
        &self.build
    }

    /// The lasers, row by row.
    #[cfg(any(test, feature = "internals"))]
    pub fn lasers(&self) -> &[Laser] {
        &self.lasers
    }

    /// E of each row, in radians.
    pub fn elevations(&self) -> impl Iterator<Item = f64> {
        self.lasers.iter().map(|laser| laser.elevation_degrees().to_radians())
    }

    /// An HDL-64E-like scanner that sees a range image as this one does, except for the direction of rotation
    /// and the origin of the beams: for pictures and regions, not for positions.
    pub fn likeness(&self) -> Hdl64 {
        let beam = |laser: &Laser| {
            let offset = laser.azimuth_degrees().to_radians();
            let shift = round_ties_even(offset / self.radians());
            let turned = offset - shift * self.radians();
            let constants = [laser.elevation_degrees().to_radians(), 0.0, 0.0, 0.0, turned];
            BeamConstants { column_shift: -shift as i64, ..BeamConstants::quantise(constants) }
        };
        let beams = self.lasers.iter().map(beam).collect();
        Hdl64::new(CoordinateGrid::Float32, self.build.ticks, self.build.range_step_um, beams)
    }

    /// Number of lasers, which is the number of rows of the range image.
    pub fn rows(&self) -> usize {
        self.lasers.len()
    }

    /// One range step, in metres.
    pub fn range_step_m(&self) -> f64 {
        f64::from(self.build.range_step_um) * 1e-6
    }

    /// This scanner, its ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        Firings { build: Build { range_step_um, ..self.build }, ..self }
    }

    /// The azimuth tick of a laser in a column.
    #[inline(always)]
    fn tick(&self, row: usize, base: u32, span: Span) -> u32 {
        self.tick_of_slot(self.slots_of_rows[row] as usize, row, base, span)
    }

    /// The same, given also the laser's slot.
    #[inline(always)]
    fn tick_of_slot(&self, slot: usize, row: usize, base: u32, Span { ticks: span, firing }: Span) -> u32 {
        let place = firing as usize * self.rows() + slot;
        let behind = self.build.ticks - self.lag(row);
        self.within_turn(self.build.timing.tick(&self.passed, place, base, span) + behind)
    }

    /// Reduces a tick of a few turns to the first turn.
    #[inline]
    fn within_turn(&self, tick: u32) -> u32 {
        let ticks = self.build.ticks;
        // Divisions are slow, and subtracting one turn is usually enough.
        match tick.checked_sub(ticks) {
            None => tick,
            Some(tick) if tick < ticks => tick,
            Some(tick) => tick % ticks,
        }
    }

    /// The ticks by which a row is behind its column.
    fn lag(&self, row: usize) -> u32 {
        self.lags.get(row).copied().unwrap_or(0)
    }

    /// The measurement of this laser that is nearest to a position in metres, in steps and ticks; `None` if
    /// there is no such range.
    fn locate(&self, row: usize, position: [f64; 3]) -> Option<(u32, u32)> {
        self.located(self.measure(&self.bearings[row], position))
    }

    /// The same for a beam that starts in the axis, given the range in metres and the azimuth of the position
    /// in radians, clockwise from x.
    fn locate_from_axis(&self, row: usize, range: f64, azimuth: f64) -> Option<(u32, u32)> {
        let ahead = if self.build.recipe.axes() == Axes::YAhead { FRAC_PI_2 } else { 0.0 };
        self.located(self.in_integers(azimuth + ahead - self.bearings[row].offset, range))
    }

    /// A measurement in steps and ticks; `None` if there is no such range.
    fn located(&self, measured: Measurement<f64>) -> Option<(u32, u32)> {
        let is_one = self.is_measured(&measured) && measured.steps < f64::from(MOST_LOCATED);
        is_one.then_some((measured.steps as u32, measured.tick as u32))
    }

    /// The measurements that are nearest to positions in metres, each by a laser of its own.
    #[inline(always)]
    fn measure<V: Choose>(&self, bearing: &Bearing<V>, [x, y, z]: [V; 3]) -> Measurement<V> {
        let flat = x * x + y * y;
        let mut azimuth = self.build.recipe.azimuth(x, y);
        let metres = if self.build.origin == Origin::default() {
            (flat + z * z).sqrt()
        } else {
            let beside = bearing.beside;
            let past = flat - beside * beside;
            let past = V::select(past.is_above(0.0), past, past.splat(0.0)).sqrt();
            let ahead = past - bearing.ahead;
            azimuth = azimuth + angle::atan2(beside, ahead + bearing.ahead);
            ahead * bearing.cos + (z - bearing.up) * bearing.sin + bearing.farther
        };
        self.in_integers(azimuth - bearing.offset, metres)
    }

    /// The measurements that are nearest to azimuths, less the lasers' offsets, and ranges.
    #[inline(always)]
    fn in_integers<V: Choose>(&self, azimuth: V, metres: V) -> Measurement<V> {
        let turn = f64::from(self.build.ticks);
        let ticks = (azimuth / azimuth.splat(self.radians())).round_ties_even();
        // From half a turn back to half a turn ahead.
        let nearest = ticks - (ticks * (1.0 / turn)).round_ties_even() * turn;
        Measurement {
            steps: (metres / metres.splat(self.range_step_m())).round_ties_even(),
            tick: V::select(nearest.is_below(0.0), nearest + turn, nearest),
            aside: azimuth - ticks * self.radians(),
        }
    }

    /// Whether there are such measurements.
    #[inline(always)]
    fn is_measured<V: Choose>(&self, measured: &Measurement<V>) -> V::Mask {
        let has_tick = measured.tick.is_above(-1.0) & measured.tick.is_below(f64::from(self.build.ticks));
        measured.steps.is_above(0.0) & has_tick
    }

    /// Approximately the positions, in metres, that the formula gives to the measurements nearest to others:
    /// to within a small fraction of a range step.
    #[inline(always)]
    fn near<V: Choose>(&self, bearing: &Bearing<V>, [x, y, _]: [V; 3], measured: &Measurement<V>) -> [V; 3] {
        let metres = measured.steps * self.range_step_m() - bearing.farther;
        let flat = metres * bearing.cos + bearing.ahead;
        // Starts from the point, rotates it onto the tick, and scales it to the range in whole steps.
        let [cos, sin] = angle::small_cos_sin(measured.aside);
        let scale = ((flat * flat + bearing.beside * bearing.beside) / (x * x + y * y)).sqrt();
        [scale * (x * cos - y * sin), scale * (x * sin + y * cos), metres * bearing.sin + bearing.up]
    }

    /// The returns of an image, each followed by its echoes, and the blanks of a full one, in the order of a
    /// file: firing by firing and slot by slot, or line by line.
    pub fn file_order(&self, image: &RangeImage) -> Vec<Return> {
        let width = image.columns.len();
        let cells = image.steps.cells();
        let span = |column: usize| Span::unpacked(image.spans.get(column).copied().unwrap_or(0));
        let has_one_tick = self.build.timing == Timing::Together && self.lags.is_empty();
        let mut returns = Vec::with_capacity(image.records());
        // The cells of a column or a line. Each is written, and then kept or overwritten: branches on cells
        // without a return would often be predicted wrongly.
        let mut part = vec![Return::default(); self.rows().max(width) + 1];
        let add = |part: &mut [Return], count: &mut usize, found: Return| {
            part[*count] = found;
            *count += usize::from(found.steps > 0 || image.is_full);
        };
        if self.rows_of_lines.is_empty() {
            for (column, &base) in image.columns.iter().enumerate() {
                let (span, mut count) = (span(column), 0);
                for (slot, &row) in self.rows_of_slots.iter().enumerate() {
                    let tick = match has_one_tick {
                        true => base,
                        false => self.tick_of_slot(slot, row as usize, base, span),
                    };
                    let steps = cells[row as usize * width + column];
                    add(&mut part, &mut count, Return { row, column: column as u32, tick, steps, echo: 0 });
                }
                returns.extend_from_slice(&part[..count]);
            }
        } else {
            for &row in &self.rows_of_lines {
                let mut count = 0;
                let line = image.steps.row(row as usize).iter().zip(&image.columns).enumerate();
                for (column, (&steps, &base)) in line {
                    let tick = self.tick(row as usize, base, span(column));
                    add(&mut part, &mut count, Return { row, column: column as u32, tick, steps, echo: 0 });
                }
                returns.extend_from_slice(&part[..count]);
            }
        }
        if image.echoes.is_empty() { returns } else { with_echoes(&returns, image) }
    }

    /// The positions of returns, rounded to a grid: [`position`](Self::position) of each.
    pub fn positions(&self, returns: &[Return], offset_m: f64, grid: CoordinateGrid) -> Vec<[f32; 3]> {
        if offset_m != 0.0 || grid != CoordinateGrid::Float32 {
            let single = |metres: f64| if metres.is_nan() { 0.0 } else { grid.nearest(metres) };
            return returns.iter().map(|found| self.position(found, offset_m).map(single)).collect();
        }
        match &self.build.mounting {
            None => side_by_side::positions(&self.arithmetic, &self.turn, returns, self.build.range_step_um),
            Some(mounting) => {
                let step = self.build.range_step_um;
                let moved = |found: &Return| {
                    let arithmetic = &self.arithmetic[found.row as usize];
                    let nearly = (!mounting.order.rounds_first())
                        .then(|| arithmetic.nearly_unrounded(&self.turn, found.tick, found.steps, step));
                    let quickly =
                        nearly.flatten().and_then(|(point, error)| mounting.surely_moved(&point, error));
                    quickly.unwrap_or_else(|| {
                        mounting.moved(&self.measured_position(found)).map(|metres| metres as f32)
                    })
                };
                returns.iter().map(|found| moved(found).map(or_zero)).collect()
            }
        }
    }

    /// The position of a return in metres, as accurately as the recipe computes it, `offset_m` metres beyond
    /// the range of its steps.
    pub fn position(&self, found: &Return, offset_m: f64) -> [f64; 3] {
        let measured = if offset_m == 0.0 {
            self.measured_position(found)
        } else {
            let metres = f64::from(found.steps) * self.range_step_m() + offset_m;
            self.arithmetic[found.row as usize].position_at(&self.turn, found.tick, metres)
        };
        match &self.build.mounting {
            None => measured,
            Some(mounting) => mounting.moved(&measured),
        }
    }

    /// The position of a return in the frame of the scanner, in metres, rounded if it is before it is moved.
    #[inline(always)]
    fn measured_position(&self, found: &Return) -> [f64; 3] {
        let arithmetic = &self.arithmetic[found.row as usize];
        let step = self.build.range_step_um;
        match &self.build.mounting {
            Some(mounting) if !mounting.order.rounds_first() => self.unrounded(found),
            _ => arithmetic.position(&self.turn, found.tick, found.steps, step).map(f64::from),
        }
    }

    /// The position of a return in the frame of the scanner, in metres, in the precision in which it is
    /// computed.
    fn unrounded(&self, found: &Return) -> [f64; 3] {
        let arithmetic = &self.arithmetic[found.row as usize];
        arithmetic.unrounded(&self.turn, found.tick, found.steps, self.build.range_step_um)
    }

    /// Whether the recipe reproduces a position in the file to the last bit, along these axes.
    fn reproduces(&self, found: &Return, position: &[f64; 3], axes: std::ops::Range<usize>) -> bool {
        let grid = self.build.coordinates;
        let formula = self.position(found, 0.0);
        axes.into_iter().all(|axis| f64::from(grid.nearest(formula[axis])) == position[axis])
    }

    /// Radians per tick.
    fn radians(&self) -> f64 {
        TAU / f64::from(self.build.ticks)
    }
}

impl fmt::Display for Firings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Build { recipe, ticks, range_step_um, coordinates, origin, timing, mounting } = &self.build;
        let degrees = |laser: Option<&Laser>| laser.map_or(0.0, Laser::elevation_degrees);
        write!(
            f,
            "{} lasers from {:.2} to {:.2} degrees, {} mm, {:.3} degrees a tick, {}",
            self.lasers.len(),
            degrees(self.lasers.last()),
            degrees(self.lasers.first()),
            f64::from(*range_step_um) * 1e-3,
            360.0 / f64::from(*ticks),
            recipe.program(),
        )?;
        match coordinates {
            CoordinateGrid::Float32 => {}
            CoordinateGrid::Millimetre => write!(f, ", rounded to millimetres")?,
            CoordinateGrid::Lattice { step_nm: 10_000_000 } => write!(f, ", rounded to centimetres")?,
            CoordinateGrid::Lattice { step_nm } => write!(f, ", rounded to {} micrometres", step_nm / 1000)?,
            CoordinateGrid::Digits(digits) => write!(f, ", rounded to {digits} digits")?,
            CoordinateGrid::Half => write!(f, ", rounded to half precision")?,
            CoordinateGrid::Binary(places) => write!(f, ", rounded to {places} binary places")?,
        }
        if recipe.starts_in_beam() {
            let along = f64::from(origin.along_um) / 1e3;
            write!(f, ", beams through a point {along} mm in front of the axis")?;
        } else if *origin != Origin::default() {
            let [along, up] = [origin.along_um, origin.up_um].map(|um| f64::from(um) / 1e3);
            let place = if along < 0.0 { "behind" } else { "off" };
            write!(f, ", beams from {} mm {place} the axis and {up} mm above", along.abs())?;
        }
        if mounting.is_some() {
            write!(f, ", moved to the frame of a vehicle")?;
        }
        let order = if self.rows_of_lines.is_empty() { "firing by firing" } else { "row by row" };
        write!(f, ", {order}")?;
        match recipe {
            _ if self.lags.is_empty() => {}
            _ if *recipe == Recipe::SingleRangeXAhead || recipe.measures_from_axis() => {
                write!(f, ", destaggered")?;
            }
            _ => write!(f, ", lasers turned by whole ticks")?,
        }
        match timing {
            Timing::Together => Ok(()),
            Timing::Vlp16 => write!(f, " with a VLP-16's timing"),
            Timing::Parts(_) => {
                write!(f, ", {} a block, with a timing of their own", timing.firings(self.rows()))
            }
        }
    }
}

/// Returns, each followed by its echoes.
fn with_echoes(returns: &[Return], image: &RangeImage) -> Vec<Return> {
    let mut all = Vec::with_capacity(returns.len() + image.echoes.len());
    for found in returns {
        all.push(*found);
        let cell = found.row * image.columns.len() as u32 + found.column;
        let first = image.echoes.partition_point(|echo| echo.cell < cell);
        let own = image.echoes[first..].iter().take_while(|echo| echo.cell == cell);
        all.extend((first as u32 + 1..).zip(own).map(|(echo, own)| Return {
            steps: own.steps,
            echo,
            ..*found
        }));
    }
    all
}
