//! The shape of a prediction's error: a Gaussian core, from the sensor's noise, and a wide tail, from the
//! edges of objects. Found on real scans: ranges on smooth surfaces have Gaussian noise.

//! All in integers, for speed: places in the table have 16 binary digits after the point, and probabilities
//! are in 2^-30.

/// The table reaches this many standard deviations of the core to each side.
const REACH: f64 = 40.0;
const STEPS: i64 = 2048;
/// Share of the core, and how many times wider the tail is.
const CORE: f64 = 0.7;
const TAIL_WIDTH: f64 = 3.0;
/// Binary digits of a place after the point.
const PLACE_BITS: u32 = 16;
/// The probability 1.
pub const CERTAIN: u32 = 1 << 30;

/// The cumulative distribution of an error whose mean magnitude is 1.
#[derive(Clone)]
pub struct ErrorShape {
    /// The probability below the start of each step.
    below: Box<[u32; STEPS as usize + 2]>,
    /// Places per unit.
    places: f64,
}

/// An [`ErrorShape`] around a prediction: the line that maps a value to its place in the table.
#[derive(Clone, Copy, Debug, Default)]
pub struct Placed {
    origin: i64,
    slope: i64,
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
        let deviations = |i: i64| ((i as f64 + 0.5) / STEPS as f64 * 2.0 - 1.0) * REACH;
        let density = |i: i64| CORE * core(deviations(i)) + (1.0 - CORE) * tail(deviations(i));
        let sum: f64 = (0..STEPS).map(density).sum();
        let magnitude: f64 = (0..STEPS).map(|i| density(i) / sum * deviations(i).abs()).sum();
        let mut below = Box::new([CERTAIN; STEPS as usize + 2]);
        let mut so_far = 0.0;
        for (i, probability) in (0..STEPS).zip(below.iter_mut()) {
            *probability = (so_far / sum * f64::from(CERTAIN)) as u32;
            so_far += density(i);
        }
        let places = STEPS as f64 / (2.0 * REACH) * magnitude * f64::from(1u32 << PLACE_BITS);
        ErrorShape { below, places }
    }

    /// The shape around `prediction`, with `scale` as its mean magnitude.
    #[inline]
    pub fn place(&self, prediction: f64, scale: f64) -> Placed {
        let slope = (self.places / scale) as i64;
        let middle = STEPS << (PLACE_BITS - 1);
        Placed { origin: middle - (prediction * slope as f64) as i64, slope }
    }

    /// Probability that the value is below `value`.
    #[inline]
    pub fn below(&self, placed: &Placed, value: i64) -> u32 {
        let place = (placed.origin + value * placed.slope).clamp(0, STEPS << PLACE_BITS);
        let index = (place >> PLACE_BITS) as usize;
        let (a, b) = (self.below[index], self.below[index + 1]);
        let part = place as u64 & ((1 << PLACE_BITS) - 1);
        a + ((u64::from(b - a) * part) >> PLACE_BITS) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_is_symmetric_and_its_mean_magnitude_is_the_scale() {
        let shape = ErrorShape::new();
        let placed = shape.place(10_000.0, 200.0);
        let below = |value: i64| f64::from(shape.below(&placed, value)) / f64::from(CERTAIN);
        assert!((below(10_000) - 0.5).abs() < 1e-4);
        assert!((below(10_400) + below(9_600) - 1.0).abs() < 1e-4);
        assert_eq!((below(-1_000_000), below(1_000_000)), (0.0, 1.0));
        let slice = |i: i64| 2.0 * (below(10_001 + i) - below(10_000 + i)) * (i as f64 + 0.5);
        let magnitude: f64 = (0..10_000).map(slice).sum();
        assert!((magnitude - 200.0).abs() < 4.0, "{magnitude}");
    }
}
