//! The points of a scan as a range image: one row a beam, one column a firing.
//!
//! A cell holds the range in steps of the sensor model, 0 where no return came. Points that the
//! model does not give back to within a few grid units, that fall into a taken cell, or that lie in no
//! column stay outside, as *strays*.

mod alignment;
mod reference;

pub use alignment::Alignment;
pub use reference::{Layer, Reference};

use crate::grid::Grid;
use crate::scan::{PointCloud, squared_distance};
use crate::sensor::SensorModel;

/// The range image of a scan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RangeImage {
    /// The column tick of each column, rising.
    pub columns: Vec<u32>,
    /// Rows x columns; range in steps, 0 = no return.
    pub steps: Grid<u32>,
}

impl RangeImage {
    /// An image without returns.
    pub fn new(rows: usize, columns: Vec<u32>) -> Self {
        RangeImage { steps: Grid::new(rows, columns.len()), columns }
    }

    /// Number of returns.
    pub fn returns(&self) -> usize {
        self.steps.cells().iter().filter(|&&steps| steps > 0).count()
    }

    /// Which cells hold a return.
    pub fn occupancy(&self) -> Grid<bool> {
        self.steps.map(|&steps| steps > 0)
    }

    /// The returns in the order in which a file holds them: row by row, by the azimuth that the
    /// formula gives.
    pub fn file_order(&self, sensor: &SensorModel) -> Vec<Return> {
        let mut returns = Vec::with_capacity(self.returns());
        let mut row_returns: Vec<(f64, Return)> = Vec::new();
        for row in 0..self.steps.rows() {
            row_returns.clear();
            for (column, &steps) in self.steps.row(row).iter().enumerate().filter(|(_, steps)| **steps > 0) {
                let tick = sensor.tick_of_column(row, self.columns[column]);
                let found = Return { row: row as u32, column: column as u32, tick, steps };
                row_returns.push((sensor.azimuth(row, tick, steps), found));
            }
            // Stable: equal azimuths stay in the order of the columns.
            row_returns.sort_by(|a, b| a.0.total_cmp(&b.0));
            returns.extend(row_returns.iter().map(|(_, found)| *found));
        }
        returns
    }
}

/// One return of the range image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Return {
    /// Beam.
    pub row: u32,
    /// Column of the image.
    pub column: u32,
    /// Azimuth tick of the beam.
    pub tick: u32,
    /// Range in steps.
    pub steps: u32,
}

/// Where each point of a scan went.
#[derive(Debug, Default)]
pub struct Projection {
    /// The range image.
    pub image: RangeImage,
    /// For each cell, the number of the point in it; only cells with a return count.
    pub point_of_cell: Grid<u32>,
    /// The points outside the image, rising.
    pub strays: Vec<u32>,
}

impl Projection {
    /// How far the formula misses the points of the image, in metres, row after row.
    pub fn misses(&self, sensor: &SensorModel, cloud: &PointCloud) -> Vec<f64> {
        let mut misses = Vec::with_capacity(cloud.positions.len());
        for row in 0..self.image.steps.rows() {
            for (column, &steps) in self.image.steps.row(row).iter().enumerate().filter(|(_, s)| **s > 0) {
                let tick = sensor.tick_of_column(row, self.image.columns[column]);
                let formula = sensor.point(row, tick, steps).map(|metres| metres as f32);
                let point = &cloud.positions[self.point_of_cell[(row, column)] as usize];
                misses.push(squared_distance(&formula, point).sqrt());
            }
        }
        misses
    }
}

/// The longest range of an image that loses nothing, in steps: further points are strays.
const LONGEST: u32 = (1 << EXACT_RANGE_BITS) - 1;
/// Ranges of such an image are below 2 to this power.
pub const EXACT_RANGE_BITS: u32 = 16;

/// A column that holds fewer points costs more than they do as strays, if there are so many beams.
const FEWEST_IN_COLUMN: u32 = 3;
/// Metres by which the formula may miss a point of a range image that loses nothing, besides half a range
/// step.
pub const REACH: f64 = 0.003;

/// Projects a scan into a range image (article, IV-A, with the calibrated sensor for the ideal
/// one, so that nothing is lost). Points that the formula misses by more than `reach` metres along an axis,
/// besides half a range step, are strays.
pub fn project(sensor: &SensorModel, cloud: &PointCloud, reach: f64) -> Projection {
    let places = places(sensor, cloud, reach + 0.5 * sensor.range_step_m());
    let mut in_column = vec![0u32; sensor.ticks as usize];
    places.iter().flatten().for_each(|place| in_column[place.column_tick as usize] += 1);
    let fewest = FEWEST_IN_COLUMN.min(sensor.rows().div_ceil(3) as u32);
    let columns: Vec<u32> = (0..sensor.ticks).filter(|&c| in_column[c as usize] >= fewest).collect();
    let mut column_of_tick = vec![None; sensor.ticks as usize];
    columns.iter().enumerate().for_each(|(column, &tick)| column_of_tick[tick as usize] = Some(column));

    let mut projection = Projection {
        point_of_cell: Grid::new(sensor.rows(), columns.len()),
        image: RangeImage::new(sensor.rows(), columns),
        strays: Vec::new(),
    };
    for (point, place) in places.iter().enumerate() {
        let cell = place.and_then(|p| column_of_tick[p.column_tick as usize].map(|column| (p.row, column)));
        match (cell, place) {
            (Some(cell), Some(place)) if projection.image.steps[cell] == 0 => {
                projection.image.steps[cell] = place.steps;
                projection.point_of_cell[cell] = point as u32;
            }
            _ => projection.strays.push(point as u32),
        }
    }
    projection
}

/// Projects a scan into the image of the ideal sensor (article, IV-A, equation 2): every point goes to
/// the nearest beam and column, and of two in one cell the nearer stays. Strays are the points that
/// found no place.
pub fn project_nearest(sensor: &SensorModel, cloud: &PointCloud) -> Projection {
    let columns = (0..sensor.ticks).collect();
    let mut projection = Projection {
        point_of_cell: Grid::new(sensor.rows(), sensor.ticks as usize),
        image: RangeImage::new(sensor.rows(), columns),
        strays: Vec::new(),
    };
    let mut row = 0;
    for (point, position) in (0u32..).zip(&cloud.positions) {
        let position @ [x, y, z] = position.map(f64::from);
        row = sensor.nearest_beam((x * x + y * y).sqrt(), z, row);
        let Some((tick, steps)) = sensor.invert(row, position) else {
            projection.strays.push(point);
            continue;
        };
        let cell = (row, sensor.column_tick(row, i64::from(tick)) as usize);
        let held = projection.image.steps[cell];
        if held == 0 || steps < held {
            if held > 0 {
                projection.strays.push(projection.point_of_cell[cell]);
            }
            projection.image.steps[cell] = steps;
            projection.point_of_cell[cell] = point;
        } else {
            projection.strays.push(point);
        }
    }
    projection.strays.sort_unstable();
    projection
}

/// Where a point belongs by the formula.
#[derive(Clone, Copy)]
struct Place {
    row: usize,
    column_tick: u32,
    steps: u32,
}

/// The place of each point, None for those that the formula does not explain.
fn places(sensor: &SensorModel, cloud: &PointCloud, reach: f64) -> Vec<Option<Place>> {
    // Points come row by row, tick after tick.
    let (mut row, mut last_tick) = (0, 0);
    cloud
        .positions
        .iter()
        .map(|position| {
            if !position.iter().all(|v| sensor.coordinates.unit_in_file(*v).is_some()) {
                return None;
            }
            let point @ [x, y, z] = position.map(f64::from);
            row = sensor.nearest_beam((x * x + y * y).sqrt(), z, row);
            let found = sensor.invert_near(row, point, last_tick);
            let (tick, steps) = found.filter(|(_, steps)| *steps <= LONGEST)?;
            last_tick = tick;
            let formula = sensor.point(row, tick, steps);
            let near = formula.iter().zip(point).all(|(f, p)| (f - p).abs() < reach);
            // On the millimetre grid -0.0 and 0.0 are told apart by the formula's sign alone.
            let zeros =
                formula.iter().zip(position).all(|(f, p)| *p != 0.0 || sensor.coordinates.keeps_zero(*p, *f));
            (near && zeros).then(|| Place {
                row,
                column_tick: sensor.column_tick(row, i64::from(tick)),
                steps,
            })
        })
        .collect()
}
