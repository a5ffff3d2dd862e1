//! Scanners of firings: what the fit finds against what the simulator has, and files in firing order on the full path.

mod common;

use common::formats::kitti;
use common::scans::Points;
use common::{File, round_trip, take_apart};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::scan::ScanFile;
use lidarpc::internals::scanner::firings::{Firings, Laser, Recipe, Timing, fit};
use lidarpc::internals::scanner::{REACH, RangeImage, Return, Scanner};
use lidarpc::internals::stream::container::SectionKind;
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner, VLP_16_ELEVATIONS, drive};

/// A VLP-16, every so many-th block of its firings.
fn config(seed: u64, frames: usize, thinning: usize) -> SynthConfig {
    SynthConfig { scanner: SynthScanner::Vlp16, seed, frames, thinning, ..SynthConfig::default() }
}

fn scans(config: &SynthConfig) -> Vec<Points> {
    drive(config).map(|frame| frame.points).collect()
}

fn file(points: &Points) -> ScanFile {
    parse("0.bin", kitti(points))
}

fn fitted(points: &Points) -> Firings {
    fit(&[file(points)]).expect("a scanner of firings is found").0
}

fn files(scans: &[Points]) -> Vec<File> {
    scans.iter().enumerate().map(|(number, points)| (format!("{number}.bin"), kitti(points))).collect()
}

/// Returns of a scan that the recipe gives to the last bit, and those that it does not; the strays.
fn counts(scanner: &Firings, points: &Points) -> (usize, usize, usize) {
    let cloud = file(points).cloud;
    let projection = scanner.project(&cloud, REACH);
    let (mut exact, mut inexact) = (0, 0);
    for found in scanner.file_order(&projection.image) {
        let point = projection.point_of_cell[(found.row as usize, found.column as usize)];
        let formula = scanner.position(&found, 0.0).map(|metres| (metres as f32).to_bits());
        let is_exact = formula == cloud.positions[point as usize].map(f32::to_bits);
        *(if is_exact { &mut exact } else { &mut inexact }) += 1;
    }
    (exact, inexact, projection.strays.len())
}

#[test]
fn the_constants_are_those_of_the_simulator() {
    for seed in 1..4 {
        let scans = scans(&config(seed, 2, 3));
        let scanner = fitted(&scans[0]);
        assert_eq!(scanner.recipe(), Recipe::VelodyneRos);
        assert_eq!((scanner.ticks(), scanner.range_step_um()), (36_000, 2000));
        assert_eq!(scanner.timing(), Timing::VLP_16);
        let mut expected = VLP_16_ELEVATIONS.map(|degrees| i64::from(degrees) * 1_000_000_000);
        expected.sort_unstable_by_key(|&elevation| -elevation);
        let found = scanner.lasers().iter().map(|laser| laser.elevation);
        assert_eq!(found.collect::<Vec<_>>(), expected);
        assert!(scanner.lasers().iter().all(|laser| laser.azimuth == 0));
        for points in &scans {
            assert_eq!(counts(&scanner, points), (points.len(), 0, 0));
        }
    }
}

#[test]
fn the_order_of_the_file_costs_nothing_and_no_point_is_a_stray() {
    let scans = scans(&config(5, 3, 2));
    let stream = round_trip(&files(&scans), &EncoderConfig::default());
    let (scanners, groups) = take_apart(&stream);
    assert_eq!(scanners.len(), 1);
    let scanner = Scanner::of_record(scanners[0].family, &scanners[0].payload).unwrap();
    assert!(matches!(scanner, Some(Scanner::Firings(_))));
    let bytes = |wanted: SectionKind| -> usize {
        let sections = groups.iter().flat_map(|group| &group.frames).flat_map(|frame| &frame.sections);
        sections.filter(|section| section.kind == wanted).map(|section| section.payload.len()).sum()
    };
    assert_eq!(bytes(SectionKind::Points), 0, "there are no strays");
    assert!(bytes(SectionKind::Order) <= 4 * scans.len());
    assert!(bytes(SectionKind::Correction) <= 300 * scans.len());
    let points: usize = scans.iter().map(Vec::len).sum();
    assert!(stream.len() < 2 * points, "{} bytes for {points} points", stream.len());
}

#[test]
fn a_record_comes_back() {
    let scanner = fitted(&scans(&config(2, 1, 4))[0]);
    let payload = scanner.to_payload();
    let mut input = &payload[..];
    assert_eq!(Firings::read_from(&mut input).unwrap(), scanner);
    assert!(input.is_empty());
    for cut in 0..payload.len() {
        assert!(Firings::read_from(&mut &payload[..cut]).is_err(), "cut at {cut}");
    }
    for (at, bit) in (0..payload.len()).flat_map(|at| (0..8).map(move |bit| (at, bit))) {
        let mut damaged = payload.clone();
        damaged[at] ^= 1 << bit;
        // An error or another scanner, never a panic.
        if let Ok(other) = Firings::read_from(&mut &damaged[..]) {
            assert_eq!(other.rows(), scanner.rows());
        }
    }
}

#[test]
fn scans_that_are_cut_and_mixed_up_come_back() {
    let whole = &scans(&config(3, 1, 3))[0];
    let reversed: Points = whole.iter().rev().copied().collect();
    let no_third_laser: Points =
        whole.iter().filter(|point| point[2] > -0.4 * point[0].abs()).copied().collect();
    let sector: Points = whole.iter().filter(|point| point[0] > 0.0).copied().collect();
    let mut with_others = whole.clone();
    for (place, point) in [(0, [0.0; 4]), (100, [f32::NAN; 4]), (200, [1e30, -1e-30, 7.0, 1.0])] {
        with_others.insert(place, point);
    }
    let mut swapped = whole.clone();
    swapped.swap(10, 500);
    swapped.swap(1000, 1001);
    let twice: Points = whole.iter().flat_map(|point| [*point, *point]).collect();
    let scans = [whole.clone(), reversed, no_third_laser, sector, with_others, swapped, twice, Vec::new()];
    for level in [1, 6] {
        let level = lidarpc::internals::backend::Level::new(level).unwrap();
        round_trip(&files(&scans), &EncoderConfig { level, ..EncoderConfig::default() });
    }
}

#[test]
fn scans_within_a_bound_stay_there() {
    let scans = scans(&config(4, 2, 4));
    let config = EncoderConfig::preset(lidarpc::internals::frame::Mode::Bounded { max_error_um: 10_000 });
    let stream = common::encode_files(&files(&scans), &config);
    let exact = common::encode_files(&files(&scans), &EncoderConfig::default());
    assert!(stream.len() * 5 < exact.len() * 4, "{} bytes, {} if exact", stream.len(), exact.len());
    for ((_, bytes), points) in common::decode_files(&stream).unwrap().iter().zip(&scans) {
        let decoded = parse("0.bin", bytes.clone()).cloud.positions;
        assert_eq!(decoded.len(), points.len());
        for (a, b) in decoded.iter().zip(points) {
            let off: f64 = (0..3).map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2)).sum();
            assert!(off.sqrt() <= 0.01, "{a:?} {b:?}");
        }
    }
}

/// A scanner of 32 lasers that fire out of order and look to either side, and a scan of it in a room of no shape.
fn made_up(recipe: Recipe, (ticks, range_step_um): (u32, u32)) -> (Firings, ScanFile) {
    let mut state = 7 + recipe as u64;
    let mut below = |end: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % end
    };
    let degrees = |thousandths: i64| thousandths * 1_000_000;
    let laser = |row: i64| Laser {
        elevation: degrees(15_000 - 1_237 * row + row % 3),
        azimuth: degrees([1_400, -4_200, 4_200, -1_400][row as usize % 4]),
    };
    let lasers: Vec<Laser> = (0..32).map(laser).collect();
    let rows_of_slots = (0..32).map(|slot| slot * 5 % 32).collect();
    let scanner = Firings::new(recipe, (ticks, range_step_um), Timing::default(), lasers, rows_of_slots);
    let step = (ticks / 1800).max(1);
    let (mut columns, mut tick) = (Vec::new(), ticks / 3);
    for _ in 0..ticks / step {
        columns.push(tick % ticks);
        tick += if step > 1 { step - 1 + below(3) as u32 } else { 1 };
    }
    let mut image = RangeImage::new(32, columns);
    for (place, steps) in image.steps.cells_mut().iter_mut().enumerate() {
        let metres = 5.0 + (place % 1009) as f64 * 0.02 + below(1000) as f64 * 1e-4;
        *steps = if below(10) == 0 { 0 } else { (metres * 1e6 / f64::from(range_step_um)) as u32 };
    }
    let point = |found: Return| {
        let [x, y, z] = scanner.position(&found, 0.0).map(|metres| metres as f32);
        [x, y, z, (found.steps % 100) as f32]
    };
    let points: Points = scanner.file_order(&image).into_iter().map(point).collect();
    let file = file(&points);
    (scanner, file)
}

#[test]
fn scanners_of_all_recipes_are_found_from_their_points() {
    for (recipe, grid) in
        Recipe::ALL.into_iter().zip([(36_000, 4000), (36_000, 2000), (36_000, 4000), (2048, 1000)])
    {
        let (truth, scan) = made_up(recipe, grid);
        let (found, share) =
            fit(std::slice::from_ref(&scan)).unwrap_or_else(|| panic!("{recipe:?} is not found"));
        assert!(share > 0.999, "{recipe:?}: {share}");
        assert_eq!((found.recipe(), found.ticks(), found.range_step_um()), (recipe, grid.0, grid.1));
        assert_eq!(found.timing(), Timing::default());
        let elevations =
            |scanner: &Firings| scanner.lasers().iter().map(|laser| laser.elevation).collect::<Vec<_>>();
        assert_eq!(elevations(&found), elevations(&truth), "{recipe:?}");
        let points: Points = scan.cloud.positions.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
        assert_eq!(counts(&found, &points), (points.len(), 0, 0), "{recipe:?}");
    }
}
