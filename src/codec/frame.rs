//! A scan as it is coded: the range image and what it takes to get from it to the file's points.

use crate::context::OrderExceptions;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::range_image::{Return, project};
use crate::scan::{Layout, PointCloud, ScanFile};
use crate::sensor::SensorModel;

/// The parts of a frame, as the sections code them.
#[derive(Debug, Default)]
pub struct Frame {
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
    /// Takes a scan apart (article, IV-A: the range image).
    pub fn from_scan(scan: &ScanFile, sensor: Option<&SensorModel>) -> Self {
        let cloud = &scan.cloud;
        let mut frame = Frame {
            layout: scan.layout.clone(),
            prefix: scan.prefix.clone(),
            suffix: scan.suffix.clone(),
            records: scan.records,
            extra: cloud.extra.clone(),
            ..Frame::default()
        };
        match sensor {
            Some(sensor) if !cloud.positions.is_empty() => frame.project(cloud, sensor),
            _ => {
                frame.strays = scan.records;
                frame.stray_positions = cloud.positions.clone();
                frame.stray_intensity = cloud.intensity.clone();
            }
        }
        frame
    }

    fn project(&mut self, cloud: &PointCloud, sensor: &SensorModel) {
        let projection = project(sensor, cloud);
        let image = projection.image;
        let returns = image.file_order(sensor);
        let point_of =
            |found: &Return| projection.point_of_cell[(found.row as usize, found.column as usize)] as usize;
        self.strays = projection.strays.len();
        self.positions = returns.iter().map(|found| cloud.positions[point_of(found)]).collect();
        self.stray_positions = projection.strays.iter().map(|&p| cloud.positions[p as usize]).collect();

        let mut order = vec![0u32; cloud.positions.len()];
        (0u32..).zip(&returns).for_each(|(element, found)| order[point_of(found)] = element);
        (returns.len() as u32..)
            .zip(&projection.strays)
            .for_each(|(element, &p)| order[p as usize] = element);
        self.order = OrderExceptions::of(&order, returns.len());

        self.occupancy = Grid::new(image.steps.rows(), image.columns.len());
        self.intensity = Grid::new(image.steps.rows(), image.columns.len());
        for found in &returns {
            let cell = (found.row as usize, found.column as usize);
            self.occupancy[cell] = true;
            if let Some(&value) = cloud.intensity.get(point_of(found)) {
                self.intensity[cell] = value;
            }
        }
        if !cloud.intensity.is_empty() {
            self.stray_intensity = projection.strays.iter().map(|&p| cloud.intensity[p as usize]).collect();
        }
        self.columns = image.columns;
        self.steps = image.steps;
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
