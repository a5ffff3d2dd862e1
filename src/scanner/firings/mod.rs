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
//! In which precision, and in which order this was computed, is the [`Recipe`] of the program that wrote the file.

mod columns;
mod fit;
mod projection;
mod recipe;

pub use columns::FiringColumnModel;
pub use fit::fit;
pub use recipe::Recipe;

use std::f64::consts::TAU;
use std::sync::Arc;

use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};
use crate::scanner::{MOST_RANGE_STEP_UM, MOST_TICKS, RangeImage, Return};
use recipe::{Arithmetic, Turn};

/// Degrees of one unit of a laser's constants.
const ANGLE_UNIT: f64 = 1e-9;
/// Constants are within a turn.
const LARGEST_ANGLE: u64 = 360_000_000_000;
/// More lasers than any scanner has.
const MOST_LASERS: u64 = 1024;
/// Longer than any time of a firing, in nanoseconds.
const LONGEST_TIME: u64 = 1 << 31;

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

/// How the azimuth goes on inside a block of firings that share one azimuth in the scanner's packets.
///
/// The tick of slot `s` in firing `f` of a block is that of the block, and of the ticks to the next block the part
/// `(s * slot + f * firing) / block`, rounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// From slot to slot, in nanoseconds.
    pub slot: u32,
    /// From firing to firing, in nanoseconds.
    pub firing: u32,
    /// From block to block, in nanoseconds; 0: all slots of a firing have the same tick.
    pub block: u32,
}

impl Timing {
    /// Velodyne VLP-16: two firings a block.
    pub const VLP_16: Timing = Timing { slot: 2304, firing: 55_296, block: 110_592 };

    /// Whether ticks differ from slot to slot.
    pub fn is_interpolated(self) -> bool {
        self.block > 0
    }

    /// The ticks from that of the block to that of a slot in a firing of it, before they are rounded, if the next
    /// block comes `span` ticks later: single precision, as Velodyne's driver computes.
    fn offset(self, base: u32, span: u32, firing: u32, slot: u32) -> f32 {
        let microseconds = |nanoseconds: u32| (f64::from(nanoseconds) * 1e-3) as f32;
        let passed = slot as f32 * microseconds(self.slot) + firing as f32 * microseconds(self.firing);
        base as f32 + span as f32 * passed / microseconds(self.block)
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

/// A scanner of firings.
#[derive(Clone, Debug)]
pub struct Firings {
    recipe: Recipe,
    ticks: u32,
    range_step_um: u32,
    timing: Timing,
    /// In the order of the rows: from the highest to the lowest.
    lasers: Vec<Laser>,
    /// The row of each slot.
    rows_of_slots: Vec<u32>,
    /// The row of each line of the file, if it holds row after row; empty if it holds firing after firing.
    rows_of_lines: Vec<u32>,
    // What follows from these.
    slots_of_rows: Vec<u32>,
    arithmetic: Vec<Arithmetic>,
    turn: Arc<Turn>,
}

impl PartialEq for Firings {
    fn eq(&self, other: &Self) -> bool {
        self.to_payload() == other.to_payload()
    }
}

impl Firings {
    /// A scanner with these lasers, from the highest to the lowest, which fire in this order: `rows_of_slots` must be
    /// a permutation of the rows. `ticks` must not be 0.
    pub fn new(
        recipe: Recipe,
        (ticks, range_step_um): (u32, u32),
        timing: Timing,
        lasers: Vec<Laser>,
        rows_of_slots: Vec<u32>,
    ) -> Self {
        let mut slots_of_rows = vec![0; lasers.len()];
        (0u32..).zip(&rows_of_slots).for_each(|(slot, &row)| slots_of_rows[row as usize] = slot);
        let arithmetic = lasers.iter().map(|laser| Arithmetic::new(recipe, laser)).collect();
        let turn = Arc::new(Turn::new(recipe, ticks));
        Firings {
            recipe,
            ticks,
            range_step_um,
            timing,
            lasers,
            rows_of_slots,
            rows_of_lines: Vec::new(),
            slots_of_rows,
            arithmetic,
            turn,
        }
    }

    /// The same scanner with files that hold row after row, in this order: `rows_of_lines` must be a permutation of the
    /// rows, or empty for files that hold firing after firing.
    pub fn line_by_line(self, rows_of_lines: Vec<u32>) -> Self {
        Firings { rows_of_lines, ..self }
    }

    /// A scanner of one laser alone, for the fit.
    fn of_laser(&self, laser: Laser) -> Self {
        let arithmetic = vec![Arithmetic::new(self.recipe, &laser)];
        Firings {
            lasers: vec![laser],
            arithmetic,
            rows_of_slots: vec![0],
            rows_of_lines: Vec::new(),
            slots_of_rows: vec![0],
            turn: self.turn.clone(),
            ..*self
        }
    }

    /// The program that wrote the files.
    #[cfg(any(test, feature = "internals"))]
    pub fn recipe(&self) -> Recipe {
        self.recipe
    }

    /// Azimuth ticks a turn.
    pub fn ticks(&self) -> u32 {
        self.ticks
    }

    /// One range step, in micrometres.
    #[cfg(any(test, feature = "internals"))]
    pub fn range_step_um(&self) -> u32 {
        self.range_step_um
    }

    /// How the azimuth goes on inside a block of firings.
    #[cfg(any(test, feature = "internals"))]
    pub fn timing(&self) -> Timing {
        self.timing
    }

    /// The lasers, row by row.
    #[cfg(any(test, feature = "internals"))]
    pub fn lasers(&self) -> &[Laser] {
        &self.lasers
    }

    /// Number of lasers, which is the number of rows of the range image.
    pub fn rows(&self) -> usize {
        self.lasers.len()
    }

    /// One range step, in metres.
    pub fn range_step_m(&self) -> f64 {
        f64::from(self.range_step_um) * 1e-6
    }

    /// The same scanner, its ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        Firings { range_step_um, ..self }
    }

    /// The azimuth tick of a laser in a column.
    fn tick(&self, row: usize, column_tick: u32, span: Span) -> u32 {
        if !self.timing.is_interpolated() {
            return column_tick;
        }
        let tick = self.timing.offset(column_tick, span.ticks, span.firing, self.slots_of_rows[row]);
        // Halves away from zero, as the driver's `round`; no tick is negative.
        (tick + 0.5).floor() as u32 % self.ticks
    }

    /// The returns of an image, and the blanks of a full one, in the order in which a file holds them: firing by firing,
    /// slot by slot, or line by line.
    pub fn file_order(&self, image: &RangeImage) -> Vec<Return> {
        let at = |row: u32, column: u32| {
            let steps = image.steps[(row as usize, column as usize)];
            let span = Span::of(image.spans.get(column as usize).copied().unwrap_or(0));
            let tick = self.tick(row as usize, image.columns[column as usize], span);
            (steps > 0 || image.is_full).then_some(Return { row, column, tick, steps })
        };
        let columns = 0..image.columns.len() as u32;
        let mut returns = Vec::with_capacity(image.records());
        if self.rows_of_lines.is_empty() {
            returns.extend(columns.flat_map(|column| {
                let slots = self.rows_of_slots.iter();
                slots.filter_map(move |&row| at(row, column))
            }));
        } else {
            let lines = self.rows_of_lines.iter();
            returns.extend(lines.flat_map(|&row| columns.clone().filter_map(move |column| at(row, column))));
        }
        returns
    }

    /// Where a return is, in metres, as well as the recipe gives it, `offset_m` metres farther than its steps say.
    pub fn position(&self, found: &Return, offset_m: f64) -> [f64; 3] {
        let arithmetic = &self.arithmetic[found.row as usize];
        if offset_m == 0.0 {
            arithmetic.position(&self.turn, found.tick, found.steps, self.range_step_um).map(f64::from)
        } else {
            let metres = f64::from(found.steps) * self.range_step_m() + offset_m;
            arithmetic.position_at(&self.turn, found.tick, metres)
        }
    }

    /// Whether the recipe gives a position in the file to the last bit.
    fn gives(&self, found: &Return, position: &[f64; 3]) -> bool {
        self.position(found, 0.0).iter().zip(position).all(|(formula, value)| formula == value)
    }

    /// The payload of the scanner's record.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut record = Vec::new();
        let out = &mut record;
        let Timing { slot, firing, block } = self.timing;
        let numbers = [self.recipe as u32, self.ticks, self.range_step_um, slot, firing, block];
        numbers.into_iter().for_each(|number| write_unsigned(out, u64::from(number)));
        write_unsigned(out, self.lasers.len() as u64);
        for laser in &self.lasers {
            write_signed(out, laser.elevation);
            write_signed(out, laser.azimuth);
        }
        self.rows_of_slots.iter().for_each(|&row| write_unsigned(out, u64::from(row)));
        out.push(u8::from(!self.rows_of_lines.is_empty()));
        self.rows_of_lines.iter().for_each(|&row| write_unsigned(out, u64::from(row)));
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
        let mut time = |what| bounded(what, 0, LONGEST_TIME);
        let timing = Timing {
            slot: time("time of a slot")?,
            firing: time("time of a firing")?,
            block: time("time of a block")?,
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
        let scanner = Self::new(recipe, (ticks, range_step_um), timing, lasers, rows_of_slots);
        Ok(scanner.line_by_line(rows_of_lines))
    }

    /// Radians of a tick.
    fn radians(&self) -> f64 {
        TAU / f64::from(self.ticks)
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
