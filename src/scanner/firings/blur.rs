//! Clouds whose coordinates were rounded to millimetres or coarser after they were computed. The rounding
//! moves a point by an angle that is the greater the nearer the point is: near points may seem to have
//! another tick, and far ones determine the scanner.

use std::f64::consts::TAU;

use super::constants::Point;
use super::projection::{Column, LONGEST, Place};
use super::timing::Span;
use super::{Build, Firings};
use crate::ground::floats::{round_ties_even, square};
use crate::scan::PointCloud;
use crate::scanner::{CoordinateGrid, Projection, Return};

/// By how much rounding has moved points, in metres along an axis, at most; 0 if the grid is so fine that it
/// does not matter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Blur(f64);

impl Blur {
    /// That of coordinates on this grid.
    pub fn of(grid: CoordinateGrid) -> Self {
        const COARSE_NM: u64 = 1_000_000;
        Blur(match grid {
            CoordinateGrid::Millimetre => 0.5e-3,
            CoordinateGrid::Lattice { step_nm } if step_nm >= COARSE_NM => 0.5e-9 * step_nm as f64,
            _ => 0.0,
        })
    }

    /// Whether there is any.
    pub fn is_any(self) -> bool {
        self.0 > 0.0
    }

    /// In metres: the largest distance in a plane, or in space, by which a point has been moved.
    fn in_plane(self) -> f64 {
        self.0 * std::f64::consts::SQRT_2
    }

    fn in_space(self) -> f64 {
        self.0 * 3f64.sqrt()
    }

    /// In metres: by how much farther from the file's points positions of the recipe may be along an axis.
    pub fn reach(self) -> f64 {
        self.0
    }

    /// The coherence that values on a grid of steps of `metres` still have.
    pub fn coherence(self, metres: f64) -> f64 {
        let deviation = self.0 / 3f64.sqrt();
        libm::exp(-0.5 * square(TAU * deviation / metres))
    }

    /// The coherence that the azimuth of this point still has on a grid of so many ticks a turn.
    pub fn coherence_of_ticks(self, point: &Point, ticks: u32) -> f64 {
        let [x, y, _] = point.position;
        self.coherence((x * x + y * y).sqrt() * TAU / f64::from(ticks))
    }

    /// The step of the coordinates, in micrometres.
    pub fn step_um(self) -> u32 {
        round_ties_even(2e6 * self.0) as u32
    }

    /// By how many ticks the tick nearest to a point, at this distance from the axis in metres, may differ
    /// from its own.
    #[inline]
    pub fn ticks(self, distance: f64, ticks: u32) -> u32 {
        let metres = distance * TAU / f64::from(ticks);
        (self.in_plane() / metres + 0.5).min(f64::from(ticks / 4)) as u32
    }

    /// By how many steps the nearest range may differ from the measured one.
    pub fn steps(self, build: &Build) -> u32 {
        (self.in_space() * 1e6 / f64::from(build.range_step_um) + 0.5) as u32
    }

    /// In radians: the largest angle by which a point at this distance may have been moved.
    pub fn angle(self, metres: f64) -> f64 {
        if self.is_any() { self.in_space() / metres } else { 0.0 }
    }

    /// The range of the nearest point from which a scanner is fitted, in metres: some to be tried one after
    /// the other, falling.
    pub fn nearest(self, points: &[Point]) -> Vec<f64> {
        /// In radians: the largest angles by which a point may have been moved along an axis.
        const ANGLES: [f64; 3] = [6e-5, 2.5e-4, 1e-3];
        /// A sufficient number of points.
        const ENOUGH: usize = 4000;
        if !self.is_any() {
            return vec![0.0];
        }
        let mut ranges: Vec<f64> = points.iter().map(|point| point.range).collect();
        ranges.sort_unstable_by(|a, b| b.total_cmp(a));
        let of_enough = ranges.get(ENOUGH.min(ranges.len() / 4)).copied().unwrap_or(0.0);
        let mut nearest = ANGLES.map(|angle| f64::min(self.0 / angle, of_enough)).to_vec();
        nearest.dedup();
        nearest
    }
}

impl Firings {
    /// Whether a place may be at a tick of its laser.
    #[inline]
    pub(super) fn is_at(&self, tick: u32, place: &Place) -> bool {
        tick == place.tick
            || (place.slack > 0 && self.turned(tick, place.tick).unsigned_abs() <= u64::from(place.slack))
    }

    /// The range of a place at a tick of its laser, in steps: its own, or if the coordinates were rounded,
    /// the one that reproduces the most of them. `None` if it is at another tick.
    #[inline(always)]
    pub(super) fn steps_at(
        &self,
        tick: u32,
        place: &Place,
        positions: &[[f32; 3]],
        reach: f64,
    ) -> Option<u32> {
        if !self.is_at(tick, place) {
            return None;
        }
        let blur = Blur::of(self.build.coordinates);
        match blur.is_any() {
            false => Some(place.steps),
            true => self.blurred_steps_at(tick, place, &positions[place.point as usize], blur, reach),
        }
    }

    /// The same if the coordinates were rounded.
    fn blurred_steps_at(
        &self,
        tick: u32,
        place: &Place,
        position: &[f32; 3],
        blur: Blur,
        reach: f64,
    ) -> Option<u32> {
        let grid = self.build.coordinates;
        let reach = reach + 0.5 * self.range_step_m() + blur.reach();
        let tried_steps = |steps: i64| {
            let steps = u32::try_from(steps).ok().filter(|steps| (1..LONGEST).contains(steps))?;
            let formula = self.position(&Return { row: place.row, column: 0, tick, steps, echo: 0 }, 0.0);
            let is_near = (0..3).all(|axis| (formula[axis] - f64::from(position[axis])).abs() < reach);
            // At another tick, a zero may have another sign.
            let is_held = is_near && (0..3).all(|axis| grid.holds(position[axis], formula[axis]));
            let reproduced = || (0..3).filter(|&axis| grid.nearest(formula[axis]) == position[axis]).count();
            is_held.then(|| (reproduced(), steps))
        };
        // The nearest first, which wins ties.
        let own = i64::from(place.steps);
        let most = i64::from(blur.steps(&self.build));
        let tried = std::iter::once(own).chain((1..=most).flat_map(|off| [own - off, own + off]));
        let better = |best: (usize, u32), next: (usize, u32)| if next.0 > best.0 { next } else { best };
        tried.filter_map(tried_steps).reduce(better).map(|(_, steps)| steps)
    }

    /// Gives columns the ticks that agree with all of their places or, if there are several such ticks, the
    /// one that the turn of the columns before makes likely.
    pub(super) fn settle_ticks(&self, places: &[Place], columns: &mut [Column]) {
        let (mut last, mut step) = (None, 0);
        for column in columns {
            let mut of_column: Vec<&Place> = places[column.places.clone()].iter().collect();
            of_column.sort_by_key(|place| place.slack);
            let Some(first) = of_column.first().map(|place| place.column_tick) else { continue };
            let (mut low, mut high) = (i64::MIN, i64::MAX);
            for place in of_column {
                let (off, slack) = (self.turned(first, place.column_tick), i64::from(place.slack));
                let (lower, upper) = (low.max(off - slack), high.min(off + slack));
                if lower > upper {
                    break;
                }
                (low, high) = (lower, upper);
            }
            let likely = last.map_or(0, |last| self.turned(first, last) + step);
            let turn = i64::from(self.build.ticks);
            let tick = (i64::from(first) + likely.clamp(low, high)).rem_euclid(turn) as u32;
            if let Some(last) = last {
                step = self.turned(last, tick);
            }
            (column.tick, last) = (tick, Some(tick));
        }
    }

    /// The share of the points in an image whose coordinates the recipe reproduces.
    pub(super) fn accuracy(&self, projection: &Projection, cloud: &PointCloud) -> f64 {
        let image = &projection.image;
        let span = |column: usize| Span::unpacked(image.spans.get(column).copied().unwrap_or(0));
        let (mut reproduced, mut all) = (0u32, 0u32);
        for row in 0..self.rows() {
            for (column, &base) in
                image.columns.iter().enumerate().filter(|(column, _)| image.steps[(row, *column)] > 0)
            {
                let (tick, steps) = (self.tick(row, base, span(column)), image.steps[(row, column)]);
                let found = Return { row: row as u32, column: column as u32, tick, steps, echo: 0 };
                let point = projection.point_of_cell[(row, column)];
                reproduced +=
                    u32::from(self.reproduces(&found, &cloud.positions[point as usize].map(f64::from), 0..3));
                all += 1;
            }
        }
        f64::from(reproduced) / f64::from(all.max(1))
    }
}
