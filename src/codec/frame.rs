//! A scan as it is coded: the range image and what it takes to get from it to the file's points.

use super::config::{EncoderConfig, ProjectionKind};
use super::parameters::{FrameParameters, Positions, Prediction, Source};
use super::steps::{Step, StepReport};
use std::time::Instant;

use crate::context::OrderExceptions;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::io::with_point_count;
use crate::prediction::Rays;
use crate::prediction::intra::IntraPrediction;
use crate::range_image::{Projection, Return, project, project_nearest};
use crate::registration::QuantisedPose;
use crate::scan::{Layout, PointCloud, ScanFile};
use crate::segmentation::segment;
use crate::sensor::SensorModel;

/// The parts of a frame, as the sections code them.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    pub parameters: FrameParameters,
    pub layout: Layout,
    pub prefix: Vec<u8>,
    pub suffix: Vec<u8>,
    /// Number of records in the file.
    pub records: usize,
    /// Number of records that are strays; the others are returns of the range image.
    pub strays: usize,
    /// Column ticks of the range image, rising.
    pub columns: Vec<u32>,
    /// Which cells hold a return.
    pub occupancy: Grid<bool>,
    /// Range of each return, in steps.
    pub steps: Grid<u32>,
    /// The regions of the image and their models, if ranges are predicted from them.
    pub intra: IntraPrediction,
    /// What an image coder made of the ranges; kept, so that they lose nothing when they are coded again.
    pub image: Vec<u8>,
    /// Intensity of each return.
    pub intensity: Grid<f32>,
    /// Position of each return, in file order.
    pub positions: Vec<[f32; 3]>,
    pub stray_positions: Vec<[f32; 3]>,
    pub stray_intensity: Vec<f32>,
    pub order: OrderExceptions,
    /// The other bytes of the records, in the order of the file.
    pub extra: Vec<u8>,
}

impl Frame {
    /// Takes a scan apart (article, III-A and IV-A: the outlier filter and the range image).
    pub fn from_scan(
        scan: &ScanFile,
        sensor: Option<&SensorModel>,
        config: &EncoderConfig,
        steps: &mut StepReport,
    ) -> Result<Self> {
        let mut frame = Frame {
            parameters: config.frame_parameters()?,
            layout: scan.layout.clone(),
            prefix: scan.prefix.clone(),
            suffix: scan.suffix.clone(),
            records: scan.records,
            ..Frame::default()
        };
        match sensor {
            None => frame.take_strays(&scan.cloud),
            Some(_) if scan.cloud.positions.is_empty() => frame.take_strays(&scan.cloud),
            Some(sensor) if config.positions == Positions::Exact => {
                steps.timed(Step::Conversion, || frame.take_points(&scan.cloud, sensor));
            }
            Some(sensor) => frame.convert_points(&scan.cloud, sensor, config, steps),
        }
        frame.parameters.range_coder.fit(&frame.steps);
        Ok(frame)
    }

    /// Takes a prediction: for intra, finds the regions of the image (equations 3 and 4) and models them
    /// (equations 5 to 7).
    pub fn predict(
        &mut self,
        prediction: Prediction,
        sensor: Option<&SensorModel>,
        config: &EncoderConfig,
        steps: &mut StepReport,
    ) {
        if prediction != Prediction::Inter {
            self.predict_from_nothing();
        }
        self.parameters.prediction = prediction;
        if let (Some(sensor), Prediction::Intra) = (sensor, prediction) {
            let segmentation = steps.timed(Step::Clustering, || {
                segment(&self.steps, &self.columns, sensor, &config.segmentation)
            });
            let rays = Rays::of(sensor, &self.columns);
            self.intra = steps.timed(Step::Prediction, || {
                IntraPrediction::fit(&self.steps, &self.occupancy, &rays, &segmentation, &config.intra)
            });
        }
    }

    /// Takes no prediction.
    pub fn predict_from_nothing(&mut self) {
        self.parameters.prediction = Prediction::None;
        self.parameters.motion = QuantisedPose::default();
    }

    /// Takes all points as they come: there is no range image. Nothing of them is lost.
    fn take_strays(&mut self, cloud: &PointCloud) {
        self.parameters.positions = Positions::Exact;
        self.parameters.intensity = true;
        self.strays = self.records;
        self.stray_positions = cloud.positions.clone();
        self.stray_intensity = cloud.intensity.clone();
        self.extra = cloud.extra.clone();
    }

    /// Takes all points as they are.
    fn take_points(&mut self, cloud: &PointCloud, sensor: &SensorModel) {
        let points = self.take_image(cloud, project(sensor, cloud), sensor);
        let returns = points.len() - self.strays;
        self.positions = points[..returns].iter().map(|&point| cloud.positions[point as usize]).collect();
        let mut order = vec![0u32; points.len()];
        (0u32..).zip(&points).for_each(|(element, &point)| order[point as usize] = element);
        self.order = OrderExceptions::of(&order, returns);
        self.extra = cloud.extra.clone();
    }

    /// Takes what the outlier filter (equation 1) and the range image (equation 2) leave of the
    /// points.
    fn convert_points(
        &mut self,
        cloud: &PointCloud,
        sensor: &SensorModel,
        config: &EncoderConfig,
        steps: &mut StepReport,
    ) {
        let filtered = steps.timed(Step::Outliers, || Some(config.outliers?.filter(cloud)));
        let cloud = filtered.as_ref().unwrap_or(cloud);
        let start = Instant::now();
        let mut projection = match config.projection {
            ProjectionKind::Calibrated { .. } => project(sensor, cloud),
            ProjectionKind::Ideal { .. } => project_nearest(sensor, cloud),
        };
        let lost = match config.projection {
            ProjectionKind::Calibrated { .. } => 0,
            ProjectionKind::Ideal { .. } => std::mem::take(&mut projection.strays).len(),
        };
        let points = self.take_image(cloud, projection, sensor);
        self.extra = cloud.select(&points).extra;
        self.parameters.source = Some(Source {
            file_size: steps.original,
            points: self.records as u64,
            outliers: (self.records - cloud.positions.len()) as u64,
            lost: lost as u64,
        });
        self.records = points.len();
        self.prefix = with_point_count(&self.prefix, self.records);
        steps.took(Step::Conversion, start);
    }

    /// Takes the range image and the strays. Returns the points in its order: the returns in file
    /// order, then the strays.
    fn take_image(&mut self, cloud: &PointCloud, projection: Projection, sensor: &SensorModel) -> Vec<u32> {
        let Projection { image, point_of_cell, strays } = projection;
        let returns = image.file_order(sensor);
        let cell = |found: &Return| (found.row as usize, found.column as usize);
        let mut points: Vec<u32> = returns.iter().map(|found| point_of_cell[cell(found)]).collect();

        self.occupancy = Grid::new(image.steps.rows(), image.columns.len());
        self.intensity = Grid::new(image.steps.rows(), image.columns.len());
        for (found, &point) in returns.iter().zip(&points) {
            self.occupancy[cell(found)] = true;
            if let Some(&value) = cloud.intensity.get(point as usize) {
                self.intensity[cell(found)] = value;
            }
        }
        self.columns = image.columns;
        self.steps = image.steps;
        self.strays = strays.len();
        let PointCloud { positions, intensity, .. } = cloud.select(&strays);
        self.stray_positions = positions;
        self.stray_intensity = intensity;
        points.extend(strays);
        points
    }

    /// Puts the scan together again.
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn into_scan(self, name: &str, returns: &[Return]) -> Result<ScanFile> {
        let order = self.order.order(returns.len())?;
        if order.len() != self.records {
            return Err(Error::corrupt("the parts of the frame hold different numbers of points"));
        }
        let mut cloud = PointCloud { extra: self.extra, ..PointCloud::default() };
        if self.layout.position.is_some() {
            let positions: Vec<_> = self.positions.iter().chain(&self.stray_positions).copied().collect();
            cloud.positions = order.iter().map(|&element| positions[element as usize]).collect();
        }
        if self.layout.intensity.is_some() {
            let of_returns =
                returns.iter().map(|found| self.intensity[(found.row as usize, found.column as usize)]);
            let intensity: Vec<f32> = of_returns.chain(self.stray_intensity.iter().copied()).collect();
            cloud.intensity = order.iter().map(|&element| intensity[element as usize]).collect();
        }
        Ok(ScanFile {
            name: name.to_owned(),
            layout: self.layout,
            prefix: self.prefix,
            records: self.records,
            cloud,
            suffix: self.suffix,
        })
    }
}
