//! The article's registration: iterative closest point (equation 8, with equal weights), each return of the
//! current frame paired with the nearest point of the reference.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Vector3};

use super::pose::RigidMotion;
use super::surface::Surfel;
use super::{Step, small_step};

/// The points of the reference, indexed for nearest-neighbour search.
pub struct NearestPoints {
    points: Vec<[f64; 3]>,
    tree: ImmutableKdTree<f64, 3>,
}

impl NearestPoints {
    /// Indexes some surfels of the reference. `None` if there are none.
    pub fn of<'a>(surfels: impl Iterator<Item = &'a Surfel>) -> Option<Self> {
        let points: Vec<_> = surfels.map(|surfel| surfel.position).collect();
        if points.is_empty() {
            return None;
        }
        let tree = ImmutableKdTree::new_from_slice(&points).ok()?;
        Some(NearestPoints { points, tree })
    }

    /// One iteration: the motion, composed with `motion`, that brings the pairs closest together (Kabsch).
    /// `None` if there are too few pairs.
    pub fn step(&self, current: &[[f64; 3]], motion: &RigidMotion, reach: f64) -> Option<Step> {
        let back = motion.inverse();
        let mut pairs = Vec::new();
        let mut squares = 0.0;
        for &point in current {
            let query = back.apply(point);
            if query.iter().any(|v| !v.is_finite()) {
                continue;
            }
            let found = self.tree.query(&query).nearest_one::<SquaredEuclidean<f64>>().execute();
            if found.distance < reach * reach {
                squares += found.distance;
                let reference = self.points[found.item as usize];
                pairs.push((Vector3::from(motion.apply(reference)), Vector3::from(point)));
            }
        }
        if pairs.len() < 3 {
            return None;
        }
        let count = pairs.len() as f64;
        let (from, to) = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (from, to)| {
            (a + from / count, b + to / count)
        });
        let mut covariance = Matrix3::zeros();
        for (a, b) in &pairs {
            covariance += (b - to) * (a - from).transpose();
        }
        let svd = covariance.try_svd(true, true, 1e-12, 100)?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut flip = Matrix3::identity();
        flip[(2, 2)] = (u * v_t).determinant().signum();
        let rotation = u * flip * v_t;
        let translation = to - rotation * from;
        let step = RigidMotion {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
            translation: translation.into(),
        };
        small_step(step, pairs.len(), count - squares / (reach * reach))
    }
}
