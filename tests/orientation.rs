//! Files whose axes are not those of the scanner: y up, z ahead, or reversed.

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::firings::{OusterDriver, ouster};
use crate::common::formats::kitti;
use crate::common::scans::{Points, compensated, scans};
use crate::common::streams::at_level;
use crate::common::{File, decode_files, encode_files, round_trip, take_apart};
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::scanner::{Orientation, Scanner};
use lidarpc::internals::study::synth::{SynthConfig, SynthScanner};

/// The number of orientations.
const COUNT: u64 = 48;

fn all() -> Vec<u64> {
    (0..COUNT).collect()
}

fn files(scans: &[Points], orientation: Orientation) -> Vec<File> {
    let point = |&[x, y, z, intensity]: &[f32; 4]| {
        let [x, y, z] = orientation.to_file([x, y, z]);
        [x, y, z, intensity]
    };
    let file = |points: &Points| kitti(&points.iter().map(point).collect::<Vec<_>>());
    scans.iter().enumerate().map(|(number, points)| (format!("{number}.bin"), file(points))).collect()
}

/// Some scans of a simulated scanner, with every `thinning`-th firing.
fn simulated(scanner: SynthScanner, frames: usize, thinning: usize) -> Vec<Points> {
    scans(&SynthConfig { scanner, seed: 3, frames, thinning, ..SynthConfig::default() })
}

/// The stream of files. One file is decoded only once: to restore it is the same for all orientations.
fn encoded(files: &[File]) -> Vec<u8> {
    if files.len() > 1 {
        return round_trip(files, &EncoderConfig::default());
    }
    let stream = encode_files(files, &EncoderConfig::default());
    assert!(decode_files(&stream).expect("decodes") == files);
    stream
}

/// Files with any axes take about as many bytes as those with the scanner's. `is_unique`: the points tell the
/// orientation.
fn takes_no_more_bytes(scans: &[Points], numbers: &[u64], is_unique: bool) {
    let upright = encoded(&files(scans, Orientation::default())).len();
    for number in numbers {
        let orientation = Orientation::from_number(*number).unwrap();
        let stream = encoded(&files(scans, orientation));
        println!("{orientation}: {} instead of {upright} bytes", stream.len());
        assert!(stream.len() <= upright + upright / 25, "{orientation}: {} bytes", stream.len());
        let record = &take_apart(&stream).0[0];
        let found = Scanner::from_record(record.family, &record.payload).unwrap().unwrap();
        assert!(!is_unique || found.orientation() == orientation, "{}", found.orientation());
    }
}

#[test]
fn an_hdl_64e_is_found_with_any_axes() {
    takes_no_more_bytes(&simulated(SynthScanner::Hdl64, 1, 8), &all(), true);
    takes_no_more_bytes(&simulated(SynthScanner::Hdl64, 2, 8), &[9, 38], true);
}

#[test]
fn an_hdl_64e_is_found_with_other_axes_if_its_scans_were_compensated() {
    let moved = |scan: &Points| compensated(scan, [0.001, 0.0, 0.03], [-0.8, 0.1, 0.02]);
    let scans: Vec<_> = simulated(SynthScanner::Hdl64, 2, 4).iter().map(moved).collect();
    takes_no_more_bytes(&scans, &[3, 21, 40], true);
}

#[test]
fn a_scanner_of_firings_is_found_with_any_axes() {
    // Mirror images may be taken for those of a scanner upside down.
    takes_no_more_bytes(&simulated(SynthScanner::Vlp16, 1, 2), &all(), false);
    takes_no_more_bytes(&simulated(SynthScanner::Vlp16, 2, 2), &[9, 38], false);
    takes_no_more_bytes(&[ouster(32, OusterDriver::Ros)], &[5, 14, 27], false);
}

#[test]
fn other_levels_and_modes_have_the_axes_of_the_file_too() {
    let scans = simulated(SynthScanner::Vlp16, 2, 4);
    let files = files(&scans, Orientation::from_number(11).unwrap());
    for level in [1, 3, 9] {
        round_trip(&files, &at_level(level));
    }
    keeps_the_bound(&files, &bounded(10_000), 10_000);
}
