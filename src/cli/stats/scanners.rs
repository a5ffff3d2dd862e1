//! The fitted scanners, and how well they explain their scans.

use std::io::{self, Write};

use crate::cli::readable;
use crate::container::{CodedFrame, Group, ScannerId, ScannerRecord};
use crate::frame::decoder::{Explained, GroupDecoder};
use crate::frame::{FrameParameters, PositionFidelity, StageReport};
use crate::ground::error::{Error, Limits, Result};
use crate::scanner::Scanner;
use crate::study::metrics;
use serde::Serialize;

/// The scanners of a stream, in the order of their first records.
#[derive(Default)]
pub struct KnownScanners {
    known: Vec<KnownScanner>,
}

struct KnownScanner {
    id: ScannerId,
    scanner: Scanner,
    /// How well it explains its first exactly coded scan, if there was one.
    first: Option<Explained>,
}

/// The report on a scanner.
#[derive(Serialize)]
pub struct ScannerStats {
    /// Family, grid and recipe, in words.
    description: String,
    /// The share of points in the range image, for its first exactly coded scan; the others are strays.
    share_in_image: Option<f64>,
    /// The share of the same points that the formula reproduces to the last bit.
    share_exact: Option<f64>,
}

impl KnownScanners {
    /// Adds a record, unless it is a copy, or of a family that this program does not know.
    ///
    /// # Errors
    /// If the record is damaged.
    pub fn add(&mut self, record: &ScannerRecord) -> Result<()> {
        let id = record.id();
        if self.known.iter().all(|known| known.id != id)
            && let Some(scanner) = Scanner::from_record(record.family, &record.payload)?
        {
            self.known.push(KnownScanner { id, scanner, first: None });
        }
        Ok(())
    }

    /// For each scanner without a sample yet, decodes the group's first scan of which it explains a point, if that
    /// is coded exactly. `first_frame` is the number of the group's first frame.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn sample(&mut self, first_frame: u64, group: &Group, limits: &Limits) -> Result<()> {
        for (track, id) in group.scanners.iter().enumerate() {
            let known = self.known.iter_mut().find(|known| Some(known.id) == *id && known.first.is_none());
            let Some(KnownScanner { scanner, first: explained, .. }) = known else { continue };
            let tracks = (0..=track).map(|place| (place == track).then_some(&*scanner));
            let mut decoder = GroupDecoder::new(tracks, limits).judging_scanners();
            let mut decode = |frame: &CodedFrame| {
                if FrameParameters::of(frame)?.positions != PositionFidelity::Exact {
                    return Ok(None);
                }
                let stages = &mut StageReport::default();
                Ok(decoder.decode_frame(&frame.header, &frame.sections, stages)?.explained)
            };
            let frames = (first_frame..).zip(&group.frames);
            for (number, frame) in frames.filter(|(_, frame)| usize::from(frame.header.stamp.track) == track)
            {
                let at = |error: Error| error.within_frame(number, &frame.header.name);
                *explained = decode(frame).map_err(at)?;
                // Scans of other kinds, which the scanner does not explain, may come before its own.
                if explained.is_none_or(|explained| explained.in_image > 0) {
                    break;
                }
            }
        }
        Ok(())
    }

    /// The report on all scanners.
    pub fn report(&self) -> Vec<ScannerStats> {
        let of_scanner = |known: &KnownScanner| ScannerStats {
            description: known.scanner.to_string(),
            share_in_image: known.first.and_then(|first| metrics::ratio(first.points, first.in_image)),
            share_exact: known.first.and_then(|first| metrics::ratio(first.points, first.reproduced)),
        };
        self.known.iter().map(of_scanner).collect()
    }
}

impl ScannerStats {
    /// Prints the report on a scanner in one line.
    pub fn print(&self, number: usize, out: &mut impl Write) -> io::Result<()> {
        write!(out, "scanner {number}: {}", self.description)?;
        if self.share_exact.is_some() {
            let (in_image, exact) =
                (readable::percent(self.share_in_image), readable::percent(self.share_exact));
            write!(
                out,
                "; of its first scan {in_image} of the points are in the range image, {exact} by the formula to the last bit"
            )?;
        }
        writeln!(out)
    }
}
