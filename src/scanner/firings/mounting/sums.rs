//! Finds the azimuth offsets of lasers if a recipe adds them to the angles of ticks in single precision: whatever
//! digits they have, and up to a common multiple of the distance of such numbers.
//!
//! The angle of a tick is a multiple of the distance of its neighbours among numbers of single precision, and so is
//! a sum. An offset thus is in effect rounded to a multiple, and to other ones where sums are from 4 on, from 2 on,
//! and from 1 on, as numbers are 4.8e-7, 2.4e-7 and 1.2e-7 radians apart there. These roundings show which tick is
//! which, where azimuth 0 is, up to a multiple, and together more digits of the offset than each of them.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::Mounting;
use super::direction::{Measurement, Seen};
use super::numbers::{COARSE, Pair, least_squares};
use crate::ground::floats::{round_ties_even, square};
use crate::scanner::firings::fit::phase;
use crate::scanner::firings::{ANGLE_UNIT, Laser};
use crate::scanner::thinned;

/// Radians between numbers of single precision from 4 on, from 2 on, and from 1 on. The roundings of smaller ones
/// are not looked at.
const APART: [f64; 3] = [1.0 / (1 << 21) as f64, 1.0 / (1 << 22) as f64, 1.0 / (1 << 23) as f64];

/// Radians by which all offsets may be turned together: angles are rounded as before.
pub(super) const COMMON: f64 = APART[0];

/// Sums that are rounded alike: those in the range of an element of [`APART`] whose tick is at an even multiple or
/// at an odd one, as ties are rounded to even ones; and the smaller ones.
const CLASSES: usize = 2 * APART.len() + 1;

/// The class of a sum, and of the angle of its tick.
fn class(sum: f64, angle: f64) -> usize {
    let range = [4.0, 2.0, 1.0].iter().position(|least| sum >= *least);
    let parity = |apart: f64| ((angle / apart).round() as i64).rem_euclid(2) as usize;
    range.map_or(CLASSES - 1, |range| 2 * range + parity(APART[range]))
}

/// By how many radians sums of a class are more than the angles of their ticks, given the offset.
fn rounded(offset: f64, class: usize) -> f64 {
    let parity = (class % 2) as f64;
    let nearest = |apart: &f64| (round_ties_even(offset / apart + parity) - parity) * apart;
    APART.get(class / 2).map_or(offset, nearest)
}

/// Lasers as such sums show them.
pub(super) struct SumsInSingle {
    /// With nearly their constants. All azimuth offsets may be greater by the same multiple of [`COMMON`].
    pub lasers: Vec<Laser>,
    /// By how many ticks azimuth 0 is before that of the measurements.
    pub later: u32,
    /// The mounting if it is that of the measurements.
    pub start: Mounting,
    /// How far azimuths are off, in radians: the mean of the weighted squares.
    pub error: f64,
}

impl SumsInSingle {
    /// The lasers if azimuth 0 is so many ticks before that of the measurements, by a number of points, in a number
    /// of rounds. `None` if they do not show that sums were rounded.
    pub fn of(seen: &Seen, later: u32, start: &Mounting, (points, rounds): (usize, usize)) -> Option<Self> {
        /// Coherence of the offsets with multiples.
        const COHERENT: f64 = 0.7;
        let ticks = seen.build.ticks;
        let tick = TAU / f64::from(ticks);
        let step = f64::from(seen.build.range_step_um) * 1e-6;
        let points: Vec<Measurement> = thinned(&seen.points, points).copied().collect();
        let angle = |tick_before: u32| f64::from((f64::from((tick_before + later) % ticks) * tick) as f32);
        let angles: Vec<f64> = points.iter().map(|(found, _)| angle(found.tick)).collect();
        let in_radians = |degrees: f64| degrees.to_radians();
        let mut elevations: Vec<f64> =
            seen.lasers.iter().map(|laser| in_radians(laser.elevation_degrees())).collect();
        let mut offsets: Vec<[f64; CLASSES]> =
            seen.lasers.iter().map(|laser| [in_radians(laser.azimuth_degrees()); CLASSES]).collect();
        let mut weights = vec![[0.0; CLASSES]; offsets.len()];
        let mut mounting = start.turned(-FRAC_PI_2 + f64::from(later) * tick);
        let mut error = f64::INFINITY;
        for round in 0..rounds {
            let measured = points.iter().zip(&angles).map(|((found, position), angle)| {
                let row = found.row as usize;
                let class = class(angle + offsets[row][0], *angle);
                let (sin, cos) = libm::sincos(angle + offsets[row][class]);
                let (sin_v, cos_v) = libm::sincos(elevations[row]);
                let range = f64::from(found.steps) * step;
                ((row, class), ([cos_v * sin, cos_v * cos, sin_v].map(|part| part * range), *position))
            });
            let (places, pairs): (Vec<(usize, usize)>, Vec<Pair>) = measured.unzip();
            let passes = if round == 0 { &COARSE[..] } else { &COARSE[COARSE.len() - 1..] };
            mounting = least_squares(&pairs, &mounting, passes)?.rigid();
            weights.fill([0.0; CLASSES]);
            let (mut clockwise, mut up) = (weights.clone(), vec![0.0; elevations.len()]);
            let (mut squares, mut sum) = (0.0, 0.0);
            for (&(row, class), (point, position)) in places.iter().zip(&pairs) {
                let Some(off) = mounting.off(point, position) else { continue };
                weights[row][class] += off.weight;
                clockwise[row][class] += off.weight * off.clockwise;
                up[row] += off.weight * off.up;
                squares += off.weight * square(off.clockwise);
                sum += off.weight;
            }
            error = squares / sum;
            for (row, weights) in weights.iter().enumerate() {
                for (class, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
                    offsets[row][class] += clockwise[row][class] / weight;
                }
                let weight: f64 = weights.iter().sum();
                elevations[row] += if weight > 0.0 { up[row] / weight } else { 0.0 };
            }
        }
        // The first two classes are those of the greatest distance.
        let measured = offsets.iter().zip(&weights).flat_map(|(offsets, weights)| {
            let seen = offsets.iter().zip(weights).take(2).filter(|(_, weight)| **weight > 0.0);
            seen.map(|(offset, _)| offset / COMMON)
        });
        let (common, strength) = phase(measured);
        if strength < COHERENT {
            return None;
        }
        let common = common * COMMON;
        let in_units = |radians: f64| (radians.to_degrees() / ANGLE_UNIT).round() as i64;
        let lasers = elevations.iter().zip(offsets).zip(&weights).map(|((elevation, offsets), weights)| {
            let azimuth = in_units(before_rounding(&offsets.map(|offset| offset - common), weights));
            Laser { elevation: in_units(*elevation), azimuth }
        });
        let start = mounting.turned(FRAC_PI_2 - f64::from(later) * tick - common);
        Some(SumsInSingle { lasers: lasers.collect(), later, start, error })
    }
}

/// The offset that, rounded as the sums of each class are, comes nearest to what was measured, by these weights.
fn before_rounding(measured: &[f64; CLASSES], weights: &[f64; CLASSES]) -> f64 {
    /// Parts of [`COMMON`] that are tried, which include the ties of all roundings, and how many to either side.
    const PARTS: f64 = 64.0;
    const TRIED: i32 = 64;
    let (sum, weight) = measured
        .iter()
        .zip(weights)
        .fold((0.0, 0.0), |(sum, all), (offset, weight)| (sum + offset * weight, all + weight));
    let mean = if weight > 0.0 { sum / weight } else { measured[0] };
    let middle = round_ties_even(mean / COMMON) * COMMON;
    let error = |offset: f64| -> f64 {
        let errors = measured
            .iter()
            .zip(weights)
            .enumerate()
            .map(|(class, (measured, weight))| weight * square(rounded(offset, class) - measured));
        errors.sum()
    };
    let tried = (-TRIED..=TRIED).map(|steps| middle + f64::from(steps) * (COMMON / PARTS));
    let tried: Vec<(f64, f64)> = tried.map(|offset| (offset, error(offset))).collect();
    let least = tried.iter().map(|(_, error)| *error).fold(f64::INFINITY, f64::min);
    // If several are as good, not one at the border.
    let best: Vec<f64> =
        tried.into_iter().filter(|(_, error)| *error == least).map(|(offset, _)| offset).collect();
    best[best.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An angle that is a number of single precision in the range of a class, with its parity.
    fn angle_of(class: usize) -> f64 {
        let Some(apart) = APART.get(class / 2) else { return 0.5 };
        let least = [4.0, 2.0, 1.0][class / 2];
        least * 1.25 + (class % 2) as f64 * apart
    }

    #[test]
    fn classes_round_as_single_precision_does() {
        for offset in [-1.042f32, 3.125, -5.208, 0.76, 1e-4, -0.000_033].map(f32::to_radians) {
            for class_of_sum in 0..CLASSES - 1 {
                let angle = angle_of(class_of_sum);
                let sum = angle as f32 + offset;
                assert_eq!(class(sum.into(), angle), class_of_sum);
                assert_eq!(f64::from(sum) - angle, rounded(offset.into(), class_of_sum), "{offset} {angle}");
            }
        }
    }

    #[test]
    fn offsets_are_found_by_their_roundings() {
        // The first is a tie: -1.042 degrees.
        for offset in [f64::from((-1.042f32).to_radians()), 0.012_345_67, -0.101_010_1] {
            let measured = std::array::from_fn(|class| rounded(offset, class));
            let found = before_rounding(&measured, &[1.0; CLASSES]);
            // The nearest part may be a tie, which is rounded otherwise: then it is the one beside it.
            assert!((found - offset).abs() <= COMMON / 64.0, "{found} {offset}");
            for (class, measured) in measured.into_iter().enumerate().take(CLASSES - 1) {
                assert_eq!(rounded(found, class), measured, "{offset}");
            }
        }
    }
}
