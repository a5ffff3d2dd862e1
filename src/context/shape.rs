//! The shape of a prediction's error: a Gaussian core, the sensor's noise, in a wide tail, the
//! edges of objects. Found on real scans: ranges on smooth surfaces scatter by a Gaussian.

/// The table reaches this many units of the core's deviation to each side.
const REACH: f64 = 40.0;
const STEPS: usize = 4096;
/// Share of the core, and how many times wider the tail is.
const CORE: f64 = 0.7;
const TAIL_WIDTH: f64 = 3.0;

/// The cumulative distribution of an error whose mean magnitude is 1.
pub struct ErrorShape {
    cumulative: Vec<f64>,
    steps_per_unit: f64,
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
        let mut sum = 0.0;
        let mut magnitude = 0.0;
        let mut cumulative = vec![0.0];
        for z in (0..STEPS).map(place) {
            let density = CORE * core(z) + (1.0 - CORE) * tail(z);
            sum += density;
            magnitude += density * z.abs();
            cumulative.push(sum);
        }
        cumulative.iter_mut().for_each(|c| *c /= sum);
        cumulative.push(1.0);
        ErrorShape { cumulative, steps_per_unit: STEPS as f64 / (2.0 * REACH) * (magnitude / sum) }
    }

    /// Probability that the error is below `error`, if `per_scale` is 1 / (its mean magnitude).
    #[inline]
    pub fn below(&self, error: f64, per_scale: f64) -> f64 {
        let place = error * per_scale * self.steps_per_unit + (STEPS / 2) as f64;
        let place = place.clamp(0.0, STEPS as f64);
        let index = place as usize;
        let (a, b) = (self.cumulative[index], self.cumulative[index + 1]);
        a + (b - a) * (place - index as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_is_symmetric_and_its_mean_magnitude_is_one() {
        let shape = ErrorShape::new();
        assert!((shape.below(0.0, 1.0) - 0.5).abs() < 1e-9);
        assert!((shape.below(2.0, 1.0) + shape.below(-2.0, 1.0) - 1.0).abs() < 1e-9);
        assert_eq!((shape.below(-1e9, 1.0), shape.below(1e9, 1.0)), (0.0, 1.0));
        let magnitude: f64 = (0..20_000)
            .map(|i| {
                let z = f64::from(i) * 0.001;
                2.0 * (shape.below(z + 0.001, 1.0) - shape.below(z, 1.0)) * (z + 0.0005)
            })
            .sum();
        assert!((magnitude - 1.0).abs() < 0.01, "{magnitude}");
    }
}
