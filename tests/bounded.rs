//! Bounded mode: every point is restored at its index, within the bound.

use crate::common::bound::{bounded, keeps_the_bound};
use crate::common::formats::{kitti, nuscenes, pcd, pcd_extra, pcd_text, ply};
use crate::common::odd::{SCANS, changed_scan, noise};
use crate::common::scans::{Points, random_points, scans, shuffled, small};
use crate::common::{File, cases, decode_files, encode_files, first_files, real_folders, section_bytes};
use lidarpc::internals::container::SectionKind;
use lidarpc::internals::edit::{Named, cut};
use lidarpc::internals::frame::IntensityFidelity;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::ground::error::Limits;
use lidarpc::internals::stream::{DecodeOptions, FrameInput, FrameRange, decode, encode};
use proptest::prelude::*;

fn named(frames: &[Points]) -> Vec<File> {
    frames.iter().enumerate().map(|(n, points)| (format!("{n}.bin"), kitti(points))).collect()
}

#[test]
fn the_bound_is_kept_and_used() {
    for (n, frames) in SCANS.iter().enumerate() {
        let files = named(frames);
        let mut smaller = usize::MAX / 2;
        for max_error_um in [1, 500, 2_000, 5_000, 10_000, 50_000, 1_000_000] {
            let (stream, largest) = keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
            let bound = f64::from(max_error_um) * 1e-6;
            // Larger errors are spread over the whole allowed range.
            assert!(max_error_um < 5_000 || largest > 0.7 * bound, "scanner {n}: {largest} m of {bound} m");
            let size = stream.len();
            // The bound itself is coded in a byte more or less.
            assert!(
                size <= smaller + 8 * frames.len(),
                "scanner {n}: {size} bytes for {max_error_um} um, {smaller} for less"
            );
            smaller = stream.len();
        }
    }
}

#[test]
fn predictable_ranges_take_next_to_nothing() {
    let files = named(&SCANS[0][..1]);
    let ranges = |max_error_um| {
        section_bytes(&keeps_the_bound(&files, &bounded(max_error_um), max_error_um).0)[&SectionKind::Range]
    };
    let (coarse, fine) = (ranges(100_000), ranges(2_000));
    assert!(coarse * 2 < fine, "{coarse} bytes against {fine}");
}

#[test]
fn intensities_are_rounded_if_asked_for() {
    let files = named(&SCANS[0]);
    let bytes = |intensity| {
        let config = EncoderConfig { intensity, ..bounded(10_000) };
        section_bytes(&keeps_the_bound(&files, &config, 10_000).0)[&SectionKind::Intensity]
    };
    let exact = bytes(IntensityFidelity::Exact);
    let steps = [20_000, 30_000, 100_000, 350_000]
        .map(|step_millionths| IntensityFidelity::Rounded { step_millionths });
    for step in steps {
        assert!(bytes(step) < exact, "{step:?}");
    }
}

#[test]
fn every_format_keeps_the_bound() {
    let points = &SCANS[0][0];
    let files: Vec<File> = [
        ("a.pcd.bin", nuscenes(points)),
        ("b.pcd", pcd_extra(points)),
        ("c.pcd", pcd_text(&points[..500])),
        ("d.ply", ply(points)),
        ("e.bin", kitti(&shuffled(points, 3))),
        ("f.bin", kitti(&random_points(300, 5))),
        ("g.bin", Vec::new()),
        ("h.pcd", b"VERSION 0.7, but damaged".to_vec()),
    ]
    .map(|(name, bytes)| (name.to_owned(), bytes))
    .to_vec();
    for max_error_um in [300, 20_000] {
        keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
    }
}

#[test]
fn a_bound_costs_no_more_than_none_where_channels_follow_from_positions() {
    let with_distances = |points: &Points| {
        pcd("x y z distance azimuth", "4 4 4 4 4", "F F F F F", points, |_, [x, y, z, _]| {
            [x, y, z, (x * x + y * y + z * z).sqrt(), y.atan2(x)].map(f32::to_le_bytes).concat()
        })
    };
    let files: Vec<File> =
        (0..).zip(&SCANS[4]).map(|(n, points)| (format!("{n}.pcd"), with_distances(points))).collect();
    let exact = encode_files(&files, &EncoderConfig::default()).len();
    let mut smaller = exact;
    for max_error_um in [500, 1_000, 10_000, 50_000] {
        let (stream, _) = keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
        let size = stream.len();
        assert!(size < exact + 10, "{max_error_um} um: {size} bytes, exact {exact}");
        // Later frames may differ from the first one, which decides.
        assert!(size <= smaller + smaller / 50, "{max_error_um} um: {size} bytes, {smaller} for less");
        smaller = size;
    }
    // A first frame without points decides nothing.
    let files = [vec![("-.pcd".to_owned(), with_distances(&Vec::new()))], files].concat();
    let (stream, _) = keeps_the_bound(&files, &bounded(50_000), 50_000);
    assert!(stream.len() < smaller + 300, "{} bytes, {smaller} without an empty frame", stream.len());
}

#[test]
fn few_digits_of_a_text_use_the_bound_too() {
    // As by C's %.5g, whose last digit is a millimetre beyond 10 m.
    let digits = |metres: f32| {
        let scale = 10f64.powi(4 - f64::from(metres.abs()).log10().floor() as i32);
        ((f64::from(metres) * scale).round() / scale) as f32
    };
    let files: Vec<File> = (0..)
        .zip(&SCANS[4])
        .map(|(n, points)| {
            let points: Points =
                points.iter().map(|&[x, y, z, i]| [digits(x), digits(y), digits(z), i]).collect();
            (format!("{n}.pcd"), pcd_text(&points))
        })
        .collect();
    let exact = encode_files(&files, &EncoderConfig::default()).len();
    for max_error_um in [5_000, 7_000, 10_000, 20_000] {
        let (stream, _) = keeps_the_bound(&files, &bounded(max_error_um), max_error_um);
        assert!(stream.len() < exact * 9 / 10, "{max_error_um} um: {} bytes, exact {exact}", stream.len());
    }
}

#[test]
fn numbers_of_a_text_keep_the_bound_too() {
    let text = |digits: usize| {
        let points: Vec<_> = random_points(3000, 7).iter().map(|p| p.map(|v| v * 0.3137 % 20.0)).collect();
        let mut text = String::from_utf8(pcd_text(&[])).unwrap().replace(" 0\nDATA", " 3000\nDATA");
        text = text.replace("WIDTH 0", "WIDTH 3000");
        points.iter().for_each(|[x, y, z, _]| text += &format!("{x:.digits$} {y:.digits$} {z:.digits$} 1\n"));
        text.into_bytes()
    };
    // Not as float32, which is what the encoder sees.
    let numbers = |bytes: &[u8]| {
        let lines =
            str::from_utf8(bytes).unwrap().lines().skip_while(|line| !line.starts_with("DATA")).skip(1);
        let number = |word: &str| word.parse::<f64>().unwrap();
        lines.map(|line| line.split(' ').take(3).map(number).collect::<Vec<_>>()).collect::<Vec<_>>()
    };
    for digits in [6, 7, 8] {
        let files = [("a.pcd".to_owned(), text(digits))];
        for max_error_um in [1, 2, 3, 5, 10, 100] {
            let decoded = decode_files(&encode_files(&files, &bounded(max_error_um))).unwrap();
            for (a, b) in numbers(&files[0].1).iter().zip(numbers(&decoded[0].1)) {
                let error = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                assert!(
                    error <= 1e-6 * f64::from(max_error_um),
                    "{digits} digits: {error} m, not {max_error_um} um"
                );
            }
        }
    }
}

#[test]
fn values_that_break_things_stay() {
    let mut points = SCANS[0][0].clone();
    let odd = [f32::NAN, f32::INFINITY, -f32::INFINITY, f32::MAX, -1e30, 1e-40, -0.0];
    for (n, value) in odd.into_iter().enumerate() {
        points[40 * n][n % 3] = value;
        points[40 * n + 7] = [value; 4];
    }
    for intensity in [IntensityFidelity::Exact, IntensityFidelity::Rounded { step_millionths: 50_000 }] {
        let config = EncoderConfig { intensity, ..bounded(20_000) };
        keeps_the_bound(&named(&[SCANS[0][1].clone(), points.clone()]), &config, 20_000);
    }
}

#[test]
fn a_cut_gives_the_same_points() {
    let files = named(&scans(&small(3, 5)));
    let stream = encode_files(&files, &bounded(20_000));
    let whole = decode_files(&stream).unwrap();
    let mut part = Vec::new();
    let range = FrameRange { start: 2, end: Some(5) };
    let named = Named { path: "whole.lpc".into(), stream: &stream[..] };
    cut(named, range, &Limits::default(), &mut part).expect("cuts");
    assert!(decode_files(&part).unwrap() == whole[2..]);
}

#[test]
fn threads_and_ways_to_decode_make_no_difference() {
    let files = named(&scans(&small(3, 5)));
    let inputs: Vec<_> =
        files.iter().map(|(name, bytes)| FrameInput::memory(name.clone(), bytes.clone())).collect();
    let streams = [1, 3].map(|threads| {
        let mut stream = Vec::new();
        let config = EncoderConfig { threads, gop: 2, ..bounded(20_000) };
        encode(&inputs, &config, &mut stream, &|| ()).unwrap();
        stream
    });
    assert!(streams[0] == streams[1]);
    decode(&streams[0][..], &DecodeOptions::default(), Ok, |frame| {
        assert!(frame.keeps_order && frame.source.is_some_and(|source| source.outliers + source.lost == 0));
        Ok(())
    })
    .unwrap();
}

#[test]
fn real_scans_keep_the_bound() {
    for (folder, max_error_um) in real_folders().into_iter().zip([5_000, 50_000].into_iter().cycle()) {
        keeps_the_bound(&first_files(&folder, 1), &bounded(max_error_um), max_error_um);
        println!("{}: as promised", folder.display());
    }
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn any_folder_keeps_the_bound(
        files in prop::collection::vec(prop_oneof![4 => changed_scan(), 1 => noise()], 0..=3),
        max_error_um in prop_oneof![1u32..10_000_000, 1u32..50_000, 1u32..1000],
        step in prop::option::of(prop_oneof![1u32..2_000_000, prop::sample::select(vec![10_000u32, 50_000])]),
    ) {
        let files: Vec<File> = files.into_iter().enumerate().map(|(n, file)| file.named(n)).collect();
        let intensity = step.map_or(IntensityFidelity::Exact, |step_millionths| IntensityFidelity::Rounded { step_millionths });
        keeps_the_bound(&files, &EncoderConfig { intensity, ..bounded(max_error_um) }, max_error_um);
    }
}
