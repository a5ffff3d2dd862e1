//! Scans in the frame of a vehicle: points of a scanner that a program moved after they were measured.

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::firings::{Mover, image, made_up, points, unrounded_hdl_32e};
use crate::common::formats::{kitti, pcd_stamped};
use crate::common::scans::{Points, random_points};
use crate::common::streams::at_level;
use crate::common::{File, encode_files, round_trip};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::scan::ScanFile;
use lidarpc::internals::scanner::firings::{Build, Firings, Laser, Mounting, Recipe, TransformOrder};
use lidarpc::internals::scanner::{REACH, RangeImage, Scanner};
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner, drive};

/// A mounting like that on a car's roof.
const DEGREES: [f64; 3] = [1.3, -2.1, 91.7];
const METRES: [f64; 3] = [1.2, 0.3, 1.9];

/// Scans of a VLP-16, with every `thinning`-th block of its firings.
fn vlp_16(frames: usize, thinning: usize) -> Vec<Points> {
    let scanner = SynthScanner::Vlp16;
    let config = SynthConfig { scanner, seed: 7, frames, thinning, ..SynthConfig::default() };
    drive(&config).map(|frame| frame.points).collect()
}

fn file(points: &Points) -> ScanFile {
    parse("0.bin", kitti(points))
}

/// The scanner that is fitted to a scan, which must be one of firings; with its mounting.
fn fitted(scan: ScanFile) -> (Firings, Option<Mounting>) {
    let scanner = Scanner::fit(&[scan]).expect("a scanner is found");
    let scanner = scanner.firings().expect("a scanner of firings").clone();
    let mounting = scanner.build().mounting.as_deref().copied();
    (scanner, mounting)
}

fn positions(points: &Points) -> Vec<[f32; 3]> {
    points.iter().map(|&[x, y, z, _]| [x, y, z]).collect()
}

fn files(scans: &[Points]) -> Vec<File> {
    scans.iter().enumerate().map(|(number, points)| (format!("{number}.bin"), kitti(points))).collect()
}

#[test]
fn what_every_program_moved_is_reproduced_to_the_last_bit() {
    let scan = &vlp_16(1, 1)[0];
    for (mover, order) in Mover::ALL.into_iter().zip([
        TransformOrder::SingleShiftFirst,
        TransformOrder::SingleShiftLast,
        TransformOrder::SingleFused,
        TransformOrder::Double,
        TransformOrder::DoubleRoundedTwice,
        TransformOrder::SingleHalved,
    ]) {
        let moved = mover.moved(scan, DEGREES, METRES);
        let (scanner, mounting) = fitted(file(&moved));
        let mounting = mounting.unwrap_or_else(|| panic!("{mover:?} is not found"));
        assert_eq!(mounting.order, order);
        let exact = scanner.reproduced_share(&positions(&moved));
        assert!(exact > 0.98, "{mover:?}: {exact}");
        for axis in 0..3 {
            assert!((mounting.rows[axis][3] - METRES[axis]).abs() < 1e-6, "{mover:?}: {mounting:?}");
        }
        assert_eq!(scanner.build().recipe, fitted(file(scan)).0.build().recipe);
    }
}

#[test]
fn points_that_were_not_rounded_before_they_were_moved_are_reproduced_too() {
    for (degrees, up) in [(180.0, -0.090_805), (37.3, 1.73)] {
        let scan = unrounded_hdl_32e(degrees, up, 1);
        let (scanner, mounting) = fitted(file(&scan));
        let mounting = mounting.unwrap_or_else(|| panic!("{degrees} degrees: not found"));
        assert_eq!(mounting.order, TransformOrder::DoubleUnrounded, "{degrees} degrees");
        let exact = scanner.reproduced_share(&positions(&scan));
        assert!(exact > 0.98, "{degrees} degrees: {exact}");
        round_trip(&files(&[scan]), &EncoderConfig::default());
    }
}

#[test]
fn moved_files_are_hardly_larger() {
    let scans = vlp_16(2, 2);
    let moved: Vec<Points> =
        scans.iter().map(|scan| Mover::Pcl.moved(scan, [40.0, -25.0, 200.0], [-3.0, 12.0, 2.5])).collect();
    let size = |scans: &[Points]| encode_files(&files(scans), &EncoderConfig::default()).len();
    let (measured, moved) = (size(&scans), size(&moved));
    assert!(moved * 100 < measured * 103, "{moved} bytes, {measured} as measured");
}

#[test]
fn a_scan_in_which_the_upper_lasers_see_nothing_shows_the_scanner() {
    let scan = &vlp_16(1, 1)[0];
    let is_low = |[x, y, z, _]: &&[f32; 4]| z.atan2(x.hypot(*y)) < 8f32.to_radians();
    let low: Points = scan.iter().filter(is_low).copied().collect();
    let part = scan[..scan.len() * 3 / 5].to_vec();
    assert!(low.len() > part.len());
    let [low, part] = [low, part].map(|points| Mover::NumPyDouble.moved(&points, DEGREES, METRES));
    let scanner = Scanner::fit(&[file(&part), file(&low)]).expect("a scanner is found");
    for points in [low, part] {
        let exact = scanner.firings().expect("a scanner of firings").reproduced_share(&positions(&points));
        assert!(exact > 0.98, "{exact}");
    }
}

#[test]
fn upside_down_and_quarters_of_a_turn_are_found() {
    let scan = &vlp_16(1, 1)[0];
    let turns = [[180.0, 0.0, 0.0], [0.0, 0.0, 90.0], [0.0, 90.0, 0.0], [0.0, 0.0, 180.0]];
    for (degrees, metres) in turns.into_iter().flat_map(|turn| [(turn, [0.0; 3]), (turn, [0.0, 0.0, 1.8])]) {
        let moved = Mover::NumPyDouble.moved(scan, degrees, metres);
        let found = Scanner::fit(&[file(&moved)]).expect("a scanner is found");
        let along_axes =
            positions(&moved).into_iter().map(|position| found.orientation().to_scanner(position));
        let exact = found.firings().unwrap().reproduced_share(&along_axes.collect::<Vec<_>>());
        assert!(exact > 0.98, "{degrees:?} {metres:?}: {exact}");
    }
}

#[test]
fn lasers_with_azimuth_offsets_are_found_in_any_order_with_or_without_a_channel() {
    let scanner = made_up(Recipe::DoubleYAhead);
    let image = RangeImage { is_full: false, ..image(&scanner, 1) };
    let by_rows = points(&scanner.clone().line_by_line((0..32).collect()), &image);
    let by_firings = points(&scanner, &image);
    let rows: Vec<u16> = scanner.file_order(&image).iter().map(|found| found.row as u16).collect();
    let times = vec![0.0; by_firings.len()];
    let moved = |points: &Points| Mover::Pcl.moved(points, DEGREES, METRES);
    let with_channel = parse("0.pcd", pcd_stamped(&moved(&by_firings), &rows, &times));
    let scans = [
        (file(&moved(&by_rows)), &by_rows),
        (file(&moved(&by_firings)), &by_firings),
        (with_channel, &by_firings),
    ];
    for (scan, points) in scans {
        let (found, mounting) = fitted(scan);
        assert_eq!(mounting.expect("a mounting").order, TransformOrder::SingleShiftFirst);
        let exact = found.reproduced_share(&positions(&moved(points)));
        assert!(exact > 0.98, "{exact}");
    }
}

#[test]
fn beams_that_start_off_the_axis_are_found() {
    for recipe in [Recipe::RoboSense, Recipe::RoboSenseEarly, Recipe::LsLidar] {
        let scanner = made_up(recipe);
        let measured = points(&scanner, &RangeImage { is_full: false, ..image(&scanner, 1) });
        for mover in [Mover::Pcl, Mover::NumPyDouble] {
            let moved = mover.moved(&measured, DEGREES, METRES);
            let (found, mounting) = fitted(file(&moved));
            assert!(mounting.is_some(), "{recipe:?}: without a mounting");
            assert_eq!((found.build().recipe, found.rows()), (recipe, scanner.rows()));
            assert_eq!(found.build().origin, scanner.build().origin);
            let exact = found.reproduced_share(&positions(&moved));
            assert!(exact > 0.95, "{recipe:?} {mover:?}: {exact}");
        }
    }
}

/// Checks that a scanner is found in several poses with the recipe by which its points were computed, and that
/// it reproduces nearly all of them.
fn is_told_in_any_pose(scanner: &Firings) {
    let recipe = scanner.build().recipe;
    let measured = points(scanner, &RangeImage { is_full: false, ..image(scanner, 1) });
    for (degrees, metres) in [(DEGREES, METRES), ([179.2, 0.6, 33.7], [0.9, -0.3, 1.8])] {
        for mover in [Mover::Pcl, Mover::NumPyDouble] {
            let moved = mover.moved(&measured, degrees, metres);
            let (found, mounting) = fitted(file(&moved));
            assert!(mounting.is_some(), "{recipe:?} {degrees:?}: without a mounting");
            assert_eq!(found.build().recipe, recipe, "{degrees:?} {mover:?}");
            let exact = found.reproduced_share(&positions(&moved));
            assert!(exact > 0.97, "{recipe:?} {degrees:?} {mover:?}: {exact}");
        }
    }
}

#[test]
fn recipes_are_told_in_any_pose() {
    for recipe in [Recipe::DoubleYAhead, Recipe::NebulaJanuary2023] {
        is_told_in_any_pose(&made_up(recipe));
    }
}

#[test]
fn offsets_that_are_all_turned_together_are_found() {
    // As in the files of Hesai's Pandar40P and Pandar64.
    let scanner = made_up(Recipe::Nebula);
    let laser = |(row, laser): (usize, &Laser)| Laser {
        azimuth: [-1_042_000_000, 3_125_000_000, -5_208_000_000][row % 3],
        ..*laser
    };
    let lasers = scanner.lasers().iter().enumerate().map(laser).collect();
    is_told_in_any_pose(&Firings::new(scanner.build().clone(), lasers, (0..32).collect()));
}

#[test]
fn offsets_of_several_ticks_by_a_recipe_in_single_precision_are_found() {
    let scanner = made_up(Recipe::VelodyneRos);
    let image = RangeImage { is_full: false, ..image(&scanner, 1) };
    let moved = Mover::Pcl.moved(&points(&scanner, &image), DEGREES, METRES);
    let rows: Vec<u16> = scanner.file_order(&image).iter().map(|found| found.row as u16).collect();
    let (found, _) = fitted(parse("0.pcd", pcd_stamped(&moved, &rows, &vec![0.0; moved.len()])));
    let exact = found.reproduced_share(&positions(&moved));
    assert!(exact > 0.98, "{exact}");
}

/// A scan of lasers with these elevations and azimuth offsets, in degrees, which fire from the highest to the
/// lowest. Most returns are of the car on which the scanner is mounted.
fn near_scan(recipe: Recipe, lasers: &[[f64; 2]]) -> Points {
    let units = |degrees: f64| (degrees * 1e9).round() as i64;
    let laser =
        |&[elevation, azimuth]: &[f64; 2]| Laser { elevation: units(elevation), azimuth: units(azimuth) };
    let build = Build { range_step_um: 4000, ..made_up(recipe).build().clone() };
    let rows = lasers.len() as u32;
    let scanner = Firings::new(build, lasers.iter().map(laser).collect(), (0..rows).collect());
    let mut image = RangeImage::new(lasers.len(), (0..36_000).step_by(20).collect());
    for row in 0..lasers.len() {
        for column in 0..1800 {
            let noise = (row * 7919 + column * 104_729) % 13;
            let is_car = (column / 300 + row / 8) % 4 != 0;
            let metres = if is_car {
                0.7 + 0.1 * (column as f64 * 0.02).sin()
            } else {
                4.0 + (column % 300) as f64 * 0.01
            };
            image.steps[(row, column)] = (metres * 250.0) as u32 + noise as u32;
        }
    }
    points(&scanner, &image)
}

/// Checks that the scanner with these lasers is found on a car, and that it explains nearly all points.
fn is_found(lasers: &[[f64; 2]]) {
    let moved =
        Mover::NumPyDouble.moved(&near_scan(Recipe::Nebula, lasers), [0.0, 0.6, 1.7], [1.2, -0.1, 1.9]);
    let scan = file(&moved);
    let scanner = Scanner::fit(std::slice::from_ref(&scan)).expect("a scanner is found");
    assert!(scanner.firings().is_some_and(|found| found.build().mounting.is_some()), "without a mounting");
    let share = scanner.explained_share(&scan.cloud);
    assert!(share > 0.99, "{share}");
}

#[test]
fn a_scanner_that_mostly_sees_its_own_car_is_found() {
    // With six digits, as in the calibration of a unit.
    let elevation = |row: f64| 14.972_364 - 1.000_137 * row + 0.000_311 * (row % 5.0);
    let laser = |row: i32| [elevation(row.into()), 0.082_385 - 0.006_713 * f64::from(row)];
    is_found(&(0..32).map(laser).collect::<Vec<_>>());
}

#[test]
fn a_scanner_whose_firings_are_no_planes_is_found() {
    let laser = |row: i32| {
        let elevation = 52.0 - 1.2 * f64::from(row);
        [elevation, -5.0 - 0.05 * (elevation / 5.0).powi(2)]
    };
    is_found(&(0..64).map(laser).collect::<Vec<_>>());
}

#[test]
fn records_without_a_return_are_moved_with_the_others() {
    let scanner = made_up(Recipe::DoubleYAhead).line_by_line((0..32).rev().collect());
    let image = RangeImage { is_full: true, ..image(&scanner, 1) };
    let moved = Mover::LeftToRight.moved(&points(&scanner, &image), DEGREES, METRES);
    let (found, _) = fitted(file(&moved));
    let projection = found.project(&file(&moved).cloud, REACH);
    assert!(projection.image.is_full && projection.strays.is_empty(), "{} strays", projection.strays.len());
    let (formula, order) = (found.file_order(&projection.image), positions(&moved));
    let exact = formula.iter().zip(&order).filter(|(found_there, position)| {
        found.position(found_there, 0.0).map(|metres| metres as f32) == **position
    });
    let exact = exact.count();
    assert!(exact * 100 > order.len() * 98, "{exact} of {}", order.len());
    round_trip(&files(&[moved]), &EncoderConfig::default());
}

#[test]
fn moved_scans_with_odd_points_come_back() {
    let mut scans: Vec<Points> =
        vlp_16(3, 4).iter().map(|scan| Mover::NumPyDouble.moved(scan, DEGREES, METRES)).collect();
    scans[0].splice(100..100, random_points(40, 1));
    scans[1].insert(7, [f32::NAN, f32::INFINITY, -0.0, 1.0]);
    scans[1].insert(9, [0.0; 4]);
    scans[2] = Mover::Pcl.moved(&scans[2], [0.0, 0.0, 1.0], [5.0, 0.0, 0.0]);
    for level in [1, 6, 9] {
        round_trip(&files(&scans), &at_level(level));
    }
}

#[test]
fn moved_scans_stay_within_a_bound() {
    let scans: Vec<Points> =
        vlp_16(2, 4).iter().map(|scan| Mover::Pcl.moved(scan, DEGREES, METRES)).collect();
    let (stream, _) = keeps_the_bound(&files(&scans), &bounded(10_000), 10_000);
    let exact = encode_files(&files(&scans), &EncoderConfig::default());
    assert!(stream.len() * 5 < exact.len() * 4, "{} bytes, {} if exact", stream.len(), exact.len());
}

#[test]
fn a_record_with_a_mounting_comes_back() {
    let (scanner, _) = fitted(file(&Mover::NumPyDouble.moved(&vlp_16(1, 2)[0], DEGREES, METRES)));
    let payload = scanner.to_payload();
    let mut input = &payload[..];
    let again = Firings::read_from(&mut input).unwrap();
    assert!(input.is_empty());
    assert_eq!(again.build(), scanner.build());
    for cut in 0..payload.len() {
        assert!(Firings::read_from(&mut &payload[..cut]).is_err(), "cut at {cut}");
    }
    let (start, number) = (payload.len() - 96, f64::NAN.to_le_bytes());
    let mut damaged = payload;
    damaged[start..start + 8].copy_from_slice(&number);
    assert!(Firings::read_from(&mut &damaged[..]).is_err(), "a number that is none");
}
