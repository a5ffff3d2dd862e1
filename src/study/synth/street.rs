//! The objects along the street, generated piece by piece from the seed, so that a drive of any length only
//! needs memory for what the scanner can see; and everything that it can see in one frame, sorted by
//! direction so that few objects must be tested for a ray.

use libm::{asin, atan2, sqrt};

use super::SynthConfig;
use super::ground::{Ground, KERB};
use super::ray::{Hit, Ray};
use super::thing::{Kind, Thing, nearer};
use super::trajectory::LANE;
use crate::ground::random::Rng;

/// Length of a piece of the street, in metres.
const PIECE: f64 = 20.0;
/// Distance between moving cars, in metres.
const HEADWAY: f64 = 45.0;
/// The right and the left side of the street, as signs of y.
const SIDES: [f64; 2] = [-1.0, 1.0];

/// All objects between two positions along the street, at a time in frames.
fn things(config: &SynthConfig, ground: &Ground, from: f64, to: f64, time: f64) -> Vec<Thing> {
    let mut street = Street { ground, seed: config.seed, things: Vec::new() };
    for piece in cells(from, to, PIECE) {
        for side in SIDES {
            street.build(piece, side);
        }
    }
    if config.traffic {
        street.drive(config, from, to, time);
    }
    street.things
}

/// The numbers of the cells of length `length` that lie between two positions.
fn cells(from: f64, to: f64, length: f64) -> core::ops::Range<i64> {
    libm::floor(from / length) as i64..libm::ceil(to / length) as i64
}

struct Street<'a> {
    ground: &'a Ground,
    seed: u64,
    things: Vec<Thing>,
}

impl Street<'_> {
    /// Puts an object on the ground, rotated by a small angle against the street.
    fn put(&mut self, kind: Kind, [x, y]: [f64; 2], angle: f64, reflectivity: f64) {
        let heading = [libm::cos(angle), libm::sin(angle)];
        let place = [x, y, self.ground.height(x, y)];
        self.things.push(Thing { kind, place, heading, reflectivity });
    }

    /// Fills one side of a piece of the street.
    fn build(&mut self, piece: i64, side: f64) {
        let key = [u64::from(b's'), piece as u64, u64::from(side > 0.0)];
        let mut rng = Rng::keyed(self.seed, &key);
        let start = piece as f64 * PIECE;
        match rng.unit() {
            dice if dice < 0.72 => self.houses(start, side, &mut rng),
            dice if dice < 0.88 => self.park(start, side, &mut rng),
            _ => self.side_street(start, side, &mut rng),
        }
        self.kerbside(start, side, &mut rng);
    }

    /// A house, with or without a gap to the next one, and the objects in front of it.
    fn houses(&mut self, start: f64, side: f64, rng: &mut Rng) {
        let width = if rng.chance(0.5) { PIECE } else { rng.between(12.0, 17.0) };
        let front = rng.between(9.2, 13.5);
        let kind = Kind::House {
            half_width: 0.5 * width,
            depth: rng.between(8.0, 11.0),
            height: rng.between(5.0, 11.0),
            seed: self.seed ^ (start as i64 as u64),
        };
        // The front faces the street, so on the right side the house is turned by half a turn.
        let angle = if side < 0.0 { core::f64::consts::PI } else { 0.0 };
        self.put(kind, [start + 0.5 * width, side * front], angle, rng.between(0.25, 0.6));
        if front > 10.8 && rng.chance(0.6) {
            let wall = Kind::Block { half: [0.4 * width, 0.12], height: [-0.5, rng.between(0.5, 1.0)] };
            self.put(wall, [start + 0.5 * width, side * 8.8], 0.0, rng.between(0.2, 0.5));
        }
        for _ in 0..3 {
            if front > 10.5 && rng.chance(0.7) {
                let x = start + rng.between(1.0, PIECE - 1.0);
                self.bush([x, side * rng.between(9.3, front - 0.3)], rng);
            }
        }
    }

    /// A hedge, trees on grass, and a building at the far end.
    fn park(&mut self, start: f64, side: f64, rng: &mut Rng) {
        let hedge = Kind::Foliage { centre: 0.6, half: [8.5, 0.7, 1.0], gap: 0.15 };
        self.put(hedge, [start + 9.0, side * 9.6], 0.0, rng.between(0.3, 0.5));
        for _ in 0..4 {
            let place = [start + rng.between(0.0, PIECE), side * rng.between(10.0, 24.0)];
            self.tree(place, rng);
            self.bush([place[0] + rng.between(-3.0, 3.0), place[1] + side * 2.0], rng);
        }
        self.far_building(start, side, 30.0, rng);
    }

    /// A side street: cars stand in it, and it ends somewhere.
    fn side_street(&mut self, start: f64, side: f64, rng: &mut Rng) {
        for step in 0..3 {
            if rng.chance(0.6) {
                let y = side * (13.0 + 6.5 * f64::from(step));
                self.car([start + 4.0, y], core::f64::consts::FRAC_PI_2, rng);
            }
        }
        self.far_building(start, side, 45.0, rng);
    }

    fn far_building(&mut self, start: f64, side: f64, distance: f64, rng: &mut Rng) {
        let block = Kind::Block { half: [14.0, 4.0], height: [-3.0, 9.0] };
        self.put(
            block,
            [start + 10.0, side * (distance + rng.between(0.0, 8.0))],
            0.0,
            rng.between(0.2, 0.5),
        );
    }

    /// Parked cars, lamp posts, signs and trees along the kerb.
    fn kerbside(&mut self, start: f64, side: f64, rng: &mut Rng) {
        for slot in 0..3 {
            if rng.chance(0.55) {
                let x = start + 3.2 + 6.6 * f64::from(slot) + rng.between(-0.5, 0.5);
                self.car([x, side * (KERB - rng.between(1.0, 1.15))], rng.between(-0.04, 0.04), rng);
            }
        }
        let behind = side * (KERB + 0.7);
        if rng.chance(0.7) {
            let post = Kind::Pole { radius: rng.between(0.05, 0.1), height: 6.0 };
            self.put(post, [start + rng.between(0.0, PIECE), behind], 0.0, rng.between(0.2, 0.5));
        }
        if rng.chance(0.3) {
            let x = start + rng.between(0.0, PIECE);
            self.put(Kind::Pole { radius: 0.035, height: 2.9 }, [x, behind], 0.0, 0.4);
            let plate = Kind::Block { half: [0.02, 0.32], height: [2.2, 2.85] };
            self.put(plate, [x + 0.06, behind], 0.0, 2.5);
        }
        if rng.chance(0.45) {
            self.tree([start + rng.between(0.0, PIECE), side * (KERB + 1.1)], rng);
        }
    }

    fn car(&mut self, place: [f64; 2], angle: f64, rng: &mut Rng) {
        let tall = rng.chance(0.12);
        let reflectivity = rng.between(0.08, 0.6);
        if tall {
            let van = Kind::Block { half: [2.6, 0.95], height: [0.3, 2.3] };
            self.put(van, place, angle, reflectivity);
        } else {
            let half = [rng.between(1.85, 2.35), rng.between(0.82, 0.9)];
            self.put(Kind::Car { half }, place, angle, reflectivity);
        }
    }

    fn tree(&mut self, place: [f64; 2], rng: &mut Rng) {
        let (trunk, crown) = (rng.between(0.1, 0.22), rng.between(1.6, 2.8));
        self.put(Kind::Pole { radius: trunk, height: 4.0 }, place, 0.0, 0.3);
        let half = [crown, crown, rng.between(1.5, 2.5)];
        let leaves =
            Kind::Foliage { centre: half[2] + rng.between(1.4, 2.4), half, gap: rng.between(0.6, 1.4) };
        self.put(leaves, place, 0.0, rng.between(0.3, 0.5));
    }

    fn bush(&mut self, place: [f64; 2], rng: &mut Rng) {
        let size = rng.between(0.6, 1.4);
        let half = [size * rng.between(0.8, 1.4), size, size];
        let leaves = Kind::Foliage { centre: 0.5 * size, half, gap: rng.between(0.15, 0.5) };
        self.put(leaves, place, 0.0, rng.between(0.3, 0.5));
    }

    /// Moving cars: those in the own lane as fast as the scanner, the others in the opposite direction.
    fn drive(&mut self, config: &SynthConfig, from: f64, to: f64, time: f64) {
        let way = config.speed * time;
        for (lane, travelled) in [(LANE, way), (-LANE, -1.1 * way)] {
            for number in cells(from - travelled - HEADWAY, to - travelled + HEADWAY, HEADWAY) {
                let mut rng = Rng::keyed(self.seed, &[u64::from(b't'), number as u64, u64::from(lane > 0.0)]);
                let own_place = lane == LANE && number == 0;
                if own_place || rng.chance(0.4) {
                    continue;
                }
                let x = travelled + HEADWAY * number as f64 + rng.between(-12.0, 12.0);
                self.car([x, lane + rng.between(-0.2, 0.2)], 0.0, &mut rng);
            }
        }
    }
}

/// Sectors of the horizon.
const SECTORS: usize = 512;

/// The surroundings of one frame.
#[derive(Debug)]
pub(super) struct Scene<'a> {
    ground: &'a Ground,
    things: Vec<Thing>,
    /// For every sector the objects in it, sorted by their least possible distance, with that distance.
    sectors: Vec<Vec<(f64, usize)>>,
    reach: f64,
}

impl<'a> Scene<'a> {
    /// The surroundings of a position on the plan, at a time counted in frames.
    pub(super) fn new(config: &SynthConfig, ground: &'a Ground, middle: [f64; 2], time: f64) -> Self {
        let reach = config.max_range.clamp(0.0, 1000.0);
        let things = things(config, ground, middle[0] - reach, middle[0] + reach, time);
        let mut sectors = vec![Vec::new(); SECTORS];
        // The scanner moves by half a frame's distance to either side of the middle.
        let margin = 0.5 * config.speed.abs() + 0.2;
        for (index, thing) in things.iter().enumerate() {
            enter(&mut sectors, index, thing, middle, margin);
        }
        for sector in &mut sectors {
            sector.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        Scene { ground, things, sectors, reach }
    }

    /// The first surface that a ray hits within reach.
    pub(super) fn trace(&self, ray: &Ray, rng: &mut Rng) -> Option<Hit> {
        let mut best = self.ground.hit(ray, self.reach);
        let sector = sector(atan2(ray.direction[1], ray.direction[0]));
        for &(nearest, index) in &self.sectors[sector.rem_euclid(SECTORS as i64) as usize] {
            if best.is_some_and(|hit| hit.distance < nearest) {
                break;
            }
            best = nearer(best, self.things[index].hit(ray, rng));
        }
        best
    }
}

/// Number of the sector of an angle in radians, not yet wrapped.
fn sector(angle: f64) -> i64 {
    libm::floor(angle / core::f64::consts::TAU * SECTORS as f64) as i64
}

/// Adds an object to all sectors in which it may be visible.
fn enter(sectors: &mut [Vec<(f64, usize)>], index: usize, thing: &Thing, middle: [f64; 2], margin: f64) {
    let (x, y) = (thing.place[0] - middle[0], thing.place[1] - middle[1]);
    let (distance, radius) = (sqrt(x * x + y * y), thing.radius() + margin);
    let (first, last) = if distance > radius {
        let (bearing, half) = (atan2(y, x), asin(radius / distance));
        (sector(bearing - half), sector(bearing + half))
    } else {
        (0, SECTORS as i64 - 1)
    };
    for sector in first..=last {
        sectors[sector.rem_euclid(SECTORS as i64) as usize].push((distance - radius, index));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_piece_is_the_same_from_anywhere() {
        let (config, ground) = (SynthConfig { traffic: false, ..SynthConfig::default() }, Ground::new(1));
        let place = |thing: &Thing| thing.place;
        let all: Vec<_> = things(&config, &ground, -100.0, 100.0, 0.0).iter().map(place).collect();
        let some: Vec<_> = things(&config, &ground, 0.0, 40.0, 9.0).iter().map(place).collect();
        assert!(some.len() > 5);
        assert!(some.iter().all(|place| all.contains(place)));
    }

    #[test]
    fn nothing_stands_where_the_scanner_drives() {
        let (config, ground) = (SynthConfig::default(), Ground::new(1));
        for frame in 0..100 {
            let way = config.speed * f64::from(frame);
            for thing in things(&config, &ground, way - 50.0, way + 50.0, f64::from(frame)) {
                let [x, y, _] = thing.place;
                let turned_away = matches!(thing.kind, Kind::House { .. } | Kind::Foliage { .. });
                let clear = (x - way).abs() > 4.0 || (y - LANE).abs() > 1.5;
                assert!(clear || turned_away, "{thing:?}");
            }
        }
    }

    /// The slow, simple way: test every object.
    fn ask_all(scene: &Scene, ray: &Ray) -> Option<Hit> {
        let found = scene.things.iter().map(|thing| thing.hit(ray, &mut Rng::keyed(1, &[])));
        found.fold(scene.ground.hit(ray, scene.reach), nearer)
    }

    #[test]
    fn sectors_hide_nothing() {
        let (config, ground) = (SynthConfig::default(), Ground::new(2));
        let mut scene = Scene::new(&config, &ground, [40.0, -1.8], 50.0);
        // Leaves are hit at random. Without them both ways must agree to the bit.
        for thing in &mut scene.things {
            if let Kind::Foliage { gap, .. } = &mut thing.kind {
                *gap = 1e9;
            }
        }
        let mut on_things = 0;
        for turn in 0..1500 {
            let (sin, cos) = libm::sincos(f64::from(turn) * 0.0041);
            let ray = Ray::new([40.3, -1.7, ground.height(40.3, -1.7) + 1.9], [cos, sin, -0.03]);
            let (fast, slow) = (scene.trace(&ray, &mut Rng::keyed(1, &[])), ask_all(&scene, &ray));
            assert_eq!(fast.map(|hit| hit.distance), slow.map(|hit| hit.distance));
            on_things +=
                usize::from(slow.map(|hit| hit.distance) != ground.hit(&ray, 120.0).map(|hit| hit.distance));
        }
        assert!(on_things > 500, "{on_things}");
    }
}
