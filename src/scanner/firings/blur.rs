//! Clouds whose coordinates were rounded to millimetres or coarser after they were computed. The rounding moves a point
//! by an angle that is the greater the nearer the point is: near points may seem to have another tick, and far ones
//! determine the scanner.

use std::f64::consts::TAU;

use super::Build;
use super::constants::Point;
use crate::ground::rounding::round_ties_even;
use crate::scanner::Coordinates;

/// By how much rounding has moved points, in metres along an axis, at most; 0 if the grid is so fine that it does not
/// matter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Blur(f64);

impl Blur {
    /// That of coordinates on this grid.
    pub fn of(grid: Coordinates) -> Self {
        const COARSE_NM: u64 = 1_000_000;
        Blur(match grid {
            Coordinates::Millimetre => 0.5e-3,
            Coordinates::Lattice { step_nm } if step_nm >= COARSE_NM => 0.5e-9 * step_nm as f64,
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
        libm::exp(-0.5 * (TAU * deviation / metres).powi(2))
    }

    /// The same for the azimuth of a point.
    pub fn coherence_of_ticks(self, point: &Point, ticks: u32) -> f64 {
        let [x, y, _] = point.position;
        self.coherence((x * x + y * y).sqrt() * TAU / f64::from(ticks))
    }

    /// The step of the coordinates, in micrometres.
    pub fn step_um(self) -> u32 {
        round_ties_even(2e6 * self.0) as u32
    }

    /// By how many ticks the tick nearest to a point, at this distance from the axis in metres, may differ from its own.
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

    /// The range of the nearest point from which a scanner is fitted, in metres: some to be tried one after the other,
    /// falling.
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
