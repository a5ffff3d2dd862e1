//! Peak signal-to-noise ratio of geometry, as MPEG measures it.
//!
//! Source: mpeg-pcc-dmetric (D. Tian et al.; `pcc_distortion.cpp`), the tool of MPEG's common test
//! conditions for point cloud compression.

use std::num::NonZero;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::nearest::{Nearest, NearestPairs, NearestPoints};

/// The peak, in metres: 59.70, as in the literature on compressing KITTI's scans. The tool leaves the choice
/// to the user; a PSNR is meaningless without it.
pub const PEAK_M: f64 = 59.70;

/// The tool's factor for geometry, whose errors have three coordinates.
const FACTOR: f64 = 3.0;

/// Number of nearest points from which a normal is estimated, including the point itself: 16.
const NORMAL_POINTS: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(15);

/// D1 and D2 of frames, symmetric.
///
/// D1 is the mean of the squared distances from each point to the nearest one of the other cloud (point to
/// point). D2 uses only the component of each such distance along the normal of the other point (point to
/// plane). Of the two directions, original to decoded and back, the one with the larger mean counts. The
/// normals of the original cloud are those of planes through the nearest points, towards the scanner; a
/// decoded point has the mean normal of those original points to which it is nearest, or, if there are none,
/// the normal of the original point nearest to it. Points at the same position count once; those with a NaN
/// or infinite coordinate do not count. PSNR is computed from the mean of all frames' errors, so that frames
/// without any error do not make it infinite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GeometryPsnr {
    frames: u64,
    /// Sums over the frames of the mean squared errors, in square metres.
    d1: f64,
    d2: f64,
}

impl GeometryPsnr {
    /// Adds a frame.
    pub fn add(&mut self, pairs: &NearestPairs) {
        let NearestPairs { original, decoded, of_original, of_decoded } = pairs;
        let normals = normals(original);
        let decoded_normals = passed_on(&normals, of_original, of_decoded);
        let there = to_planes(original, decoded, of_original, &decoded_normals);
        let back = to_planes(decoded, original, of_decoded, &normals);
        self.frames += 1;
        self.d1 += mean(squares(of_original)).max(mean(squares(of_decoded)));
        self.d2 += mean(there.into_iter()).max(mean(back.into_iter()));
    }

    /// Adds a frame whose points have not changed.
    pub fn add_identical(&mut self) {
        self.frames += 1;
    }

    /// PSNR of point-to-point errors, in decibels; infinite if nothing has changed, `None` without frames.
    pub fn d1(&self) -> Option<f64> {
        self.psnr(self.d1)
    }

    /// PSNR of point-to-plane errors, in decibels; infinite if nothing has changed, `None` without frames.
    pub fn d2(&self) -> Option<f64> {
        self.psnr(self.d2)
    }

    fn psnr(&self, sum: f64) -> Option<f64> {
        let mean = sum / self.frames as f64;
        (self.frames > 0).then(|| 10.0 * (FACTOR * PEAK_M * PEAK_M / mean).log10())
    }
}

fn squares(nearest: &[Nearest]) -> impl ExactSizeIterator<Item = f64> {
    nearest.iter().map(|found| found.squared)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// The unit normal of each point, towards the scanner, which is at the origin.
fn normals(points: &NearestPoints) -> Vec<Vector3<f64>> {
    let normal = |point: &[f64; 3]| {
        let near = points.nearest_few(point, NORMAL_POINTS);
        let near = || near.iter().map(|&number| Vector3::from(points.points()[number]));
        let centre: Vector3<f64> = near().sum::<Vector3<f64>>() / near().len() as f64;
        let covariance: Matrix3<f64> = near().map(|p| (p - centre) * (p - centre).transpose()).sum();
        let eigen = covariance.symmetric_eigen();
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        if normal.dot(&Vector3::from(*point)) > 0.0 { -normal } else { normal }
    };
    points.points().par_iter().map(normal).collect()
}

/// The normals of the decoded points, from those of the original ones.
fn passed_on(normals: &[Vector3<f64>], of_original: &[Nearest], of_decoded: &[Nearest]) -> Vec<Vector3<f64>> {
    let mut sums = vec![(Vector3::zeros(), 0.0); of_decoded.len()];
    for (normal, found) in normals.iter().zip(of_original) {
        let (sum, count) = &mut sums[found.point];
        *sum += normal;
        *count += 1.0;
    }
    let mean = |((sum, count), found): ((Vector3<f64>, f64), &Nearest)| {
        if count > 0.0 { sum / count } else { normals[found.point] }
    };
    sums.into_iter().zip(of_decoded).map(mean).collect()
}

/// The squared distance of each point from the plane through the nearest of the others, in square metres.
fn to_planes(
    points: &NearestPoints,
    others: &NearestPoints,
    nearest: &[Nearest],
    normals: &[Vector3<f64>],
) -> Vec<f64> {
    let of_point = |(point, found): (&[f64; 3], &Nearest)| {
        let error = Vector3::from(*point) - Vector3::from(others.points()[found.point]);
        error.dot(&normals[found.point]).powi(2)
    };
    points.points().iter().zip(nearest).map(of_point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::PointCloud;

    /// A wall of 20 x 20 points 1 m apart, `away` metres in front of the scanner, shifted sideways by
    /// `aside`.
    fn wall(away: f32, aside: f32) -> PointCloud {
        let point = |i: usize| [away, (i / 20) as f32 - 10.0 + aside, (i % 20) as f32 - 10.0];
        PointCloud { positions: (0..400).map(point).collect(), ..PointCloud::default() }
    }

    fn psnr(original: &PointCloud, decoded: &PointCloud) -> (f64, f64) {
        let mut psnr = GeometryPsnr::default();
        psnr.add(&NearestPairs::of(original, decoded).unwrap());
        (psnr.d1().unwrap(), psnr.d2().unwrap())
    }

    /// 10 log10(3 peak^2 / error^2).
    fn of_distance(metres: f64) -> f64 {
        10.0 * (3.0 * 59.70 * 59.70 / (metres * metres)).log10()
    }

    #[test]
    fn a_wall_that_moves_away_has_both_errors() {
        let (d1, d2) = psnr(&wall(20.0, 0.0), &wall(20.25, 0.0));
        assert!((d1 - of_distance(0.25)).abs() < 1e-9 && (d2 - of_distance(0.25)).abs() < 1e-9, "{d1} {d2}");
        assert!((d1 - 52.332).abs() < 1e-3, "{d1}");
    }

    #[test]
    fn a_wall_that_moves_along_itself_stays_in_its_plane() {
        let (d1, d2) = psnr(&wall(20.0, 0.0), &wall(20.0, 0.25));
        assert!((d1 - of_distance(0.25)).abs() < 1e-9, "{d1}");
        assert!(d2 > 200.0, "{d2}");
    }

    #[test]
    fn the_worse_direction_counts() {
        let (whole, mut part) = (wall(20.0, 0.0), wall(20.0, 0.0));
        part.positions.truncate(380);
        // The last row of 20 is lost: its points are 1 m from the row before, in the same plane.
        let lost = of_distance((20.0f64 / 400.0).sqrt());
        for (original, decoded) in [(&whole, &part), (&part, &whole)] {
            let (d1, d2) = psnr(original, decoded);
            assert!((d1 - lost).abs() < 1e-9 && d2 > 200.0, "{d1} {d2}");
        }
    }

    #[test]
    fn frames_count_alike() {
        let mut psnr = GeometryPsnr::default();
        assert_eq!((psnr.d1(), psnr.d2()), (None, None));
        psnr.add_identical();
        assert_eq!((psnr.d1(), psnr.d2()), (Some(f64::INFINITY), Some(f64::INFINITY)));
        psnr.add(&NearestPairs::of(&wall(20.0, 0.0), &wall(20.5, 0.0)).unwrap());
        assert!((psnr.d1().unwrap() - of_distance((0.25f64 / 2.0).sqrt())).abs() < 1e-9);
    }

    #[test]
    fn few_points_have_errors_too() {
        for count in 1..4 {
            let mut few = wall(5.0, 0.0);
            few.positions.truncate(count);
            let (d1, d2) = psnr(&few, &wall(6.0, 0.0));
            assert!(d1.is_finite() && !d2.is_nan(), "{count}: {d1} {d2}");
            let same = psnr(&few, &few);
            assert_eq!(same, (f64::INFINITY, f64::INFINITY));
        }
    }
}
