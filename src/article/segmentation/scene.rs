//! The positions of returns, and the angles between them.

use std::f64::consts::TAU;

use crate::ground::grid::Grid;
use crate::scanner::hdl64::{Alignment, Hdl64};

use super::neighbours::Cell;

/// The direction of a beam.
struct Beam {
    /// Cosine and sine of its elevation.
    cos: f32,
    sin: f32,
    /// Height of its origin above the scanner's centre, in metres.
    height: f32,
    /// The column of the image that corresponds to its first aligned column.
    turn: usize,
}

/// The returns of an image with aligned columns.
pub struct Scene {
    /// Rows x columns, metres; 0 = no return.
    pub ranges: Grid<f32>,
    beams: Vec<Beam>,
    /// Azimuth of each column of the image, in radians, for two turns.
    azimuths: Vec<f32>,
}

impl Scene {
    /// The scene of an image, given its ranges in steps and its column ticks.
    pub fn of(steps: &Grid<u32>, columns: &[u32], scanner: &Hdl64, alignment: &Alignment) -> Self {
        let mut ranges = Grid::new(steps.rows(), steps.columns());
        for row in 0..ranges.rows() {
            for (range, &steps) in ranges.row_mut(row).iter_mut().zip(steps.row(row)) {
                *range = scanner.metres(steps) as f32;
            }
        }
        alignment.align(&mut ranges);
        let beam = |row| {
            let elevation = scanner.elevation(row);
            Beam {
                cos: libm::cos(elevation) as f32,
                sin: libm::sin(elevation) as f32,
                height: scanner.height(row) as f32,
                turn: alignment.turn(row),
            }
        };
        let tick = TAU / f64::from(scanner.ticks);
        let azimuth = |column: &u32| (f64::from(*column) * tick) as f32;
        Scene {
            ranges,
            beams: (0..scanner.rows()).map(beam).collect(),
            azimuths: columns.iter().chain(columns).map(azimuth).collect(),
        }
    }

    /// Whether a cell holds a return.
    pub fn is_return(&self, cell: Cell) -> bool {
        self.ranges[cell] > 0.0
    }

    /// How far the line between two returns of a row or a column rises, and the square of its horizontal
    /// length, in metres (delta z and the square of delta x of equation 3).
    pub fn rise_and_run(&self, a: Cell, b: Cell) -> (f32, f32) {
        let ((rho_a, z_a), (rho_b, z_b)) = (self.place(a), self.place(b));
        let across = if a.0 == b.0 { self.turn(a, b) * rho_a.min(rho_b) } else { 0.0 };
        ((z_a - z_b).abs(), (rho_a - rho_b) * (rho_a - rho_b) + across * across)
    }

    /// Equation 4: whether the angle between the longer beam and the line to the end of the shorter one is
    /// larger than the angle with this tangent.
    pub fn is_one_surface(&self, a: Cell, b: Cell, tangent: f32) -> bool {
        let between = if a.0 == b.0 { self.turn(a, b) } else { self.tilt(a.0, b.0) };
        let (near, far) = (self.ranges[a].min(self.ranges[b]), self.ranges[a].max(self.ranges[b]));
        // For angles of a few degrees; accurate to a thousandth.
        let (sin, cos) = (between, 1.0 - 0.5 * between * between);
        near * sin > tangent * (far - near * cos)
    }

    /// Distance from the scanner's axis, and height, in metres.
    fn place(&self, cell: Cell) -> (f32, f32) {
        let (beam, range) = (&self.beams[cell.0], self.ranges[cell]);
        (range * beam.cos, range * beam.sin + beam.height)
    }

    /// The angle between two columns of a row, in radians.
    fn turn(&self, (row, a): Cell, (_, b): Cell) -> f32 {
        let turn = self.beams[row].turn;
        let apart = (self.azimuths[turn + a] - self.azimuths[turn + b]).abs();
        apart.min(TAU as f32 - apart)
    }

    /// The angle between two rows, in radians.
    fn tilt(&self, a: usize, b: usize) -> f32 {
        let (a, b) = (&self.beams[a], &self.beams[b]);
        (a.sin * b.cos - a.cos * b.sin).abs()
    }
}
