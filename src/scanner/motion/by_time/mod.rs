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
//! `find` estimates the motion from the points, their time stamps and the scanner; `rough` does so from a
//! channel that distinguishes the lasers, if the scanner moved by more than its steps. Points that the
//! formula misses are listed. FORMAT.md 8.15, "By time stamps".

mod find;
mod payload;
mod rough;

pub use find::{fit, undo};

use super::{Miss, Motion, Mover, find_misses, put_right, unless_nan};
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
