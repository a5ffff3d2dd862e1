//! Errors of points whose order or number has changed.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use crate::scan::PointCloud;

/// The points of a cloud, indexed for nearest-neighbour search: each position once, without points that have
/// a NaN or infinite coordinate. There is at least one.
pub struct NearestPoints {
    /// Positions in metres, in ascending order of x, then y, then z.
    points: Vec<[f64; 3]>,
    /// Number of points of the cloud at each position.
    counts: Vec<u32>,
    tree: ImmutableKdTree<f64, 3>,
}

/// The point nearest to a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Its index in [`NearestPoints::points`].
    pub point: usize,
    /// Square of the distance, in square metres.
    pub squared: f64,
}

impl NearestPoints {
    /// Indexes a cloud; `None` if it has no finite point.
    pub fn of(cloud: &PointCloud) -> Option<Self> {
        let mut all: Vec<[f64; 3]> = cloud.positions.iter().filter_map(finite).collect();
        all.par_sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        // Files that store (0, 0, 0) for records without a return have thousands of points in one position,
        // among which a search would take very long.
        let (points, counts): (Vec<_>, Vec<_>) =
            all.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)).unzip();
        if points.is_empty() {
            return None;
        }
        let tree = ImmutableKdTree::new_from_slice(&points).ok()?;
        Some(NearestPoints { points, counts, tree })
    }

    /// The positions, in metres.
    pub fn points(&self) -> &[[f64; 3]] {
        &self.points
    }

    /// The position nearest to a point.
    pub fn nearest(&self, point: &[f64; 3]) -> Nearest {
        let found = self.tree.query(point).nearest_one::<SquaredEuclidean<f64>>().execute();
        Nearest { point: found.item as usize, squared: found.distance }
    }

    /// The position nearest to each of other points, computed on all processors.
    pub fn nearest_to_all(&self, others: &NearestPoints) -> Vec<Nearest> {
        others.points.par_iter().map(|point| self.nearest(point)).collect()
    }

    /// The indices of the positions nearest to a point: `count` of them, or all if there are fewer.
    pub fn nearest_few(&self, point: &[f64; 3], count: NonZero<usize>) -> Vec<usize> {
        let found = self.tree.query(point).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        found.iter().map(|neighbour| neighbour.item as usize).collect()
    }
}

/// A frame's original and decoded points, each with the nearest of the others: the basis of point-to-point
/// (D1) and point-to-plane (D2) measures.
pub struct NearestPairs {
    /// The original points.
    pub original: NearestPoints,
    /// The decoded points.
    pub decoded: NearestPoints,
    /// The decoded position nearest to each original one.
    pub of_original: Vec<Nearest>,
    /// The original position nearest to each decoded one.
    pub of_decoded: Vec<Nearest>,
}

impl NearestPairs {
    /// Finds the pairs; `None` if a cloud has no finite point.
    pub fn of(original: &PointCloud, decoded: &PointCloud) -> Option<Self> {
        let (original, decoded) = (NearestPoints::of(original)?, NearestPoints::of(decoded)?);
        let of_original = decoded.nearest_to_all(&original);
        let of_decoded = original.nearest_to_all(&decoded);
        Some(NearestPairs { original, decoded, of_original, of_decoded })
    }
}

/// Distances of points from the nearest ones of another cloud: the point-to-point distance (D1) of MPEG's
/// common test conditions, in one direction. Distances are 3-D, in f64; points with a NaN or infinite
/// coordinate are ignored.
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
    #[cfg(any(test, feature = "internals"))]
    pub fn add(&mut self, points: &PointCloud, others: &PointCloud) {
        if let (Some(points), Some(others)) = (NearestPoints::of(points), NearestPoints::of(others)) {
            self.add_nearest(&points, &others.nearest_to_all(&points));
        }
    }

    /// As [`add`](Self::add), for points whose nearest counterparts are known.
    pub fn add_nearest(&mut self, points: &NearestPoints, nearest: &[Nearest]) {
        for (count, found) in points.counts.iter().zip(nearest) {
            self.measured += u64::from(*count);
            self.squared_sum += f64::from(*count) * found.squared;
            self.max = self.max.max(found.squared.sqrt());
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

/// The distance, in metres, of each decoded point from the nearest original one; `None` if there is none, or
/// if a coordinate is NaN or infinite.
pub fn nearest_distances(original: &PointCloud, decoded: &PointCloud) -> Vec<Option<f64>> {
    let original = NearestPoints::of(original);
    let of_point = |point| Some(original.as_ref()?.nearest(&finite(point)?).squared.sqrt());
    decoded.positions.par_iter().map(of_point).collect()
}

/// A point in f64, if it is finite; zeros have no sign.
fn finite(point: &[f32; 3]) -> Option<[f64; 3]> {
    point.iter().all(|value| value.is_finite()).then(|| point.map(|value| f64::from(value) + 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(positions: &[[f32; 3]]) -> PointCloud {
        PointCloud { positions: positions.to_vec(), ..PointCloud::default() }
    }

    /// The errors from the first cloud to the second.
    fn errors(points: &[[f32; 3]], others: &[[f32; 3]]) -> NearestErrors {
        let mut errors = NearestErrors::default();
        errors.add(&cloud(points), &cloud(others));
        errors
    }

    #[test]
    fn distances_go_to_the_nearest_in_any_order() {
        let points = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
        let others = [[10.0, 0.0, 1.0], [0.0, 3.0, 4.0], [100.0, 0.0, f32::INFINITY]];
        let errors = errors(&points, &others);
        assert_eq!(errors.max(), Some(5.0));
        assert_eq!(errors.rmse(), Some(13.0f64.sqrt()));
    }

    #[test]
    fn each_point_has_a_distance_if_it_is_finite() {
        let original = cloud(&[[9.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [0.0; 3]]);
        let decoded = cloud(&[[0.0, 3.0, 4.0], [f32::INFINITY; 3], [8.5, 0.0, 0.0]]);
        assert_eq!(nearest_distances(&original, &decoded), [Some(5.0), None, Some(0.5)]);
        assert_eq!(nearest_distances(&cloud(&[]), &decoded), [None; 3]);
    }

    #[test]
    fn nothing_has_no_error() {
        for (points, others) in
            [(&[[1.0; 3]][..], &[][..]), (&[], &[[1.0; 3]]), (&[[f32::NAN; 3]], &[[1.0; 3]])]
        {
            let errors = errors(points, others);
            assert_eq!((errors.rmse(), errors.max()), (None, None));
        }
    }

    #[test]
    fn many_points_at_one_place_are_found_and_counted() {
        let many = errors(&[[1.0, 2.0, 3.5]; 3], &[[1.0, 2.0, 3.0]; 1000]);
        assert_eq!(many.max(), Some(0.5));
        let weighted = errors(&[[0.0, 0.0, 3.0], [0.0; 3], [-0.0; 3], [0.0; 3]], &[[0.0; 3]]);
        assert_eq!(weighted.rmse(), Some(1.5));
    }

    #[test]
    fn the_few_nearest_are_as_many_as_there_are() {
        let points = NearestPoints::of(&cloud(&[[0.0; 3], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]])).unwrap();
        let few = |count| {
            let mut few = points.nearest_few(&[0.9, 0.0, 0.0], NonZero::new(count).unwrap());
            few.sort_unstable();
            few
        };
        assert_eq!((few(2), few(9)), (vec![0, 1], vec![0, 1, 2]));
    }
}
