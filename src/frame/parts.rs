//! A scan in the form in which it is coded: the range image, and the data that turn it into the file's
//! points. FORMAT.md 4.2 and 9.

use super::bound::Bound;
use super::fidelity::{IntensityFidelity, PositionFidelity};
use super::parameters::{FrameParameters, OriginalFile, Prediction};
use super::settings::{EncoderConfig, ProjectionKind};
use super::stages::{Stage, StageReport};
use super::whole::WholeFile;
use std::mem::take;
use std::sync::Arc;

use crate::article::prediction::Rays;
use crate::article::prediction::intra::IntraPrediction;
use crate::article::segmentation::segment;
use crate::files::with_point_count;
use crate::ground::clock::Instant;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::registration::QuantisedPose;
use crate::models::{OrderExceptions, PointTrail, RecordContext};
use crate::scan::{Channel, Layout, PointCloud, ScanFile, has_direction, sorted};
use crate::scanner::hdl64::project_nearest;
use crate::scanner::motion::{self, Compensation, by_time};
use crate::scanner::{Orientation, Projection, REACH, RangeImage, Return, Scanner};

/// The parts of a frame, as the sections code them.
#[derive(Clone, Debug, Default)]
pub struct FrameParts {
    pub parameters: FrameParameters,
    pub layout: Layout,
    pub prefix: Vec<u8>,
    pub suffix: Vec<u8>,
    /// Number of records in the file.
    pub records: usize,
    /// The records that are not returns of the range image.
    pub strays: Strays,
    /// The range image.
    pub image: RangeImage,
    /// Which cells hold a return.
    pub occupancy: Grid<bool>,
    /// The indices of the cells with a return, row after row.
    pub cells: Vec<u32>,
    /// The indices of the cells that hold blanks, row after row.
    pub blanks: Vec<u32>,
    /// The regions of the image and their models, if they predict the ranges.
    pub intra: IntraPrediction,
    /// The output of an image coder for the ranges, kept so that recoding does not add losses.
    pub coded_image: Vec<u8>,
    /// Intensities of the returns and blanks.
    pub intensity: Grid<f32>,
    /// The returns of the range image, and its blanks, in file order.
    pub returns: Vec<Return>,
    /// Positions of these.
    pub positions: Vec<[f32; 3]>,
    /// Intensities of the echoes.
    pub echo_intensity: Vec<f32>,
    pub order: OrderExceptions,
    /// The channels of the records, in the order of the file.
    pub channels: Vec<Channel>,
    /// The cells of the images by which channels are coded.
    pub image_cells_of_channels: u64,
    /// The file's bytes, if the whole frame is coded as bytes.
    pub whole: Option<WholeFile>,
    /// The axes of the file; all positions here have those of the scanner.
    pub orientation: Orientation,
    /// How the points were moved after they were measured; all positions here are those before.
    pub compensation: Option<Compensation>,
    /// The channel by which the file's records were sorted; everything else here is in the order of arrival.
    pub sorted: Option<usize>,
    /// The positions and intensities in the order of the file, once a decoder has restored them for the
    /// channels.
    pub decoded_in_file_order: Option<(Vec<[f32; 3]>, Vec<f32>)>,
    /// The original points; only while a scan is encoded.
    origin: Option<Arc<Origin>>,
    /// Positions as in the file, if they were moved; only while a scan is encoded.
    moved: Option<Arc<Vec<[f32; 3]>>>,
}

/// The records of a frame that are not returns of its range image.
#[derive(Clone, Debug, Default)]
pub struct Strays {
    pub count: usize,
    /// Empty if the records have no position.
    pub positions: Vec<[f32; 3]>,
    /// The trail of each, if the model of points coded them.
    pub trails: Vec<PointTrail>,
    pub intensity: Vec<f32>,
}

impl Strays {
    /// The number of those without a direction, such as records without a return.
    pub fn without_direction(&self) -> usize {
        self.positions.iter().filter(|position| !has_direction(position)).count()
    }
}

/// The points of a scan that is being encoded, and their cells in the range image.
#[derive(Debug)]
struct Origin {
    cloud: PointCloud,
    point_of_cell: Grid<u32>,
    point_of_echo: Vec<u32>,
    strays: Vec<u32>,
}

impl FrameParts {
    /// Bytes of the records, or cells of the range image or of the channels' images if these are more: what a
    /// decoder allocates in addition to the file.
    pub fn unfolded_bytes(&self) -> u64 {
        let records = self.records as u64 * self.layout.stride() as u64;
        records.max(self.image.steps.cells().len() as u64).max(self.image_cells_of_channels)
    }

    /// Number of records in the range image.
    pub fn in_image(&self) -> usize {
        self.records - self.strays.count
    }

    /// A frame with `records` records of which nothing else is known yet.
    pub fn of_records(records: usize, scanner: Option<&Scanner>) -> Self {
        let orientation = scanner.map_or_else(Orientation::default, Scanner::orientation);
        FrameParts { records, orientation, ..FrameParts::default() }
    }

    /// A frame that is coded as the bytes of its file.
    pub fn of_whole(whole: WholeFile, records: usize) -> Self {
        FrameParts { whole: Some(whole), records, ..FrameParts::default() }
    }

    /// Splits a scan into parts (article, III-A and IV-A: the outlier filter and the range image). Without
    /// `has_image`, all its points are strays, although there is a scanner.
    pub fn from_scan(
        scan: ScanFile,
        scanner: Option<&Scanner>,
        has_image: bool,
        config: &EncoderConfig,
        stages: &mut StageReport,
    ) -> Result<Self> {
        let mut frame = FrameParts {
            parameters: config.frame_parameters()?,
            layout: scan.layout,
            prefix: scan.prefix,
            suffix: scan.suffix,
            ..FrameParts::of_records(scan.records, scanner)
        };
        let scanner = scanner.filter(|_| has_image);
        let bound = Bound::of(config.positions, config.intensity);
        let cloud = stages.timed(Stage::Conversion, || {
            let mut cloud = scan.cloud;
            frame.orientation.turn_to_scanner(&mut cloud.positions);
            let cloud = if scanner.is_some() { frame.undo_sort(cloud) } else { cloud };
            frame.undo_compensation(cloud, scanner, config)
        });
        match scanner.filter(|_| !cloud.positions.is_empty()) {
            None => frame.take_strays(cloud),
            Some(scanner) if config.positions == PositionFidelity::Formula => {
                frame.convert_points(&cloud, scanner, config, stages);
            }
            Some(scanner) => stages.timed(Stage::Conversion, || {
                frame.take_points(cloud, scanner, bound.as_ref());
            }),
        }
        if let Some(bound) = bound {
            frame.round_values(&bound);
            frame.parameters.source = Some(OriginalFile::all_points(stages.original, scan.records as u64));
        }
        frame.parameters.range_coder.fit(&frame.image.steps);
        Ok(frame)
    }

    /// Applies a prediction: for intra, segments the image into regions (equations 3 and 4) and models them
    /// (equations 5 to 7).
    pub fn predict(
        &mut self,
        prediction: Prediction,
        scanner: Option<&Scanner>,
        config: &EncoderConfig,
        stages: &mut StageReport,
    ) {
        if prediction != Prediction::Inter {
            self.predict_from_nothing();
        }
        self.parameters.prediction = prediction;
        if let (Some(scanner), Prediction::Intra) = (scanner.and_then(Scanner::hdl64), prediction) {
            let segmentation = stages.timed(Stage::Clustering, || {
                segment(&self.image.steps, &self.image.columns, scanner, &config.segmentation)
            });
            let rays = Rays::of(scanner, &self.image.columns);
            self.intra = stages.timed(Stage::Prediction, || {
                IntraPrediction::fit(&self.image.steps, &self.occupancy, &rays, &segmentation, &config.intra)
            });
        }
    }

    /// Removes the prediction.
    pub fn predict_from_nothing(&mut self) {
        self.parameters.prediction = Prediction::None;
        self.parameters.motion = QuantisedPose::default();
    }

    /// The points in the order of arrival, if they were sorted after it.
    fn undo_sort(&mut self, cloud: PointCloud) -> PointCloud {
        let Some((channel, cloud)) = sorted::in_order_of_arrival(&cloud) else { return cloud };
        // If points are left out, and the formula's come in the order of the image, nothing is sorted again.
        self.sorted = (self.parameters.positions != PositionFidelity::Formula).then_some(channel);
        cloud
    }

    /// The points as they were measured, if they were moved after it.
    fn undo_compensation(
        &mut self,
        cloud: PointCloud,
        scanner: Option<&Scanner>,
        config: &EncoderConfig,
    ) -> PointCloud {
        let firings = scanner.and_then(Scanner::firings);
        if !config.undoes_compensation()
            || firings.is_some_and(|firings| firings.reproduces_most(&cloud.positions))
        {
            return cloud;
        }
        let undone = motion::undo(&cloud.positions).or_else(|| {
            let (positions, stamped) = by_time::undo(&cloud, firings?)?;
            Some((positions, Compensation::Stamped(stamped)))
        });
        let Some((positions, compensation)) = undone else { return cloud };
        self.compensation = Some(compensation);
        self.moved = Some(Arc::new(cloud.positions));
        PointCloud { positions, ..cloud }
    }

    /// Codes all points one by one, without a range image. No point is lost.
    fn take_strays(&mut self, cloud: PointCloud) {
        if self.parameters.positions == PositionFidelity::Formula {
            self.parameters.positions = PositionFidelity::Exact;
            self.parameters.intensity = IntensityFidelity::Exact;
        }
        let PointCloud { positions, intensity, channels } = cloud;
        self.strays = Strays { count: self.records, positions, trails: Vec::new(), intensity };
        self.channels = channels;
    }

    /// Codes all points, in bins of range as wide as the bound allows.
    fn take_points(&mut self, cloud: PointCloud, scanner: &Scanner, bound: Option<&Bound>) {
        let projection = scanner.project(&cloud, bound.map_or(REACH, |bound| bound.reach().max(REACH)));
        if let Some(bound) = bound {
            let bin = bound.bin(scanner.range_step_m(), scanner.misses(&projection, &cloud));
            self.parameters.range_coder = self.parameters.range_coder.in_bins(bin);
            if let PositionFidelity::Bounded { on_grid, .. } = &mut self.parameters.positions {
                *on_grid = bin == 1;
            }
        }
        self.take_image(cloud, projection);
    }

    /// Rounds the values outside the range image as far as the bound allows.
    fn round_values(&mut self, bound: &Bound) {
        bound.round_positions(&mut self.strays.positions);
        let of_cells = self.intensity.cells_mut().iter_mut();
        let outside = self.strays.intensity.iter_mut().chain(&mut self.echo_intensity);
        bound.round_intensities(of_cells.chain(outside));
    }

    /// Codes the points that remain after the outlier filter (equation 1) and the conversion to the range
    /// image (equation 2).
    fn convert_points(
        &mut self,
        cloud: &PointCloud,
        scanner: &Scanner,
        config: &EncoderConfig,
        stages: &mut StageReport,
    ) {
        let cloud = stages.timed(Stage::Outliers, || match config.outliers {
            #[cfg(feature = "article")]
            Some(outliers) => outliers.filter(cloud),
            _ => cloud.clone(),
        });
        let start = Instant::now();
        let mut projection = match config.projection {
            ProjectionKind::Calibrated { .. } => scanner.project(&cloud, REACH),
            ProjectionKind::Ideal { .. } => match scanner.hdl64() {
                Some(scanner) => project_nearest(scanner, &cloud),
                None => scanner.project(&cloud, REACH),
            },
        };
        // Points that are not in the image.
        let blanks = projection.image.blanks();
        projection.image.is_full = false;
        let lost = match config.projection {
            ProjectionKind::Calibrated { .. } => blanks,
            ProjectionKind::Ideal { .. } => blanks + std::mem::take(&mut projection.strays).len(),
        };
        self.parameters.source = Some(OriginalFile {
            file_size: stages.original,
            points: self.records as u64,
            outliers: (self.records - cloud.positions.len()) as u64,
            lost: lost as u64,
        });
        self.records = cloud.positions.len() - lost;
        self.take_image(cloud, projection);
        self.prefix = with_point_count(&self.prefix, self.records);
        stages.took(Stage::Conversion, start);
    }

    /// Sets the range image and the strays.
    fn take_image(&mut self, cloud: PointCloud, projection: Projection) {
        let Projection { image, point_of_cell, point_of_echo, strays } = projection;
        self.occupancy = image.occupancy();
        self.intensity = Grid::new(image.steps.rows(), image.columns.len());
        let of_point = |point: &u32| cloud.intensity.get(*point as usize).copied().unwrap_or(0.0);
        let cells = image.steps.cells().iter().zip(point_of_cell.cells());
        for (intensity, (steps, point)) in self.intensity.cells_mut().iter_mut().zip(cells) {
            if image.is_full || *steps > 0 {
                *intensity = of_point(point);
            }
        }
        self.echo_intensity = point_of_echo.iter().map(of_point).collect();
        self.image = image;
        let PointCloud { positions, intensity, .. } = cloud.select(&strays);
        self.strays = Strays { count: strays.len(), positions, trails: Vec::new(), intensity };
        self.origin = Some(Arc::new(Origin { cloud, point_of_cell, point_of_echo, strays }));
    }

    /// Brings the encoder's points into the order in which a decoder finds the returns, which depends on the
    /// decoded ranges.
    pub fn arrange(&mut self, scanner: Option<&Scanner>) {
        self.returns = scanner.map_or_else(Vec::new, |scanner| scanner.file_order(&self.image));
        let Some(origin) = self.origin.take() else { return };
        let Origin { cloud, point_of_cell, point_of_echo, strays } = &*origin;
        let returns = &self.returns;
        let of_returns = returns.iter().map(|found| match found.echo.checked_sub(1) {
            None => point_of_cell[(found.row as usize, found.column as usize)],
            Some(echo) => point_of_echo[echo as usize],
        });
        let points: Vec<u32> = of_returns.chain(strays.iter().copied()).collect();
        self.positions =
            points[..returns.len()].iter().map(|&point| cloud.positions[point as usize]).collect();
        if self.parameters.positions == PositionFidelity::Formula {
            self.channels = cloud.select(&points).channels;
            return;
        }
        self.order = OrderExceptions::of_places(&points, returns.len());
        self.channels.clone_from(&cloud.channels);
    }

    /// The index of the file's point in each cell.
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn point_of_cell(&self) -> Result<Grid<Option<u32>>> {
        let mut points = Grid::new(self.occupancy.rows(), self.occupancy.columns());
        for (point, element) in (0u32..).zip(self.order.order(self.returns.len())?) {
            if let Some(found) = self.returns.get(element as usize).filter(|found| found.echo == 0) {
                points[(found.row as usize, found.column as usize)] = Some(point);
            }
        }
        let Some(order) = self.file_order() else { return Ok(points) };
        let mut places = vec![0; order.len()];
        (0u32..).zip(order).for_each(|(place, record)| places[record as usize] = place);
        Ok(points.map(|point| point.and_then(|record| places.get(record as usize).copied())))
    }

    /// The number of returns that the formula reproduces as measured, to the last bit.
    pub fn reproduced_returns(&self, scanner: &Scanner) -> usize {
        let offset_m = self.parameters.range_coder.offset_m(scanner);
        let formula = scanner.positions(&self.returns, offset_m, true);
        let bits = |position: &[f32; 3]| position.map(f32::to_bits);
        let points = formula.iter().zip(&self.positions).zip(&self.returns);
        // Blanks were not measured.
        points
            .filter(|((formula, position), found)| found.steps == 0 || bits(formula) == bits(position))
            .count()
    }

    /// For each position in the file, the index of its record, if records were sorted after they arrived.
    fn file_order(&self) -> Option<Vec<u32>> {
        let keys = self.channels.get(self.sorted?)?;
        Some(sorted::file_order(keys))
    }

    /// The data about the records that are known when their channels are coded.
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn record_context(&self, scanner: Option<&Scanner>) -> Result<RecordContext> {
        let mut context = RecordContext::default();
        if self.layout.position.is_some() {
            context.positions = self.positions_in_order()?;
        }
        context.intensity = self.intensities_of_file()?;
        if !self.returns.is_empty() {
            context.rows = self.numbers_in_order(|found| found.row + 1)?;
            context.columns = self.numbers_in_order(|found| found.column + 1)?;
            if let Some(scanner) = scanner.and_then(Scanner::firings) {
                context.steps = self.numbers_in_order(|found| found.steps)?;
                context.ticks = self.numbers_in_order(|found| found.tick)?;
                context.range_step_m = scanner.range_step_m();
                context.tick_degrees = 360.0 / f64::from(scanner.build().ticks);
            }
        } else if !self.strays.trails.is_empty() {
            context.rows = self.strays.trails.iter().map(|trail| trail.row).collect();
            context.columns = vec![0; context.rows.len()];
        }
        Ok(context)
    }

    /// A number for each return, in the order of the file; 0 for strays.
    fn numbers_in_order(&self, number: impl Fn(&Return) -> u32) -> Result<Vec<u32>> {
        let of_returns: Vec<u32> = self.returns.iter().map(number).collect();
        self.order.arranged(of_returns, &vec![0; self.order.stray_places.len()])
    }

    /// The intensities in the order of the file, if it has any.
    fn intensities_of_file(&self) -> Result<Vec<f32>> {
        if self.layout.intensity.is_none() {
            return Ok(Vec::new());
        }
        let of_return = |found: &Return| match found.echo.checked_sub(1) {
            None => self.intensity[(found.row as usize, found.column as usize)],
            Some(echo) => self.echo_intensity.get(echo as usize).copied().unwrap_or(0.0),
        };
        let of_returns: Vec<f32> = self.returns.iter().map(of_return).collect();
        self.order.arranged(of_returns, &self.strays.intensity)
    }

    /// The positions, as coded, in the order of the file.
    pub fn positions_in_order(&self) -> Result<Vec<[f32; 3]>> {
        self.order.arranged(self.positions.as_slice(), &self.strays.positions)
    }

    /// Moves the positions, in file order, out of the frame; empty if the layout has none.
    fn positions_of_file(&mut self) -> Result<Vec<[f32; 3]>> {
        if self.layout.position.is_none() {
            return Ok(Vec::new());
        }
        self.order.arranged(take(&mut self.positions), &self.strays.positions)
    }

    /// Lists the points that motion compensation does not move to their positions in the file, now that their
    /// decoded positions are known.
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn find_misses(&mut self) -> Result<()> {
        let Some(moved) = self.moved.take() else { return Ok(()) };
        let measured = self.positions_in_order()?;
        let bound = Bound::of(self.parameters.positions, self.parameters.intensity);
        if let Some(compensation) = &mut self.compensation {
            compensation.find_misses((&measured, &self.channels), &moved, |a, b| match &bound {
                Some(bound) => bound.is_near(a, b),
                None => a.map(f32::to_bits) == b.map(f32::to_bits),
            });
        }
        Ok(())
    }

    /// Restores the scan from its parts.
    ///
    /// # Errors
    /// If the parts do not fit together.
    pub fn into_scan(mut self, name: &str) -> Result<ScanFile> {
        if let Some(whole) = self.whole {
            return whole.into_scan(name, self.records);
        }
        if self.returns.len() + self.order.stray_places.len() != self.records {
            return Err(Error::corrupt("the parts of the frame hold different numbers of points"));
        }
        let mut cloud = PointCloud::default();
        (cloud.positions, cloud.intensity) = match self.decoded_in_file_order.take() {
            Some(decoded) => decoded,
            None => (self.positions_of_file()?, self.intensities_of_file()?),
        };
        if let Some(compensation) = &self.compensation {
            compensation.apply(&mut cloud.positions, &self.channels);
        }
        self.orientation.turn_to_file(&mut cloud.positions);
        let order = self.file_order();
        cloud.channels = self.channels;
        if let Some(order) = order {
            cloud = cloud.select(&order);
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
