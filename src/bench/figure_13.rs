//! Figure 13 of the article: what prediction is worth to each lossless back-end. Twice: in the article's
//! terms, range image and residuals as 32-bit floats, and in integers, where plain differences compete.

use crate::backend::BACKENDS;
use crate::codec::{EncoderConfig, ProjectionKind};
use crate::contour::ContourModel;
use crate::entropy::ArithmeticEncoder;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::prediction::intra::IntraPrediction;
use crate::prediction::surface::SurfaceCoder;
use crate::prediction::{Predictor, Rays};
use crate::range_image::project_nearest;
use crate::scan::PointCloud;
use crate::segmentation::segment;
use crate::sensor::{FLOAT_RANGES, SensorModel, ideal};

/// Bytes of one or more frames by one back-end. Side data (contour map and models of regions) is
/// counted where regions predict; which cells hold a return is not counted anywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// The range image, in steps, as 32-bit floats in metres: as the article stores it.
    pub float_image: u64,
    /// What the regions leave of it, as 32-bit floats.
    pub float_residual: u64,
    /// The ranges in steps.
    pub ranges: u64,
    /// Their differences along the snake's path.
    pub differences: u64,
    /// What the regions leave of the ranges.
    pub residual: u64,
    /// Differences of that along the snake's path.
    pub residual_differences: u64,
}

impl Sizes {
    fn add(&mut self, other: &Sizes) {
        self.float_image += other.float_image;
        self.float_residual += other.float_residual;
        self.ranges += other.ranges;
        self.differences += other.differences;
        self.residual += other.residual;
        self.residual_differences += other.residual_differences;
    }
}

/// The figure's data.
#[derive(Clone, Debug, Default)]
pub struct Figure13 {
    /// Frames.
    pub frames: u64,
    /// Bytes of their files.
    pub original: u64,
    /// Bytes of contour maps and models of regions, part of the sizes.
    pub side: u64,
    /// For each back-end of the registry, in its order.
    pub sizes: Vec<Sizes>,
}

/// Measures frames one after the other.
pub struct Figure13Bench<'a> {
    config: &'a EncoderConfig,
    sensor: SensorModel,
    side: SideCoder,
    figure: Figure13,
}

impl<'a> Figure13Bench<'a> {
    /// With the article's projection, outlier filter and regions as `config` has them.
    ///
    /// # Errors
    /// If the configuration has no ideal projection with a step.
    pub fn new(config: &'a EncoderConfig) -> Result<Self> {
        let sensor = match config.projection {
            ProjectionKind::Ideal { columns, range_step_um } if range_step_um != FLOAT_RANGES => {
                ideal(columns, range_step_um)
            }
            _ => return Err(Error::InvalidConfig("the figure needs the ideal range image in steps".into())),
        };
        Ok(Figure13Bench {
            config,
            sensor,
            side: SideCoder::default(),
            figure: Figure13 { sizes: vec![Sizes::default(); BACKENDS.len()], ..Figure13::default() },
        })
    }

    /// Measures one frame.
    ///
    /// # Errors
    /// If a back-end's library fails.
    pub fn add(&mut self, cloud: &PointCloud, file_bytes: u64) -> Result<()> {
        let filtered = self.config.outliers.map(|filter| filter.filter(cloud));
        let cloud = filtered.as_ref().unwrap_or(cloud);
        let image = project_nearest(&self.sensor, cloud).image;
        let occupancy = image.occupancy();
        let rays = Rays::of(&self.sensor, &image.columns);
        let segmentation = segment(&image.steps, &image.columns, &self.sensor, &self.config.segmentation);
        let mut intra =
            IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &self.config.intra);
        let side = self.side.code(&mut intra, &occupancy)?;
        let predicted = intra.ranges(&occupancy, &rays);

        let (floats, residual_floats) = self.as_floats(&image.steps, &predicted);
        let integers = |ranges: Option<&Grid<u32>>, snake| {
            Predictor { ranges: ranges.cloned(), snake }.residuals(&occupancy, &image.steps)
        };
        let variants = [
            (integers(None, false), false),
            (integers(None, true), true),
            (integers(Some(&predicted), false), false),
            (integers(Some(&predicted), true), true),
        ];
        for (total, backend) in self.figure.sizes.iter_mut().zip(BACKENDS) {
            let size = |bytes: &[u8]| -> Result<u64> {
                Ok(backend.compress(bytes, self.config.level)?.len() as u64)
            };
            let packed = |place: usize| {
                size(&self.config.packing_for(*backend, variants[place].1).pack(&variants[place].0))
            };
            total.add(&Sizes {
                float_image: size(&floats)?,
                float_residual: size(&residual_floats)? + side,
                ranges: packed(0)?,
                differences: packed(1)?,
                residual: packed(2)? + side,
                residual_differences: packed(3)? + side,
            });
        }
        self.figure.frames += 1;
        self.figure.original += file_bytes;
        self.figure.side += side;
        Ok(())
    }

    /// The sizes so far.
    pub fn figure(self) -> Figure13 {
        self.figure
    }

    /// The whole image as floats in metres, and what prediction leaves of it; 0 where there is no
    /// return.
    fn as_floats(&self, steps: &Grid<u32>, predicted: &Grid<u32>) -> (Vec<u8>, Vec<u8>) {
        let metres = |steps: i64| (steps as f64 * f64::from(self.sensor.range_step_um) * 1e-6) as f32;
        let (mut image, mut residual) = (Vec::new(), Vec::new());
        for (&range, &predicted) in steps.cells().iter().zip(predicted.cells()) {
            image.extend(metres(range.into()).to_le_bytes());
            residual.extend(metres(i64::from(range) - i64::from(predicted)).to_le_bytes());
        }
        (image, residual)
    }
}

/// Codes contour maps and models of regions.
#[derive(Default)]
struct SideCoder {
    contour: ContourModel,
    surfaces: SurfaceCoder,
}

impl SideCoder {
    /// How many bytes they take.
    fn code(&mut self, intra: &mut IntraPrediction, occupancy: &Grid<bool>) -> Result<u64> {
        let mut coder = ArithmeticEncoder::default();
        intra.code_contour(&mut self.contour, &mut coder, occupancy)?;
        intra.code_models(&mut self.surfaces, &mut coder);
        Ok(coder.finish().len() as u64)
    }
}
