//! Points one by one, for scans without a scanner model and for the strays of others. FORMAT.md 8.4.
//!
//! A point that is the same as an earlier one to the bit is coded as its repeat. All others are told which
//! point their laser measured before, and predicted from that one and from how other lasers have turned
//! since: first the larger horizontal coordinate, then the other one in the expected direction, then the
//! height at the resulting distance.

mod predecessors;
mod repeats;
mod site;
mod trails;

use repeats::{Repeat, RepeatModel, Source};
use site::{DETAILS, Expected, Parallax, Place, Site, finite};
use trails::{TrailModel, Trails};

use crate::entropy::{AdaptiveBit, ArithmeticEncoder, BitCoder, MixedBits, code_below_highest};
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::Channel;
use crate::scanner::CoordinateGrid;

/// The adaptive models of points.
#[derive(Clone, Default)]
pub struct PointModel {
    repeats: RepeatModel,
    trails: TrailModel,
    /// Of points that continue a trail, and of those that begin one. Large, so there are none before the
    /// first point.
    coordinates: Option<Box<[[CoordinateModel; 3]; 2]>>,
    parallax: Parallax,
}

/// The grids of x, y and z.
pub type Grids = [CoordinateGrid; 3];

/// What an encoder finds out about positions before they are coded. That of a decoder, which knows nothing,
/// is empty.
#[derive(Clone, Debug)]
pub struct Analysis {
    grids: Grids,
    repeats: Vec<Repeat>,
    /// For each point that is not a repeat, the index of its predecessor on the same trail; both count such
    /// points only.
    before: Vec<Option<usize>>,
    /// If channels may tell the trails: about the number of bytes by the best channel, and by the order of
    /// the points.
    pub sizes_by: Option<TrailSizes>,
}

impl Default for Analysis {
    fn default() -> Self {
        Analysis {
            grids: [CoordinateGrid::Float32; 3],
            repeats: Vec::new(),
            before: Vec::new(),
            sizes_by: None,
        }
    }
}

/// About the number of bytes of some points, by what tells their trails.
#[derive(Clone, Copy, Debug)]
pub struct TrailSizes {
    /// A channel that names lasers.
    pub channel: usize,
    /// The order of the points.
    pub order: usize,
}

/// What is known of a point besides its position, once it is coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointTrail {
    /// The number of its trail, counted from 1; 0 if it repeats another point.
    pub row: u32,
    /// The index of the point before it in its trail, or of the one that it repeats.
    pub before: Option<usize>,
}

impl PointTrail {
    /// The index of the point that it repeats, if it does.
    pub fn source(&self) -> Option<usize> {
        self.before.filter(|_| self.row == 0)
    }
}

/// The indices of the points that are not repeats.
fn not_repeated<T>(points: &[T], is_own: impl Fn(&T) -> bool) -> Vec<usize> {
    (0..points.len()).filter(|&index| is_own(&points[index])).collect()
}

/// The number of points from whose size that of all is estimated.
const SAMPLE: usize = 4 * predecessors::BLOCK;

impl PointModel {
    /// For an encoder: what `code` needs to know about positions before it codes them. Most of them are on
    /// `grid`; `None` means that their grids are found. A channel of these points may tell which laser measured them.
    pub fn analyse(
        &self,
        grid: Option<CoordinateGrid>,
        positions: &[[f32; 3]],
        channels: &[Channel],
    ) -> Analysis {
        let grids = grid.map_or_else(|| CoordinateGrid::of_most(positions), |grid| [grid; 3]);
        let repeats = repeats::find(positions);
        let own = not_repeated(&repeats, |repeat| *repeat == Repeat::No);
        let (before, sizes_by) = self.find_trails(grids, positions, channels, &own);
        Analysis { grids, repeats, before, sizes_by }
    }

    /// Codes positions one after the other. Their grids, unless one is given, come first. An encoder passes
    /// the analysis of these positions. Returns what is known of each point from then on.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Option<CoordinateGrid>,
        positions: &mut [[f32; 3]],
        analysis: &Analysis,
    ) -> Vec<PointTrail> {
        let grids = grid.map_or_else(|| code_grids(coder, analysis.grids), |grid| [grid; 3]);
        let sources = self.repeats.code(coder, positions.len(), &analysis.repeats);
        let own = not_repeated(&sources, Option::is_none);
        let mut trails = self.code_own(coder, grids, positions, &own, &analysis.before);
        for (index, source) in sources.iter().enumerate() {
            let Some(source) = source else { continue };
            positions[index] = source.position(positions);
            if let Source::Point(before) = *source {
                trails[index].before = Some(before);
            }
        }
        trails
    }

    /// About the number of bytes that `code` would take.
    pub fn size_of(&self, positions: &[[f32; 3]], analysis: &Analysis) -> usize {
        let mut encoder = ArithmeticEncoder::default();
        let sources = self.repeats.clone().code(&mut encoder, positions.len(), &analysis.repeats);
        let own = not_repeated(&sources, Option::is_none);
        encoder.finish().len() + self.size_of_own(analysis.grids, positions, &own, &analysis.before)
    }

    /// For an encoder: the number of the point before each of the points `own` in its trail, by the way that
    /// takes the fewest bytes, and the bytes that decided it.
    fn find_trails(
        &self,
        grids: Grids,
        positions: &[[f32; 3]],
        channels: &[Channel],
        own: &[usize],
    ) -> (Vec<Option<usize>>, Option<TrailSizes>) {
        let size = |known: &Vec<Option<usize>>| self.size_of_own(grids, positions, own, known);
        let by_channels = predecessors::by_channels(channels, positions.len(), own);
        let sized = by_channels.into_iter().map(|known| (size(&known), known));
        let Some((channel, by_channel)) = sized.min_by_key(|(size, _)| *size) else {
            return (predecessors::by_order(positions, own), None);
        };
        let order = size(&predecessors::by_order(positions, &own[..own.len().min(SAMPLE)]));
        let before = if channel < order { by_channel } else { predecessors::by_order(positions, own) };
        (before, Some(TrailSizes { channel, order }))
    }

    /// About the number of bytes of the points `own`, from the first of them.
    fn size_of_own(
        &self,
        grids: Grids,
        positions: &[[f32; 3]],
        own: &[usize],
        known: &[Option<usize>],
    ) -> usize {
        let sample = &own[..own.len().min(SAMPLE)];
        let mut encoder = ArithmeticEncoder::default();
        let end = sample.last().map_or(0, |last| last + 1);
        self.clone().code_own(&mut encoder, grids, &mut positions[..end].to_vec(), sample, known);
        encoder.finish().len() * own.len() / sample.len().max(1)
    }

    /// Codes the points `own`; an encoder knows the number of the point before each in its trail.
    fn code_own<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grids: Grids,
        positions: &mut [[f32; 3]],
        own: &[usize],
        known: &[Option<usize>],
    ) -> Vec<PointTrail> {
        let mut known_trails = vec![PointTrail::default(); positions.len()];
        let mut trails = Trails::default();
        let mut places: Vec<Place> = Vec::with_capacity(own.len());
        for (point, &index) in own.iter().enumerate() {
            if coder.is_exhausted() {
                break;
            }
            let known = known.get(point).copied().flatten();
            let continues = trails.code(coder, &mut self.trails, point, known);
            positions[index] =
                self.code_point(coder, grids, &mut trails, &mut places, continues, positions[index]);
            let number = trails.current().map_or(0, |trail| trail.number);
            let before = places.get(point).and_then(|place| place.before).map(|before| own[before]);
            known_trails[index] = PointTrail { row: u32::from(number) + 1, before };
        }
        known_trails
    }

    /// Codes a point in the current trail: FORMAT.md 8.4, Coordinates.
    fn code_point<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grids: Grids,
        trails: &mut Trails,
        places: &mut Vec<Place>,
        continues: bool,
        mut position: [f32; 3],
    ) -> [f32; 3] {
        let Some(trail) = trails.current() else { return position };
        let site = Site::of(places, continues.then_some(trail.last), &self.parallax);
        let models = &mut self.coordinates.get_or_insert_default()[usize::from(!continues)];
        let [larger, smaller, height] = models;
        let [larger_error, smaller_error, height_error] = &mut trail.errors;

        let direction = site.direction();
        let [major, minor] = if direction[0].abs() >= direction[1].abs() { [0, 1] } else { [1, 0] };
        let share = direction[major];
        let expected = site.larger_coordinate(share);
        position[major] = larger.code(coder, grids[major], expected, larger_error, position[major]);

        let expected = site.smaller_coordinate(finite(position)[major], major, share);
        position[minor] = smaller.code(coder, grids[minor], expected, smaller_error, position[minor]);

        let [last, _] = trail.last;
        let own = Place::of(position, continues.then_some(last));
        let features = site.features(&own);
        let expected = site.height(&own, &features, &trail.cone);
        position[2] = height.code(coder, grids[2], expected, height_error, position[2]);

        let own = own.with_height(position[2]);
        if continues {
            site.teach(own, &features, &mut trail.cone, &mut self.parallax);
            trail.last = [places.len(), last];
        }
        places.push(own);
        position
    }
}

/// The recent error of a model that has seen none: a hundredth of a metre or so.
const FIRST_ERROR: f32 = -6.0;
/// Classes of errors, in bits.
const ERRORS: usize = 40;
/// Lengths of residuals, in bits.
const LENGTHS: usize = 64;

/// One coordinate against several predictions, of which the one with the smallest recent errors is used. A
/// coordinate off its grid is coded as any float32. The size of an error is the binary logarithm of metres, to
/// within one.
#[derive(Clone)]
struct CoordinateModel {
    /// The recent size of each prediction's errors.
    errors: [f32; 4],
    /// Whether a coordinate is off the grid, after one that was not, and after one that was.
    off_grid: [AdaptiveBit; 2],
    was_off: bool,
    raw: AdaptiveBit,
    /// The length of the residual.
    length: MixedBits<3, 8>,
    /// The bits below its highest.
    below: Vec<AdaptiveBit>,
}

impl Default for CoordinateModel {
    fn default() -> Self {
        let places = [ERRORS, ERRORS * ERRORS, DETAILS * ERRORS].map(|contexts| contexts * LENGTHS);
        CoordinateModel {
            errors: [FIRST_ERROR; 4],
            off_grid: [AdaptiveBit::default(); 2],
            was_off: false,
            raw: AdaptiveBit::default(),
            length: MixedBits::new(places, LENGTHS, 0.4, 0.0, 0.015),
            below: vec![AdaptiveBit::default(); 4 * LENGTHS],
        }
    }
}

impl CoordinateModel {
    /// Codes a coordinate. `trail_error`, the recent size of residuals in its trail, changes.
    fn code<C: BitCoder, const N: usize>(
        &mut self,
        coder: &mut C,
        mut grid: CoordinateGrid,
        Expected { predictions, detail }: Expected<N>,
        trail_error: &mut f32,
        value: f32,
    ) -> f32 {
        let best = (0..N).min_by(|&a, &b| self.errors[a].total_cmp(&self.errors[b])).unwrap_or(0);
        let unit_on = |grid: CoordinateGrid| {
            let fits = |unit: &i64| grid.value(*unit, predictions[best]).to_bits() == value.to_bits();
            grid.unit_in_file(value).filter(fits)
        };
        let mut unit = unit_on(grid);
        self.was_off = self.off_grid[usize::from(self.was_off)].code(coder, unit.is_none());
        if self.was_off {
            grid = CoordinateGrid::Float32;
            unit = unit_on(grid);
            if self.raw.code(coder, unit.is_none()) {
                return f32::from_bits(coder.code_plain(u64::from(value.to_bits()), 32) as u32);
            }
        }
        let predicted = grid.unit_of(predictions[best]);
        let step = grid.step_exponent(predictions[best]);
        let class = |error: f32| ((error - step as f32) as usize).min(ERRORS - 1);
        let (own, of_trail) = (class(self.errors[best]), class(*trail_error));
        let both = class(0.5 * (self.errors[best] + *trail_error));
        let contexts = [own, of_trail * ERRORS + own, detail * ERRORS + both];
        let residual = zigzag(unit.unwrap_or(0).wrapping_sub(predicted)) & (u64::MAX >> 1);
        let length = self.code_length(coder, contexts, u64::BITS - residual.leading_zeros());
        let below = &mut self.below[4 * length as usize..][..4];
        let residual = code_below_highest(below, coder, length, residual);
        let unit = predicted.wrapping_add(unzigzag(residual));
        for (error, prediction) in self.errors.iter_mut().zip(predictions) {
            let off = unit.wrapping_sub(grid.unit_of(prediction)).unsigned_abs();
            let size = (u64::BITS - off.leading_zeros()) as i32 + grid.step_exponent(prediction);
            *error = 0.9 * *error + 0.1 * size as f32;
        }
        let off = unit.wrapping_sub(predicted).unsigned_abs();
        let size = (u64::BITS - off.leading_zeros()) as i32 + step;
        *trail_error = 0.7 * *trail_error + 0.3 * size as f32;
        grid.value(unit, predictions[best])
    }

    /// Codes the length of a residual, in bits.
    fn code_length<C: BitCoder>(&mut self, coder: &mut C, contexts: [usize; 3], length: u32) -> u32 {
        let mut node = 1;
        for bit in (0..LENGTHS.ilog2()).rev() {
            let places = contexts.map(|context| context * LENGTHS + node);
            let bit = self.length.code(coder, node, &places, 0.0, length >> bit & 1 == 1);
            node = node << 1 | usize::from(bit);
        }
        (node - LENGTHS) as u32
    }
}

/// Codes the grids of the axes: one, if they are the same.
fn code_grids<C: BitCoder>(coder: &mut C, grids: Grids) -> Grids {
    let differ = coder.code_plain(u64::from(grids != [grids[0]; 3]), 1) == 1;
    let first = code_grid(coder, grids[0]);
    if differ { [first, code_grid(coder, grids[1]), code_grid(coder, grids[2])] } else { [first; 3] }
}

/// Codes a grid by its numbers; those of none stand for `Float32`.
fn code_grid<C: BitCoder>(coder: &mut C, grid: CoordinateGrid) -> CoordinateGrid {
    let (kind, step) = grid.to_numbers();
    let kind = coder.code_plain(kind.into(), 3) as u32;
    let step = if kind < 2 { 0 } else { coder.code_plain(step.into(), 30) as u32 };
    CoordinateGrid::from_numbers(kind, step).unwrap_or(CoordinateGrid::Float32)
}
