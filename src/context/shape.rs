//! The shape of a prediction's error: a Gaussian core, the sensor's noise, in a wide tail, the
//! edges of objects. Found on real scans: ranges on smooth surfaces scatter by a Gaussian.

/// The table reaches this many units of the core's deviation to each side.
const REACH: f64 = 40.0;
const STEPS: usize = 2048;
/// Share of the core, and how many times wider the tail is.
const CORE: f64 = 0.7;
const TAIL_WIDTH: f64 = 3.0;

/// The cumulative distribution of an error whose mean magnitude is 1.
pub struct ErrorShape {
    /// The probability below the start of each step, and what the step adds.
    steps: Box<[(f32, f32); STEPS + 1]>,
    steps_per_unit: f64,
}

/// An [`ErrorShape`] around a prediction, as the line from a value to its place in the table.
#[derive(Clone, Copy, Debug, Default)]
pub struct Placed {
    origin: f64,
    steps: f64,
}

impl ErrorShape {
    /// Computes the table.
    pub fn new() -> Self {
        let core = |z: f64| libm::exp(-z * z / 2.0) / libm::sqrt(std::f64::consts::TAU);
        // Student's t with two degrees of freedom has the density (2 + t^2)^-1.5.
        let tail = |z: f64| {
            let t = z / TAIL_WIDTH;
            1.0 / ((2.0 + t * t) * libm::sqrt(2.0 + t * t)) / TAIL_WIDTH
        };
        let place = |i: usize| ((i as f64 + 0.5) / STEPS as f64 * 2.0 - 1.0) * REACH;
        let density: Vec<f64> =
            (0..STEPS).map(place).map(|z| CORE * core(z) + (1.0 - CORE) * tail(z)).collect();
        let sum: f64 = density.iter().sum();
        let magnitude: f64 = density.iter().enumerate().map(|(i, d)| d * place(i).abs()).sum();
        let mut steps = Box::new([(1.0, 0.0); STEPS + 1]);
        let mut below = 0.0;
        for (step, d) in steps.iter_mut().zip(density) {
            *step = (below as f32, (d / sum) as f32);
            below += d / sum;
        }
        ErrorShape { steps, steps_per_unit: STEPS as f64 / (2.0 * REACH) * (magnitude / sum) }
    }

    /// The shape around `prediction`, with 1 / `per_scale` as its mean magnitude.
    #[inline]
    pub fn place(&self, prediction: f64, per_scale: f64) -> Placed {
        let steps = per_scale * self.steps_per_unit;
        Placed { origin: (STEPS / 2) as f64 - prediction * steps, steps }
    }

    /// Probability that the value is below `value`.
    #[inline]
    pub fn below(&self, placed: &Placed, value: f64) -> f64 {
        let place = (placed.origin + value * placed.steps).clamp(0.0, STEPS as f64);
        let index = place as i32;
        let (start, step) = self.steps[index as usize & (2 * STEPS - 1)];
        f64::from(start) + f64::from(step) * (place - f64::from(index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_is_symmetric_and_its_mean_magnitude_is_one() {
        let shape = ErrorShape::new();
        let below = |value: f64| shape.below(&shape.place(100.0, 0.5), value);
        assert!((below(100.0) - 0.5).abs() < 1e-6);
        assert!((below(104.0) + below(96.0) - 1.0).abs() < 1e-6);
        assert!(below(-1e9) < 1e-6 && below(1e9) > 1.0 - 1e-6);
        let slice =
            |i: i32| 2.0 * (below(100.0 + f64::from(i + 1) * 0.002) - below(100.0 + f64::from(i) * 0.002));
        let magnitude: f64 = (0..40_000).map(|i| slice(i) * (f64::from(i) + 0.5) * 0.002).sum();
        assert!((magnitude - 2.0).abs() < 0.05, "{magnitude}");
    }
}
