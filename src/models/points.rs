//! Points one by one, for scans without a scanner model and for the strays of others. FORMAT.md 8.4.
//!
//! A point that is the same as an earlier one to the bit is coded as its repeat. All others are told which point their
//! laser measured before, and predicted from that one and from how other lasers have turned since: first the larger
//! horizontal coordinate, then the other one in the expected direction, then the height at the resulting distance.

mod predecessors;
mod repeats;
mod trails;

use repeats::{RepeatModel, Source};
use trails::{TrailModel, Trails};

use super::least_squares::LeastSquares;
use crate::entropy::{AdaptiveBit, ArithmeticEncoder, BitCoder, MixedBits, code_below_highest};
use crate::ground::varint::{unzigzag, zigzag};
use crate::scan::Channel;
use crate::scanner::Coordinates;

/// The adaptive models of points.
#[derive(Clone, Default)]
pub struct PointModel {
    repeats: RepeatModel,
    trails: TrailModel,
    /// Of points that continue a trail, and of those that begin one. Large, so there are none before the first point.
    coordinates: Option<Box<[[CoordinateModel; 3]; 2]>>,
    parallax: Parallax,
}

/// The indices of the points that are not repeats.
fn not_repeated(sources: &[Option<Source>]) -> Vec<usize> {
    (0..sources.len()).filter(|&index| sources[index].is_none()).collect()
}

/// What an encoder finds out about positions before they are coded.
#[derive(Clone, Debug)]
pub struct Analysis {
    grid: Coordinates,
    /// For each point that is not a repeat: the number, among these, of the point before it in its trail.
    before: Vec<Option<usize>>,
}

impl Default for Analysis {
    /// Of a decoder, which knows nothing.
    fn default() -> Self {
        Analysis { grid: Coordinates::Float32, before: Vec::new() }
    }
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

/// The coordinates of a point in other terms.
#[derive(Clone, Copy, Default)]
struct Place {
    position: [f64; 3],
    /// In radians.
    azimuth: f64,
    /// The distance from the vertical axis, in metres.
    distance: f64,
    /// The index of the point before it in its trail, if it continues one.
    before: Option<usize>,
}

impl Place {
    fn of(position: [f32; 3], before: Option<usize>) -> Self {
        let position = finite(position);
        let [x, y, _] = position;
        Place { position, azimuth: libm::atan2(y, x), distance: (x * x + y * y).sqrt(), before }
    }

    fn closeness(&self) -> f64 {
        closeness(self.distance)
    }
}

/// The reciprocal of a distance, limited to that of a centimetre.
fn closeness(distance: f64) -> f64 {
    1.0 / distance.max(0.01)
}

/// The number of points from whose size that of all is estimated.
const SAMPLE: usize = 4 * predecessors::BLOCK;

/// A difference of angles, in radians, as one of half a turn at most.
fn turned(angle: f64) -> f64 {
    const TURN: f64 = std::f64::consts::TAU;
    angle - TURN * crate::ground::rounding::round_ties_even(angle / TURN)
}

impl PointModel {
    /// For an encoder: what `code` needs to know about positions before it codes them. Most of them are on `grid`; `None`
    /// means one that is found. A channel of these points may tell which laser measured them.
    pub fn analyse(
        &self,
        grid: Option<Coordinates>,
        positions: &[[f32; 3]],
        channels: &[Channel],
    ) -> Analysis {
        let grid = grid.unwrap_or_else(|| Coordinates::of_most(positions));
        let sources = RepeatModel::default().code(&mut ArithmeticEncoder::default(), positions);
        let before = self.find_trails(grid, positions, channels, &not_repeated(&sources));
        Analysis { grid, before }
    }

    /// Codes positions one after the other. Their grid, if it is not given, comes first. An encoder passes the analysis
    /// of these positions. Returns what is known of each point from then on.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Option<Coordinates>,
        positions: &mut [[f32; 3]],
        analysis: &Analysis,
    ) -> Vec<PointTrail> {
        let grid = grid.unwrap_or_else(|| code_grid(coder, analysis.grid));
        let sources = self.repeats.code(coder, positions);
        let mut trails = self.code_own(coder, grid, positions, &not_repeated(&sources), &analysis.before);
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
        let sources = self.repeats.clone().code(&mut encoder, positions);
        let own = not_repeated(&sources);
        encoder.finish().len() + self.size_of_own(analysis.grid, positions, &own, &analysis.before)
    }

    /// For an encoder: the number of the point before each of the points `own` in its trail, by the way that takes the
    /// fewest bytes.
    fn find_trails(
        &self,
        grid: Coordinates,
        positions: &[[f32; 3]],
        channels: &[Channel],
        own: &[usize],
    ) -> Vec<Option<usize>> {
        let size = |known: &Vec<Option<usize>>| self.size_of_own(grid, positions, own, known);
        let by_channels = predecessors::by_channels(channels, positions.len(), own);
        let sized = by_channels.into_iter().map(|known| (size(&known), known));
        let by_channel = sized.min_by_key(|(size, _)| *size);
        let best = by_channel.filter(|(of_channel, _)| {
            let of_sample = predecessors::by_order(positions, &own[..own.len().min(SAMPLE)]);
            *of_channel < size(&of_sample)
        });
        best.map_or_else(|| predecessors::by_order(positions, own), |(_, known)| known)
    }

    /// About the number of bytes of the points `own`, from the first of them.
    fn size_of_own(
        &self,
        grid: Coordinates,
        positions: &[[f32; 3]],
        own: &[usize],
        known: &[Option<usize>],
    ) -> usize {
        let sample = &own[..own.len().min(SAMPLE)];
        let mut encoder = ArithmeticEncoder::default();
        let end = sample.last().map_or(0, |last| last + 1);
        self.clone().code_own(&mut encoder, grid, &mut positions[..end].to_vec(), sample, known);
        encoder.finish().len() * own.len() / sample.len().max(1)
    }

    /// Codes the points `own`; an encoder knows the number of the point before each in its trail.
    fn code_own<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Coordinates,
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
                self.code_point(coder, grid, &mut trails, &mut places, continues, positions[index]);
            let number = trails.current().map_or(0, |trail| trail.number);
            let before = places.get(point).and_then(|place| place.before).map(|before| own[before]);
            known_trails[index] = PointTrail { row: u32::from(number) + 1, before };
        }
        known_trails
    }

    /// Codes a point in the current trail.
    fn code_point<C: BitCoder>(
        &mut self,
        coder: &mut C,
        grid: Coordinates,
        trails: &mut Trails,
        places: &mut Vec<Place>,
        continues: bool,
        mut position: [f32; 3],
    ) -> [f32; 3] {
        let Some(trail) = trails.current() else { return position };
        let index = places.len();
        let at = |index: usize| places.get(index).copied().unwrap_or_default();
        let [last, earlier] = match continues {
            true => trail.last,
            false => [index.saturating_sub(1), index.saturating_sub(2)],
        };
        let (west, west2) = (at(last), at(earlier));
        let partners = Partners::of(places, last).filter(|_| continues);
        let [north, north_west] = partners.as_ref().map_or([west; 2], |partners| partners.nearest.map(at));
        let models = self.coordinates.get_or_insert_default();
        let [x_or_y, y_or_x, z] = &mut models[usize::from(!continues)];
        let [major_error, minor_error, z_error] = &mut trail.errors;

        // The expected direction, and the larger coordinate in it.
        let offset = self.parallax.offset();
        let step = self.parallax.step(north, north_west);
        let middle_step =
            partners.as_ref().map_or(step, |partners| partners.middle_step(places, &self.parallax));
        let azimuth = west.azimuth + step;
        let direction = [libm::cos(azimuth), libm::sin(azimuth)];
        let (major, minor) = if direction[0].abs() >= direction[1].abs() { (0, 1) } else { (1, 0) };
        let farther = [west.distance - west2.distance, north.distance - north_west.distance];
        let distances = [west.distance, west.distance + farther[0], west.distance + farther[1]];
        let predictions = distances.map(|distance| distance * direction[major]);
        let detail = farther.map(|farther| (exponent(farther) + 8).clamp(0, 7) as usize);
        let detail = detail[0] * 8 + detail[1];
        position[major] = x_or_y.code(coder, grid, predictions, (detail, major_error), position[major]);

        // The other one, in the direction that is expected at the resulting distance.
        let along = finite(position)[major];
        let closer = closeness(along / direction[major]) - west.closeness();
        let plain_step = turned(north.azimuth - north_west.azimuth);
        let azimuths = [
            azimuth + offset * closer,
            west.azimuth + middle_step + offset * closer,
            west.azimuth + plain_step,
            west.azimuth + turned(west.azimuth - west2.azimuth),
        ];
        let predictions = azimuths.map(|azimuth| {
            let direction = [libm::cos(azimuth), libm::sin(azimuth)];
            along * direction[minor] / direction[major]
        });
        let detail = (exponent(closer) + 22).clamp(0, 31) as usize;
        position[minor] = y_or_x.code(coder, grid, predictions, (detail, minor_error), position[minor]);

        // The height at this distance.
        let own = Place::of(position, continues.then_some(last));
        let steps: [f64; 3] = [
            own.distance - west.distance,
            own.position[0] - west.position[0],
            own.position[1] - west.position[1],
        ];
        let tenths = |metres: f64| (metres * 1e4).clamp(-1e7, 1e7) as f32;
        let features = [tenths(steps[0]), tenths(steps[1]), tenths(steps[2]), 1.0];
        let in_line = |place: Place| {
            if place.distance == 0.0 {
                place.position[2]
            } else {
                place.position[2] * (own.distance / place.distance)
            }
        };
        let height = west.position[2];
        let predictions = [
            height + f64::from(trail.cone.predict(&features)) / 1e4,
            in_line(west),
            in_line(west) + in_line(north) - in_line(north_west),
            2.0 * height - west2.position[2],
        ];
        let detail = (exponent(steps[0]) + 14).clamp(0, 31) as usize;
        position[2] = z.code(coder, grid, predictions, (detail, z_error), position[2]);

        let own = Place { position: finite(position), ..own };
        if continues {
            let shared = features[0] / 1000.0;
            trail.cone.learn(&features, tenths(own.position[2] - height), 1.0 / (1.0 + shared * shared));
            self.parallax.learn([own, west], [north, north_west]);
            trail.last = [index, last];
        }
        places.push(own);
        position
    }
}

/// The latest points of other lasers that were measured together with the coming one, as far as their predecessors were
/// measured together with its own.
struct Partners {
    /// The latest partner, and its predecessor.
    nearest: [usize; 2],
    /// Up to three.
    all: [[usize; 2]; 3],
    count: usize,
}

impl Partners {
    /// The partners of a point whose trail has `last` as its last point.
    fn of(places: &[Place], last: usize) -> Option<Self> {
        const FARTHEST: usize = 12;
        const MISSING: usize = 8;
        let mut partners = Partners { nearest: [0; 2], all: [[0; 2]; 3], count: 0 };
        let latest = places.iter().enumerate().rev().zip(1..=FARTHEST);
        for ((index, place), back) in latest {
            let Some(before) =
                place.before.filter(|&before| before < last && last - before <= back + MISSING)
            else {
                continue;
            };
            partners.all[partners.count] = [index, before];
            partners.count += 1;
            if partners.count == partners.all.len() {
                break;
            }
        }
        partners.nearest = partners.all[0];
        (partners.count > 0).then_some(partners)
    }

    /// The step of the middle one of three partners; if there are fewer, of the nearest.
    fn middle_step(&self, places: &[Place], parallax: &Parallax) -> f64 {
        let mut steps = self.all.map(|[index, before]| parallax.step(places[index], places[before]));
        if self.count < self.all.len() {
            return steps[0];
        }
        steps.sort_by(f64::total_cmp);
        steps[1]
    }
}

/// How far beside the origin the beams begin: for a moving scanner, or one that is not the origin, a laser's azimuth
/// changes with the distance of what it hits.
#[derive(Clone)]
struct Parallax(LeastSquares<4>);

impl Default for Parallax {
    fn default() -> Self {
        Parallax(LeastSquares::new(0.998).solved_every(1))
    }
}

impl Parallax {
    /// In metres, to the left of the direction.
    fn offset(&self) -> f64 {
        f64::from(self.0.predict(&[1.0, 0.0, 0.0, 0.0])).clamp(-3.0, 3.0)
    }

    /// How far a laser has turned between two points, in radians.
    fn step(&self, to: Place, from: Place) -> f64 {
        turned(to.azimuth - from.azimuth) - self.offset() * (to.closeness() - from.closeness())
    }

    /// Learns from a point, the one before it, and the same of another laser.
    fn learn(&mut self, [own, west]: [Place; 2], [north, north_west]: [Place; 2]) {
        /// In radians; what differs by more is not a matter of parallax.
        const LARGEST: f64 = 8e-4;
        let step = turned(own.azimuth - west.azimuth) - turned(north.azimuth - north_west.azimuth);
        if step.abs() < LARGEST {
            let closer = (own.closeness() - west.closeness()) - (north.closeness() - north_west.closeness());
            self.0.learn(&[(closer * 1e6) as f32, 0.0, 0.0, 0.0], (step * 1e6) as f32, 1.0);
        }
    }
}

/// The recent error of a model that has seen none: a hundredth of a metre or so.
const FIRST_ERROR: f32 = -6.0;
/// Classes of errors, in bits.
const ERRORS: usize = 40;
/// Classes of what else is known of a coordinate.
const DETAILS: usize = 64;
/// Lengths of residuals, in bits.
const LENGTHS: usize = 64;

/// One coordinate against several predictions, of which the one with the smallest recent errors is used. The size of an
/// error is the binary logarithm of metres, to within one.
#[derive(Clone)]
struct CoordinateModel {
    /// The recent size of each prediction's errors.
    errors: [f32; 4],
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
            raw: AdaptiveBit::default(),
            length: MixedBits::new(places, LENGTHS, 0.4, 0.0, 0.015),
            below: vec![AdaptiveBit::default(); 4 * LENGTHS],
        }
    }
}

impl CoordinateModel {
    /// Codes a coordinate. `detail` is what is known of it; `trail_error`, the recent size of residuals in its trail, changes.
    fn code<C: BitCoder, const N: usize>(
        &mut self,
        coder: &mut C,
        grid: Coordinates,
        predictions: [f64; N],
        (detail, trail_error): (usize, &mut f32),
        value: f32,
    ) -> f32 {
        let best = (0..N).min_by(|&a, &b| self.errors[a].total_cmp(&self.errors[b])).unwrap_or(0);
        let predicted = grid.unit_of(predictions[best]);
        let fits = |unit: &i64| grid.value(*unit, predictions[best]).to_bits() == value.to_bits();
        let unit = grid.unit_in_file(value).filter(fits);
        if self.raw.code(coder, unit.is_none()) {
            return f32::from_bits(coder.code_plain(u64::from(value.to_bits()), 32) as u32);
        }
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

/// Codes a grid by its numbers; those of none stand for `Float32`.
fn code_grid<C: BitCoder>(coder: &mut C, grid: Coordinates) -> Coordinates {
    let (kind, step) = grid.to_numbers();
    let kind = coder.code_plain(kind.into(), 3) as u32;
    let step = if kind < 2 { 0 } else { coder.code_plain(step.into(), 30) as u32 };
    Coordinates::from_numbers(kind, step).unwrap_or(Coordinates::Float32)
}

/// The exponent of a number's highest binary digit; -1023 for 0.
fn exponent(value: f64) -> i32 {
    (value.to_bits() >> 52 & 0x7ff) as i32 - 1023
}

/// A position to predict from; coordinates that are not finite count as 0.
fn finite(position: [f32; 3]) -> [f64; 3] {
    position.map(|v| if v.is_finite() { f64::from(v) } else { 0.0 })
}
