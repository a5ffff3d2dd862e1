//! The fit of an HDL-64E: its constants against the simulator's, and the share of points that it explains,
//! for any sample.

use crate::common;
use crate::common::formats::kitti;
use crate::common::scans::{
    Points, Random, moved, random_points, rows, scans, shuffled, single_precision, unrounded,
};
use lidarpc::internals::files::parse;
use lidarpc::internals::scan::ScanFile;
use lidarpc::internals::scanner::hdl64::{Hdl64, fit, project};
use lidarpc::internals::scanner::{CoordinateGrid, REACH, Scanner};
use lidarpc::internals::study::synth::{SynthConfig, scanner_beams};

/// All beams, every eighth firing: some 230 points a beam.
fn config(seed: u64) -> SynthConfig {
    SynthConfig { seed, frames: 4, thinning: 8, ..SynthConfig::default() }
}

fn file(points: &Points) -> ScanFile {
    parse("0.bin", kitti(points))
}

fn fitted(sample: &[Points]) -> Option<Hdl64> {
    fit(&sample.iter().map(file).collect::<Vec<_>>())
}

/// The share of a scan's points that are returns of the range image.
fn explained(scanner: &Hdl64, points: &Points) -> f64 {
    1.0 - project(scanner, &file(points).cloud, REACH).strays.len() as f64 / points.len() as f64
}

/// The share of a scan's points that the formula reproduces to the millimetre.
fn exact(scanner: &Hdl64, points: &Points) -> f64 {
    let mut exact = 0;
    let mut row = 0;
    for point in points {
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(point[axis]));
        row = scanner.nearest_beam(x.hypot(y), z, row);
        let Some((tick, steps)) = scanner.invert(row, [x, y, z]) else { continue };
        let formula = scanner.point(row, tick, steps);
        let hit = |(f, p): (&f64, f64)| (f * 1000.0).round() == (p * 1000.0).round();
        exact += usize::from(formula.iter().zip([x, y, z]).all(hit));
    }
    exact as f64 / points.len() as f64
}

/// A scanner is fitted to the sample, and explains all except a few points of `good`.
fn explains(sample: &[Points], good: &Points, least: f64) -> Hdl64 {
    let scanner = fitted(sample).expect("a scanner is found");
    let share = explained(&scanner, good);
    assert!(share >= least, "{share} of the points explained, less than {least}");
    comes_back(&scanner, good);
    scanner
}

/// A model read from the record gives the same projection, point for point.
fn comes_back(scanner: &Hdl64, points: &Points) {
    let mut bytes = Vec::new();
    scanner.write_to(&mut bytes);
    let mut input = &bytes[..];
    let again = Hdl64::read_from(&mut input).unwrap();
    assert!(input.is_empty());
    assert_eq!(again, *scanner);
    let (a, b) = (project(scanner, &file(points).cloud, REACH), project(&again, &file(points).cloud, REACH));
    assert_eq!(a.image, b.image);
    assert_eq!(a.strays, b.strays);
    for found in a.image.file_order(scanner) {
        let place = (found.row as usize, found.tick, found.steps);
        let bits = |scanner: &Hdl64| scanner.point(place.0, place.1, place.2).map(f64::to_bits);
        assert_eq!(bits(scanner), bits(&again));
    }
}

#[test]
fn one_frame_or_many_and_scanners_of_other_constants() {
    for seed in 1..5 {
        let frames = scans(&config(seed));
        for sample in [&frames[..1], &frames[..2], &frames[..]] {
            let scanner = explains(sample, &frames[3], 0.998);
            assert_eq!((scanner.rows(), scanner.coordinates), (64, CoordinateGrid::Millimetre));
            let exact = exact(&scanner, &frames[3]);
            assert!(exact > if sample.len() > 2 { 0.97 } else { 0.85 }, "{exact} to the millimetre");
        }
    }
}

#[test]
fn odd_frames_among_good_ones() {
    let frames = scans(&config(1));
    let half = frames[0][..frames[0].len() / 2].to_vec();
    let lower_half = frames[0][frames[0].len() / 2..].to_vec();
    let other = scans(&SynthConfig { frames: 1, ..config(9) }).remove(0);
    let fewer = scans(&SynthConfig { frames: 1, beams: 16, ..config(5) }).remove(0);
    let odd = [
        ("random", random_points(15_000, 3)),
        ("empty", Vec::new()),
        ("one point", vec![[1.0, 2.0, 3.0, 0.0]]),
        ("zeros", vec![[0.0; 4]; 5000]),
        ("other scanner", other),
        ("fewer beams", fewer),
        ("shuffled", shuffled(&frames[0], 1)),
        ("first half", half),
        ("second half", lower_half),
        ("moved", moved(&frames[0])),
        ("one point off", [frames[0][1000..1001].to_vec(), frames[0].clone()].concat()),
        ("without a row", rows(&frames[0]).into_iter().skip(1).flatten().collect()),
        ("reversed", frames[0].iter().rev().copied().collect()),
    ];
    for (name, points) in odd {
        println!("{name}");
        for place in [0, 3] {
            let mut sample = frames[1..].to_vec();
            sample.insert(place, points.clone());
            explains(&sample, &frames[1], 0.998);
        }
    }
}

/// The first frames are all unusual, each in its own way, and only two are good.
#[test]
fn a_sequence_that_begins_with_odd_frames() {
    let frames = scans(&config(2));
    let without = |row: usize| {
        let mut rows = rows(&frames[0]);
        rows.remove(row);
        rows.concat()
    };
    let sample = [
        random_points(9000, 1),
        Vec::new(),
        shuffled(&frames[0], 4),
        without(5),
        without(40),
        frames[1].clone(),
        frames[2].clone(),
    ];
    explains(&sample, &frames[2], 0.998);
}

/// In each frame another beam is missing, so that the rows are never the same beams.
#[test]
fn beams_that_are_missing_now_and_then() {
    let frames = scans(&config(3));
    let sample: Vec<Points> = frames
        .iter()
        .enumerate()
        .map(|(n, points)| {
            let mut rows = rows(points);
            rows.remove(n * 17);
            rows.concat()
        })
        .collect();
    explains(&sample, &frames[0], 0.98);
    explains(&sample, &sample[1], 0.998);
}

/// Upper beams that see little except sky: a row ends long before the turn is complete, or is empty.
#[test]
fn beams_with_few_points() {
    let frames = scans(&config(4));
    let sky = |(n, points): (usize, &Points)| -> Points {
        let see = |(row, points): (usize, Points)| -> Points {
            match row {
                0 => points.into_iter().skip(60).take(3 + n).collect(),
                1 => points.into_iter().skip(100).take(60).collect(),
                9 => points.into_iter().take(110).collect(),
                _ => points,
            }
        };
        rows(points).into_iter().enumerate().flat_map(see).collect()
    };
    let sample: Vec<Points> = frames.iter().enumerate().map(sky).collect();
    explains(&sample, &sample[0], 0.99);
}

/// Sectors, with and without the seam of the rows, and the view of a camera, which leaves out the lowest beams
/// and shortens those at its lower edge.
#[test]
fn parts_of_the_turn() {
    type Sees = fn(f32, f32) -> bool;
    let parts: [(&str, Sees); 4] = [
        ("40 degrees on either side", |azimuth, _| azimuth.abs() < 40.0),
        ("15 degrees on either side", |azimuth, _| azimuth.abs() < 15.0),
        ("30 degrees to the left", |azimuth, _| (50.0..80.0).contains(&azimuth)),
        ("camera", |azimuth, slope| azimuth.abs() < 40.0 && slope / azimuth.to_radians().cos() > -0.28),
    ];
    let frames = scans(&SynthConfig { thinning: 2, ..config(2) });
    for (name, sees) in parts {
        println!("{name}");
        let is_seen = |[x, y, z, _]: &[f32; 4]| sees(y.atan2(*x).to_degrees(), z / x.hypot(*y));
        let part =
            |points: &Points| -> Points { points.iter().filter(|point| is_seen(point)).copied().collect() };
        let sample: Vec<Points> = frames.iter().map(part).collect();
        explains(&sample, &sample[3], 0.99);
        let files: Vec<ScanFile> = sample.iter().map(file).collect();
        assert!(Scanner::fit(&files).is_some_and(|scanner| scanner.hdl64().is_some()));
    }
}

/// Columns have three or four points on average, and many have one.
#[test]
fn a_tenth_of_the_points() {
    let mut random = Random(1);
    let frames = scans(&SynthConfig { thinning: 1, frames: 2, ..config(3) });
    let mut tenth =
        |points: &Points| -> Points { points.iter().filter(|_| random.below(10) == 0).copied().collect() };
    let sample: Vec<Points> = frames.iter().map(&mut tenth).collect();
    explains(&sample, &sample[1], 0.995);
}

#[test]
fn fewer_beams_and_thinned_azimuth() {
    for beams in [1, 2, 4, 16, 32] {
        let config = SynthConfig { beams, thinning: 4, ..config(6) };
        let frames = scans(&config);
        let scanner = explains(&frames, &frames[1], 0.99);
        assert_eq!(scanner.rows(), beams);
    }
    let thinned = scans(&SynthConfig { thinning: 40, frames: 8, ..config(7) });
    explains(&thinned, &thinned[1], 0.99);
}

#[test]
fn coordinates_that_were_not_rounded() {
    let config = config(8);
    let frames: Vec<Points> = scans(&config).iter().map(|points| unrounded(&config, points)).collect();
    let scanner = explains(&frames, &frames[3], 0.998);
    assert_eq!(scanner.coordinates, CoordinateGrid::Float32);
    assert!(!scanner.is_single_precision());
}

/// Constants are found to their last bits: the formula reproduces the file exactly.
#[test]
fn coordinates_computed_in_single_precision() {
    let config = SynthConfig { beams: 8, thinning: 2, ..config(8) };
    let frames: Vec<Points> = scans(&config).iter().map(|points| single_precision(&config, points)).collect();
    let scanner = explains(&frames, &frames[3], 0.998);
    assert!(scanner.is_single_precision());
    let projected = project(&scanner, &file(&frames[3]).cloud, REACH);
    let right = projected.image.file_order(&scanner).into_iter().filter(|found| {
        let point = projected.point_of_cell[(found.row as usize, found.column as usize)];
        let metres = scanner.metres(found.steps);
        let position = scanner.position_at(found.row as usize, found.tick, metres);
        position.map(|v| (v as f32).to_bits())
            == [0, 1, 2].map(|axis| frames[3][point as usize][axis].to_bits())
    });
    let share = right.count() as f64 / frames[3].len() as f64;
    assert!(share > 0.97, "{share} of the points to the bit");
}

/// Properties of other drives: points in no shared column, order broken at the seam, a y of -0.0.
#[test]
fn frames_with_points_off_the_columns_and_out_of_order() {
    let mut frames = scans(&config(1));
    let other_columns = scans(&SynthConfig { thinning: 3, ..config(1) });
    for (points, others) in frames.iter_mut().zip(&other_columns) {
        let mut rows = rows(points);
        for (row, others) in rows.iter_mut().zip(common::scans::rows(others)) {
            // The end of the row comes first, as if the row started before the seam.
            row.rotate_right(2);
            row.splice(50..50, others[130..133].to_vec());
        }
        rows[3].push([9.5, -0.0, 0.3, 0.1]);
        *points = rows.concat();
    }
    explains(&frames, &frames[3], 0.985);
}

#[test]
fn what_no_scanner_saw_is_fitted_by_none() {
    let frames = scans(&config(1));
    let moved: Vec<Points> = frames.iter().map(|points| moved(points)).collect();
    assert!(fitted(&moved).is_none());
    assert!(fitted(&[random_points(20_000, 1)]).is_none());
    assert!(fitted(&[shuffled(&frames[0], 1)]).is_none());
    assert!(fitted(&[vec![[f32::NAN; 4]; 500], vec![[0.0; 4]; 500], vec![]]).is_none());
    assert!(fitted(&[vec![frames[0][0]; 9000]]).is_none());
    assert!(fitted(&[]).is_none());
}

#[test]
fn the_constants_are_those_of_the_simulator() {
    for seed in 1..4 {
        // All firings: with more points, the constants are more accurate.
        let config = SynthConfig { thinning: 1, frames: 2, ..config(seed) };
        let scanner = fitted(&scans(&config)).expect("a scanner is found");
        let beams = scanner_beams(&config);
        assert_eq!(scanner.rows(), beams.len());
        let (mut elevation_off, mut height_off) = (0.0f64, 0.0f64);
        for (row, beam) in beams.iter().enumerate() {
            elevation_off = elevation_off.max((scanner.elevation(row).to_degrees() - beam.elevation).abs());
            // Ranges may be counted from any whole step, so the beam's height is compared at a distance of 10
            // m.
            let [x, y, z] = scanner.point(row, 0, 5000);
            let along = x.hypot(y) - beam.range_offset;
            let expected = along * beam.elevation.to_radians().tan() + beam.height;
            height_off = height_off.max((z - expected).abs());
        }
        assert!(elevation_off < 0.002, "elevations are off by up to {elevation_off} degrees");
        assert!(height_off < 0.001, "heights are off by up to {height_off} m");
    }
}
