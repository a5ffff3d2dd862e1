//! Tests of the section: what is written is read back, and damage is rejected or harmless. Whole sweeps are
//! in `tests/compensation.rs`.

use super::*;
use crate::ground::random::Rng;

fn example() -> (Vec<[f32; 3]>, World) {
    let points: Vec<[f32; 3]> =
        (0..100).map(|n| if n % 3 == 0 { [0.0; 3] } else { [n as f32 * 0.1, -1.5, 0.25] }).collect();
    let knot = |time, x| Knot { time, pose: Pose { position: [x, -5, 1 << 40], rotation: [1 << 30, -x, 7] } };
    let correction = |record, steps, units| Correction { record, steps, units };
    let world = World {
        rotation: [0.1, -0.2, 3.0],
        origin: [1500.0, -20.0, 1.5],
        lattices: [Some(-13), None],
        times: Times { border: 1, short: 2 },
        first: vec![Pose { position: [1, 2, 3], rotation: [-4, 5, -6] }; 2],
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
            let measured = &points;
            let mut points = points.clone();
            points[1] = [f32::NAN, f32::MAX, f32::NEG_INFINITY];
            world.apply(&mut points);
            assert_eq!(World::from_payload(&world.to_payload(measured), measured).unwrap(), world);
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
