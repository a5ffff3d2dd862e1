//! Angles between beams and the surfaces that they hit.

use std::f64::consts::TAU;

use super::neighbours::Cell;
use crate::grid::Grid;
use crate::sensor::SensorModel;

/// Ranges and directions of all returns, as if all beams left one point.
pub struct SurfaceAngles {
    /// Rows x columns, metres; 0 = no return.
    ranges: Grid<f32>,
    /// Of each row: cosine and sine of the beam's elevation.
    elevations: Vec<(f32, f32)>,
    /// Azimuth of each column, in radians.
    azimuths: Vec<f32>,
}

impl SurfaceAngles {
    /// Of an image.
    pub fn of(steps: &Grid<u32>, columns: &[u32], sensor: &SensorModel) -> Self {
        let mut ranges = Grid::new(steps.rows(), steps.columns());
        for row in 0..ranges.rows() {
            for (range, &steps) in ranges.row_mut(row).iter_mut().zip(steps.row(row)) {
                *range = sensor.metres(steps) as f32;
            }
        }
        let tick = TAU / f64::from(sensor.ticks);
        let elevation = |row| {
            let elevation = sensor.elevation(row);
            (libm::cos(elevation) as f32, libm::sin(elevation) as f32)
        };
        SurfaceAngles {
            ranges,
            elevations: (0..sensor.rows()).map(elevation).collect(),
            azimuths: columns.iter().map(|&column| (f64::from(column) * tick) as f32).collect(),
        }
    }

    /// Equation 3: whether the line between two returns rises by less than the angle of this tangent.
    pub fn is_flat(&self, a: Cell, b: Cell, tangent: f32) -> bool {
        let place = |cell: Cell| {
            let (cos, sin) = self.elevations[cell.0];
            (self.ranges[cell] * cos, self.ranges[cell] * sin)
        };
        let ((rho_a, z_a), (rho_b, z_b)) = (place(a), place(b));
        let turned = self.turn(a.1, b.1) * rho_a.min(rho_b);
        let along = ((rho_a - rho_b) * (rho_a - rho_b) + turned * turned).sqrt();
        (z_a - z_b).abs() < tangent * along
    }

    /// Equation 4: whether the angle between the longer beam and the line to the shorter one's end is
    /// larger than that of this tangent.
    pub fn is_one_surface(&self, a: Cell, b: Cell, tangent: f32) -> bool {
        let between = if a.0 == b.0 { self.turn(a.1, b.1) } else { self.rise(a.0, b.0) };
        let (near, far) = (self.ranges[a].min(self.ranges[b]), self.ranges[a].max(self.ranges[b]));
        // For angles below a degree, to a thousandth of it.
        let (sin, cos) = (between, 1.0 - 0.5 * between * between);
        near * sin > tangent * (far - near * cos)
    }

    /// The angle between two columns, in radians.
    fn turn(&self, a: usize, b: usize) -> f32 {
        let apart = (self.azimuths[a] - self.azimuths[b]).abs();
        apart.min(TAU as f32 - apart)
    }

    /// The angle between two rows, in radians.
    fn rise(&self, a: usize, b: usize) -> f32 {
        let ((cos_a, sin_a), (cos_b, sin_b)) = (self.elevations[a], self.elevations[b]);
        (sin_a * cos_b - cos_a * sin_b).abs()
    }
}
