//! What was found of the scanners, and how well it explains their scans.

use std::io::{self, Write};

use crate::cli::table;
use crate::frame::group::GroupDecoder;
use crate::frame::{FrameParameters, Positions, StepReport};
use crate::ground::error::{Limits, Result};
use crate::scanner::Scanner;
use crate::stream::container::{Group, ScannerId, ScannerRecord};
use crate::study::metrics;
use serde::Serialize;

/// The scanners of a stream, in the order of their first records.
#[derive(Default)]
pub struct Scanners {
    known: Vec<(ScannerId, Scanner, Option<Sample>)>,
}

/// The first exact scan of a scanner.
#[derive(Clone, Copy)]
struct Sample {
    points: u64,
    in_image: u64,
    exact: u64,
}

/// What is reported of a scanner.
#[derive(Serialize)]
pub struct ScannerStats {
    /// Family, grid and recipe, in words.
    description: String,
    /// Of the points of its first exact scan, the share in the range image; the others are strays.
    share_in_image: Option<f64>,
    /// Of the same points, the share that the formula gives to the last bit.
    share_exact: Option<f64>,
}

impl Scanners {
    /// Adds a record, unless it is one more copy, or of a family that this program does not know.
    ///
    /// # Errors
    /// If the record is damaged.
    pub fn add(&mut self, record: &ScannerRecord) -> Result<()> {
        let id = record.id();
        if self.known.iter().all(|(known, ..)| *known != id)
            && let Some(scanner) = Scanner::of_record(record.family, &record.payload)?
        {
            self.known.push((id, scanner, None));
        }
        Ok(())
    }

    /// Decodes the group's first scan of each scanner that has not had one, if it is coded exactly.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn sample(&mut self, group: &Group, limits: &Limits) -> Result<()> {
        for (stream, id) in group.scanners.iter().enumerate() {
            let known =
                self.known.iter_mut().find(|(known, _, sample)| Some(*known) == *id && sample.is_none());
            let first = group.frames.iter().find(|frame| usize::from(frame.header.stamp.stream) == stream);
            let (Some((_, scanner, sample)), Some(frame)) = (known, first) else { continue };
            if FrameParameters::of(frame)?.positions != Positions::Exact {
                continue;
            }
            let streams = (0..=stream).map(|place| (place == stream).then_some(&*scanner));
            let mut decoder = GroupDecoder::new(streams, limits).keeping_images(true);
            let decoded = decoder.decode_frame(&frame.header, &frame.sections, &mut StepReport::default())?;
            let (in_image, exact) = decoded.image.map_or((0, 0), |image| (image.points, image.exact_points));
            *sample = Some(Sample { points: decoded.scan.records as u64, in_image, exact });
        }
        Ok(())
    }

    /// What was found.
    pub fn report(&self) -> Vec<ScannerStats> {
        let of_scanner = |(_, scanner, sample): &(ScannerId, Scanner, Option<Sample>)| ScannerStats {
            description: scanner.to_string(),
            share_in_image: sample.and_then(|sample| metrics::ratio(sample.points, sample.in_image)),
            share_exact: sample.and_then(|sample| metrics::ratio(sample.points, sample.exact)),
        };
        self.known.iter().map(of_scanner).collect()
    }
}

impl ScannerStats {
    /// Prints it in one line.
    pub fn print(&self, number: usize, out: &mut impl Write) -> io::Result<()> {
        write!(out, "scanner {number}: {}", self.description)?;
        if self.share_exact.is_some() {
            let (in_image, exact) = (table::percent(self.share_in_image), table::percent(self.share_exact));
            write!(
                out,
                "; of its first scan {in_image} of the points are in the range image, {exact} by the formula to the last bit"
            )?;
        }
        writeln!(out)
    }
}
