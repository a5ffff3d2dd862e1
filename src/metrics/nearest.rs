//! Errors of points whose order or number has changed.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::scan::PointCloud;

/// How far points are from the nearest ones of another cloud: the point-to-point distance (D1) of
/// MPEG's common test conditions, in one direction. Distances are 3-D, in f64; points with a
/// coordinate that is NaN or infinite play no part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NearestErrors {
    /// Points that have a distance.
    measured: u64,
    /// Sum of the squared distances, in square metres.
    squared_sum: f64,
    /// Largest distance, in metres.
    max: f64,
}

impl NearestErrors {
    /// Adds the points of one frame: the distance of each of `points` to the nearest of `others`.
    /// Nothing is added if there are no others.
    pub fn add(&mut self, points: &PointCloud, others: &PointCloud) {
        let others = finite(others);
        if others.is_empty() {
            return;
        }
        let Ok(tree) = ImmutableKdTree::<f64, 3>::new_from_slice(&others) else { return };
        for point in finite(points) {
            let squared = tree.query(&point).nearest_one::<SquaredEuclidean<f64>>().execute().distance;
            self.measured += 1;
            self.squared_sum += squared;
            self.max = self.max.max(squared.sqrt());
        }
    }

    /// Root of the mean squared distance, in metres; `None` if there is no distance.
    pub fn rmse(&self) -> Option<f64> {
        (self.measured > 0).then(|| (self.squared_sum / self.measured as f64).sqrt())
    }

    /// Largest distance, in metres; `None` if there is none.
    pub fn max(&self) -> Option<f64> {
        (self.measured > 0).then_some(self.max)
    }
}

fn finite(cloud: &PointCloud) -> Vec<[f64; 3]> {
    let finite = cloud.positions.iter().filter(|point| point.iter().all(|v| v.is_finite()));
    finite.map(|point| point.map(f64::from)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(positions: &[[f32; 3]]) -> PointCloud {
        PointCloud { positions: positions.to_vec(), ..PointCloud::default() }
    }

    #[test]
    fn distances_go_to_the_nearest_in_any_order() {
        let points = cloud(&[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]]);
        let others = cloud(&[[10.0, 0.0, 1.0], [0.0, 3.0, 4.0], [100.0, 0.0, f32::INFINITY]]);
        let mut errors = NearestErrors::default();
        errors.add(&points, &others);
        assert_eq!(errors.max(), Some(5.0));
        assert_eq!(errors.rmse(), Some(13.0f64.sqrt()));
    }

    #[test]
    fn nothing_has_no_error() {
        let mut errors = NearestErrors::default();
        errors.add(&cloud(&[[1.0; 3]]), &cloud(&[]));
        errors.add(&cloud(&[]), &cloud(&[[1.0; 3]]));
        assert_eq!((errors.rmse(), errors.max()), (None, None));
    }

    #[test]
    fn many_points_at_one_place_are_found() {
        let mut errors = NearestErrors::default();
        errors.add(&cloud(&[[1.0, 2.0, 3.5]; 3]), &cloud(&[[1.0, 2.0, 3.0]; 1000]));
        assert_eq!(errors.max(), Some(0.5));
    }
}
