//! Scanners of the `firings` family: the fit's constants against the simulator's, and whole streams of files
//! in firing order.

use std::f64::consts::TAU;

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::firings::{
    OusterDriver, image, made_up, ouster, ouster_fields, points, taking_turns, timed,
    velodyne_decoder_vlp_16, vlp_32c, with_echoes,
};
use crate::common::formats::kitti;
use crate::common::scans::{Points, Random, random_points, rounded};
use crate::common::streams::at_level;
use crate::common::{self, File, round_trip, take_apart};
use lidarpc::internals::container::{Group, SectionKind};
use lidarpc::internals::files::parse;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::scan::ScanFile;
use lidarpc::internals::scanner::firings::{self, Build, Firings, Laser, Recipe, Timing};
use lidarpc::internals::scanner::{REACH, RangeImage, Return, Scanner};
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner, VLP_16_ELEVATIONS, drive};

/// A VLP-16, with every `thinning`-th block of its firings.
fn config(seed: u64, frames: usize, thinning: usize) -> SynthConfig {
    SynthConfig { scanner: SynthScanner::Vlp16, seed, frames, thinning, ..SynthConfig::default() }
}

fn scans(config: &SynthConfig) -> Vec<Points> {
    drive(config).map(|frame| frame.points).collect()
}

fn file(points: &Points) -> ScanFile {
    parse("0.bin", kitti(points))
}

/// The scanner that is fitted to scans, and the share of the points of the first that it explains.
fn fit(sample: &[ScanFile]) -> Option<(Firings, f64)> {
    let scanner = firings::fit(sample)?;
    let share = scanner.explained_share(&sample[0].cloud.positions);
    Some((scanner, share))
}

fn fitted(points: &Points) -> Firings {
    fit(&[file(points)]).expect("a scanner of firings is found").0
}

fn files(scans: &[Points]) -> Vec<File> {
    scans.iter().enumerate().map(|(number, points)| (format!("{number}.bin"), kitti(points))).collect()
}

/// The numbers of returns that the recipe reproduces to the last bit, of returns that it does not, and of
/// strays.
fn counts(scanner: &Firings, points: &Points) -> (usize, usize, usize) {
    let cloud = file(points).cloud;
    let projection = scanner.project(&cloud, REACH);
    let (mut exact, mut inexact) = (0, 0);
    for found in scanner.file_order(&projection.image).into_iter().filter(|found| found.steps > 0) {
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
        let Build { recipe, ticks, range_step_um, ref timing, .. } = *scanner.build();
        assert_eq!((recipe, ticks, range_step_um), (Recipe::VelodyneRos, 36_000, 2000));
        assert_eq!(*timing, Timing::Vlp16);
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

/// The size of all sections of a kind.
fn bytes_of(wanted: SectionKind, groups: &[Group]) -> usize {
    let sections = groups.iter().flat_map(|group| &group.frames).flat_map(|frame| &frame.sections);
    sections.filter(|section| section.kind == wanted).map(|section| section.payload.len()).sum()
}

#[test]
fn the_order_of_the_file_costs_nothing_and_no_point_is_a_stray() {
    let scans = scans(&config(5, 3, 2));
    let stream = round_trip(&files(&scans), &EncoderConfig::default());
    let (scanners, groups) = take_apart(&stream);
    assert_eq!(scanners.len(), 1);
    let scanner = Scanner::from_record(scanners[0].family, &scanners[0].payload).unwrap();
    assert!(scanner.is_some_and(|scanner| scanner.firings().is_some()));
    let bytes = |wanted: SectionKind| bytes_of(wanted, &groups);
    assert_eq!(bytes(SectionKind::Strays), 0, "there are no strays");
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
    let (stream, _) = keeps_the_bound(&files(&scans), &bounded(10_000), 10_000);
    let exact = common::encode_files(&files(&scans), &EncoderConfig::default());
    assert!(stream.len() * 5 < exact.len() * 4, "{} bytes, {} if exact", stream.len(), exact.len());
}

#[test]
fn scanners_of_all_recipes_are_found_from_their_points() {
    for recipe in Recipe::ALL {
        let truth = made_up(recipe);
        let points = points(&truth, &image(&truth, 1));
        let (found, share) = fit(&[file(&points)]).unwrap_or_else(|| panic!("{recipe:?} is not found"));
        assert!(share > 0.999, "{recipe:?}: {share}");
        // In double precision, it does not matter which axis counts as ahead: a quarter of a turn is a whole
        // number of ticks. Nor does a timing in which no slot is a tick later.
        let ahead = |build: &Build| {
            let recipe = match build.recipe {
                Recipe::DoubleXAhead => Recipe::DoubleYAhead,
                other => other,
            };
            Build { recipe, timing: Timing::Together, ..build.clone() }
        };
        assert_eq!(ahead(found.build()), ahead(truth.build()));
        let elevations =
            |scanner: &Firings| scanner.lasers().iter().map(|laser| laser.elevation).collect::<Vec<_>>();
        assert_eq!(elevations(&found), elevations(&truth), "{recipe:?}");
        let (exact, inexact, strays) = counts(&found, &points);
        // Sums in single precision hide the last digit of an offset.
        assert!(inexact <= points.len() / 1000 && strays == 0, "{recipe:?}: {exact}, {inexact}, {strays}");
    }
}

#[test]
fn formulas_are_those_of_the_geometry() {
    for recipe in Recipe::ALL {
        let scanner = made_up(recipe);
        let Build { ticks, origin, .. } = *scanner.build();
        let metre = |um: i32| f64::from(um) * 1e-6;
        for (row, laser) in (0u32..).zip(scanner.lasers()) {
            let tick = (row * 997 + 31) % ticks;
            let found = Return { row, column: 0, tick, steps: 5000 + row, echo: 0 };
            let start = f64::from(tick) / f64::from(ticks) * TAU;
            let azimuth = start + (laser.azimuth as f64 * 1e-9).to_radians();
            let elevation = (laser.elevation as f64 * 1e-9).to_radians();
            let mut metres = f64::from(found.steps) * scanner.range_step_m();
            if recipe.measures_from_axis() {
                // The ranges of these recipes are measured from the axis.
                metres -= metre(origin.along_um);
            }
            let mut start = start;
            if matches!(recipe, Recipe::VelodyneDecoder | Recipe::VelodyneDecoderHdl32e) {
                // And of these; their beams start in the direction of the laser.
                metres -= metre(origin.along_um) / elevation.cos();
                start = azimuth;
            }
            let ahead = metres * elevation.cos() * azimuth.cos() + metre(origin.along_um) * start.cos();
            let right = metres * elevation.cos() * azimuth.sin() + metre(origin.along_um) * start.sin();
            if recipe == Recipe::OusterEarly {
                // Its heights are computed as if beams started in front of the axis.
                metres += 2.0 * metre(origin.along_um);
            }
            let up = metres * elevation.sin() + metre(origin.up_um);
            let [x, y, z] = scanner.position(&found, 0.0);
            // Programs differ in which axis is ahead.
            let is_there = |a: [f64; 3]| [x, y, z].iter().zip(a).all(|(x, a)| (x - a).abs() < 2e-5);
            assert!(is_there([ahead, -right, up]) || is_there([right, ahead, up]), "{recipe:?}");
        }
    }
}

#[test]
fn a_file_of_whole_firings_has_no_strays_whatever_its_blanks_and_lines() {
    let scanner = made_up(Recipe::DoubleYAhead);
    let full = RangeImage { is_full: true, ..image(&scanner, 1) };
    let lines = made_up(Recipe::DoubleYAhead).line_by_line((0..32).rev().collect());
    for scanner in [scanner, lines] {
        let zeros = points(&scanner, &full);
        let nan = zeros.iter().map(|point| if point[0] == 0.0 { [f32::NAN; 4] } else { *point }).collect();
        let mut odd = zeros.clone();
        odd[100] = [1.0, 2.0, 3.0, 4.0];
        odd[32 * 500] = [-0.0, f32::INFINITY, 1e-40, 0.5];
        let all = [zeros, nan, odd];
        let stream = round_trip(&files(&all), &EncoderConfig::default());
        let (_, groups) = take_apart(&stream);
        let kinds = |wanted: SectionKind| {
            let sections = groups.iter().flat_map(|group| &group.frames).flat_map(|frame| &frame.sections);
            sections
                .filter(move |section| section.kind == wanted)
                .map(|section| section.payload.len())
                .sum::<usize>()
        };
        assert_eq!(kinds(SectionKind::Strays), 0);
        assert!(kinds(SectionKind::Blanks) > 0 && kinds(SectionKind::Blanks) < 400);
        round_trip(&files(&all), &at_level(1));
        round_trip(&files(&all), &at_level(9));
    }
}

#[test]
fn echoes_come_back_at_every_level_and_cost_less_than_strays() {
    let scanner = made_up(Recipe::Nebula);
    let points = points(&scanner, &with_echoes(image(&scanner, 1)));
    for level in [1, 3, 6, 9] {
        let stream = round_trip(&files(std::slice::from_ref(&points)), &at_level(level));
        let (_, groups) = take_apart(&stream);
        let sections = &groups[0].frames[0].sections;
        assert!(sections.iter().all(|section| section.kind != SectionKind::Strays), "level {level}");
        assert!(sections.iter().any(|section| section.kind == SectionKind::Echoes), "level {level}");
    }
}

#[test]
fn the_timing_of_a_block_is_found() {
    let truth = timed(&made_up(Recipe::RoboSense));
    let points = points(&truth, &image(&truth, 1));
    let (found, share) = fit(&[file(&points)]).expect("found");
    assert!(share > 0.999, "{share}");
    assert!(matches!(found.build().timing, Timing::Parts(_)));
    let (exact, inexact, strays) = counts(&found, &points);
    assert!(exact > 999 * points.len() / 1000 && inexact == 0 && strays < points.len() / 1000);
}

#[test]
fn published_timings_are_found_to_the_last_bit() {
    for timing in Timing::of_robosense(32) {
        let made_up = made_up(Recipe::RoboSense);
        let build = Build { timing: timing.clone(), ..made_up.build().clone() };
        let truth = Firings::new(build, made_up.lasers().to_vec(), (0..32).collect());
        let points = points(&truth, &image(&truth, 1));
        let (found, share) = fit(&[file(&points)]).expect("found");
        assert_eq!((&found.build().timing, share), (&timing, 1.0));
        let (_, inexact, strays) = counts(&found, &points);
        assert_eq!((inexact, strays), (0, 0), "{timing:?}");
    }
}

#[test]
fn all_versions_of_robosenses_driver_are_found() {
    for recipe in
        [Recipe::RoboSense, Recipe::RoboSenseEarly, Recipe::RoboSenseFused, Recipe::RoboSenseEarlyFused]
    {
        let truth = made_up(recipe);
        let points = points(&truth, &image(&truth, 1));
        let (found, share) = fit(&[file(&points)]).expect("found");
        assert_eq!((found.build().recipe, share), (recipe, 1.0));
        let (_, inexact, strays) = counts(&found, &points);
        assert_eq!((inexact, strays), (0, 0), "{recipe:?}");
    }
}

#[test]
fn lasers_that_see_only_the_floor_are_found() {
    for recipe in [Recipe::RoboSense, Recipe::LsLidar] {
        let truth = made_up(recipe);
        let mut image = image(&truth, 1);
        let width = image.columns.len();
        for (place, steps) in
            image.steps.cells_mut().iter_mut().enumerate().filter(|(place, _)| place / width >= 29)
        {
            // Nearly all returns of three lasers are within a metre, where the axis is not far.
            let metres = if place % 16 == 0 { 2.0 } else { 0.06 + (place % 97) as f64 * 0.01 };
            *steps = (metres * 1e6 / f64::from(truth.build().range_step_um)) as u32;
        }
        let points = points(&truth, &image);
        let (found, _) = fit(&[file(&points)]).expect("found");
        assert_eq!((found.build().recipe, found.rows()), (recipe, 32));
        let (_, inexact, strays) = counts(&found, &points);
        assert!(inexact + strays <= points.len() / 100, "{recipe:?}: {inexact}, {strays}");
    }
}

#[test]
fn lasers_that_look_back_and_forth_while_the_azimuth_goes_on_are_found() {
    let scan = vlp_32c(150);
    let (found, share) = fit(&[file(&scan)]).expect("found");
    assert!(share > 0.999, "{share}");
    assert!(matches!(found.build().timing, Timing::Parts(_)));
    assert!(found.lasers().iter().all(|laser| laser.azimuth == 0));
    let (exact, inexact, strays) = counts(&found, &scan);
    assert!(exact > 999 * scan.len() / 1000 && inexact == 0, "{exact}, {inexact}, {strays}");
    round_trip(&files(&[scan]), &EncoderConfig::default());
    // Likewise for a program that adds angles instead of ticks.
    let truth = made_up(Recipe::VelodyneRos);
    let truth = timed(&truth);
    let scan = points(&truth, &image(&truth, 1));
    let (found, share) = fit(&[file(&scan)]).expect("found");
    assert!(share > 0.95, "{share}");
    let (exact, inexact, strays) = counts(&found, &scan);
    assert!(exact > 95 * scan.len() / 100 && inexact == 0, "{exact}, {inexact}, {strays}");
}

#[test]
fn lasers_that_take_turns_are_found() {
    let truth = made_up(Recipe::Nebula);
    let scan = points(&truth, &taking_turns(image(&truth, 1)));
    let (found, share) = fit(&[file(&scan)]).expect("found");
    assert_eq!((found.build().recipe, share), (Recipe::Nebula, 1.0));
    let columns = found.project(&file(&scan).cloud, REACH).image.columns.len();
    assert_eq!(columns, image(&truth, 1).columns.len());
    let (_, inexact, _) = counts(&found, &scan);
    assert!(inexact <= scan.len() / 1000, "{inexact} of {}", scan.len());
}

/// Sums of degrees tell which whole ticks belong to the offsets by the end of the turn alone.
#[test]
fn whole_ticks_of_offsets_are_found() {
    let nominal = made_up(Recipe::NebulaJanuary2023);
    for degrees in [-3, 2, 7] {
        let lasers = nominal.lasers().iter();
        let lasers = lasers
            .map(|laser| Laser { azimuth: laser.azimuth + degrees * 1_000_000_000, ..*laser })
            .collect();
        let truth = Firings::new(nominal.build().clone(), lasers, (0..32).collect());
        let scan = points(&truth, &image(&truth, 1));
        let (found, share) = fit(&[file(&scan)]).expect("found");
        assert_eq!((found.build().recipe, share), (Recipe::NebulaJanuary2023, 1.0));
        assert_eq!(found.lasers(), truth.lasers(), "{degrees}");
        let (_, inexact, strays) = counts(&found, &scan);
        assert_eq!((inexact, strays), (0, 0), "{degrees}");
    }
}

#[test]
fn constants_of_any_digits_are_found_to_the_last_bit() {
    let nominal = made_up(Recipe::Nebula);
    let lasers = nominal.lasers().iter().zip(0i64..).map(|(laser, row)| {
        // As float32 values: the angles in Hesai's files have more than three decimals.
        let single = |units: i64| (f64::from((units as f64 * 1e-9) as f32) * 1e9).round() as i64;
        Laser {
            elevation: single(laser.elevation + 37 * row * row * 1009 % 1_000_000),
            azimuth: single(laser.azimuth - 3_141_592_653 + 41 * row * 7919 % 1_000_000),
        }
    });
    let truth = Firings::new(nominal.build().clone(), lasers.collect(), (0..32).collect());
    let scan = points(&truth, &image(&truth, 1));
    let (found, share) = fit(&[file(&scan)]).expect("found");
    assert_eq!((found.build().recipe, share), (Recipe::Nebula, 1.0));
    let (_, inexact, _) = counts(&found, &scan);
    assert!(inexact <= scan.len() / 200, "{inexact} of {}", scan.len());
}

#[test]
fn ousters_whose_beams_start_off_the_axis_are_found() {
    for (driver, recipe, along) in [
        (OusterDriver::Sdk, Recipe::Ouster, 27_116),
        (OusterDriver::Ros, Recipe::OusterRos, 27_116),
        (OusterDriver::Early, Recipe::OusterEarly, -27_116),
    ] {
        let points = ouster(64, driver);
        let (found, share) = fit(&[file(&points)]).expect("found");
        assert_eq!((found.build().recipe, found.build().ticks), (recipe, 512));
        assert_eq!((found.build().origin.along_um, found.build().origin.up_um), (along, 36_180));
        assert_eq!(share, 1.0);
        let (_, inexact, strays) = counts(&found, &points);
        assert_eq!((inexact, strays), (0, 0));
        let stream = round_trip(&files(std::slice::from_ref(&points)), &EncoderConfig::default());
        assert!(stream.len() < points.len(), "{} bytes", stream.len());
    }
}

#[test]
fn an_ouster_in_a_room_is_found_from_returns_alone() {
    // Nothing is farther than 3.5 m, from where elevations also depend on the azimuths of lasers.
    let scan = ouster(64, OusterDriver::Sdk);
    let near = seen_in_part(&scan, |_, [x, y, z, _]| (0.1..3.5).contains(&x.hypot(y.hypot(*z))));
    let returns: Points = near.into_iter().filter(|point| point[..3] != [0.0; 3]).collect();
    assert!(returns.len() > 5000, "{}", returns.len());
    let (found, _) = fit(&[file(&returns)]).expect("found");
    let (_, inexact, strays) = counts(&found, &returns);
    // A laser with fewer than 12 returns stays unknown.
    assert!(inexact == 0 && strays < 2 * 12, "{inexact}, {strays}");
}

#[test]
fn the_range_of_an_ouster_is_not_coded_twice() {
    let file = (String::from("0.pcd"), ouster_fields(32));
    let (_, groups) = take_apart(&round_trip(&[file], &EncoderConfig::default()));
    let coded = bytes_of(SectionKind::Channels, &groups);
    // 512 times, 32 rings, and ambient light of 1013 values, which take ten bits each.
    let ambient = 32 * 512 * 10 / 8;
    assert!(coded < ambient + 4000, "{coded} bytes");
}

#[test]
fn the_fullest_scan_shows_the_scanner() {
    // The last scan ends after a few columns.
    let whole = ouster(32, OusterDriver::Sdk);
    let mut cut = whole.clone();
    (0..cut.len()).filter(|record| record % 512 > 30).for_each(|record| cut[record] = [0.0; 4]);
    let (found, _) = fit(&[file(&whole), file(&cut)]).expect("found");
    let (_, inexact, strays) = counts(&found, &whole);
    assert_eq!((inexact, strays), (0, 0));
}

/// A scan in which only these of its records have a return.
fn seen_in_part(scan: &Points, is_seen: impl Fn(usize, &[f32; 4]) -> bool) -> Points {
    let blank = scan.contains(&[0.0; 4]);
    let records = scan.iter().enumerate().map(|(record, point)| (is_seen(record, point), *point));
    match blank {
        true => records.map(|(is_seen, point)| if is_seen { point } else { [0.0; 4] }).collect(),
        false => records.filter(|(is_seen, _)| *is_seen).map(|(_, point)| point).collect(),
    }
}

#[test]
fn lasers_that_the_fullest_scan_does_not_show_are_found_in_another() {
    let room = |recipe| {
        let scanner = made_up(recipe);
        points(&scanner, &image(&scanner, 1))
    };
    let scans = [
        ("an image by lines", ouster(32, OusterDriver::Sdk), 512),
        ("an image by columns", room(Recipe::Ouster), 1),
        (
            "returns",
            room(Recipe::VelodyneRos).into_iter().filter(|point| point[..3] != [0.0; 3]).collect(),
            1,
        ),
    ];
    for (name, whole, width) in scans {
        // The upper lasers look into the sky.
        let low = seen_in_part(&whole, |_, [x, y, z, _]| z.atan2(x.hypot(*y)) < 11.0f32.to_radians());
        let columns = if width > 1 { width } else { whole.len() };
        let part = seen_in_part(&whole, |record, _| record % columns < columns * 3 / 5);
        let (found, _) = fit(&[file(&part), file(&low), file(&low)]).expect("found");
        for scan in [&low, &part] {
            let (_, inexact, strays) = counts(&found, scan);
            assert!(inexact <= scan.len() / 1000 && strays == 0, "{name}: {inexact}, {strays}");
        }
    }
}

#[test]
fn scans_of_a_tenth_of_their_points_show_the_scanner() {
    // About three points of a firing remain.
    let mut random = Random(1);
    for recipe in [Recipe::VelodyneRos, Recipe::DoubleYAhead, Recipe::Pandar64, Recipe::RoboSense] {
        let truth = made_up(recipe);
        let all = points(&truth, &image(&truth, 1));
        let few = all.into_iter().filter(|point| random.below(10) == 0 && *point != [0.0; 4]);
        let few: Points = few.collect();
        let (found, _) = fit(&[file(&few)]).unwrap_or_else(|| panic!("{recipe:?} is not found"));
        let (exact, inexact, strays) = counts(&found, &few);
        assert!(inexact + strays <= few.len() / 100, "{recipe:?}: {exact}, {inexact}, {strays}");
    }
}

/// Whether a scanner's returns are in the order of the file.
fn keeps_order(scanner: &Firings, points: &Points) -> bool {
    let projection = scanner.project(&file(points).cloud, REACH);
    let returns = scanner.file_order(&projection.image).into_iter();
    let place = |found: Return| projection.point_of_cell[(found.row as usize, found.column as usize)];
    returns.map(place).is_sorted()
}

#[test]
fn files_of_returns_alone_row_by_row_keep_their_order_if_another_shows_more_lasers() {
    let truth = made_up(Recipe::VelodyneRos).line_by_line((0..32).collect());
    let whole = points(&truth, &RangeImage { is_full: false, ..image(&truth, 1) });
    let low = seen_in_part(&whole, |_, [x, y, z, _]| z.atan2(x.hypot(*y)) < 11.0f32.to_radians());
    let part = seen_in_part(&whole, |record, _| record % 5 < 3);
    let (found, _) = fit(&[file(&part), file(&low)]).expect("found");
    assert!(keeps_order(&found, &low) && keeps_order(&found, &part));
}

#[test]
fn beams_through_a_focal_point_are_found() {
    let points = velodyne_decoder_vlp_16(110);
    let (found, share) = fit(&[file(&points)]).expect("found");
    assert_eq!((found.build().recipe, found.build().origin.along_um), (Recipe::VelodyneDecoder, 41_910));
    assert!(share > 0.99, "{share}");
    let (exact, inexact, strays) = counts(&found, &points);
    // glibc's cosine is another float32 for one angle in a hundred, and the azimuth advances by fractions of
    // a tick.
    assert!(inexact <= exact / 30 && strays <= exact / 100, "{exact}, {inexact}, {strays}");
}

#[test]
fn rounded_coordinates_take_little_more_than_those_to_the_last_bit() {
    let of = |scanner: Firings| points(&scanner, &image(&scanner, 1));
    let made_up = |recipe| of(made_up(recipe));
    let vlp_16 = scans(&config(8, 1, 1)).remove(0);
    // Decimal places, and bytes in percent of those of the scan before it was rounded. The room of the last
    // one has no noise, so that there is little else to code than what rounding has changed.
    for (name, scan, limits) in [
        ("VLP-16", vlp_16, &[(3, 105), (2, 100)][..]),
        ("32 lasers with offsets", made_up(Recipe::DoubleYAhead), &[(3, 102), (2, 130)]),
        ("32 lasers with offsets, in single precision", made_up(Recipe::VelodyneRos), &[(3, 102), (2, 145)]),
        ("512 columns", ouster(32, OusterDriver::Sdk), &[(3, 180)]),
    ] {
        let before = round_trip(&files(std::slice::from_ref(&scan)), &EncoderConfig::default()).len();
        for (places, most) in limits {
            let after = round_trip(&files(&[rounded(&scan, *places)]), &EncoderConfig::default()).len();
            assert!(after * 100 < before * most, "{name}, {places} places: {before} -> {after} bytes");
        }
    }
}

#[test]
fn rounded_scans_that_are_cut_and_mixed_up_come_back() {
    let whole = scans(&config(9, 1, 2)).remove(0);
    let by_rows: Points = {
        let mut points = whole.clone();
        points.sort_by(|a, b| {
            let slope = |p: &[f32; 4]| (p[2] / p[0].hypot(p[1]) * 50.0).round();
            slope(b).total_cmp(&slope(a))
        });
        points
    };
    let twice: Points = whole.iter().flat_map(|point| [*point, point.map(|value| value * 1.01)]).collect();
    // Near points have no certain tick; on the axes coordinates are zeros of either sign.
    let near: Points = whole.iter().map(|&[x, y, z, i]| [x / 40.0, y / 40.0, z / 40.0, i]).collect();
    let sector = whole[500..2000].to_vec();
    for places in 1..4 {
        let scans = [&whole, &by_rows, &twice, &near, &sector].map(|points| rounded(points, places));
        for scan in scans.clone() {
            round_trip(&files(&[scan]), &EncoderConfig::default());
        }
        let (_, largest) = keeps_the_bound(&files(&scans), &bounded(20_000), 20_000);
        // Decimetres take fewer bytes exactly than within two centimetres.
        assert!(largest > 0.0 || places == 1);
        round_trip(&files(&scans), &at_level(1));
    }
}

#[test]
fn files_of_returns_alone_row_by_row_are_understood() {
    for recipe in Recipe::ALL {
        let truth = made_up(recipe).line_by_line((0..32).rev().collect());
        let image = RangeImage { is_full: false, ..image(&truth, 1) };
        let points = points(&truth, &image);
        let (found, share) = fit(&[file(&points)]).unwrap_or_else(|| panic!("{recipe:?} is not found"));
        assert!(share > 0.999, "{recipe:?}: {share}");
        let (exact, inexact, strays) = counts(&found, &points);
        assert!(inexact <= points.len() / 1000 && strays == 0, "{recipe:?}: {exact}, {inexact}, {strays}");
        assert!(keeps_order(&found, &points), "{recipe:?}: the order of the file");
        let projection = found.project(&file(&points).cloud, REACH);
        // Less than twice as many columns as the scanner measured.
        assert!(projection.image.columns.len() < 2 * image.columns.len(), "{recipe:?}");
    }
}

#[test]
fn rows_of_a_vlp_16_are_put_back_into_firings() {
    let points = scans(&config(3, 1, 1)).remove(0);
    let mut rows = points.clone();
    rows.sort_by_key(|[x, y, z, _]| {
        -(f64::from(*z).atan2(f64::from(x.hypot(*y))).to_degrees().round() as i64)
    });
    let columns = |points: &Points| {
        let (found, share) = fit(&[file(points)]).expect("found");
        assert!(share > 0.99, "{share}");
        found.project(&file(points).cloud, REACH).image.columns.len()
    };
    let (of_firings, of_rows) = (columns(&points), columns(&rows));
    assert!(of_rows <= of_firings + of_firings / 100, "{of_rows} columns, not {of_firings}");
    let size =
        |points: &Points| round_trip(&files(std::slice::from_ref(points)), &EncoderConfig::default()).len();
    assert!(size(&rows) < size(&points) * 11 / 10, "{} bytes, not {}", size(&rows), size(&points));
}

/// An image with a line for each laser and a column for each step of the azimuth, as SLAM programs make them:
/// the returns of a column may be of neighbouring firings, and some steps pass between two firings. Cells
/// without a return are `blank`.
fn in_steps_of_azimuth(scan: &Points, columns: usize, blank: [f32; 4]) -> Points {
    let mut image = vec![blank; VLP_16_ELEVATIONS.len() * columns];
    for point in scan {
        let [x, y, z] = [point[0], point[1], point[2]].map(f64::from);
        let elevation = libm::atan2(z, libm::hypot(x, y)).to_degrees();
        let row = ((elevation + 15.0) / 2.0).round() as usize;
        let column = (libm::atan2(x, y) / TAU).rem_euclid(1.0) * columns as f64;
        image[row * columns + column as usize % columns] = *point;
    }
    image
}

#[test]
fn images_with_a_column_for_each_step_of_the_azimuth_show_the_scanner() {
    let scans = scans(&config(9, 2, 1));
    for blank in [[f32::NAN, f32::NAN, f32::NAN, -1.0], [0.0; 4]] {
        let images: Vec<Points> = scans.iter().map(|scan| in_steps_of_azimuth(scan, 1999, blank)).collect();
        let returns =
            images.iter().flatten().filter(|point| point[3].to_bits() != blank[3].to_bits()).count();
        let scanner = fitted(&images[0]);
        assert_eq!((scanner.build().recipe, scanner.build().range_step_um), (Recipe::VelodyneRos, 2000));
        let (exact, inexact, _) = counts(&scanner, &images[0]);
        assert!(inexact * 1000 < exact && exact * 100 > 98 * returns / 2, "{exact}, {inexact} of {returns}");
        let stream = round_trip(&files(&images), &EncoderConfig::default());
        let (_, groups) = take_apart(&stream);
        let blanks = bytes_of(SectionKind::Blanks, &groups) + bytes_of(SectionKind::Strays, &groups);
        assert!(blanks < 200, "{blanks} bytes for records without a return");
    }
}

#[test]
fn ousters_without_blanks_are_found_in_every_order() {
    let (rows, width) = (64, 512);
    let points = ouster(rows, OusterDriver::Sdk);
    let cells = |order: &dyn Fn(usize, usize) -> usize| -> Points {
        let cells = (0..width).flat_map(|column| (0..rows).map(move |row| (row, column)));
        let points = cells.map(|(row, column)| points[row * width + order(row, column)]);
        points.filter(|point| point[..3] != [0.0; 3]).collect()
    };
    let lines: Points = points.iter().copied().filter(|point| point[..3] != [0.0; 3]).collect();
    let columns = cells(&|_, column| column);
    let firings = cells(&|row, column| (column + [24, 8, 504, 488][row % 4]) % width);
    for (name, points) in [("lines", lines), ("columns", columns), ("firings", firings)] {
        let (found, share) = fit(&[file(&points)]).unwrap_or_else(|| panic!("{name}: none is found"));
        assert_eq!((found.build().recipe, found.build().ticks), (Recipe::Ouster, 512), "{name}");
        assert_eq!((found.build().origin.along_um, found.build().origin.up_um), (27_116, 36_180), "{name}");
        assert_eq!(share, 1.0, "{name}");
        let (_, inexact, strays) = counts(&found, &points);
        assert_eq!((inexact, strays), (0, 0), "{name}");
        let stream = round_trip(&files(std::slice::from_ref(&points)), &EncoderConfig::default());
        assert!(stream.len() < 5 * points.len() / 4, "{name}: {} bytes", stream.len());
    }
}

#[test]
fn a_first_scan_of_another_kind_does_not_keep_the_others_from_their_scanner() {
    let scans = scans(&config(3, 3, 4));
    let y_up = |[x, y, z, i]: [f32; 4]| [-y, -z, x, i];
    for turned in [false, true] {
        let of_scanner = scans.iter().map(|points| match turned {
            true => points.iter().copied().map(y_up).collect(),
            false => points.clone(),
        });
        let files = files(&std::iter::once(random_points(5000, 7)).chain(of_scanner).collect::<Vec<_>>());
        let [all, first, others] = [&files[..], &files[..1], &files[1..]]
            .map(|files| round_trip(files, &EncoderConfig::default()).len());
        assert!(all < first + others + others / 10, "{all} bytes, alone {first} and {others}");
    }
}

#[test]
fn two_scanners_in_one_folder_are_told_apart() {
    let scan = |scanner: &Firings| points(scanner, &image(scanner, 1));
    let one = made_up(Recipe::DoubleYAhead);
    // Another unit, whose lasers differ by so little that most of its points are in the first one's image.
    let lasers = (0..).zip(one.lasers()).map(|(row, laser)| Laser {
        elevation: laser.elevation + [3, -4, 5][row % 3] * 1_000_000,
        azimuth: laser.azimuth + [2, -3][row % 2] * 1_000_000,
    });
    let another = Firings::new(one.build().clone(), lasers.collect(), (0..32).map(|n| n * 5 % 32).collect());
    for (first, second) in [
        (scan(&made_up(Recipe::VelodyneRos)), scan(&made_up(Recipe::SingleRangeXAhead))),
        (scan(&one), scan(&another)),
    ] {
        let stream =
            round_trip(&files(&[first.clone(), second.clone(), first, second]), &EncoderConfig::default());
        let (scanners, groups) = take_apart(&stream);
        assert_eq!(scanners.len(), 2);
        let tracks: Vec<u8> = groups[0].frames.iter().map(|frame| frame.header.stamp.track).collect();
        assert!(tracks[0] == tracks[2] && tracks[1] == tracks[3] && tracks[0] != tracks[1]);
    }
}

#[test]
fn units_that_see_only_what_is_near_are_told_apart() {
    let near = |scanner: &Firings| {
        let mut image = image(scanner, 1);
        image.steps.cells_mut().iter_mut().for_each(|steps| *steps /= 6);
        let points = points(scanner, &image).into_iter();
        points.filter(|point| point[..3] != [0.0; 3]).collect::<Points>()
    };
    let one = made_up(Recipe::DoubleYAhead);
    // Nearby, the beams of the other unit are within reach of this one's.
    let lasers = (0..).zip(one.lasers()).map(|(row, laser)| Laser {
        elevation: laser.elevation + [70, -60, 80][row % 3] * 1_000_000,
        ..*laser
    });
    let another = Firings::new(one.build().clone(), lasers.collect(), (0..32).map(|n| n * 5 % 32).collect());
    let (one, another) = (near(&one), near(&another));
    let (of_one, _) = fit(&[file(&one)]).expect("found");
    assert!(of_one.explained_share(&file(&another).cloud.positions) > 0.5);
    let (of_both, _) = fit(&[file(&one), file(&another)]).expect("found");
    assert_eq!(of_both.lasers().len(), 32);
    let stream = round_trip(&files(&[one, another]), &EncoderConfig::default());
    assert_eq!(take_apart(&stream).0.len(), 2);
}

#[test]
fn scanners_that_take_turns_are_all_found() {
    let scan = |recipe| {
        let scanner = made_up(recipe);
        points(&scanner, &image(&scanner, 1))
    };
    let recipes = [Recipe::VelodyneRos, Recipe::SingleRangeXAhead, Recipe::DoubleYAhead, Recipe::RoboSense];
    let scans = recipes.map(scan);
    let two_in_turn: Vec<_> = (0..21).map(|frame| scans[frame % 2].clone()).collect();
    for (scans, count) in [(&scans[..], scans.len()), (&two_in_turn, 2)] {
        let stream = round_trip(&files(scans), &EncoderConfig::default());
        assert_eq!(take_apart(&stream).0.len(), count);
    }
}
