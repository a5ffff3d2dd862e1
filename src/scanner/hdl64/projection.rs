//! Projecting the points of a scan into a range image. In the encoder's input nearly every point is one tick
//! after the one before, so the formula is inverted for several points at a time, near their expected ticks.

use std::f64::consts::TAU;

use pulp::{Scalar, Simd, WithSimd};

use super::Hdl64;
use super::formula::Tick;
use super::model::ON_CONE;
use crate::ground::doubles::{Choose, Doubles, Real};
use crate::ground::floats::nearest_integer;
use crate::ground::grid::Grid;
use crate::ground::lanes::{dispatch, lanes};
use crate::ground::lazy_table::BLOCK;
use crate::scan::{PointCloud, squared_distance};
use crate::scanner::{FLOAT_RANGES, LEAST_RANGE_BITS, Projection, RangeImage};

impl Hdl64 {
    /// The deviations of an image's points from the formula, in metres, row after row.
    pub fn misses(&self, projection: &Projection, cloud: &PointCloud) -> Vec<f64> {
        let mut misses = Vec::with_capacity(cloud.positions.len());
        let image = &projection.image;
        for row in 0..image.steps.rows() {
            for (column, &steps) in image.steps.row(row).iter().enumerate().filter(|(_, s)| **s > 0) {
                let tick = self.tick_of_column(row, image.columns[column]);
                let formula = self.point(row, tick, steps).map(|metres| metres as f32);
                let point = &cloud.positions[projection.point_of_cell[(row, column)] as usize];
                misses.push(squared_distance(&formula, point).sqrt());
            }
        }
        misses
    }
}

/// The longest range in a lossless image, in steps; farther points are strays.
const LONGEST: u32 = (1 << LEAST_RANGE_BITS) - 1;

/// If there are many beams, a column with fewer points costs more than the points do as strays.
const FEWEST_IN_COLUMN: u32 = 3;
/// But not if columns have fewer points than this on average.
const FEW_IN_COLUMN: usize = 12;

/// Projects a scan into a range image (article, IV-A, with the calibrated scanner in place of the ideal one,
/// so that nothing is lost). Points that deviate from the formula by more than `reach` metres along an axis,
/// plus half a range step, are strays.
pub fn project(scanner: &Hdl64, cloud: &PointCloud, reach: f64) -> Projection {
    let places = places(scanner, cloud, reach + 0.5 * scanner.range_step_m());
    let mut in_column = vec![0u32; scanner.ticks as usize];
    places
        .iter()
        .filter(|place| place.steps > 0)
        .for_each(|place| in_column[place.column_tick as usize] += 1);
    let used = in_column.iter().filter(|points| **points > 0).count();
    let found = in_column.iter().sum::<u32>() as usize;
    // Of a scan that was not moved back, a few points are on the formula by chance.
    let is_sparse = found < FEW_IN_COLUMN * used && 2 * found > places.len();
    let fewest = if is_sparse { 1 } else { FEWEST_IN_COLUMN.min(scanner.rows().div_ceil(3) as u32) };
    let columns: Vec<u32> = (0..scanner.ticks).filter(|&c| in_column[c as usize] >= fewest).collect();
    let mut column_of_tick = vec![None; scanner.ticks as usize];
    (0u32..).zip(&columns).for_each(|(column, &tick)| column_of_tick[tick as usize] = Some(column));

    let mut projection = Projection {
        point_of_cell: Grid::new(scanner.rows(), columns.len()),
        image: RangeImage::new(scanner.rows(), columns),
        ..Projection::default()
    };
    for (point, place) in (0u32..).zip(&places) {
        let column = column_of_tick[place.column_tick as usize].filter(|_| place.steps > 0);
        let cell = column.map(|column| (place.row as usize, column as usize));
        match cell.filter(|&cell| projection.image.steps[cell] == 0) {
            Some(cell) => {
                projection.image.steps[cell] = place.steps;
                projection.point_of_cell[cell] = point;
            }
            None => projection.strays.push(point),
        }
    }
    projection
}

/// Projects a scan into the image of the ideal scanner (article, IV-A, equation 2): every point goes to the
/// nearest beam and column, and of two points in one cell the nearer one is kept. Strays are the points in no
/// cell.
pub fn project_nearest(scanner: &Hdl64, cloud: &PointCloud) -> Projection {
    let columns = (0..scanner.ticks).collect();
    let mut projection = Projection {
        point_of_cell: Grid::new(scanner.rows(), scanner.ticks as usize),
        image: RangeImage::new(scanner.rows(), columns),
        ..Projection::default()
    };
    let mut row = 0;
    for (point, position) in (0u32..).zip(&cloud.positions) {
        let position @ [x, y, z] = position.map(f64::from);
        row = scanner.nearest_beam((x * x + y * y).sqrt(), z, row);
        let Some((tick, steps)) = scanner.invert(row, position) else {
            projection.strays.push(point);
            continue;
        };
        let cell = (row, scanner.column_tick(row, i64::from(tick)) as usize);
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

/// The cell and range of a point by the formula.
#[derive(Clone, Copy, Default, PartialEq)]
struct Place {
    row: u32,
    column_tick: u32,
    /// Range in steps; 0 if the formula does not explain the point.
    steps: u32,
}

/// The cell and range of each point.
fn places(scanner: &Hdl64, cloud: &PointCloud, reach: f64) -> Vec<Place> {
    let search = Search { scanner, reach, row: 0, tick: 0, hint: 0 };
    dispatch(Searching { search, positions: &cloud.positions })
}

/// The arguments of [`places`], for a function compiled for several vector units.
struct Searching<'a> {
    search: Search<'a>,
    positions: &'a [[f32; 3]],
}

impl WithSimd for Searching<'_> {
    type Output = Vec<Place>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<Place> {
        /// Number of points at a time.
        const BLOCK: usize = 8;
        let Searching { mut search, positions } = self;
        let mut places = Vec::with_capacity(positions.len());
        let (blocks, rest) = positions.as_chunks::<BLOCK>();
        for block in blocks {
            match search.next(simd, block) {
                Some(found) => places.extend_from_slice(&found),
                None => places.extend(block.iter().map(|point| search.next_one(point))),
            }
        }
        places.extend(rest.iter().map(|point| search.next_one(point)));
        places
    }
}

/// Finds the cells of points that are in order of rows and ticks.
struct Search<'a> {
    scanner: &'a Hdl64,
    /// In metres.
    reach: f64,
    /// The row of the last point.
    row: usize,
    tick: u32,
    /// The tick from which the next search starts: that of the point before the last points that were found
    /// together, so that the next search need not wait for this one to finish.
    hint: u32,
}

impl Search<'_> {
    /// The cells of the next points, if all of them are near that of the last one.
    #[inline(always)]
    fn next<S: Simd, const N: usize>(&mut self, simd: S, points: &[[f32; 3]; N]) -> Option<[Place; N]> {
        let found = self.scanner.invert_near(simd, self.row, points, self.hint, self.reach)?;
        if found.iter().any(|(_, steps)| *steps > LONGEST) {
            return None;
        }
        (self.hint, self.tick) = (self.tick, found.last()?.0);
        let (row, column_tick) = (self.row as u32, self.scanner.columns_of_ticks(self.row));
        Some(lanes(|i| Place { row, column_tick: column_tick(found[i].0), steps: found[i].1 }))
    }

    /// The cell of the next point, wherever that is.
    fn next_one(&mut self, position: &[f32; 3]) -> Place {
        if let Some([place]) = self.next(Scalar::new(), &[*position]) {
            return place;
        }
        let point @ [x, y, z] = position.map(f64::from);
        self.row = self.scanner.nearest_beam((x * x + y * y).sqrt(), z, self.row);
        match self.scanner.invert(self.row, point).filter(|(_, steps)| *steps <= LONGEST) {
            Some((tick, steps)) => {
                (self.hint, self.tick) = (tick, tick);
                let formula = self.scanner.point(self.row, tick, steps);
                let mut axes = formula.into_iter().zip(position);
                let is_near = |(formula, value): (f64, &f32)| {
                    (formula - f64::from(*value)).abs() < self.reach
                        && self.scanner.coordinates.holds(*value, formula)
                };
                let place = || {
                    let column_tick = self.scanner.column_tick(self.row, i64::from(tick));
                    Place { row: self.row as u32, column_tick, steps }
                };
                if axes.all(is_near) { place() } else { Place::default() }
            }
            None => Place::default(),
        }
    }
}

/// Within this many ticks an angle can be replaced by its sine.
const NEAR: f64 = 32.0;

impl Hdl64 {
    /// The ticks and range steps of points (metres, as in the file) of beam `row`, all near tick `hint`.
    /// `None` if any of them is not near it, is not on the file's grid, or deviates from the formula by
    /// `reach` metres or more along an axis.
    #[inline(always)]
    fn invert_near<S: Simd, const N: usize>(
        &self,
        simd: S,
        row: usize,
        points: &[[f32; 3]; N],
        hint: u32,
        reach: f64,
    ) -> Option<[(u32, u32); N]> {
        let (beam, turn) = (&self.beams[row], f64::from(self.ticks));
        if self.range_step_um == FLOAT_RANGES || turn < 16.0 * NEAR {
            return None;
        }
        let (cos, sin) = beam.heading(*self.ticks_of_turn.get(hint));
        let (mut turned, mut steps, mut values) = ([0.0; N], [0.0; N], [[0.0; N]; 3]);
        for part in 0..N / S::F64_LANES {
            let first = part * S::F64_LANES;
            let along = |axis: usize| Doubles::of(simd, |lane| f64::from(points[first + lane][axis]));
            let (x, y, z) = (along(0), along(1), along(2));
            let rho = (x * x + y * y).sqrt();
            let ticks = (y * cos - x * sin - beam.h) / rho * (turn * (1.0 / TAU));
            let range = (beam.range(rho, z) * (1e6 / f64::from(self.range_step_um))).round_ties_even();
            let is_expected = (beam.height_at(rho) - z).abs().is_below(ON_CONE)
                & ticks.abs().is_below(NEAR)
                & (x * cos + y * sin).is_above(0.0)
                & range.is_above(0.0)
                & range.is_below(f64::from(self.most_steps()) + 1.0);
            if !is_expected.all() {
                return None;
            }
            ticks.store(&mut turned, part);
            range.store(&mut steps, part);
            x.store(&mut values[0], part);
            y.store(&mut values[1], part);
            z.store(&mut values[2], part);
        }
        let ticks: [u32; N] = lanes(|i| {
            let tick = hint as i32 + nearest_integer(turned[i]);
            let (first, end) = (tick < 0, tick >= self.ticks as i32);
            (tick + self.ticks as i32 * (i32::from(first) - i32::from(end))) as u32
        });
        let metres: [f64; N] = lanes(|i| steps[i] * self.range_step_m());
        let mut formula = [[0.0; N]; 3];
        self.compute_points(simd, row, &ticks, &metres, &mut formula);
        for part in 0..N / S::F64_LANES {
            let load = |values: &[f64; N]| Doubles::load(simd, values, part);
            let miss = |axis: usize| (load(&formula[axis]) - load(&values[axis])).abs();
            let is_near = miss(0).is_below(reach) & miss(1).is_below(reach) & miss(2).is_below(reach);
            if !is_near.all() {
                return None;
            }
        }
        let on_grid = self.coordinates.holds_all(&values[0], &formula[0])
            & self.coordinates.holds_all(&values[1], &formula[1])
            & self.coordinates.holds_all(&values[2], &formula[2]);
        on_grid.then(|| lanes(|i| (ticks[i], nearest_integer(steps[i]) as u32)))
    }

    /// Computes x, y and z, in metres, of points of one beam by the formula.
    #[inline(always)]
    fn compute_points<S: Simd, const N: usize>(
        &self,
        simd: S,
        row: usize,
        ticks: &[u32; N],
        metres: &[f64; N],
        points: &mut [[f64; N]; 3],
    ) {
        let Some(block) = self.ticks_of_turn.block_of(ticks) else {
            return self.compute_points_one_by_one(row, ticks, metres, points);
        };
        for part in 0..N / S::F64_LANES {
            let tick = |lane: usize| &block[ticks[part * S::F64_LANES + lane] as usize % BLOCK];
            let (cos, sin) = (Doubles::of(simd, |i| tick(i).cos), Doubles::of(simd, |i| tick(i).sin));
            let [x, y, z] = self.beams[row].point(Tick { cos, sin }, Doubles::load(simd, metres, part));
            x.store(&mut points[0], part);
            y.store(&mut points[1], part);
            z.store(&mut points[2], part);
        }
    }

    /// The same, for ticks in several blocks of the table. Not inlined, so that vectors are not divided into
    /// the values that are computed here.
    #[inline(never)]
    fn compute_points_one_by_one<const N: usize>(
        &self,
        row: usize,
        ticks: &[u32; N],
        metres: &[f64; N],
        points: &mut [[f64; N]; 3],
    ) {
        for i in 0..N {
            let point = self.point_at(row, ticks[i], metres[i]);
            (0..3).for_each(|axis| points[axis][i] = point[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::REACH;
    use crate::scanner::hdl64::positions;
    use crate::scanner::hdl64::testing::scanner;

    #[test]
    fn points_find_their_cells_on_every_vector_unit() {
        let (scanner, image) = scanner();
        let positions = positions(&scanner, &image.file_order(&scanner), 0.0, true);
        let reach = REACH + 0.5 * scanner.range_step_m();
        let search = Search { scanner: &scanner, reach, row: 0, tick: 0, hint: 0 };
        let cloud = PointCloud { positions, ..PointCloud::default() };
        let anywhere = Searching { search, positions: &cloud.positions }.with_simd(Scalar::new());
        assert!(places(&scanner, &cloud, reach) == anywhere);
        assert_eq!(project(&scanner, &cloud, REACH).image, image);
    }
}
