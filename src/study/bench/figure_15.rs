//! Figure 15 of the article: error against bit rate, for every coder available.

use super::experiment;
use super::report::{Axis, Figure, Marker, Origin, Point, Scale, Section, Series};
use super::sample::Sample;
use crate::article::image_coding::{ImageCodec, ImageConfig, Rate};
use crate::article::prediction::intra::{IntraConfig, RegionModels};
use crate::backend;
use crate::frame::settings::{Coder, EncoderConfig, Mode, PredictionChoice, ProjectionKind};
use crate::frame::{Intensity, Prediction};
use crate::ground::error::Result;
use crate::scanner::{FLOAT_RANGES, RANGE_STEP_UM};
use crate::study::metrics;

/// Range steps of the curves, in micrometres.
const STEPS_UM: [u32; 7] = [1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000];
/// Those with `--quick`.
const QUICK_STEPS_UM: [u32; 3] = [2000, 10_000, 50_000];

/// Rates of image coders, in bits a return.
const RATES: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Those with `--quick`.
const QUICK_RATES: [f64; 2] = [1.0, 4.0];

const INTRA: PredictionChoice = PredictionChoice::Always(Prediction::Intra);
const INTER: PredictionChoice = PredictionChoice::EveryReference;

/// A curve, or a point: settings of the encoder that differ in one respect.
struct Curve {
    name: &'static str,
    marker: Marker,
    /// The respect in words, and all settings.
    points: Vec<(String, EncoderConfig)>,
}

/// All curves.
pub struct Curves {
    /// The article's back-ends.
    article: Vec<Curve>,
    /// Other coders.
    others: Vec<Curve>,
}

impl Curves {
    /// The curves, with the columns of the image, the outlier filter and the regions of `base`; fewer points
    /// on each if `quick`.
    pub fn new(sample: &Sample, base: &EncoderConfig, quick: bool) -> Self {
        Curves { article: article_curves(sample, base, quick), others: other_curves(sample, base, quick) }
    }

    /// Number of frames to code in all.
    pub fn frames_to_code(&self, sample: &Sample) -> usize {
        let curves = self.article.iter().chain(&self.others);
        curves.map(|curve| curve.points.len()).sum::<usize>() * sample.inputs.len()
    }

    /// Measures all points.
    ///
    /// # Errors
    /// If a back-end's library fails.
    pub fn measure(&self, sample: &Sample, on_frame: &(dyn Fn() + Sync)) -> Result<Vec<Section>> {
        let (article, worst) = measure_all(&self.article, sample, on_frame)?;
        let note = format!(
            "On {}, of each run all frames but the first, which is there to predict from. Bits are those of \
             the coded frames, everything included, for each point that comes back. RMSE: equation 12 over \
             the returns of both range images, the original's made of float32 ranges; at most {:.2} % of the \
             returns are in one of them only. It leaves out what the projection itself does to the points: \
             {:.1} % have no cell of their own or are outliers, and the ideal sensor's beams are not the \
             scanner's. Directly: nothing is predicted. In two passes, each of the error of those before, where \
             that leaves less. Floats: without loss. The article's figure is a plot without values.",
            sample.describe(),
            100.0 * worst.alone,
            100.0 * worst.dropped,
        );
        let article = figure("Figure 15", "error against bit rate", note, article);
        let (others, _) = measure_all(&self.others, sample, on_frame)?;
        let note = "As above, for coarser range steps. The calibrated image's RMSE is against ranges in the \
                    scanner's own steps of 2 mm. Bounded and exact mode have all points, in order; their RMSE \
                    is that of points. Exact mode has intensities too. Without a calibrated image, as of scans \
                    that were moved afterwards, there is no curve of it.";
        let others = figure("Figure 15, beyond", "other ways to spend bits", note.to_owned(), others);
        Ok(vec![article, others])
    }
}

fn figure(number: &str, title: &str, note: String, series: Vec<Series>) -> Section {
    Section::Figure(Figure {
        number: number.into(),
        title: title.into(),
        note,
        x: Axis { name: "bit rate".into(), unit: "bits a point".into(), scale: Scale::Log },
        y: Axis { name: "RMSE".into(), unit: "m".into(), scale: Scale::Log },
        series,
    })
}

/// A curve that is one point.
fn one(name: &'static str, marker: Marker, setting: &str, config: EncoderConfig) -> Curve {
    Curve { name, marker, points: vec![(setting.to_owned(), config)] }
}

/// JPEG and JPEG 2000 at rising rates, for the image itself and for residuals; and LZMA for residuals,
/// without loss, as in the article.
fn article_curves(sample: &Sample, base: &EncoderConfig, quick: bool) -> Vec<Curve> {
    let rates: &[f64] = if quick { &QUICK_RATES } else { &RATES };
    let by_rate = |name, marker, codec, prediction| {
        let at = |&rate: &f64| {
            let image = ImageConfig { rate: Rate::Bits(rate), ..base.image };
            (
                format!("{rate} bits"),
                EncoderConfig { coder: Coder::Image(codec), prediction, image, ..base.clone() },
            )
        };
        Curve { name, marker, points: rates.iter().map(at).collect() }
    };
    let floats = |prediction| EncoderConfig {
        projection: with_step(base.projection, FLOAT_RANGES),
        coder: Coder::Backend(backend::LZMA),
        intra: IntraConfig { models: RegionModels::Article, ..base.intra },
        prediction,
        ..base.clone()
    };
    let none = PredictionChoice::Always(Prediction::None);
    let (jpeg, jpeg2000) = (ImageCodec::Jpeg, ImageCodec::Jpeg2000);
    let mut curves = vec![
        by_rate("JPEG, directly", Marker::Square, jpeg, none),
        by_rate("JPEG, intra", Marker::Triangle, jpeg, INTRA),
        by_rate("JPEG 2000, directly", Marker::Circle, jpeg2000, none),
        by_rate("JPEG 2000, intra", Marker::Diamond, jpeg2000, INTRA),
        one("LZMA, intra, floats", Marker::Cross, "float", floats(INTRA)),
    ];
    if sample.has_references() {
        curves.insert(2, by_rate("JPEG, inter", Marker::TriangleDown, jpeg, INTER));
        curves.insert(5, by_rate("JPEG 2000, inter", Marker::Star, jpeg2000, INTER));
        curves.push(one("LZMA, inter, floats", Marker::Plus, "float", floats(INTER)));
    }
    curves
}

/// Lossless coders with coarser steps, and the modes of this program.
fn other_curves(sample: &Sample, base: &EncoderConfig, quick: bool) -> Vec<Curve> {
    let steps: &[u32] = if quick { &QUICK_STEPS_UM } else { &STEPS_UM };
    let at = |step: u32, coder, prediction| EncoderConfig {
        projection: with_step(base.projection, step),
        coder,
        prediction,
        ..base.clone()
    };
    let by_step = |name, marker, coder, prediction| Curve {
        name,
        marker,
        points: steps.iter().map(|&step| (length(step), at(step, coder, prediction))).collect(),
    };
    let lzma = Coder::Backend(backend::LZMA);
    let smallest = PredictionChoice::Smallest;
    let calibrated = |step: u32| EncoderConfig {
        projection: ProjectionKind::Calibrated { range_step_um: Some(step) },
        outliers: None,
        ..at(step, Coder::Context, smallest)
    };
    // So coarse a step removes the intensities.
    let intensity = Intensity::Rounded { step_millionths: u32::MAX };
    let bounded = |max_error_um| EncoderConfig {
        threads: base.threads,
        intensity,
        ..EncoderConfig::preset(Mode::Bounded { max_error_um })
    };
    let coarser = || steps.iter().filter(|&&step| step >= RANGE_STEP_UM);
    let mut curves = vec![by_step("LZMA, intra", Marker::Square, lzma, INTRA)];
    if sample.has_references() {
        curves.push(by_step("LZMA, inter", Marker::Triangle, lzma, INTER));
    }
    curves.push(by_step("context, ideal image", Marker::Circle, Coder::Context, smallest));
    curves.push(Curve {
        name: "context, calibrated image",
        marker: Marker::Diamond,
        points: coarser().map(|&step| (length(step), calibrated(step))).collect(),
    });
    curves.push(Curve {
        name: "bounded mode, without intensities",
        marker: Marker::TriangleDown,
        points: coarser().map(|&error| (length(error), bounded(error))).collect(),
    });
    let exact = EncoderConfig { threads: base.threads, ..EncoderConfig::preset(Mode::Exact) };
    curves.push(one("exact mode, whole files", Marker::Star, "", exact));
    curves
}

/// Measures curves. Those of which nothing can be measured are left out. Also returns the largest shares of
/// returns that only one image has, and of points that are dropped.
fn measure_all(
    curves: &[Curve],
    sample: &Sample,
    on_frame: &(dyn Fn() + Sync),
) -> Result<(Vec<Series>, Missing)> {
    let mut series = Vec::new();
    let mut worst = Missing::default();
    for curve in curves {
        let mut points = Vec::new();
        for (setting, config) in &curve.points {
            let Measured { bits, rmse, missing } = measure(sample, config, on_frame)?;
            worst.alone = worst.alone.max(missing.alone);
            worst.dropped = worst.dropped.max(missing.dropped);
            if let (Some(x), Some(y)) = (bits, rmse) {
                points.push(Point { x, y, label: setting.clone() });
            }
        }
        if points.is_empty() {
            continue;
        }
        series.push(Series {
            name: curve.name.into(),
            origin: Origin::Measured,
            line: curve.points.len() > 1,
            marker: curve.marker,
            points,
        });
    }
    Ok((series, worst))
}

/// A point of a curve.
struct Measured {
    /// Bits for each point that is decoded.
    bits: Option<f64>,
    /// In metres.
    rmse: Option<f64>,
    missing: Missing,
}

/// What an error does not cover.
#[derive(Clone, Copy, Default)]
struct Missing {
    /// The share of the returns that only one of the range images has.
    alone: f64,
    /// The share of the points that were dropped.
    dropped: f64,
}

fn measure(sample: &Sample, config: &EncoderConfig, on_frame: &(dyn Fn() + Sync)) -> Result<Measured> {
    let coded = experiment::run(sample, config, on_frame)?;
    let frames = || sample.compared();
    let points = sample.points(frames());
    let decoded = frames().map(|frame| coded.frames[frame].decoded.header.point_count).sum();
    let distortion = coded.distortion(sample, config, frames());
    let ranges = &distortion.ranges;
    let alone = ranges.only_original + ranges.only_decoded;
    let sources = frames().filter_map(|frame| coded.frames[frame].decoded.source);
    let dropped: u64 = sources.map(|source| source.outliers + source.lost).sum();
    let part = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    Ok(Measured {
        bits: metrics::bits_per_point(coded.bytes(frames()).round() as u64, decoded),
        rmse: distortion.rmse(),
        missing: Missing { alone: part(alone, alone + ranges.compared), dropped: part(dropped, points) },
    })
}

/// The ideal image with another step.
fn with_step(projection: ProjectionKind, step: u32) -> ProjectionKind {
    match projection {
        ProjectionKind::Ideal { columns, .. } => ProjectionKind::Ideal { columns, range_step_um: step },
        ProjectionKind::Calibrated { .. } => ProjectionKind::Calibrated { range_step_um: Some(step) },
    }
}

/// A length in words: `2 mm`, `1 cm`.
fn length(micrometres: u32) -> String {
    let units = [(10_000, "cm"), (1000, "mm"), (1, "\u{b5}m")];
    let fitting = units.into_iter().find(|(unit, _)| micrometres.is_multiple_of(*unit));
    fitting.map_or_else(String::new, |(unit, name)| format!("{} {name}", micrometres / unit))
}
