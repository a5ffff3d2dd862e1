//! Errors of points paired by their order.

use crate::scan::{PointCloud, squared_distance};

/// Errors of decoded points relative to the original ones.
///
/// Points are paired by their order in the file: the first decoded with the first original, and so on. The
/// error of a pair is the 3-D distance between its positions, computed in f64. A pair in which a coordinate
/// is NaN or infinite has no distance: it is [`PointErrors::non_finite_changed`] if any bit of its positions
/// differs; otherwise it counts as an error of 0. Intensities are compared separately.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PointErrors {
    /// Pairs compared.
    pub paired: u64,
    /// Original points that have no decoded one.
    pub lost: u64,
    /// Decoded points that have no original one.
    pub added: u64,
    /// Pairs with a NaN or infinite coordinate that are not equal bit for bit.
    pub non_finite_changed: u64,
    /// Pairs that have a distance, or are equal bit for bit.
    measured: u64,
    /// Sum of the squared errors, in square metres.
    squared_sum: f64,
    /// Largest error, in metres.
    max: f64,
    /// Largest difference between two intensities that are not NaN, in the file's unit.
    pub max_intensity: f64,
}

impl PointErrors {
    /// Adds the points of one frame.
    pub fn add(&mut self, original: &PointCloud, decoded: &PointCloud) {
        let (before, after) = (original.positions.len() as u64, decoded.positions.len() as u64);
        self.paired += before.min(after);
        self.lost += before.saturating_sub(after);
        self.added += after.saturating_sub(before);
        for (a, b) in original.positions.iter().zip(&decoded.positions) {
            self.add_pair(a, b);
        }
        for (a, b) in original.intensity.iter().zip(&decoded.intensity) {
            // `max` ignores NaN.
            self.max_intensity = self.max_intensity.max((f64::from(*a) - f64::from(*b)).abs());
        }
    }

    fn add_pair(&mut self, a: &[f32; 3], b: &[f32; 3]) {
        if let Some(squared) = finite_squared_distance(a, b) {
            self.measured += 1;
            self.squared_sum += squared;
            self.max = self.max.max(squared.sqrt());
        } else if a.map(f32::to_bits) == b.map(f32::to_bits) {
            self.measured += 1;
        } else {
            self.non_finite_changed += 1;
        }
    }

    /// Root of the mean squared error, in metres; `None` if no pair could be measured.
    pub fn rmse(&self) -> Option<f64> {
        (self.measured > 0).then(|| (self.squared_sum / self.measured as f64).sqrt())
    }

    /// Largest error, in metres; `None` if no pair could be measured.
    pub fn max(&self) -> Option<f64> {
        (self.measured > 0).then_some(self.max)
    }
}

/// The square of the 3-D distance, in square metres; `None` if a coordinate is NaN or infinite.
fn finite_squared_distance(a: &[f32; 3], b: &[f32; 3]) -> Option<f64> {
    let finite = a.iter().chain(b).all(|value| value.is_finite());
    finite.then(|| squared_distance(a, b))
}

/// The distance, in metres, of each decoded point from the original point with the same index; `None` if
/// there is none, or if a coordinate is NaN or infinite.
pub fn paired_distances(original: &PointCloud, decoded: &PointCloud) -> Vec<Option<f64>> {
    let of_point = |(place, point): (usize, &[f32; 3])| {
        finite_squared_distance(original.positions.get(place)?, point).map(f64::sqrt)
    };
    decoded.positions.iter().enumerate().map(of_point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(positions: &[[f32; 3]]) -> PointCloud {
        PointCloud { positions: positions.to_vec(), ..PointCloud::default() }
    }

    #[test]
    fn errors_are_distances_in_metres() {
        let mut errors = PointErrors::default();
        errors.add(&cloud(&[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), &cloud(&[[3.0, 4.0, 0.0], [1.0, 1.0, 1.0]]));
        assert_eq!(errors.max(), Some(5.0));
        assert_eq!(errors.rmse(), Some(12.5f64.sqrt()));
        errors.add(&cloud(&[[0.0, 0.0, 12.0]; 2]), &cloud(&[[0.0, 0.0, 5.0], [0.0, 0.0, 12.0]]));
        assert_eq!(errors.max(), Some(7.0));
        assert_eq!(errors.rmse(), Some((74.0f64 / 4.0).sqrt()));
        assert_eq!((errors.paired, errors.lost, errors.added), (4, 0, 0));
    }

    #[test]
    fn each_point_has_a_distance_if_it_has_a_partner() {
        let original = cloud(&[[0.0; 3], [f32::NAN, 0.0, 0.0], [1.0; 3]]);
        let decoded = cloud(&[[0.0, 3.0, 4.0], [0.0; 3], [1.0; 3], [2.0; 3]]);
        assert_eq!(paired_distances(&original, &decoded), [Some(5.0), None, Some(0.0), None]);
    }

    #[test]
    fn intensities_are_compared_where_they_are_numbers() {
        let with = |intensity: &[f32]| PointCloud { intensity: intensity.to_vec(), ..PointCloud::default() };
        let mut errors = PointErrors::default();
        errors.add(&with(&[0.5, f32::NAN, 3.0]), &with(&[0.25, f32::NAN, 3.0]));
        assert_eq!(errors.max_intensity, 0.25);
    }

    #[test]
    fn missing_points_are_counted() {
        let mut errors = PointErrors::default();
        errors.add(&cloud(&[[0.0; 3]; 5]), &cloud(&[[0.0; 3]; 2]));
        errors.add(&cloud(&[[0.0; 3]; 1]), &cloud(&[[0.0; 3]; 2]));
        assert_eq!((errors.paired, errors.lost, errors.added), (3, 3, 1));
    }

    #[test]
    fn what_is_not_finite_is_compared_bit_by_bit() {
        let other_nan = f32::from_bits(f32::NAN.to_bits() ^ 1);
        let original = cloud(&[[f32::NAN, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0]]);
        let decoded = cloud(&[[f32::NAN, 0.0, 0.0], [other_nan, 0.0, 0.0], [1.0, 0.0, 0.0]]);
        let mut errors = PointErrors::default();
        errors.add(&original, &decoded);
        assert_eq!(errors.non_finite_changed, 2);
        assert_eq!((errors.rmse(), errors.max()), (Some(0.0), Some(0.0)));
        assert_eq!(PointErrors::default().rmse(), None);
    }
}
