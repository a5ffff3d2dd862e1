//! The ground plane by random sample consensus (article, IV-C.2, Algorithm 1).

use nalgebra::{Matrix3, Vector3};

use crate::ground::random::Rng;

/// Parameters of the search for a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacConfig {
    /// t: the largest distance of supporting points from the plane, in metres. Default 0.15.
    pub tolerance_m: f64,
    /// The share of the points that the best plane is expected to contain (forseeable_support /
    /// length(point_list)). Default 0.5.
    pub foreseeable_support: f64,
    /// alpha: the probability that at least one of the tried planes goes through three points of that share.
    /// Default 0.99.
    pub confidence: f64,
    /// The largest number of points that are used; of more, an even sample is taken. Default 4000.
    pub most_points: usize,
    /// The seed of the random choices. Default 1.
    pub seed: u64,
}

impl Default for RansacConfig {
    fn default() -> Self {
        RansacConfig {
            tolerance_m: 0.15,
            foreseeable_support: 0.5,
            confidence: 0.99,
            most_points: 4000,
            seed: 1,
        }
    }
}

/// The largest number of planes that are tried, whatever the settings.
const MOST_TRIALS: f64 = 1000.0;

/// The best plane of the points (metres), as `w` with `w . p = 1` on it (equation 6 divided by d), refined by
/// least squares over its support. `None` if no three points define a plane that does not pass through the
/// origin.
pub fn fit_plane(points: &[[f64; 3]], config: &RansacConfig) -> Option<[f64; 3]> {
    let stride = points.len().div_ceil(config.most_points.max(3)).max(1);
    let points: Vec<Vector3<f64>> = points.iter().step_by(stride).map(|p| Vector3::from(*p)).collect();
    if points.len() < 3 {
        return None;
    }
    let mut random = Rng::keyed(config.seed, &[]);
    let mut best: Option<(Support, Vector3<f64>)> = None;
    for _ in 0..trials(config) {
        let chosen = [(); 3].map(|()| points[random.below(points.len())]);
        let Some(plane) = through(&chosen) else { continue };
        let support = Support::of(&plane, &points, config.tolerance_m);
        if best.as_ref().is_none_or(|(other, _)| support.is_better(other)) {
            best = Some((support, plane));
        }
    }
    let (_, plane) = best?;
    let supporters = points.iter().filter(|p| distance(&plane, p) <= config.tolerance_m);
    Some(least_squares_plane(supporters.map(|p| (*p).into())).unwrap_or(plane.into()))
}

/// N of Algorithm 1.
fn trials(config: &RansacConfig) -> usize {
    let support = config.foreseeable_support.clamp(0.01, 0.999);
    let all_three = support * support * support;
    let trials = libm::log(1.0 - config.confidence.clamp(0.0, 0.999_999)) / libm::log(1.0 - all_three);
    trials.round().clamp(1.0, MOST_TRIALS) as usize
}

/// The support of a plane by points.
struct Support {
    count: usize,
    deviation: f64,
}

impl Support {
    fn of(plane: &Vector3<f64>, points: &[Vector3<f64>], tolerance: f64) -> Self {
        let near = points.iter().map(|p| distance(plane, p)).filter(|distance| *distance <= tolerance);
        let (mut count, mut squares) = (0, 0.0);
        near.for_each(|distance| {
            count += 1;
            squares += distance * distance;
        });
        Support { count, deviation: (squares / count.max(1) as f64).sqrt() }
    }

    fn is_better(&self, other: &Support) -> bool {
        self.count > other.count || (self.count == other.count && self.deviation < other.deviation)
    }
}

fn distance(plane: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
    (plane.dot(point) - 1.0).abs() / plane.norm()
}

/// The plane through three points, if there is one and it does not pass through the origin.
fn through(points: &[Vector3<f64>; 3]) -> Option<Vector3<f64>> {
    let plane = Matrix3::from_rows(&points.map(|p| p.transpose())).lu().solve(&Vector3::repeat(1.0))?;
    (plane.norm() > 0.0 && plane.iter().all(|w| w.is_finite())).then_some(plane)
}

/// The plane with the least squared distances to points (metres), as `w` with `w . p = 1` on it. `None` if
/// the points are on a line.
pub fn least_squares_plane(points: impl Iterator<Item = [f64; 3]>) -> Option<[f64; 3]> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for point in points.map(Vector3::from) {
        normal += point * point.transpose();
        right += point;
    }
    let plane = normal.cholesky()?.solve(&right);
    plane.iter().all(|w| w.is_finite()).then(|| plane.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a tilted floor 1.7 m below, and as many clutter points.
    fn floor_and_clutter() -> Vec<[f64; 3]> {
        let mut random = Rng::keyed(7, &[]);
        let mut number = |scale: f64| (random.below(20_001) as f64 / 10_000.0 - 1.0) * scale;
        let mut points = Vec::new();
        for _ in 0..2000 {
            let (x, y) = (number(30.0), number(30.0));
            points.push([x, y, -1.7 + 0.02 * x - 0.01 * y + number(0.02)]);
            points.push([number(30.0), number(30.0), number(5.0)]);
        }
        points
    }

    #[test]
    fn the_floor_is_found_among_clutter() {
        let [a, b, c] = fit_plane(&floor_and_clutter(), &RansacConfig::default()).unwrap();
        // z = (1 - a x - b y) / c
        assert!((1.0 / c + 1.7).abs() < 0.01, "{c}");
        assert!((-a / c - 0.02).abs() < 0.001 && (-b / c + 0.01).abs() < 0.001);
    }

    #[test]
    fn it_is_repeatable() {
        let points = floor_and_clutter();
        let config = RansacConfig::default();
        assert_eq!(fit_plane(&points, &config), fit_plane(&points, &config));
    }

    #[test]
    fn odd_points_have_no_plane() {
        let config = RansacConfig::default();
        assert_eq!(fit_plane(&[], &config), None);
        assert_eq!(fit_plane(&[[1.0; 3]; 2], &config), None);
        assert_eq!(fit_plane(&[[0.0; 3]; 10], &config), None);
        assert_eq!(least_squares_plane([[1.0, 2.0, 3.0]; 5].into_iter()), None);
    }

    #[test]
    fn trials_follow_algorithm_1() {
        let config = RansacConfig { foreseeable_support: 0.5, confidence: 0.99, ..RansacConfig::default() };
        assert_eq!(trials(&config), 34);
    }
}
