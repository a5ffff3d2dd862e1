//! Undoing motion compensation by time stamps: each point of a scan was moved by the motion of the scanner
//! between the point's time stamp and one moment of the scan, as if the scanner had moved uniformly (Apollo's
//! compensator, and others like it):
//!
//! ```text
//! s = (time - moment) / (last time - first time)
//! v = f32(R(s r) p + s t)              R(a): the rotation about the axis a by the angle |a|
//! ```
//!
//! for a point p of the scanner's formula, and a motion of rotation r and translation t during the scan.
//! `find` estimates the motion from the points, their time stamps and the scanner, or at first from a channel
//! that distinguishes the lasers, if the scanner moved by more than its steps. Points that the formula misses
//! are listed. FORMAT.md 8.15, "By time stamps".

mod find;

pub use find::{fit, undo};

use super::{Miss, Motion, Mover, UnitModel, exponent_of, find_misses, put_right, unless_nan};
use crate::entropy::{AdaptiveBit, ArithmeticDecoder, ArithmeticEncoder, BitCoder};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, saturated, write_unsigned};
use crate::scan::{Channel, Number};

/// The moment to which points were moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Moment {
    /// The last time stamp.
    #[default]
    Last,
    /// The first one.
    First,
    /// Halfway between the two.
    Middle,
}

impl Moment {
    /// Every moment, at the index of its number in the stream.
    const ALL: [Moment; 3] = [Moment::Last, Moment::First, Moment::Middle];
}

/// How the points of a scan were moved by their time stamps, and the points that this misses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stamped {
    /// The index of the channel with the time stamps.
    pub channel: usize,
    /// The moment to which points were moved.
    pub moment: Moment,
    /// The motion from the first time stamp to the last.
    pub motion: Motion,
    /// Points that the formula does not reproduce to the last bit, in ascending order.
    pub misses: Vec<Miss>,
}

impl Stamped {
    /// The points as moved by the formula, in the order of arrival.
    fn formula(&self, measured: &[[f32; 3]], channels: &[Channel]) -> Vec<[f32; 3]> {
        let parts = channels.get(self.channel).map_or_else(Vec::new, |times| parts(times, self.moment));
        let mover = Mover::new(&self.motion);
        // Points of one packet share their time stamp.
        let mut of_last = (0.0f64, mover.at(0.0));
        let moved = measured.iter().zip(parts).map(|(&point, part)| {
            if part.to_bits() != of_last.0.to_bits() {
                of_last = (part, mover.at(part));
            }
            unless_nan(&point, of_last.1.moved(point.map(f64::from)).map(|metres| metres as f32))
        });
        moved.collect()
    }

    /// Records the points of the file `positions` that the formula misses, given the decoded measured points:
    /// those that are not `near` it.
    pub fn find_misses(
        &mut self,
        (measured, channels): (&[[f32; 3]], &[Channel]),
        positions: &[[f32; 3]],
        near: impl Fn(&[f32; 3], &[f32; 3]) -> bool,
    ) {
        self.misses = find_misses(&self.formula(measured, channels), positions, near);
    }

    /// Moves the points of a scan. Misses with a number that no point has are ignored.
    pub fn apply(&self, positions: &mut [[f32; 3]], channels: &[Channel]) {
        let formula = self.formula(positions, channels);
        positions.iter_mut().zip(formula).for_each(|(position, moved)| *position = moved);
        put_right(positions, &self.misses);
    }
}

/// The part of the motion of each point: the time from the moment to its time stamp, relative to the time
/// between the first and the last stamp. 0 for a time stamp that is NaN.
fn parts(times: &Channel, moment: Moment) -> Vec<f64> {
    let since = since_first(times);
    let span = since.iter().copied().filter(|time| time.is_finite()).fold(0.0, f64::max);
    let part = |time: f64| match moment {
        Moment::Last => (time - span) / span,
        Moment::First => time / span,
        Moment::Middle => time / span - 0.5,
    };
    // Adding 0 turns -0.0 into 0.0.
    since.into_iter().map(part).map(|part| if part.is_finite() { part + 0.0 } else { 0.0 }).collect()
}

/// The time from the first time stamp to each.
fn since_first(times: &Channel) -> Vec<f64> {
    let scalar = times.field.scalar;
    let values = times.bytes.chunks_exact(scalar.size() as usize);
    let stamps: Vec<Number> = values.filter_map(|value| scalar.number(value)).collect();
    let (mut least, mut least_float) = (i128::MAX, f64::INFINITY);
    for stamp in &stamps {
        match *stamp {
            Number::Integer(time) => least = least.min(time),
            Number::Float(time) if time.is_finite() => least_float = least_float.min(time),
            Number::Float(_) => {}
        }
    }
    let since = |stamp: Number| match stamp {
        // Subtracted before conversion to floating point, so that no digits are lost.
        Number::Integer(time) => (time - least) as f64,
        Number::Float(time) => time - least_float,
    };
    stamps.into_iter().map(since).collect()
}

/// The section's name in errors.
const WHAT: &str = "stamped";

impl Stamped {
    /// The payload of the section, for a frame whose points were measured at `measured`.
    pub fn to_payload(&self, measured: &[[f32; 3]], channels: &[Channel]) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_unsigned(&mut bytes, self.channel as u64);
        write_unsigned(&mut bytes, self.moment as u64);
        self.motion.write_to(&mut bytes);
        let mut coder = ArithmeticEncoder::default();
        code_misses(&mut coder, &self.formula(measured, channels), &self.misses);
        bytes.extend(coder.finish());
        bytes
    }

    /// Reads the payload of the section.
    ///
    /// # Errors
    /// If it is cut short, or holds a channel that the frame does not have or a motion that no scanner makes.
    pub fn from_payload(mut bytes: &[u8], measured: &[[f32; 3]], channels: &[Channel]) -> Result<Self> {
        let input = &mut bytes;
        let channel = saturated(read_unsigned(input, WHAT)?);
        if channels.get(channel).is_none_or(|channel| channel.field.count != 1) {
            return Err(Error::corrupt(format!("{WHAT}: no channel of time stamps")));
        }
        let moment = read_unsigned(input, WHAT)?;
        let moment = usize::try_from(moment).ok().and_then(|number| Moment::ALL.get(number));
        let moment = *moment.ok_or_else(|| Error::unsupported(format!("{WHAT}: unknown moment")))?;
        let motion = Motion::read_from(input, WHAT)?;
        let mut stamped = Stamped { channel, moment, motion, misses: Vec::new() };
        let mut coder = ArithmeticDecoder::new(bytes);
        stamped.misses = code_misses(&mut coder, &stamped.formula(measured, channels), &[]);
        if coder.is_exhausted() {
            return Err(Error::corrupt(format!("{WHAT} ends too early")));
        }
        Ok(stamped)
    }
}

/// Codes the misses among all points, and returns them.
fn code_misses<C: BitCoder>(coder: &mut C, formula: &[[f32; 3]], misses: &[Miss]) -> Vec<Miss> {
    // Contexts: whether a coordinate is close to 0, where float32 values are dense, and how many of the last
    // two points were missed.
    let mut is_missed = [[AdaptiveBit::default(); 3]; 2];
    let mut of_units = UnitModel::default();
    let mut given = misses.iter().peekable();
    let mut found = Vec::new();
    let mut missed = 0u32;
    for (point, start) in (0u32..).zip(formula) {
        if coder.is_exhausted() {
            break;
        }
        let known = given.next_if(|miss| miss.point == point);
        let is_small = start.iter().any(|&metres| exponent_of(metres) == 0);
        let bit = &mut is_missed[usize::from(is_small)][missed.count_ones() as usize];
        let is_miss = bit.code(coder, known.is_some());
        missed = (missed << 1 | u32::from(is_miss)) & 3;
        if is_miss {
            let mut units = known.map_or([0; 3], |miss| miss.units);
            of_units.code(coder, start, &mut units);
            found.push(Miss { point, units });
        }
    }
    found
}
