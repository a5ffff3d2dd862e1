//! The section of a frame that describes how its points were moved through a world frame. FORMAT.md 8.15.

use super::{Correction, Formula, Knot, Pose, SLOTS, Times, World};
use crate::entropy::{AdaptiveBit, ArithmeticDecoder, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{
    read_f64, read_signed, read_within, unzigzag, write_signed, write_unsigned, zigzag,
};
use crate::scanner::motion::{UnitModel, unless_nan};

/// The section's name in errors.
const WHAT: &str = "world";
/// A bound above the poses, rotations in radians and positions in metres of any scanner.
const MOST_UNITS: u64 = 1 << 45;
const LARGEST_ROTATION: f64 = 8.0;
const FARTHEST: f64 = 1e9;
/// A bound on the fineness of lattices, as a power of two: finer than those of float32 near a metre.
const FINEST: u64 = 60;
/// A bound above the number of knots, and of firings before the first border.
const MOST_KNOTS: u64 = 4096;
/// A bound above the end of any sweep, in quarters of a microsecond.
const LATEST: u64 = 1 << 31;

impl World {
    /// Whether a stream may contain this.
    pub(super) fn is_possible(&self) -> bool {
        let poses = self.first.iter().chain(self.knots.iter().map(|knot| &knot.pose));
        let mut units = poses.flat_map(|pose| pose.position.into_iter().chain(pose.rotation));
        // False for NaN too.
        self.rotation.iter().all(|r| r.abs() <= LARGEST_ROTATION)
            && self.origin.iter().all(|metres| metres.abs() <= FARTHEST)
            && units.all(|units| units.unsigned_abs() <= MOST_UNITS)
            && (2..=MOST_KNOTS as usize).contains(&self.knots.len())
            && self.knots.windows(2).all(|pair| pair[0].time < pair[1].time)
    }

    /// The payload of the section, for a frame whose points were measured at `measured`.
    pub fn to_payload(&self, measured: &[[f32; 3]]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let out = &mut bytes;
        let values = self.rotation.iter().chain(&self.origin);
        values.for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
        for lattice in self.lattices {
            write_unsigned(out, lattice.map_or(0, |exponent| 1 + u64::from(exponent.unsigned_abs())));
        }
        let Times { border, short } = self.times;
        [border, short].iter().for_each(|&number| write_unsigned(out, number.into()));
        let mut last = Pose::default();
        self.first.iter().for_each(|pose| write_pose(out, pose, &mut last));
        write_unsigned(out, self.knots.len() as u64);
        let mut time = 0;
        for knot in &self.knots {
            write_unsigned(out, u64::from(knot.time - time));
            time = knot.time;
            write_pose(out, &knot.pose, &mut last);
        }
        let mut coder = ArithmeticEncoder::default();
        code_corrections(&mut coder, &Formula::new(self, measured.len()), measured, &self.corrections);
        bytes.extend(coder.finish());
        bytes
    }

    /// Reads the payload of the section.
    ///
    /// # Errors
    /// If it is cut short, or holds values that no scanner produces.
    pub fn from_payload(bytes: &[u8], measured: &[[f32; 3]]) -> Result<Self> {
        let (mut world, rest) = Self::read_header(bytes, measured.len().div_ceil(SLOTS))?;
        let mut coder = ArithmeticDecoder::new(rest);
        world.corrections =
            code_corrections(&mut coder, &Formula::new(&world, measured.len()), measured, &[]);
        if coder.is_exhausted() {
            return Err(Error::corrupt(format!("{WHAT} ends too early")));
        }
        Ok(world)
    }

    /// Everything but the corrections, and the bytes after it.
    fn read_header(mut bytes: &[u8], firings: usize) -> Result<(Self, &[u8])> {
        let input = &mut bytes;
        let mut values = [0.0; 6];
        for (number, value) in values.iter_mut().enumerate() {
            *value = read_value(input, if number < 3 { LARGEST_ROTATION } else { FARTHEST })?;
        }
        let mut world = World::default();
        let [rx, ry, rz, x, y, z] = values;
        (world.rotation, world.origin) = ([rx, ry, rz], [x, y, z]);
        for lattice in &mut world.lattices {
            let number = read_within(input, "exponent of a world's lattice", 0..=FINEST + 1)?;
            *lattice = number.checked_sub(1).map(|exponent| -(exponent as i32));
        }
        let border = read_within(input, "first border of a world", 0..=MOST_KNOTS)? as u32;
        let short = read_within(input, "first border of a world that is not late", 0..=MOST_KNOTS)? as u32;
        world.times = Times { border, short };
        let mut last = Pose::default();
        for _ in 0..firings.min(border as usize + 1) {
            world.first.push(read_pose(input, &mut last)?);
        }
        let knots = read_within(input, "knots of a world", 2..=MOST_KNOTS)?;
        let mut time = 0;
        for number in 0..knots {
            let later = read_within(input, "time of a world", 0..=LATEST)?;
            if number > 0 && later == 0 || time + later > LATEST {
                return Err(Error::corrupt(format!("{WHAT}: knots out of order")));
            }
            time += later;
            world.knots.push(Knot { time: time as u32, pose: read_pose(input, &mut last)? });
        }
        Ok((world, bytes))
    }
}

/// Poses are coded as differences from the one before.
fn write_pose(out: &mut Vec<u8>, pose: &Pose, last: &mut Pose) {
    let numbers = |pose: &Pose| pose.position.into_iter().chain(pose.rotation);
    numbers(pose).zip(numbers(last)).for_each(|(now, before)| write_signed(out, now.wrapping_sub(before)));
    *last = *pose;
}

fn read_pose(input: &mut &[u8], last: &mut Pose) -> Result<Pose> {
    for number in last.position.iter_mut().chain(&mut last.rotation) {
        *number = number.wrapping_add(read_signed(input, WHAT)?);
        if number.unsigned_abs() > MOST_UNITS {
            return Err(Error::corrupt(format!("{WHAT}: a pose too far away")));
        }
    }
    Ok(*last)
}

fn read_value(input: &mut &[u8], most: f64) -> Result<f64> {
    let value = read_f64(input, WHAT)?;
    // False for NaN too.
    if value.abs() <= most { Ok(value) } else { Err(Error::corrupt(format!("{WHAT}: {value} is too large"))) }
}

/// The adaptive models of the corrections.
#[derive(Default)]
struct Models {
    /// Whether a record without a return has the same correction as the one before in the firing.
    again: AdaptiveBit,
    /// Whether a record is corrected, in the context of whether it has a return, and how many of the last two
    /// were corrected.
    is_missed: [[AdaptiveBit; 3]; 2],
    steps: [IntegerModel; 2],
    units: UnitModel,
}

/// Codes the corrections of all records, and returns them.
fn code_corrections<C: BitCoder>(
    coder: &mut C,
    formula: &Formula,
    measured: &[[f32; 3]],
    corrections: &[Correction],
) -> Vec<Correction> {
    let mut models = Models::default();
    let mut given = corrections.iter().peekable();
    let mut found = Vec::new();
    let (mut missed, mut of_none): (usize, Option<Correction>) = (0, None);
    for (record, measured) in measured.iter().enumerate() {
        if record % SLOTS == 0 {
            of_none = None;
            if coder.is_exhausted() {
                break;
            }
        }
        let known = given.next_if(|correction| correction.record as usize == record).copied();
        let mut correction = Correction { record: record as u32, ..known.unwrap_or_default() };
        let is_none = *measured == [0.0; 3];
        if let Some(last) = of_none.filter(|_| is_none) {
            let same = Correction { record: correction.record, ..last };
            if models.again.code(coder, correction == same) {
                found.extend((!is_right(&same)).then_some(same));
                continue;
            }
        }
        models.code(coder, (formula, measured), (is_none, missed.count_ones() as usize), &mut correction);
        missed = (missed << 1 | usize::from(!is_right(&correction))) & 3;
        of_none = if is_none { Some(correction) } else { of_none };
        found.extend((!is_right(&correction)).then_some(correction));
    }
    found
}

fn is_right(correction: &Correction) -> bool {
    correction.steps == [0; 2] && correction.units == [0; 3]
}

impl Models {
    fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (formula, measured): (&Formula, &[f32; 3]),
        (is_none, missed): (bool, usize),
        correction: &mut Correction,
    ) {
        let is_missed = &mut self.is_missed[usize::from(is_none)][missed.min(2)];
        if !is_missed.code(coder, !is_right(correction)) {
            (correction.steps, correction.units) = ([0; 2], [0; 3]);
            return;
        }
        for axis in (0..2).filter(|&axis| formula.steps[axis] > 0.0) {
            let steps = &mut correction.steps[axis];
            *steps = unzigzag(self.steps[axis].code(coder, zigzag(*steps)));
        }
        let world = formula.world(correction.record as usize, measured);
        let start = unless_nan(measured, formula.file(world, &correction.steps));
        self.units.code(coder, &start, &mut correction.units);
    }
}
