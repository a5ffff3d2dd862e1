//! Errors of range images, cell by cell.

use crate::scanner::{RangeImage, Scanner};

/// Errors of the ranges of a decoded image relative to the original one: the RMSE of the article (VI-A,
/// equation 12),
///
/// ```text
/// RMSE = sqrt(1 / (m n) * sum over cells of (I(i, j) - K(i, j))^2),
/// ```
///
/// over the cells that hold a return in both images instead of all m x n, since cells without a return have
/// no range. Returns that only one of the images has are counted separately. Ranges are in metres, in f64.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RangeErrors {
    /// Returns in both images.
    pub compared: u64,
    /// Returns in the original image only.
    pub only_original: u64,
    /// Returns in the decoded image only.
    pub only_decoded: u64,
    /// Sum of the squared errors, in square metres.
    squared_sum: f64,
    /// Largest error, in metres.
    max: f64,
}

impl RangeErrors {
    /// Adds the images of one frame, each with the scanner that defines its steps. They have the same rows;
    /// columns correspond if their ticks are equal.
    pub fn add(&mut self, original: (&Scanner, &RangeImage), decoded: (&Scanner, &RangeImage)) {
        let (mut left, mut right) = (0, 0);
        let tick = |image: &RangeImage, column: usize| image.columns.get(column).copied();
        loop {
            match (tick(original.1, left), tick(decoded.1, right)) {
                (None, None) => break,
                (Some(a), Some(b)) if a == b => {
                    self.add_column(original, left, decoded, right);
                    (left, right) = (left + 1, right + 1);
                }
                (Some(a), b) if b.is_none_or(|b| a < b) => {
                    self.only_original += returns_of_column(original.1, left);
                    left += 1;
                }
                _ => {
                    self.only_decoded += returns_of_column(decoded.1, right);
                    right += 1;
                }
            }
        }
    }

    fn add_column(
        &mut self,
        (scanner, original): (&Scanner, &RangeImage),
        left: usize,
        (decoded_scanner, decoded): (&Scanner, &RangeImage),
        right: usize,
    ) {
        for row in 0..original.steps.rows().min(decoded.steps.rows()) {
            match (original.steps[(row, left)], decoded.steps[(row, right)]) {
                (0, 0) => {}
                (_, 0) => self.only_original += 1,
                (0, _) => self.only_decoded += 1,
                (before, after) => {
                    let error = (scanner.metres(before) - decoded_scanner.metres(after)).abs();
                    self.compared += 1;
                    self.squared_sum += error * error;
                    self.max = self.max.max(error);
                }
            }
        }
    }

    /// Root of the mean squared error, in metres; `None` if there is nothing to compare.
    pub fn rmse(&self) -> Option<f64> {
        (self.compared > 0).then(|| (self.squared_sum / self.compared as f64).sqrt())
    }

    /// Largest error, in metres; `None` if there is nothing to compare.
    #[cfg(any(test, feature = "internals"))]
    pub fn max(&self) -> Option<f64> {
        (self.compared > 0).then_some(self.max)
    }
}

fn returns_of_column(image: &RangeImage, column: usize) -> u64 {
    (0..image.steps.rows()).filter(|&row| image.steps[(row, column)] > 0).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::ideal;

    /// One row with these steps in these columns.
    fn image(cells: &[(u32, u32)]) -> RangeImage {
        let mut image = RangeImage::new(1, cells.iter().map(|(tick, _)| *tick).collect());
        cells.iter().enumerate().for_each(|(column, (_, steps))| image.steps[(0, column)] = *steps);
        image
    }

    #[test]
    fn errors_are_range_differences_of_returns_in_both_images() {
        let (millimetres, centimetres) = (Scanner::from(ideal(100, 1000)), Scanner::from(ideal(100, 10_000)));
        let original = image(&[(0, 1003), (1, 2000), (2, 0), (3, 4004), (4, 0)]);
        let decoded = image(&[(0, 100), (1, 0), (2, 7), (3, 400), (4, 0)]);
        let mut errors = RangeErrors::default();
        errors.add((&millimetres, &original), (&centimetres, &decoded));
        assert_eq!((errors.compared, errors.only_original, errors.only_decoded), (2, 1, 1));
        let expected = ((0.003f64.powi(2) + 0.004f64.powi(2)) / 2.0).sqrt();
        assert!((errors.rmse().unwrap() - expected).abs() < 1e-9);
        assert!((errors.max().unwrap() - 0.004).abs() < 1e-9);
    }

    #[test]
    fn columns_are_matched_by_their_ticks() {
        let scanner = Scanner::from(ideal(100, 1000));
        let mut errors = RangeErrors::default();
        errors.add(
            (&scanner, &image(&[(1, 10), (5, 20), (7, 30)])),
            (&scanner, &image(&[(0, 9), (5, 20), (9, 9)])),
        );
        assert_eq!((errors.compared, errors.only_original, errors.only_decoded), (1, 2, 2));
        assert_eq!(errors.rmse(), Some(0.0));
        assert_eq!(RangeErrors::default().rmse(), None);
    }
}
