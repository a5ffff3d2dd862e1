//! Where the points of a scan lie in the range image of a scanner of firings.

use pulp::{Scalar, Simd, WithSimd};

use super::blur::Blur;
use super::timing::Span;
use super::{Bearing, Firings};
use crate::ground::angle::shorter_way;
use crate::ground::doubles::{Choose, Doubles};
use crate::ground::error::Limits;
use crate::ground::floats::nearest_integer;
use crate::ground::grid::Grid;
use crate::ground::lanes::{dispatch, lanes};
use crate::scan::{PointCloud, has_direction};
use crate::scanner::{CoordinateGrid, Echo, Projection, REACH, RangeImage, Return, thinned};

/// Ranges of an exact image are below this, in steps.
pub(super) const LONGEST: u32 = 1 << 20;
/// With more cells per point than this, the points are in no order that is worth an image, unless columns
/// have [`ENOUGH_POINTS`] on average.
const MOST_CELLS: usize = 16;
/// More than the two points that columns would have by chance.
const ENOUGH_POINTS: f64 = 2.5;

/// The place of a point in the range image, by the formula.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub point: u32,
    pub row: u32,
    pub slot: u32,
    /// The tick of the laser, and that of its column if all lasers of a firing have one tick.
    pub tick: u32,
    pub column_tick: u32,
    pub steps: u32,
    /// By how many ticks these may be wrong, because the coordinates were rounded.
    pub slack: u32,
}

/// The tick of a column without returns, until it is filled in.
const UNKNOWN: u32 = u32::MAX;

/// Finds the returns that are nearest to points.
pub struct Sight<'f> {
    scanner: &'f Firings,
    elevations: Vec<f64>,
    /// Tangents of the elevations halfway between neighbouring lasers.
    borders: Vec<f64>,
    /// Where the beams cross, in metres from the axis and above the origin.
    along: f64,
    up: f64,
}

impl<'f> Sight<'f> {
    /// For the returns of this scanner.
    pub fn new(scanner: &'f Firings) -> Self {
        let elevations: Vec<f64> = scanner.elevations().collect();
        let border = |pair: &[f64]| libm::tan(0.5 * (pair[0] + pair[1]));
        let borders = elevations.windows(2).map(border).collect();
        let [along, up] = scanner.build.origin.metres();
        let along = scanner.build.recipe.crossing(along);
        Sight { scanner, elevations, borders, along, up }
    }

    /// Number of lasers.
    pub fn rows(&self) -> usize {
        self.elevations.len()
    }

    /// The return that is nearest to a position in the file, in metres, not yet in a column, and its position
    /// there by the recipe. `None` if there is no such range.
    pub fn nearest(&self, metres: [f64; 3]) -> Option<(Return, [f64; 3])> {
        let measured = self.scanner.in_frame(metres);
        let row = self.row(measured) as usize;
        let located = self.scanner.measure(&self.scanner.bearings[row], measured);
        let is_one = self.scanner.is_measured(&located) && located.steps < f64::from(LONGEST);
        let found = || unplaced(row as u32, located.tick as u32, located.steps as u32);
        is_one.then(|| (found(), self.scanner.position(&found(), 0.0)))
    }

    /// The rows of the lasers that are nearest to positions, as whole numbers.
    #[inline(always)]
    fn row<V: Choose>(&self, [x, y, z]: [V; 3]) -> V {
        let [none, one] = [0.0, 1.0].map(|value| x.splat(value));
        // Approximately the direction of the beam: its azimuth offset is small.
        let ahead = (x * x + y * y).sqrt() - self.along;
        // Behind the place where beams cross, a point is straight above or below.
        let slope = (z - self.up) / V::select(ahead.is_above(0.0), ahead, none);
        // All borders are counted: for several points at once, that is faster than halving them for one point
        // after the other.
        let above = |border: f64| V::select(slope.is_at_most(x.splat(border)), one, none);
        // Sums of their own, which need not wait for one another.
        let mut rows = [none; 4];
        let (groups, others) = self.borders.as_chunks::<4>();
        for borders in groups {
            for i in 0..4 {
                rows[i] = rows[i] + above(borders[i]);
            }
        }
        for border in others {
            rows[0] = rows[0] + above(*border);
        }
        rows[0] + rows[1] + (rows[2] + rows[3])
    }
}

/// A return that is not yet in a column.
fn unplaced(row: u32, tick: u32, steps: u32) -> Return {
    Return { row, tick, steps, column: 0, echo: 0 }
}

/// The search for the places of points, as a type so that it can be compiled for several vector units.
struct Search<'a, const IS_MOUNTED: bool> {
    scanner: &'a Firings,
    positions: &'a [[f32; 3]],
    reach: f64,
}

impl<const IS_MOUNTED: bool> WithSimd for Search<'_, IS_MOUNTED> {
    type Output = Vec<Place>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<Place> {
        /// Number of points that are processed together.
        const BLOCK: usize = 8;
        let sight = Sight::new(self.scanner);
        let mut places = Vec::with_capacity(self.positions.len());
        let (blocks, rest) = self.positions.as_chunks::<BLOCK>();
        let mut first = 0;
        for block in blocks {
            self.find(simd, &sight, first, block, &mut places);
            first += BLOCK as u32;
        }
        for point in rest {
            self.find(Scalar::new(), &sight, first, std::array::from_ref(point), &mut places);
            first += 1;
        }
        places
    }
}

impl<const IS_MOUNTED: bool> Search<'_, IS_MOUNTED> {
    /// Appends the places of `N` points, of which the first has the number `first`. `N` must be a multiple of
    /// the number of values in a vector.
    #[inline(always)]
    fn find<S: Simd, const N: usize>(
        &self,
        simd: S,
        sight: &Sight,
        first: u32,
        block: &[[f32; 3]; N],
        places: &mut Vec<Place>,
    ) {
        let scanner = self.scanner;
        let grid = scanner.build.coordinates;
        let measured: [[f64; 3]; N] =
            if IS_MOUNTED { lanes(|i| scanner.in_frame(block[i].map(f64::from))) } else { [[0.0; 3]; N] };
        let (mut rows, mut ticks, mut steps) = ([0.0; N], [0.0; N], [0.0; N]);
        for part in 0..N / S::F64_LANES {
            let of = |lane: usize| part * S::F64_LANES + lane;
            let along = |axis: usize| match IS_MOUNTED {
                true => Doubles::of(simd, |lane| measured[of(lane)][axis]),
                false => Doubles::of(simd, |lane| f64::from(block[of(lane)][axis])),
            };
            let point = [along(0), along(1), along(2)];
            sight.row(point).store(&mut rows, part);
            let row = |lane: usize| nearest_integer(rows[of(lane)]) as usize;
            let bearing = Bearing::of_rows(simd, &scanner.bearings, row);
            let located = scanner.measure(&bearing, point);
            let mut is_one = scanner.is_measured(&located) & located.steps.is_below(f64::from(LONGEST));
            // Every float32 is on its grid.
            if grid == CoordinateGrid::Float32 {
                let near = scanner.near(&bearing, point, &located);
                let is_near = |axis: usize| (near[axis] - point[axis]).abs().is_below(self.reach);
                is_one = is_one & is_near(0) & is_near(1) & is_near(2);
            }
            located.tick.store(&mut ticks, part);
            let none = located.steps.splat(0.0);
            Choose::select(is_one, located.steps, none).store(&mut steps, part);
        }
        for i in (0..N).filter(|&i| steps[i] > 0.0) {
            let [row, tick, steps] = [rows[i], ticks[i], steps[i]].map(|value| nearest_integer(value) as u32);
            let found = unplaced(row, tick, steps);
            let slack = match grid {
                CoordinateGrid::Float32 => Some(0),
                _ => self.slack(&found, &block[i]),
            };
            if let Some(slack) = slack {
                let place = scanner.place(first + i as u32, &found);
                places.push(Place { slack, ..place });
            }
        }
    }

    /// By how many ticks the return at a position of a file whose coordinates were rounded may be wrong;
    /// `None` if the recipe does not explain the position.
    #[inline(never)]
    fn slack(&self, found: &Return, position: &[f32; 3]) -> Option<u32> {
        let (grid, blur) = (self.scanner.build.coordinates, Blur::of(self.scanner.build.coordinates));
        let reach = self.reach + blur.reach();
        // On such grids, the formula gives the sign of a zero.
        let (formula, metres) = (self.scanner.position(found, 0.0), position.map(f64::from));
        let is_near = (0..3).all(|axis| (formula[axis] - metres[axis]).abs() < reach);
        let distance = (metres[0] * metres[0] + metres[1] * metres[1]).sqrt();
        let slack = || if blur.is_any() { blur.ticks(distance, self.scanner.build.ticks) } else { 0 };
        (is_near && grid.holds_all(&metres, &formula)).then(slack)
    }
}

/// Points that were measured together: a column under construction.
pub(super) struct Column {
    pub places: std::ops::Range<usize>,
    pub tick: u32,
    pub span: Span,
}

impl Firings {
    /// Whether the recipe reproduces nearly all points of a sample to the last bit: then they have not been
    /// moved since they were measured.
    pub fn reproduces_most(&self, positions: &[[f32; 3]]) -> bool {
        const LEAST: f64 = 0.9;
        self.reproduced_share(positions) > LEAST
    }

    /// The share of a sample of the points that the recipe reproduces to the last bit.
    pub fn reproduced_share(&self, positions: &[[f32; 3]]) -> f64 {
        const SAMPLE: usize = 400;
        let sight = Sight::new(self);
        let blur = Blur::of(self.build.coordinates);
        let is_clear =
            |[x, y, _]: &&[f32; 3]| blur.ticks(f64::from(libm::hypotf(*x, *y)), self.build.ticks) == 0;
        let is_exact = |position: &[f32; 3]| {
            let metres = position.map(f64::from);
            let formula = sight.nearest(metres).map(|(_, formula)| formula);
            formula.is_some_and(|formula| formula.map(|v| self.build.coordinates.nearest(v)) == *position)
        };
        let returns = thinned(positions, SAMPLE).filter(|position| position.iter().any(|v| *v != 0.0));
        let returns = returns.filter(|position| !blur.is_any() || is_clear(position));
        let (mut exact, mut all) = (0u32, 0u32);
        for position in returns.filter(|position| position.iter().all(|v| v.is_finite())) {
            exact += u32::from(is_exact(position));
            all += 1;
        }
        // Rounded points that are all near contradict nothing.
        if all == 0 && blur.is_any() { 1.0 } else { f64::from(exact) / f64::from(all.max(1)) }
    }

    /// Projects a scan into a range image. Points that the recipe misses by more than `reach` metres along an
    /// axis, that are out of the order of the firings, or that have no return become strays.
    pub fn project(&self, cloud: &PointCloud, reach: f64) -> Projection {
        /// The minimum share of the returns, in an image of which every cell is a record, that are in their
        /// firing's column. If columns are not firings, the others would be blanks at places of their own.
        const LEAST_IN_COLUMNS: f64 = 0.98;
        let found = || self.places(&cloud.positions, reach + 0.5 * self.range_step_m());
        let mut places = found();
        if let Some(width) = self.full_width(&places, &cloud.positions) {
            let least = LEAST_IN_COLUMNS * places.len() as f64;
            let projection = self.project_full(places, width, &cloud.positions, reach);
            if projection.image.returns() as f64 >= least {
                return projection;
            }
            places = found();
        }
        let (places, echoes) = without_echoes(places);
        let (places, echoes, columns) = match self.rows_of_lines.is_empty() {
            true => {
                let columns = self.columns(&places);
                (places, echoes, columns)
            }
            false => self.columns_of_lines(places, echoes),
        };
        // Decoders do not accept a larger image than their limits allow, either.
        let most = Limits::default().points as usize;
        let (cells, points) = (columns.len().saturating_mul(self.rows()), cloud.positions.len());
        let is_ordered = columns.len() as f64 * ENOUGH_POINTS <= points as f64;
        if cells > most || cells > MOST_CELLS * points && !is_ordered {
            let strays = (0..cloud.positions.len() as u32).collect();
            return Projection {
                image: RangeImage::new(self.rows(), Vec::new()),
                strays,
                ..Projection::default()
            };
        }
        let spans = columns.iter().map(|column| column.span.packed());
        let spans: Vec<u32> = if self.build.timing.is_interpolated() { spans.collect() } else { Vec::new() };
        let mut image = RangeImage::new(self.rows(), columns.iter().map(|column| column.tick).collect());
        image.spans = spans;
        let mut point_of_cell = Grid::new(self.rows(), columns.len());
        let mut is_stray = vec![true; cloud.positions.len()];
        // The cells of the places, if there are echoes, which need them.
        let mut cells = vec![None; if echoes.is_empty() { 0 } else { places.len() }];
        for (number, column) in columns.iter().enumerate() {
            for index in column.places.clone() {
                let place = &places[index];
                let row = place.row as usize;
                let tick = self.tick_of_slot(place.slot as usize, row, column.tick, column.span);
                if let Some(steps) = self.steps_at(tick, place, &cloud.positions, reach) {
                    if let Some(cell) = cells.get_mut(index) {
                        *cell = Some((row * columns.len() + number) as u32);
                    }
                    image.steps[(row, number)] = steps;
                    point_of_cell[(row, number)] = place.point;
                    is_stray[place.point as usize] = false;
                }
            }
        }
        let mut found: Vec<(Echo, u32)> = echoes
            .into_iter()
            .filter_map(|(of, place)| {
                let cell = cells[of]?;
                let column = &columns[cell as usize % columns.len()];
                let tick = self.tick(place.row as usize, column.tick, column.span);
                let steps = self.steps_at(tick, &place, &cloud.positions, reach)?;
                Some((Echo { cell, steps }, place.point))
            })
            .collect();
        // The sort is stable: the echoes of a cell keep their order.
        found.sort_by_key(|(echo, _)| echo.cell);
        found.iter().for_each(|(_, point)| is_stray[*point as usize] = false);
        let point_of_echo;
        (image.echoes, point_of_echo) = found.into_iter().unzip();
        let strays =
            (0u32..).zip(is_stray).filter(|(_, is_stray)| *is_stray).map(|(point, _)| point).collect();
        Projection { image, point_of_cell, point_of_echo, strays }
    }

    /// How many points the recipe reproduces to the last bit, and how many it explains, of those whose ticks
    /// are certain.
    pub(super) fn reproduced(&self, positions: &[[f32; 3]]) -> (usize, usize) {
        let places = self.places(positions, REACH + 0.5 * self.range_step_m());
        let is_reproduced = |place: &&Place| {
            let found = Return { row: place.row, column: 0, tick: place.tick, steps: place.steps, echo: 0 };
            self.reproduces(&found, &positions[place.point as usize].map(f64::from), 0..3)
        };
        let clear = || places.iter().filter(|place| place.slack == 0);
        (clear().filter(is_reproduced).count(), clear().count())
    }

    /// How many of these points the recipe explains.
    pub(super) fn explained(&self, positions: &[[f32; 3]]) -> usize {
        self.places(positions, REACH + 0.5 * self.range_step_m()).len()
    }

    /// The share of the points that the recipe explains, in a sample of those that have a direction.
    pub fn explained_share(&self, positions: &[[f32; 3]]) -> f64 {
        const SAMPLE: usize = 4000;
        let points: Vec<[f32; 3]> = positions.iter().filter(|point| has_direction(point)).copied().collect();
        let sample: Vec<[f32; 3]> = thinned(&points, SAMPLE).copied().collect();
        self.explained(&sample) as f64 / sample.len().max(1) as f64
    }

    /// The row and the column of a record, in a file in which every cell of an image of `width` columns is a
    /// record.
    #[inline]
    fn cell_of_record(&self, record: u32, width: u32) -> (u32, u32) {
        let rows = self.rows() as u32;
        match self.rows_of_lines.get((record / width) as usize) {
            Some(&row) => (row, record % width),
            None => (self.rows_of_slots[(record % rows) as usize], record / rows),
        }
    }

    /// The number of columns if every cell of the image is a record: then the row of a return follows from
    /// its record number. Without a blank, the number of records may be a multiple of the number of rows by
    /// chance, so all returns must be in their places.
    fn full_width(&self, places: &[Place], positions: &[[f32; 3]]) -> Option<usize> {
        /// The minimum share of the returns in their places.
        const LEAST: f64 = 0.9;
        let records = positions.len();
        let width = records / self.rows();
        let is_whole = records > 0 && records == width * self.rows();
        let is_there = |place: &&Place| self.cell_of_record(place.point, width as u32).0 == place.row;
        let nothing = self.of_nothing();
        let is_blank = |p: &[f32; 3]| *p == nothing || *p == [0.0; 3] || p.iter().any(|v| !v.is_finite());
        let is_full = || {
            let least = if positions.iter().any(is_blank) { LEAST } else { 1.0 };
            places.iter().filter(is_there).count() as f64 >= least * places.len() as f64
        };
        (is_whole && !places.is_empty() && is_full()).then_some(width)
    }

    /// Projects a scan in which every cell is a record. Records that the recipe does not explain become
    /// blanks.
    fn project_full(
        &self,
        mut places: Vec<Place>,
        width: usize,
        positions: &[[f32; 3]],
        reach: f64,
    ) -> Projection {
        let cell = |place: &Place| self.cell_of_record(place.point, width as u32);
        places.retain(|place| cell(place).0 == place.row);
        // A file that holds firing after firing has this order already.
        if !self.rows_of_lines.is_empty() {
            places.sort_by_key(|place| (cell(place).1, place.slot));
        }
        let mut columns = Vec::with_capacity(width);
        let (mut rest, mut ticks) = (0, Vec::new());
        for number in 0..width as u32 {
            let own = places[rest..].iter().take_while(|place| cell(place).1 == number);
            ticks.clear();
            ticks.extend(own.map(|place| place.column_tick));
            let end = rest + ticks.len();
            ticks.sort_unstable();
            let most = ticks.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
            let tick = most.map_or(UNKNOWN, |same| same[0]);
            columns.push(Column { places: rest..end, tick, span: Span::default() });
            rest = end;
        }
        if self.build.timing.is_interpolated() {
            self.find_spans(&places, &mut columns, self.usual_span(&places));
        }
        self.fill_in_ticks(&mut columns);
        let mut image = RangeImage::new(self.rows(), columns.iter().map(|column| column.tick).collect());
        if self.build.timing.is_interpolated() {
            image.spans = columns.iter().map(|column| column.span.packed()).collect();
        }
        image.is_full = true;
        let mut point_of_cell = Grid::new(self.rows(), width);
        let mut records = 0u32..;
        if self.rows_of_lines.is_empty() {
            for column in 0..width {
                for (row, record) in self.rows_of_slots.iter().zip(&mut records) {
                    point_of_cell[(*row as usize, column)] = record;
                }
            }
        } else {
            for row in &self.rows_of_lines {
                let cells = point_of_cell.row_mut(*row as usize);
                cells.iter_mut().zip(&mut records).for_each(|(cell, record)| *cell = record);
            }
        }
        for (number, column) in columns.iter().enumerate() {
            for place in &places[column.places.clone()] {
                let tick = self.tick(place.row as usize, column.tick, column.span);
                if let Some(steps) = self.steps_at(tick, place, positions, reach) {
                    image.steps[(place.row as usize, number)] = steps;
                }
            }
        }
        Projection { image, point_of_cell, ..Projection::default() }
    }

    /// Fills in the ticks of columns without a return, as if the scanner turned evenly.
    fn fill_in_ticks(&self, columns: &mut [Column]) {
        let known = |column: &Column| (column.tick != UNKNOWN).then_some(column.tick);
        let mut steps: Vec<u32> = columns
            .windows(2)
            .filter_map(|pair| Some(self.ticks_from(known(&pair[0])?, known(&pair[1])?)))
            .collect();
        steps.sort_unstable();
        let step = steps.get(steps.len() / 2).copied().unwrap_or(0);
        let first = columns.iter().position(|column| column.tick != UNKNOWN);
        let before = first.map_or(0, |first| {
            let passed = (first as u64 + 1) * u64::from(step) % u64::from(self.build.ticks);
            self.ticks_from(passed as u32, columns[first].tick)
        });
        columns.iter_mut().fold(before, |last, column| {
            if column.tick == UNKNOWN {
                column.tick = (last + step) % self.build.ticks;
            }
            column.tick
        });
    }

    /// The places of the points that the recipe explains, in the order of the file.
    pub(super) fn places(&self, positions: &[[f32; 3]], reach: f64) -> Vec<Place> {
        match self.build.mounting {
            None => dispatch(Search::<false> { scanner: self, positions, reach }),
            Some(_) => dispatch(Search::<true> { scanner: self, positions, reach }),
        }
    }

    /// The place of a point, given its return.
    #[inline(always)]
    fn place(&self, point: u32, &Return { row, tick, steps, .. }: &Return) -> Place {
        let column_tick = self.within_turn(tick + self.lag(row as usize));
        Place { point, row, slot: self.slots_of_rows[row as usize], tick, column_tick, steps, slack: 0 }
    }

    /// Splits places into columns: a new one begins where the slots start again, or where the tick changes.
    pub(super) fn columns(&self, places: &[Place]) -> Vec<Column> {
        let span = self.usual_span(places);
        let pace = (span, self.firing(span));
        let mut columns: Vec<Column> = Vec::new();
        // The last place of a column, and the last one of those whose ticks are surest.
        let mut last: Option<(&Place, &Place)> = None;
        for (number, place) in places.iter().enumerate() {
            let known = last.filter(|(last, sure)| place.slot > last.slot && self.goes_on(sure, place, pace));
            match columns.last_mut().filter(|_| known.is_some()) {
                Some(column) => column.places.end = number + 1,
                None => columns.push(Column {
                    places: number..number + 1,
                    tick: place.column_tick,
                    span: Span::default(),
                }),
            }
            let sure = known.map(|(_, sure)| sure).filter(|sure| sure.slack < place.slack);
            last = Some((place, sure.unwrap_or(place)));
        }
        if self.build.timing.is_interpolated() {
            self.find_spans(places, &mut columns, span);
        } else if Blur::of(self.build.coordinates).is_any() {
            self.settle_ticks(places, &mut columns);
        }
        columns
    }

    /// Splits places into columns if the file holds row after row: those with the same tick are one column
    /// or, if the azimuth advances while lasers fire, those whose firings began at about the same tick.
    /// Returns the places column by column.
    fn columns_of_lines(
        &self,
        places: Vec<Place>,
        echoes: Vec<(usize, Place)>,
    ) -> (Vec<Place>, Vec<(usize, Place)>, Vec<Column>) {
        let (ticks, firing) = self.unrolled(&places);
        let firings = self.build.timing.firings(self.rows()).max(1);
        let (span, near) = match self.build.timing.is_interpolated() {
            true => ((firing * i64::from(firings)) as f64, 0.5 * firing as f64),
            false => (0.0, 0.0),
        };
        let begun = |at: usize| ticks[at] as f64 - self.passed(0, places[at].slot) * span;
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by(|&a, &b| begun(a).total_cmp(&begun(b)).then(places[a].slot.cmp(&places[b].slot)));
        let mut columns: Vec<std::ops::Range<usize>> = Vec::new();
        // For each slot, the number of columns up to and including the last one with a place of this slot.
        let mut taken = vec![0; self.rows()];
        for (number, &at) in order.iter().enumerate() {
            let taken = &mut taken[places[at].slot as usize];
            let is_near = |column: &std::ops::Range<usize>| begun(at) - begun(order[column.start]) <= near;
            let goes_on = columns.last().is_some_and(is_near) && *taken < columns.len();
            match columns.last_mut().filter(|_| goes_on) {
                Some(column) => column.end = number + 1,
                None => columns.push(number..number + 1),
            }
            *taken = columns.len();
        }
        for column in &columns {
            order[column.clone()].sort_by_key(|&at| places[at].slot);
        }
        let mut new_places = vec![0; places.len()];
        order.iter().enumerate().for_each(|(new, &at)| new_places[at] = new);
        let echoes = echoes.into_iter().map(|(of, place)| (new_places[of], place)).collect();
        let places: Vec<Place> = order.into_iter().map(|at| places[at]).collect();
        let column = |of: std::ops::Range<usize>| Column {
            tick: places[of.start].column_tick,
            places: of,
            span: Span::default(),
        };
        let mut columns: Vec<Column> = columns.into_iter().map(column).collect();
        if self.build.timing.is_interpolated() {
            self.find_spans(&places, &mut columns, span);
        }
        (places, echoes, columns)
    }

    /// For the places of rows that follow one another, the ticks since the scan began, which may exceed a
    /// turn; and the usual number of ticks from firing to firing.
    fn unrolled(&self, places: &[Place]) -> (Vec<i64>, i64) {
        /// A step of more than this fraction of a turn is a step back.
        const BACK: f64 = 0.98;
        let turn = self.build.ticks;
        let of_rows = || places.chunk_by(|a, b| a.row == b.row);
        let steps = of_rows().flat_map(|row| row.windows(2));
        let steps = steps.map(|pair| self.turned(pair[0].column_tick, pair[1].column_tick));
        let (rising, falling): (Vec<i64>, Vec<i64>) = steps.partition(|step| *step > 0);
        let is_falling = rising.len() < falling.len();
        let mut steps = if is_falling { falling } else { rising };
        let middle = steps.len() / 2;
        let firing = if steps.is_empty() { 0 } else { steps.select_nth_unstable(middle).1.abs() };
        let along = |tick: u32| if is_falling { (turn - tick) % turn } else { tick };
        // Rows begin about where the scan does: behind the widest gap between their first ticks.
        let mut firsts: Vec<u32> = of_rows().map(|row| along(row[0].column_tick)).collect();
        firsts.sort_unstable();
        let before = firsts.last().into_iter().chain(&firsts);
        let gaps = before.zip(&firsts).map(|(before, first)| (self.ticks_from(*before, *first), *first));
        let (_, start) = gaps.max_by_key(|(gap, _)| *gap).unwrap_or_default();
        let mut ticks = Vec::with_capacity(places.len());
        for row in of_rows() {
            let (mut last, mut passed) = (None, 0);
            for place in row {
                let tick = along(place.column_tick);
                let step = self.ticks_from(last.unwrap_or(start), tick);
                let is_back = last.is_some() && f64::from(step) > BACK * f64::from(turn);
                passed += i64::from(step) - if is_back { i64::from(turn) } else { 0 };
                ticks.push(passed);
                last = Some(tick);
            }
        }
        (ticks, firing)
    }

    /// The part of a block that has passed at a slot of a firing.
    #[inline]
    pub(super) fn passed(&self, firing: u32, slot: u32) -> f64 {
        let place = firing as usize * self.rows() + slot as usize;
        self.passed.parts.get(place).copied().unwrap_or(0.0)
    }

    /// Ticks from one tick to another, the shorter way round.
    #[inline]
    pub(super) fn turned(&self, from: u32, to: u32) -> i64 {
        shorter_way(i64::from(to) - i64::from(from), i64::from(self.build.ticks))
    }

    /// Ticks from one tick to another, forwards.
    fn ticks_from(&self, from: u32, to: u32) -> u32 {
        (to + self.build.ticks - from) % self.build.ticks
    }
}

/// Places without those that repeat the row and the tick of the place before: these are its echoes, each
/// returned with the index of that place among the remaining ones.
pub(super) fn without_echoes(places: Vec<Place>) -> (Vec<Place>, Vec<(usize, Place)>) {
    // Most scans have none.
    if places.windows(2).all(|pair| (pair[0].row, pair[0].tick) != (pair[1].row, pair[1].tick)) {
        return (places, Vec::new());
    }
    let (mut first, mut echoes): (Vec<Place>, Vec<(usize, Place)>) =
        (Vec::with_capacity(places.len()), Vec::new());
    for place in places {
        match first.last() {
            Some(last) if (last.row, last.tick) == (place.row, place.tick) => {
                echoes.push((first.len() - 1, place))
            }
            _ => first.push(place),
        }
    }
    (first, echoes)
}

/// The index of the nearest of some descending values.
pub(super) fn nearest(falling: &[f64], value: f64) -> usize {
    let after = falling.partition_point(|&other| other > value);
    match after {
        0 => 0,
        _ if after == falling.len() => after - 1,
        _ if falling[after - 1] - value < value - falling[after] => after - 1,
        _ => after,
    }
}
