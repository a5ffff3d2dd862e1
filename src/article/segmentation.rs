//! Ground and objects in a range image (article, IV-B), after I. Bogoslavskyi and C. Stachniss, "Fast Range
//! Image-Based Segmentation of Sparse 3D Laser Scans for Online Operation" (2016) and "Efficient Online
//! Segmentation for Sparse 3D Laser Scans" (2017). The time depends only on the number of pixels. Only the
//! encoder needs this.
//!
//! The file holds the settings and the whole, then the next return in each direction and the angles between
//! returns, which both steps use, and then these: removal of the ground and clustering of objects.

use std::f64::consts::TAU;
use std::iter::successors;

use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::scanner::hdl64::{Alignment, Hdl64};

/// The criteria for ground and for objects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentationConfig {
    /// Two returns one above the other are ground if the slope of the line between them is smaller than this,
    /// in degrees (equation 3). Default: the article's 10.
    pub ground_angle: f64,
    /// They are not ground if the line rises by more than this, in metres: far from the scanner, the angle
    /// alone would lead from the ground behind an object to its top. Default: 0.4.
    pub ground_rise_m: f64,
    /// The two may be up to three returns apart if their horizontal distance is smaller than this, in metres.
    /// Near the scanner the rows on the ground are close together, and the elevation of an ideal beam is off
    /// by a quarter of a degree, which is too much for an angle between neighbours. Default: 2.
    pub ground_reach_m: f64,
    /// Two neighbours belong to one object if the angle between the longer beam and the line between them is
    /// larger than this, in degrees (equation 4). Default: 10, not the article's 75.
    ///
    /// The article states 75 degrees for the angle for which the method's authors state 10. At 75 degrees,
    /// neighbours 0.18 degrees apart at 10 m may differ by 8 mm in range, less than the scanner's noise, and
    /// any surface that is not seen perpendicularly falls apart into pixels: of the returns above the ground,
    /// 97 % (city drive) and 98 % (road) then belong to no object of 20 returns, compared to 9 % and 5 % at
    /// 10 degrees.
    pub cluster_angle: f64,
    /// Clusters with fewer returns are not objects. Default: 20.
    pub smallest_cluster: usize,
}

impl Default for SegmentationConfig {
    fn default() -> Self {
        SegmentationConfig {
            ground_angle: 10.0,
            ground_rise_m: 0.4,
            ground_reach_m: 2.0,
            cluster_angle: 10.0,
            smallest_cluster: 20,
        }
    }
}

impl SegmentationConfig {
    /// Checks that all settings are in range.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] names the setting that is not.
    pub fn check(&self) -> Result<()> {
        let angles = [("the ground angle", self.ground_angle), ("the cluster angle", self.cluster_angle)];
        for (name, degrees) in angles {
            if !(0.0..=90.0).contains(&degrees) {
                return Err(Error::InvalidSettings(format!("{name} is from 0 to 90 degrees")));
            }
        }
        let lengths = [("the ground rise", self.ground_rise_m), ("the ground reach", self.ground_reach_m)];
        match lengths.iter().find(|(_, metres)| !(*metres >= 0.0 && metres.is_finite())) {
            Some((name, _)) => {
                Err(Error::InvalidSettings(format!("{name} is a length in metres, 0 or more")))
            }
            None => Ok(()),
        }
    }
}

/// The region of each return.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Segmentation {
    /// Rows x columns: [`NO_RETURN`], [`UNASSIGNED`], [`GROUND`], or the number of an object, from
    /// [`FIRST_OBJECT`] on.
    pub labels: Grid<u32>,
    /// All labels are below this.
    pub end: u32,
}

/// The label of cells without a return.
const NO_RETURN: u32 = 0;
/// The label of returns that belong to no object.
pub const UNASSIGNED: u32 = 1;
/// The label of the ground.
pub const GROUND: u32 = 2;
/// The label of the first object.
pub const FIRST_OBJECT: u32 = 3;

/// Divides the returns of an image into ground, objects and the rest.
///
/// `steps` are the ranges (rows x columns, 0 = no return), `columns` the column ticks.
pub fn segment(
    steps: &Grid<u32>,
    columns: &[u32],
    scanner: &Hdl64,
    config: &SegmentationConfig,
) -> Segmentation {
    let alignment = Alignment::of(scanner, columns.len());
    let scene = Scene::of(steps, columns, scanner, &alignment);
    let neighbours = Neighbours::of(&scene.ranges);
    let mut labels = Grid::new(steps.rows(), steps.columns());
    mark_ground(&scene, &neighbours, config, &mut labels);
    let end = mark_objects(&scene, &neighbours, config, &mut labels);
    alignment.restore(&mut labels);
    Segmentation { labels, end }
}

/// The tangent of an angle in degrees, so that angles can be compared without an arc tangent.
fn tangent(degrees: f64) -> f32 {
    libm::tan(degrees.to_radians()) as f32
}

/// A cell, row and column.
type Cell = (usize, usize);

/// Returns in a row are neighbours if they are at most this many columns apart.
const ROW_REACH: usize = 4;
/// Returns in a column are neighbours if they are at most this many rows apart. Some beams have few returns,
/// and the ideal image has rows that no real beam measures.
const COLUMN_REACH: usize = 10;

/// The number of cells to the next return on each side; 0 = none within reach.
#[derive(Clone, Copy, Default)]
struct Distances {
    left: u8,
    right: u8,
    above: u8,
    below: u8,
}

/// Finds the returns around a cell. The image wraps around from its last column to its first.
struct Neighbours {
    distances: Grid<Distances>,
}

impl Neighbours {
    /// The neighbours in an image of ranges, 0 = no return.
    fn of(ranges: &Grid<f32>) -> Self {
        let mut neighbours = Neighbours { distances: Grid::new(ranges.rows(), ranges.columns()) };
        // For each column, the row of the last return so far.
        let mut last_rows = vec![None; ranges.columns()];
        for row in 0..ranges.rows() {
            neighbours.link_row(row, ranges.row(row));
            neighbours.link_columns(row, ranges.row(row), &mut last_rows);
        }
        neighbours
    }

    fn link_row(&mut self, row: usize, ranges: &[f32]) {
        let columns = ranges.len();
        // Columns continue from the end of the preceding turn, so that the end of a row meets its beginning.
        let mut last = ranges.iter().rposition(|&range| range > 0.0).unwrap_or(0);
        for column in (0..columns).filter(|&column| ranges[column] > 0.0) {
            let distance = column + columns - last;
            if distance <= ROW_REACH && distance < columns {
                self.distances[(row, column)].left = distance as u8;
                self.distances[(row, last % columns)].right = distance as u8;
            }
            last = column + columns;
        }
    }

    fn link_columns(&mut self, row: usize, ranges: &[f32], last_rows: &mut [Option<usize>]) {
        for column in (0..ranges.len()).filter(|&column| ranges[column] > 0.0) {
            if let Some(last) = last_rows[column].replace(row)
                && row - last <= COLUMN_REACH
            {
                self.distances[(row, column)].above = (row - last) as u8;
                self.distances[(last, column)].below = (row - last) as u8;
            }
        }
    }

    /// The nearest returns to the left and to the right.
    fn beside(&self, (row, column): Cell) -> impl Iterator<Item = Cell> + use<> {
        let columns = self.distances.columns();
        let Distances { left, right, .. } = self.distances[(row, column)];
        let left = (left > 0).then(|| (row, (column + columns - usize::from(left)) % columns));
        let right = (right > 0).then(|| (row, (column + usize::from(right)) % columns));
        left.into_iter().chain(right)
    }

    /// The returns above, beginning with the nearest.
    fn above(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let next = |&(row, column): &Cell| match usize::from(self.distances[(row, column)].above) {
            0 => None,
            distance => Some((row - distance, column)),
        };
        successors(next(&cell), next)
    }

    /// The returns below, beginning with the nearest.
    fn below(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let next = |&(row, column): &Cell| match usize::from(self.distances[(row, column)].below) {
            0 => None,
            distance => Some((row + distance, column)),
        };
        successors(next(&cell), next)
    }
}

/// The direction of a beam.
struct Beam {
    /// Cosine and sine of its elevation.
    cos: f32,
    sin: f32,
    /// Height of its origin above the scanner's centre, in metres.
    height: f32,
    /// The column of the image that corresponds to its first aligned column.
    turn: usize,
}

/// The returns of an image with aligned columns.
struct Scene {
    /// Rows x columns, metres; 0 = no return.
    ranges: Grid<f32>,
    beams: Vec<Beam>,
    /// Azimuth of each column of the image, in radians, for two turns.
    azimuths: Vec<f32>,
}

impl Scene {
    /// The scene of an image, given its ranges in steps and its column ticks.
    fn of(steps: &Grid<u32>, columns: &[u32], scanner: &Hdl64, alignment: &Alignment) -> Self {
        let mut ranges = Grid::new(steps.rows(), steps.columns());
        for row in 0..ranges.rows() {
            for (range, &steps) in ranges.row_mut(row).iter_mut().zip(steps.row(row)) {
                *range = scanner.metres(steps) as f32;
            }
        }
        alignment.align(&mut ranges);
        let beam = |row| {
            let elevation = scanner.elevation(row);
            Beam {
                cos: libm::cos(elevation) as f32,
                sin: libm::sin(elevation) as f32,
                height: scanner.height(row) as f32,
                turn: alignment.turn(row),
            }
        };
        let tick = TAU / f64::from(scanner.ticks);
        let azimuth = |column: &u32| (f64::from(*column) * tick) as f32;
        Scene {
            ranges,
            beams: (0..scanner.rows()).map(beam).collect(),
            azimuths: columns.iter().chain(columns).map(azimuth).collect(),
        }
    }

    /// Whether a cell holds a return.
    fn is_return(&self, cell: Cell) -> bool {
        self.ranges[cell] > 0.0
    }

    /// How far the line between two returns of a row or a column rises, and the square of its horizontal
    /// length, in metres (delta z and the square of delta x of equation 3).
    fn rise_and_run(&self, a: Cell, b: Cell) -> (f32, f32) {
        let ((rho_a, z_a), (rho_b, z_b)) = (self.place(a), self.place(b));
        let across = if a.0 == b.0 { self.turn(a, b) * rho_a.min(rho_b) } else { 0.0 };
        ((z_a - z_b).abs(), (rho_a - rho_b) * (rho_a - rho_b) + across * across)
    }

    /// Equation 4: whether the angle between the longer beam and the line to the end of the shorter one is
    /// larger than the angle with this tangent.
    fn is_one_surface(&self, a: Cell, b: Cell, tangent: f32) -> bool {
        let between = if a.0 == b.0 { self.turn(a, b) } else { self.tilt(a.0, b.0) };
        let (near, far) = (self.ranges[a].min(self.ranges[b]), self.ranges[a].max(self.ranges[b]));
        // For angles of a few degrees; accurate to a thousandth.
        let (sin, cos) = (between, 1.0 - 0.5 * between * between);
        near * sin > tangent * (far - near * cos)
    }

    /// Distance from the scanner's axis, and height, in metres.
    fn place(&self, cell: Cell) -> (f32, f32) {
        let (beam, range) = (&self.beams[cell.0], self.ranges[cell]);
        (range * beam.cos, range * beam.sin + beam.height)
    }

    /// The angle between two columns of a row, in radians.
    fn turn(&self, (row, a): Cell, (_, b): Cell) -> f32 {
        let turn = self.beams[row].turn;
        let apart = (self.azimuths[turn + a] - self.azimuths[turn + b]).abs();
        apart.min(TAU as f32 - apart)
    }

    /// The angle between two rows, in radians.
    fn tilt(&self, a: usize, b: usize) -> f32 {
        let (a, b) = (&self.beams[a], &self.beams[b]);
        (a.sin * b.cos - a.cos * b.sin).abs()
    }
}

/// Number of returns above and below to which lines are drawn.
const HOPS: usize = 3;

/// Marks the ground, growing it from the lowest return of each column along flat lines. Returns that are flat
/// but not connected, such as a roof, are not ground.
fn mark_ground(scene: &Scene, neighbours: &Neighbours, config: &SegmentationConfig, labels: &mut Grid<u32>) {
    let lines = Lines::new(scene, neighbours, config);
    let mut open = Vec::new();
    for column in 0..labels.columns() {
        let lowest = (0..labels.rows()).rev().map(|row| (row, column)).find(|&cell| scene.is_return(cell));
        open.extend(lowest.filter(|&cell| lines.lies(cell)));
    }
    open.iter().for_each(|&cell| labels[cell] = GROUND);
    while let Some(cell) = open.pop() {
        for next in lines.flat_in_column(cell) {
            if labels[next] == NO_RETURN {
                labels[next] = GROUND;
                open.push(next);
            }
        }
        for next in lines.flat_in_row(cell) {
            if labels[next] == NO_RETURN && lines.lies(next) {
                labels[next] = GROUND;
                open.push(next);
            }
        }
    }
}

/// Decides which lines between returns may be ground.
struct Lines<'a> {
    scene: &'a Scene,
    neighbours: &'a Neighbours,
    square_tangent: f32,
    most_rise: f32,
    square_reach: f32,
    surface_tangent: f32,
}

impl<'a> Lines<'a> {
    fn new(scene: &'a Scene, neighbours: &'a Neighbours, config: &SegmentationConfig) -> Self {
        let steepest = tangent(config.ground_angle);
        Lines {
            scene,
            neighbours,
            square_tangent: steepest * steepest,
            most_rise: config.ground_rise_m as f32,
            square_reach: (config.ground_reach_m * config.ground_reach_m) as f32,
            surface_tangent: tangent(config.cluster_angle),
        }
    }

    /// The returns above and below that a flat line connects. Beyond the next return the line must be short.
    fn flat_in_column(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let above = self.neighbours.above(cell).take(HOPS).enumerate();
        let below = self.neighbours.below(cell).take(HOPS).enumerate();
        let is_flat = move |&(hop, other): &(usize, Cell)| {
            let (rise, square_run) = self.scene.rise_and_run(cell, other);
            self.is_flat(rise, square_run) && (hop == 0 || square_run < self.square_reach)
        };
        above.chain(below).filter(is_flat).map(|(_, other)| other)
    }

    /// The returns to the left and right that a flat line connects. Seen from the side, the edge of a roof is
    /// almost level with the ground far behind it, so both must also be on one surface.
    fn flat_in_row(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        self.neighbours.beside(cell).filter(move |&other| {
            let (rise, square_run) = self.scene.rise_and_run(cell, other);
            self.is_flat(rise, square_run) && self.scene.is_one_surface(cell, other, self.surface_tangent)
        })
    }

    /// Whether a flat line leads up or down. A wall is level from column to column too; only this
    /// distinguishes it from the ground.
    fn lies(&self, cell: Cell) -> bool {
        self.flat_in_column(cell).next().is_some()
    }

    /// Equation 3.
    fn is_flat(&self, rise: f32, square_run: f32) -> bool {
        rise < self.most_rise && rise * rise < self.square_tangent * square_run
    }
}

/// Returns in a column are compared only if they are at most this many rows apart.
const CLUSTER_REACH: usize = 3;

/// Labels all unlabelled returns. Returns the end of the labels.
fn mark_objects(
    scene: &Scene,
    neighbours: &Neighbours,
    config: &SegmentationConfig,
    labels: &mut Grid<u32>,
) -> u32 {
    let surfaces = Surfaces { scene, neighbours, tangent: tangent(config.cluster_angle) };
    let mut end = FIRST_OBJECT;
    let mut cluster = Vec::new();
    for row in 0..labels.rows() {
        for column in 0..labels.columns() {
            let seed = (row, column);
            if labels[seed] != NO_RETURN || !scene.is_return(seed) {
                continue;
            }
            surfaces.fill(seed, end, labels, &mut cluster);
            if cluster.len() < config.smallest_cluster {
                cluster.iter().for_each(|&cell| labels[cell] = UNASSIGNED);
            } else {
                end += 1;
            }
        }
    }
    end
}

/// Decides which neighbours are on a common surface.
struct Surfaces<'a> {
    scene: &'a Scene,
    neighbours: &'a Neighbours,
    tangent: f32,
}

impl Surfaces<'_> {
    /// Labels everything connected with a return, breadth first; `cluster` then holds the labelled returns.
    fn fill(&self, seed: Cell, label: u32, labels: &mut Grid<u32>, cluster: &mut Vec<Cell>) {
        labels[seed] = label;
        cluster.clear();
        cluster.push(seed);
        let mut next = 0;
        while let Some(&cell) = cluster.get(next) {
            next += 1;
            for other in self.around(cell) {
                if labels[other] == NO_RETURN && self.scene.is_one_surface(cell, other, self.tangent) {
                    labels[other] = label;
                    cluster.push(other);
                }
            }
        }
    }

    fn around(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let near = move |other: &Cell| other.0.abs_diff(cell.0) <= CLUSTER_REACH;
        let above = self.neighbours.above(cell).next().filter(near);
        let below = self.neighbours.below(cell).next().filter(near);
        self.neighbours.beside(cell).chain(above).chain(below)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::hdl64::BeamConstants;
    use crate::scanner::{CoordinateGrid, RangeImage, ideal};

    /// The image of a scene: `range` returns the range in metres, if any, for the elevation and the azimuth
    /// (radians) of a beam.
    fn image(range: impl Fn(f64, f64) -> Option<f64>) -> (RangeImage, Hdl64) {
        let scanner = ideal(360, 10_000);
        (image_of(&scanner, range), scanner)
    }

    /// As [`image`], for a scanner with 360 ticks.
    fn image_of(scanner: &Hdl64, range: impl Fn(f64, f64) -> Option<f64>) -> RangeImage {
        let mut image = RangeImage::new(scanner.rows(), (0..360).collect());
        for row in 0..scanner.rows() {
            for column in 0..360 {
                let azimuth = f64::from(scanner.tick_of_column(row, column)).to_radians();
                if let Some(metres) = range(scanner.elevation(row), azimuth) {
                    image.steps[(row, column as usize)] = scanner.steps(metres).unwrap();
                }
            }
        }
        image
    }

    /// Flat ground 1.7 m below the scanner, up to 40 m away.
    fn ground(elevation: f64) -> Option<f64> {
        (elevation < -0.0425).then(|| 1.7 / -elevation.sin())
    }

    fn labels_of(image: &RangeImage, scanner: &Hdl64) -> Segmentation {
        segment(&image.steps, &image.columns, scanner, &SegmentationConfig::default())
    }

    #[test]
    fn flat_ground_is_all_ground() {
        let (image, scanner) = image(|elevation, _| ground(elevation));
        let found = labels_of(&image, &scanner);
        assert_eq!(found.end, FIRST_OBJECT);
        let as_expected =
            |(label, steps): (&u32, &u32)| *label == if *steps > 0 { GROUND } else { NO_RETURN };
        assert!(found.labels.cells().iter().zip(image.steps.cells()).all(as_expected));
    }

    /// Two posts 8 m away on that ground, one of them straight ahead, where the image begins and ends.
    fn two_posts(elevation: f64, azimuth: f64) -> Option<f64> {
        let on_post = |at: f64| ((azimuth - at + 3.0).rem_euclid(std::f64::consts::TAU) - 3.0).abs() < 0.1;
        let post = on_post(0.0) || on_post(2.0);
        let floor = ground(elevation);
        if post && floor.is_none_or(|range| range * elevation.cos() > 8.0) {
            Some(8.0 / elevation.cos())
        } else {
            floor
        }
    }

    #[test]
    fn posts_are_objects_even_across_the_seam() {
        let (image, scanner) = image(two_posts);
        let found = labels_of(&image, &scanner);
        assert_eq!(found.end, FIRST_OBJECT + 2);
        assert_eq!(found.labels[(10, 0)], found.labels[(10, 358)]);
        assert_ne!(found.labels[(10, 0)], found.labels[(10, 115)]);
        assert_eq!(found.labels[(60, 0)], GROUND);
    }

    #[test]
    fn beams_that_point_aside_see_the_same() {
        let beam = |row: usize| BeamConstants {
            column_shift: (row as i64 * 25) % 90 - 45,
            ..BeamConstants::quantise([ideal(360, 10_000).elevation(row), 0.0, 0.0, 0.0, 0.0])
        };
        let beams = (0..64).map(beam).collect();
        let scanner = Hdl64::new(CoordinateGrid::Float32, 360, 10_000, beams);
        let found = labels_of(&image_of(&scanner, two_posts), &scanner);
        let (straight, straight_scanner) = image(two_posts);
        let expected = labels_of(&straight, &straight_scanner);
        assert_eq!(found.end, expected.end);
        let same = |row: usize, column: u32| {
            let tick = scanner.tick_of_column(row, column) as usize;
            found.labels[(row, column as usize)] == expected.labels[(row, tick)]
        };
        assert!((0..64).all(|row| (0..360).all(|column| same(row, column))));
    }

    /// The percentage of the ground in an image.
    fn ground_share(image: &RangeImage, scanner: &Hdl64, config: &SegmentationConfig) -> usize {
        let found = segment(&image.steps, &image.columns, scanner, config);
        found.labels.cells().iter().filter(|label| **label == GROUND).count() * 100 / image.returns()
    }

    #[test]
    fn ground_is_found_where_elevations_are_off_by_a_tenth_of_a_degree() {
        let off = |elevation: f64| (elevation * 5000.0).sin().signum() * 0.002;
        let (image, scanner) = image(|elevation, _| ground(elevation + off(elevation)));
        let config = SegmentationConfig::default();
        assert!(ground_share(&image, &scanner, &config) >= 90);
        assert!(ground_share(&image, &scanner, &SegmentationConfig { ground_reach_m: 0.0, ..config }) < 50);
    }

    #[test]
    fn ground_goes_on_behind_rows_without_returns() {
        // Eight rows have no returns.
        let (mut image, scanner) = image(|elevation, _| ground(elevation));
        (40..48).for_each(|row| image.steps.row_mut(row).fill(0));
        assert_eq!(ground_share(&image, &scanner, &SegmentationConfig::default()), 100);
    }

    #[test]
    fn ground_behind_an_object_does_not_lead_onto_it() {
        // A flat top 0.9 m below the scanner, 5 to 6 m away: from its far edge to the ground that is seen
        // behind it, the line falls by 8 degrees.
        let (image, scanner) = image(|elevation, azimuth| {
            let ahead = (azimuth - 1.0).abs() < 0.2;
            let top = 0.9 / -elevation.tan();
            match () {
                () if ahead && (5.0..6.0).contains(&top) => Some(top / elevation.cos()),
                () if ahead && (0.0..5.0).contains(&top) && 5.0 * elevation.tan() > -1.7 => {
                    Some(5.0 / elevation.cos())
                }
                () => ground(elevation),
            }
        });
        let config = SegmentationConfig::default();
        let top = (0..64).find(|&row| image.steps[(row, 57)] < 700 && image.steps[(row, 57)] > 0).unwrap();
        assert!(image.steps[(top - 1, 57)] > 1000);
        let label = |config| segment(&image.steps, &image.columns, &scanner, &config).labels[(top, 57)];
        assert!(label(config) >= FIRST_OBJECT);
        assert_eq!(label(SegmentationConfig { ground_rise_m: 10.0, ..config }), GROUND);
    }

    #[test]
    fn roofs_are_no_ground() {
        // A box 6 m away: its front, then its flat roof 0.3 m below the scanner.
        let (image, scanner) = image(|elevation, azimuth| {
            let box_ahead = (azimuth - 1.0).abs() < 0.3;
            let front = 6.0 * elevation.tan();
            match () {
                () if box_ahead && (-1.7..-0.3).contains(&front) => Some(6.0 / elevation.cos()),
                () if box_ahead && front > -0.3 && front < -0.15 => Some(0.3 / -elevation.sin()),
                () => ground(elevation),
            }
        });
        let found = labels_of(&image, &scanner);
        let column = 57;
        let roof = (0..64).find(|&row| image.steps[(row, column)] > 0).unwrap();
        assert_ne!(found.labels[(roof, column)], GROUND);
        assert_eq!(found.labels[(63, column)], GROUND);
    }

    #[test]
    fn odd_images_are_segmented() {
        let scanner = ideal(16, 10_000);
        let mut image = RangeImage::new(64, (0..16).collect());
        assert_eq!(labels_of(&image, &scanner).labels, Grid::new(64, 16));
        image.steps[(5, 5)] = 700;
        assert_eq!(labels_of(&image, &scanner).labels[(5, 5)], UNASSIGNED);
        let none = RangeImage::new(64, Vec::new());
        assert_eq!(labels_of(&none, &scanner).end, FIRST_OBJECT);
    }

    #[test]
    fn every_return_may_be_an_object_of_its_own() {
        let (mut image, scanner) = image(|_, _| None);
        for row in 0..64 {
            for column in 0..360 {
                image.steps[(row, column)] = 500 + 700 * ((row * 7 + column * 5) % 11) as u32;
            }
        }
        let config =
            SegmentationConfig { smallest_cluster: 1, ground_angle: 0.0, ..SegmentationConfig::default() };
        assert_eq!(segment(&image.steps, &image.columns, &scanner, &config).end, FIRST_OBJECT + 64 * 360);
    }
}
