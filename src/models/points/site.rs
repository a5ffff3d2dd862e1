//! What is known around a point that is about to be coded, and where it is therefore expected. FORMAT.md 8.4,
//! Coordinates.

use crate::ground::floats::round_ties_even;
use crate::models::LeastSquares;

/// A position to predict from; coordinates that are not finite count as 0.
pub fn finite<const N: usize>(position: [f32; N]) -> [f64; N] {
    position.map(|v| if v.is_finite() { f64::from(v) } else { 0.0 })
}

/// The coordinates of a point in other terms.
#[derive(Clone, Copy, Default)]
pub struct Place {
    /// Finite.
    position: [f64; 3],
    /// In radians.
    azimuth: f64,
    /// The distance from the vertical axis, in metres.
    distance: f64,
    /// The index of the point before it in its trail, if it continues one.
    pub before: Option<usize>,
}

impl Place {
    pub fn of(position: [f32; 3], before: Option<usize>) -> Self {
        let position = finite(position);
        let [x, y, _] = position;
        Place { position, azimuth: libm::atan2(y, x), distance: (x * x + y * y).sqrt(), before }
    }

    /// The same place at another height, in metres.
    pub fn with_height(self, height: f32) -> Self {
        let [x, y, _] = self.position;
        let [z] = finite([height]);
        Place { position: [x, y, z], ..self }
    }

    fn closeness(&self) -> f64 {
        closeness(self.distance)
    }

    /// The height, in metres, on the line through the origin and this point, at this distance from the axis.
    fn height_at(&self, distance: f64) -> f64 {
        if self.distance == 0.0 { self.position[2] } else { self.position[2] * (distance / self.distance) }
    }
}

/// The reciprocal of a distance, limited to that of a centimetre.
fn closeness(distance: f64) -> f64 {
    1.0 / distance.max(0.01)
}

/// A difference of angles, in radians, as one of half a turn at most.
fn turned(angle: f64) -> f64 {
    const TURN: f64 = std::f64::consts::TAU;
    angle - TURN * round_ties_even(angle / TURN)
}

/// What a coordinate is expected to be.
pub struct Expected<const N: usize> {
    /// In metres, in several ways.
    pub predictions: [f64; N],
    /// What else is known, as a context below [`DETAILS`].
    pub detail: usize,
}

/// Number of contexts of what is known of a coordinate.
pub const DETAILS: usize = 64;

/// The class of a number by its size: below 2^(`smallest` + 1) it is class 0, below twice that class 1, and
/// so on.
fn size_class(value: f64, smallest: i32, classes: i32) -> usize {
    (exponent(value) - smallest).clamp(0, classes - 1) as usize
}

/// The exponent of a number's highest binary digit; -1023 for 0.
fn exponent(value: f64) -> i32 {
    (value.to_bits() >> 52 & 0x7ff) as i32 - 1023
}

/// The points around one that is about to be coded, as far as they are known.
pub struct Site {
    /// The point before it in its trail, and the one before that. If it begins a trail, the last two points.
    west: Place,
    west2: Place,
    /// The nearest partner and its predecessor.
    north: Place,
    north_west: Place,
    /// How far the laser is expected to have turned since `west`, in radians: as far as that of the nearest
    /// partner, and as that of the middle one of three.
    step: f64,
    middle_step: f64,
    /// In metres, the parallax.
    offset: f64,
}

impl Site {
    /// The surroundings of the next point, after `places`. `west` has the indices of the two points before it
    /// in its trail; `None` if it begins one.
    pub fn of(places: &[Place], west: Option<[usize; 2]>, parallax: &Parallax) -> Self {
        let next = places.len();
        let at = |index: usize| places.get(index).copied().unwrap_or_default();
        let [last, earlier] = west.unwrap_or([next.saturating_sub(1), next.saturating_sub(2)]);
        let (west, partners) = (at(last), west.and_then(|_| Partners::of(places, last)));
        let [north, north_west] = partners.as_ref().map_or([west; 2], |partners| partners.nearest.map(at));
        let step = parallax.step(north, north_west);
        let middle_step = partners.as_ref().map_or(step, |partners| partners.middle_step(places, parallax));
        Site { west, west2: at(earlier), north, north_west, step, middle_step, offset: parallax.offset() }
    }

    fn azimuth(&self) -> f64 {
        self.west.azimuth + self.step
    }

    /// The horizontal direction in which the point is expected: its cosine and sine.
    pub fn direction(&self) -> [f64; 2] {
        let (sin, cos) = libm::sincos(self.azimuth());
        [cos, sin]
    }

    /// The larger of the horizontal coordinates, given its share of the direction.
    pub fn larger_coordinate(&self, share: f64) -> Expected<3> {
        let farther =
            [self.west.distance - self.west2.distance, self.north.distance - self.north_west.distance];
        let distances = [0.0, farther[0], farther[1]].map(|farther| self.west.distance + farther);
        // From 4 mm to half a metre.
        let [own, of_partner] = farther.map(|farther| size_class(farther, -8, 8));
        Expected { predictions: distances.map(|distance| distance * share), detail: own * 8 + of_partner }
    }

    /// The smaller of the horizontal coordinates, given the larger one, its axis and its share of the
    /// direction.
    pub fn smaller_coordinate(&self, larger: f64, axis: usize, share: f64) -> Expected<4> {
        let Site { west, west2, north, north_west, .. } = self;
        let closer = closeness(larger / share) - west.closeness();
        let azimuths = [
            self.azimuth() + self.offset * closer,
            west.azimuth + self.middle_step + self.offset * closer,
            west.azimuth + turned(north.azimuth - north_west.azimuth),
            west.azimuth + turned(west.azimuth - west2.azimuth),
        ];
        let predictions = azimuths.map(|azimuth| {
            let (sin, cos) = libm::sincos(azimuth);
            if axis == 0 { larger * sin / cos } else { larger * cos / sin }
        });
        // From a quarter of a micrometre at a metre.
        Expected { predictions, detail: size_class(closer, -22, 32) }
    }

    /// How the point lies from `west`, as features of its height: farther, along x, along y, in tenths of a
    /// millimetre; and 1. Its height need not be known.
    pub fn features(&self, own: &Place) -> [f32; 4] {
        let along = |axis: usize| own.position[axis] - self.west.position[axis];
        [tenths(own.distance - self.west.distance), tenths(along(0)), tenths(along(1)), 1.0]
    }

    /// The height of a point whose horizontal coordinates are known, given how it changes along its laser's
    /// cone.
    pub fn height(&self, own: &Place, features: &[f32; 4], cone: &LeastSquares<4>) -> Expected<4> {
        let height = self.west.position[2];
        let [west, north, north_west] =
            [self.west, self.north, self.north_west].map(|place| place.height_at(own.distance));
        let predictions = [
            height + f64::from(cone.predict(features)) / TENTHS,
            west,
            west + north - north_west,
            2.0 * height - self.west2.position[2],
        ];
        // From 0.06 mm.
        Expected { predictions, detail: size_class(own.distance - self.west.distance, -14, 32) }
    }

    /// Learns from the point, if it continues a trail.
    pub fn teach(
        &self,
        own: Place,
        features: &[f32; 4],
        cone: &mut LeastSquares<4>,
        parallax: &mut Parallax,
    ) {
        let decimetres = features[0] / 1000.0;
        let rise = tenths(own.position[2] - self.west.position[2]);
        cone.learn(features, rise, 1.0 / (1.0 + decimetres * decimetres));
        parallax.learn([own, self.west], [self.north, self.north_west]);
    }
}

/// Tenths of a millimetre in a metre.
const TENTHS: f64 = 1e4;

/// A length in metres, of a kilometre at most, in tenths of a millimetre.
fn tenths(metres: f64) -> f32 {
    (metres * TENTHS).clamp(-1e7, 1e7) as f32
}

/// The latest points of other lasers that were measured together with the coming one, as far as their
/// predecessors were measured together with its own.
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

/// How far beside the origin the beams begin: for a moving scanner, or one that is not the origin, a laser's
/// azimuth changes with the distance of what it hits.
#[derive(Clone)]
pub struct Parallax(LeastSquares<1>);

impl Default for Parallax {
    fn default() -> Self {
        Parallax(LeastSquares::new(0.998).solved_every(1))
    }
}

impl Parallax {
    /// In metres, to the left of the direction.
    fn offset(&self) -> f64 {
        /// Farther than any scanner is mounted from the origin of a vehicle's frame.
        const FARTHEST: f64 = 3.0;
        f64::from(self.0.predict(&[1.0])).clamp(-FARTHEST, FARTHEST)
    }

    /// How far a laser has turned between two points, in radians.
    fn step(&self, to: Place, from: Place) -> f64 {
        turned(to.azimuth - from.azimuth) - self.offset() * (to.closeness() - from.closeness())
    }

    /// Learns from a point, the one before it, and the same of another laser.
    fn learn(&mut self, [own, west]: [Place; 2], [north, north_west]: [Place; 2]) {
        /// In radians; what differs by more is not a matter of parallax.
        const LARGEST: f64 = 8e-4;
        /// Makes the ridge of the least squares small beside the features.
        const SCALE: f64 = 1e6;
        let step = turned(own.azimuth - west.azimuth) - turned(north.azimuth - north_west.azimuth);
        if step.abs() < LARGEST {
            let closer = (own.closeness() - west.closeness()) - (north.closeness() - north_west.closeness());
            self.0.learn(&[(closer * SCALE) as f32], (step * SCALE) as f32, 1.0);
        }
    }
}
