//! The pictures of a range image.

use crate::article::prediction::Rays;
use crate::article::prediction::intra::IntraPrediction;
use crate::article::prediction::surface::SurfaceModel;
use crate::article::segmentation::{GROUND, UNASSIGNED, segment};
use crate::cli::args::PictureKind;
use crate::frame::DecodedImage;
use crate::frame::settings::EncoderConfig;
use crate::ground::grid::Grid;
use crate::scanner::hdl64::Alignment;
use crate::study::picture::{self, LabelStyle, Picture, Scale, Zoom};

/// All pictures of the range image and their titles, in the order of the coding steps.
pub const PICTURES: [(PictureKind, &str); 7] = [
    (PictureKind::Range, "range, m"),
    (PictureKind::Occupancy, "occupancy"),
    (PictureKind::Labels, "ground, objects"),
    (PictureKind::Regions, "regions"),
    (PictureKind::Prediction, "prediction, m"),
    (PictureKind::Residual, "residual, m"),
    (PictureKind::Error, "error, mm"),
];

/// The contents of a range image's pictures, ready to be drawn. Ranges are in millimetres, whatever the
/// image's steps.
pub struct Pictures {
    occupancy: Grid<bool>,
    ranges: Grid<u32>,
    predicted: Grid<u32>,
    /// The labels of [`crate::article::segmentation`].
    labels: Grid<u32>,
    intra: IntraPrediction,
    /// Errors in millimetres, NaN for cells without one, if the original is known.
    errors: Option<Grid<f32>>,
    zoom: Zoom,
}

/// The unit of the pictures' ranges, in metres.
const MILLIMETRE: f64 = 1e-3;

impl Pictures {
    /// The regions are the stream's, or those that intra prediction would use. `errors` are those of the
    /// file's points, in metres.
    pub fn of(
        decoded: &DecodedImage,
        errors: Option<&[Option<f64>]>,
        config: &EncoderConfig,
        scale: Option<u16>,
    ) -> Self {
        let DecodedImage { scanner, image, point_of_cell, intra, .. } = decoded;
        let millimetres_of = |errors: &[Option<f64>], point: &Option<u32>| {
            let error = errors.get((*point)? as usize).copied()??;
            Some((error / MILLIMETRE) as f32)
        };
        let errors =
            errors.map(|errors| point_of_cell.map(|point| millimetres_of(errors, point).unwrap_or(f32::NAN)));
        let occupancy = image.occupancy();
        let mut intra = intra.clone();
        let likeness = scanner.likeness();
        let segmentation = segment(&image.steps, &image.columns, &likeness, &config.segmentation);
        let rays = Rays::of(&likeness, &image.columns);
        if intra.models.is_empty() {
            intra = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &config.intra);
        }
        let predicted = intra.ranges(&occupancy, &rays);
        let millimetres =
            |steps: &Grid<u32>| steps.map(|&steps| (scanner.metres(steps) / MILLIMETRE).round() as u32);
        let zoom = match scale.map(usize::from) {
            Some(column) => Zoom { row: 4 * column, column },
            None => Zoom::for_columns(image.columns.len()),
        };
        let mut pictures = Pictures {
            ranges: millimetres(&image.steps),
            predicted: millimetres(&predicted),
            occupancy,
            labels: segmentation.labels,
            intra,
            errors,
            zoom,
        };
        pictures.align(&Alignment::of(&likeness, image.columns.len()));
        pictures
    }

    /// Aligns rows such that cells above one another have the same azimuth.
    fn align(&mut self, alignment: &Alignment) {
        alignment.align(&mut self.occupancy);
        alignment.align(&mut self.ranges);
        alignment.align(&mut self.predicted);
        alignment.align(&mut self.labels);
        alignment.align(&mut self.intra.labels);
        self.errors.iter_mut().for_each(|errors| alignment.align(errors));
    }

    /// The picture of a kind; `None` if it shows errors and these are unknown.
    pub fn draw(&self, kind: PictureKind) -> Option<Picture> {
        let of_ranges =
            || Scale::of_ranges(self.ranges.cells().iter().map(|&range| f64::from(range) * MILLIMETRE));
        Some(match kind {
            PictureKind::Occupancy => picture::occupancy(&self.occupancy, self.zoom),
            PictureKind::Labels => picture::labels(&self.labels, style_of_label, self.zoom),
            PictureKind::Regions => {
                picture::labels(&self.intra.labels, |region| self.style_of_region(region), self.zoom)
            }
            PictureKind::Prediction => picture::range(&self.predicted, MILLIMETRE, &of_ranges(), self.zoom),
            PictureKind::Residual => {
                picture::residual(&self.residuals(), &self.occupancy, MILLIMETRE, self.zoom)
            }
            PictureKind::Error => picture::error(self.errors.as_ref()?, self.zoom),
            PictureKind::Range
            | PictureKind::BirdsEye
            | PictureKind::Perspective
            | PictureKind::Overview
            | PictureKind::All => picture::range(&self.ranges, MILLIMETRE, &of_ranges(), self.zoom),
        })
    }

    fn style_of_region(&self, region: u32) -> LabelStyle {
        match self.intra.models[region as usize - 1] {
            SurfaceModel::Plane(_) => LabelStyle::Ground,
            SurfaceModel::Mean(_) => LabelStyle::Object,
        }
    }

    /// The residuals of equation 7.
    fn residuals(&self) -> Grid<i32> {
        let mut residuals = self.ranges.map(|&range| range as i32);
        for row in 0..residuals.rows() {
            for (residual, predicted) in residuals.row_mut(row).iter_mut().zip(self.predicted.row(row)) {
                *residual = residual.wrapping_sub(*predicted as i32);
            }
        }
        residuals
    }
}

fn style_of_label(label: u32) -> LabelStyle {
    match label {
        GROUND => LabelStyle::Ground,
        UNASSIGNED => LabelStyle::Unassigned,
        _ => LabelStyle::Object,
    }
}
