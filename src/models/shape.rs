//! The distribution of a prediction's error: a Gaussian core, from the scanner's noise, and a wide tail, from
//! the edges of objects. Observed on real scans: ranges on smooth surfaces have Gaussian noise.
//! FORMAT.md 8.6.

/// The table extends this many standard deviations of the core to each side.
const REACH: f64 = 40.0;
const STEPS: usize = 2048;
/// Weight of the core, and the width of the tail relative to it.
const CORE: f64 = 0.7;
const TAIL_WIDTH: f64 = 3.0;

/// The cumulative distribution of an error whose mean magnitude is 1.
#[derive(Clone)]
pub struct ErrorShape {
    /// The cumulative probability at the start of each step, and the probability of the step.
    below: Box<[[f32; 2]; STEPS]>,
    /// Steps per unit.
    fineness: f32,
}

/// An [`ErrorShape`] around each of `P` predictions: the linear functions that map a value to its position in
/// the table.
#[derive(Clone, Copy, Debug)]
pub struct Placed<const P: usize> {
    predictions: [f32; P],
    slopes: [f32; P],
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
        let deviations = |i: usize| ((i as f64 + 0.5) / STEPS as f64 * 2.0 - 1.0) * REACH;
        let density = |i: usize| CORE * core(deviations(i)) + (1.0 - CORE) * tail(deviations(i));
        let sum: f64 = (0..STEPS).map(density).sum();
        let magnitude: f64 = (0..STEPS).map(|i| density(i) / sum * deviations(i).abs()).sum();
        let mut so_far = 0.0;
        let below = std::array::from_fn(|i| {
            let below = so_far / sum;
            so_far += density(i);
            [below as f32, (density(i) / sum) as f32]
        });
        ErrorShape { below: Box::new(below), fineness: (STEPS as f64 / (2.0 * REACH) * magnitude) as f32 }
    }

    /// The shape around predictions, with `scales` as its mean magnitudes.
    #[inline]
    pub fn place<const P: usize>(&self, predictions: [f32; P], scales: &[f32; P]) -> Placed<P> {
        Placed { predictions, slopes: scales.map(|scale| self.fineness / scale) }
    }

    /// The cumulative probabilities at `value`.
    #[inline]
    pub fn below<const P: usize>(&self, placed: &Placed<P>, value: f32) -> [f32; P] {
        const MIDDLE: f32 = (STEPS / 2) as f32;
        const LAST: f32 = (STEPS - 1) as f32;
        // In a sum with 2^23 the lowest bit has the value 1, and subtracting one half makes rounding go down.
        const UNIT: f32 = (1 << 23) as f32;
        let mut steps = [0u32; P];
        let mut parts = [0.0; P];
        for k in 0..P {
            let place = ((value - placed.predictions[k]) * placed.slopes[k] + MIDDLE).clamp(1.0, LAST);
            let floor = place + (UNIT - 0.5);
            steps[k] = floor.to_bits();
            parts[k] = place - (floor - UNIT);
        }
        let mut below = [0.0; P];
        for k in 0..P {
            let [start, step] = self.below[steps[k] as usize % STEPS];
            below[k] = start + step * parts[k];
        }
        below
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_is_symmetric_and_its_mean_magnitude_is_the_scale() {
        let shape = ErrorShape::new();
        let placed = shape.place([10_000.0], &[200.0]);
        let below = |value: i32| shape.below(&placed, value as f32)[0];
        assert!((below(10_000) - 0.5).abs() < 1e-4);
        assert!((below(10_400) + below(9_600) - 1.0).abs() < 1e-4);
        assert!(below(-1_000_000) < 1e-5 && below(1_000_000) > 1.0 - 1e-5);
        let slice = |i: i32| 2.0 * (below(10_001 + i) - below(10_000 + i)) * (i as f32 + 0.5);
        let magnitude: f32 = (0..10_000).map(slice).sum();
        assert!((magnitude - 200.0).abs() < 4.0, "{magnitude}");
    }
}
