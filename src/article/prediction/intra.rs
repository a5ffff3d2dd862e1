//! Intra prediction (article, IV-C): each return is predicted from the model of its region.
//! FORMAT.md 8.11 and 8.12.

use super::each_return;
use super::partition::{Judge, Region};
use super::ransac::{RansacConfig, fit_plane};
use super::surface::{Rays, SurfaceCoder, SurfaceModel};
use crate::article::contour::{ContourModel, renumber};
use crate::article::segmentation::{FIRST_OBJECT, GROUND, Segmentation, UNASSIGNED};
use crate::entropy::BitCoder;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// The regions and their models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RegionModels {
    /// As in the article: the mean of each object, and one plane for the ground.
    #[default]
    Article,
    /// A mean or a plane for each region; regions are split and merged wherever this decreases SSE + lambda *
    /// bits.
    Fitted,
}

/// How regions are fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntraConfig {
    /// The regions and their models. Default: the article's.
    pub models: RegionModels,
    /// lambda of equation 5, in squared steps per bit. Default 1000.
    pub lambda: f64,
    /// How the ground plane is estimated.
    pub ransac: RansacConfig,
}

impl Default for IntraConfig {
    fn default() -> Self {
        IntraConfig { models: RegionModels::Article, lambda: 1000.0, ransac: RansacConfig::default() }
    }
}

impl IntraConfig {
    /// Checks that all settings are in range.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] names the setting that is not.
    pub fn check(&self) -> Result<()> {
        let RansacConfig { tolerance_m, foreseeable_support, confidence, .. } = self.ransac;
        let share = 0.0..=1.0;
        let settings = [
            ("lambda is not negative", self.lambda >= 0.0 && self.lambda.is_finite()),
            ("the plane's tolerance is a length", tolerance_m >= 0.0 && tolerance_m.is_finite()),
            ("the plane's foreseeable support is from 0 to 1", share.contains(&foreseeable_support)),
            ("the plane's confidence is from 0 to 1", share.contains(&confidence)),
        ];
        match settings.iter().find(|(_, holds)| !holds) {
            Some((what, _)) => Err(Error::InvalidSettings((*what).to_owned())),
            None => Ok(()),
        }
    }
}

/// The regions of a frame and their models, as represented in the stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IntraPrediction {
    /// Rows x columns: the region of each return, numbered from 1 in order of appearance; 0 = no return.
    pub labels: Grid<u32>,
    /// The model of each region, in the order of their numbers.
    pub models: Vec<SurfaceModel>,
}

impl IntraPrediction {
    /// Models the regions of a segmented image; for the encoder. `steps` is rows x columns.
    pub fn fit(
        steps: &Grid<u32>,
        occupancy: &Grid<bool>,
        rays: &Rays,
        segmentation: &Segmentation,
        config: &IntraConfig,
    ) -> Self {
        let judge = Judge { steps, rays, lambda: config.lambda };
        let mut regions = Vec::new();
        for (label, cells) in (0..).zip(cells_of(occupancy, segmentation)) {
            let region = match (label, config.models) {
                _ if cells.is_empty() => continue,
                (GROUND, _) => with_ground_plane(&judge, cells, &config.ransac),
                (_, RegionModels::Article) => judge.with_mean(cells),
                (_, RegionModels::Fitted) => judge.with_best(cells),
            };
            match config.models {
                RegionModels::Article => regions.push(region),
                RegionModels::Fitted => judge.split(region, &mut regions),
            }
        }
        if config.models == RegionModels::Fitted {
            regions = judge.merge(regions);
        }
        IntraPrediction::of(occupancy, &regions)
    }

    fn of(occupancy: &Grid<bool>, regions: &[Region]) -> Self {
        let mut labels: Grid<u32> = Grid::new(occupancy.rows(), occupancy.columns());
        for (label, region) in (1..).zip(regions) {
            region.cells.iter().for_each(|&(row, column)| labels[(row as usize, column as usize)] = label);
        }
        let order = renumber(occupancy, &mut labels);
        IntraPrediction {
            labels,
            models: order.iter().map(|&label| regions[label as usize - 1].model).collect(),
        }
    }

    /// Codes the contour map (article, IV-D.1).
    ///
    /// # Errors
    /// If the stream refers to a region that does not exist.
    pub fn code_contour<C: BitCoder>(
        &mut self,
        model: &mut ContourModel,
        coder: &mut C,
        occupancy: &Grid<bool>,
    ) -> Result<()> {
        if !C::ENCODES {
            self.labels = Grid::new(occupancy.rows(), occupancy.columns());
        }
        let regions = model.code(coder, occupancy, &mut self.labels)?;
        self.models.resize(regions as usize, SurfaceModel::Mean(0));
        Ok(())
    }

    /// Codes the model of each region.
    pub fn code_models<C: BitCoder>(&mut self, model: &mut SurfaceCoder, coder: &mut C) {
        self.models.iter_mut().for_each(|surface| *surface = model.code(coder, *surface));
    }

    /// The predicted range of each return, in steps; 0 elsewhere.
    pub fn ranges(&self, occupancy: &Grid<bool>, rays: &Rays) -> Grid<u32> {
        let mut ranges = Grid::new(occupancy.rows(), occupancy.columns());
        each_return(occupancy, |cell| {
            let model = &self.models[self.labels[cell] as usize - 1];
            ranges[cell] = rays.range(model, cell);
        });
        ranges
    }
}

/// The ground with the plane found by RANSAC (Algorithm 1), or with its mean if there is none.
fn with_ground_plane(judge: &Judge, cells: Vec<(u32, u32)>, config: &RansacConfig) -> Region {
    let point = |&(row, column): &(u32, u32)| {
        let cell = (row as usize, column as usize);
        judge.rays.point(cell, judge.steps[cell])
    };
    let points: Vec<_> = cells.iter().map(point).collect();
    let by_mean = judge.with_mean(cells);
    let SurfaceModel::Mean(mean) = by_mean.model else { return by_mean };
    match fit_plane(&points, config) {
        Some(plane) => judge.region(by_mean.cells, SurfaceModel::plane(plane, mean)),
        None => by_mean,
    }
}

/// The cells of each label. Returns that belong to no object join the region to their left, or above: a
/// border around each would cost more than any model of them saves.
fn cells_of(occupancy: &Grid<bool>, segmentation: &Segmentation) -> Vec<Vec<(u32, u32)>> {
    let mut cells = vec![Vec::new(); segmentation.end.max(FIRST_OBJECT) as usize];
    let mut above = vec![UNASSIGNED; occupancy.columns()];
    let mut left = UNASSIGNED;
    let mut last_row = 0;
    each_return(occupancy, |cell| {
        if cell.0 != last_row {
            (last_row, left) = (cell.0, UNASSIGNED);
        }
        let mut label = segmentation.labels[cell];
        if label == UNASSIGNED {
            label = if left == UNASSIGNED { above[cell.1] } else { left };
        }
        (left, above[cell.1]) = (label, label);
        cells[label as usize].push((cell.0 as u32, cell.1 as u32));
    });
    cells
}

#[cfg(test)]
mod tests {
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
        comes_back(
            &image(|row, column| 1 + ((row * 7919 + column * 104_729) % 60_000) as u32),
            &scanner,
            &alone,
        );
    }

    #[test]
    fn flat_ground_leaves_next_to_nothing() {
        let scanner = ideal(COLUMNS, 10_000);
        let floor =
            |row: usize| if row < 20 { None } else { scanner.steps(1.7 / -scanner.elevation(row).sin()) };
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
}
