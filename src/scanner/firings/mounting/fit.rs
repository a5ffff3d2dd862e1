//! Fits a scanner and its mounting to points alone.
//!
//! The [`pose`](super::pose) of the scanner turns points into ranges, elevations and azimuths, of which only
//! the [`direction`](super::direction) of azimuth 0 is still unknown. The numbers of the mounting then follow by
//! least squares, and the measured points, to the last bit, from those of the recipe. To these a scanner is fitted
//! as to any others.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;

use super::direction::{Measurement, Off, Offsets, SAMPLE, Seen, WORTH};
use super::numbers::{COARSE, last_bits, least_squares};
use super::pose::{self, Pose};
use super::{Mounting, TransformOrder};
use crate::ground::floats::round_ties_even;
use crate::scan::{PointCloud, ScanFile, fullest};
use crate::scanner::firings::arithmetic::whole_steps;
use crate::scanner::firings::blur::Blur;
use crate::scanner::firings::constants::{Moved, MovedBy, Point, TRIED, by_rows};
use crate::scanner::firings::fit::{
    ON_CONE, completed, elevations, fit_by, fit_moved, in_ticks, phase, range_step, ticks,
};
use crate::scanner::firings::off_axis::known_start;
use crate::scanner::firings::order::{FiringOrder, lines, order, vlp_16};
use crate::scanner::firings::projection::{Sight, nearest};
use crate::scanner::firings::recipe::Axes;
use crate::scanner::firings::{ANGLE_UNIT, Build, Firings, Laser, Origin, Recipe, THOUSANDTH, Timing};
use crate::scanner::{CoordinateGrid, Return, channel_of_lasers, median, thinned};

/// A scanner with its mounting. `None` if the largest scan of the sample does not show a scanner.
pub fn fit(sample: &[ScanFile]) -> Option<Firings> {
    let scan = fullest(sample)?;
    let positions = &scan.cloud.positions;
    let nothing = of_nothing(positions);
    let is_return = |position: &[f32; 3]| Some(*position) != nothing && may_be_return(position);
    let (start, along) = frame_of(&scan.cloud, is_return)?;
    let returns: Vec<[f32; 3]> = positions.iter().filter(|position| is_return(position)).copied().collect();
    let (scanner, seen, start) = match along {
        0.0 => Seen::of(&returns, &start)?.sharpened(&start)?.with_recipe(&start)?,
        _ => Seen::off_axis(&scan.cloud, nothing, &start, along)?,
    };
    let sharpened = |seen: &Seen, start: &Mounting| {
        let mut pairs = seen.pairs(&scanner);
        pairs.extend(nothing.map(|position| ([0.0; 3], position)));
        let (mounting, exact) = last_bits(&pairs, start)?;
        Some((nothing.map_or(mounting, |position| mounting.with_zeros_at(position)), exact))
    };
    let (mounting, exact) = sharpened(&seen, &start)?;
    // Most recipes round x and y alike, so that a quarter of a turn shows only in the order of a mounting's
    // sums.
    let quarter = seen.later(scanner.build.ticks / 4);
    let other = sharpened(&quarter, &start.turned(FRAC_PI_2)).filter(|(_, other)| *other > exact);
    let mounting = other.map_or(mounting, |(mounting, _)| mounting);
    let mounted = scanner.mounted(mounting);
    fit_by(sample, |cloud| {
        let positions = &cloud.positions;
        let measured = mounted.measured(positions);
        let moved = measured.iter().zip(positions).map(|(measured, position)| Moved {
            measured: *measured,
            by: MovedBy::Mounting(mounting),
            position: *position,
        });
        let fitted = fit_moved(cloud, &moved.collect::<Vec<_>>(), mounted.mean_offset())?;
        let values: Vec<f32> = thinned(positions, SAMPLE).flatten().copied().collect();
        let build = Build { coordinates: CoordinateGrid::finest_of(&values), ..fitted.build.clone() };
        let fitted = Firings { build, ..fitted }.mounted(mounting);
        let reproduced = |scanner: &Firings| scanner.reproduced(positions).0;
        let with_lasers = fitted.with_lasers_of(&mounted);
        let better = with_lasers.filter(|with_lasers| reproduced(with_lasers) > reproduced(&fitted));
        Some(better.unwrap_or(fitted))
    })
}

impl Firings {
    /// The mean of the azimuth offsets of the lasers, in degrees.
    fn mean_offset(&self) -> f64 {
        let sum: f64 = self.lasers.iter().map(Laser::azimuth_degrees).sum();
        sum / self.lasers.len().max(1) as f64
    }

    /// This scanner with the lasers of another one, but for whole ticks. `None` if they are not the same.
    ///
    /// Where roundings do not tell azimuth 0, few points are reproduced, and digits of a laser's angles that
    /// reproduce a few more of them may be wrong.
    fn with_lasers_of(&self, other: &Firings) -> Option<Firings> {
        let tick = (360.0 / f64::from(self.build.ticks) / ANGLE_UNIT).round() as i64;
        let lasers = self.lasers.iter().zip(&other.lasers).map(|(own, other)| {
            let ticks = (own.azimuth - other.azimuth + tick / 2).div_euclid(tick);
            let azimuth = other.azimuth + ticks * tick;
            let is_same = |a: i64, b: i64| (a - b).abs() < THOUSANDTH;
            let laser = Laser { azimuth, ..*other };
            (is_same(own.elevation, laser.elevation) && is_same(own.azimuth, azimuth)).then_some(laser)
        });
        let lasers: Option<Vec<Laser>> = lasers.collect();
        let lasers = lasers.filter(|_| self.lasers.len() == other.lasers.len())?;
        let scanner = Firings::new(self.build.clone(), lasers, self.rows_of_slots.clone());
        Some(scanner.line_by_line(self.rows_of_lines.clone()).lagging(self.lags.clone()))
    }
}

/// Whether a point of a file may be a return: others are not finite, too far away for any scanner, or at the
/// origin.
fn may_be_return(position: &[f32; 3]) -> bool {
    /// In metres.
    const FARTHEST: f32 = 10_000.0;
    position.iter().all(|metres| metres.abs() < FARTHEST) && *position != [0.0; 3]
}

/// Where a cloud has its records without a return, if they were moved, too: where more records are than
/// returns can be.
fn of_nothing(positions: &[[f32; 3]]) -> Option<[f32; 3]> {
    const FEWEST: usize = 20;
    let mut sorted: Vec<[u32; 3]> = positions
        .iter()
        .filter(|position| may_be_return(position))
        .map(|position| position.map(f32::to_bits))
        .collect();
    sorted.sort_unstable();
    let most = sorted.chunk_by(|a, b| a == b).max_by_key(|same| same.len())?;
    (most.len() >= FEWEST).then(|| most[0].map(f32::from_bits))
}

fn vector(position: &[f32; 3]) -> Vector3<f64> {
    Vector3::from(position.map(f64::from))
}

/// The mounting of the scanner that measured a cloud, except for the direction of its azimuth 0, and how far
/// from the axis its beams start, in metres.
fn frame_of(cloud: &PointCloud, is_return: impl Fn(&[f32; 3]) -> bool) -> Option<(Mounting, f64)> {
    const FEWEST: usize = 500;
    let records = (0..cloud.positions.len()).filter(|&at| is_return(&cloud.positions[at]));
    let records: Vec<usize> = records.collect();
    if records.len() < FEWEST {
        return None;
    }
    let point = |record: &usize| vector(&cloud.positions[*record]);
    let points: Vec<Vector3<f64>> = records.iter().map(point).collect();
    let of_rows = channel_of_lasers(&cloud.channels).map(|channel| {
        let mut sorted = records.clone();
        sorted.sort_by_key(|&record| channel.value(record));
        sorted.iter().map(point).collect::<Vec<_>>()
    });
    let pose = pose::find(&points, of_rows.as_deref())?;
    let upright = Mounting::of(&pose);
    // Scanners turn clockwise, seen from above.
    let azimuth = |point: &Vector3<f64>| {
        let [x, y, _] = upright.undone((*point).into());
        libm::atan2(y, x)
    };
    let azimuths: Vec<f64> = points.iter().map(azimuth).collect();
    let steps = azimuths.windows(2).map(|pair| pair[1] - pair[0]);
    let turned: f64 = steps.map(|step| step - round_ties_even(step / TAU) * TAU).sum();
    let mounting = if turned > 0.0 { Mounting::of(&Pose { axis: -pose.axis, ..pose }) } else { upright };
    Some((mounting, pose.along))
}

impl Mounting {
    /// A mounting with this pose.
    fn of(pose: &Pose) -> Self {
        let [one, other] = pose::across(&pose.axis);
        let rows = [0, 1, 2].map(|axis| [one[axis], other[axis], pose.axis[axis], pose.apex[axis]]);
        Mounting { order: TransformOrder::Double, rows }
    }

    /// This mounting, its translation corrected in the last digits such that records without a return, which are
    /// zeros before they are moved, are moved to where the file has them, in metres.
    fn with_zeros_at(mut self, position: [f32; 3]) -> Self {
        /// Parts of a metre in which translations are written.
        const PARTS: [f64; 2] = [1e4, 1e6];
        let moved = self.moved(&[0.0; 3]).map(|metres| metres as f32);
        for axis in (0..3).filter(|&axis| moved[axis] != position[axis]) {
            let metres = f64::from(position[axis]);
            let written = PARTS.map(|parts| round_ties_even(metres * parts) / parts);
            let same = written.into_iter().find(|written| *written as f32 == position[axis]);
            self.rows[axis][3] = same.unwrap_or(metres);
        }
        self
    }
}

impl Seen {
    /// Finds the steps, ticks and lasers of the returns of a file.
    fn of(returns: &[[f32; 3]], mounting: &Mounting) -> Option<Self> {
        /// Coherence of offsets with whole ones.
        const COMMON: f64 = 0.9;
        let measured = returns
            .iter()
            .map(|position| Some((Point::new(mounting.undone(position.map(f64::from)), None)?, *position)));
        let (points, positions): (Vec<Point>, Vec<[f32; 3]>) = measured.flatten().unzip();
        let range_step_um = range_step(points.iter().map(|point| point.range), Blur::default())?;
        let elevations = completed(elevations(&points, ON_CONE)?);
        let row = |point: &Point| {
            let row = nearest(&elevations, point.elevation);
            ((elevations[row] - point.elevation).abs() < ON_CONE).then_some(row)
        };
        let rows: Vec<Option<usize>> = points.iter().map(row).collect();
        let of_rows = by_rows(&points, &rows, elevations.len(), 10 * TRIED);
        let ticks = ticks(&of_rows, Blur::default())?;
        let phase_of = |points: &Vec<Point>| phase(points.iter().map(|point| in_ticks(point, ticks))).0;
        let phases: Vec<f64> = of_rows.iter().map(phase_of).collect();
        let tick = 360.0 / f64::from(ticks);
        // The offsets of the lasers, in ticks, if azimuth 0 is turned by so many more.
        let offsets = |common: f64| -> Vec<f64> {
            let parts = phases.iter().map(|phase| phase - common - round_ties_even(phase - common));
            let parts: Vec<f64> = parts.collect();
            let sequence = points.iter().zip(&rows).filter_map(|(point, row)| {
                let tick = round_ties_even(in_ticks(point, ticks) - common - parts[(*row)?]) as i64;
                Some(((*row)?, tick.rem_euclid(i64::from(ticks)) as u32))
            });
            let whole = whole_ticks(sequence.collect(), &elevations, ticks);
            parts.iter().zip(whole).map(|(part, whole)| part + whole).collect()
        };
        // Azimuth 0 is turned such that the offsets of all lasers are whole ticks, or whole thousandths of
        // degrees.
        let in_parts = |offsets: &[f64], parts: f64| {
            let seen = offsets.iter().zip(&of_rows).filter(|(_, points)| !points.is_empty());
            let (common, strength) = phase(seen.map(|(offset, _)| offset * parts));
            (strength > COMMON).then_some(common / parts)
        };
        let (common, multiples) = match in_parts(&phases, 1.0) {
            Some(common) => (common, Offsets::Ticks),
            None => match in_parts(&offsets(phases[0]), tick * 1e3) {
                Some(common) => (phases[0] + common, Offsets::Thousandths),
                None => (phases[0], Offsets::Any),
            },
        };
        let offsets = offsets(common);
        let elevations: Vec<f64> = elevations.iter().map(|elevation| elevation.to_degrees()).collect();
        let azimuths: Vec<f64> = offsets.iter().map(|offset| offset * tick).collect();
        let elevations = all_as_written(&elevations, &[DEGREES, RADIANS]).into_iter();
        let lasers = elevations.zip(all_as_written(&azimuths, &[DEGREES]));
        let lasers = lasers.map(|(elevation, azimuth)| Laser { elevation, azimuth });
        let build = Build {
            recipe: Recipe::DoubleXAhead,
            ticks,
            range_step_um,
            coordinates: CoordinateGrid::Float32,
            origin: Origin::default(),
            timing: Timing::Together,
            mounting: None,
        };
        let step = f64::from(range_step_um) * 1e-6;
        let found = points.iter().zip(&rows).zip(&positions).filter_map(|((point, row), position)| {
            let row = (*row)?;
            let tick = round_ties_even(in_ticks(point, ticks) - common - offsets[row]) as i64;
            let tick = tick.rem_euclid(i64::from(ticks)) as u32;
            let steps = whole_steps(point.range, step)?;
            Some((Return { row: row as u32, column: 0, tick, steps, echo: 0 }, *position))
        });
        let found: Vec<Measurement> = found.collect();
        let points = thinned(&found, 4 * SAMPLE).copied().collect();
        Some(Seen { build, lasers: lasers.collect(), points, offsets: multiples })
    }

    /// The same with the angles of lasers with which the points come nearest to their positions in the file, if
    /// nobody rounded them to thousandths of degrees.
    fn sharpened(mut self, start: &Mounting) -> Option<Self> {
        const ROUNDS: usize = 3;
        let mut mounting = *start;
        if self.lasers.iter().all(|laser| laser.elevation % THOUSANDTH == 0) {
            return Some(self);
        }
        for _ in 0..ROUNDS {
            let pairs = self.pairs(&self.scanner(Recipe::DoubleXAhead, 0));
            mounting = least_squares(&pairs, &mounting, &COARSE)?;
            // Of each laser: the weight of its points, and their weighted changes of elevation and azimuth.
            let mut sums = vec![[0.0; 3]; self.lasers.len()];
            for ((found, position), (point, _)) in self.points.iter().zip(&pairs) {
                let Some(off) = mounting.off(point, position) else { continue };
                let sum = &mut sums[found.row as usize];
                let Off { weight, up, clockwise } = off;
                *sum = [sum[0] + weight, sum[1] + weight * up, sum[2] + weight * clockwise];
            }
            let in_units = |radians: f64| (radians.to_degrees() / ANGLE_UNIT).round() as i64;
            for (laser, [weight, up, clockwise]) in self.lasers.iter_mut().zip(sums) {
                if weight > 0.0 {
                    laser.elevation += in_units(up / weight);
                    laser.azimuth += in_units(clockwise / weight);
                }
            }
        }
        Some(self)
    }

    /// The scanner of a manufacturer whose beams start away from the axis, and its measurements and mounting;
    /// `along`: how far away, in metres. The mounting has the height at which the lines of the beams cross.
    fn off_axis(
        cloud: &PointCloud,
        nothing: Option<[f32; 3]>,
        mounting: &Mounting,
        along: f64,
    ) -> Option<(Firings, Self, Mounting)> {
        /// Number of points by which the start of the beams is told.
        const POINTS: usize = 40_000;
        let undone = |mounting: &Mounting, position: &[f32; 3]| match Some(*position) == nothing {
            true => [0.0; 3],
            false => mounting.undone(position.map(f64::from)),
        };
        let points =
            thinned(&cloud.positions, POINTS).map(|position| Point::new(undone(mounting, position), None));
        let (origin, ahead) = known_start(&points.flatten().collect::<Vec<_>>(), along)?;
        let [_, up] = origin.metres();
        let mut lower = *mounting;
        lower.rows.iter_mut().for_each(|row| row[3] -= up * row[2]);
        let start = lower.turned(-ahead);
        let moved = cloud.positions.iter().map(|position| Moved {
            measured: undone(&start, position),
            by: MovedBy::Mounting(start),
            position: *position,
        });
        let found = fit_moved(cloud, &moved.collect::<Vec<_>>(), 0.0)?;
        let sight = Sight::new(&found);
        let measurement = |position: &[f32; 3]| {
            let there = undone(&start, position);
            let (measured, formula) = sight.nearest(there)?;
            let is_near = (0..3).all(|axis| (formula[axis] - there[axis]).abs() < found.range_step_m());
            (is_near && measured.steps > 0).then_some((measured, *position))
        };
        let points = thinned(&cloud.positions, 4 * SAMPLE).filter_map(measurement).collect();
        let seen = Seen {
            build: found.build.clone(),
            lasers: found.lasers.clone(),
            points,
            offsets: Offsets::Ticks,
        };
        let recipes: &[Recipe] = match found.build.recipe {
            Recipe::RoboSense => &[
                Recipe::RoboSense,
                Recipe::RoboSenseEarly,
                Recipe::RoboSenseFused,
                Recipe::RoboSenseEarlyFused,
            ],
            _ => &[found.build.recipe],
        };
        let all: Vec<u32> = (0..seen.build.ticks).collect();
        let directions = recipes.iter().filter_map(|recipe| {
            let quarter = if recipe.axes() == Axes::YAhead { FRAC_PI_2 } else { 0.0 };
            seen.direction(*recipe, (0..1, &all), &start.turned(quarter))
        });
        let direction = directions.min_by(|a, b| a.chance().total_cmp(&b.chance()))?;
        let (recipe, later, mounting) = match direction.chance() < WORTH {
            true => (direction.recipe, direction.before.later, direction.mounting),
            false => (found.build.recipe, 0, start),
        };
        let seen = seen.later(later);
        Some((seen.scanner(recipe, 0), seen, mounting))
    }
}

/// The whole ticks of each laser's azimuth offset, as far as the order of the file tells them, from the rows
/// and ticks of its points: such that their mean is about 0.
fn whole_ticks(mut sequence: Vec<(usize, u32)>, elevations: &[f64], ticks: u32) -> Vec<f64> {
    let rows = elevations.len();
    // Echoes say nothing about the order. A VLP-16's lasers have no offsets, but ticks pass while they fire.
    sequence.dedup();
    let of_file = || {
        let by_firings = order(&sequence, rows, ticks, 0);
        by_firings
            .or_else(|| lines(&sequence, rows, ticks).map(|_| FiringOrder::of_lines(&sequence, rows, ticks)))
    };
    let shifts = if vlp_16(elevations).is_some() { None } else { of_file().map(|order| order.shifts) };
    let shifts = shifts.unwrap_or_else(|| vec![0.0; rows]);
    let middle = round_ties_even(shifts.iter().sum::<f64>() / rows.max(1) as f64);
    shifts.into_iter().map(|shift| shift - middle).collect()
}

/// Grids of angles, in degrees: manufacturers write thousandths of degrees, some programs ten-thousandths of
/// radians.
const DEGREES: f64 = 1e-3;
const RADIANS: f64 = 1e-4 * 180.0 / PI;

/// Angles in degrees as they were written, all on one of these grids, or on none, in the unit of [`Laser`].
fn all_as_written(degrees: &[f64], grids: &[f64]) -> Vec<i64> {
    /// In degrees: how near to a grid half of the angles must be. Angles that are on no grid are 2.5e-4 off
    /// on average.
    const MOST_NEAR: f64 = 1e-4;
    /// In degrees: how near an angle must be to be rounded.
    const NEAR: f64 = 2.5e-4;
    let on_grid = |degrees: f64, grid: f64| round_ties_even(degrees / grid) * grid;
    let off = |grid: f64| median(degrees.iter().map(|&angle| (angle - on_grid(angle, grid)).abs()));
    let grid = grids.iter().copied().min_by(|a, b| off(*a).total_cmp(&off(*b)));
    let grid = grid.filter(|grid| off(*grid) < MOST_NEAR);
    let written = |&angle: &f64| {
        let near = grid.map(|grid| on_grid(angle, grid)).filter(|written| (written - angle).abs() < NEAR);
        (near.unwrap_or(angle) / ANGLE_UNIT).round() as i64
    };
    degrees.iter().map(written).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_are_moved_to_where_the_file_has_them() {
        let rows =
            [[0.6, -0.8, 0.0, 0.900_000_06], [0.8, 0.6, 0.0, -1.1e-8], [0.0, 0.0, 1.0, 1.800_000_000_1]];
        for order in TransformOrder::ALL {
            let mounting = Mounting { order, rows };
            let position = [0.9, 0.0, 1.8];
            assert_ne!(mounting.moved(&[0.0; 3]).map(|metres| metres as f32), position);
            let corrected = mounting.with_zeros_at(position);
            assert_eq!(corrected.moved(&[0.0; 3]).map(|metres| metres as f32), position);
            // Written in decimals, as translations are; what is right to float32 is left as it is.
            assert_eq!(corrected.rows.map(|row| row[3]), [0.9, 0.0, 1.800_000_000_1]);
            let odd = [0.123_456_79, 0.0, 1.8];
            assert_eq!(mounting.with_zeros_at(odd).rows[0][3], f64::from(odd[0]));
        }
    }
}
