//! The article's codec: outliers, segmentation, region prediction, contour map, residuals, image coders.

pub mod contour;
pub mod image_coding;
pub mod outlier;
pub mod prediction;
pub mod residual;
pub mod segmentation;
