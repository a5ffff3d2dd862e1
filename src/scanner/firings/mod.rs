//! Scanners whose files hold firing after firing: Velodyne's VLP and HDL-32E, Hesai's, Ouster's by columns.
//!
//! A firing is one column of the range image: each laser once, in an order of its own (the *slots*), at one azimuth
//! tick or at ticks that go on from slot to slot. All beams leave one point. For a laser with elevation E and azimuth
//! offset O, a range of `n` steps and an azimuth of `t` ticks:
//!
//! ```text
//! d = n * range_step
//! A = t * tick + O
//! x, y, z = d * cos E * cos A, -d * cos E * sin A, d * sin E      or with the axes of another program
//! ```
//!
//! In which precision, and in which order this was computed, is the [`Recipe`] of the program that wrote the file. The
//! beams of some scanners start away from the axis ([`Origin`]), in the direction of the tick, not of the beam.

mod columns;
mod fit;
mod glibc;
mod off_axis;
mod order;
mod projection;
mod recipe;

pub use columns::FiringColumnModel;
pub use fit::{Moved, fit, fit_moved};
pub use projection::Sight;
pub use recipe::{Origin, Recipe};

use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;

use crate::ground::angle;
use crate::ground::error::{Error, Result};
use crate::ground::rounding::round_ties_even;
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};
use crate::scanner::{BeamConstants, Coordinates, Hdl64, MOST_RANGE_STEP_UM, MOST_TICKS, RangeImage, Return};
use recipe::{Arithmetic, Turn, whole_steps};

/// Degrees of one unit of a laser's constants.
const ANGLE_UNIT: f64 = 1e-9;
/// Constants are within a turn.
const LARGEST_ANGLE: u64 = 360_000_000_000;
/// More lasers than any scanner has.
const MOST_LASERS: u64 = 1024;
/// Farther than the beams of any scanner start from its origin.
const MOST_ORIGIN_UM: u64 = 1_000_000;

/// The constants of a laser, as they stand in the stream.
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

/// Where a laser looks, for finding what it measured.
#[derive(Clone, Copy, Debug)]
struct Bearing {
    /// Cosine and sine of E.
    cos: f64,
    sin: f64,
    /// O, in radians.
    offset: f64,
    /// Where its beam starts: metres beside the axis and ahead of it, seen along the beam.
    beside: f64,
    ahead: f64,
}

impl Bearing {
    fn new(laser: &Laser, origin: Origin) -> Self {
        let (elevation, offset) =
            (laser.elevation_degrees().to_radians(), laser.azimuth_degrees().to_radians());
        let [along, _] = origin.metres();
        Bearing {
            cos: libm::cos(elevation),
            sin: libm::sin(elevation),
            offset,
            beside: along * libm::sin(offset),
            ahead: along * libm::cos(offset),
        }
    }
}

/// What a laser measured that left a point.
#[derive(Clone, Copy, Debug)]
struct Located {
    steps: u32,
    tick: u32,
    /// Radians from the tick to the point.
    aside: f64,
}

/// How the azimuth goes on inside a block: the firings that share one azimuth in the scanner's packets.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Timing {
    /// All slots of a firing have the same tick.
    #[default]
    Together,
    /// Velodyne's VLP-16, with two firings a block, in single precision: of the ticks to the next block, the part
    /// `(s * slot + f * firing) / block` has passed at slot `s` of firing `f`; rounded.
    Vlp16,
    /// Of the ticks to the next block, these parts have passed at each slot, in 2^-24, firing after firing; rounded
    /// down.
    Parts(Vec<u32>),
}

/// One in the unit of the parts of a block.
const WHOLE: u32 = 1 << 24;

/// From slot to slot, from firing to firing and from block to block of a VLP-16, in microseconds.
const VLP_16_TIMES: [f32; 3] = [2.304, 55.296, 110.592];

impl Timing {
    /// Whether ticks differ from slot to slot.
    pub fn is_interpolated(&self) -> bool {
        *self != Timing::Together
    }

    /// The ticks of a slot in a firing of a block at `base`, if the next block comes `span` ticks later; `rows` are the
    /// slots of a firing.
    fn tick(&self, base: u32, span: u32, (firing, slot): (u32, u32), rows: usize) -> u32 {
        match self {
            Timing::Together => base,
            Timing::Vlp16 => {
                let [of_slot, of_firing, of_block] = VLP_16_TIMES;
                let passed = slot as f32 * of_slot + firing as f32 * of_firing;
                // Halves away from zero, as the driver's `round`; no tick is negative, so that `as` rounds down.
                (base as f32 + span as f32 * passed / of_block + 0.5) as u32
            }
            Timing::Parts(parts) => {
                let part = parts.get(firing as usize * rows + slot as usize).copied().unwrap_or(0);
                base + (u64::from(span) * u64::from(part) / u64::from(WHOLE)) as u32
            }
        }
    }

    /// Firings of a block.
    fn firings(&self, rows: usize) -> u32 {
        match self {
            Timing::Together => 1,
            Timing::Vlp16 => 2,
            Timing::Parts(parts) => (parts.len() / rows.max(1)) as u32,
        }
    }

    /// The part of a block that has passed at a slot of a firing.
    fn passed(&self, (firing, slot): (u32, u32), rows: usize) -> f64 {
        match self {
            Timing::Together => 0.0,
            Timing::Vlp16 => {
                let [of_slot, of_firing, of_block] = VLP_16_TIMES.map(f64::from);
                (f64::from(slot) * of_slot + f64::from(firing) * of_firing) / of_block
            }
            Timing::Parts(parts) => {
                let part = parts.get(firing as usize * rows + slot as usize).copied().unwrap_or(0);
                f64::from(part) / f64::from(WHOLE)
            }
        }
    }
}

/// A column's place in its block and the ticks to the next block, as the range image keeps them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Span {
    /// Ticks from this block to the next.
    ticks: u32,
    /// Which firing of the block this is.
    firing: u32,
}

impl Span {
    fn of(kept: u32) -> Self {
        Span { ticks: kept >> 1, firing: kept & 1 }
    }

    fn kept(self) -> u32 {
        self.ticks << 1 | self.firing
    }
}

/// What is said of a scanner of firings as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Build {
    /// The program that wrote the files.
    pub recipe: Recipe,
    /// Azimuth ticks a turn; not 0.
    pub ticks: u32,
    /// One range step, in micrometres.
    pub range_step_um: u32,
    /// The grid of the file's coordinates.
    pub coordinates: Coordinates,
    /// Where beams start.
    pub origin: Origin,
    /// How the azimuth goes on inside a block.
    pub timing: Timing,
}

/// A scanner of firings.
#[derive(Clone, Debug)]
pub struct Firings {
    build: Build,
    /// In the order of the rows: from the highest to the lowest.
    lasers: Vec<Laser>,
    /// The row of each slot.
    rows_of_slots: Vec<u32>,
    /// The row of each line of the file, if it holds row after row; empty if it holds firing after firing.
    rows_of_lines: Vec<u32>,
    /// The ticks by which each row is behind its column, less than a turn; empty if none is.
    lags: Vec<u32>,
    // What follows from these.
    slots_of_rows: Vec<u32>,
    arithmetic: Vec<Arithmetic>,
    bearings: Vec<Bearing>,
    turn: Arc<Turn>,
}

impl PartialEq for Firings {
    fn eq(&self, other: &Self) -> bool {
        self.to_payload() == other.to_payload()
    }
}

impl Firings {
    /// A scanner with these lasers, from the highest to the lowest, which fire in this order: `rows_of_slots` must be
    /// a permutation of the rows.
    pub fn new(build: Build, lasers: Vec<Laser>, rows_of_slots: Vec<u32>) -> Self {
        let mut slots_of_rows = vec![0; lasers.len()];
        (0u32..).zip(&rows_of_slots).for_each(|(slot, &row)| slots_of_rows[row as usize] = slot);
        let of_laser = |laser: &Laser| Arithmetic::new(build.recipe, laser, build.origin, build.ticks);
        let arithmetic = lasers.iter().map(of_laser).collect();
        let bearings = lasers.iter().map(|laser| Bearing::new(laser, build.origin)).collect();
        let turn = Arc::new(Turn::new(build.recipe, build.ticks));
        let (rows_of_lines, lags) = (Vec::new(), Vec::new());
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
        }
    }

    /// The same scanner with files that hold row after row, in this order: `rows_of_lines` must be a permutation of the
    /// rows, or empty for files that hold firing after firing.
    pub fn line_by_line(self, rows_of_lines: Vec<u32>) -> Self {
        Firings { rows_of_lines, ..self }
    }

    /// The same scanner with columns that hold what was not fired together: each row so many ticks behind its column, as in
    /// Ouster's destaggered clouds. There must be as many as rows, all less than a turn, or none.
    pub fn lagging(self, lags: Vec<u32>) -> Self {
        Firings { lags, ..self }
    }

    /// The same scanner with another timing of its firings.
    fn with_timing(self, timing: Timing) -> Self {
        Firings { build: Build { timing, ..self.build }, ..self }
    }

    /// A scanner of one laser alone, for the fit.
    fn of_laser(&self, laser: Laser) -> Self {
        let arithmetic =
            vec![Arithmetic::new(self.build.recipe, &laser, self.build.origin, self.build.ticks)];
        Firings {
            build: Build { timing: Timing::Together, ..self.build },
            lasers: vec![laser],
            arithmetic,
            rows_of_slots: vec![0],
            rows_of_lines: Vec::new(),
            lags: Vec::new(),
            slots_of_rows: vec![0],
            bearings: vec![Bearing::new(&laser, self.build.origin)],
            turn: self.turn.clone(),
        }
    }

    /// What is said of it as a whole.
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

    /// An HDL-64E-like scanner that sees a range image as this one does, but for the direction in which it turns and
    /// for the origin of its beams: for pictures and regions, not for positions.
    pub fn likeness(&self) -> Hdl64 {
        let beam = |laser: &Laser| {
            let offset = laser.azimuth_degrees().to_radians();
            let shift = round_ties_even(offset / self.radians());
            let turned = offset - shift * self.radians();
            let constants = [laser.elevation_degrees().to_radians(), 0.0, 0.0, 0.0, turned];
            BeamConstants { column_shift: -shift as i64, ..BeamConstants::quantise(constants) }
        };
        let beams = self.lasers.iter().map(beam).collect();
        Hdl64::new(Coordinates::Float32, self.build.ticks, self.build.range_step_um, beams)
    }

    /// Number of lasers, which is the number of rows of the range image.
    pub fn rows(&self) -> usize {
        self.lasers.len()
    }

    /// One range step, in metres.
    pub fn range_step_m(&self) -> f64 {
        f64::from(self.build.range_step_um) * 1e-6
    }

    /// The same scanner, its ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        Firings { build: Build { range_step_um, ..self.build }, ..self }
    }

    /// The azimuth tick of a laser in a column.
    fn tick(&self, row: usize, column_tick: u32, span: Span) -> u32 {
        if !self.build.timing.is_interpolated() {
            return (column_tick + self.build.ticks - self.lag(row)) % self.build.ticks;
        }
        let place = (span.firing, self.slots_of_rows[row]);
        self.build.timing.tick(column_tick, span.ticks, place, self.rows()) % self.build.ticks
    }

    /// The ticks by which a row is behind its column.
    fn lag(&self, row: usize) -> u32 {
        self.lags.get(row).copied().unwrap_or(0)
    }

    /// What comes nearest to a position in metres if this laser measured it; none if there is no such range.
    #[inline]
    fn locate(&self, row: usize, [x, y, z]: [f64; 3]) -> Option<Located> {
        let Bearing { cos, sin, offset, beside, ahead } = self.bearings[row];
        let (metres, turned) = if self.build.origin == Origin::default() {
            ((x * x + y * y + z * z).sqrt(), 0.0)
        } else {
            let [along, up] = self.build.origin.metres();
            let flat = (x * x + y * y - beside * beside).max(0.0).sqrt() - ahead;
            let metres = flat * cos + (z - up) * sin;
            let metres = if self.build.recipe.measures_from_axis() { metres + along } else { metres };
            (metres, angle::atan2(beside, flat + ahead))
        };
        let steps = whole_steps(metres, self.range_step_m())?;
        let azimuth = self.build.recipe.azimuth(x, y) + turned - offset;
        let tick = round_ties_even(azimuth / self.radians());
        let aside = azimuth - tick * self.radians();
        Some(Located { steps, tick: (tick as i64).rem_euclid(i64::from(self.build.ticks)) as u32, aside })
    }

    /// About where the formula puts what was located at a position, in metres: to within a small part of a range step.
    #[inline]
    fn near(&self, row: usize, [x, y, _]: [f64; 3], located: &Located) -> [f64; 3] {
        let Bearing { cos, sin, beside, ahead, .. } = self.bearings[row];
        let [along, up] = self.build.origin.metres();
        let metres = f64::from(located.steps) * self.range_step_m();
        let metres = if self.build.recipe.measures_from_axis() { metres - along } else { metres };
        let flat = metres * cos + ahead;
        // From the point: turned by what it is aside, and as far away as the steps say.
        let [cos_a, sin_a] = angle::small_cos_sin(located.aside);
        let scale = ((flat * flat + beside * beside) / (x * x + y * y)).sqrt();
        [scale * (x * cos_a - y * sin_a), scale * (x * sin_a + y * cos_a), metres * sin + up]
    }

    /// The returns of an image, each followed by its echoes, and the blanks of a full one, in the order in which a file
    /// holds them: firing by firing, slot by slot, or line by line.
    pub fn file_order(&self, image: &RangeImage) -> Vec<Return> {
        let width = image.columns.len() as u32;
        let mut returns = Vec::with_capacity(image.records());
        let mut add = |row: u32, column: u32| {
            let steps = image.steps[(row as usize, column as usize)];
            if steps == 0 && !image.is_full {
                return;
            }
            let span = Span::of(image.spans.get(column as usize).copied().unwrap_or(0));
            let tick = self.tick(row as usize, image.columns[column as usize], span);
            returns.push(Return { row, column, tick, steps, echo: 0 });
            if !image.echoes.is_empty() {
                let cell = row * width + column;
                let first = image.echoes.partition_point(|echo| echo.cell < cell);
                let own = image.echoes[first..].iter().take_while(|echo| echo.cell == cell);
                returns.extend((first as u32 + 1..).zip(own).map(|(number, echo)| Return {
                    row,
                    column,
                    tick,
                    steps: echo.steps,
                    echo: number,
                }));
            }
        };
        if self.rows_of_lines.is_empty() {
            for column in 0..width {
                self.rows_of_slots.iter().for_each(|&row| add(row, column));
            }
        } else {
            for &row in &self.rows_of_lines {
                (0..width).for_each(|column| add(row, column));
            }
        }
        returns
    }

    /// Where a return is, in metres, as well as the recipe gives it, `offset_m` metres farther than its steps say.
    pub fn position(&self, found: &Return, offset_m: f64) -> [f64; 3] {
        let arithmetic = &self.arithmetic[found.row as usize];
        if offset_m == 0.0 {
            let step = self.build.range_step_um;
            arithmetic.position(&self.turn, found.tick, found.steps, step).map(f64::from)
        } else {
            let metres = f64::from(found.steps) * self.range_step_m() + offset_m;
            arithmetic.position_at(&self.turn, found.tick, metres)
        }
    }

    /// Whether the recipe gives a position in the file to the last bit, along these axes.
    fn gives(&self, found: &Return, position: &[f64; 3], axes: std::ops::Range<usize>) -> bool {
        let grid = self.build.coordinates;
        let formula = self.position(found, 0.0);
        axes.into_iter().all(|axis| f64::from(grid.nearest(formula[axis])) == position[axis])
    }

    /// The payload of the scanner's record.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut record = Vec::new();
        let out = &mut record;
        let Build { recipe, ticks, range_step_um, coordinates, origin, ref timing } = self.build;
        [recipe as u32, ticks, range_step_um].iter().for_each(|&number| write_unsigned(out, number.into()));
        let (grid, step) = match coordinates {
            Coordinates::Float32 => (0, 0),
            Coordinates::Millimetre => (1, 0),
            Coordinates::Lattice { step_nm } => (2, step_nm),
            Coordinates::Digits(digits) => (3, u64::from(digits)),
        };
        write_unsigned(out, grid);
        write_unsigned(out, step);
        write_signed(out, origin.along_um.into());
        write_signed(out, origin.up_um.into());
        write_unsigned(out, self.lasers.len() as u64);
        for laser in &self.lasers {
            write_signed(out, laser.elevation);
            write_signed(out, laser.azimuth);
        }
        self.rows_of_slots.iter().for_each(|&row| write_unsigned(out, u64::from(row)));
        out.push(u8::from(!self.rows_of_lines.is_empty()));
        self.rows_of_lines.iter().for_each(|&row| write_unsigned(out, u64::from(row)));
        out.push(u8::from(!self.lags.is_empty()));
        self.lags.iter().for_each(|&lag| write_unsigned(out, u64::from(lag)));
        match timing {
            Timing::Together => write_unsigned(out, 0),
            Timing::Vlp16 => write_unsigned(out, 1),
            Timing::Parts(parts) => {
                write_unsigned(out, 1 + u64::from(timing.firings(self.rows())));
                parts.iter().for_each(|&part| write_unsigned(out, part.into()));
            }
        }
        record
    }

    /// Reads the payload of the scanner's record.
    ///
    /// # Errors
    /// If it is cut short or holds values that no scanner has.
    pub fn read_from(bytes: &mut &[u8]) -> Result<Self> {
        let mut bounded = |what: &str, min: u64, max: u64| match read_unsigned(bytes, "scanner")? {
            got if (min..=max).contains(&got) => Ok(got as u32),
            got => Err(Error::over_limit(format!("scanner: {what}"), got, max)),
        };
        let recipe = bounded("recipe", 0, u64::from(u32::MAX))?;
        let recipe = Recipe::of_number(recipe)
            .ok_or_else(|| Error::unsupported(format!("scanner: unknown recipe {recipe}")))?;
        let ticks = bounded("ticks a turn", 1, MOST_TICKS)?;
        let range_step_um = bounded("range step in micrometres", 1, MOST_RANGE_STEP_UM)?;
        let grid = bounded("grid of the coordinates", 0, 3)?;
        let step = bounded("step of the grid", 0, 1_000_000_000)?;
        let coordinates = match (grid, step) {
            (0, 0) => Coordinates::Float32,
            (1, 0) => Coordinates::Millimetre,
            (2, 1..) => Coordinates::Lattice { step_nm: step.into() },
            (3, 1..=9) => Coordinates::Digits(step as u8),
            _ => return Err(Error::corrupt("scanner: a grid and a step that do not fit together")),
        };
        let mut metre = || match read_signed(bytes, "scanner")? {
            um if um.unsigned_abs() <= MOST_ORIGIN_UM => Ok(um as i32),
            _ => Err(Error::corrupt("scanner: beams start too far away")),
        };
        let origin = Origin { along_um: metre()?, up_um: metre()? };
        let mut bounded = |what: &str, min: u64, max: u64| match read_unsigned(bytes, "scanner")? {
            got if (min..=max).contains(&got) => Ok(got as u32),
            got => Err(Error::over_limit(format!("scanner: {what}"), got, max)),
        };
        let rows = bounded("lasers", 1, MOST_LASERS)?;
        let mut angle = || match read_signed(bytes, "scanner")? {
            angle if angle.unsigned_abs() <= LARGEST_ANGLE => Ok(angle),
            _ => Err(Error::corrupt("scanner: an angle is out of range")),
        };
        let mut lasers = Vec::new();
        for _ in 0..rows {
            lasers.push(Laser { elevation: angle()?, azimuth: angle()? });
        }
        let rows_of_slots = read_permutation(bytes, rows)?;
        let rows_of_lines = match read_unsigned(bytes, "scanner")? {
            0 => Vec::new(),
            1 => read_permutation(bytes, rows)?,
            other => return Err(Error::unsupported(format!("scanner: unknown order {other}"))),
        };
        let lags = match read_unsigned(bytes, "scanner")? {
            0 => Vec::new(),
            1 => (0..rows)
                .map(|_| match read_unsigned(bytes, "scanner")? {
                    lag if lag < u64::from(ticks) => Ok(lag as u32),
                    lag => {
                        Err(Error::over_limit("scanner: ticks behind a column", lag, u64::from(ticks) - 1))
                    }
                })
                .collect::<Result<_>>()?,
            other => return Err(Error::unsupported(format!("scanner: unknown columns {other}"))),
        };
        let timing = match read_unsigned(bytes, "scanner")? {
            0 => Timing::Together,
            1 => Timing::Vlp16,
            firings @ 2..=3 => {
                let count = (firings - 1) * u64::from(rows);
                let part = |_| match read_unsigned(bytes, "scanner")? {
                    part if part <= u64::from(WHOLE) => Ok(part as u32),
                    part => Err(Error::over_limit("scanner: part of a block", part, WHOLE.into())),
                };
                Timing::Parts((0..count).map(part).collect::<Result<_>>()?)
            }
            other => return Err(Error::unsupported(format!("scanner: unknown timing {other}"))),
        };
        let build = Build { recipe, ticks, range_step_um, coordinates, origin, timing };
        Ok(Self::new(build, lasers, rows_of_slots).line_by_line(rows_of_lines).lagging(lags))
    }

    /// Radians of a tick.
    fn radians(&self) -> f64 {
        TAU / f64::from(self.build.ticks)
    }
}

impl fmt::Display for Firings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Build { recipe, ticks, range_step_um, coordinates, origin, timing } = &self.build;
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
            Coordinates::Float32 => {}
            Coordinates::Millimetre => write!(f, ", rounded to millimetres")?,
            Coordinates::Lattice { step_nm } => write!(f, ", rounded to {} micrometres", step_nm / 1000)?,
            Coordinates::Digits(digits) => write!(f, ", rounded to {digits} digits")?,
        }
        if *origin != Origin::default() {
            let [along, up] = [origin.along_um, origin.up_um].map(|um| f64::from(um) / 1e3);
            write!(f, ", beams from {along} mm off the axis and {up} mm above")?;
        }
        let order = if self.rows_of_lines.is_empty() { "firing by firing" } else { "row by row" };
        write!(f, ", {order}")?;
        if !self.lags.is_empty() {
            write!(f, ", destaggered")?;
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

/// Reads each of the rows once, in any order.
fn read_permutation(bytes: &mut &[u8], rows: u32) -> Result<Vec<u32>> {
    let (mut order, mut seen) = (Vec::new(), vec![false; rows as usize]);
    for _ in 0..rows {
        let row = read_unsigned(bytes, "scanner")?;
        let is_new = seen.get_mut(row as usize).map(|seen| !std::mem::replace(seen, true));
        if is_new != Some(true) {
            return Err(Error::corrupt("scanner: an order is no permutation of the rows"));
        }
        order.push(row as u32);
    }
    Ok(order)
}
