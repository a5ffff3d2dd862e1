//! Selects the points with enough neighbours, by means of a tree.

use std::collections::HashMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::RadiusOutlier;
use crate::scan::PointCloud;

impl RadiusOutlier {
    /// The points that remain, in the same order.
    pub fn filter(&self, cloud: &PointCloud) -> PointCloud {
        let kept = (0..).zip(self.keeps(&cloud.positions)).filter(|(_, kept)| *kept);
        cloud.select(&kept.map(|(point, _)| point).collect::<Vec<u32>>())
    }

    /// For each point, whether at least n others are within the radius. Points with a NaN or infinite
    /// coordinate neither have neighbours nor count as such, and are always dropped.
    pub fn keeps(&self, positions: &[[f32; 3]]) -> Vec<bool> {
        let finite: Vec<[f32; 3]> = positions.iter().copied().filter(is_finite).collect();
        if self.neighbours >= finite.len() {
            return vec![false; positions.len()];
        }
        let voxels = Voxels::of(&finite, self.radius_m);
        let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(&finite) else {
            return vec![false; positions.len()];
        };
        // A search for neighbours also finds the point itself.
        let wanted = NonZero::<usize>::MIN.saturating_add(self.neighbours);
        let squared = (self.radius_m * self.radius_m) as f32;
        let has_neighbours = |point: &[f32; 3]| {
            let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(wanted).within(squared);
            voxels.points_with(point) >= wanted.get() || found.execute().len() >= wanted.get()
        };
        positions.iter().map(|point| is_finite(point) && has_neighbours(point)).collect()
    }
}

/// Number of points in cubes so small that all points in a cube are neighbours. Thus most points of a scan
/// need no search; and a search among thousands of equal points, such as the (0, 0, 0) of records without a
/// return in some files, would take very long.
struct Voxels {
    /// Length of an edge in metres.
    edge: f64,
    counts: HashMap<[i64; 3], usize>,
}

impl Voxels {
    fn of(points: &[[f32; 3]], radius_m: f64) -> Self {
        // The diagonal is shorter than the radius by a thousandth, which exceeds all rounding errors.
        let mut voxels = Voxels { edge: radius_m * (0.999 / 3.0f64.sqrt()), counts: HashMap::new() };
        for voxel in points.iter().filter_map(|point| voxels.voxel(point)).collect::<Vec<_>>() {
            *voxels.counts.entry(voxel).or_default() += 1;
        }
        voxels
    }

    /// Number of points in the cube of a point; 0 if the point is in none.
    fn points_with(&self, point: &[f32; 3]) -> usize {
        self.voxel(point).and_then(|voxel| self.counts.get(&voxel)).copied().unwrap_or(0)
    }

    /// `None` where numbers are too coarse to tell cubes apart.
    fn voxel(&self, point: &[f32; 3]) -> Option<[i64; 3]> {
        const MOST: f64 = (1u64 << 40) as f64;
        let places = point.map(|value| (f64::from(value) / self.edge).floor());
        places.iter().all(|place| place.abs() < MOST).then(|| places.map(|place| place as i64))
    }
}

fn is_finite(point: &[f32; 3]) -> bool {
    point.iter().all(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scan::{Channel, Field};

    /// The definition, implemented directly.
    fn slowly(filter: &RadiusOutlier, positions: &[[f32; 3]]) -> Vec<bool> {
        let squared = |a: &[f32; 3], b: &[f32; 3]| -> f32 { (0..3).map(|i| (a[i] - b[i]).powi(2)).sum() };
        let near = |a, b| squared(a, b) <= (filter.radius_m * filter.radius_m) as f32;
        let count = |a| positions.iter().filter(|b| near(a, b)).count();
        positions.iter().map(|a| is_finite(a) && count(a) > filter.neighbours).collect()
    }

    #[test]
    fn odd_clouds_are_filtered() {
        let filter = RadiusOutlier::default();
        assert_eq!(filter.keeps(&[]), [false; 0]);
        assert_eq!(filter.keeps(&[[1.0; 3]]), [false]);
        assert_eq!(filter.keeps(&[[1.0; 3]; 20_000]), [true; 20_000]);
        assert_eq!(
            filter.keeps(&[[f32::NAN, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0; 3]]),
            [false, true, true, true]
        );
        assert_eq!(filter.keeps(&[[f32::INFINITY; 3]; 5]), [false; 5]);
        assert_eq!(filter.keeps(&[[3e38; 3], [3e38; 3], [3e38; 3], [-3e38; 3]]), [true, true, true, false]);
    }

    #[test]
    fn odd_settings_are_followed() {
        let points = [[1.0; 3], [1.0; 3], [1.0, 1.0, 1.5], [f32::NAN; 3]];
        let keeps = |neighbours, radius_m| RadiusOutlier { neighbours, radius_m }.keeps(&points);
        assert_eq!(keeps(0, 0.1), [true, true, true, false]);
        assert_eq!(keeps(1, 0.0), [true, true, false, false]);
        assert_eq!(keeps(2, f64::INFINITY), [true, true, true, false]);
        assert_eq!(keeps(3, 10.0), [false; 4]);
        assert_eq!(keeps(usize::MAX, 10.0), [false; 4]);
        assert_eq!(RadiusOutlier { neighbours: 0, radius_m: 1.0 }.keeps(&[[f32::NAN; 3]]), [false]);
    }

    #[test]
    fn what_is_left_keeps_its_fields() {
        let cloud = PointCloud {
            positions: vec![[50.0, 0.0, 0.0], [0.0; 3], [0.1; 3], [0.2; 3]],
            intensity: vec![1.0, 2.0, 3.0, 4.0],
            channels: vec![Channel { field: Field::padding(2), bytes: vec![1, 1, 2, 2, 3, 3, 4, 4] }],
        };
        let left = RadiusOutlier::default().filter(&cloud);
        assert_eq!(left.positions, cloud.positions[1..]);
        assert_eq!(
            (left.intensity, &left.channels[0].bytes[..]),
            (vec![2.0, 3.0, 4.0], &[2, 2, 3, 3, 4, 4][..])
        );
    }

    proptest! {
        #[test]
        fn it_keeps_what_the_definition_says(
            points in prop::collection::vec(prop::array::uniform3(-20i8..20), 0..80),
            neighbours in 0usize..5,
        ) {
            let positions: Vec<_> = points.iter().map(|p| p.map(|v| f32::from(v) * 0.25)).collect();
            let filter = RadiusOutlier { neighbours, radius_m: 1.1 };
            prop_assert_eq!(filter.keeps(&positions), slowly(&filter, &positions));
        }
    }
}
