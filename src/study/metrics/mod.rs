//! Measures of size and error, with their exact definitions.

mod nearest;
mod paired;
mod psnr;
mod ranges;

pub use nearest::{Nearest, NearestErrors, NearestPairs, NearestPoints, nearest_distances};
pub use paired::{PointErrors, paired_distances};
pub use psnr::{GeometryPsnr, PEAK_M};
pub use ranges::RangeErrors;

/// The article's compression ratio (equation 11): coded size / original size. Smaller is better; 0.08 means
/// that 8 % remains. `None` if there was nothing to encode.
pub fn ratio(original_bytes: u64, coded_bytes: u64) -> Option<f64> {
    (original_bytes > 0).then(|| coded_bytes as f64 / original_bytes as f64)
}

/// Coded bits for each point: 8 x bytes / points. `None` if there are no points.
pub fn bits_per_point(coded_bytes: u64, points: u64) -> Option<f64> {
    (points > 0).then(|| 8.0 * coded_bytes as f64 / points as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratio_and_bits_follow_their_definitions() {
        assert_eq!(ratio(1000, 80), Some(0.08));
        assert_eq!(ratio(0, 80), None);
        assert_eq!(bits_per_point(100, 50), Some(16.0));
        assert_eq!(bits_per_point(100, 0), None);
    }
}
