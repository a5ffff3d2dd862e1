//! The scanner of a stream of scans: one of the families. FORMAT.md 3.1.

use std::borrow::Cow;
use std::fmt;

use super::firings::{self, Firings};
use super::hdl64::{self, Hdl64};
use super::motion::by_time;
use super::{CoordinateGrid, MOST_STEPS, Orientation, Projection, REACH, RangeImage, Return};
use crate::entropy::BitCoder;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};
use crate::scan::{PointCloud, ScanFile, fullest, squared_distance};

/// A scanner: the model that turns integers (beam or laser, azimuth tick, range steps) into the coordinates
/// of a file, along its own axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Scanner {
    family: Family,
    orientation: Orientation,
}

/// A family defines the formula, the order of points in a file, the coding of columns, and how constants are
/// estimated from points alone. A new family is a folder, a variant here, and a line in each of the functions
/// below. What only one family has, others ask for by [`Scanner::hdl64`] and [`Scanner::firings`].
#[derive(Clone, Debug, PartialEq)]
pub enum Family {
    /// Beam by beam, each in ascending order of azimuth.
    Hdl64(Hdl64),
    /// Firing by firing.
    Firings(Firings),
}

/// The numbers of the families in the stream.
const HDL64: u64 = 1;
const FIRINGS: u64 = 2;

/// Minimum share of a scan that its own scanner explains.
pub const LEAST_EXPLAINED: f64 = 0.5;

/// The adaptive models of columns, whatever the family.
#[derive(Clone, Default)]
pub struct ColumnModels {
    hdl64: hdl64::Hdl64ColumnModel,
    firings: firings::FiringColumnModel,
}

impl fmt::Display for Scanner {
    /// The scanner's properties in users' terms.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.family {
            Family::Hdl64(scanner) => write!(
                f,
                "like Velodyne's HDL-64E, {} lasers, {:.3} degrees a firing, row by row",
                scanner.rows(),
                360.0 / f64::from(scanner.ticks),
            )?,
            Family::Firings(scanner) => scanner.fmt(f)?,
        }
        if self.orientation.is_default() { Ok(()) } else { write!(f, ", with axes {}", self.orientation) }
    }
}

impl From<Family> for Scanner {
    /// The scanner of a file with the scanner's axes.
    fn from(family: Family) -> Self {
        Scanner { family, orientation: Orientation::default() }
    }
}

impl From<Hdl64> for Scanner {
    fn from(scanner: Hdl64) -> Self {
        Family::Hdl64(scanner).into()
    }
}

impl From<Firings> for Scanner {
    fn from(scanner: Firings) -> Self {
        Family::Firings(scanner).into()
    }
}

impl Scanner {
    /// Fits a scanner to a sample of a stream's scans, as they were measured: of the families, the one that
    /// explains most of the points. None if none explains enough of them.
    pub fn fit(sample: &[ScanFile]) -> Option<Scanner> {
        Self::of_sample(sample).filter(Self::can_be_read)
    }

    /// Whether a decoder accepts the scanner's record. One that was fitted to values that no scanner measures
    /// may have constants beyond all limits.
    fn can_be_read(&self) -> bool {
        Self::from_record(self.family_number(), &self.to_payload()).is_ok()
    }

    fn of_sample(sample: &[ScanFile]) -> Option<Scanner> {
        /// Minimum share of the points that a recipe reproduces only along the axes of the scanner.
        const RIGHT_AXES: f64 = 0.75;
        let beams = || hdl64::fit(sample).map(Scanner::from);
        let fullest = fullest(sample)?;
        let positions = &fullest.cloud.positions;
        // An evident HDL-64E is recognised quickly, whereas ruling out all other scanners takes long.
        let evident = if hdl64::is_evident(positions) { beams() } else { None };
        if evident.is_some() {
            return evident;
        }
        // If `firings` explains the scans, they are in firing order, which no other family has.
        let found = firings::fit(sample);
        let exact = found.as_ref().map_or(0.0, |scanner| scanner.reproduced_share(positions));
        if let Some(found) = found.as_ref().filter(|scanner| scanner.reproduces_most(positions)) {
            return Some(found.clone().into());
        }
        // Along wrong axes, a recipe does not reproduce as many.
        let turned = match exact < RIGHT_AXES {
            true => Self::with_other_axes(sample, fullest, found.as_ref()),
            false => None,
        };
        if let Some((turned, _)) = turned.as_ref().filter(|(_, reproduces_most)| *reproduces_most) {
            return Some(turned.clone());
        }
        // Half of what is missed must be worth a motion.
        let is_better =
            |scanner: &Firings| found.is_none() || scanner.reproduced_share(positions) > 0.5 * (1.0 + exact);
        let moved = by_time::fit(sample, found.as_ref());
        // Rounding hides how much the frame is turned around the axis of the scanner that was found.
        let may_be_mounted = found.is_none() || !CoordinateGrid::are_rounded(positions);
        let mounted = || may_be_mounted.then(|| firings::fit_mounted(sample))?.filter(is_better);
        let firings = moved.or_else(mounted).or(found).map(Scanner::from);
        firings.or_else(beams).or(turned.map(|(scanner, _)| scanner))
    }

    /// A scanner of firings for a sample whose files have other axes than it has, and whether it reproduces
    /// most of the fullest scan: the first that does or, unless there is one along the axes of the files, the
    /// first one. `along_files`: that one, which does not reproduce most points.
    fn with_other_axes(
        sample: &[ScanFile],
        fullest: &ScanFile,
        along_files: Option<&Firings>,
    ) -> Option<(Scanner, bool)> {
        /// Number of failed fits after which the other three or four orientations with the same axis up are
        /// tried: which axis is ahead matters to roundings, by which few scanners are found.
        const MAY_FAIL: [usize; 2] = [4, 0];
        /// Minimum share of the points that one of the recipes reproduces along the right axes, though constants
        /// were fitted along others.
        const LEAST: f64 = 0.3;
        let mut first = None;
        let by_recipes = along_files.and_then(Firings::as_written_by_all_recipes);
        let may_fit = |positions: &[[f32; 3]]| {
            let reproduces = |scanner: &Firings| scanner.reproduced_share(positions) > LEAST;
            by_recipes.as_ref().is_none_or(|scanners| scanners.iter().any(reproduces))
        };
        let fit = |sample: &[ScanFile], orientation: Orientation| {
            let turned = |scan: &ScanFile| {
                let mut turned = scan.clone();
                orientation.turn_to_scanner(&mut turned.cloud.positions);
                turned
            };
            firings::fit(&sample.iter().map(turned).collect::<Vec<_>>())
        };
        for (four, may_fail) in Orientation::of_firings(&fullest.cloud.positions).into_iter().zip(MAY_FAIL) {
            // Roundings tell which of the four it is, if one of them fits.
            if along_files.is_some() && !four.contains(&Orientation::default()) {
                continue;
            }
            let mut failed = 0;
            for orientation in four.into_iter().filter(|orientation| !orientation.is_default()) {
                let mut positions = fullest.cloud.positions.clone();
                orientation.turn_to_scanner(&mut positions);
                if !may_fit(&positions) {
                    continue;
                }
                let Some(found) = fit(std::slice::from_ref(fullest), orientation) else {
                    failed += 1;
                    if failed > may_fail {
                        break;
                    }
                    continue;
                };
                let reproduces_most = found.reproduces_most(&positions);
                let found = match reproduces_most && sample.len() > 1 {
                    true => fit(sample, orientation).unwrap_or(found),
                    false => found,
                };
                let found = Scanner::from(found).oriented(orientation);
                if reproduces_most {
                    return Some((found, true));
                }
                first = first.or(along_files.is_none().then_some(found));
            }
        }
        first.map(|first| (first, false))
    }

    /// This scanner for files with these axes.
    pub fn oriented(self, orientation: Orientation) -> Self {
        Scanner { orientation, ..self }
    }

    /// The axes of the files. All else here, and all clouds that its functions take and return, have the axes
    /// of the scanner.
    pub fn orientation(&self) -> Orientation {
        self.orientation
    }

    /// The points of a file along the axes of the scanner.
    pub fn along_axes<'c>(&self, cloud: &'c PointCloud) -> Cow<'c, PointCloud> {
        if self.orientation.is_default() {
            return Cow::Borrowed(cloud);
        }
        let mut turned = cloud.clone();
        self.orientation.turn_to_scanner(&mut turned.positions);
        Cow::Owned(turned)
    }

    /// The share of a scan's points that are in its range image; of many points by an HDL-64E, of those in
    /// the middle.
    pub fn explained_share(&self, cloud: &PointCloud) -> f64 {
        /// A sufficient number of points: at least ten beams.
        const MANY: usize = 25_000;
        let positions = &cloud.positions;
        let middle = match &self.family {
            Family::Hdl64(_) if positions.len() > MANY => {
                let start = (positions.len() - MANY) / 2;
                Cow::Owned(PointCloud {
                    positions: positions[start..start + MANY].to_vec(),
                    ..PointCloud::default()
                })
            }
            _ => Cow::Borrowed(cloud),
        };
        let image = self.project(&middle, REACH).image;
        let is_off_axis = |[x, y, _]: &&[f32; 3]| (*x != 0.0 || *y != 0.0) && !(x.is_nan() || y.is_nan());
        let points = middle.positions.iter().filter(is_off_axis).count();
        (image.returns() + image.echoes.len()) as f64 / points.max(1) as f64
    }

    /// The family's number in the stream.
    pub fn family_number(&self) -> u64 {
        match &self.family {
            Family::Hdl64(_) => HDL64,
            Family::Firings(_) => FIRINGS,
        }
    }

    /// The family's name in reports.
    #[cfg(any(test, feature = "internals"))]
    pub fn name(&self) -> &'static str {
        match &self.family {
            Family::Hdl64(_) => "hdl64",
            Family::Firings(_) => "firings",
        }
    }

    /// The payload of the scanner's record.
    pub fn to_payload(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        write_unsigned(&mut payload, self.orientation.number());
        payload.extend(match &self.family {
            Family::Hdl64(scanner) => scanner.to_payload(),
            Family::Firings(scanner) => scanner.to_payload(),
        });
        payload
    }

    /// Reads the payload of a record of this family; none if this program does not know the family.
    ///
    /// # Errors
    /// If the payload is cut short, too long, or holds values that no scanner has.
    pub fn from_record(family: u64, mut payload: &[u8]) -> Result<Option<Scanner>> {
        let input = &mut payload;
        if !matches!(family, HDL64 | FIRINGS) {
            return Ok(None);
        }
        let orientation = Orientation::from_number(read_unsigned(input, "scanner: orientation")?)?;
        let family = match family {
            HDL64 => Family::Hdl64(Hdl64::read_from(input)?),
            _ => Family::Firings(Firings::read_from(input)?),
        };
        if !input.is_empty() {
            return Err(Error::corrupt("bytes left over"));
        }
        Ok(Some(Scanner { family, orientation }))
    }

    /// The family, with its constants.
    pub fn family(&self) -> &Family {
        &self.family
    }

    /// The scanner, if it is of this family: regions, registration and references of P frames support no
    /// other.
    pub fn hdl64(&self) -> Option<&Hdl64> {
        match &self.family {
            Family::Hdl64(scanner) => Some(scanner),
            Family::Firings(_) => None,
        }
    }

    /// A scanner of the HDL-64E family with about the same rows and columns: for pictures and regions.
    pub fn likeness(&self) -> Cow<'_, Hdl64> {
        match &self.family {
            Family::Hdl64(scanner) => Cow::Borrowed(scanner),
            Family::Firings(scanner) => Cow::Owned(scanner.likeness()),
        }
    }

    /// Whether its family knows the arithmetic of programs, which reproduces points to the last bit.
    pub fn has_recipe(&self) -> bool {
        self.firings().is_some()
    }

    /// The share of a sample of a cloud's points, along the scanner's axes, that its recipe reproduces to the
    /// last bit; `None` if it has no recipe.
    pub fn reproduced_share(&self, cloud: &PointCloud) -> Option<f64> {
        self.firings().map(|own| own.reproduced_share(&cloud.positions))
    }

    /// How well it explains a cloud along its axes: the share of the points in its range image, plus the share that
    /// its recipe reproduces. Units of the same model see about the same, but only one of them to the last bit.
    pub fn score(&self, cloud: &PointCloud) -> f64 {
        self.explained_share(cloud) + self.reproduced_share(cloud).unwrap_or(0.0)
    }

    /// Whether its recipe reproduces most of one of these scans to the last bit.
    pub fn reproduces_any<'s>(&self, scans: impl IntoIterator<Item = &'s ScanFile>) -> bool {
        let is_own =
            |own: &Firings, scan: &ScanFile| own.reproduces_most(&self.along_axes(&scan.cloud).positions);
        self.firings().is_some_and(|own| scans.into_iter().any(|scan| is_own(own, scan)))
    }

    /// Whether it has measured a scan. `reproduces`: it reproduces others of the folder to the last bit.
    pub fn has_measured(&self, scan: &ScanFile, reproduces: bool) -> bool {
        let cloud = &self.along_axes(&scan.cloud);
        // Units of the same model see about the same, but only one of them to the last bit.
        let reproduced = reproduces.then(|| self.reproduced_share(cloud)).flatten().unwrap_or(1.0);
        // A scan that was moved by time stamps can be attributed to this scanner only after it is moved back.
        let is_moved = || self.firings().is_some_and(|own| by_time::undo(cloud, own).is_some());
        let is_seen = || reproduced.min(self.explained_share(cloud)) >= LEAST_EXPLAINED;
        cloud.positions.is_empty() || is_seen() || is_moved()
    }

    /// The scanner, if it is of this family.
    pub fn firings(&self) -> Option<&Firings> {
        match &self.family {
            Family::Firings(scanner) => Some(scanner),
            Family::Hdl64(_) => None,
        }
    }

    /// Number of rows of the range image.
    pub fn rows(&self) -> usize {
        match &self.family {
            Family::Hdl64(scanner) => scanner.rows(),
            Family::Firings(scanner) => scanner.rows(),
        }
    }

    /// The grid of the file's coordinates.
    pub fn coordinates(&self) -> CoordinateGrid {
        match &self.family {
            Family::Hdl64(scanner) => scanner.coordinates,
            Family::Firings(scanner) => scanner.build().coordinates,
        }
    }

    /// One range step, in metres; 0 if ranges are float32.
    pub fn range_step_m(&self) -> f64 {
        match &self.family {
            Family::Hdl64(scanner) => scanner.range_step_m(),
            Family::Firings(scanner) => scanner.range_step_m(),
        }
    }

    /// The longest range in a range image of this scanner, in steps.
    pub fn most_steps(&self) -> u32 {
        match &self.family {
            Family::Hdl64(scanner) => scanner.most_steps(),
            Family::Firings(_) => MOST_STEPS,
        }
    }

    /// A range of `steps`, in metres.
    pub fn metres(&self, steps: u32) -> f64 {
        match &self.family {
            Family::Hdl64(scanner) => scanner.metres(steps),
            Family::Firings(scanner) => f64::from(steps) * scanner.range_step_m(),
        }
    }

    /// This scanner with another range step, in micrometres.
    pub fn with_range_step(self, range_step_um: u32) -> Self {
        let family = match self.family {
            Family::Hdl64(scanner) => Family::Hdl64(scanner.with_range_step(range_step_um)),
            Family::Firings(scanner) => Family::Firings(scanner.with_range_step(range_step_um)),
        };
        Scanner { family, ..self }
    }

    /// Projects a scan into a lossless range image. Points that deviate from the formula by more than `reach`
    /// metres along an axis, plus half a range step, are strays.
    pub fn project(&self, cloud: &PointCloud, reach: f64) -> Projection {
        match &self.family {
            Family::Hdl64(scanner) => hdl64::project(scanner, cloud, reach),
            Family::Firings(scanner) => scanner.project(cloud, reach),
        }
    }

    /// The deviations of the image's points from the formula, in metres.
    pub fn misses(&self, projection: &Projection, cloud: &PointCloud) -> Vec<f64> {
        match &self.family {
            Family::Hdl64(scanner) => scanner.misses(projection, cloud),
            Family::Firings(scanner) => {
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

    /// Codes the columns of the range image.
    ///
    /// # Errors
    /// If there are more than `most`, or if this scanner cannot have them.
    pub fn code_columns<C: BitCoder>(
        &self,
        models: &mut ColumnModels,
        coder: &mut C,
        image: &mut RangeImage,
        most: u64,
    ) -> Result<()> {
        match &self.family {
            Family::Hdl64(scanner) => {
                models.hdl64.code(coder, scanner.ticks, &mut image.columns);
                Ok(())
            }
            Family::Firings(scanner) => models.firings.code(coder, scanner, image, most),
        }
    }

    /// The returns of an image in the order of the file.
    pub fn file_order(&self, image: &RangeImage) -> Vec<Return> {
        match &self.family {
            Family::Hdl64(scanner) => image.file_order(scanner),
            Family::Firings(scanner) => scanner.file_order(image),
        }
    }

    /// The position of a return by the formula, in metres, at a range `offset_m` metres longer than its
    /// steps. It is what a coordinate of the file rounds or corrects.
    pub fn position(&self, found: &Return, offset_m: f64) -> [f64; 3] {
        match &self.family {
            Family::Hdl64(scanner) => {
                scanner.position_at(found.row as usize, found.tick, scanner.metres(found.steps) + offset_m)
            }
            Family::Firings(scanner) => scanner.position(found, offset_m),
        }
    }

    /// As [`position`](Self::position), for many returns, as float32; rounded to the file's grid if
    /// `on_grid`.
    pub fn positions(&self, returns: &[Return], offset_m: f64, on_grid: bool) -> Vec<[f32; 3]> {
        match &self.family {
            Family::Hdl64(scanner) => hdl64::positions(scanner, returns, offset_m, on_grid),
            Family::Firings(scanner) => {
                let grid = if on_grid { scanner.build().coordinates } else { CoordinateGrid::Float32 };
                scanner.positions(returns, offset_m, grid)
            }
        }
    }
}
