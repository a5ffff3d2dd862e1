//! The scanner of a stream of scans: one of the families. FORMAT.md 3.1.

use std::borrow::Cow;
use std::fmt;

use super::firings::{self, Firings};
use super::hdl64::{self, Hdl64};
use super::motion::by_time;
use super::{Coordinates, MOST_STEPS, Projection, REACH, RangeImage, Return};
use crate::entropy::BitCoder;
use crate::ground::error::{Error, Result};
use crate::scan::{PointCloud, ScanFile, squared_distance};

/// A scanner: what turns integers (beam or laser, azimuth tick, range steps) into the coordinates of a file.
///
/// A family knows its formula, the order of its points in a file, how its columns are coded, and how to find its
/// constants from points alone. A new one is a folder, a variant here, and a line in each of the functions below.
#[derive(Clone, Debug, PartialEq)]
pub enum Scanner {
    /// Beam by beam, each by rising azimuth.
    Hdl64(Hdl64),
    /// Firing by firing.
    Firings(Firings),
}

/// The numbers of the families in the stream.
const HDL64: u64 = 1;
const FIRINGS: u64 = 2;

/// What the coder has learned about columns, whatever the family.
#[derive(Clone, Default)]
pub struct ColumnModels {
    hdl64: hdl64::ColumnModel,
    firings: firings::FiringColumnModel,
}

impl fmt::Display for Scanner {
    /// What was found of it, in the words of those who know scanners.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Scanner::Hdl64(scanner) => write!(
                f,
                "like Velodyne's HDL-64E, {} lasers, {:.3} degrees a firing, row by row",
                scanner.rows(),
                360.0 / f64::from(scanner.ticks),
            ),
            Scanner::Firings(scanner) => scanner.fmt(f),
        }
    }
}

impl Scanner {
    /// Fits a scanner to a sample of a stream's scans, as they were measured: of the families, that which explains
    /// most of the points. None if none explains enough of them.
    pub fn fit(sample: &[ScanFile]) -> Option<Scanner> {
        let beams = || hdl64::fit(sample).map(Scanner::Hdl64);
        let largest = sample.iter().max_by_key(|scan| scan.cloud.positions.len());
        // Seen at once, where it takes long to see that nothing else made the scans.
        let evident = largest.filter(|scan| hdl64::is_evident(&scan.cloud.positions)).and_then(|_| beams());
        if evident.is_some() {
            return evident;
        }
        // What the first explains is in the order of firings, which is in no other family's.
        let firings = firings::fit(sample)
            .map(|(scanner, _)| by_time::fit(sample, Some(&scanner)).unwrap_or(scanner))
            .or_else(|| by_time::fit(sample, None))
            .map(Scanner::Firings);
        firings.or_else(beams)
    }

    /// The share of the points of a scan that have a place in its range image.
    pub fn share(&self, cloud: &PointCloud) -> f64 {
        let image = self.project(cloud, REACH).image;
        let points = cloud.positions.iter().filter(|[x, y, _]| x.hypot(*y) > 0.0).count();
        (image.returns() + image.echoes.len()) as f64 / points.max(1) as f64
    }

    /// The family's number in the stream.
    pub fn family(&self) -> u64 {
        match self {
            Scanner::Hdl64(_) => HDL64,
            Scanner::Firings(_) => FIRINGS,
        }
    }

    /// The family's name in reports.
    #[cfg(any(test, feature = "internals"))]
    pub fn name(&self) -> &'static str {
        match self {
            Scanner::Hdl64(_) => "hdl64",
            Scanner::Firings(_) => "firings",
        }
    }

    /// The payload of the scanner's record.
    pub fn to_payload(&self) -> Vec<u8> {
        match self {
            Scanner::Hdl64(scanner) => scanner.to_payload(),
            Scanner::Firings(scanner) => scanner.to_payload(),
        }
    }

    /// Reads the payload of a record of this family; none if this program does not know the family.
    ///
    /// # Errors
    /// If the payload is cut short, too long, or holds what no scanner has.
    pub fn of_record(family: u64, mut payload: &[u8]) -> Result<Option<Scanner>> {
        let input = &mut payload;
        let scanner = match family {
            HDL64 => Scanner::Hdl64(Hdl64::read_from(input)?),
            FIRINGS => Scanner::Firings(Firings::read_from(input)?),
            _ => return Ok(None),
        };
        if !input.is_empty() {
            return Err(Error::corrupt("bytes left over"));
        }
        Ok(Some(scanner))
    }

    /// The scanner, if it is of this family: regions, registration and the references of P frames know no other.
    pub fn hdl64(&self) -> Option<&Hdl64> {
        match self {
            Scanner::Hdl64(scanner) => Some(scanner),
            Scanner::Firings(_) => None,
        }
    }

    /// A scanner of this family that sees a range image as this one does: for pictures and regions.
    pub fn likeness(&self) -> Cow<'_, Hdl64> {
        match self {
            Scanner::Hdl64(scanner) => Cow::Borrowed(scanner),
            Scanner::Firings(scanner) => Cow::Owned(scanner.likeness()),
        }
    }

    /// The scanner, if it is of this family.
    pub fn firings(&self) -> Option<&Firings> {
        match self {
            Scanner::Firings(scanner) => Some(scanner),
            Scanner::Hdl64(_) => None,
        }
    }

    /// Number of rows of the range image.
    pub fn rows(&self) -> usize {
        match self {
            Scanner::Hdl64(scanner) => scanner.rows(),
            Scanner::Firings(scanner) => scanner.rows(),
        }
    }

    /// The grid of the file's coordinates.
    pub fn coordinates(&self) -> Coordinates {
        match self {
            Scanner::Hdl64(scanner) => scanner.coordinates,
            Scanner::Firings(scanner) => scanner.build().coordinates,
        }
    }

    /// One range step, in metres; 0 if ranges are float32.
    pub fn range_step_m(&self) -> f64 {
        match self {
            Scanner::Hdl64(scanner) => scanner.range_step_m(),
            Scanner::Firings(scanner) => scanner.range_step_m(),
        }
    }

    /// The longest range that a range image of this scanner holds, in steps.
    pub fn most_steps(&self) -> u32 {
        match self {
            Scanner::Hdl64(scanner) => scanner.most_steps(),
            Scanner::Firings(_) => MOST_STEPS,
        }
    }

    /// A range of `steps`, in metres.
    pub fn metres(&self, steps: u32) -> f64 {
        match self {
            Scanner::Hdl64(scanner) => scanner.metres(steps),
            Scanner::Firings(scanner) => f64::from(steps) * scanner.range_step_m(),
        }
    }

    /// The same scanner, its ranges rounded to other steps, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        match self {
            Scanner::Hdl64(scanner) => Scanner::Hdl64(scanner.with_range_step(range_step_um)),
            Scanner::Firings(scanner) => Scanner::Firings(scanner.with_range_step(range_step_um)),
        }
    }

    /// Projects a scan into a range image that loses nothing. Points that the formula misses by more than `reach`
    /// metres along an axis, besides half a range step, are strays.
    pub fn project(&self, cloud: &PointCloud, reach: f64) -> Projection {
        match self {
            Scanner::Hdl64(scanner) => hdl64::project(scanner, cloud, reach),
            Scanner::Firings(scanner) => scanner.project(cloud, reach),
        }
    }

    /// How far the formula misses the points of the image, in metres.
    pub fn misses(&self, projection: &Projection, cloud: &PointCloud) -> Vec<f64> {
        match self {
            Scanner::Hdl64(scanner) => projection.misses(scanner, cloud),
            Scanner::Firings(scanner) => {
                let miss = |found: &Return| {
                    let point = projection.point_of_cell[(found.row as usize, found.column as usize)];
                    let formula = scanner.position(found, 0.0).map(|metres| metres as f32);
                    squared_distance(&formula, &cloud.positions[point as usize]).sqrt()
                };
                let records = scanner.file_order(&projection.image);
                records.iter().filter(|found| found.steps > 0 && found.echo == 0).map(miss).collect()
            }
        }
    }

    /// Codes which columns the range image has.
    ///
    /// # Errors
    /// If there are more than `most`, or they are none that this scanner can have.
    pub fn code_columns<C: BitCoder>(
        &self,
        models: &mut ColumnModels,
        coder: &mut C,
        image: &mut RangeImage,
        most: u64,
    ) -> Result<()> {
        match self {
            Scanner::Hdl64(scanner) => {
                models.hdl64.code(coder, scanner.ticks, &mut image.columns);
                Ok(())
            }
            Scanner::Firings(scanner) => models.firings.code(coder, scanner, image, most),
        }
    }

    /// The returns of an image in the order in which a file holds them.
    pub fn file_order(&self, image: &RangeImage) -> Vec<Return> {
        match self {
            Scanner::Hdl64(scanner) => image.file_order(scanner),
            Scanner::Firings(scanner) => scanner.file_order(image),
        }
    }

    /// Where a return is by the formula, in metres, `offset_m` metres farther than its steps say: what a coordinate
    /// of the file rounds or corrects.
    pub fn position(&self, found: &Return, offset_m: f64) -> [f64; 3] {
        match self {
            Scanner::Hdl64(scanner) => {
                scanner.position_at(found.row as usize, found.tick, scanner.metres(found.steps) + offset_m)
            }
            Scanner::Firings(scanner) => scanner.position(found, offset_m),
        }
    }

    /// As [`position`](Self::position), of many returns, as float32: as the file's grid has them if they are
    /// `on_grid`.
    pub fn positions(&self, returns: &[Return], offset_m: f64, on_grid: bool) -> Vec<[f32; 3]> {
        match self {
            Scanner::Hdl64(scanner) => hdl64::positions(scanner, returns, offset_m, on_grid),
            Scanner::Firings(scanner) => {
                let grid = if on_grid { scanner.build().coordinates } else { Coordinates::Float32 };
                scanner.positions(returns, offset_m, grid)
            }
        }
    }

    /// As [`position`](Self::position), as float32.
    pub fn single_position(&self, found: &Return) -> [f32; 3] {
        self.position(found, 0.0).map(|metres| if metres.is_nan() { 0.0 } else { metres as f32 })
    }
}
