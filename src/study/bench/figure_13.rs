//! Figure 13 of the article: the gain of each lossless back-end by prediction. Measured twice: as in the
//! article, with range image and residuals as 32-bit floats, and in integers, with which plain differences
//! compete. It is shown as a table and as plots.

use rayon::ThreadPoolBuilder;
use rayon::prelude::*;

use super::published;
use super::report::{Axis, Figure, Marker, Origin, Point, Row, Scale, Section, Series, Table};
use super::sample::Sample;
use super::tables::column;
use crate::article::contour::ContourModel;
use crate::article::prediction::intra::IntraPrediction;
use crate::article::prediction::surface::SurfaceCoder;
use crate::article::prediction::{Predictor, Rays};
use crate::article::segmentation::segment;
use crate::backend::{BACKENDS, Backend, Packing};
use crate::entropy::ArithmeticEncoder;
use crate::frame::settings::EncoderConfig;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::inter::registration::{QuantisedPose, register};
use crate::inter::{self, Past};
use crate::scan::PointCloud;
use crate::scanner::RangeImage;
use crate::scanner::hdl64::{Hdl64, project_nearest};

/// The source of the prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Nothing,
    Regions,
    FrameBefore,
}

/// A form in which a back-end gets a frame.
#[derive(Clone, Copy, Debug)]
struct Form {
    name: &'static str,
    /// If true, all cells as 32-bit floats in metres, 0 where there is no return; otherwise the returns'
    /// integers.
    floats: bool,
    source: Source,
    /// Whether differences along the snake's path are taken (V-C).
    snake: bool,
}

const fn floats(name: &'static str, source: Source, snake: bool) -> Form {
    Form { name, floats: true, source, snake }
}

const fn integers(name: &'static str, source: Source, snake: bool) -> Form {
    Form { name, floats: false, source, snake }
}

/// The forms. Those in floats are the article's, which takes differences of inter residuals only.
const FORMS: [Form; 9] = [
    floats("float image", Source::Nothing, false),
    floats("float intra", Source::Regions, false),
    floats("float inter", Source::FrameBefore, true),
    integers("ranges", Source::Nothing, false),
    integers("differences", Source::Nothing, true),
    integers("intra", Source::Regions, false),
    integers("intra, diff.", Source::Regions, true),
    integers("inter", Source::FrameBefore, false),
    integers("inter, diff.", Source::FrameBefore, true),
];

/// Bytes of one or more frames with one back-end, in each form. Contour map and models of regions are
/// included in predictions from regions; the occupancy, and the dozen bytes of a motion, are never included.
type Sizes = [u64; FORMS.len()];

/// The figure's data.
#[derive(Clone, Debug)]
pub struct Figure13 {
    /// Number of measured frames: those with a frame before them, for which all forms can be compared.
    frames: u64,
    /// The number of frames and their origin, in words.
    sample: String,
    /// Whether the forms that need a frame before them are measured.
    has_references: bool,
    /// Bytes of the frames' files.
    original: u64,
    /// Bytes of contour maps and models of regions, which are included in the sizes.
    side: u64,
    /// For each back-end of the registry, in the same order.
    sizes: Vec<Sizes>,
}

/// Measures a sample, in the range images of the ideal scanner, with the outlier filter and the regions of
/// `config`. `on_frame` is called after each frame.
///
/// # Errors
/// If a back-end's library fails.
pub fn measure(
    sample: &Sample,
    scanner: &Hdl64,
    config: &EncoderConfig,
    on_frame: &dyn Fn(),
) -> Result<Figure13> {
    let threads = config.threads;
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Internal(format!("cannot start {threads} threads: {e}")))?;
    let mut figure = Figure13 {
        frames: 0,
        sample: sample.describe_some(sample.compared().count()),
        has_references: sample.has_references(),
        original: 0,
        side: 0,
        sizes: vec![[0; FORMS.len()]; BACKENDS.len()],
    };
    let mut before = Before::default();
    for (frame, cloud) in sample.clouds.iter().enumerate() {
        if !sample.has_reference(frame) {
            before = Before::default();
        }
        let image = image(cloud, scanner, config);
        if sample.compared().any(|compared| compared == frame) {
            figure.frames += 1;
            figure.original += sample.inputs[frame].size()?;
            let from_before = before.predict(&image, scanner, config);
            pool.install(|| figure.add(&image, from_before, scanner, config))?;
        }
        before.image = Some(image);
        on_frame();
    }
    Ok(figure)
}

/// The range image of the points that remain after the outlier filter (III-A, IV-A).
fn image(cloud: &PointCloud, scanner: &Hdl64, config: &EncoderConfig) -> RangeImage {
    let filtered = config.outliers.map(|filter| filter.filter(cloud));
    project_nearest(scanner, filtered.as_ref().unwrap_or(cloud)).image
}

impl Figure13 {
    fn add(
        &mut self,
        image: &RangeImage,
        from_before: Option<Grid<u32>>,
        scanner: &Hdl64,
        config: &EncoderConfig,
    ) -> Result<()> {
        let occupancy = image.occupancy();
        let rays = Rays::of(scanner, &image.columns);
        let segmentation = segment(&image.steps, &image.columns, scanner, &config.segmentation);
        let mut intra = IntraPrediction::fit(&image.steps, &occupancy, &rays, &segmentation, &config.intra);
        let side = side_bytes(&mut intra, &occupancy)?;
        let from_regions = intra.ranges(&occupancy, &rays);
        self.side += side;
        let residuals = |form: Form| {
            let ranges = match form.source {
                Source::Nothing => None,
                Source::Regions => Some(from_regions.clone()),
                Source::FrameBefore => Some(from_before.clone()?),
            };
            Some(Predictor { ranges, snake: form.snake }.residuals(&occupancy, &image.steps))
        };
        let residuals = FORMS.map(residuals);
        let size = |backend: &dyn Backend, form: Form, residuals: &[i32]| -> Result<u64> {
            let bytes = match form.floats {
                true => as_floats(residuals, &occupancy, scanner),
                // Ranges that are not differences are large numbers.
                false => {
                    let best = if form.snake { backend.packing() } else { Packing::Planes };
                    config.packing.unwrap_or(best).pack(residuals)
                }
            };
            let side = if form.source == Source::Regions { side } else { 0 };
            Ok(backend.compress(&bytes, config.level)?.len() as u64 + side)
        };
        self.sizes.par_iter_mut().zip(BACKENDS.par_iter()).try_for_each(|(sizes, backend)| {
            for ((total, form), residuals) in sizes.iter_mut().zip(FORMS).zip(&residuals) {
                if let Some(residuals) = residuals {
                    *total += size(*backend, form, residuals)?;
                }
            }
            Ok(())
        })
    }
}

/// Bytes of the contour map and the models of regions.
fn side_bytes(intra: &mut IntraPrediction, occupancy: &Grid<bool>) -> Result<u64> {
    let mut coder = ArithmeticEncoder::default();
    intra.code_contour(&mut ContourModel::default(), &mut coder, occupancy)?;
    intra.code_models(&mut SurfaceCoder::default(), &mut coder);
    Ok(coder.finish().len() as u64)
}

/// The whole image as floats in metres, 0 where there is no return.
fn as_floats(residuals: &[i32], occupancy: &Grid<bool>, scanner: &Hdl64) -> Vec<u8> {
    let metres = |steps: i32| (f64::from(steps) * f64::from(scanner.range_step_um) * 1e-6) as f32;
    let mut residuals = residuals.iter();
    let value = |filled: &bool| if *filled { residuals.next().copied().unwrap_or_default() } else { 0 };
    occupancy.cells().iter().map(value).flat_map(|steps| metres(steps).to_le_bytes()).collect()
}

/// The frame before, and the motion of the scanner from there.
#[derive(Default)]
struct Before {
    image: Option<RangeImage>,
    motion: QuantisedPose,
}

impl Before {
    /// The ranges predicted from the frame before (V-B and V-C); if the scanner's motion cannot be estimated,
    /// it is assumed to stand still. `None` if there is no frame before.
    fn predict(&mut self, image: &RangeImage, scanner: &Hdl64, config: &EncoderConfig) -> Option<Grid<u32>> {
        let before = self.image.take()?;
        let levels = Grid::new(before.steps.rows(), before.steps.columns());
        let past = Past::new(before, levels);
        let surface = past.surface(scanner);
        let found = register(surface, image, scanner, &self.motion.pose(), &config.registration);
        self.motion = found.and_then(|found| found.pose.quantise()).unwrap_or_default();
        let reference = past.reference(scanner, &image.columns, &self.motion.pose().motion());
        Some(inter::ranges(&reference, &image.occupancy()))
    }
}

/// The back-end that does not compress: shown in the table, not in the plots.
const STORE: &str = "store";

impl Figure13 {
    /// The table in KB, and the plots of ratios: in floats and in integers.
    pub fn sections(&self) -> Vec<Section> {
        let floats = self.plot(
            "Figure 13, floats",
            true,
            "As in the article: the range image and what prediction leaves of it as 32-bit floats. The article's \
             figure is a plot; of its values the text states the best and the worst over all scenes."
                .to_owned(),
        );
        let integers = self.plot(
            "Figure 13, integers",
            false,
            "The same ranges as integers in steps, packed for each back-end. diff.: differences along the \
             snake's path."
                .to_owned(),
        );
        vec![self.table(), floats, integers]
    }

    /// Mean KB of a frame.
    fn kilobytes(&self, backend: usize, form: usize) -> Option<f64> {
        let is_measured =
            self.frames > 0 && (FORMS[form].source != Source::FrameBefore || self.has_references);
        is_measured.then(|| self.sizes[backend][form] as f64 / self.frames as f64 / 1e3)
    }

    fn table(&self) -> Section {
        let kilobytes = |bytes: u64| bytes as f64 / self.frames.max(1) as f64 / 1e3;
        let row = |(place, backend): (usize, &&dyn crate::backend::Backend)| Row {
            name: backend.name().into(),
            cells: (0..FORMS.len()).map(|form| self.kilobytes(place, form)).collect(),
        };
        Section::Table(Table {
            number: "Figure 13, table".into(),
            title: format!("KB a frame, of {:.0} KB", kilobytes(self.original)),
            note: format!(
                "The mean of {}: those that have one before them, if there are any. Float and integer forms as in the \
                 plots. Intra forms include {:.1} KB of contour map and models of regions. Which cells hold a \
                 return is counted nowhere.",
                self.sample,
                kilobytes(self.side),
            ),
            label: "back-end".into(),
            columns: FORMS.iter().map(|form| column(form.name, "KB", Some(1), Origin::Measured)).collect(),
            rows: BACKENDS.iter().enumerate().map(row).collect(),
        })
    }

    fn plot(&self, number: &str, floats: bool, note: String) -> Section {
        let backends: Vec<_> =
            BACKENDS.iter().enumerate().filter(|(_, backend)| backend.name() != STORE).collect();
        let forms = FORMS.iter().enumerate().filter(|(_, form)| form.floats == floats);
        let measured = forms.map(|(form, about)| {
            let ratio = |backend| self.kilobytes(backend, form).map(|kilobytes| self.percent(kilobytes));
            let points = backends.iter().enumerate().filter_map(|(row, (backend, _))| {
                Some(Point { x: ratio(*backend)?, y: row as f64, label: String::new() })
            });
            let name = about.name.into();
            Series {
                name,
                origin: Origin::Measured,
                line: false,
                marker: marker(about),
                points: points.collect(),
            }
        });
        let mut series: Vec<_> = measured.filter(|series| !series.points.is_empty()).collect();
        if floats {
            let names: Vec<_> = backends.iter().map(|(_, backend)| backend.name()).collect();
            series.extend(published_series(&names));
        }
        let names = backends.iter().map(|(_, backend)| backend.name().to_owned()).collect();
        Section::Figure(Figure {
            number: number.into(),
            title: "what prediction is worth to each back-end".into(),
            note,
            x: Axis { name: "compression rate".into(), unit: "%".into(), scale: Scale::Linear },
            y: Axis { name: "back-end".into(), unit: String::new(), scale: Scale::Categories(names) },
            series,
        })
    }

    /// Equation 11.
    fn percent(&self, kilobytes: f64) -> f64 {
        let original = self.original as f64 / self.frames.max(1) as f64;
        if original > 0.0 { 100.0 * kilobytes * 1e3 / original } else { 0.0 }
    }
}

/// The same marker for the same prediction, but different ones within a plot.
fn marker(form: &Form) -> Marker {
    match (form.source, form.snake && !form.floats) {
        (Source::Nothing, false) => Marker::Circle,
        (Source::Nothing, true) => Marker::Diamond,
        (Source::Regions, false) => Marker::Square,
        (Source::Regions, true) => Marker::Cross,
        (Source::FrameBefore, false) => Marker::Triangle,
        (Source::FrameBefore, true) => Marker::Plus,
    }
}

/// The values that the article's text states for the figure.
fn published_series(backends: &[&str]) -> Vec<Series> {
    let kinds = [("intra, extremes", Marker::Square), ("inter, extremes", Marker::Triangle)];
    let series = published::FIGURE_13.iter().zip(kinds).map(|(extremes, (name, marker))| {
        let points = extremes.iter().filter_map(|(backend, ratio)| {
            let row = backends.iter().position(|name| name == backend)?;
            Some(Point { x: *ratio, y: row as f64, label: String::new() })
        });
        let name = name.to_owned();
        Series { name, origin: Origin::Published, line: false, marker, points: points.collect() }
    });
    series.collect()
}
