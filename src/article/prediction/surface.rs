//! Models of a region's surface (article, IV-C) as represented in the stream, the rays of a range image, and
//! the ranges that the models predict along these. FORMAT.md 8.12.

use crate::entropy::{AdaptiveBit, BitCoder, IntegerModel};
use crate::scanner::hdl64::Hdl64;

/// Plane parameters are in units of 2^-22 per metre: 3 mm of range at 100 m.
const PLANE_UNIT: f64 = 1.0 / (1 << 22) as f64;
/// The magnitude of plane parameters is below this, in units: planes at least 1 m away.
const PLANE_END: i32 = 1 << 22;
/// Metres: the scanner's reach (article, equation 1).
const FARTHEST: f64 = 120.0;

/// The surface of a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceModel {
    /// One range for all returns, in steps: an object.
    Mean(u32),
    /// The plane of all points p with `w . p = 1` (equation 6 divided by d), w in units of 2^-22 per metre:
    /// the ground.
    Plane([i32; 3]),
}

impl SurfaceModel {
    /// The plane with these parameters, per metre; the mean, in steps, if the plane is too near.
    pub fn plane(parameters: [f64; 3], mean: u32) -> Self {
        let units = parameters.map(|w| w / PLANE_UNIT);
        if units.iter().all(|w| w.abs() < f64::from(PLANE_END)) {
            SurfaceModel::Plane(units.map(|w| w.round() as i32))
        } else {
            SurfaceModel::Mean(mean)
        }
    }

    /// The range, in steps, at which the ray in `direction` (a unit vector) intersects the surface. The same
    /// on every machine: nothing but + - * / on f64.
    #[inline]
    pub fn range(&self, scanner: &Hdl64, direction: [f64; 3]) -> u32 {
        match *self {
            SurfaceModel::Mean(steps) => steps,
            SurfaceModel::Plane(w) => {
                let [x, y, z] = direction;
                let inverse = (f64::from(w[0]) * x + f64::from(w[1]) * y + f64::from(w[2]) * z) * PLANE_UNIT;
                // The range of a ray that does not intersect the plane is the scanner's reach.
                scanner.nearest_steps(if inverse * FARTHEST > 1.0 { 1.0 / inverse } else { FARTHEST })
            }
        }
    }
}

/// The adaptive models of the regions' surfaces.
#[derive(Clone, Default)]
pub struct SurfaceCoder {
    is_plane: [AdaptiveBit; 2],
    mean: IntegerModel,
    plane: [IntegerModel; 3],
    last_was_plane: bool,
    last_mean: u32,
    last_plane: [i32; 3],
}

impl SurfaceCoder {
    /// Codes a model by its difference from the last one of its kind.
    pub fn code<C: BitCoder>(&mut self, coder: &mut C, model: SurfaceModel) -> SurfaceModel {
        let is_plane = matches!(model, SurfaceModel::Plane(_));
        let is_plane = self.is_plane[usize::from(self.last_was_plane)].code(coder, is_plane);
        self.last_was_plane = is_plane;
        if !is_plane {
            let steps = if let SurfaceModel::Mean(steps) = model { steps } else { 0 };
            self.last_mean = code_near(coder, &mut self.mean, steps as i32, self.last_mean as i32) as u32;
            return SurfaceModel::Mean(self.last_mean);
        }
        let parameters = if let SurfaceModel::Plane(parameters) = model { parameters } else { [0; 3] };
        for ((model, last), value) in self.plane.iter_mut().zip(&mut self.last_plane).zip(parameters) {
            *last = code_near(coder, model, value, *last);
        }
        SurfaceModel::Plane(self.last_plane)
    }
}

/// Codes a value by its difference from another.
fn code_near<C: BitCoder>(coder: &mut C, model: &mut IntegerModel, value: i32, other: i32) -> i32 {
    let difference = model.code_signed(coder, i64::from(value) - i64::from(other));
    i64::from(other).wrapping_add(difference) as i32
}

/// The direction of each pixel of a range image.
pub struct Rays<'a> {
    scanner: &'a Hdl64,
    /// Column tick of each column.
    columns: &'a [u32],
}

impl<'a> Rays<'a> {
    /// The rays of an image with these columns.
    pub fn of(scanner: &'a Hdl64, columns: &'a [u32]) -> Self {
        Rays { scanner, columns }
    }

    /// The range that a model predicts for a pixel, in steps.
    #[inline]
    pub fn range(&self, model: &SurfaceModel, cell: (usize, usize)) -> u32 {
        model.range(self.scanner, self.direction(cell))
    }

    /// The end point of a range of `steps`, in metres, as if all beams started at one point.
    pub fn point(&self, cell: (usize, usize), steps: u32) -> [f64; 3] {
        let metres = self.scanner.metres(steps);
        self.direction(cell).map(|v| v * metres)
    }

    #[inline]
    fn direction(&self, (row, column): (usize, usize)) -> [f64; 3] {
        self.scanner.direction(row, self.scanner.tick_of_column(row, self.columns[column]))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
    use crate::scanner::ideal;

    #[test]
    fn a_plane_is_met_where_it_is() {
        let scanner = ideal(2000, 1000);
        // 2 m below.
        let floor = SurfaceModel::plane([0.0, 0.0, -0.5], 77);
        let down = scanner.direction(63, 0);
        assert!(floor.range(&scanner, down).abs_diff((2000.0 / -down[2]) as u32) <= 1);
        assert_eq!(floor.range(&scanner, scanner.direction(0, 0)), 120_000, "upwards");
        assert_eq!(SurfaceModel::plane([1.5, 0.0, 0.0], 77), SurfaceModel::Mean(77));
    }

    proptest! {
        #[test]
        fn any_models_come_back_and_predict(
            models in prop::collection::vec(prop_oneof![
                any::<u32>().prop_map(SurfaceModel::Mean),
                any::<[i32; 3]>().prop_map(SurfaceModel::Plane),
            ], 0..20)
        ) {
            let mut encoder = ArithmeticEncoder::default();
            let mut coder = SurfaceCoder::default();
            models.iter().for_each(|model| { coder.code(&mut encoder, *model); });
            let bytes = encoder.finish();
            let mut decoder = ArithmeticDecoder::new(&bytes);
            let mut coder = SurfaceCoder::default();
            let scanner = ideal(16, 1000);
            for model in models {
                let decoded = coder.code(&mut decoder, SurfaceModel::Mean(0));
                prop_assert_eq!(decoded, model);
                decoded.range(&scanner, scanner.direction(5, 7));
            }
        }
    }
}
