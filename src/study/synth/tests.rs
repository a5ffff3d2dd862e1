//! Tests of whole frames.

use std::f64::consts::PI;
use std::path::Path;

use super::*;

fn small() -> SynthConfig {
    SynthConfig { frames: 2, thinning: 8, ..SynthConfig::default() }
}

fn frames(config: &SynthConfig) -> Vec<SynthFrame> {
    drive(config).collect()
}

/// Azimuth in degrees; a y of -0.0 was below the seam before rounding.
fn azimuth(point: &[f32; 4]) -> f64 {
    let degrees = f64::from(point[1]).atan2(f64::from(point[0])).to_degrees();
    if degrees.is_sign_negative() { degrees + 360.0 } else { degrees }
}

/// The rows of a frame: a new one begins where the azimuth falls back.
fn rows(points: &[[f32; 4]]) -> Vec<&[[f32; 4]]> {
    points.chunk_by(|a, b| azimuth(b) - azimuth(a) > -180.0).collect()
}

/// Range in steps and azimuth in ticks of a point of a beam, not rounded.
fn invert(beam: &Beam, point: &[f32; 4]) -> (f64, f64) {
    let [x, y, z] = [0, 1, 2].map(|axis| f64::from(point[axis]));
    let rho = x.hypot(y);
    let (sin, cos) = (beam.elevation * PI / 180.0).sin_cos();
    // Of the two ways to compute the distance, the one nearer to its own axis is more accurate; this is their
    // optimal mixture.
    let distance = (rho - beam.range_offset) * cos + (z - beam.height) * sin;
    let degrees = azimuth(point) - (beam.side / rho).atan().to_degrees() - beam.turn;
    (distance / STEP, degrees / 0.09)
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_seed_others() {
    let config = SynthConfig { thinning: 40, ..small() };
    assert_eq!(frames(&config), frames(&config));
    let other = SynthConfig { seed: 2, ..config.clone() };
    assert_ne!(frames(&config)[0].points, frames(&other)[0].points);
    assert_ne!(frames(&config)[0].points, frames(&config)[1].points);
}

#[test]
fn every_point_is_an_integer_range_and_tick_of_its_beam() {
    let config = small();
    let beams = scanner_beams(&config);
    for frame in drive(&config) {
        let rows = rows(&frame.points);
        assert_eq!(rows.len(), beams.len());
        for (beam, row) in beams.iter().zip(rows) {
            for point in row {
                let (steps, ticks) = invert(beam, point);
                let again =
                    beam.point((ticks.round() as i32).rem_euclid(TICKS), steps.round() as u32).position;
                assert_eq!(again.map(f32::to_bits), [point[0], point[1], point[2]].map(f32::to_bits));
                // Half a millimetre of rounding is at most 0.4 of a step, and 0.16 ticks at 2 m.
                assert!((steps - steps.round()).abs() < 0.45, "{steps}");
                assert!((ticks - ticks.round()).abs() < 0.25, "{ticks}");
            }
        }
    }
}

#[test]
fn beams_share_their_columns() {
    let config = small();
    let beams = scanner_beams(&config);
    for frame in drive(&config) {
        let mut used = vec![0_usize; TICKS as usize];
        for (beam, row) in beams.iter().zip(rows(&frame.points)) {
            for point in row {
                let column = (invert(beam, point).1.round() as i32 + beam.shift).rem_euclid(TICKS);
                used[column as usize] += 1;
            }
        }
        let shared: Vec<usize> = used.into_iter().filter(|points| *points > 3).collect();
        assert!((265..=272).contains(&shared.len()), "{}", shared.len());
        let in_them: usize = shared.iter().sum();
        assert!(in_them + 3 >= frame.points.len());
    }
}

#[test]
fn order_is_by_beam_and_by_azimuth_with_a_seam() {
    let config = SynthConfig { thinning: 2, frames: 1, ..small() };
    let beams = scanner_beams(&config);
    let frame = &frames(&config)[0];
    let mut seams = 0;
    for (beam, row) in beams.iter().zip(rows(&frame.points)) {
        for pair in row.windows(2) {
            // Rounding to the millimetre moves each point by at most 0.71 mm.
            let blur =
                |point: &[f32; 4]| (0.00071 / f64::from(point[0]).hypot(f64::from(point[1]))).to_degrees();
            let slack = blur(&pair[0]) + blur(&pair[1]);
            assert!(azimuth(&pair[1]) > azimuth(&pair[0]) - slack);
        }
        let ticks = |point: &[f32; 4]| (invert(beam, point).1.round() as i32).rem_euclid(TICKS);
        seams += row.windows(2).filter(|pair| ticks(&pair[1]) < ticks(&pair[0])).count();
    }
    assert!(seams > 0, "the ticks are in order everywhere");
}

#[test]
fn numbers_are_on_the_grids_of_the_files() {
    for frame in drive(&small()) {
        for &[x, y, z, intensity] in &frame.points {
            for value in [x, y, z] {
                let millimetres = (f64::from(value) * 1000.0).round();
                assert_eq!((millimetres / 1000.0) as f32, value);
            }
            let hundredths = (f64::from(intensity) * 100.0).round();
            assert_eq!((hundredths / 100.0) as f32, intensity);
            assert!((0.0..=99.0).contains(&hundredths));
            let range = [x, y, z].iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt();
            assert!((1.8..=120.3).contains(&range), "{range}");
        }
    }
}

#[test]
fn a_full_frame_is_filled_like_a_real_one() {
    let config = SynthConfig { frames: 1, ..SynthConfig::default() };
    let frame = &frames(&config)[0];
    assert!((112_000..=126_000).contains(&frame.points.len()), "{}", frame.points.len());
    let mut ranges: Vec<f32> = frame.points.iter().map(|p| p[0].hypot(p[1]).hypot(p[2])).collect();
    ranges.sort_by(f32::total_cmp);
    let share = |part: f64| ranges[(part * ranges.len() as f64) as usize];
    assert!((7.0..12.0).contains(&share(0.5)), "median {}", share(0.5));
    assert!((20.0..50.0).contains(&share(0.95)), "95 % {}", share(0.95));
    let zero = |value: &&f32| **value == 0.0 && value.is_sign_negative();
    assert!(frame.points.iter().flat_map(|p| &p[..3]).filter(zero).count() > 0);
}

#[test]
fn noise_is_as_wide_as_asked() {
    let quiet = SynthConfig { noise: 0.0, dropout: 0.0, frames: 1, ..small() };
    let loud = SynthConfig { noise: 0.0089, ..quiet.clone() };
    let beams = scanner_beams(&quiet);
    // The lowest beams see little except smooth road, so both drives have returns at the same ticks.
    let ranges = |config: &SynthConfig| -> Vec<std::collections::BTreeMap<i32, f64>> {
        let frame = &frames(config)[0];
        let rows = rows(&frame.points).into_iter().zip(&beams).skip(50);
        rows.map(|(row, beam)| {
            row.iter().map(|p| invert(beam, p)).map(|(n, t)| (t.round() as i32, n)).collect()
        })
        .collect()
    };
    let mut errors = Vec::new();
    for (quiet, loud) in ranges(&quiet).iter().zip(&ranges(&loud)) {
        let pairs = quiet.iter().filter_map(|(tick, steps)| Some((loud.get(tick)? - steps) * STEP));
        errors.extend(pairs.filter(|error| error.abs() < 0.05));
    }
    assert!(errors.len() > 1500, "{}", errors.len());
    let sigma = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((0.0083..0.0096).contains(&sigma), "{sigma}");
}

/// Two frames, transformed by their true poses, must agree: the ground in one is the ground in the other.
#[test]
fn poses_bring_frames_together() {
    let config = SynthConfig { rolling: false, traffic: false, noise: 0.0, speed: 1.5, ..small() };
    let [first, second] = &frames(&config)[..] else { panic!("two frames") };
    let ground = |frame: &SynthFrame, m: &[f64; 12]| -> std::collections::BTreeMap<[i64; 2], f64> {
        let world = frame.points.iter().map(|&[x, y, z, _]| {
            let p = [f64::from(x), f64::from(y), f64::from(z)];
            [0, 4, 8].map(|r| m[r] * p[0] + m[r + 1] * p[1] + m[r + 2] * p[2] + m[r + 3])
        });
        let road = world.filter(|p| p[1].abs() < 2.5 && p[0].abs() < 15.0);
        road.map(|p| ([p[0], p[1]].map(|v| (v / 0.4).floor() as i64), p[2])).collect()
    };
    let error = |pose: &[f64; 12]| {
        let (a, b) = (ground(first, &first.pose), ground(second, pose));
        let mut gaps: Vec<f64> = a.iter().filter_map(|(cell, z)| Some((b.get(cell)? - z).abs())).collect();
        assert!(gaps.len() > 200, "{}", gaps.len());
        gaps.sort_by(f64::total_cmp);
        gaps[gaps.len() / 2]
    };
    let mut lifted = second.pose;
    lifted[11] += 0.05;
    assert!(error(&second.pose) < 0.01, "{}", error(&second.pose));
    assert!(error(&lifted) > 0.03);
    assert!((second.pose[3] - first.pose[3] - 1.5).abs() < 1e-9);
}

#[test]
fn fewer_beams_and_any_settings_do_no_harm() {
    let half = SynthConfig { beams: 32, frames: 1, ..small() };
    assert_eq!(rows(&frames(&half)[0].points).len(), 32);
    let odd = [
        SynthConfig { beams: 0, thinning: 500, ..half.clone() },
        SynthConfig { beams: 2, thinning: 0, speed: f64::NAN, ..half.clone() },
        SynthConfig { beams: 2, max_range: f64::INFINITY, ..half.clone() },
        SynthConfig { beams: 2, speed: f64::INFINITY, noise: f64::NAN, ..half.clone() },
        SynthConfig { beams: 2, speed: 1e300, dropout: -3.0, ..half },
    ];
    for config in odd {
        assert!(drive(&config).count() == 1);
    }
}

#[test]
fn bytes_are_little_endian_records_of_four() {
    let frame = SynthFrame { name: String::new(), points: vec![[1.0, -0.0, 2.5, 0.25]], pose: [0.0; 12] };
    assert_eq!(frame.to_bin(), [0, 0, 128, 63, 0, 0, 0, 128, 0, 0, 32, 64, 0, 0, 128, 62]);
}

/// The committed drive is the simulator's output. After an intended change of that, regenerate it with `cargo
/// test --lib synth -- --ignored write_testdata`.
#[test]
fn testdata_is_what_the_simulator_makes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/drive");
    if !folder.exists() {
        return;
    }
    let made = frames(&SynthConfig::testdata());
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), made.len());
    for frame in made {
        let committed = std::fs::read(folder.join(&frame.name)).unwrap();
        assert!(committed == frame.to_bin(), "{} differs", frame.name);
    }
}

#[test]
#[ignore = "writes testdata/drive"]
fn write_testdata() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/drive");
    std::fs::create_dir_all(&folder).unwrap();
    for frame in drive(&SynthConfig::testdata()) {
        std::fs::write(folder.join(&frame.name), frame.to_bin()).unwrap();
    }
}
