//! Where the points of a scan lie in the range image of a scanner of firings.

use super::recipe::steps_of;
use super::{Firings, Span};
use crate::ground::grid::Grid;
use crate::ground::rounding::round_ties_even;
use crate::scan::PointCloud;
use crate::scanner::{EXACT_RANGE_BITS, Projection, RangeImage, Return};

/// Ranges of an image that loses nothing are below this, in steps.
const LONGEST: u32 = 1 << EXACT_RANGE_BITS;
/// Cells for each point from which on the points are in no order that an image is worth.
const MOST_CELLS: usize = 16;

/// Where a point belongs by the formula.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub point: u32,
    pub row: u32,
    pub slot: u32,
    pub tick: u32,
    pub steps: u32,
}

/// Points that were measured together: a column in the making.
struct Column {
    places: std::ops::Range<usize>,
    tick: u32,
    span: Span,
}

impl Firings {
    /// Projects a scan into a range image. Points that the recipe misses by more than `reach` metres along an axis, that
    /// are out of the firings' order, or that have no return are strays.
    pub fn project(&self, cloud: &PointCloud, reach: f64) -> Projection {
        let places = self.places(&cloud.positions, reach + 0.5 * self.range_step_m());
        let columns = self.columns(&places);
        if columns.len().saturating_mul(self.rows()) > MOST_CELLS * cloud.positions.len() {
            let strays = (0..cloud.positions.len() as u32).collect();
            return Projection {
                image: RangeImage::new(self.rows(), Vec::new()),
                strays,
                ..Projection::default()
            };
        }
        let spans = columns.iter().map(|column| column.span.kept());
        let spans: Vec<u32> = if self.timing.is_interpolated() { spans.collect() } else { Vec::new() };
        let mut image = RangeImage::new(self.rows(), columns.iter().map(|column| column.tick).collect());
        image.spans = spans;
        let mut point_of_cell = Grid::new(self.rows(), columns.len());
        let mut is_stray = vec![true; cloud.positions.len()];
        for (number, column) in columns.iter().enumerate() {
            for place in &places[column.places.clone()] {
                let row = place.row as usize;
                if self.tick(row, column.tick, column.span) == place.tick {
                    image.steps[(row, number)] = place.steps;
                    point_of_cell[(row, number)] = place.point;
                    is_stray[place.point as usize] = false;
                }
            }
        }
        let strays =
            (0u32..).zip(is_stray).filter(|(_, is_stray)| *is_stray).map(|(point, _)| point).collect();
        Projection { image, point_of_cell, strays }
    }

    /// The places of the points that the recipe explains, in the order of the file.
    pub(super) fn places(&self, positions: &[[f32; 3]], reach: f64) -> Vec<Place> {
        let mut places = Vec::with_capacity(positions.len());
        let elevations: Vec<f64> =
            self.lasers.iter().map(|laser| laser.elevation_degrees().to_radians()).collect();
        for (point, position) in (0u32..).zip(positions) {
            let metres @ [x, y, z] = position.map(f64::from);
            let Some(steps) = steps_of(metres, self.range_step_m()).filter(|steps| *steps < LONGEST) else {
                continue;
            };
            let row = nearest(&elevations, libm::atan2(z, (x * x + y * y).sqrt()));
            let tick = self.nearest_tick(row, x, y);
            let found = Return { row: row as u32, tick, steps, column: 0 };
            let formula = self.position(&found, 0.0);
            let is_near = formula.iter().zip(metres).all(|(formula, value)| (formula - value).abs() < reach);
            if is_near {
                places.push(Place { point, row: row as u32, slot: self.slots_of_rows[row], tick, steps });
            }
        }
        places
    }

    /// The tick at which a laser is nearest to looking at a point.
    pub(super) fn nearest_tick(&self, row: usize, x: f64, y: f64) -> u32 {
        let turned = self.recipe.azimuth(x, y) - self.lasers[row].azimuth_degrees().to_radians();
        (round_ties_even(turned / self.radians()) as i64).rem_euclid(i64::from(self.ticks)) as u32
    }

    /// Places by columns: a new one begins where the slots begin anew, or the tick is another.
    fn columns(&self, places: &[Place]) -> Vec<Column> {
        let mut columns: Vec<Column> = Vec::new();
        let mut last: Option<&Place> = None;
        for (number, place) in places.iter().enumerate() {
            let goes_on =
                last.is_some_and(|last| place.slot > last.slot && self.goes_on(last.tick, place.tick));
            match columns.last_mut().filter(|_| goes_on) {
                Some(column) => column.places.end = number + 1,
                None => columns.push(Column {
                    places: number..number + 1,
                    tick: place.tick,
                    span: Span::default(),
                }),
            }
            last = Some(place);
        }
        if self.timing.is_interpolated() {
            self.find_spans(places, &mut columns);
        }
        columns
    }

    /// Whether a tick may follow another in one firing.
    fn goes_on(&self, last: u32, tick: u32) -> bool {
        /// The part of a turn that a firing may take.
        const LONGEST_FIRING: u32 = 300;
        match self.timing.is_interpolated() {
            true => (tick + self.ticks - last) % self.ticks <= self.ticks / LONGEST_FIRING,
            false => last == tick,
        }
    }

    /// Finds the tick of each block, and the ticks to the next one: those by which the ticks of all its places come out.
    fn find_spans(&self, places: &[Place], columns: &mut [Column]) {
        /// Blocks that no numbers explain, before no more are looked for widely.
        const MOST_FAILURES: usize = 16;
        let mut number = 0;
        let mut last = 0;
        let mut failures = 0;
        while number < columns.len() {
            let next = columns.get(number + 2).map(|column| &places[column.places.clone()]);
            let both = self.block(places, columns, number..(number + 2).min(columns.len()), 0, (last, next));
            let (count, first) = match both {
                Some(_) => (2, 0),
                None => (1, 0),
            };
            let alone = || self.block(places, columns, number..number + 1, 0, (last, None));
            let second = || self.block(places, columns, number..number + 1, 1, (last, None));
            let (found, first) = match both.or_else(alone) {
                Some(found) => (Some(found), first),
                None => (second(), 1),
            };
            let end = (number + count).min(columns.len());
            for (firing, column) in (first..).zip(&mut columns[number..end]) {
                if let Some((tick, ticks)) = found {
                    column.tick = tick;
                    column.span = Span { ticks, firing };
                }
            }
            last = found.map_or(last, |(_, ticks)| ticks);
            failures += usize::from(found.is_none());
            if failures > MOST_FAILURES && failures > number / 4 {
                return;
            }
            number = end;
        }
    }

    /// The tick of a block of these columns, the first of which is this firing of it, and the ticks to the next one.
    fn block(
        &self,
        places: &[Place],
        columns: &[Column],
        block: std::ops::Range<usize>,
        first_firing: u32,
        (last, next): (u32, Option<&[Place]>),
    ) -> Option<(u32, u32)> {
        /// Ticks between blocks differ by less than this from those before, if the scanner turns evenly.
        const UNEVEN: u32 = 12;
        let first = places.get(columns[block.start].places.start)?;
        let fits = |tick: u32, ticks: u32| {
            (first_firing..).zip(&columns[block.clone()]).all(|(firing, column)| {
                places[column.places.clone()]
                    .iter()
                    .all(|place| self.tick(place.row as usize, tick, Span { ticks, firing }) == place.tick)
            })
        };
        // The next block tells how many ticks there are, if its first slot has a return.
        let told = next.and_then(<[Place]>::first).filter(|next| next.slot == 0).map(|next| next.tick);
        let around = (0..=UNEVEN).flat_map(|off| [last.saturating_sub(off), last + off]);
        let widely = 0..=self.ticks / 100;
        for back in 0..=self.ticks / 400 {
            let tick = (first.tick + self.ticks - back) % self.ticks;
            let told = told.map(|told| (told + self.ticks - tick) % self.ticks);
            let found = match back {
                0 => told
                    .into_iter()
                    .chain(around.clone())
                    .chain(widely.clone())
                    .find(|&ticks| fits(tick, ticks)),
                _ => told.into_iter().chain(around.clone()).find(|&ticks| fits(tick, ticks)),
            };
            if let Some(ticks) = found {
                return Some((tick, ticks));
            }
            if first.slot == 0 && first_firing == 0 {
                break;
            }
        }
        None
    }
}

/// The place of the nearest of some falling values.
pub(super) fn nearest(falling: &[f64], value: f64) -> usize {
    let after = falling.partition_point(|&other| other > value);
    match after {
        0 => 0,
        _ if after == falling.len() => after - 1,
        _ if falling[after - 1] - value < value - falling[after] => after - 1,
        _ => after,
    }
}
