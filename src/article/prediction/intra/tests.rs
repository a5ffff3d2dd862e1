use proptest::prelude::*;

use super::*;
use crate::article::prediction::Predictor;
use crate::article::segmentation::{SegmentationConfig, segment};
use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
use crate::scanner::hdl64::Hdl64;
use crate::scanner::{RangeImage, ideal};

const COLUMNS: u32 = 64;

/// Fits, codes, decodes and predicts with each kind of model; the decoded image must be the same.
fn comes_back(image: &RangeImage, scanner: &Hdl64, segmentation: &SegmentationConfig) {
    let occupancy = image.occupancy();
    let rays = Rays::of(scanner, &image.columns);
    let segmentation = segment(&image.steps, &image.columns, scanner, segmentation);
    for models in [RegionModels::Article, RegionModels::Fitted] {
        let config = IntraConfig { models, ..IntraConfig::default() };
        let mut fitted = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &config);
        let before = fitted.clone();
        let mut encoder = ArithmeticEncoder::default();
        fitted.code_contour(&mut ContourModel::default(), &mut encoder, &occupancy).unwrap();
        fitted.code_models(&mut SurfaceCoder::default(), &mut encoder);
        assert_eq!(fitted, before);
        let bytes = encoder.finish();
        let mut decoder = ArithmeticDecoder::new(&bytes);
        let mut decoded = IntraPrediction::default();
        decoded.code_contour(&mut ContourModel::default(), &mut decoder, &occupancy).unwrap();
        decoded.code_models(&mut SurfaceCoder::default(), &mut decoder);
        assert_eq!(decoded, fitted);
        for snake in [false, true] {
            let predictor = Predictor { ranges: Some(decoded.ranges(&occupancy, &rays)), snake };
            let residuals = predictor.residuals(&occupancy, &image.steps);
            assert_eq!(predictor.restore(&occupancy, &residuals), image.steps);
        }
    }
}

fn image(steps: impl Fn(usize, usize) -> u32) -> RangeImage {
    let mut image = RangeImage::new(64, (0..COLUMNS).collect());
    for row in 0..64 {
        for column in 0..COLUMNS as usize {
            image.steps[(row, column)] = steps(row, column);
        }
    }
    image
}

#[test]
fn odd_images_come_back() {
    let scanner = ideal(COLUMNS, 10_000);
    let config = SegmentationConfig::default();
    comes_back(&RangeImage::new(64, Vec::new()), &scanner, &config);
    comes_back(&image(|_, _| 0), &scanner, &config);
    comes_back(&image(|row, column| u32::from((row, column) == (9, 9)) * 500), &scanner, &config);
    comes_back(&image(|_, _| 1), &scanner, &config);
    comes_back(&image(|row, _| if row > 20 { 10_000 / (row as u32 - 10) } else { 0 }), &scanner, &config);
    let alone = SegmentationConfig { smallest_cluster: 1, ..config };
    comes_back(&image(|row, column| 1 + ((row * 7919 + column * 104_729) % 60_000) as u32), &scanner, &alone);
}

#[test]
fn flat_ground_leaves_next_to_nothing() {
    let scanner = ideal(COLUMNS, 10_000);
    let floor = |row: usize| if row < 20 { None } else { scanner.steps(1.7 / -scanner.elevation(row).sin()) };
    let image = image(|row, _| floor(row).unwrap_or(0));
    let (occupancy, rays) = (image.occupancy(), Rays::of(&scanner, &image.columns));
    let segmentation = segment(&image.steps, &image.columns, &scanner, &SegmentationConfig::default());
    let config = IntraConfig::default();
    let fitted = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &config);
    assert_eq!(fitted.models.len(), 1);
    let predictor = Predictor { ranges: Some(fitted.ranges(&occupancy, &rays)), snake: false };
    let residuals = predictor.residuals(&occupancy, &image.steps);
    assert!(residuals.iter().all(|residual| residual.abs() <= 1), "{residuals:?}");
}

#[test]
fn a_wall_with_a_step_is_split_where_it_pays() {
    let scanner = ideal(COLUMNS, 10_000);
    let image = image(|row, column| {
        if row > 40 {
            0
        } else if column < 20 {
            1000
        } else {
            1040
        }
    });
    let (occupancy, rays) = (image.occupancy(), Rays::of(&scanner, &image.columns));
    let mut labels = image.steps.clone();
    for row in 0..64 {
        labels.row_mut(row).iter_mut().for_each(|label| *label = u32::from(*label > 0) * FIRST_OBJECT);
    }
    let segmentation = Segmentation { labels, end: FIRST_OBJECT + 1 };
    let config = IntraConfig { models: RegionModels::Fitted, lambda: 20.0, ..IntraConfig::default() };
    let fitted = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &config);
    assert_eq!(fitted.models, [SurfaceModel::Mean(1000), SurfaceModel::Mean(1040)]);
    let dear = IntraConfig { lambda: 1e9, ..config };
    let fitted = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &dear);
    assert_eq!(fitted.models.len(), 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn any_image_comes_back(cells in prop::collection::vec(prop_oneof![Just(0u32), 1u32..20_000], 256)) {
        let scanner = ideal(COLUMNS, 10_000);
        let image = image(|row, column| cells[(row * 37 + column * 11) % 256]);
        comes_back(&image, &scanner, &SegmentationConfig { smallest_cluster: 3, ..Default::default() });
    }
}
