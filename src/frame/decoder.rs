//! Decodes the frames of a group.

use std::borrow::Borrow;
use std::mem::take;

use super::fidelity::PositionFidelity;
use super::parameters::{OriginalFile, Prediction};
use super::parts::FrameParts;
use super::sections::SectionReader;
use super::stages::StageReport;
use super::syntax::Models;
use crate::article::prediction::intra::IntraPrediction;
use crate::container::{FrameHeader, Section, allowance};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::grid::Grid;
use crate::inter::registration::Pose;
use crate::scan::ScanFile;
use crate::scanner::{RangeImage, Scanner};

/// A frame decoded by [`GroupDecoder`].
pub struct DecodedScan {
    /// The file.
    pub scan: ScanFile,
    /// Properties of the original file, if it is not restored exactly.
    pub source: Option<OriginalFile>,
    /// Whether it has the points of the original file in the same order.
    pub keeps_order: bool,
    /// The range image, if there is one and it was requested.
    pub image: Option<DecodedImage>,
    /// How well the scanner explains it, if it has one and this was requested.
    pub explained: Option<Explained>,
}

/// How well a frame's scanner explains it.
#[derive(Clone, Copy, Debug)]
pub struct Explained {
    /// Number of records of the file, without the strays that have no direction: those were not measured.
    pub points: u64,
    /// The number of these in the range image, including echoes and blanks.
    pub in_image: u64,
    /// The number of points in the image that the formula reproduces as measured, to the last bit.
    pub reproduced: u64,
}

/// The range image of a decoded frame.
#[derive(Clone, Debug)]
pub struct DecodedImage {
    /// The scanner that defines the rows, ticks and steps.
    pub scanner: Scanner,
    /// The ranges.
    pub image: RangeImage,
    /// The point of the file in each cell, counted from 0.
    pub point_of_cell: Grid<Option<u32>>,
    /// The regions that predict the ranges; empty if none do.
    pub intra: IntraPrediction,
    /// The motion of the scanner since the frame before, if it is used to predict the ranges.
    pub motion: Option<Pose>,
}

/// Decodes the frames of one group.
pub struct GroupDecoder<S> {
    /// The scanner of each track, and the models of its frames, once there was one.
    tracks: Vec<(Option<S>, Option<Models>)>,
    limits: Limits,
    keeps_images: bool,
    judges_scanners: bool,
}

impl<S: Borrow<Scanner>> GroupDecoder<S> {
    /// A new group whose tracks have these scanners.
    pub fn new(scanners: impl IntoIterator<Item = Option<S>>, limits: &Limits) -> Self {
        let tracks = scanners.into_iter().map(|scanner| (scanner, None)).collect();
        GroupDecoder { tracks, limits: *limits, keeps_images: false, judges_scanners: false }
    }

    /// Makes the decoder also return range images.
    pub fn keeping_images(self, keeps_images: bool) -> Self {
        GroupDecoder { keeps_images, ..self }
    }

    /// Makes the decoder also determine how well the scanners explain their frames.
    pub fn judging_scanners(self) -> Self {
        GroupDecoder { judges_scanners: true, ..self }
    }

    /// Decodes the next frame; adds the times of all stages to `stages`.
    ///
    /// # Errors
    /// If the sections do not make a frame, or make one that exceeds the limits; if the group does not have
    /// the frame's track.
    pub fn decode_frame(
        &mut self,
        header: &FrameHeader,
        sections: &[Section],
        stages: &mut StageReport,
    ) -> Result<DecodedScan> {
        let track = self.tracks.get_mut(usize::from(header.stamp.track));
        let unknown = || Error::corrupt("a frame of a track that the group does not have");
        let (scanner, models) = track.ok_or_else(unknown)?;
        let scanner = scanner.as_ref().map(S::borrow);
        let models = models.get_or_insert_default();
        let (mut frame, report) = decode_parts(models, scanner, header, sections, &self.limits)?;
        stages.add(&report);
        let source = frame.parameters.source;
        stages.frames += 1;
        let original = source.map_or(header.file_size, |source| source.file_size);
        stages.original = stages.original.saturating_add(original);
        stages.count_sections(sections);
        let explained = scanner.filter(|_| self.judges_scanners).map(|scanner| Explained {
            points: frame.records.saturating_sub(frame.strays.without_direction()) as u64,
            in_image: frame.returns.len() as u64,
            reproduced: frame.reproduced_returns(scanner) as u64,
        });
        let image = match scanner.filter(|_| self.keeps_images) {
            Some(scanner) => Some(DecodedImage {
                scanner: scanner.clone(),
                point_of_cell: frame.point_of_cell()?,
                image: take(&mut frame.image),
                intra: take(&mut frame.intra),
                motion: (frame.parameters.prediction == Prediction::Inter)
                    .then(|| frame.parameters.motion.pose()),
            }),
            None => None,
        };
        let keeps_order = frame.parameters.positions != PositionFidelity::Formula;
        Ok(DecodedScan { scan: frame.into_scan(&header.name)?, source, keeps_order, image, explained })
    }
}

/// Decodes the sections of the next frame of a track.
///
/// # Errors
/// If they do not make a frame, or make one that exceeds the limits.
pub(crate) fn decode_parts(
    models: &mut Models,
    scanner: Option<&Scanner>,
    header: &FrameHeader,
    sections: &[Section],
    limits: &Limits,
) -> Result<(FrameParts, StageReport)> {
    let limits = limits.at_most(allowance(sections));
    let mut reader = SectionReader::new(sections, &limits);
    let mut frame = FrameParts::of_records(header.point_count as usize, scanner);
    models.code_frame(&mut reader, scanner, &mut frame)?;
    Ok((frame, reader.finish()?))
}
