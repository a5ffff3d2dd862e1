//! Scans in the frame of a vehicle: how a program moved the points of a scanner that is mounted on one.
//! FORMAT.md 3.3.
//!
//! With a rotation R and a translation T, which are the same for all scans, a point p of the scanner's recipe
//! becomes
//!
//! ```text
//! v = R p + T
//! ```
//! The [`TransformOrder`] of the operations and their precision are those of the program. `pose` finds where
//! the scanner is and how it is turned from points alone; `direction` the direction of its azimuth 0, and the
//! recipe; `sums` the offsets of lasers that a recipe adds in single precision; `numbers` the numbers of R and T to
//! the last bit; and `fit` all of a scanner, with these.

mod direction;
mod fit;
mod numbers;
mod pose;
mod sums;

pub use fit::fit;

use super::arithmetic::{TURNED_ERROR, sure};
use super::projection::Sight;
use super::{Build, Firings};
use crate::scanner::REACH;

/// The order and precision in which a program computes `R p + T`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TransformOrder {
    /// Double precision, rounded once.
    Double = 1,
    /// Double precision, rounded after the rotation and again after the translation: the devkit of nuScenes.
    DoubleRoundedTwice = 2,
    /// Single precision, the translation first: `x a + (y b + (z c + t))`: PCL.
    SingleShiftFirst = 3,
    /// Single precision, the translation last: `((x a + y b) + z c) + t`.
    SingleShiftLast = 4,
    /// Single precision with fused products and sums: `fma(z, c, fma(y, b, x a)) + t`: NumPy.
    SingleFused = 5,
    /// Double precision, rounded once, as the points were not rounded before: programs that keep points in
    /// double precision until they write them.
    DoubleUnrounded = 6,
    /// Single precision, a row of R times the point first: `(x a + (y b + z c)) + t`: Eigen, for matrices of a
    /// size that is known when a program is compiled.
    SingleHalved = 7,
}

impl TransformOrder {
    /// Every order.
    pub const ALL: [TransformOrder; 7] = [
        TransformOrder::Double,
        TransformOrder::DoubleRoundedTwice,
        TransformOrder::SingleShiftFirst,
        TransformOrder::SingleShiftLast,
        TransformOrder::SingleFused,
        TransformOrder::DoubleUnrounded,
        TransformOrder::SingleHalved,
    ];

    /// The order of this number in the stream.
    pub fn from_number(number: u64) -> Option<Self> {
        Self::ALL.into_iter().find(|order| *order as u64 == number)
    }

    /// Whether the numbers of R and T are float32.
    pub fn is_single(self) -> bool {
        !matches!(
            self,
            TransformOrder::Double | TransformOrder::DoubleRoundedTwice | TransformOrder::DoubleUnrounded
        )
    }

    /// Whether points were rounded to float32 before they were moved.
    #[inline(always)]
    pub fn rounds_first(self) -> bool {
        self != TransformOrder::DoubleUnrounded
    }

    /// A point of the recipe as it is moved.
    #[inline(always)]
    pub fn rounded_first(self, point: [f64; 3]) -> [f64; 3] {
        let rounded = |metres: f64| if self.rounds_first() { f64::from(metres as f32) } else { metres };
        [rounded(point[0]), rounded(point[1]), rounded(point[2])]
    }

    /// The numbers of a row as they are stored.
    fn in_its_precision(self, row: [f64; 4]) -> [f64; 4] {
        if self.is_single() { row.map(|number| f64::from(number as f32)) } else { row }
    }

    /// A coordinate, from its row of R with its number of T, in the precision in which it is computed.
    #[inline(always)]
    fn coordinate(self, row: &[f64; 4], point: &[f64; 3]) -> f64 {
        let turned = || {
            let [a, b, c, _] = *row;
            let [x, y, z] = self.rounded_first(*point);
            a * x + b * y + c * z
        };
        // `map` is not always inlined.
        let (x, y, z) = (point[0] as f32, point[1] as f32, point[2] as f32);
        let (a, b, c, t) = (row[0] as f32, row[1] as f32, row[2] as f32, row[3] as f32);
        match self {
            TransformOrder::Double | TransformOrder::DoubleUnrounded => turned() + row[3],
            TransformOrder::DoubleRoundedTwice => f64::from(turned() as f32) + row[3],
            TransformOrder::SingleShiftFirst => (x * a + (y * b + (z * c + t))).into(),
            TransformOrder::SingleShiftLast => (((x * a + y * b) + z * c) + t).into(),
            TransformOrder::SingleHalved => ((x * a + (y * b + z * c)) + t).into(),
            TransformOrder::SingleFused => (libm::fmaf(z, c, libm::fmaf(y, b, x * a)) + t).into(),
        }
    }
}

/// How the points of a scanner were moved to the frame of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// How this was computed.
    pub order: TransformOrder,
    /// For each coordinate, its row of R and its number of T, in metres.
    pub rows: [[f64; 4]; 3],
}

impl Mounting {
    /// The position to which a point of the recipe is moved, in the precision in which it is computed.
    #[inline]
    pub fn moved(&self, point: &[f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.order.coordinate(&self.rows[axis], point))
    }

    /// [`moved`](Self::moved), rounded to float32, given nearly a point of the recipe that is not rounded,
    /// and the largest error of its x and y. `None` in the rare cases in which the error might show.
    #[inline]
    pub(super) fn surely_moved(&self, point: &[f64; 3], error: f64) -> Option<[f32; 3]> {
        let coordinate = |row: &[f64; 4]| {
            let [a, b, c, t] = row.map(f64::abs);
            let error = (a + b) * error + TURNED_ERROR * (c * point[2].abs() + t);
            sure(self.order.coordinate(row, point), error)
        };
        let [x, y, z] = &self.rows;
        Some([coordinate(x)?, coordinate(y)?, coordinate(z)?])
    }

    /// The position from which a point is moved to this one: R^T (v - T).
    #[inline(always)]
    pub fn undone(&self, position: [f64; 3]) -> [f64; 3] {
        let [u, v, w] = [0, 1, 2].map(|axis| position[axis] - self.rows[axis][3]);
        let [a, b, c] = &self.rows;
        [0, 1, 2].map(|axis| u * a[axis] + v * b[axis] + w * c[axis])
    }

    /// This mounting for a scanner that is turned by so many radians more, counterclockwise around its axis.
    fn turned(&self, radians: f64) -> Self {
        let (sin, cos) = libm::sincos(radians);
        let rows = self.rows.map(|[a, b, c, t]| [a * cos + b * sin, b * cos - a * sin, c, t]);
        Mounting { rows, ..*self }
    }
}

impl Firings {
    /// This scanner with a mounting.
    fn mounted(self, mounting: Mounting) -> Self {
        Firings { build: Build { mounting: Some(Box::new(mounting)), ..self.build }, ..self }
    }

    /// This scanner in a frame of its own.
    fn unmounted(&self) -> Self {
        Firings { build: Build { mounting: None, ..self.build.clone() }, ..self.clone() }
    }

    /// A position of the file, in metres, in the frame of the scanner.
    #[inline(always)]
    pub(super) fn in_frame(&self, position: [f64; 3]) -> [f64; 3] {
        self.build.mounting.as_ref().map_or(position, |mounting| mounting.undone(position))
    }

    /// The position in the file of a record without a return, of which the recipe makes zeros.
    pub(super) fn of_nothing(&self) -> [f32; 3] {
        let mounting = self.build.mounting.as_deref();
        mounting.map_or([0.0; 3], |mounting| mounting.moved(&[0.0; 3]).map(|metres| metres as f32))
    }

    /// The points of a file in the frame of the scanner: those of the recipe, or if it gives no near one, the
    /// file's moved back.
    fn measured(&self, positions: &[[f32; 3]]) -> Vec<[f64; 3]> {
        let Some(mounting) = &self.build.mounting else {
            return positions.iter().map(|position| position.map(f64::from)).collect();
        };
        let reach = REACH + 0.5 * self.range_step_m();
        let bare = self.unmounted();
        let (sight, nothing) = (Sight::new(&bare), self.of_nothing());
        let measured = |position: &[f32; 3]| {
            if *position == nothing || *position == [0.0; 3] {
                return [0.0; 3];
            }
            let there = mounting.undone(position.map(f64::from));
            let formula = sight.nearest(there).map(|(found, _)| self.measured_position(&found));
            let near =
                formula.filter(|formula| (0..3).all(|axis| (formula[axis] - there[axis]).abs() < reach));
            near.unwrap_or_else(|| mounting.order.rounded_first(there))
        };
        positions.iter().map(measured).collect()
    }
}
