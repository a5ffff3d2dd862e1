//! Sweeps made by a formula path of their own: undone, coded, and given back.

use super::*;
use crate::ground::random::Rng;

/// Firings of the sweeps, and ticks from one to the next.
const FIRINGS: usize = 1085;
const FIRING_TICKS: f64 = 33.2;

/// How a car goes, and where the scanner is in the map in the end.
struct Drive {
    /// Metres a second.
    velocity: [f64; 3],
    /// Radians a second.
    yaw_rate: f64,
    origin: [f64; 3],
    heading: f64,
}

const TURNING: Drive =
    Drive { velocity: [0.1, 8.1, 0.25], yaw_rate: -0.2, origin: [1201.234, 303.777, 1.84], heading: 0.7 };
const STRAIGHT: Drive =
    Drive { velocity: [-0.2, 11.3, 0.1], yaw_rate: 0.01, origin: [411.8, -902.25, 1.83], heading: 2.4 };

/// The elevation of a record's beam in degrees: thirds of four degrees as the data sheet rounds them, two of
/// them down.
fn elevation(slot: usize) -> f64 {
    let hundredths = ((slot as f64 * 4.0 - 92.0) * 100.0 / 3.0).round();
    (hundredths + if slot == 3 || slot == 18 { 1.0 } else { 0.0 }) / 100.0
}

/// What the scanner measures in a street: (0, 0, 0) where nothing comes back.
fn street(seed: u64) -> Vec<[f32; 3]> {
    let mut random = Rng::keyed(seed, &[]);
    let mut points = Vec::with_capacity(FIRINGS * SLOTS);
    for firing in 0..FIRINGS {
        for slot in 0..SLOTS {
            let place = if slot < 16 { 2 * slot } else { 2 * slot - 31 };
            // As the scanner's driver has them: the blocks' ticks are whole, and so are their differences.
            let at = |firing: usize| (18_100.0 + firing as f64 * FIRING_TICKS).floor();
            let next = if firing % 12 == 3 && firing > 0 {
                2.0 * at(firing) - at(firing - 1)
            } else {
                at(firing + 1)
            };
            let tick = at(firing) + ((next - at(firing)) * place as f64 / 40.0 + 0.5).floor();
            let azimuth = (tick % 36_000.0) * std::f64::consts::PI / 18_000.0;
            let up = elevation(slot).to_radians();
            let ground = 1.84 / (-up.sin()).max(0.02);
            let wall = 9.0 / (azimuth.sin().abs().max(0.05) * up.cos());
            let range = ground.min(wall);
            let is_lost = range > 60.0 || random.chance(0.12);
            let steps = if is_lost { 0.0 } else { (range / 0.002 + random.normal() * 4.0).round() };
            let metres = steps as f32 * 0.002f32;
            let flat = metres * up.cos() as f32;
            points.push(if is_lost {
                [0.0; 3]
            } else {
                [flat * azimuth.cos() as f32, -(flat * azimuth.sin() as f32), metres * up.sin() as f32]
            });
        }
    }
    points
}

/// The points as the file has them: to the map and back.
fn moved(points: &[[f32; 3]], drive: &Drive) -> Vec<[f32; 3]> {
    let mut time = 0.0;
    let mut times = Vec::new();
    for firing in 0..FIRINGS {
        times.push(time * 1e-6);
        let packet = (firing + 9) / 12;
        time += if firing % 12 == 3 && packet % 25 != 5 { 47.0 } else { 46.0 };
    }
    let end = times[FIRINGS - 1];
    // The map's axes: a heading and a slight tilt.
    let (sin, cos) = drive.heading.sin_cos();
    let (tilt_sin, tilt_cos) = 0.02f64.sin_cos();
    let axes = [
        [cos, -sin * tilt_cos, sin * tilt_sin],
        [sin, cos * tilt_cos, -cos * tilt_sin],
        [0.0, tilt_sin, tilt_cos],
    ];
    let to_map = |v: [f64; 3]| -> [f32; 3] {
        std::array::from_fn(|row| {
            let along: f64 = (0..3).map(|column| axes[row][column] * v[column]).sum();
            (along + drive.origin[row]) as f32
        })
    };
    let from_map = |g: [f32; 3]| -> [f32; 3] {
        let off: [f64; 3] = std::array::from_fn(|row| f64::from(g[row]) - drive.origin[row]);
        std::array::from_fn(|column| (0..3).map(|row| axes[row][column] * off[row]).sum::<f64>() as f32)
    };
    let of_record = |(record, point): (usize, &[f32; 3])| {
        let left = times[record / SLOTS] - end;
        let (sin, cos) = (drive.yaw_rate * left).sin_cos();
        let [x, y, z] = point.map(f64::from);
        let place = drive.velocity.map(|v| v * left);
        from_map(to_map([x * cos - y * sin + place[0], x * sin + y * cos + place[1], z + place[2]]))
    };
    points.iter().enumerate().map(of_record).collect()
}

fn bits(points: &[[f32; 3]]) -> Vec<[u32; 3]> {
    points.iter().map(|point| point.map(f32::to_bits)).collect()
}

#[test]
fn elevations_are_thirds_of_four_degrees() {
    let all: Vec<f64> = (0..SLOTS).map(elevation).collect();
    assert_eq!((all[0], all[1], all[3], all[18], all[31]), (-30.67, -29.33, -26.66, -6.66, 10.67));
}

#[test]
fn a_sweep_is_measured_again_and_comes_back() {
    for (seed, drive) in (1..).zip([TURNING, STRAIGHT]) {
        let truth = street(seed);
        let file = moved(&truth, &drive);
        let (found, mut world) = undo(&file).expect("it was moved through a map");
        let wrong = found.iter().zip(&truth).filter(|(a, b)| a != b).count();
        assert!(wrong * 200 < truth.len(), "{wrong} points are not as measured");
        let quickly = measured(&file).expect("it was moved through a map");
        let wrong = quickly.iter().zip(&truth).filter(|(a, b)| a != b).count();
        assert!(wrong * 100 < truth.len(), "{wrong} points are not as measured at first");

        world.find_corrections(&found, &file);
        let payload = world.to_payload(&found);
        assert!(payload.len() < truth.len() / 4, "{} bytes for {}", payload.len(), world.corrections.len());
        let read = World::from_payload(&payload, &found).unwrap();
        assert_eq!(read, world);
        let mut again = found;
        read.apply(&mut again);
        assert_eq!(bits(&again), bits(&file));
    }
}

#[test]
fn what_went_through_no_map_is_left_alone() {
    let truth = street(3);
    let file = moved(&truth, &TURNING);
    let noise: Vec<[f32; 3]> =
        file.iter().enumerate().map(|(n, &[x, y, z])| [x + n as f32 * 1e-5, y, z]).collect();
    let mut odd = file.clone();
    odd[77] = [f32::NAN, 0.0, 1.0];
    for points in [&truth[..], &noise, &file[1..], &odd, &[[1.0, 0.5, 0.25]; 32 * 300], &[]] {
        assert!(undo(points).is_none() && measured(points).is_none());
    }
}

fn example() -> (Vec<[f32; 3]>, World) {
    let points: Vec<[f32; 3]> =
        (0..100).map(|n| if n % 3 == 0 { [0.0; 3] } else { [n as f32 * 0.1, -1.5, 0.25] }).collect();
    let knot = |time, x| Knot { time, pose: Pose { place: [x, -5, 1 << 40], turn: [1 << 30, -x, 7] } };
    let correction = |record, steps, units| Correction { record, steps, units };
    let world = World {
        rotation: [0.1, -0.2, 3.0],
        origin: [1500.0, -20.0, 1.5],
        lattices: [Some(-13), None],
        times: Times { border: 1, short: 2 },
        first: vec![Pose { place: [1, 2, 3], turn: [-4, 5, -6] }; 2],
        knots: vec![knot(0, -100), knot(1000, 1 << 29), knot(1001, 9)],
        corrections: vec![
            correction(0, [1, 0], [0; 3]),
            correction(3, [1, 0], [0; 3]),
            correction(32, [-(1 << 39), 0], [1 << 33, -1, 0]),
            correction(99, [0; 2], [0, 0, -70_000]),
        ],
    };
    (points, world)
}

#[test]
fn numbers_come_back() {
    let (points, world) = example();
    let payload = world.to_payload(&points);
    assert_eq!(World::from_payload(&payload, &points).unwrap(), world);
}

#[test]
fn damage_is_refused_or_does_no_harm() {
    let (points, world) = example();
    let payload = world.to_payload(&points);
    let mut random = Rng::keyed(5, &[]);
    for round in 0..3000 {
        let mut bytes = payload.clone();
        for _ in 0..1 + round % 4 {
            let place = random.below(bytes.len());
            bytes[place] = random.below(256) as u8;
        }
        bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.below(bytes.len() + 1) });
        if let Ok(world) = World::from_payload(&bytes, &points) {
            let mut points = points.clone();
            points[1] = [f32::NAN, f32::MAX, f32::NEG_INFINITY];
            world.apply(&mut points);
        }
    }
}

#[test]
fn impossible_worlds_are_refused() {
    let (points, world) = example();
    for place in 0..6 {
        for value in [f64::NAN, f64::INFINITY, -2e9] {
            let mut payload = world.to_payload(&points);
            payload[8 * place..][..8].copy_from_slice(&value.to_le_bytes());
            assert!(World::from_payload(&payload, &points).is_err(), "{place} {value}");
        }
    }
}
