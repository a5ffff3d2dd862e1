//! Checks the error bound of bounded mode by comparing files.

use lidarpc::internals::files::{parse, parse_like};
use lidarpc::internals::frame::IntensityFidelity;
use lidarpc::internals::frame::settings::{EncoderConfig, Mode};
use lidarpc::internals::scan::ScanFile;

use super::{File, decode_files, encode_files};

/// The settings of bounded mode.
pub fn bounded(max_error_um: u32) -> EncoderConfig {
    EncoderConfig { threads: 2, ..EncoderConfig::preset(Mode::Bounded { max_error_um }) }
}

/// Encodes and decodes files, and checks that each point is within the bound. Returns the stream and the
/// largest error.
pub fn keeps_the_bound(files: &[File], config: &EncoderConfig, max_error_um: u32) -> (Vec<u8>, f64) {
    let stream = encode_files(files, config);
    let largest = check_bound(files, &decode_files(&stream).expect("decodes"), config, max_error_um);
    (stream, largest)
}

/// Compares decoded files with the originals: same names, points, order and other fields; positions within
/// the bound or, if they are not finite, bit by bit; intensities bit by bit or within half a step.
pub fn check_bound(files: &[File], decoded: &[File], config: &EncoderConfig, max_error_um: u32) -> f64 {
    let bound = f64::from(max_error_um) * 1e-6;
    let mut largest = 0.0f64;
    assert_eq!(files.len(), decoded.len());
    for ((name, before), (decoded_name, after)) in files.iter().zip(decoded) {
        assert_eq!(name, decoded_name);
        let a = parse(name, before.clone());
        let b = parse_like(&a, name, after.clone());
        // Not the whole layout: the decoded numbers may look as if they had been written as text by another
        // rule.
        let fields = |scan: &ScanFile| (scan.layout.position.is_some(), scan.layout.intensity.is_some());
        assert_eq!(
            (a.records, fields(&a), &a.cloud.channels),
            (b.records, fields(&b), &b.cloud.channels),
            "{name}"
        );
        if a.layout.position.is_none() {
            assert_eq!(before, after, "{name}: what is no scan is exact");
        }
        assert_eq!(a.cloud.positions.len(), b.cloud.positions.len());
        for (n, (p, q)) in a.cloud.positions.iter().zip(&b.cloud.positions).enumerate() {
            if p.map(f32::to_bits) == q.map(f32::to_bits) {
                continue;
            }
            let apart = |axis: usize| f64::from(p[axis]) - f64::from(q[axis]);
            let error = (apart(0).powi(2) + apart(1).powi(2) + apart(2).powi(2)).sqrt();
            assert!(error <= bound, "{name}, point {n}: {p:?} became {q:?}, {error} m away");
            largest = largest.max(error);
        }
        for (p, q) in a.cloud.intensity.iter().zip(&b.cloud.intensity) {
            match config.intensity {
                IntensityFidelity::Rounded { step_millionths } if p.is_finite() => {
                    let error = (f64::from(*p) - f64::from(*q)).abs();
                    let rounding = 1e-7 * f64::from(p.abs());
                    assert!(
                        error <= 0.5e-6 * f64::from(step_millionths) + rounding,
                        "{name}: {p} became {q}"
                    );
                }
                _ => assert_eq!(p.to_bits(), q.to_bits(), "{name}"),
            }
        }
    }
    largest
}
