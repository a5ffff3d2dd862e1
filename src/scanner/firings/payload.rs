//! A scanner of firings as its record in the stream. FORMAT.md 3.3.

use super::mounting::TransformOrder;
use super::timing::{MOST_BLOCKS, WHOLE};
use super::{Build, Firings, Laser, Mounting, Origin, Recipe, Timing};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{
    read_f64, read_signed, read_unsigned, read_within, saturated, write_signed, write_unsigned,
};
use crate::scanner::{CoordinateGrid, MOST_RANGE_STEP_UM, MOST_ROWS, MOST_TICKS};

/// Constants are at most one turn, in 1e-9 degrees.
const LARGEST_ANGLE: u64 = 360_000_000_000;
/// Beams of all scanners start nearer to the origin.
const MOST_ORIGIN_UM: u64 = 1_000_000;
/// The numbers of a mounting are smaller: metres, and cosines.
const MOST_MOUNTING: f64 = 1e6;

impl Firings {
    /// The payload of the scanner's record.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut record = Vec::new();
        let out = &mut record;
        let Build { recipe, ticks, range_step_um, coordinates, origin, ref timing, ref mounting } =
            self.build;
        [recipe as u32, ticks, range_step_um].iter().for_each(|&number| write_unsigned(out, number.into()));
        let (grid, step) = coordinates.to_numbers();
        write_unsigned(out, grid.into());
        write_unsigned(out, step.into());
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
        write_unsigned(out, mounting.as_ref().map_or(0, |mounting| mounting.order as u64));
        for number in mounting.iter().flat_map(|mounting| mounting.rows.as_flattened()) {
            out.extend_from_slice(&number.to_le_bytes());
        }
        record
    }

    /// Reads the payload of the scanner's record.
    ///
    /// # Errors
    /// If it is truncated or holds values that no scanner has.
    pub fn read_from(bytes: &mut &[u8]) -> Result<Self> {
        let recipe = read_within(bytes, "scanner: recipe", 0..=u64::from(u32::MAX))? as u32;
        let recipe = Recipe::from_number(recipe)
            .ok_or_else(|| Error::unsupported(format!("scanner: unknown recipe {recipe}")))?;
        let ticks = read_within(bytes, "scanner: ticks a turn", 1..=MOST_TICKS)? as u32;
        let range_step_um =
            read_within(bytes, "scanner: range step in micrometres", 1..=MOST_RANGE_STEP_UM)? as u32;
        let grid = read_within(bytes, "scanner: grid of the coordinates", 0..=5)? as u32;
        let step = read_within(bytes, "scanner: step of the grid", 0..=u32::MAX.into())? as u32;
        let coordinates = CoordinateGrid::from_numbers(grid, step)
            .ok_or_else(|| Error::corrupt("scanner: a grid and a step that do not fit together"))?;
        let mut metre = || match read_signed(bytes, "scanner")? {
            um if um.unsigned_abs() <= MOST_ORIGIN_UM => Ok(um as i32),
            _ => Err(Error::corrupt("scanner: beams start too far away")),
        };
        let origin = Origin { along_um: metre()?, up_um: metre()? };
        let rows = read_within(bytes, "scanner: lasers", 1..=MOST_ROWS)? as u32;
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
                .map(|_| {
                    Ok(read_within(bytes, "scanner: ticks behind a column", 0..=u64::from(ticks) - 1)? as u32)
                })
                .collect::<Result<_>>()?,
            other => return Err(Error::unsupported(format!("scanner: unknown columns {other}"))),
        };
        let timing = match read_unsigned(bytes, "scanner")? {
            0 => Timing::Together,
            1 => Timing::Vlp16,
            firings @ 2..=3 => {
                let count = (firings - 1) * u64::from(rows);
                let most = u64::from(WHOLE) * MOST_BLOCKS as u64;
                let part = |_| Ok(read_within(bytes, "scanner: part of a block", 0..=most)? as u32);
                Timing::Parts((0..count).map(part).collect::<Result<_>>()?)
            }
            other => return Err(Error::unsupported(format!("scanner: unknown timing {other}"))),
        };
        let mounting = read_mounting(bytes)?.map(Box::new);
        let build = Build { recipe, ticks, range_step_um, coordinates, origin, timing, mounting };
        Ok(Self::new(build, lasers, rows_of_slots).line_by_line(rows_of_lines).lagging(lags))
    }
}

/// Reads how points were moved to the frame of a vehicle, if they were.
fn read_mounting(bytes: &mut &[u8]) -> Result<Option<Mounting>> {
    let order = read_unsigned(bytes, "scanner")?;
    if order == 0 {
        return Ok(None);
    }
    let order = TransformOrder::from_number(order)
        .ok_or_else(|| Error::unsupported(format!("scanner: unknown order of a mounting {order}")))?;
    let mut rows = [[0.0; 4]; 3];
    for number in rows.as_flattened_mut() {
        *number = read_f64(bytes, "scanner")?;
        // False for NaN too.
        let is_possible = number.abs() <= MOST_MOUNTING;
        if !is_possible {
            return Err(Error::corrupt("scanner: a number of the mounting is out of range"));
        }
    }
    Ok(Some(Mounting { order, rows }))
}

/// Reads a permutation of the rows.
fn read_permutation(bytes: &mut &[u8], rows: u32) -> Result<Vec<u32>> {
    let (mut order, mut seen) = (Vec::new(), vec![false; rows as usize]);
    for _ in 0..rows {
        let row = read_unsigned(bytes, "scanner")?;
        let is_new = seen.get_mut(saturated(row)).map(|seen| !std::mem::replace(seen, true));
        if is_new != Some(true) {
            return Err(Error::corrupt("scanner: an order is no permutation of the rows"));
        }
        order.push(row as u32);
    }
    Ok(order)
}
