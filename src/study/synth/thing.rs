//! The objects that stand and drive in the street, and how a ray hits them.

use super::ray::{Hit, Ray, Span, through_box, through_cylinder, through_ellipsoid};
use crate::ground::random::{Rng, hash, unit};

/// An object in the street.
#[derive(Clone, Debug)]
pub(super) struct Thing {
    /// What it is.
    pub kind: Kind,
    /// The position of its centre on the ground, in metres.
    pub place: [f64; 3],
    /// Cosine and sine of the angle by which it is rotated about the vertical.
    pub heading: [f64; 2],
    /// Share of the light that returns.
    pub reflectivity: f64,
}

/// The kind of an object. Lengths are in metres, in the object's own axes.
#[derive(Clone, Debug)]
pub(super) enum Kind {
    /// A passenger car of this half length and half width, along its x axis.
    Car { half: [f64; 2] },
    /// A house whose front is the plane y = 0, and which extends towards smaller y.
    House { half_width: f64, depth: f64, height: f64, seed: u64 },
    /// A low wall, a sign, the body of a lorry.
    Block { half: [f64; 2], height: [f64; 2] },
    /// A pole or a trunk.
    Pole { radius: f64, height: f64 },
    /// A hedge, a bush or the crown of a tree: random twigs in an ellipsoid, `gap` metres apart along a ray
    /// on average.
    Foliage { centre: f64, half: [f64; 3], gap: f64 },
}

impl Thing {
    /// The first surface that the ray hits, if there is one.
    pub(super) fn hit(&self, ray: &Ray, rng: &mut Rng) -> Option<Hit> {
        let ray = ray.seen_from(self.place, self.heading[0], self.heading[1]);
        let plain = |span: Span| Hit::plain(span.enter, span.incidence, self.reflectivity);
        let hit = match self.kind {
            Kind::Car { half } => car(&ray, half, self.reflectivity),
            Kind::House { half_width, depth, height, seed } => {
                house(&ray, [half_width, depth, height], seed, self.reflectivity)
            }
            Kind::Block { half: [x, y], height: [low, high] } => {
                through_box(&ray, [-x, -y, low], [x, y, high]).map(plain)
            }
            Kind::Pole { radius, height } => through_cylinder(&ray, radius, [-0.5, height]).map(plain),
            Kind::Foliage { centre, half, gap } => through_ellipsoid(&ray, [0.0, 0.0, centre], half)
                .and_then(|span| foliage(span, gap, self.reflectivity, rng)),
        };
        hit.filter(|hit| hit.distance > 0.0)
    }

    /// The radius of a circle on the plan, around the object's position, that contains all of it, in metres.
    pub(super) fn radius(&self) -> f64 {
        match self.kind {
            Kind::Car { half: [x, y] } | Kind::Block { half: [x, y], .. } => libm::sqrt(x * x + y * y),
            Kind::House { half_width, depth, .. } => libm::sqrt(half_width * half_width + depth * depth),
            Kind::Pole { radius, .. } => radius,
            Kind::Foliage { half: [x, y, _], .. } => x.max(y),
        }
    }
}

/// The nearer of two hits.
pub(super) fn nearer(a: Option<Hit>, b: Option<Hit>) -> Option<Hit> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.distance < a.distance { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Heights of a car's underside and of its belt line, where the windows begin.
const SILL: f64 = 0.25;
const BELT: f64 = 0.9;
/// Radius of the rounded edges of a car's body, in metres.
const ROUNDING: f64 = 0.12;

/// A rounded body, with a dome of glass and a roof on top.
fn car(ray: &Ray, half: [f64; 2], paint: f64) -> Option<Hit> {
    let [x, y] = half;
    let body = through_box(ray, [-x, -y, SILL], [x, y, BELT]).map(|span| car_body(ray, span, half, paint));
    let dome = through_ellipsoid(ray, [-0.1 * x, 0.0, BELT - 0.1], [0.66 * x, 0.88 * y, 0.68])
        .filter(|span| ray.at(span.enter)[2] > BELT - 0.05)
        .map(|span| {
            let roof = ray.at(span.enter)[2] > 1.35;
            if roof {
                Hit::plain(span.enter, span.incidence, paint)
            } else {
                Hit::glass(span.enter, span.incidence, 0.93)
            }
        });
    nearer(body, dome)
}

fn car_body(ray: &Ray, span: Span, half: [f64; 2], paint: f64) -> Hit {
    let [x, y, z] = ray.at(span.enter);
    let across = if span.axis == 0 { y / half[1] } else { x / half[0] };
    let upright = (z - SILL) / (BELT - SILL) * 2.0 - 1.0;
    let bend = fourth(across) + fourth(upright) * f64::from(u8::from(span.axis != 2));
    // Number plates and lamps: reflectors on the front and the back.
    let reflector =
        span.axis == 0 && (0.45..0.57).contains(&z) && (y.abs() < 0.26 || y.abs() > 0.8 * half[1]);
    let reflectivity = if reflector { 2.5 } else { paint };
    Hit::plain(span.enter + ROUNDING * bend, span.incidence.max(0.1), reflectivity)
}

fn fourth(v: f64) -> f64 {
    v * v * v * v
}

/// Windows repeat at this distance, along the front and from floor to floor, in metres.
const BAY: f64 = 2.9;
const FLOOR: f64 = 2.8;

/// A house: a box with windows and doors set back into its front.
fn house(ray: &Ray, [half_width, depth, height]: [f64; 3], seed: u64, tone: f64) -> Option<Hit> {
    let span = through_box(ray, [-half_width, 0.0, -1.0], [half_width, depth, height])?;
    let wall = Hit::plain(span.enter, span.incidence, tone);
    if span.axis != 1 || ray.direction[1] < 0.0 {
        return Some(wall);
    }
    let [x, _, z] = ray.at(span.enter);
    match opening(x, z, half_width, seed) {
        Some(niche) => Some(niche.look(ray, tone)),
        // Plinths, frames and drainpipes, as a front does not have a single colour.
        None if z < 0.5 => Some(Hit { reflectivity: 0.6 * tone, ..wall }),
        None => Some(wall),
    }
}

/// The opening of a window or a door in a front: a niche with a pane at its back.
struct Niche {
    low: [f64; 3],
    high: [f64; 3],
    /// Share of the pulses that the pane does not return: small if there are curtains.
    loss: f64,
}

/// The opening in the front at a position, if there is one.
fn opening(x: f64, z: f64, half_width: f64, seed: u64) -> Option<Niche> {
    let (bay, floor) = (libm::floor(x / BAY), libm::floor(z / FLOOR));
    if half_width - (bay + 0.5).abs() * BAY < 0.5 * BAY {
        return None;
    }
    let dice = unit(hash(seed, &[bay as i64 as u64, floor as i64 as u64]));
    let door = floor == 0.0 && dice < 0.25;
    let (width, sill, lintel) = if door { (1.1, 0.0, 2.1) } else { (1.3, 0.95, 2.25) };
    let (left, bottom) = ((bay + 0.5) * BAY - 0.5 * width, floor * FLOOR);
    let niche = Niche {
        low: [left, -1.0, bottom + sill],
        high: [left + width, 0.1 + 0.2 * dice, bottom + lintel],
        loss: if dice < 0.45 { 0.04 } else { 0.9 },
    };
    let inside = |v: f64, axis: usize| (niche.low[axis]..niche.high[axis]).contains(&v);
    (dice < 0.85 && inside(x, 0) && inside(z, 2)).then_some(niche)
}

impl Niche {
    /// What a ray that enters the opening hits: the pane at the back or, on the way, a jamb.
    fn look(&self, ray: &Ray, tone: f64) -> Hit {
        let walls: [f64; 3] = core::array::from_fn(|axis| match ray.direction[axis] {
            0.0 => f64::INFINITY,
            along => {
                ((if along > 0.0 { self.high[axis] } else { self.low[axis] }) - ray.origin[axis]) / along
            }
        });
        let jamb = walls[0].min(walls[2]);
        if walls[1] <= jamb {
            return Hit::glass(walls[1], ray.direction[1].abs(), self.loss);
        }
        let axis = if walls[0] < walls[2] { 0 } else { 2 };
        Hit::plain(jamb, ray.direction[axis].abs(), tone)
    }
}

/// A twig that the ray hits among the leaves, if any.
fn foliage(span: Span, gap: f64, tone: f64, rng: &mut Rng) -> Option<Hit> {
    let distance = span.enter.max(0.0) + rng.exponential(gap);
    let reflectivity = tone * rng.between(0.3, 1.2);
    (distance < span.leave)
        .then(|| Hit { loss: 0.02, ..Hit::plain(distance, rng.between(0.4, 1.0), reflectivity) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thing(kind: Kind) -> Thing {
        Thing { kind, place: [10.0, 0.0, 0.0], heading: [1.0, 0.0], reflectivity: 0.4 }
    }

    fn distance(thing: &Thing, height: f64) -> f64 {
        let ray = Ray::new([0.0, 0.0, height], [1.0, 0.0, 0.0]);
        thing.hit(&ray, &mut Rng::keyed(1, &[])).map_or(f64::INFINITY, |hit| hit.distance)
    }

    #[test]
    fn a_car_is_seen_at_its_back_and_over_its_bonnet() {
        let car = thing(Kind::Car { half: [2.1, 0.87] });
        assert!((distance(&car, 0.6) - 7.9).abs() < 0.02);
        assert!((8.2..9.5).contains(&distance(&car, 1.1)));
        assert_eq!(distance(&car, 1.7), f64::INFINITY);
        assert_eq!(distance(&car, 0.1), f64::INFINITY);
    }

    #[test]
    fn windows_lie_behind_the_front() {
        let front = Thing {
            heading: [0.0, -1.0],
            ..thing(Kind::House { half_width: 9.0, depth: 8.0, height: 7.0, seed: 4 })
        };
        let mut depths: Vec<f64> = Vec::new();
        for step in 0..300 {
            let ray = Ray::new([0.0, 0.04 * f64::from(step) - 6.0, 1.5], [1.0, 0.0, 0.0]);
            depths.extend(front.hit(&ray, &mut Rng::keyed(1, &[])).map(|hit| hit.distance - 10.0));
        }
        assert_eq!(depths.len(), 300);
        let (wall, window): (Vec<f64>, Vec<f64>) = depths.iter().partition(|depth| depth.abs() < 1e-9);
        assert!(wall.len() > 50 && window.len() > 40, "{} {}", wall.len(), window.len());
        assert!(window.iter().all(|depth| (0.1..=0.3).contains(depth)));
    }

    #[test]
    fn leaves_are_met_at_random_inside_the_crown() {
        let bush = thing(Kind::Foliage { centre: 1.0, half: [2.0, 2.0, 1.5], gap: 0.7 });
        let ray = Ray::new([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
        let mut rng = Rng::keyed(1, &[]);
        let hits: Vec<f64> =
            (0..500).filter_map(|_| bush.hit(&ray, &mut rng)).map(|hit| hit.distance).collect();
        assert!(hits.len() > 450 && hits.iter().all(|distance| (8.0..=12.0).contains(distance)));
        let mean = hits.iter().sum::<f64>() / hits.len() as f64;
        assert!((mean - 8.68).abs() < 0.15, "{mean}");
    }
}
