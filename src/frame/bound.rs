//! The error bound of bounded mode, and how the encoder keeps it.

use super::fidelity::{IntensityFidelity, PositionFidelity};
use crate::scan::{PointCloud, ScanFile, Widening, Wrapping, squared_distance};
use crate::scanner::CoordinateGrid;

/// The largest errors allowed for decoded values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    /// Largest 3-D distance, in metres.
    max_error: f64,
    /// The grid for points outside the range image.
    lattice: CoordinateGrid,
    intensity: IntensityFidelity,
}

impl Bound {
    /// The bound in these settings; `None` if they require more than a bound.
    pub fn of(positions: PositionFidelity, intensity: IntensityFidelity) -> Option<Self> {
        match (positions, positions.lattice()) {
            (PositionFidelity::Bounded { max_error_um, .. }, Some(lattice)) => {
                Some(Bound { max_error: f64::from(max_error_um) * 1e-6, lattice, intensity })
            }
            _ => None,
        }
    }

    /// The largest error of the formula for a point of the range image, in metres.
    pub fn reach(&self) -> f64 {
        0.5 * self.max_error
    }

    /// The widest bins of ranges, in steps of `step` metres, that keep nearly all points within the bound.
    /// `misses` are the errors of the formula without bins, in metres.
    pub fn bin(&self, step: f64, mut misses: Vec<f64>) -> u32 {
        /// The minimum share of points within the bound; the others are corrected. A correction costs a few
        /// bytes, a finer step one bit for every point.
        const KEPT: f64 = 0.995;
        /// The largest rounding error of two float32 coordinates of a point, in metres, up to a hundred
        /// metres away.
        const ROUNDING: f64 = 2e-5;
        if misses.is_empty() {
            return 1;
        }
        let place = ((misses.len() - 1) as f64 * KEPT) as usize;
        let (_, miss, _) = misses.select_nth_unstable_by(place, f64::total_cmp);
        // The ends of a bin of n steps are (n - 1) / 2 steps from its middle.
        let steps = 2.0 * (self.max_error - *miss - ROUNDING) / step;
        (steps + 1.0).clamp(1.0, 65_536.0) as u32
    }

    /// Moves positions to the lattice where the bound allows it.
    pub fn round_positions(&self, positions: &mut [[f32; 3]]) {
        for position in positions {
            let moved = position.map(|v| self.lattice.value(self.lattice.unit_of(f64::from(v)), 0.0));
            if self.is_near(position, &moved) {
                *position = moved;
            }
        }
    }

    /// Rounds intensities to multiples of the step, if there is one.
    pub fn round_intensities<'a>(&self, intensities: impl Iterator<Item = &'a mut f32>) {
        let IntensityFidelity::Rounded { step_millionths } = self.intensity else { return };
        for value in intensities.filter(|value| value.is_finite()) {
            let count = (f64::from(*value) * 1e6 / f64::from(step_millionths)).round();
            *value = match self.intensity.levels_per_unit() {
                Some(levels) => (count / f64::from(levels)) as f32,
                None => (count * (f64::from(step_millionths) * 1e-6)) as f32,
            };
        }
    }

    /// Whether a decoded scan has the points of the original, in the same order, and all within the bound.
    pub fn holds(&self, original: &ScanFile, decoded: &ScanFile) -> bool {
        let (PointCloud { positions, intensity, channels }, after) = (&original.cloud, &decoded.cloud);
        let half_step = match self.intensity {
            IntensityFidelity::Rounded { step_millionths } => 0.5e-6 * f64::from(step_millionths),
            IntensityFidelity::Exact | IntensityFidelity::None => 0.0,
        };
        // The relative error of rounding to float32 is smaller than this.
        let near =
            |a: f32, b: f32| (f64::from(a) - f64::from(b)).abs() <= half_step + 1e-7 * f64::from(a.abs());
        let same_bits = |a: f32, b: f32| a.to_bits() == b.to_bits();
        original.records == decoded.records
            && positions.len() == after.positions.len()
            && positions.iter().zip(&after.positions).all(|(a, b)| self.is_near(a, b))
            && intensity.len() == after.intensity.len()
            && intensity
                .iter()
                .zip(&after.intensity)
                .all(|(&a, &b)| same_bits(a, b) || (half_step > 0.0 && near(a, b)))
            && *channels == after.channels
    }

    /// By how many metres writing the decoded positions to a file displaced those that are then beyond the
    /// bound, at most; 0 if none is.
    pub fn displaced_by(&self, original: &[[f32; 3]], decoded: &[[f32; 3]], written: &[[f32; 3]]) -> f64 {
        let points = original.iter().zip(decoded).zip(written);
        let beyond = points.filter(|((original, _), written)| !self.is_near(original, written));
        beyond.map(|((_, decoded), written)| squared_distance(decoded, written).sqrt()).fold(0.0, f64::max)
    }

    /// Whether a decoded position is within the bound of the original.
    pub fn is_near(&self, a: &[f32; 3], b: &[f32; 3]) -> bool {
        squared_distance(a, b).sqrt() <= self.max_error || a.map(f32::to_bits) == b.map(f32::to_bits)
    }
}

/// Errors below `most_um` micrometres: 0.5, 1, 2, 5, 10, 20 mm. Larger ones hardly save more.
pub fn smaller_errors(most_um: u32) -> impl Iterator<Item = u32> {
    [500, 1000, 2000, 5000, 10_000, 20_000].into_iter().filter(move |error| *error < most_um)
}

/// The maximum increase, in micrometres, of the distance between two points when their coordinates are
/// written as text or integers instead of float32, in which distances are measured: each coordinate of each
/// point is off by up to half a unit in its last place. 0 for other kinds of files.
pub fn file_rounding_um(scan: &ScanFile) -> u32 {
    let is_rounded = match &scan.layout.wrapping {
        Wrapping::Text(_) | Wrapping::Scaled(_) => true,
        Wrapping::Widened(widenings) | Wrapping::ByField(widenings) | Wrapping::Arrow { widenings, .. } => {
            let is_exact = |widening: &Widening| matches!(widening, Widening::None | Widening::Exact);
            !widenings.iter().all(is_exact)
        }
        Wrapping::Plain | Wrapping::PcdCompressed { .. } | Wrapping::BigEndian => false,
    };
    if !is_rounded {
        return 0;
    }
    let coordinates = scan.cloud.positions.as_flattened().iter().map(|v| v.abs()).filter(|v| v.is_finite());
    let largest = coordinates.fold(0.0, f32::max);
    let unit = f64::from(largest.next_up()) - f64::from(largest);
    (1e6 * 3f64.sqrt() * unit).ceil() as u32
}

/// The maximum displacement, in micrometres, of decoded points when the file is written with integer
/// coordinates: half a step along each axis.
pub fn step_rounding_um(scan: &ScanFile) -> u32 {
    let Some(axes) = scan.layout.axes() else { return 0 };
    let half_steps = axes.map(|axis| 0.5 / axis.per_metre);
    (1e6 * half_steps.iter().map(|half| half * half).sum::<f64>().sqrt()).ceil() as u32
}
