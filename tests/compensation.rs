//! Motion-compensated scans: the compensation is detected, the scans are coded as measured, and restored.

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::firings::{image, made_up, moved_by_stamps, sorted, stamped};
use crate::common::formats::{kitti, pcd_stamped, pcd_xyz};
use crate::common::scans::{Points, compensated, moved, random_points, scans, shuffled, small, unrounded};
use crate::common::streams::at_level;
use crate::common::sweeps::{SLOTS, STRAIGHT, TURNING, elevation, street, through_a_map};
use crate::common::{File, decode_files, encode_files, round_trip, section_bytes};
use lidarpc::internals::container::SectionKind;
use lidarpc::internals::edit::{Named, cut};
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::ground::error::Limits;
use lidarpc::internals::scanner::firings::Recipe;
use lidarpc::internals::scanner::motion::world::{self, World};
use lidarpc::internals::scanner::motion::{Compensation, undo};
use lidarpc::internals::stream::FrameRange;

fn positions(points: &Points) -> Vec<[f32; 3]> {
    points.iter().map(|&[x, y, z, _]| [x, y, z]).collect()
}

fn named(frames: &[Points]) -> Vec<File> {
    (0..).zip(frames).map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
}

/// Rotations and translations of a turn: crawling, a street, a highway, a sharp corner.
const MOTIONS: [([f64; 3], [f64; 3]); 4] = [
    ([0.0001, -0.0002, 0.0005], [-0.02, 0.001, 0.0]),
    ([0.0005, 0.0011, -0.002], [-0.83, -0.04, -0.02]),
    ([-0.001, 0.002, 0.02], [-3.5, 0.1, -0.05]),
    ([0.003, 0.001, -0.12], [-0.6, 0.05, 0.01]),
];

#[test]
fn the_measured_millimetres_are_found_again() {
    for (seed, (rotation, translation)) in (1..).zip(MOTIONS) {
        let measured = scans(&small(seed, 1)).swap_remove(0);
        let file = compensated(&measured, rotation, translation);
        let (found, compensation) = undo(&positions(&file)).expect("a motion is found");
        let Compensation::Turn(compensation) = compensation else { panic!("through no map") };
        let wrong = found.iter().zip(positions(&measured)).filter(|(a, b)| **a != *b).count();
        assert_eq!(wrong, 0);
        // A motion that few points determine leaves some coordinates on the wrong side of a rounding
        // boundary.
        let missed = compensation.misses.len();
        assert!(missed * 200 < measured.len(), "{missed} of {} points missed", measured.len());
        let motion = compensation.motion;
        let off = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off(motion.rotation, rotation) < 1e-7, "{motion:?}");
        assert!(off(motion.translation, translation) < 1e-6, "{motion:?}");
    }
}

/// A drive as it was measured, and as it is in files.
fn drive() -> (Vec<File>, Vec<File>) {
    let measured = scans(&small(7, MOTIONS.len()));
    let moved: Vec<Points> =
        measured.iter().zip(MOTIONS).map(|(points, (r, t))| compensated(points, r, t)).collect();
    (named(&measured), named(&moved))
}

#[test]
fn frames_take_little_more_than_what_was_measured() {
    let (measured, files) = drive();
    let config = EncoderConfig::default();
    let before = encode_files(&measured, &config).len();
    let stream = round_trip(&files, &config);
    assert!(stream.len() < before + 120 * files.len(), "{} bytes, measured ones {before}", stream.len());
    let of_motion = section_bytes(&stream)[&SectionKind::Compensation];
    assert!(of_motion < 80 * files.len(), "{of_motion} bytes");
}

#[test]
fn the_bound_holds_where_points_are_in_the_file() {
    let (measured, files) = drive();
    for max_error_um in [2_000, 20_000, 200_000] {
        let config = bounded(max_error_um);
        let before = encode_files(&measured, &config).len();
        let (stream, _) = keeps_the_bound(&files, &config, max_error_um);
        assert!(section_bytes(&stream).contains_key(&SectionKind::Compensation));
        assert!(stream.len() < before + before / 5, "{} bytes, measured ones {before}", stream.len());
    }
}

#[test]
fn frames_that_are_coded_again_stay_what_they_are() {
    let (_, files) = drive();
    for config in [EncoderConfig::default(), bounded(20_000)] {
        let stream = encode_files(&files, &config);
        let range = FrameRange { start: 1, end: Some(3) };
        let mut part = Vec::new();
        let named = Named { path: "in.lpc".into(), stream: stream.as_slice() };
        assert_eq!(cut(named, range, &Limits::default(), &mut part).unwrap().recoded, 2);
        assert!(decode_files(&part).unwrap() == decode_files(&stream).unwrap()[1..3]);
    }
}

#[test]
fn points_that_were_not_moved_so_come_back_too() {
    let (rotation, translation) = MOTIONS[1];
    let mut points = compensated(&scans(&small(4, 1))[0], rotation, translation);
    points[5] = [f32::NAN, f32::INFINITY, f32::from_bits(0xffc0_0001), 0.0];
    points[6] = [0.0, -0.0, 1e30, 0.5];
    points[7] = [f32::MIN_POSITIVE / 4.0, f32::MAX, f32::MIN, 0.5];
    points.iter_mut().skip(100).take(20).for_each(|point| point[1] += 0.25);
    let odd: Points = random_points(10, 5).into_iter().map(|[x, y, z, i]| [x + 1e-5, y, z, i]).collect();
    points.splice(700..700, odd);
    let files = vec![
        ("0.bin".to_owned(), [kitti(&points), vec![1, 2, 3]].concat()),
        ("1.pcd".to_owned(), pcd_xyz(&points)),
    ];
    let stream = round_trip(&files, &EncoderConfig::default());
    assert!(section_bytes(&stream).contains_key(&SectionKind::Compensation));
}

#[test]
fn what_was_not_moved_so_is_left_alone() {
    let config = small(2, 1);
    let measured = scans(&config).swap_remove(0);
    let (rotation, translation) = MOTIONS[1];
    let file = compensated(&measured, rotation, translation);
    let half: Points = file
        .iter()
        .enumerate()
        .map(|(n, &[x, y, z, i])| [if n % 2 == 0 { x * 1.00001 } else { x }, y, z, i])
        .collect();
    let others = [
        measured.clone(),
        unrounded(&config, &measured),
        moved(&measured),
        shuffled(&file, 3),
        half,
        vec![[0.1, 0.0, 0.3, 0.0]; 300],
        vec![[f32::NAN; 4]; 30],
        Points::new(),
    ];
    for (number, points) in others.iter().enumerate() {
        assert!(undo(&positions(points)).is_none(), "scan {number}");
    }
}

/// Rotations and translations during a scan: of a scanner that nearly stands still, and of drives.
const STANDING: [([f64; 3], [f64; 3]); 3] = [
    ([6e-6, -4e-6, -1.5e-5], [-1e-4, 4e-5, 8e-5]),
    ([0.0; 3], [2e-4, -1e-4, 5e-5]),
    ([2e-5, 1e-5, 3e-5], [0.0; 3]),
];
const DRIVEN: [([f64; 3], [f64; 3]); 3] = [MOTIONS[0], MOTIONS[1], MOTIONS[2]];

/// Scans by one recipe, measured and moved, in the order of arrival, with their time stamps.
fn by_stamps(recipe: Recipe, motions: &[([f64; 3], [f64; 3])], packet: u32) -> Stamped {
    let scanner = made_up(recipe);
    let (measured, rows, times) = stamped(&scanner, &image(&scanner, 4), packet);
    let moved = motions
        .iter()
        .map(|(rotation, translation)| moved_by_stamps(&measured, &times, *rotation, *translation));
    let moved = moved.collect();
    Stamped { measured, moved, rows, times }
}

struct Stamped {
    measured: Points,
    moved: Vec<Points>,
    rows: Vec<u16>,
    times: Vec<f64>,
}

impl Stamped {
    fn files<'p>(&self, scans: impl IntoIterator<Item = &'p Points>) -> Vec<File> {
        let file = |points: &Points| pcd_stamped(points, &self.rows, &self.times);
        (0..).zip(scans).map(|(n, points)| (format!("{n}.pcd"), file(points))).collect()
    }

    /// The moved scans, sorted by time.
    fn sorted_files(&self) -> Vec<File> {
        let rows = sorted(&self.rows, &self.times);
        let file = |points: &Points| pcd_stamped(&sorted(points, &self.times), &rows, &self.times);
        (0..).zip(&self.moved).map(|(n, points)| (format!("{n}.pcd"), file(points))).collect()
    }
}

#[test]
fn points_moved_by_their_time_stamps_take_little_more_than_what_was_measured() {
    let cases = [
        (Recipe::Pandar64, STANDING, 6),
        (Recipe::VelodyneRos, STANDING, 6),
        (Recipe::DoubleYAhead, DRIVEN, 1),
        (Recipe::Pandar64, DRIVEN, 1),
    ];
    for (recipe, motions, packet) in cases {
        let scans = by_stamps(recipe, &motions, packet);
        let before = encode_files(&scans.files([&scans.measured; 3]), &EncoderConfig::default()).len();
        let stream = round_trip(&scans.files(&scans.moved), &EncoderConfig::default());
        let (moved, sections) = (&scans.moved, section_bytes(&stream));
        assert!(sections[&SectionKind::Stamped] < 800 * moved.len(), "{recipe:?}: {sections:?}");
        assert!(
            stream.len() < before + 1000 * moved.len(),
            "{recipe:?}: {} bytes, measured {before}",
            stream.len()
        );
    }
}

#[test]
fn single_scans_that_were_moved_by_fractions_of_a_step_take_little_more() {
    let motions = [
        ([1.2e-5, 0.0, 0.0], [-4.8e-5, -5.1e-5, 2.38e-4]),
        ([0.0, 1.5e-5, 0.0], [3e-5, 8e-5, -2.6e-4]),
        ([4e-5, -3e-5, 2e-5], [2e-4, -3e-4, 4e-4]),
        ([-6e-5, 2e-5, 1e-5], [1e-4, 1e-4, 6e-4]),
    ];
    let scans = by_stamps(Recipe::Pandar64, &motions, 6);
    let before = encode_files(&scans.files([&scans.measured]), &EncoderConfig::default()).len();
    for (points, motion) in scans.moved.iter().zip(motions) {
        let stream = round_trip(&scans.files([points]), &EncoderConfig::default());
        assert!(stream.len() < before + 1000, "{motion:?}: {} bytes, measured {before}", stream.len());
    }
}

#[test]
fn what_a_sort_by_time_shuffles_takes_no_more() {
    let scans = by_stamps(Recipe::Pandar64, &STANDING, 6);
    let Stamped { moved, times, .. } = &scans;
    let before = encode_files(&scans.files(moved), &EncoderConfig::default()).len();
    let stream = round_trip(&scans.sorted_files(), &EncoderConfig::default());
    assert!(section_bytes(&stream).contains_key(&SectionKind::Sorted));
    assert!(stream.len() <= before + 16 * moved.len(), "{} bytes, unsorted {before}", stream.len());
    // Shuffled in another way, within the packets.
    let mut others = moved.clone();
    for points in &mut others {
        let mut start = 0;
        for packet in times.chunk_by(|a, b| a == b) {
            points[start..start + packet.len()].reverse();
            start += packet.len();
        }
    }
    let stream = round_trip(&scans.files(&others), &EncoderConfig::default());
    assert!(!section_bytes(&stream).contains_key(&SectionKind::Sorted));
}

#[test]
fn the_bound_holds_where_time_stamps_say_that_points_are() {
    let files = by_stamps(Recipe::Pandar64, &STANDING, 6).sorted_files();
    for max_error_um in [500, 20_000] {
        let (stream, _) = keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
        assert!(section_bytes(&stream).contains_key(&SectionKind::Sorted));
    }
}

#[test]
fn odd_points_and_odd_time_stamps_come_back() {
    let Stamped { moved, rows, times, .. } = by_stamps(Recipe::Pandar64, &STANDING[..1], 6);
    let mut points = moved[0].clone();
    points[5] = [f32::NAN, f32::INFINITY, f32::from_bits(0xffc0_0001), 0.0];
    points[6] = [0.0, -0.0, 1e30, 0.5];
    points[7] = [f32::MIN_POSITIVE / 4.0, f32::MAX, f32::MIN, 0.5];
    points.iter_mut().skip(100).take(20).for_each(|point| point[1] += 0.25);
    let odd = |places: &[(usize, f64)]| {
        let mut times = times.clone();
        places.iter().for_each(|(place, time)| times[*place] = *time);
        times
    };
    let last = times.len() - 1;
    let all_times = [
        times.clone(),
        odd(&[(50, f64::NAN), (60, f64::INFINITY), (70, f64::NEG_INFINITY)]),
        odd(&[(0, -1.0)]),
        odd(&[(last, f64::MAX), (0, f64::MIN)]),
        vec![times[0]; times.len()],
        times.iter().rev().copied().collect(),
    ];
    let files: Vec<File> = (0..)
        .zip(&all_times)
        .map(|(n, times)| (format!("{n}.pcd"), pcd_stamped(&points, &rows, times)))
        .collect();
    let stream = round_trip(&files, &EncoderConfig::default());
    assert!(section_bytes(&stream).contains_key(&SectionKind::Stamped));
}

#[test]
fn elevations_are_thirds_of_four_degrees() {
    let all: Vec<f64> = (0..SLOTS).map(elevation).collect();
    assert_eq!((all[0], all[1], all[3], all[18], all[31]), (-30.67, -29.33, -26.66, -6.66, 10.67));
}

fn bits(points: &[[f32; 3]]) -> Vec<[u32; 3]> {
    points.iter().map(|point| point.map(f32::to_bits)).collect()
}

#[test]
fn a_sweep_moved_through_a_map_is_measured_again_and_comes_back() {
    for (seed, drive) in (1..).zip([TURNING, STRAIGHT]) {
        let truth = street(seed);
        let file = through_a_map(&truth, &drive);
        let (found, mut world) = world::undo(&file).expect("it was moved through a map");
        let wrong = found.iter().zip(&truth).filter(|(a, b)| a != b).count();
        assert!(wrong * 200 < truth.len(), "{wrong} points are not as measured");
        let quickly = world::measured(&file).expect("it was moved through a map");
        let wrong = quickly.iter().zip(&truth).filter(|(a, b)| a != b).count();
        assert!(wrong * 100 < truth.len(), "{wrong} points are not as measured at first");

        world.find_corrections(&found, &file, |a, b| a.map(f32::to_bits) == b.map(f32::to_bits));
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
fn sweeps_that_went_through_no_map_are_left_alone() {
    let truth = street(3);
    let file = through_a_map(&truth, &TURNING);
    let noise: Vec<[f32; 3]> =
        file.iter().enumerate().map(|(n, &[x, y, z])| [x + n as f32 * 1e-5, y, z]).collect();
    let mut odd = file.clone();
    odd[77] = [f32::NAN, 0.0, 1.0];
    for points in [&truth[..], &noise, &file[1..], &odd, &[[1.0, 0.5, 0.25]; 32 * 300], &[]] {
        assert!(world::undo(points).is_none() && world::measured(points).is_none());
    }
}

#[test]
fn every_level_undoes_a_map() {
    let sweep = through_a_map(&street(1), &TURNING);
    let points: Points = sweep.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
    for level in [1, 2, 3, 6] {
        let stream = encode_files(&named(std::slice::from_ref(&points)), &at_level(level));
        let is_undone = section_bytes(&stream).get(&SectionKind::World).is_some_and(|&bytes| bytes > 0);
        assert!(is_undone, "level {level}");
    }
}

#[test]
fn the_bound_makes_sweeps_that_went_through_a_map_smaller() {
    let sweep = through_a_map(&street(1), &TURNING);
    let points: Points = sweep.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
    let files = named(std::slice::from_ref(&points));
    let exact = encode_files(&files, &EncoderConfig::default());
    for (max_error_um, of_exact) in [(2_000, 0.95), (20_000, 0.7)] {
        let (stream, _) = keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
        assert!(section_bytes(&stream).contains_key(&SectionKind::World));
        let limit = (of_exact * exact.len() as f64) as usize;
        assert!(stream.len() < limit, "{max_error_um} um: {} bytes, exact {}", stream.len(), exact.len());
    }
}
