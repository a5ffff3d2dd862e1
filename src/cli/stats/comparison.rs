//! Comparison of decoded scans with the originals.

use std::io::{self, BufReader, Read, Write};

use crate::files::{parse_like, rounded_by_file};
use crate::stream::{self, DecodeOptions, DecodedFrame};
use crate::study::metrics::{GeometryPsnr, NearestErrors, NearestPairs, PEAK_M, PointErrors};
use serde::Serialize;

use crate::cli::args::StatsArgs;
use crate::cli::console::Console;
use crate::cli::input::Originals;
use crate::cli::readable;

/// The comparison with the originals.
#[derive(Default, Serialize)]
pub struct Against {
    identical_files: u64,
    differing_files: u64,
    /// Errors of points paired by their order in the file.
    rmse_m: Option<f64>,
    max_error_m: Option<f64>,
    /// Largest intensity error of such pairs, in the file's unit.
    max_intensity_error: f64,
    /// Errors from point to point if the order has changed: from each decoded point to the nearest original.
    decoded_to_original_rmse_m: Option<f64>,
    decoded_to_original_max_m: Option<f64>,
    /// Errors from each original point, including removed ones, to the nearest decoded one.
    original_to_decoded_rmse_m: Option<f64>,
    original_to_decoded_max_m: Option<f64>,
    lost_points: u64,
    added_points: u64,
    non_finite_changed: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    psnr: Option<Psnr>,
}

/// PSNR as computed by mpeg-pcc-dmetric, in decibels; null if the points have not changed.
#[derive(Serialize)]
struct Psnr {
    peak_m: f64,
    lossless: bool,
    /// Point to point.
    d1_db: Option<f64>,
    /// Point to plane.
    d2_db: Option<f64>,
}

/// Decodes all frames and measures their errors relative to the originals.
pub fn compare(
    args: &StatsArgs,
    input: impl Read + Send,
    mut originals: Originals,
    frames: u64,
    console: Console,
) -> crate::ground::error::Result<Against> {
    let options = DecodeOptions {
        threads: args.threads.threads,
        limits: args.limits.limits(),
        ..DecodeOptions::default()
    };
    let bar = console.bar(Some(frames), "comparing");
    let mut comparison = Comparison { psnr: args.psnr.then(GeometryPsnr::default), ..Comparison::default() };
    let compared = stream::decode(BufReader::new(input), &options, Ok, |frame| {
        bar.inc(1);
        let original = originals.take(&frame.header.name)?;
        comparison.add(original, frame)
    });
    bar.finish_and_clear();
    compared?;
    Ok(comparison.report())
}

/// The measurements, frame by frame.
#[derive(Default)]
struct Comparison {
    identical_files: u64,
    differing_files: u64,
    paired: PointErrors,
    to_original: NearestErrors,
    to_decoded: NearestErrors,
    psnr: Option<GeometryPsnr>,
}

impl Comparison {
    fn add(&mut self, original: Vec<u8>, frame: DecodedFrame) -> crate::ground::error::Result<()> {
        let bytes = frame.to_bytes()?;
        let is_identical = original == bytes;
        match is_identical {
            true => self.identical_files += 1,
            false => self.differing_files += 1,
        }
        let keeps_order = frame.keeps_order;
        // The values of the file: those of the stream have more digits than text.
        let decoded = rounded_by_file(&frame.scan, bytes).unwrap_or(frame.scan);
        let original = parse_like(&decoded, &frame.header.name, original);
        let (original, decoded) = (&original.cloud, &decoded.cloud);
        if keeps_order {
            self.paired.add(original, decoded);
            match &mut self.psnr {
                None => return Ok(()),
                Some(psnr) if is_identical => {
                    psnr.add_identical();
                    return Ok(());
                }
                Some(_) => {}
            }
        }
        let Some(pairs) = NearestPairs::of(original, decoded) else { return Ok(()) };
        if !keeps_order {
            self.to_original.add_nearest(&pairs.decoded, &pairs.of_decoded);
            self.to_decoded.add_nearest(&pairs.original, &pairs.of_original);
        }
        if let Some(psnr) = &mut self.psnr {
            psnr.add(&pairs);
        }
        Ok(())
    }

    fn report(&self) -> Against {
        let finite = |decibels: Option<f64>| decibels.filter(|decibels| decibels.is_finite());
        Against {
            identical_files: self.identical_files,
            differing_files: self.differing_files,
            rmse_m: self.paired.rmse(),
            max_error_m: self.paired.max(),
            max_intensity_error: self.paired.max_intensity,
            decoded_to_original_rmse_m: self.to_original.rmse(),
            decoded_to_original_max_m: self.to_original.max(),
            original_to_decoded_rmse_m: self.to_decoded.rmse(),
            original_to_decoded_max_m: self.to_decoded.max(),
            lost_points: self.paired.lost,
            added_points: self.paired.added,
            non_finite_changed: self.paired.non_finite_changed,
            psnr: self.psnr.map(|psnr| Psnr {
                peak_m: PEAK_M,
                lossless: psnr.d1() == Some(f64::INFINITY),
                d1_db: finite(psnr.d1()),
                d2_db: finite(psnr.d2()),
            }),
        }
    }
}

impl Against {
    pub fn print(&self, out: &mut impl Write) -> io::Result<()> {
        let metres = |error: Option<f64>| error.map_or_else(|| "-".to_owned(), |error| format!("{error:.6}"));
        let files = self.identical_files + self.differing_files;
        for (name, rmse, max) in [
            ("", self.rmse_m, self.max_error_m),
            (" to original", self.decoded_to_original_rmse_m, self.decoded_to_original_max_m),
            (" to decoded", self.original_to_decoded_rmse_m, self.original_to_decoded_max_m),
        ] {
            if rmse.is_some() {
                writeln!(out, "RMSE{name:<12} {:>10} m", metres(rmse))?;
                writeln!(out, "max error{name:<12} {:>5} m", metres(max))?;
            }
        }
        if self.max_intensity_error > 0.0 {
            writeln!(out, "intensities  {:>14.6} at most", self.max_intensity_error)?;
        }
        writeln!(out, "identical    {:>14} of {}", self.identical_files, readable::count(files, "file"))?;
        if let Some(psnr) = &self.psnr {
            for (name, decibels) in [("D1 PSNR", psnr.d1_db), ("D2 PSNR", psnr.d2_db)] {
                let text = match decibels {
                    Some(decibels) => format!("{decibels:.3} dB"),
                    None => if psnr.lossless { "lossless" } else { "-" }.to_owned(),
                };
                writeln!(out, "{name:<12} {text:>14}, peak {:.2} m", psnr.peak_m)?;
            }
        }
        for (name, count) in [
            ("lost points", self.lost_points),
            ("added points", self.added_points),
            ("NaN changed", self.non_finite_changed),
        ] {
            if count > 0 {
                writeln!(out, "{name:<12} {count:>14}")?;
            }
        }
        Ok(())
    }
}
